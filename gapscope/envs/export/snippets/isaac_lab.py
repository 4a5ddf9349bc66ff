"""Isaac Lab: actuator configurations, and event terms that draw what a diagnosis leaves open."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from gapscope.envs.export.snippets.arm_values import JointValues, SnippetArm
from gapscope.envs.export.snippets.target import JOINTS, Target, finite

TEMPLATE = """
import math

from isaaclab.actuators import DelayedPDActuatorCfg
{% if arm.ranges %}
import isaaclab.envs.mdp as mdp
from isaaclab.managers import EventTermCfg, SceneEntityCfg
{% endif %}

PHYSICS_DT = 0.005  # s: sim.dt of your environment, in which delays are counted
{% if gains %}
TORQUE_GAIN = {{ gains | table }}  # times efforts that you command
{% endif %}

ACTUATORS = {  # actuators= of ArticulationCfg
{% for group in groups %}
    "{{ group.label }}": DelayedPDActuatorCfg(
        joint_names_expr=[{{ group.names | map("quoted") | join(", ") }}],
        stiffness={{ group.table("applied_kp") | table(8) }},
        damping={{ group.table("applied_kd") | table(8) }},
{% if group.table("applied_effort") %}
        actuator_effort_limit={{ group.table("applied_effort") | table(8) }},  # 2.x: effort_limit
{% endif %}
{% if group.table("velocity") %}
        actuator_velocity_limit={{ group.table("velocity") | table(8) }},  # 2.x: velocity_limit
{% endif %}
        armature={{ group.table("armature") | table(8) }},
        friction={{ group.table("static_friction") | table(8) }},
        dynamic_friction={{ group.table("friction") | table(8) }},
        viscous_friction={{ group.table("damping") | table(8) }},
{% if group.delay[0] < group.delay[1] %}
        min_delay=math.floor({{ group.delay[0] | number }} / PHYSICS_DT),
        max_delay=math.ceil({{ group.delay[1] | number }} / PHYSICS_DT),
{% else %}
        min_delay=round({{ group.delay[0] | number }} / PHYSICS_DT),
        max_delay=round({{ group.delay[1] | number }} / PHYSICS_DT),
{% endif %}
    ),
{% endfor %}
}
{% if arm.ranges %}

