"""Encoders and the outer world: offset with eccentricity, coarse steps, a push [haddadin2017]."""

from __future__ import annotations

import numpy as np

from gapscope.blind_check.generator.law import Law, LawContext, LawValues, sign, times
from gapscope.blind_check.generator.plant import Outer, TrueArm


def _offset(
    rng: np.random.Generator, scene: LawContext, joints: np.ndarray
) -> LawValues:
    count = len(joints)
    return {
        "offset": sign(rng, count) * rng.uniform(0.015, 0.06, count),
        "eccentric": np.full(count, rng.uniform(0.0, 0.05)),
    }


def _misread(plant: TrueArm, joints: np.ndarray, values: LawValues) -> None:
    plant.put("encoder", joints, values["offset"])
    plant.put("eccentric", joints, values["eccentric"])


def _coarse(
    rng: np.random.Generator, scene: LawContext, joints: np.ndarray
) -> LawValues:
    return {"step": np.full(len(joints), scene.encoder_step * rng.uniform(3.0, 20.0))}


def _round(plant: TrueArm, joints: np.ndarray, values: LawValues) -> None:
    plant.put("step", joints, values["step"])


def _force(
    rng: np.random.Generator, scene: LawContext, joints: np.ndarray
) -> LawValues:
    way = rng.standard_normal(3)
    lasts = rng.uniform(0.15, 0.4) * scene.shortest
    start = rng.uniform(1.2, scene.shortest - lasts - 1.2)
    return {
        "force": 10.0 * rng.uniform(0.5, 2.0) * way / np.linalg.norm(way),
        "start": np.array(start),
        "end": np.array(start + lasts),
        "ramp": np.array(rng.uniform(0.01, 0.04)),
    }


def _push(plant: TrueArm, joints: np.ndarray, values: LawValues) -> None:
    force = values["force"]
    start, end, ramp = (float(values[name]) for name in ("start", "end", "ramp"))

    def pushed(t: float, place: np.ndarray, speed: np.ndarray) -> np.ndarray:
        """A force that grows and fades smoothly; start and end are where it is half of its size."""
        return force * 0.5 * (np.tanh((t - start) / ramp) - np.tanh((t - end) / ramp))

    outer: Outer = pushed
    plant.push = outer


SENSING = (
    Law(
        "encoder_offset",
        _offset,
        _misread,
        times("offset"),
        {"offset": "rad"},
        joints="middle",
        largest={"offset": 0.2},
        own=False,
        form="with eccentricity, delta (1 + e sin q)",
    ),
    Law(
        "encoder_quantization",
        _coarse,
        _round,
        times("step"),
        {"step": "rad"},
        largest={"step": 0.02},
        own=False,
        measure="step",
        form="noise comes before the rounding, the controller sees it too",
    ),
    Law(
        "external_force",
        _force,
        _push,
        times("force"),
        {"force": "N", "start": "s", "end": "s"},
        joints="arm",
        largest={"force": 300.0},
        own=False,
        form="grows and fades smoothly, on MuJoCo's body",
    ),
)
"""The laws of sensing and of the outer world."""
