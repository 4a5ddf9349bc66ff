"""Samples of long recordings: worked on in blocks, thinned to a bounded number, and the same where they are kept."""

from __future__ import annotations

import tracemalloc

import arms
import numpy as np
import pytest

from gapscope.ident.model.friction_law import FrictionLaw
from gapscope.ident.model.model_columns import ModelColumns
from gapscope.ident.signals import samples as module
from gapscope.ident.signals.samples import Band, Samples

BAND = Band(10.0)


def made(band: Band = BAND) -> Samples:
    recording = arms.recording("a.csv", 3)
    return Samples(ModelColumns(arms.arm()), band.segments([recording]), band)


def test_blocks_hold_the_same_samples(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = made()
    monkeypatch.setattr(module, "LONGEST", 4.0)
    cut = made()
    assert len(cut.segments) == 3
    step = BAND.step(whole.segments[0])
    rate = whole.segments[0].motion.rate
    places = [
        np.round(s.motion.t[BAND.rows(s)][::step] * rate).astype(int)
        for s in cut.segments
    ]
    rows = BAND.filtered(np.asarray(whole.segments[0].torque), whole.segments[0])
    first = round(whole.segments[0].motion.t[BAND.rows(whole.segments[0])][0] * rate)
    np.testing.assert_allclose(
        cut.torque, rows[np.concatenate(places) - first], atol=1e-2 * np.abs(rows).max()
    )
    assert abs(len(cut.torque) - len(whole.torque)) <= len(cut.segments)


def test_long_recordings_are_thinned_further() -> None:
    segments = BAND.segments([arms.recording("a.csv", 3)])
    bounded = BAND.bounded(segments, most=100)
    few = Samples(ModelColumns(arms.arm()), segments, bounded)
    assert len(few.torque) <= 100
    whole = made()
    np.testing.assert_allclose(
        few.torque, whole.torque[:: bounded.thinning], rtol=1e-12
    )
    np.testing.assert_allclose(
        few.matrix(FrictionLaw()),
        whole.matrix(FrictionLaw())[:: bounded.thinning],
        rtol=1e-9,
        atol=1e-12,
    )
    assert few.interval == pytest.approx(bounded.thinning * whole.interval)


def test_short_recordings_keep_all_that_the_band_holds() -> None:
    assert BAND.bounded(BAND.segments([arms.recording("a.csv", 3)])) == BAND


def test_full_rate_columns_are_held_of_one_block_at_a_time(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def peak() -> int:
        tracemalloc.start()
        made()
        _, found = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        return found

    made()
    whole = peak()
    monkeypatch.setattr(module, "LONGEST", 2.0)
    # the response of the filter is kept for all blocks of one length
    made()
    assert peak() < 0.5 * whole
