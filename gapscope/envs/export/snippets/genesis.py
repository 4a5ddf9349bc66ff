"""Genesis: values of joints, set on an entity."""

from __future__ import annotations

from gapscope.envs.export.snippets.joint_table import NAMES, TABLE
from gapscope.envs.export.snippets.target import JOINTS, Target

TEMPLATE = (
    NAMES
    + """
import numpy as np
"""
    + TABLE
    + """

def set_joints(robot{{ ", rng=None, n_envs=0" if arm.ranges else "" }}):
    \"\"\"Set the joints of a rigid entity after scene.build().
{% if arm.ranges %}

    With a generator of numpy and a number of environments each has values of its own, which
    RigidOptions(batch_dofs_info=True) must allow.
{% endif %}
    \"\"\"
    dofs = [robot.get_joint(name).dofs_idx_local[0] for name in JOINTS]
{% if arm.ranges %}
    draws = [[values_of(name, rng) for name in JOINTS] for _ in range(max(n_envs, 1))]

    def column(key):
        rows = np.array([[values[key] for values in row] for row in draws])
        return rows if n_envs else rows[0]

    limit = np.array([[values.get("effort", np.inf) for values in row] for row in draws])
    gain = column("torque_gain")  # torque at the joint over the commanded one
    limit = gain * (limit if n_envs else limit[0])
{% else %}
    values = [values_of(name) for name in JOINTS]

    def column(key):
        return np.array([each[key] for each in values])

    gain = column("torque_gain")  # torque at the joint over the commanded one
    limit = gain * np.array([each.get("effort", np.inf) for each in values])
{% endif %}

    robot.set_dofs_damping(column("damping"), dofs)
    robot.set_dofs_frictionloss(column("friction"), dofs)
    robot.set_dofs_armature(column("armature"), dofs)
    robot.set_dofs_stiffness(column("spring_stiffness"), dofs)
    robot.set_dofs_kp(gain * column("kp"), dofs)
    robot.set_dofs_kv(gain * column("kd"), dofs)
    robot.set_dofs_force_range(-limit, limit, dofs)
"""
)

GENESIS = Target(
    name="genesis",
    title="Genesis 1.4",
    template=TEMPLATE,
    held=JOINTS | {"scale"},
    hints={
        "scale": "as torque_gain, in gains and limits; multiply efforts that you command by it",
        "stiffness": "its stiffness is set, but a joint springs back to where its file has it at rest: move "
        "that by spring_rest",
    },
    notes=(
        "A command acts at once: hold back what you pass to control_dofs_force by the delay, if one is listed above.",
        "kv of control_dofs_position multiplies the velocity alone, not its error: with a reference that moves, "
        "command control_dofs_force instead.",
        "The gains are those of the case, without its feedforward, if its controller is a PD law, else zero.",
    ),
)
"""The target."""
