"""Transmission: two masses with a hardening spring, free play, cogging, a dress pack [deluca2016, tuttle1996]."""

from __future__ import annotations

import numpy as np

from gapscope.blind_check.generator.law import (
    Draws,
    Law,
    LawValues,
    powers,
    puts,
    times,
)
from gapscope.blind_check.generator.true_arm import TrueArm

TOOTH = 80.0
"""Resonance of the closed gear of a joint with free play [Hz]."""


def _two_masses(
    draws: Draws, frequency: np.ndarray | float
) -> tuple[np.ndarray, np.ndarray]:
    """Stiffness of a joint whose link swings at a frequency [Hz], and half of its critical damping."""
    link, rotor = draws.inertia, draws.armature
    stiffness = link * (2 * np.pi * frequency) ** 2
    # sqrt(k m), with the reduced mass of link and rotor
    return stiffness, np.sqrt(stiffness * link * rotor / (link + rotor))


def _elasticity(draws: Draws) -> LawValues:
    frequency = draws.uniform(6.0, 14.0)
    stiffness, half_critical = _two_masses(draws, frequency)
    ratio = draws.rng.uniform(0.04, 0.1)
    inverse_twist = stiffness / np.maximum(draws.peak, 1e-6)
    return {
        "stiffness": stiffness,
        "damping": 2 * ratio * half_critical,
        "hardening": draws.rng.uniform(0.02, 0.08) * inverse_twist**2,
        "frequency": frequency,
    }


def _backlash(draws: Draws) -> LawValues:
    stiffness, half_critical = _two_masses(draws, TOOTH)
    return {
        "width": np.radians(draws.uniform(0.3, 1.2)),
        "stiffness": stiffness,
        "damping": 2 * 0.2 * half_critical,
    }


def _loosen(plant: TrueArm, joints: np.ndarray, values: LawValues) -> None:
    plant.put("play", joints, 0.5 * values["width"])
    puts(stiffness="stiffness", damping="damping")(plant, joints, values)


def _spring(draws: Draws) -> LawValues:
    swing = np.maximum(draws.swing, 0.3)
    share = draws.uniform(0.2, 0.6)
    return {
        "stiffness": draws.deviation * share / swing,
        "rest": draws.middle + draws.uniform(-0.6, 0.6) * swing,
        "cubic": draws.sign() * draws.uniform(0.02, 0.06) / swing**2,
        "share": share,
    }


TRANSMISSION = (
    Law(
        "joint_elasticity",
        _elasticity,
        puts(stiffness="stiffness", damping="damping", hardening="hardening"),
        # a spring that yields that many times as far, with the same damping ratio
        powers(stiffness=-1, damping=-0.5, hardening=-2, frequency=-0.5),
        {"stiffness": "N m/rad", "damping": "N m s/rad"},
        joints="inner",
        largest={"frequency": -3.0},
        own=False,
        form="two masses, the spring hardens with its twist",
    ),
    Law(
        "backlash",
        _backlash,
        _loosen,
        times("width"),
        {"width": "rad"},
        joints="inner",
        largest={"width": 0.06},
        own=False,
        form="two masses, teeth of finite stiffness that meet with an impact",
    ),
    Law(
        "torque_ripple",
        lambda draws: {
            "amplitude": draws.deviation * draws.uniform(0.05, 0.15),
            "cycles": draws.rng.integers(4, 31, len(draws.joints)).astype(float),
            "phase": draws.uniform(-np.pi, np.pi),
            "harmonic": draws.common(0.02, 0.08),
        },
        puts(ripple="amplitude", cycles="cycles", phase="phase", harmonic="harmonic"),
        times("amplitude"),
        {"amplitude": "N m", "cycles": "1", "phase": "rad"},
        form="cogging with a second harmonic",
    ),
    Law(
        "parallel_spring",
        _spring,
        puts(spring="stiffness", rest="rest", cubic="cubic"),
        times("stiffness", "share"),
        {"stiffness": "N m/rad", "rest": "rad"},
        largest={"share": 4.0},
        form="slightly cubic",
    ),
)
"""The laws of the transmission."""
