"""Whether the recordings of a case hold what an arm can have: numbers beyond every unit are an error of the input."""

from __future__ import annotations

import numpy as np

from gapscope.arm.case import Case
from gapscope.arm.errors import GapscopeError, InputError
from gapscope.arm.io.plausibility import DIAGNOSE_FIRST, PLAUSIBLE_RATES
from gapscope.arm.recording import Recording
from gapscope.diagnosis.thresholds import (
    LARGEST_POSITION,
    LARGEST_TORQUE,
    LEAST_TORQUE_CHANGE,
)


def check_stamps(case: Case) -> None:
    """Check that the stamps of most samples run forward, in s or ms.

    Raises:
        InputError: those of a recording stand still, jump back, or are too far apart for any robot log.
    """
    slowest = PLAUSIBLE_RATES[0] / 1e3  # stamps in ms are repaired
    for recording in (*case.recordings, *case.judged):
        step = float(np.median(np.diff(recording.t))) if len(recording.t) > 1 else 0.0
        if not 0 < step <= 1.01 / slowest:
            raise InputError(
                f"time does not run as in a log of a robot: steps of {step:.3g} s",
                "give the unit of the time stamps in import: {time: {unit: ...}}, or their rate:; "
                + DIAGNOSE_FIRST,
                file=recording.name,
                where="column t",
            )


def check_torque(case: Case) -> None:
    """Check that a case has a torque that says something, and positions and torques of some unit.

    Raises:
        GapscopeError: no recording carries a torque that can be trusted, or none that changes.
        InputError: a position or torque is larger than in any unit.
    """
    carrying = [r for r in case.recordings if r.tau is not None]
    if not carrying:
        raise _no_torque(case)
    for recording in (*case.recordings, *case.judged):
        _check_size(recording, "q", LARGEST_POSITION, "rad")
        _check_size(recording, "tau", LARGEST_TORQUE, "N m")
        _check_size(recording, "tau_sensor", LARGEST_TORQUE, "N m")
    torques = [r.tau for r in carrying if r.tau is not None]
    if max(np.ptp(tau, axis=0).max() for tau in torques) < LEAST_TORQUE_CHANGE:
        names = ", ".join(r.name for r in carrying)
        raise GapscopeError(
            f"{case.name}: the torque of no joint changes ({names})",
            "check the columns tau1.. or import: {tau: ...}, its unit included; record a motion of all joints",
        )


def check_rates(case: Case) -> None:
    """Check that recordings, their time stamps put right, run forward at a rate at which robots are logged.

    Raises:
        InputError: one does not.
    """
    low, high = PLAUSIBLE_RATES
    for recording in (*case.recordings, *case.judged):
        # stamps of 0.1 s round to a little more
        if not 0.99 * low <= recording.rate <= 1.01 * high:
            raise InputError(
                f"the rate is {recording.rate:.3g} Hz, expected {low:g} to {high:g} Hz",
                "log at a higher rate; or, if this is none, give the unit of the time stamps in import: {time: {unit: "
                "...}}, or their rate:",
                file=recording.name,
                where="column t",
            )
        back = np.flatnonzero(np.diff(recording.t) <= 0)
        if len(back):
            raise InputError(
                "time stands still or jumps back",
                "drop rows that repeat a time stamp, and split the log if it jumps back",
                file=recording.name,
                where=f"row {int(back[0]) + 2}, column t",
            )


def _no_torque(case: Case) -> GapscopeError:
    """The error on a case without torque, with the reasons that were noted as it was read."""
    notes = [note for recording in case.recordings for note in recording.notes]
    reasons = dict.fromkeys((*case.warnings, *notes))
    why = "; ".join(reasons) or "none has a torque column"
    return GapscopeError(
        f"{case.name}: no recording carries a torque that can be trusted ({why})",
        "give torque with its sign in column tau1.., or map it in the case's import: section; positions are enough "
        "where controller: is known and the recordings have its reference in columns q_ref1..",
    )


def _check_size(recording: Recording, channel: str, largest: float, unit: str) -> None:
    """Check that no value of a channel is beyond what it can be in any unit."""
    series = getattr(recording, channel)
    if series is None or not len(series):
        return
    row, column = np.unravel_index(np.abs(series).argmax(), series.shape)
    value = float(series[row, column])
    if abs(value) > largest:
        raise InputError(
            f"{value:.3g} {unit} is beyond what an arm has in any unit ({largest:g} {unit})",
            f"drop or repair the row, or give the unit in import: {{{channel}: {{column: ..., unit: ...}}}}",
            file=recording.name,
            where=f"row {int(row) + 1}, column {channel}{int(column) + 1}",
        )
