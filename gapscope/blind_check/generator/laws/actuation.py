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
from gapscope.blind_check.generator.plant import TrueArm


def _scale(
    rng: np.random.Generator, scene: LawContext, joints: np.ndarray
) -> LawValues:
    count = len(joints)
    return {
        "scale": sign(rng, count) * rng.uniform(0.07, 0.2, count),
        "iron": rng.uniform(0.0, 0.03, count),
        "peak": 1.5 * scene.peak[joints],
    }


def _rescale(plant: TrueArm, joints: np.ndarray, values: LawValues) -> None:
    plant.add("scale", joints, values["scale"])
    plant.put("iron", joints, values["iron"])
    plant.put("peak", joints, values["peak"])


def _offset(
    rng: np.random.Generator, scene: LawContext, joints: np.ndarray
) -> LawValues:
    count = len(joints)
    return {
        "torque": sign(rng, count)
        * rng.uniform(0.05, 0.3, count)
        * scene.deviation[joints]
    }


def _bias(plant: TrueArm, joints: np.ndarray, values: LawValues) -> None:
    plant.add("offset", joints, values["torque"])


def _clamp(
    rng: np.random.Generator, scene: LawContext, joints: np.ndarray
) -> LawValues:
    share = rng.uniform(0.65, 0.85, len(joints))
    return {
        "limit": share * scene.peak[joints],
        "slope": np.full(len(joints), rng.uniform(0.0, 0.03)),
        "share": share,
    }


def _clip(plant: TrueArm, joints: np.ndarray, values: LawValues) -> None:
    plant.put("clamp", joints, values["limit"])
    plant.put("clamp_slope", joints, values["slope"])


def _lag(rng: np.random.Generator, scene: LawContext, joints: np.ndarray) -> LawValues:
    return {
        "time_constant": rng.uniform(0.003, 0.01, len(joints)),
        "second": np.full(len(joints), float(rng.integers(0, 2))),
    }


def _slow(plant: TrueArm, joints: np.ndarray, values: LawValues) -> None:
    plant.put("lag", joints, values["time_constant"])
    plant.put("second", joints, values["second"])


def _delay(
    rng: np.random.Generator, scene: LawContext, joints: np.ndarray
) -> LawValues:
    return {"delay": rng.uniform(0.003, 0.009, len(joints))}


def _late(plant: TrueArm, joints: np.ndarray, values: LawValues) -> None:
    plant.add("delay", joints, values["delay"])


ACTUATION = (
    Law(
        "torque_scale",
        _scale,
        _rescale,
        times("scale"),
        {"scale": "1"},
        largest={"scale": 0.45},
        form="the torque constant falls a little with current",
    ),
    Law(
        "torque_offset",
        _offset,
        _bias,
        times("torque"),
        {"torque": "N m"},
        form="a bias of the current sensor",
    ),
    Law(
        "torque_saturation",
        _clamp,
        _clip,
        over("limit", "share"),
        {"limit": "N m"},
        largest={"share": -0.4},
        form="a clamp that falls with speed (back-EMF)",
    ),
    Law(
        "actuator_lag",
        _lag,
        _slow,
        times("time_constant"),
        {"time_constant": "s"},
        largest={"time_constant": 0.025},
        form="a current loop of first order, or of second with two equal poles",
    ),
    Law(
        "actuator_delay",
        _delay,
        _late,
        times("delay"),
        {"delay": "s"},
        largest={"delay": 0.025},
        form="a dead time in whole steps of the drive",
    ),
)
"""The laws of the motor."""
