"""Quantisation of the encoders, read from the positions themselves.

Noise before rounding leaves every position on a lattice, q = o + k s with whole k. The smallest distances between
distinct values give a first step s; the share of values on the lattice decides whether there is one; a line
through values against k gives the step with its standard deviation.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from gapscope.arm.case import Case
from gapscope.arm.recording import Recording
from gapscope.diagnosis.setup_faults.found_fault import FoundFault
from gapscope.diagnosis.thresholds import (
    LATTICE_AGREEMENT,
    LATTICE_COHERENCE,
    LATTICE_LEVELS,
    LATTICE_SAMPLES,
    LOG_DIGITS,
    OBVIOUS_FAULT_PROBABILITY,
    STEP_OVER_DATA_SHEET,
    STEP_WITHOUT_DATA_SHEET,
)
from gapscope.effects.catalogue import of_quantity
from gapscope.effects.setup_faults.fault import Fault

QUANTISATION, _ = of_quantity("resolution")


@dataclass(frozen=True)
class Quantisation(Fault):
    """No fault but an effect: it shows in the recordings themselves, and no reading brings back what was rounded.

    Attributes:
        joints: from 1.
        step: of each [rad].
    """

    name = QUANTISATION.name
    parameters = QUANTISATION.parameters
    joints: tuple[int, ...]
    step: tuple[float, ...]


def find_quantization(case: Case) -> tuple[FoundFault, ...]:
    """Quantisation on the joints whose step exceeds the data sheet's, as one finding; or none."""
    sheet = case.arm.encoder_step
    least = STEP_WITHOUT_DATA_SHEET * case.arm.per_radian
    if sheet is not None:
        least = np.full(case.arm.n_joints, STEP_OVER_DATA_SHEET * sheet)
    recordings = (*case.recordings, *case.judged)
    found = {}
    for joint in range(case.arm.n_joints):
        step = encoder_step(recordings, joint)
        if step is not None and step[0] > least[joint]:
            found[joint + 1] = step
    if not found:
        return ()
    steps, stds = zip(*found.values(), strict=True)
    quantisation = Quantisation(tuple(found), steps)
    return (FoundFault(quantisation, OBVIOUS_FAULT_PROBABILITY, {"step": stds}),)


def encoder_step(
    recordings: Iterable[Recording], joint: int
) -> tuple[float, float] | None:
    """Quantisation step of a joint, from 0, and its standard deviation [rad]; ``None`` if q lies on no lattice.

    Recordings have to agree; those in which the joint hardly moves do not count.
    """
    found = [lattice(r.q[:LATTICE_SAMPLES, joint]) for r in recordings]
    steps = [step for step in found if step is not None]
    if not steps:
        return None
    values, stds = np.array(steps).T
    agree = np.abs(values / float(np.median(values)) - 1) <= LATTICE_AGREEMENT
    # without a majority the lattices are chance
    if agree.mean() <= 0.5:
        return None
    weights = 1.0 / stds[agree] ** 2
    mean = (weights * values[agree]).sum() / weights.sum()
    return float(mean), float(weights.sum() ** -0.5)


def lattice(q: np.ndarray) -> tuple[float, float] | None:
    """Step of the lattice on which positions q [rad], (N,), lie, and its standard deviation; ``None`` for none."""
    largest = max(float(np.abs(q).max()), 1e-9)
    resolution = 10.0 ** (np.floor(np.log10(largest)) - LOG_DIGITS)
    distances = np.diff(np.unique(q))
    distances = np.sort(distances[distances > 3 * resolution])
    if len(distances) < LATTICE_LEVELS:
        return None
    for guess in _first_steps(distances, resolution):
        step = _sharpened(q, guess)
        if step is not None:
            return step
    return None


def _first_steps(distances: np.ndarray, resolution: float) -> list[float]:
    """Guesses of the step from sorted distances of neighbouring values: the mean of the smallest that are alike."""
    quantile, median = float(np.quantile(distances, 0.02)), float(np.median(distances))
    guesses: list[float] = []
    for smallest in (distances[0], quantile, median):
        width = max(0.1 * smallest, 2 * resolution)
        alike = distances[np.abs(distances - smallest) < width]
        if not len(alike):
            continue
        guess = float(alike.mean())
        is_new = all(abs(guess / other - 1) >= 0.02 for other in guesses)
        if is_new:
            guesses.append(guess)
    return guesses


def _sharpened(q: np.ndarray, step: float) -> tuple[float, float] | None:
    """The step refined over wider and wider stretches of positions, with its standard deviation.

    ``None`` if the positions do not lie on the refined lattice.
    """
    centre = float(np.median(q))
    offset = q - q[np.argmin(np.abs(q - centre))]
    travel = float(np.abs(offset).max())
    reach = 8 * step  # near the centre even a rough step counts the levels rightly
    while True:
        near = offset[np.abs(offset) <= reach]
        count = np.round(near / step)
        if np.ptp(count) >= 1:
            slope = _line(count, near)[0]
            if not 0.8 < slope / step < 1.25:
                return None
            step = slope
        if reach >= travel:
            break
        reach *= 2
    return _line_through_levels(offset, step)


def _line_through_levels(offset: np.ndarray, step: float) -> tuple[float, float] | None:
    """Slope of positions against the numbers of their levels, and its standard deviation; ``None`` off the lattice."""
    phase = np.exp(2j * np.pi * offset / step)
    count = np.round(offset / step)
    if (
        np.abs(phase.mean()) < LATTICE_COHERENCE
        or len(np.unique(count)) < LATTICE_LEVELS
    ):
        return None
    slope, start = _line(count, offset)
    residual = offset - start - slope * count
    std = residual.std() / (count.std() * np.sqrt(len(offset)))
    return slope, float(max(std, 1e-12))


def _line(x: np.ndarray, y: np.ndarray) -> tuple[float, float]:
    """Slope and start of the straight line through points, by least squares."""
    centred = x - x.mean()
    slope = float(centred @ y) / float(centred @ centred)
    return slope, float(y.mean() - slope * x.mean())
