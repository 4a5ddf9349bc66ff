"""mjlab: actuator configurations, and event terms that draw what a diagnosis leaves open."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from gapscope.envs.export.snippets.arm_values import SnippetArm
from gapscope.envs.export.snippets.isaac_lab import factors
from gapscope.envs.export.snippets.target import JOINTS, Target

TEMPLATE = """
import math

from mjlab.actuator import IdealPdActuatorCfg
{% if arm.ranges %}
from mjlab.envs.mdp import dr
from mjlab.managers.event_manager import EventTermCfg
from mjlab.managers.scene_entity_config import SceneEntityCfg
{% endif %}

PHYSICS_DT = 0.002  # s: timestep of your MuJoCo model, in which delays are counted
{% if gains %}
TORQUE_GAIN = {{ gains | table }}  # times efforts that you command
{% endif %}

ACTUATORS = (  # actuators= of EntityArticulationInfoCfg
{% for joint in joints %}
{% set delay = arm.ends("delay")[joint.name] %}
    IdealPdActuatorCfg(
        target_names_expr=({{ joint.name | quoted }},),
        stiffness={{ joint.applied_kp | number }},
        damping={{ joint.applied_kd | number }},
        effort_limit={{ joint.applied_effort | number }},
        armature={{ joint.armature | number }},
        frictionloss={{ joint.friction | number }},
        viscous_damping={{ joint.damping | number }},
{% if delay[0] < delay[1] %}
        delay_min_lag=math.floor({{ delay[0] | number }} / PHYSICS_DT),
        delay_max_lag=math.ceil({{ delay[1] | number }} / PHYSICS_DT),
        delay_update_period=10**9,  # one lag from a reset on, not another at each step
        delay_per_env_phase=False,
{% else %}
        delay_min_lag=round({{ delay[0] | number }} / PHYSICS_DT),
        delay_max_lag=round({{ delay[1] | number }} / PHYSICS_DT),
{% endif %}
    ),
{% endfor %}
)
{% if arm.ranges %}

EVENTS = {  # events= of ManagerBasedRlEnvCfg
{% for key, func, ends in drawn %}
    "{{ key }}": EventTermCfg(
        func=dr.{{ func }},
        mode="startup",
        params={
            "ranges": {{ ends | table(12) }},
            "operation": "abs",
        },
    ),
{% endfor %}
{% for name, ends in biased.items() %}
    "encoder_{{ name }}": EventTermCfg(
        func=dr.encoder_bias,
        mode="startup",
        params={
            "bias_range": {{ ends | pair }},
            "asset_cfg": SceneEntityCfg("robot", joint_names=({{ name | quoted }},)),
        },
    ),
{% endfor %}
{% for name, ends in gain.items() %}
    "gains_{{ name }}": EventTermCfg(
        func=dr.pd_gains,
        mode="startup",
        params={
            "kp_range": {{ ends | pair }},
            "kd_range": {{ ends | pair }},
            "asset_cfg": SceneEntityCfg("robot", actuator_names=({{ name | quoted }},)),
            "operation": "scale",
        },
    ),
{% endfor %}
{% for body in arm.bodies %}
    # a point mass added at the centre of mass: dr.body_mass leaves the inertia tensor
    "mass_{{ body.name }}": EventTermCfg(
        func=dr.body_mass,
        mode="startup",
        params={"ranges": {{ {body.name: body.mass} | table }}, "operation": "add"},
    ),
    "com_{{ body.name }}": EventTermCfg(
        func=dr.body_com_offset,
        mode="startup",
        params={
            "ranges": {0: {{ body.com[0] | pair }}, 1: {{ body.com[1] | pair }}, 2: {{ body.com[2] | pair }}},
            "asset_cfg": SceneEntityCfg("robot", body_names=({{ body.name | quoted }},)),
            "operation": "add",
        },
    ),
{% endfor %}
}
{% endif %}
"""
TWO_MASSES = (
    "the file of gapscope export --format mjcf has a joint of the motor for it, with rotor and friction: act on that "
    "joint, and leave armature, frictionloss and viscous_damping of this one out"
)
"""What to know of joints with elasticity or backlash."""
TERMS = (("friction", "friction"), ("damping", "damping"), ("armature", "armature"))
"""Values of a joint, and what ``dr.joint_*`` calls them."""


def values(arm: SnippetArm) -> Mapping[str, Any]:
    """Gains of the torque, and what the events draw."""
    # the file of the arm has the offsets themselves
    found = {joint.name: joint.encoder_offset for joint in arm.joints}
    biased = {
        name: (low - found[name], high - found[name])
        for name, (low, high) in arm.ends("encoder_offset").items()
        if low < high
    }
    drawn = [
        (
            f"joint_{func}",
            f"joint_{func}",
            {n: e for n, e in ends.items() if e[0] < e[1]},
        )
        for name, func in TERMS
        if arm.varies(name) and (ends := arm.ends(name))
    ]
    return {
        "gains": {j.name: j.torque_gain for j in arm.joints if j.torque_gain != 1.0},
        "drawn": drawn,
        "biased": biased,
        "gain": factors(arm, "applied_kp", "applied_kd"),
    }


MJLAB = Target(
    name="mjlab",
    title="mjlab 1.6",
    template=TEMPLATE,
    held=JOINTS | {"actuator_delay", "torque_scale"},
    hints={
        "torque_scale": "in gains and limits; multiply efforts that you command by TORQUE_GAIN",
        "encoder_offset": "in the file of gapscope export --format mjcf; its range as the event dr.encoder_bias, for "
        "which observe joint_pos_biased",
        "joint_elasticity": TWO_MASSES,
        "backlash": TWO_MASSES,
        "parallel_spring": "in the file of gapscope export --format mjcf, which this belongs to",
    },
    notes=(
        "The lag holds back targets and efforts, not the measured state: to delay torque as the arm does, command "
        "efforts with stiffness and damping at zero and your control law outside.",
        "The file of gapscope export --format mjcf has actuators of its own: delete its <actuator> element first.",
        "The gains are those of the case, without its feedforward, if its controller is a PD law, else zero: put in "
        "your own, or command efforts.",
    ),
    model="mjcf",
    values=values,
)
"""The target."""
