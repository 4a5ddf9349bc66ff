"""Samples of long recordings: thinned to a bounded number, and the same where they are kept."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from arms import tooled_panda
from cases import case_of, panda_recording

from gapscope.arm.recording import Recording
from gapscope.ident import samples as module
from gapscope.ident.identification import IdentificationSettings, identify
from gapscope.ident.samples import FrictionLaw, ModelColumns, Samples


def made(recording: Recording | None = None) -> Samples:
    recording = recording or panda_recording("a.csv", 3)
    return Samples(ModelColumns(tooled_panda()), [recording], 10.0)


def test_long_recordings_are_thinned_further(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = made()
    monkeypatch.setattr(module, "MOST", 100)
    few = made()
    assert len(few.torque) <= 100
    np.testing.assert_allclose(few.torque, whole.torque[:: few.thinning], rtol=1e-12)
    thinned, every = few.matrix(FrictionLaw()), whole.matrix(FrictionLaw())
    np.testing.assert_allclose(thinned, every[:: few.thinning], rtol=1e-9, atol=1e-12)
    assert few.interval[0] == pytest.approx(few.thinning * whole.interval[0])


def test_each_recording_counts_by_its_own_rate() -> None:
    """Recordings of 250 and 125 Hz: what is said of their time and errors does not depend on which comes first."""
    fast, slow = (panda_recording(f"{seed}.csv", seed, duration=5.0) for seed in (3, 4))
    slow, figures = slow.part(slice(None, None, 2)), []
    for two in ((fast, slow), (slow, fast)):
        case = case_of("mixed", tooled_panda(), *two, judged=(slow, fast))
        found = identify(case, IdentificationSettings(cutoff=20.0))
        # five seconds each, of which 0.6 s are trimmed
        assert found.counted.seconds == pytest.approx(8.8, rel=0.02)
        assert found.filtered.track.t[-1] == pytest.approx(8.8, rel=0.02)
        figures.append(
            (found.counted.bandwidth, found.interval.noise, found.groups.stated_std)
        )
    for one, other in zip(*figures, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-3)


def test_torque_at_its_limit_does_not_count() -> None:
    recording = panda_recording("a.csv", 3)
    tau = np.asarray(recording.tau).copy()
    limit = 0.6 * np.abs(tau[:, 1]).max()
    tau[:, 1] = tau[:, 1].clip(-limit, limit)
    samples = made(replace(recording, tau=tau))
    whole = made()
    share = samples.measured.mean(axis=0)
    assert 0.2 < share[1] < 0.95
    assert (np.delete(share, 1) == 1.0).all()
    matrix, expected = samples.matrix(FrictionLaw()), whole.matrix(FrictionLaw())
    out = ~samples.measured
    assert not matrix[out].any()
    assert not samples.torque[out].any()
    np.testing.assert_array_equal(matrix[~out], expected[~out])
    # what is left is no nearer to the limit than the filters reach
    error = np.abs(samples.torque - whole.torque)[~out]
    assert error.max() < 0.02 * np.abs(whole.torque[:, 1]).max()