EVENTS = {  # for name, term in EVENTS.items(): setattr(cfg.events, name, term)
{% for name, ends in friction.items() %}
    # one factor each for static, dynamic and viscous friction of {{ name }}: the term has one range for all three
    "friction_{{ name }}": EventTermCfg(
        func=mdp.randomize_joint_parameters,
        mode="startup",
        params={
            "asset_cfg": SceneEntityCfg("robot", joint_names=[{{ name | quoted }}]),
            "friction_distribution_params": {{ ends | pair }},
            "operation": "scale",
        },
    ),
{% endfor %}
{% for name, value, ends in without_factor %}
    # {{ value }} of {{ name }} is 0 here and {{ ends | pair }} over all units: no factor of 0 draws that
{% endfor %}
{% for name, ends in arm.ends("armature").items() if ends[0] < ends[1] %}
    "armature_{{ name }}": EventTermCfg(
        func=mdp.randomize_joint_parameters,
        mode="startup",
        params={
            "asset_cfg": SceneEntityCfg("robot", joint_names=[{{ name | quoted }}]),
            "armature_distribution_params": {{ ends | pair }},
            "operation": "abs",
        },
    ),
{% endfor %}
{% for name, ends in gain.items() %}
    "gains_{{ name }}": EventTermCfg(
        func=mdp.randomize_actuator_gains,
        mode="startup",
        params={
            "asset_cfg": SceneEntityCfg("robot", joint_names=[{{ name | quoted }}]),
            "stiffness_distribution_params": {{ ends | pair }},
            "damping_distribution_params": {{ ends | pair }},
            "operation": "scale",
        },
    ),
{% endfor %}
{% for body in arm.bodies %}
    "mass_{{ body.name }}": EventTermCfg(
        func=mdp.randomize_rigid_body_mass,
        mode="startup",
        params={
            "asset_cfg": SceneEntityCfg("robot", body_names=[{{ body.name | quoted }}]),
            "mass_distribution_params": {{ body.mass | pair }},
            "operation": "add",
        },
    ),
    "com_{{ body.name }}": EventTermCfg(
        func=mdp.randomize_rigid_body_com,
        mode="startup",
        params={
            "asset_cfg": SceneEntityCfg("robot", body_names=[{{ body.name | quoted }}]),
            "com_range": {"x": {{ body.com[0] | pair }}, "y": {{ body.com[1] | pair }}, "z": {{ body.com[2] | pair }}},
        },
    ),
{% endfor %}
}
{% endif %}
"""


FRICTION = ("static_friction", "friction", "damping")
"""Values of a joint that one range of Isaac Lab scales."""


class Group:
    """Joints with the same delay, which one actuator configuration has for all of its joints.

    Attributes:
        label: its key.
        joints: the joints.
        delay: lowest and highest delay [s].
    """

    def __init__(
        self, label: str, joints: list[JointValues], delay: tuple[float, float]
    ) -> None:
        self.label, self.joints, self.delay = label, joints, delay

    @property
    def names(self) -> list[str]:
        """Names of the joints."""
        return [joint.name for joint in self.joints]

    def table(self, value: str) -> dict[str, float]:
        """A value of each joint, if it is finite."""
        return finite({joint.name: getattr(joint, value) for joint in self.joints})


def values(arm: SnippetArm) -> Mapping[str, Any]:
    """Groups of joints, factors of their friction and gains."""
    by_delay: dict[tuple[float, float], list[JointValues]] = {}
    delays = arm.ends("delay")
    for joint in arm.joints:
        by_delay.setdefault(delays[joint.name], []).append(joint)
    groups = [
        Group(f"arm_{k}", joints, delay)
        for k, (delay, joints) in enumerate(by_delay.items(), 1)
    ]
    gains = {j.name: j.torque_gain for j in arm.joints if j.torque_gain != 1.0}
    return {
        "groups": groups,
        "gains": gains,
        "friction": factors(arm, *FRICTION),
        "gain": factors(arm, "applied_kp", "applied_kd"),
        "without_factor": [
            (joint.name, value, arm.ends(value)[joint.name])
            for joint in arm.joints
            for value in FRICTION
            if getattr(joint, value) == 0 < arm.ends(value)[joint.name][1]
        ],
    }


def factors(arm: SnippetArm, *names: str) -> dict[str, tuple[float, float]]:
    """Lowest and highest factor of some values of each joint together; joints without a range are left out.

    Args:
        arm: the arm.
        names: of the values; one that is zero has no factor.
    """
    found = {}
    for joint in arm.joints:
        ratios = [1.0]
        for name in names:
            value = getattr(joint, name)
            if value > 0:
                ratios += [end / value for end in arm.ends(name)[joint.name]]
        if np.ptp(ratios) > 0:
            found[joint.name] = (min(ratios), max(ratios))
    return found


ISAAC_LAB = Target(
    name="isaac_lab",
    title="Isaac Lab 3 (names of 2.x beside them)",
    template=TEMPLATE,
    held=JOINTS | {"actuator_delay", "torque_scale", "stribeck_friction"},
    hints={
        "stribeck_friction": "in friction at rest; in motion dynamic_friction acts at once, not from this velocity on",
        "torque_scale": "in gains and limits; multiply efforts that you command by TORQUE_GAIN",
    },
    notes=(
        "friction and dynamic_friction are efforts in N m from Isaac Sim 5 on; before, they were coefficients of the "
        "load on the joint: leave them out there.",
        "On Newton (MJWarp) there is no dynamic_friction; friction is the only dry friction.",
        "min_delay and max_delay hold back targets and efforts, not the measured state: to delay torque as the arm "
        "does, command efforts with stiffness and damping at zero and your control law outside.",
        "The gains are those of the case, without its feedforward, if its controller is a PD law, else zero: put in "
        "your own, or command efforts.",
    ),
    values=values,
)
"""The target."""
