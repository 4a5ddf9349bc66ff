"""Quantisation of the encoders, read from the positions themselves.

Noise before rounding leaves every position on a lattice, q = o + k s with whole k. The smallest distances between
distinct values give a first step s; the share of values that lie on the lattice tells whether there is one; a line
through values against k gives the step with its standard deviation.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from gapscope.arm.case import Case
from gapscope.arm.recording import Recording
from gapscope.diagnosis.setup_faults.found_fault import FoundFault, Quantity
from gapscope.diagnosis.thresholds import (
    LATTICE_COHERENCE,
    LATTICE_LEVELS,
    LATTICE_SAMPLES,
    LOG_DIGITS,
    STEP_OVER_DATA_SHEET,
    STEP_WITHOUT_DATA_SHEET,
)


def find_quantization(case: Case) -> tuple[FoundFault, ...]:
    """``encoder_quantization`` on the joints whose step exceeds the data sheet's, as one finding; or nothing."""
    sheet = case.arm.encoder_step
    least = STEP_WITHOUT_DATA_SHEET if sheet is None else STEP_OVER_DATA_SHEET * sheet
    found = {}
    for joint in range(case.arm.n_joints):
        step = encoder_step((*case.recordings, *case.judged), joint)
        if step is not None and step[0] > least:
            found[joint + 1] = step
    if not found:
        return ()
    values, stds = (tuple(float(s[k]) for s in found.values()) for k in (0, 1))
    return (
        FoundFault(
            "encoder_quantization",
            tuple(found),
            "",
            {"step": Quantity("rad", values, stds)},
            0.99,
        ),
    )


def encoder_step(
    recordings: Iterable[Recording], joint: int
) -> tuple[float, float] | None:
    """Quantisation step of a joint, from 0, and its standard deviation [rad]; ``None`` where q lies on no lattice.

    Recordings have to agree; those in which the joint hardly moves do not count.
    """
    steps = [
        s
        for r in recordings
        if (s := lattice(r.q[:LATTICE_SAMPLES, joint])) is not None
    ]
    if not steps:
        return None
    values, stds = np.array(steps).T
    step = float(np.median(values))
    if np.abs(values / step - 1).max() > 0.1:
        agreeing = np.abs(values / step - 1) < 0.1
        if agreeing.mean() <= 0.5:
            return None
        values, stds = values[agreeing], stds[agreeing]
    weights = 1.0 / stds**2
    return float((weights * values).sum() / weights.sum()), float(weights.sum() ** -0.5)


def lattice(q: np.ndarray) -> tuple[float, float] | None:
    """Step of the lattice on which positions q [rad], (N,), lie, and its standard deviation; ``None`` for none."""
    resolution = 10.0 ** (
        np.floor(np.log10(max(float(np.abs(q).max()), 1e-9))) - LOG_DIGITS
    )
    values = np.unique(q)
    distances = np.diff(values)
    distances = np.sort(distances[distances > 3 * resolution])
    if len(distances) < LATTICE_LEVELS:
        return None
    for candidate in _first_steps(distances, resolution):
        step = _sharpened(q, candidate)
        if step is not None:
            return step
    return None


def _first_steps(distances: np.ndarray, resolution: float) -> list[float]:
    """Guesses of the step from sorted distances of neighbouring values: the mean of the smallest that are alike."""
    guesses: list[float] = []
    for smallest in (
        distances[0],
        float(np.quantile(distances, 0.02)),
        float(np.median(distances)),
    ):
        alike = distances[
            np.abs(distances - smallest) < max(0.1 * smallest, 2 * resolution)
        ]
        if not len(alike):
            continue
        guess = float(alike.mean())
        if not any(abs(guess / g - 1) < 0.02 for g in guesses):
            guesses.append(guess)
    return guesses


def _sharpened(q: np.ndarray, step: float) -> tuple[float, float] | None:
    """The step refined over wider and wider stretches of positions, with its standard deviation."""
    centre = float(np.median(q))
    offset = q - q[np.argmin(np.abs(q - centre))]
    travel = float(np.abs(offset).max())
    reach = 8 * step
    while True:
        near = offset[np.abs(offset) <= reach]
        count = np.round(near / step)
        if np.ptp(count) >= 1:
            slope = np.polyfit(count, near, 1)[0]
            if not 0.8 < slope / step < 1.25:
                return None
            step = float(slope)
        if reach >= travel:
            break
        reach *= 2
    phase = np.exp(2j * np.pi * offset / step)
    levels = len(np.unique(np.round(offset / step)))
    if np.abs(phase.mean()) < LATTICE_COHERENCE or levels < LATTICE_LEVELS:
        return None
    count = np.round(offset / step)
    slope, start = np.polyfit(count, offset, 1)
    off = offset - start - slope * count
    return float(slope), float(max(off.std() / (count.std() * np.sqrt(len(q))), 1e-12))
