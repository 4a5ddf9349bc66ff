"""Newton: values of joints and their drives, set in a ``ModelBuilder``."""

from __future__ import annotations

from gapscope.envs.export.snippets.joint_table import NAMES, TABLE
from gapscope.envs.export.snippets.target import JOINTS, Target

TEMPLATE = (
    NAMES
    + """
{% set names = dict(names, torque_offset="offset", delay="delay") %}
from newton.actuators import ClampingMaxEffort, DrivePD

PHYSICS_DT = 0.002  # s: time between calls of Actuator.step, in which Delay counts
"""
    + TABLE
    + """

def add_actuators(builder{{ ", rng=None" if arm.ranges else "" }}):
    \"\"\"Set the arm's joints in a newton.ModelBuilder, of all its worlds; call it before finalize().\"\"\"
    for joint, label in enumerate(builder.joint_label):
        name = label.rsplit("/", 1)[-1]
        if name not in JOINTS:
            continue
        values = values_of(name{{ ", rng" if arm.ranges else "" }})
        dof, position = builder.joint_qd_start[joint], builder.joint_q_start[joint]
        builder.joint_damping[dof] = values["damping"]
        builder.joint_friction[dof] = values["friction"]
        builder.joint_armature[dof] = values["armature"]
        builder.joint_stiffness[dof] = values["spring_stiffness"]
        builder.joint_rest_q[dof] = values["spring_rest"]
        # the drive below in place of the solver's own
        builder.joint_target_ke[dof] = builder.joint_target_kd[dof] = 0.0
        gain = values["torque_gain"]  # torque at the joint over the commanded one
        clamping = [(ClampingMaxEffort, {"max_effort": gain * values["effort"]})] if "effort" in values else []
        builder.add_actuator(
            DrivePD,
            index=dof,
            pos_index=position,
            kp=gain * values["kp"],
            kd=gain * values["kd"],
            const_effort=values["torque_offset"],
            clamping=clamping,
            delay_steps=round(values["delay"] / PHYSICS_DT) or None,
        )
"""
)

NEWTON = Target(
    name="newton",
    title="Newton 1.8",
    template=TEMPLATE,
    held=JOINTS | {"delay", "scale", "offset", "stiffness", "rest"},
    hints={
        "scale": "as torque_gain, in gains and limits; multiply feedforward efforts by it",
        "offset": "as const_effort of DrivePD, which the limit clips too",
    },
    notes=(
        "Delay holds back targets and feedforward, not the measured state: to delay torque as the arm does, command "
        "feedforward with kp and kd at zero and your control law outside.",
        "joint_friction, joint_stiffness and joint_rest_q are used by SolverMuJoCo; see its documentation for others.",
        "The gains are those of the case, without its feedforward, if its controller is a PD law, else zero.",
        "DriveNeuralMLP and DriveNeuralGRU load networks that map one joint's position error and velocity to its whole "
        "torque; a residual network adds to a drive and sees all joints: evaluate it beside them.",
    ),
)
"""The target."""
