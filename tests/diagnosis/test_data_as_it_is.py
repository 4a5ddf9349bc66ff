"""Damaged torques cost no right finding and no healthy verdict; `experiments/52_data_as_it_is.py` has more."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import synthetic
from sweeps import daily
from synthetic import Truth

from gapscope.arm.case import Case
from gapscope.diagnosis.diagnose import diagnose


def damaged(truth: Truth, damage: Callable[[np.ndarray], np.ndarray]) -> Case:
    """Two recordings of an arm, their torque damaged."""
    sound = synthetic.case(truth, seed=3, duration=6.0)
    recordings = tuple(
        replace(r, tau=damage(r.tau.copy())) for r in sound.recordings[1:]
    )
    return replace(sound, recordings=recordings)


def clipped(tau: np.ndarray) -> np.ndarray:
    most = 0.7 * np.abs(tau).max(axis=0)
    return np.clip(tau, -most, most)


def stuck(tau: np.ndarray) -> np.ndarray:
    tau[400:700, 1] = tau[400, 1]
    return tau


def coarse(tau: np.ndarray) -> np.ndarray:
    step = 0.03 * np.ptp(tau, axis=0)
    return step * np.round(tau / step)


@pytest.mark.parametrize("damage", daily((clipped, stuck, coarse), clipped))
def test_a_healthy_arm_stays_healthy(
    damage: Callable[[np.ndarray], np.ndarray],
) -> None:
    document = diagnose(damaged(Truth(), damage)).document
    assert document["verdict"] == "no_gap"
    assert document["effects"] == []


@pytest.mark.parametrize("damage", daily((clipped, stuck), stuck))
def test_an_effect_is_found_on_the_other_rows(
    damage: Callable[[np.ndarray], np.ndarray],
) -> None:
    case = damaged(Truth(viscous=(0.0, 3.0, 0.0)), damage)
    (found,) = diagnose(case).document["effects"]
    assert (found["effect"], found["joints"]) == ("viscous_friction", [2])
    value, std = (found["parameters"]["coefficient"][key] for key in ("value", "std"))
    assert value[0] == pytest.approx(3.0, abs=4 * std[0])
