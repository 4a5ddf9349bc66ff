"""The motor: torque constant, bias, current clamp, dead time, current loop [gautier2014, hwangbo2019]."""

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


def _saturation(draws: Draws) -> LawValues:
    share = draws.uniform(0.65, 0.85)
    slope = draws.common(0.0, 0.03)
    return {"limit": share * draws.peak, "slope": slope, "share": share}


ACTUATION = (
    Law(
        "torque_scale",
        lambda draws: {
            "scale": draws.sign() * draws.uniform(0.07, 0.2),
            "iron": draws.uniform(0.0, 0.03),
            "peak": 1.5 * draws.peak,
        },
        puts(scale="scale", iron="iron", peak="peak"),
        times("scale"),
        {"scale": "1"},
        largest={"scale": 0.45},
        form="the torque constant falls a little with current",
    ),
    Law(
        "torque_offset",
        lambda draws: {
            "torque": draws.sign() * draws.uniform(0.05, 0.3) * draws.deviation
        },
        puts(offset="torque"),
        times("torque"),
        {"torque": "N m"},
        form="a bias of the current sensor",
    ),
    Law(
        "torque_saturation",
        _saturation,
        puts(clamp="limit", clamp_slope="slope"),
        powers(limit=-1, share=-1),
        {"limit": "N m"},
        largest={"share": -0.4},
        form="a clamp that falls with speed (back-EMF)",
    ),
    Law(
        "actuator_lag",
        lambda draws: {
            "time_constant": draws.uniform(0.003, 0.01),
            "second": np.full(len(draws.joints), float(draws.rng.integers(0, 2))),
        },
        puts(lag="time_constant", second="second"),
        times("time_constant"),
        {"time_constant": "s"},
        largest={"time_constant": 0.025},
        form="a current loop of first order, or of second with two equal poles",
    ),
    Law(
        "actuator_delay",
        lambda draws: {"delay": draws.uniform(0.003, 0.009)},
        puts(delay="delay"),
        times("delay"),
        {"delay": "s"},
        largest={"delay": 0.025},
        form="a dead time in whole steps of the drive",
    ),
)
"""The laws of the motor."""
