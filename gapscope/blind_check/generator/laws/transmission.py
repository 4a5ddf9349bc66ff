"""Transmission: two masses with a hardening spring, free play, cogging, a dress pack [deluca2016, tuttle1996]."""

from __future__ import annotations

import numpy as np

from gapscope.blind_check.generator.law import Law, LawContext, LawValues, sign, times
from gapscope.blind_check.generator.true_arm import TrueArm

TOOTH = 80.0
"""Resonance of the closed gear of a joint with free play [Hz]."""


def _draw_elasticity(
    rng: np.random.Generator, context: LawContext, joints: np.ndarray
) -> LawValues:
    frequency = rng.uniform(6.0, 14.0, len(joints))
    link, rotor = context.inertia[joints], context.arm.armature[joints]
    stiffness = link * (2 * np.pi * frequency) ** 2
    ratio = rng.uniform(0.04, 0.1)
    # half of the critical damping: sqrt(k m), with the reduced mass of link and rotor
    half_critical = np.sqrt(stiffness * link * rotor / (link + rotor))
    inverse_twist = stiffness / np.maximum(context.peak[joints], 1e-6)
    return {
        "stiffness": stiffness,
        "damping": 2 * ratio * half_critical,
        "hardening": rng.uniform(0.02, 0.08) * inverse_twist**2,
        "frequency": frequency,
    }


def _softer(values: LawValues, factor: np.ndarray) -> LawValues:
    """A spring that yields ``factor`` times as far, with the same damping ratio."""
    return {
        "stiffness": values["stiffness"] / factor,
        "damping": values["damping"] / np.sqrt(factor),
        "hardening": values["hardening"] / factor**2,
        "frequency": values["frequency"] / np.sqrt(factor),
    }


def _apply_elasticity(plant: TrueArm, joints: np.ndarray, values: LawValues) -> None:
    for name in ("stiffness", "damping", "hardening"):
        plant.put(name, joints, values[name])


def _draw_backlash(
    rng: np.random.Generator, context: LawContext, joints: np.ndarray
) -> LawValues:
    link, rotor = context.inertia[joints], context.arm.armature[joints]
    stiffness = link * (2 * np.pi * TOOTH) ** 2
    half_critical = np.sqrt(stiffness * link * rotor / (link + rotor))
    return {
        "width": np.radians(rng.uniform(0.3, 1.2, len(joints))),
        "stiffness": stiffness,
        "damping": 2 * 0.2 * half_critical,
    }


def _apply_backlash(plant: TrueArm, joints: np.ndarray, values: LawValues) -> None:
    plant.put("play", joints, 0.5 * values["width"])
    plant.put("stiffness", joints, values["stiffness"])
    plant.put("damping", joints, values["damping"])


def _draw_ripple(
    rng: np.random.Generator, context: LawContext, joints: np.ndarray
) -> LawValues:
    count = len(joints)
    return {
        "amplitude": context.deviation[joints] * rng.uniform(0.05, 0.15, count),
        "cycles": rng.integers(4, 31, count).astype(float),
        "phase": rng.uniform(-np.pi, np.pi, count),
        "harmonic": np.full(count, rng.uniform(0.02, 0.08)),
    }


def _apply_ripple(plant: TrueArm, joints: np.ndarray, values: LawValues) -> None:
    for name, value in (
        ("ripple", "amplitude"),
        ("cycles", "cycles"),
        ("phase", "phase"),
        ("harmonic", "harmonic"),
    ):
        plant.put(name, joints, values[value])


def _draw_spring(
    rng: np.random.Generator, context: LawContext, joints: np.ndarray
) -> LawValues:
    count = len(joints)
    swing = np.maximum(context.swing[joints], 0.3)
    share = rng.uniform(0.2, 0.6, count)
    return {
        "stiffness": context.deviation[joints] * share / swing,
        "rest": context.middle[joints] + rng.uniform(-0.6, 0.6, count) * swing,
        "cubic": sign(rng, count) * rng.uniform(0.02, 0.06, count) / swing**2,
        "share": share,
    }


def _apply_spring(plant: TrueArm, joints: np.ndarray, values: LawValues) -> None:
    for name, value in (("spring", "stiffness"), ("rest", "rest"), ("cubic", "cubic")):
        plant.put(name, joints, values[value])


TRANSMISSION = (
    Law(
        "joint_elasticity",
        _draw_elasticity,
        _apply_elasticity,
        _softer,
        {"stiffness": "N m/rad", "damping": "N m s/rad"},
        joints="inner",
        largest={"frequency": -3.0},
        own=False,
        form="two masses, the spring hardens with its twist",
    ),
    Law(
        "backlash",
        _draw_backlash,
        _apply_backlash,
        times("width"),
        {"width": "rad"},
        joints="inner",
        largest={"width": 0.06},
        own=False,
        form="two masses, teeth of finite stiffness that meet with an impact",
    ),
    Law(
        "torque_ripple",
        _draw_ripple,
        _apply_ripple,
        times("amplitude"),
        {"amplitude": "N m", "cycles": "1", "phase": "rad"},
        form="cogging with a second harmonic",
    ),
    Law(
        "parallel_spring",
        _draw_spring,
        _apply_spring,
        times("stiffness", "share"),
        {"stiffness": "N m/rad", "rest": "rad"},
        largest={"share": 4.0},
        form="slightly cubic",
    ),
)
"""The laws of the transmission."""
