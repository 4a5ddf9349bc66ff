"""What is written is read back the same, in every format."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gapscope.arm.errors import GapscopeError, InputError
from gapscope.arm.io.write_case import write_recording
from gapscope.arm.recording import CHANNELS, Recording

Load = Callable[..., Recording]


@pytest.mark.parametrize("ending", ["csv", "parquet", "npz"])
def test_round_trip(
    ending: str, recording: Recording, load: Load, tmp_path: Path
) -> None:
    back = load(recording, f"motion.{ending}", complete=True)
    assert back.name == f"motion.{ending}" and back.notes == ()
    assert [file.name for file in tmp_path.glob(".*")] == []
    # to the last bit
    for name in ("t", *CHANNELS):
        np.testing.assert_array_equal(getattr(back, name), getattr(recording, name))
    # positions alone are a recording but not a complete one
    bare = Recording("motion", recording.t, recording.q)
    assert load(bare, f"motion.{ending}").tau is None
    with pytest.raises(InputError, match="has no column tau1; it has t, q1, q2"):
        load(bare, f"motion.{ending}", complete=True)


@pytest.mark.parametrize("delimiter", [",", ";", "\t"])
def test_delimiters(delimiter: str, load: Load) -> None:
    rows = [f"{i / 100},{np.sin(i)},{np.cos(i)}" for i in range(30)]
    text = "\ufeff" + "\n".join([" t ,q1, q2", *rows, ""])
    found = load(text.replace(",", delimiter).encode()).q[:, 1]
    np.testing.assert_array_equal(found, np.cos(np.arange(30)))


def test_what_cannot_be_written(recording: Recording, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="'.xls' names no format"):
        write_recording(recording, tmp_path / "motion.xls")
    (tmp_path / "file").touch()
    with pytest.raises(GapscopeError, match="cannot be written") as caught:
        write_recording(recording, tmp_path / "file" / "motion.csv")
    assert caught.value.exit_code == 1


@pytest.mark.parametrize("start", [-2.0, 1e5, 1.79e9])
def test_time_counts_from_its_start(
    start: float, recording: Recording, load: Load
) -> None:
    """Effects that fade since the start of a recording need its start; what is written has the log's own stamps.

    Dates in double precision are rounded to 0.2 microseconds, which the rate does not show.
    """
    late = replace(recording, t=recording.t + start)
    assert late.rate == 100.0
    read = load(late, "late.npz")
    assert read.t[0] == 0.0
    np.testing.assert_allclose(read.t, recording.t - recording.t[0], atol=1e-6)
    np.testing.assert_allclose(read.stamps, late.t, rtol=0, atol=1e-6)
    assert any("counted from the first row" in note for note in read.notes)
