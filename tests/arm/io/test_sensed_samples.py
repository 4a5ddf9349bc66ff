"""What no sensor measured is not read: spikes are bridged, rows with a stuck encoder are left out, both with a note."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from cases import to_and_fro

from gapscope.arm.recording import Recording

T = np.arange(2000) / 500
RNG = np.random.default_rng(0)
Q, _ = to_and_fro(T)
SOUND = Recording(
    "sound.csv",
    T,
    Q + 1e-5 * RNG.standard_normal(Q.shape),
    tau=8 * Q + 0.05 * RNG.standard_normal(Q.shape),
)


Load = Callable[..., Recording]


def changed(channel: str, rows: slice | list[int], by: np.ndarray | float) -> Recording:
    """The sound recording with something added to the second joint's channel."""
    series = getattr(SOUND, channel).copy()
    series[rows, 1] += by
    return replace(SOUND, **{channel: series})


SPIKES = [
    ("q", [700], 0.02),
    ("q", [0, 700, 701, 1400], -3.0),
    ("q", [1999], 0.1),
    ("tau", [700], 40.0),
    ("tau", [400, 402, 900, 901], -60.0),
]


@pytest.mark.parametrize(("channel", "rows", "by"), SPIKES)
def test_spikes_are_replaced_by_the_curve_through_their_neighbours(
    channel: str, rows: list[int], by: float, load: Load
) -> None:
    spiky = changed(channel, rows, by)
    found = load(spiky)
    error = np.abs(getattr(found, channel) - getattr(SOUND, channel))
    assert error.max() < (1e-4 if channel == "q" else 0.5)
    assert np.delete(error, rows, axis=0).max() < 1e-6
    said = "spikes replaced by the curve through their neighbours"
    assert f"{said}: {channel}2 {len(rows)}" in found.notes
    every = load(spiky, every_row=True)
    np.testing.assert_allclose(getattr(every, channel), getattr(spiky, channel))


KEPT: dict[str, Callable[[], Recording]] = {
    "as it is": lambda: SOUND,
    "a torque that steps": lambda: changed("tau", slice(700, None), 40.0),
    "an impact of 8 ms": lambda: changed("tau", slice(700, 704), 40.0),
    "a torque that starts high": lambda: changed("tau", [0], 60.0),
    "coarse encoders": lambda: replace(SOUND, q=np.round(SOUND.q, 2)),
    "heavy noise": lambda: replace(SOUND, tau=SOUND.tau + RNG.standard_t(4, Q.shape)),
    "30 Hz": lambda: SOUND.part(slice(None, None, 16)),
    "a joint that rests at times": lambda: replace(
        SOUND, q=np.sin(3 * np.clip(np.stack([T, T], 1), 0.0, [2.0, 3.0]))
    ),
}


@pytest.mark.parametrize("label", KEPT)
def test_what_an_arm_does_is_kept(label: str, load: Load) -> None:
    recording = KEPT[label]()
    found = load(recording)
    assert found.notes == ()
    np.testing.assert_allclose(found.q, recording.q, atol=1e-6)
    np.testing.assert_allclose(found.tau, recording.tau, atol=1e-5)


def test_rows_with_a_stuck_encoder_are_left_out(load: Load) -> None:
    q = SOUND.q.copy()
    q[600:850, 0] = q[600, 0]
    found = load(replace(SOUND, q=q))
    assert len(found.t) == len(T) - 249
    assert not ((found.t > T[600]) & (found.t < T[850])).any()
    note = "rows left out in which a position stands still and then leaps: 249 (12.45%), q1"
    assert found.notes[:1] == (note,)
