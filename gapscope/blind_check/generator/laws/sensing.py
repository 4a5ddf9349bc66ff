"""Encoders and the outer world: offset with eccentricity, coarse steps, a push [haddadin2017]."""

from __future__ import annotations

import numpy as np

from gapscope.blind_check.generator.law import Draws, Law, LawValues, puts, times
from gapscope.blind_check.generator.true_arm import TrueArm


def _force(draws: Draws) -> LawValues:
    rng, shortest = draws.rng, draws.shortest
    way = rng.standard_normal(3)
    lasts = rng.uniform(0.15, 0.4) * shortest
    start = rng.uniform(1.2, shortest - lasts - 1.2)
    return {
        # 10 N is a first guess; the sizing scales it
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
        begun, over = np.tanh((t - start) / ramp), np.tanh((t - end) / ramp)
        return force * 0.5 * (begun - over)

    plant.push = pushed


SENSING = (
    Law(
        "encoder_offset",
        lambda draws: {
            "offset": draws.sign() * draws.uniform(0.015, 0.06),
            "eccentric": draws.common(0.0, 0.05),
        },
        puts(encoder="offset", eccentric="eccentric"),
        times("offset"),
        {"offset": "rad"},
        joints="middle",
        largest={"offset": 0.2},
        own=False,
        form="with eccentricity, delta (1 + e sin q)",
    ),
    Law(
        "encoder_quantization",
        lambda draws: {"step": draws.encoder_step * draws.common(3.0, 20.0)},
        puts(step="step"),
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
