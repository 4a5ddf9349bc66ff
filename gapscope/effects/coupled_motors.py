"""Rotor and friction of motors that turn several joints, as in a wrist: those of a joint, taken at the motor.

Motor m turns at w = D_m dq, D_m [1] the row of the arm's coupling, on the side of the joint of its own number, and its
torque acts on the joints along D_m^T. ``joints`` of these effects are the numbers of the motors. They exist on arms
whose case declares a coupling.
"""

from __future__ import annotations

from dataclasses import replace

from gapscope.effects.effect import DryLaw, Effect, Inertial, TorqueLaw
from gapscope.effects.friction import (
    COULOMB,
    COULOMB_TORQUE,
    SATURATING,
    STRIBECK,
    VISCOUS,
    VISCOUS_COEFFICIENT,
)
from gapscope.effects.parametrisation import linear_in
from gapscope.effects.rigid_body import ARMATURE, ROTOR_INERTIA

_ALONE = "the joints of the motor one at a time, then against each other"

COUPLED_COULOMB: DryLaw = replace(
    COULOMB,
    name="coupled_coulomb_friction",
    equation="D^T c sgn(D dq)",
    looks_like="a step of the torque of all joints of one motor, where the motor turns round",
    confused_with=((COULOMB.name, _ALONE),),
    on_joint=COULOMB.name,
    parametrisation=linear_in(COULOMB_TORQUE, lowest=0.0),
    severity=None,
    reach="motor",
    plotted_against="own torque",
    quantities={"torque": "motor_friction"},
)

COUPLED_STRIBECK: DryLaw = replace(
    STRIBECK,
    name="coupled_stribeck_friction",
    equation="D^T d exp(-(D dq / vs)^2) sgn(D dq)",
    looks_like="friction of a motor that falls as it begins to move",
    confused_with=((STRIBECK.name, _ALONE),),
    on_joint=STRIBECK.name,
    parametrisation=None,
    severity=None,
    reach="motor",
    quantities={"torque": "motor_breakaway", "velocity": "motor_breakaway_speed"},
    without="",
)

COUPLED_SATURATING: DryLaw = replace(
    SATURATING,
    name="coupled_saturating_friction",
    equation="D^T d tanh(|D dq| / vs) sgn(D dq)",
    looks_like="friction of a motor that grows with its speed, less and less",
    confused_with=((SATURATING.name, _ALONE),),
    on_joint=SATURATING.name,
    parametrisation=None,
    severity=None,
    reach="motor",
    plotted_against="own torque",
    quantities={"torque": "motor_saturating", "velocity": "motor_saturating_speed"},
    without="",
)

COUPLED_VISCOUS: TorqueLaw = replace(
    VISCOUS,
    name="coupled_viscous_friction",
    equation="D^T b D dq",
    looks_like="a torque on all joints of one motor, linear in the motor's speed",
    confused_with=((VISCOUS.name, _ALONE),),
    on_joint=VISCOUS.name,
    parametrisation=linear_in(VISCOUS_COEFFICIENT, lowest=0.0),
    severity=None,
    reach="motor",
    plotted_against="own torque",
    quantities={"coefficient": "motor_damping"},
)

COUPLED_ARMATURE: Inertial = replace(
    ARMATURE,
    name="coupled_armature",
    equation="D^T I D ddq",
    looks_like="a torque on all joints of one motor, proportional to the motor's acceleration",
    confused_with=((ARMATURE.name, _ALONE),),
    on_joint=ARMATURE.name,
    parametrisation=linear_in(ROTOR_INERTIA, lowest=0.0),
    severity=None,
    reach="motor",
    plotted_against="own torque",
    quantities={"inertia": "motor_rotor"},
)

COUPLED_MOTORS: dict[str, Effect] = {
    effect.name: effect
    for effect in (
        *(COUPLED_COULOMB, COUPLED_VISCOUS, COUPLED_ARMATURE),
        *(COUPLED_STRIBECK, COUPLED_SATURATING),
    )
}
"""Effects of coupled motors by name; the catalogue is for arms of any kind and does without them.

A diagnosis looks for the first three; the others come from an identification.
"""
