"""Faults of references, velocities and gains: found from the channels before any torque is worked out from them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial

import numpy as np

from gapscope.arm.case import Case
from gapscope.arm.errors import GapscopeError
from gapscope.arm.recording import Recording
from gapscope.arm.set_points import SetPoints, set_points
from gapscope.diagnosis.setup_faults.found_fault import FoundFault, repaired
from gapscope.diagnosis.setup_faults.references.control_faults import (
    exact_gains,
    ignored_velocity,
    other_gains,
    unmeasured_torque,
)
from gapscope.diagnosis.setup_faults.references.control_rows import (
    ControlRows,
    control_rows,
)
from gapscope.diagnosis.setup_faults.references.speed_scaling import pace
from gapscope.diagnosis.setup_faults.references.velocity_source import is_of_reference
from gapscope.diagnosis.thresholds import (
    NAMED_RATE_ERROR,
    OBVIOUS_FAULT_PROBABILITY,
    STEPS_IN_TORQUE,
)
from gapscope.effects.setup_faults.fault import Fault
from gapscope.effects.setup_faults.reference_faults import (
    CoarseReference,
    SpeedScaling,
    VelocityOfReference,
)
from gapscope.model.conditioning import low_pass

COMPUTED = (
    "the torque is kp (q_ref - q) + kd (dq_ref - dq) to rounding in every row, with kp {kp} N m/rad and kd {kd} "
    "N m s/rad: it was computed from these columns, not measured. No other gains fit the motion decidedly better; what "
    "the loop adds behind them, a delay above all, shows as an effect of the arm"
)
"""Note on a torque that follows from the log's other columns."""


def find_reference_faults(case: Case) -> tuple[Case, tuple[FoundFault, ...]]:
    """The case with faults of references, velocities and gains put right, and these, in the order of their repair.

    A torque that was computed rather than measured, and fits the motion, is no fault but a warning of the case.
    """
    found: list[FoundFault] = []
    if not any(r.q_ref is not None for r in case.recordings):
        return case, ()
    for search in (_velocity, _set_points, _pace):
        faults = search((*case.recordings, *case.judged))
        if faults:
            case = repaired(case, faults)
            found.extend(faults)
    try:
        rows = control_rows(case)
    except GapscopeError:
        # too short or gapped for any law; what needs the signals says so
        return case, tuple(found)
    if rows is None:
        return case, tuple(found)
    case, faults = _of_the_law(case, rows)
    return case, (*found, *faults)


def _of_the_law(case: Case, rows: ControlRows) -> tuple[Case, tuple[FoundFault, ...]]:
    """The case with what is wrong about its control law put right."""
    gains = exact_gains((*case.recordings, *case.judged))
    if gains is not None:
        fault = unmeasured_torque(case, rows, gains)
        if fault is not None:
            return repaired(case, (fault,)), (fault,)
        if case.controller is None:
            case = replace(case, warnings=(*case.warnings, _computed(gains)))
    for search in (ignored_velocity, other_gains):
        fault = search(case, rows)
        if fault is not None:
            return repaired(case, (fault,)), (fault,)
    return case, ()


def _computed(gains: np.ndarray) -> str:
    kp, kd = (", ".join(f"{x:.4g}" for x in column) for column in gains.T)
    return COMPUTED.format(kp=kp, kd=kd)


def _velocity(recordings: tuple[Recording, ...]) -> tuple[FoundFault, ...]:
    names = tuple(r.name for r in recordings if is_of_reference(r))
    fault = VelocityOfReference()
    found = FoundFault(fault, OBVIOUS_FAULT_PROBABILITY, recordings=names)
    return (found,) if names else ()


def _set_points(recordings: tuple[Recording, ...]) -> tuple[FoundFault, ...]:
    """Coarse references that the torque does not follow, one fault for each variant."""
    periods: dict[str, dict[str, float]] = {}
    for recording in recordings:
        points = set_points(recording)
        if points is not None and not _followed(recording, points):
            of_variant = periods.setdefault(points.variant, {})
            of_variant[recording.name] = points.every / recording.rate
    return tuple(
        _by_median(partial(CoarseReference, variant), "period", of_variant)
        for variant, of_variant in periods.items()
    )


def _followed(recording: Recording, points: SetPoints) -> bool:
    """Whether the torque has the steps of the reference, so that the controller did follow them."""
    smooth = points.smooth(recording)
    if recording.tau is None or recording.q_ref is None or smooth.q_ref is None:
        return False
    # what changes faster than set points can tell: half of their rate
    band = recording.rate / points.every / 2
    steps, torque = (
        x - low_pass(x, recording.rate, band)
        for x in (recording.q_ref - smooth.q_ref, recording.tau)
    )
    power = np.sqrt((steps**2).sum(axis=0) * (torque**2).sum(axis=0))
    stepping = power > 0
    if not stepping.any():
        return False
    likeness = (steps * torque).sum(axis=0)[stepping] / power[stepping]
    return bool(np.median(likeness) > STEPS_IN_TORQUE)


def _pace(recordings: tuple[Recording, ...]) -> tuple[FoundFault, ...]:
    """Other paces, one fault for all recordings at one pace."""
    paces = {r.name: s for r in recordings if (s := pace(r)) is not None}
    faults: list[FoundFault] = []
    while paces:
        first = next(iter(paces.values()))
        alike = {
            name: s
            for name, s in paces.items()
            if abs(np.log(s / first)) < NAMED_RATE_ERROR
        }
        faults.append(_by_median(SpeedScaling, "factor", alike))
        paces = {name: s for name, s in paces.items() if name not in alike}
    return tuple(faults)


def _by_median(
    fault: Callable[[float], Fault], name: str, values: Mapping[str, float]
) -> FoundFault:
    """The fault whose parameter is the median over recordings, and how far these differ."""
    given = list(values.values())
    median = float(np.median(given))
    std = max(float(np.std(given)), 1e-3 * median)
    return FoundFault(
        fault(median), OBVIOUS_FAULT_PROBABILITY, {name: (std,)}, tuple(values)
    )
