"""Recordings that cannot be right are refused: file, line and column, what was expected, what to do."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from gapscope.arm.errors import InputError
from gapscope.arm.io.formats.table_files import read_parquet
from gapscope.arm.io.load_recording import load_recording
from gapscope.arm.io.write_case import write_recording
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording

N = 50
Rows = list[list[str]]


def rows() -> Rows:
    """A sound file: header in line 1, then ``N`` rows."""
    t = np.arange(N) / 100
    table = np.column_stack(
        [t, np.sin(9 * t), np.cos(9 * t), np.cos(9 * t), -np.sin(9 * t)]
    )
    return [
        ["t", "q1", "q2", "tau1", "tau2"],
        *([f"{x:.6f}" for x in row] for row in table),
    ]


def cell(line: int, column: int, text: str) -> Callable[[Rows], Rows]:
    """Put ``text`` into one cell."""

    def change(table: Rows) -> Rows:
        table[line - 1][column] = text
        return table

    return change


def times(factor: float, column: int = 0) -> Callable[[Rows], Rows]:
    """Multiply one column."""

    def change(table: Rows) -> Rows:
        return [
            table[0],
            *(
                [*row[:column], repr(float(row[column]) * factor), *row[column + 1 :]]
                for row in table[1:]
            ),
        ]

    return change


BAD: list[tuple[str, Callable[[Rows], Rows], str, str]] = [
    (
        "no header",
        lambda x: x[1:],
        "has no header, and so no column tau1; it has 5 columns",
        "gapscope inspect log.csv tells what they hold",
    ),
    ("header only", lambda x: x[:1], "has a header and no rows", "samples"),
    ("empty", lambda x: [], "is empty", "give a file with a header"),
    (
        "one row",
        lambda x: x[:2],
        "time stands still in all of its rows (1)",
        "longer recording",
    ),
    (
        "missing q2",
        lambda x: [[*r[:2], *r[3:]] for r in x],
        "has no column q2; it has t, q1, tau1, tau2",
        "import:",
    ),
    ("missing tau", lambda x: [r[:4] for r in x], "has no column tau2", "import:"),
    ("missing time", lambda x: [r[1:] for r in x], "has no column t;", "import:"),
    (
        "third joint",
        lambda x: [[*x[0], "q3"], *([*r, "0"] for r in x[1:])],
        "has a column q3, but the arm has only 2 joints: shoulder, elbow",
        "URDF of the recorded arm",
    ),
    ("column twice", cell(1, 2, "q1"), "line 1: has the column 'q1' twice", "rename"),
    (
        "nan",
        cell(31, 2, "nan"),
        "line 31, column q2: is not a finite number (nan), the first of 1",
        "never guessed",
    ),
    (
        "inf",
        cell(31, 3, "inf"),
        "line 31, column tau1: is not a finite number (inf)",
        "never guessed",
    ),
    (
        "empty cell",
        cell(12, 3, ""),
        "line 12, column tau1: the cell is empty",
        "never guessed",
    ),
    (
        "text",
        cell(13, 1, "#REF!"),
        "line 13, column q1: expected a number, got '#REF!'",
        "repair the cell",
    ),
    (
        "ragged",
        lambda x: [*x[:20], x[20][:3], *x[21:]],
        "line 21: has 3 cells, the header has 5",
        "cut short",
    ),
    (
        "cut short",
        lambda x: [*x[:-1], x[-1][:2]],
        f"line {N + 1}: has 2 cells",
        "cut short",
    ),
    (
        "back in time",
        cell(25, 0, "0.1"),
        "line 25, column t: time jumps back, from 0.22 s to 0.1 s",
        "split the log",
    ),
    (
        "ms",
        times(1e3),
        "column t: looks like ms: taken as s the rate is 0.1 Hz",
        "unit: ms",
    ),
    ("us", times(1e6), "column t: looks like us:", "unit: us"),
    ("ns", times(1e9), "column t: looks like ns:", "unit: ns"),
    ("hours", times(1 / 3600), "column t: the rate is 3.6e+05 Hz", "correct the unit"),
    ("still time", times(0), "time stands still in all of its rows (50)", "longer"),
    (
        "degrees",
        times(100, 1),
        "q1 goes from -95.46 to 99.92, shoulder is limited to -2 to 2 rad: looks like degrees",
        "unit: deg",
    ),
    (
        "motor side",
        times(9999, 2),
        "elbow is limited to -2 to 2 rad",
        "the transmission",
    ),
]


@pytest.mark.parametrize(
    ("change", "message", "remedy"),
    [case[1:] for case in BAD],
    ids=[case[0] for case in BAD],
)
def test_refused(
    change: Callable[[Rows], Rows],
    message: str,
    remedy: str,
    arm: NominalArm,
    tmp_path: Path,
) -> None:
    path = tmp_path / "log.csv"
    path.write_text("\n".join(",".join(row) for row in change(rows())))
    with pytest.raises(InputError) as caught:
        load_recording(path, arm, complete=True)
    text = str(caught.value)
    assert (
        text.startswith(str(path)) and message in text and remedy in caught.value.remedy
    )
    assert caught.value.exit_code == 2


def test_sound(arm: NominalArm, tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("\n\n".join(",".join(row) for row in rows()))
    assert load_recording(path, arm, complete=True).notes == ()


def test_decimal_comma(arm: NominalArm, tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("\n".join(";".join(row).replace(".", ",") for row in rows()))
    with pytest.raises(
        InputError, match="line 2, column t: '0,000000' has a decimal comma"
    ):
        load_recording(path, arm)


def test_beyond_the_limits_is_a_note(arm: NominalArm, tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("\n".join(",".join(row) for row in times(2.5, 2)(rows())))
    (note,) = load_recording(path, arm).notes
    assert (
        note.startswith("q2 goes from -2.5")
        and "elbow is limited to -2 to 2 rad" in note
    )


@pytest.mark.parametrize("ending", ["npz", "parquet"])
def test_damaged_binary_files(
    ending: str, recording: Recording, arm: NominalArm, tmp_path: Path
) -> None:
    path = write_recording(recording, tmp_path / f"log.{ending}")
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(
        InputError, match=f"log.{ending}: cannot be read as (NPZ|Parquet)"
    ) as caught:
        load_recording(path, arm)
    assert caught.value.remedy == "is the file complete?"


def test_a_parquet_file_with_any_byte_changed_is_read_or_refused(
    tmp_path: Path,
) -> None:
    """A page that says it has no rows leaves its column shorter than the others."""
    path, table = tmp_path / "log.parquet", pa.table({"t": [0.0, 1.0], "q1": [2.0] * 2})
    pq.write_table(table, path, compression="none", use_dictionary=False)
    sound, reasons = path.read_bytes(), ""
    for place in range(len(sound)):
        damaged = bytearray(sound)
        damaged[place] ^= 1
        path.write_bytes(damaged)
        try:
            columns = read_parquet(path).columns
        except InputError as error:
            reasons += error.message
        else:
            assert len(columns) == 2
    assert "rows, the first" in reasons


def test_arrays_of_different_length(arm: NominalArm, tmp_path: Path) -> None:
    np.savez(tmp_path / "log.npz", t=np.arange(5.0), q=np.zeros((4, 2)))
    with pytest.raises(
        InputError, match="its arrays differ in length: t 5, q1 4, q2 4"
    ):
        load_recording(tmp_path / "log.npz", arm)


def test_nan_in_a_binary_file_names_the_row(
    recording: Recording, arm: NominalArm, tmp_path: Path
) -> None:
    q = recording.q.copy()
    q[6, 1] = np.nan
    np.savez(tmp_path / "log.npz", t=recording.t, q=q)
    with pytest.raises(
        InputError, match=r"log.npz, row 7, column q2: is not a finite number \(nan\)"
    ):
        load_recording(tmp_path / "log.npz", arm)


def test_no_such_file_and_unknown_format(arm: NominalArm, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="absent.csv: no such file or folder"):
        load_recording(tmp_path / "absent.csv", arm)
    (tmp_path / "log.xlsx").write_bytes(b"PK")
    with pytest.raises(InputError, match="the ending '.xlsx' names no known format"):
        load_recording(tmp_path / "log.xlsx", arm)


def test_binary_content_in_a_csv(arm: NominalArm, tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_bytes(b"t,q1\n\xff\xfe\x00")
    with pytest.raises(InputError, match="is not a text in UTF-8"):
        load_recording(tmp_path / "log.csv", arm)
