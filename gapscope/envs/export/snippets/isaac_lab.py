"""Isaac Lab: actuator configurations, and event terms that draw what a diagnosis leaves open."""

from __future__ import annotations

from gapscope.envs.export.snippets.target import JOINTS, Target

TEMPLATE = """
import math

from isaaclab.actuators import DelayedPDActuatorCfg
{% if arm.ranges %}
import isaaclab.envs.mdp as mdp
from isaaclab.managers import EventTermCfg, SceneEntityCfg
{% endif %}

PHYSICS_DT = 0.005  # s: sim.dt of your environment, in which delays are counted
{% if arm.gains %}
TORQUE_GAIN = {{ arm.gains | table }}  # times efforts that you command
{% endif %}

ACTUATORS = {  # actuators= of ArticulationCfg
{% for delay, names in arm.groups("delay").items() %}
    "arm_{{ loop.index }}": DelayedPDActuatorCfg(
        joint_names_expr=[{{ names | map("quoted") | join(", ") }}],
        stiffness={{ arm.column("applied_kp", names) | table(8) }},
        damping={{ arm.column("applied_kd", names) | table(8) }},
{% if arm.column("applied_effort", names) %}
        actuator_effort_limit={{ arm.column("applied_effort", names) | table(8) }},  # 2.x: effort_limit
{% endif %}
{% if arm.column("velocity", names) %}
        actuator_velocity_limit={{ arm.column("velocity", names) | table(8) }},  # 2.x: velocity_limit
{% endif %}
        armature={{ arm.column("rotor", names) | table(8) }},
        friction={{ arm.column("static_friction", names) | table(8) }},
        dynamic_friction={{ arm.column("friction", names) | table(8) }},
        viscous_friction={{ arm.column("damping", names) | table(8) }},
{% if delay[0] < delay[1] %}
        min_delay=math.floor({{ delay[0] | number }} / PHYSICS_DT),
        max_delay=math.ceil({{ delay[1] | number }} / PHYSICS_DT),
{% else %}
        min_delay=round({{ delay[0] | number }} / PHYSICS_DT),
        max_delay=round({{ delay[1] | number }} / PHYSICS_DT),
{% endif %}
    ),
{% endfor %}
}
{% if arm.ranges %}

{% set friction = ["static_friction", "friction", "damping"] %}
EVENTS = {  # for name, term in EVENTS.items(): setattr(cfg.events, name, term)
{% for name, ends in arm.factors(*friction).items() %}
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
{% for joint in joints %}
{% for value in friction if joint[value] == 0 < arm.ends(value)[joint.name][1] %}
{% set ends = arm.ends(value)[joint.name] %}
    # {{ value }} of {{ joint.name }} is 0 here and {{ ends | pair }} over all units: no factor of 0 draws that
{% endfor %}
{% endfor %}
{% for name, ends in arm.ranged("rotor").items() %}
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
{% for name, ends in arm.factors("applied_kp", "applied_kd").items() %}
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

ISAAC_LAB = Target(
    name="isaac_lab",
    title="Isaac Lab 3 (names of 2.x beside them)",
    template=TEMPLATE,
    held=JOINTS | {"delay", "scale", "breakaway", "breakaway_speed"},
    hints={
        "breakaway": "in friction at rest; in motion dynamic_friction acts at once, not from this velocity on",
        "scale": "in gains and limits; multiply efforts that you command by TORQUE_GAIN",
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
)
"""The target."""
