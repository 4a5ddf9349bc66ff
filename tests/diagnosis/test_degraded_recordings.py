"""Recordings as bad as logs can be: each ends with a diagnosis or with an error that says what to do, never otherwise.

Warnings of numpy and scipy count as failures: they would reach the terminal.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import synthetic
from sweeps import daily
from synthetic import Truth

from gapscope.arm.case import Case
from gapscope.arm.errors import GapscopeError, InputError
from gapscope.arm.recording import Recording
from gapscope.diagnosis.diagnose import diagnose
from gapscope.diagnosis.document.diagnosis_json import validate

pytestmark = pytest.mark.filterwarnings(
    "error::RuntimeWarning",
    "error::scipy.linalg.LinAlgWarning",
)
Change = Callable[[np.ndarray], np.ndarray]

SOUND = synthetic.case(Truth(coulomb=(0.0, 2.0, 0.0)), seed=3, duration=4.0)


def changed(
    rows: np.ndarray | None = None,
    *,
    t: Change | None = None,
    q: Change | None = None,
    tau: Change | None = None,
) -> Case:
    """Two recordings of the sound case, some rows or some channels of each."""

    def one(recording: Recording) -> Recording:
        kept = recording.part(slice(None) if rows is None else rows)
        changes = {"t": t, "q": q, "tau": tau}
        new = {k: f(getattr(kept, k).copy()) for k, f in changes.items() if f}
        return replace(kept, **new)

    return replace(SOUND, recordings=tuple(one(r) for r in SOUND.recordings[1:]))


def column(j: int, value: float) -> Change:
    """A channel with the value on one joint, from 0."""

    def change(series: np.ndarray) -> np.ndarray:
        series[:, j] = value
        return series

    return change


def noisy(deviation: float) -> Change:
    rng = np.random.default_rng(0)
    return lambda series: series + deviation * rng.standard_normal(series.shape)


def kept(share: float) -> np.ndarray:
    """Rows of a log that loses the others at random."""
    return np.flatnonzero(np.random.default_rng(1).random(1001) < share)


def times(factor: float) -> Change:
    return lambda series: factor * series


def rounded(q: np.ndarray) -> np.ndarray:
    return np.round(q, 1)


def repeated(t: np.ndarray) -> np.ndarray:
    t[99] = t[98]
    return t


def spiky(tau: np.ndarray) -> np.ndarray:
    """A torque with one row that is nonsense."""
    tau[100] = 1e5
    return tau


DIAGNOSED: dict[str, Callable[[], Case]] = {
    "1 s": lambda: changed(np.arange(251)),
    "1 s at 30 Hz": lambda: changed(np.arange(0, 265, 8)),
    "1.6 s": lambda: changed(np.arange(401)),
    "30 Hz": lambda: changed(np.arange(0, 1001, 8)),
    "noise five times as loud": lambda: changed(tau=noisy(0.6)),
    "a third of the rows lost": lambda: changed(kept(0.67)[:400]),
    "a joint that never moves": lambda: changed(q=column(2, 0.3)),
    "no torque on a joint": lambda: changed(tau=column(0, 0.0)),
    "a constant torque": lambda: changed(tau=column(2, 4.0)),
    "positions in steps of 0.1 rad": lambda: changed(np.arange(501), q=rounded),
    "a spike in the torque": lambda: changed(np.arange(601), tau=spiky),
    "torque in thousandths": lambda: changed(np.arange(601), tau=times(1e-3)),
}
DAILY = (
    *("1 s at 30 Hz", "a third of the rows lost"),
    *("a spike in the torque", "torque in thousandths"),
)


@pytest.mark.parametrize("label", daily(DIAGNOSED, *DAILY))
def test_it_is_diagnosed(label: str) -> None:
    validate(diagnose(DIAGNOSED[label]()).document)


REFUSED: dict[str, tuple[Callable[[], Case], str]] = {
    "0.9 s": (lambda: changed(np.arange(226)), "lasts 0.9 s"),
    "no torque": (lambda: changed(tau=times(0.0)), "of no joint changes"),
    "torque of 10^12": (lambda: changed(tau=times(1e12)), "column tau"),
    "positions of 10^12": (lambda: changed(q=times(1e12)), "column q"),
    "years between samples": (lambda: changed(t=times(1e12)), "column t"),
    "time in a millionth": (lambda: changed(t=times(1e-6)), "the rate is"),
    "time that stands still": (lambda: changed(t=times(0.0)), "column t"),
    "a stamp twice": (lambda: changed(t=repeated), "row 100, column t"),
    "large stamps, small steps": (lambda: changed(t=lambda t: t + 1e15), "column t"),
}


@pytest.mark.parametrize("label", REFUSED)
def test_it_is_refused_with_place_and_remedy(label: str) -> None:
    build, says = REFUSED[label]
    with pytest.raises(GapscopeError) as caught:
        diagnose(build())
    assert says in str(caught.value) and "remedy" in str(caught.value)
    if "column" in says:
        assert isinstance(caught.value, InputError)
        assert "recording_1.csv" in str(caught.value)
