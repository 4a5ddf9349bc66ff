"""Friction: LuGre with a Stribeck curve, load inside it, warming by its own losses [armstrong1994, bittencourt2012]."""

from __future__ import annotations

import numpy as np

from gapscope.blind_check.generator.law import Draws, Law, LawValues, adds, puts, times


def _drift(draws: Draws) -> LawValues:
    speed = draws.speed
    friction = draws.coulomb + draws.viscous * speed
    return {
        "amplitude": draws.uniform(0.5, 1.0),
        "time_constant": np.full(
            len(speed), draws.rng.uniform(0.25, 0.7) * draws.shortest
        ),
        "share": draws.common(0.05, 0.15),
        "power": np.maximum(friction * speed, 1e-6),
    }


FRICTION = (
    Law(
        "coulomb_friction",
        lambda draws: {"torque": draws.coulomb * draws.uniform(0.8, 2.0)},
        adds(coulomb="torque"),
        times("torque"),
        {"torque": "N m"},
        form="LuGre: bristles bend before the joint slides",
    ),
    Law(
        "viscous_friction",
        lambda draws: {"coefficient": draws.viscous * draws.uniform(0.8, 3.0)},
        adds(viscous="coefficient"),
        times("coefficient"),
        {"coefficient": "N m s/rad"},
        form="b |v|^a sgn v with a in 0.94 .. 1",
    ),
    Law(
        "stribeck_friction",
        lambda draws: {
            "torque": draws.coulomb * draws.uniform(0.8, 2.0),
            "velocity": draws.speed * draws.uniform(0.15, 0.6),
            "power": draws.uniform(1.8, 2.2),
        },
        puts(fall="torque", fall_speed="velocity", fall_power="power"),
        times("torque"),
        {"torque": "N m", "velocity": "rad/s"},
        form="inside LuGre, exp(-(|v| / vs)^p) with p in 1.8 .. 2.2",
    ),
    Law(
        "saturating_friction",
        lambda draws: {
            "torque": draws.coulomb * draws.uniform(0.8, 2.0),
            "velocity": draws.speed * draws.uniform(0.3, 0.8),
            "power": draws.uniform(1.4, 3.0),
        },
        puts(level="torque", level_speed="velocity", level_power="power"),
        times("torque"),
        {"torque": "N m", "velocity": "rad/s"},
        form="d v / (|v|^p + w^p)^(1 / p) with p in 1.4 .. 3",
    ),
    Law(
        "load_friction",
        lambda draws: {"coefficient": draws.uniform(0.05, 0.15)},
        puts(load="coefficient"),
        times("coefficient"),
        {"coefficient": "1"},
        largest={"coefficient": 0.35},
        form="inside LuGre, on the torque behind the motor",
    ),
    Law(
        "friction_drift",
        _drift,
        puts(
            drift="amplitude",
            drift_time="time_constant",
            drift_share="share",
            drift_power="power",
        ),
        times("amplitude"),
        {"amplitude": "1", "time_constant": "s"},
        largest={"amplitude": 3.0},
        form="a joint that warms by its own losses, friction curved in temperature",
    ),
)
"""The laws of friction."""
