"""Friction: LuGre with a Stribeck curve, load inside it, warming by its own losses [armstrong1994, bittencourt2012]."""

from __future__ import annotations

import numpy as np

from gapscope.blind_check.generator.law import Law, LawContext, LawValues, times
from gapscope.blind_check.generator.true_arm import TrueArm


def _draw_coulomb(
    rng: np.random.Generator, context: LawContext, joints: np.ndarray
) -> LawValues:
    return {"torque": context.arm.coulomb[joints] * rng.uniform(0.8, 2.0, len(joints))}


def _apply_coulomb(plant: TrueArm, joints: np.ndarray, values: LawValues) -> None:
    plant.add("coulomb", joints, values["torque"])


def _draw_viscous(
    rng: np.random.Generator, context: LawContext, joints: np.ndarray
) -> LawValues:
    return {
        "coefficient": context.arm.viscous[joints] * rng.uniform(0.8, 3.0, len(joints))
    }


def _apply_viscous(plant: TrueArm, joints: np.ndarray, values: LawValues) -> None:
    plant.add("viscous", joints, values["coefficient"])


def _draw_stribeck(
    rng: np.random.Generator, context: LawContext, joints: np.ndarray
) -> LawValues:
    count = len(joints)
    return {
        "torque": context.arm.coulomb[joints] * rng.uniform(0.8, 2.0, count),
        "velocity": context.speed[joints] * rng.uniform(0.15, 0.6, count),
        "power": rng.uniform(1.8, 2.2, count),
    }


def _apply_stribeck(plant: TrueArm, joints: np.ndarray, values: LawValues) -> None:
    plant.add("fall", joints, values["torque"])
    plant.put("fall_speed", joints, values["velocity"])
    plant.put("fall_power", joints, values["power"])


def _draw_saturating(
    rng: np.random.Generator, context: LawContext, joints: np.ndarray
) -> LawValues:
    count = len(joints)
    return {
        "torque": context.arm.coulomb[joints] * rng.uniform(0.8, 2.0, count),
        "velocity": context.speed[joints] * rng.uniform(0.3, 0.8, count),
        "power": rng.uniform(1.4, 3.0, count),
    }


def _apply_saturating(plant: TrueArm, joints: np.ndarray, values: LawValues) -> None:
    plant.put("level", joints, values["torque"])
    plant.put("level_speed", joints, values["velocity"])
    plant.put("level_power", joints, values["power"])


def _draw_load(
    rng: np.random.Generator, context: LawContext, joints: np.ndarray
) -> LawValues:
    return {"coefficient": rng.uniform(0.05, 0.15, len(joints))}


def _apply_load(plant: TrueArm, joints: np.ndarray, values: LawValues) -> None:
    plant.add("load", joints, values["coefficient"])


def _draw_drift(
    rng: np.random.Generator, context: LawContext, joints: np.ndarray
) -> LawValues:
    count = len(joints)
    arm, speed = context.arm, context.speed
    friction = arm.coulomb + arm.viscous * speed
    power = friction[joints] * speed[joints]
    return {
        "amplitude": rng.uniform(0.5, 1.0, count),
        "time_constant": np.full(count, rng.uniform(0.25, 0.7) * context.shortest),
        "share": np.full(count, rng.uniform(0.05, 0.15)),
        "power": np.maximum(power, 1e-6),
    }


def _apply_drift(plant: TrueArm, joints: np.ndarray, values: LawValues) -> None:
    plant.put("drift", joints, values["amplitude"])
    plant.put("drift_time", joints, values["time_constant"])
    plant.put("drift_share", joints, values["share"])
    plant.put("drift_power", joints, values["power"])


FRICTION = (
    Law(
        "coulomb_friction",
        _draw_coulomb,
        _apply_coulomb,
        times("torque"),
        {"torque": "N m"},
        form="LuGre: bristles bend before the joint slides",
    ),
    Law(
        "viscous_friction",
        _draw_viscous,
        _apply_viscous,
        times("coefficient"),
        {"coefficient": "N m s/rad"},
        form="b |v|^a sgn v with a in 0.94 .. 1",
    ),
    Law(
        "stribeck_friction",
        _draw_stribeck,
        _apply_stribeck,
        times("torque"),
        {"torque": "N m", "velocity": "rad/s"},
        form="inside LuGre, exp(-(|v| / vs)^p) with p in 1.8 .. 2.2",
    ),
    Law(
        "saturating_friction",
        _draw_saturating,
        _apply_saturating,
        times("torque"),
        {"torque": "N m", "velocity": "rad/s"},
        form="d v / (|v|^p + w^p)^(1 / p) with p in 1.4 .. 3",
    ),
    Law(
        "load_friction",
        _draw_load,
        _apply_load,
        times("coefficient"),
        {"coefficient": "1"},
        largest={"coefficient": 0.35},
        form="inside LuGre, on the torque behind the motor",
    ),
    Law(
        "friction_drift",
        _draw_drift,
        _apply_drift,
        times("amplitude"),
        {"amplitude": "1", "time_constant": "s"},
        largest={"amplitude": 3.0},
        form="a joint that warms by its own losses, friction curved in temperature",
    ),
)
"""The laws of friction."""
