"""Time stamps that are not those of the samples, told from the recording itself.

Named is what no usual clock does. A logger that runs freely against a robot's bus stores up to some per cent of its
rows twice; real-time clocks jitter by less than 5 % of their period; quartz clocks keep their rate to 1e-4, so that a
rate off by 3 % is a mistake in the set-up.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable

import numpy as np
from scipy.signal import butter, sosfiltfilt

from gapscope.arm.io.plausibility import PLAUSIBLE_RATES, REPEATED, repeated_rows
from gapscope.arm.recording import CHANNELS, Recording
from gapscope.diagnosis.setup_faults.channel_mapping import timed
from gapscope.diagnosis.setup_faults.clock import stamps_are_wrong, unevenness
from gapscope.diagnosis.setup_faults.found_fault import FoundFault, Quantity
from gapscope.diagnosis.thresholds import (
    LOST_SAMPLE_STEP,
    NAMED_JITTER,
    NAMED_LOST,
    NAMED_RATE_ERROR,
    NAMED_REPEATS,
    RATE_AGREEMENT,
    RATE_BAND,
)
from gapscope.ident.signals.conditioning import GAP_STEPS


def find_stamps(recordings: Iterable[Recording]) -> tuple[FoundFault, ...]:
    """Time stamps that are wrong, one finding for each kind, of the recordings that have it."""
    recordings = tuple(recordings)
    found: list[FoundFault] = []

    def note(fault: FoundFault | None) -> None:
        nonlocal recordings
        if fault is not None:
            found.append(fault)
            recordings = tuple(fault.repair(r) for r in recordings)

    note(_milliseconds(recordings))
    kinds: tuple[tuple[str, Callable[[Recording], float], float], ...] = (
        ("repeats", repeats, NAMED_REPEATS),
        ("jitter", jitter, NAMED_JITTER),
        ("gaps", lost, NAMED_LOST),
    )
    for kind, measure, most in kinds:
        amounts = {r.name: measure(r) for r in recordings}
        note(
            _finding(
                kind, {name: a for name, a in amounts.items() if a > most}, recordings
            )
        )
    rates = {r.name: rate_error(r) for r in recordings}
    wrong = {
        name: a
        for name, a in rates.items()
        if a is not None and abs(np.log(a)) > NAMED_RATE_ERROR
    }
    note(_finding("wrong_rate", wrong, recordings))
    return tuple(found)


def _finding(
    kind: str, amounts: dict[str, float], recordings: tuple[Recording, ...]
) -> FoundFault | None:
    if not amounts:
        return None
    values = np.array(list(amounts.values()))
    amount = float(np.median(values))
    std = float(max(values.std(), 0.02 * amount))
    n = recordings[0].n_joints
    reading = timed(n, 1.0 / amount) if kind == "wrong_rate" else None
    parameters = {"amount": Quantity("1", (amount,), (std,))}
    return FoundFault(
        "time_stamps", (), kind, parameters, 0.99, tuple(amounts), reading
    )


def repeats(recording: Recording) -> float:
    """Share of rows that repeat the measurement before them [1], those that the reader has dropped among them."""
    for note in recording.notes:
        found = re.match(re.escape(REPEATED) + r"(\d+)", note)
        if found:
            return int(found[1]) / (len(recording.t) + int(found[1]))
    present = {
        name: x for name in CHANNELS if (x := getattr(recording, name)) is not None
    }
    return float(repeated_rows(recording.t, present)[0].mean())


def jitter(recording: Recording) -> float:
    """Unevenness of stamps over the period, standard deviation [1]; 0 where the samples are as uneven as they say."""
    amount = float(unevenness(recording.t).std())
    return (
        amount
        if amount > NAMED_JITTER and stamps_are_wrong(recording.t, recording.q)
        else 0.0
    )


def lost(recording: Recording) -> float:
    """Share of samples that are missing in gaps of more than ``GAP_STEPS`` periods [1]."""
    steps = np.diff(recording.t) * recording.rate
    missing = float((steps[steps > max(LOST_SAMPLE_STEP, GAP_STEPS)] - 1).sum())
    return missing / (len(recording.t) + missing)


def rate_error(recording: Recording) -> float | None:
    """Assumed over true period [1]: recorded velocities over those of the positions by the stamps.

    ``None`` where no velocity is recorded, or joints contradict each other. References serve where they have both.
    """
    found = [
        _rate_of(recording, q, dq)
        for q, dq in ((recording.q, recording.dq), (recording.q_ref, recording.dq_ref))
        if q is not None and dq is not None
    ]
    known = [a for a in found if a is not None]
    return known[0] if known else None


def _rate_of(recording: Recording, q: np.ndarray, dq: np.ndarray) -> float | None:
    rate = recording.rate
    if len(q) < 50:
        return None
    sos = butter(
        2,
        min(RATE_BAND / rate, 0.2) if rate > 2 * RATE_BAND else 0.2,
        output="sos",
        fs=1.0,
    )
    steps = np.diff(recording.t)
    usual = np.r_[False, (steps[1:] < 1.5 / rate) & (steps[:-1] < 1.5 / rate), False]
    own, given = (
        sosfiltfilt(sos, x, axis=0) for x in (np.gradient(q, recording.t, axis=0), dq)
    )
    own, given = own[usual], given[usual]
    power = (own**2).sum(axis=0) * (given**2).sum(axis=0)
    product = (own * given).sum(axis=0)
    agree = (power > 0) & (product > RATE_AGREEMENT * np.sqrt(power))
    if agree.sum() < max(1, recording.n_joints // 2):
        return None
    ratios = np.sqrt(
        (given[:, agree] ** 2).sum(axis=0) / (own[:, agree] ** 2).sum(axis=0)
    )
    if np.ptp(ratios) > 0.05 * np.median(ratios):
        return None
    return float(np.median(ratios))


def _milliseconds(recordings: tuple[Recording, ...]) -> FoundFault | None:
    """Stamps that give a rate at which no robot is logged in s, but do in ms."""
    low, high = PLAUSIBLE_RATES
    names = tuple(
        r.name for r in recordings if r.rate < low and low <= 1e3 * r.rate <= high
    )
    if not names:
        return None
    reading = timed(recordings[0].n_joints, 1e-3)
    return FoundFault("unit_mismatch", (), "milliseconds", {}, 0.99, names, reading)
