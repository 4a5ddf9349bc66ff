"""Encoders and the outer world: offset with eccentricity, coarse steps, a push [haddadin2017]."""

from __future__ import annotations

import numpy as np

from gapscope.blind_check.generator.law import Law, LawContext, LawValues, sign, times
from gapscope.blind_check.generator.true_arm import TipForce, TrueArm


def _draw_offset(
    rng: np.random.Generator, context: LawContext, joints: np.ndarray
) -> LawValues:
    count = len(joints)
    return {
        "offset": sign(rng, count) * rng.uniform(0.015, 0.06, count),
        "eccentric": np.full(count, rng.uniform(0.0, 0.05)),
    }


def _apply_offset(plant: TrueArm, joints: np.ndarray, values: LawValues) -> None:
    plant.put("encoder", joints, values["offset"])
    plant.put("eccentric", joints, values["eccentric"])


def _draw_quantization(
    rng: np.random.Generator, context: LawContext, joints: np.ndarray
) -> LawValues:
    return {"step": np.full(len(joints), context.encoder_step * rng.uniform(3.0, 20.0))}


def _apply_quantization(plant: TrueArm, joints: np.ndarray, values: LawValues) -> None:
    plant.put("step", joints, values["step"])


def _draw_force(
    rng: np.random.Generator, context: LawContext, joints: np.ndarray
) -> LawValues:
    way = rng.standard_normal(3)
    lasts = rng.uniform(0.15, 0.4) * context.shortest
    start = rng.uniform(1.2, context.shortest - lasts - 1.2)
    return {
        # 10 N is a first guess; the sizing scales it
        "force": 10.0 * rng.uniform(0.5, 2.0) * way / np.linalg.norm(way),
        "start": np.array(start),
        "end": np.array(start + lasts),
        "ramp": np.array(rng.uniform(0.01, 0.04)),
    }


def _apply_force(plant: TrueArm, joints: np.ndarray, values: LawValues) -> None:
    force = values["force"]
    start, end, ramp = (float(values[name]) for name in ("start", "end", "ramp"))

    def pushed(t: float, place: np.ndarray, speed: np.ndarray) -> np.ndarray:
        """A force that grows and fades smoothly; start and end are where it is half of its size."""
        begun, over = np.tanh((t - start) / ramp), np.tanh((t - end) / ramp)
        return force * 0.5 * (begun - over)

    push: TipForce = pushed
    plant.push = push


SENSING = (
    Law(
        "encoder_offset",
        _draw_offset,
        _apply_offset,
        times("offset"),
        {"offset": "rad"},
        joints="middle",
        largest={"offset": 0.2},
        own=False,
        form="with eccentricity, delta (1 + e sin q)",
    ),
    Law(
        "encoder_quantization",
        _draw_quantization,
        _apply_quantization,
        times("step"),
        {"step": "rad"},
        largest={"step": 0.02},
        own=False,
        measure="step",
        form="noise comes before the rounding, the controller sees it too",
    ),
    Law(
        "external_force",
        _draw_force,
        _apply_force,
        times("force"),
        {"force": "N", "start": "s", "end": "s"},
        joints="arm",
        largest={"force": 300.0},
        own=False,
        form="grows and fades smoothly, on MuJoCo's body",
    ),
)
"""The laws of sensing and of the outer world."""
