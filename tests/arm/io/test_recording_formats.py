"""What is written is read back the same, in every format."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from gapscope.arm.errors import GapscopeError, InputError
from gapscope.arm.io.load_recording import load_recording
from gapscope.arm.io.write_case import write_recording
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import CHANNELS, Recording

FORMATS = ("csv", "parquet", "npz")
JOINT = '<joint name="{0}" type="continuous"><parent link="{1}"/><child link="{2}"/></joint><link name="{2}"/>'
TWO = f'<robot name="two"><link name="base"/>{JOINT.format("a", "base", "u")}{JOINT.format("b", "u", "l")}</robot>'


def assert_same(one: Recording, other: Recording) -> None:
    """All samples of two recordings are equal to the last bit."""
    np.testing.assert_array_equal(one.t, other.t)
    for name in CHANNELS:
        a, b = getattr(one, name), getattr(other, name)
        assert (a is None) == (b is None), name
        if a is not None:
            np.testing.assert_array_equal(a, b, err_msg=name)


@pytest.mark.parametrize("ending", FORMATS)
def test_round_trip(
    ending: str, recording: Recording, arm: NominalArm, tmp_path: Path
) -> None:
    path = write_recording(recording, tmp_path / f"motion.{ending}")
    back = load_recording(path, arm, complete=True)
    assert_same(recording, back)
    assert back.name == f"motion.{ending}" and back.notes == ()
    assert [file.name for file in tmp_path.glob(".*")] == []


@pytest.mark.parametrize("ending", FORMATS)
def test_positions_alone_are_a_recording_but_not_a_complete_one(
    ending: str, recording: Recording, arm: NominalArm, tmp_path: Path
) -> None:
    path = write_recording(
        Recording("motion", recording.t, recording.q), tmp_path / f"motion.{ending}"
    )
    assert load_recording(path, arm).tau is None
    with pytest.raises(InputError, match="has no column tau1; it has t, q1, q2"):
        load_recording(path, arm, complete=True)


@settings(max_examples=20, deadline=None)
@given(
    q=arrays(float, (40, 2), elements=st.floats(-2, 2)),
    tau=arrays(float, (40, 2), elements=st.floats(-1e6, 1e6)),
    ending=st.sampled_from(FORMATS),
)
def test_any_recording_survives(q: np.ndarray, tau: np.ndarray, ending: str) -> None:
    with tempfile.TemporaryDirectory() as folder:
        urdf = Path(folder) / "two.urdf"
        urdf.write_text(TWO)
        arm = NominalArm("two", urdf, ("a", "b"))
        tau[0] = -1.0
        recording = Recording("motion", np.arange(40) / 100, q, tau)
        path = write_recording(recording, Path(folder) / f"motion.{ending}")
        assert_same(recording, load_recording(path, arm, every_row=True))


@pytest.mark.parametrize("delimiter", [",", ";", "\t"])
def test_delimiters(delimiter: str, arm: NominalArm, tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    rows = [f"{i / 100},{np.sin(i)},{np.cos(i)}" for i in range(30)]
    path.write_text(
        "\ufeff" + "\n".join([" t ,q1, q2", *rows, ""]).replace(",", delimiter),
        encoding="utf-8",
    )
    np.testing.assert_array_equal(
        load_recording(path, arm).q[:, 1], np.cos(np.arange(30))
    )


def test_no_format_to_write(recording: Recording, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="'.xls' names no format"):
        write_recording(recording, tmp_path / "motion.xls")


def test_a_folder_that_cannot_be_made(recording: Recording, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(GapscopeError, match="cannot be written") as caught:
        write_recording(recording, tmp_path / "file" / "motion.csv")
    assert caught.value.exit_code == 1


@pytest.mark.parametrize("start", [-2.0, 1e5, 1.79e9])
def test_time_counts_from_the_first_row(
    start: float, recording: Recording, arm: NominalArm, tmp_path: Path
) -> None:
    """Effects that fade since the start of a recording need its start; what is written has the log's own stamps."""
    late = replace(recording, t=recording.t + start)
    read = load_recording(write_recording(late, tmp_path / "late.npz"), arm)
    assert read.t[0] == 0.0
    np.testing.assert_allclose(read.t, recording.t - recording.t[0], atol=1e-6)
    np.testing.assert_allclose(read.stamps, late.t, rtol=0, atol=1e-6)
    assert any("counted from the first row" in note for note in read.notes)


@pytest.mark.parametrize("rate", [100.0, 250.0, 1000.0])
def test_the_rate_does_not_depend_on_the_clock(rate: float) -> None:
    """Dates in double precision are rounded to 0.2 microseconds."""
    t = np.arange(1000) / rate
    for start in (0.0, 1e5, 1.79e9):
        assert Recording("log", t + start, np.zeros((1000, 1))).rate == rate
