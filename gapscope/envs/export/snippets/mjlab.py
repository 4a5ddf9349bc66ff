"""mjlab: actuator configurations, and event terms that draw what a diagnosis leaves open."""

from __future__ import annotations

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
{% if arm.gains %}
TORQUE_GAIN = {{ arm.gains | table }}  # times efforts that you command
{% endif %}

ACTUATORS = (  # actuators= of EntityArticulationInfoCfg
{% for joint in joints %}
{% set delay = arm.ends("delay")[joint.name] %}
    IdealPdActuatorCfg(
        target_names_expr=({{ joint.name | quoted }},),
        stiffness={{ joint.applied_kp | number }},
        damping={{ joint.applied_kd | number }},
        effort_limit={{ joint.applied_effort | number }},
        armature={{ joint.rotor | number }},
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

{% set terms = {"friction": "joint_friction", "damping": "joint_damping", "rotor": "joint_armature"} %}
EVENTS = {  # events= of ManagerBasedRlEnvCfg
{% for name, func in terms.items() if arm.ranged(name) %}
    "{{ func }}": EventTermCfg(
        func=dr.{{ func }},
        mode="startup",
        params={
            "ranges": {{ arm.ranged(name) | table(12) }},
            "operation": "abs",
        },
    ),
{% endfor %}
{% for joint in joints if joint.name in arm.ranged("zero") %}
{# the file of the arm has the offsets themselves #}
{% set ends = arm.ranged("zero")[joint.name] %}
    "encoder_{{ joint.name }}": EventTermCfg(
        func=dr.encoder_bias,
        mode="startup",
        params={
            "bias_range": {{ (ends[0] - joint.zero, ends[1] - joint.zero) | pair }},
            "asset_cfg": SceneEntityCfg("robot", joint_names=({{ joint.name | quoted }},)),
        },
    ),
{% endfor %}
{% for name, ends in arm.factors("applied_kp", "applied_kd").items() %}
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

MJLAB = Target(
    name="mjlab",
    title="mjlab 1.6",
    template=TEMPLATE,
    held=JOINTS | {"delay", "scale"},
    hints={
        "scale": "in gains and limits; multiply efforts that you command by TORQUE_GAIN",
        "zero": "in the file of gapscope export --format mjcf; its range as the event dr.encoder_bias, for "
        "which observe joint_pos_biased",
        "gear_stiffness": TWO_MASSES,
        "play": TWO_MASSES,
        "stiffness": "in the file of gapscope export --format mjcf, which this belongs to",
    },
    notes=(
        "The lag holds back targets and efforts, not the measured state: to delay torque as the arm does, command "
        "efforts with stiffness and damping at zero and your control law outside.",
        "The file of gapscope export --format mjcf has actuators of its own: delete its <actuator> element first.",
        "The gains are those of the case, without its feedforward, if its controller is a PD law, else zero: put in "
        "your own, or command efforts.",
    ),
    model="mjcf",
)
"""The target."""
