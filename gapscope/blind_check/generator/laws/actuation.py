"""The motor: torque constant, bias, current clamp, dead time, current loop [gautier2014, hwangbo2019]."""

from __future__ import annotations

import numpy as np

from gapscope.blind_check.generator.law import (
    Law,
    LawContext,
    LawValues,
    over,
    sign,
    times,
)
from gapscope.blind_check.generator.true_arm import TrueArm


def _draw_scale(
    rng: np.random.Generator, context: LawContext, joints: np.ndarray
) -> LawValues:
    count = len(joints)
    return {
        "scale": sign(rng, count) * rng.uniform(0.07, 0.2, count),
        "iron": rng.uniform(0.0, 0.03, count),
        "peak": 1.5 * context.peak[joints],
    }


def _apply_scale(plant: TrueArm, joints: np.ndarray, values: LawValues) -> None:
    plant.add("scale", joints, values["scale"])
    plant.put("iron", joints, values["iron"])
    plant.put("peak", joints, values["peak"])


def _draw_offset(
    rng: np.random.Generator, context: LawContext, joints: np.ndarray
) -> LawValues:
    count = len(joints)
    return {
        "torque": sign(rng, count)
        * rng.uniform(0.05, 0.3, count)
        * context.deviation[joints]
    }


def _apply_offset(plant: TrueArm, joints: np.ndarray, values: LawValues) -> None:
    plant.add("offset", joints, values["torque"])


def _draw_saturation(
    rng: np.random.Generator, context: LawContext, joints: np.ndarray
) -> LawValues:
    share = rng.uniform(0.65, 0.85, len(joints))
    return {
        "limit": share * context.peak[joints],
        "slope": np.full(len(joints), rng.uniform(0.0, 0.03)),
        "share": share,
    }


def _apply_saturation(plant: TrueArm, joints: np.ndarray, values: LawValues) -> None:
    plant.put("clamp", joints, values["limit"])
    plant.put("clamp_slope", joints, values["slope"])


def _draw_lag(
    rng: np.random.Generator, context: LawContext, joints: np.ndarray
) -> LawValues:
    return {
        "time_constant": rng.uniform(0.003, 0.01, len(joints)),
        "second": np.full(len(joints), float(rng.integers(0, 2))),
    }


def _apply_lag(plant: TrueArm, joints: np.ndarray, values: LawValues) -> None:
    plant.put("lag", joints, values["time_constant"])
    plant.put("second", joints, values["second"])


def _draw_delay(
    rng: np.random.Generator, context: LawContext, joints: np.ndarray
) -> LawValues:
    return {"delay": rng.uniform(0.003, 0.009, len(joints))}


def _apply_delay(plant: TrueArm, joints: np.ndarray, values: LawValues) -> None:
    plant.add("delay", joints, values["delay"])


ACTUATION = (
    Law(
        "torque_scale",
        _draw_scale,
        _apply_scale,
        times("scale"),
        {"scale": "1"},
        largest={"scale": 0.45},
        form="the torque constant falls a little with current",
    ),
    Law(
        "torque_offset",
        _draw_offset,
        _apply_offset,
        times("torque"),
        {"torque": "N m"},
        form="a bias of the current sensor",
    ),
    Law(
        "torque_saturation",
        _draw_saturation,
        _apply_saturation,
        over("limit", "share"),
        {"limit": "N m"},
        largest={"share": -0.4},
        form="a clamp that falls with speed (back-EMF)",
    ),
    Law(
        "actuator_lag",
        _draw_lag,
        _apply_lag,
        times("time_constant"),
        {"time_constant": "s"},
        largest={"time_constant": 0.025},
        form="a current loop of first order, or of second with two equal poles",
    ),
    Law(
        "actuator_delay",
        _draw_delay,
        _apply_delay,
        times("delay"),
        {"delay": "s"},
        largest={"delay": 0.025},
        form="a dead time in whole steps of the drive",
    ),
)
"""The laws of the motor."""
