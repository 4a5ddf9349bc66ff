"""Time stamps that are not those of the samples, seen in the recording itself.

Named is what no usual clock does. A logger that runs freely against a robot's bus stores up to some per cent of its
rows twice; real-time clocks jitter by less than 5 % of their period; quartz clocks keep their rate to 1e-4, so that a
rate off by 3 %, or by the same 0.7 % in all recordings, is a mistake in the set-up.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping

import numpy as np
from scipy.signal import butter, sosfiltfilt

from gapscope.arm.errors import InputError
from gapscope.arm.io.even_rows import stamps_are_wrong, unevenness
from gapscope.arm.io.plausibility import PLAUSIBLE_RATES, REPEATED, repeated_rows
from gapscope.arm.io.samples.stuck import LEFT_OUT
from gapscope.arm.recording import Recording
from gapscope.diagnosis.setup_faults.found_fault import FoundFault
from gapscope.diagnosis.thresholds import (
    AGREED_RATE_ERROR,
    NAMED_JITTER,
    NAMED_LOST,
    NAMED_RATE_ERROR,
    NAMED_REPEATS,
    OBVIOUS_FAULT_PROBABILITY,
    RATE_AGREEMENT,
    RATE_BAND,
    RATE_DISAGREEMENT,
    RATE_REPEATED,
    STAMP_AMOUNT_STD,
)
from gapscope.effects.setup_faults.channel_faults import UnitMismatch
from gapscope.effects.setup_faults.time_stamp_fault import TimeStamps
from gapscope.model.conditioning import GAP_STEPS, SHORTEST

VELOCITY_UNITS = {
    180 / np.pi: "positions in rad with velocities in deg/s",
    np.pi / 180: "positions in deg with velocities in rad/s",
    30 / np.pi: "positions in rad with velocities in rpm",
}
"""Velocities over what positions change by per second, of units that do not fit together [1]."""


def find_stamps(recordings: Iterable[Recording]) -> tuple[FoundFault, ...]:
    """Time stamps that are wrong, one finding for each kind, of the recordings that have it."""
    recordings = tuple(recordings)
    searches = (_milliseconds, _repeats, find_jitter, _gaps, _wrong_rate)
    found: list[FoundFault] = []
    for search in searches:
        fault = search(recordings)
        if fault is not None:
            # the next search sees recordings on which this fault is corrected
            recordings = tuple(fault.repair(r) for r in recordings)
            found.append(fault)
    return tuple(found)


def _milliseconds(recordings: tuple[Recording, ...]) -> FoundFault | None:
    """Stamps that give a rate at which no robot is logged in s, but do in ms."""
    names = tuple(r.name for r in recordings if _in_milliseconds(r))
    if not names:
        return None
    fault = UnitMismatch("milliseconds")
    return FoundFault(fault, OBVIOUS_FAULT_PROBABILITY, recordings=names)


def _in_milliseconds(recording: Recording) -> bool:
    """Whether stamps are likelier in ms: at a rate of no log in s, and then not over at once.

    A log of 6 s at 5 Hz would last 6 ms.
    """
    low, high = PLAUSIBLE_RATES
    rate, duration = recording.rate, recording.duration
    # stamps of 0.1 s round to a little more
    slow = rate < 0.99 * low
    return slow and low <= 1e3 * rate <= high and 1e-3 * duration >= SHORTEST


def _repeats(recordings: tuple[Recording, ...]) -> FoundFault | None:
    shares = {r.name: repeats(r) for r in recordings}
    return _fault("repeats", _above(shares, NAMED_REPEATS))


def find_jitter(recordings: tuple[Recording, ...]) -> FoundFault | None:
    """Stamps that jitter while the samples do not; ``None`` if no recording has them."""
    amounts = {r.name: jitter(r) for r in recordings}
    return _fault("jitter", _above(amounts, NAMED_JITTER))


def _gaps(recordings: tuple[Recording, ...]) -> FoundFault | None:
    shares = {r.name: lost(r) for r in recordings}
    return _fault("gaps", _above(shares, NAMED_LOST))


def _wrong_rate(recordings: tuple[Recording, ...]) -> FoundFault | None:
    every = {r.name: rate_error(r) for r in recordings}
    _check_units(every)
    errors = {name: error for name, error in every.items() if error is not None}
    logs = np.log(list(errors.values()))
    # a clock is off by the same in all recordings, which a velocity's own filter is not
    agree = len(logs) > 1 and np.ptp(logs) < RATE_REPEATED
    least = AGREED_RATE_ERROR if agree else NAMED_RATE_ERROR
    wrong = {
        name: error for name, error in errors.items() if abs(np.log(error)) > least
    }
    return _fault("wrong_rate", wrong)


def _check_units(errors: Mapping[str, float | None]) -> None:
    """Check that no rate seems wrong by what two units of velocity differ by: then the stamps are right.

    Raises:
        InputError: positions and velocities of a recording are in units that do not fit together.
    """
    for name, error in errors.items():
        for factor, units in VELOCITY_UNITS.items():
            if error is not None and abs(np.log(error / factor)) < NAMED_RATE_ERROR:
                raise InputError(
                    f"velocities are {error:.3g} times what the positions change by: {units}",
                    "give the units: import: {q: {column: ..., unit: ...}, dq: {column: ..., unit: ...}}; "
                    "or leave the velocities out: import: {dq: null}",
                    file=name,
                    where="columns q1.., dq1..",
                )


def _above(amounts: dict[str, float], most: float) -> dict[str, float]:
    return {name: amount for name, amount in amounts.items() if amount > most}


def _fault(kind: str, amounts: dict[str, float]) -> FoundFault | None:
    """The finding on the recordings with these amounts: their median, and how far they differ."""
    if not amounts:
        return None
    values = np.array(list(amounts.values()))
    median = float(np.median(values))
    std = float(max(values.std(), STAMP_AMOUNT_STD * median))
    fault = TimeStamps(kind, median)
    return FoundFault(
        fault, OBVIOUS_FAULT_PROBABILITY, {"amount": (std,)}, tuple(amounts)
    )


def repeats(recording: Recording) -> float:
    """Share of rows that repeat the measurement before them [1], those that the reader has dropped among them."""
    dropped = _counted(recording, REPEATED)
    if dropped:
        return dropped / (len(recording.t) + dropped)
    repeated, _ = repeated_rows(recording.t, recording.channels)
    return float(repeated.mean())


def _counted(recording: Recording, note: str) -> int:
    """Number of rows that a note of the reader, which begins like this, counts; 0 without it."""
    found = (re.match(re.escape(note) + r"(\d+)", own) for own in recording.notes)
    return next((int(match[1]) for match in found if match), 0)


def jitter(recording: Recording) -> float:
    """Unevenness of stamps over the period, standard deviation [1]; 0 if the samples are as uneven as they say."""
    amount = float(unevenness(recording.t).std())
    if amount > NAMED_JITTER and stamps_are_wrong(recording.t, recording.q):
        return amount
    return 0.0


def lost(recording: Recording) -> float:
    """Share of samples missing in gaps of more than ``GAP_STEPS`` periods [1], those left out on reading apart."""
    steps = np.diff(recording.t) * recording.rate
    missing = float((steps[steps > GAP_STEPS] - 1).sum())
    missing = max(missing - _counted(recording, LEFT_OUT), 0.0)
    return missing / (len(recording.t) + missing)


def rate_error(recording: Recording) -> float | None:
    """Assumed over true period [1]: recorded velocities over those of the positions by the stamps.

    ``None`` if no velocity is recorded, or joints contradict each other. References serve if they have both.
    """
    motions = (
        (recording.q, recording.dq),
        (recording.q_ref, recording.dq_ref),
    )
    for q, dq in motions:
        if q is not None and dq is not None:
            error = _velocity_ratio(recording, q, dq)
            if error is not None:
                return error
    return None


def _velocity_ratio(
    recording: Recording, q: np.ndarray, dq: np.ndarray
) -> float | None:
    """Recorded velocities over those of the positions below ``RATE_BAND``; ``None`` if the joints disagree."""
    if len(q) < 50:
        return None
    rate = recording.rate
    cutoff = min(RATE_BAND / rate, 0.2) if rate > 2 * RATE_BAND else 0.2
    sos = butter(2, cutoff, output="sos", fs=1.0)
    beside_gap = np.diff(recording.t) >= 1.5 / rate
    # derivatives across a gap are wrong
    usual = np.zeros(len(q), dtype=bool)
    usual[1:-1] = ~(beside_gap[1:] | beside_gap[:-1])
    derivative = np.gradient(q, recording.t, axis=0)
    by_stamps = sosfiltfilt(sos, derivative, axis=0)[usual]
    recorded = sosfiltfilt(sos, dq, axis=0)[usual]

    by_stamps_power = (by_stamps**2).sum(axis=0)
    recorded_power = (recorded**2).sum(axis=0)
    power = by_stamps_power * recorded_power
    product = (by_stamps * recorded).sum(axis=0)
    agree = (power > 0) & (product > RATE_AGREEMENT * np.sqrt(power))
    # A joint that follows friction or noise alone does not agree; half of the joints have to.
    if agree.sum() < max(1, recording.n_joints // 2):
        return None
    ratios = np.sqrt(recorded_power[agree] / by_stamps_power[agree])
    if np.ptp(ratios) > RATE_DISAGREEMENT * np.median(ratios):
        return None
    return float(np.median(ratios))
