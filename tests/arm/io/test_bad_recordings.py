"""Recordings that cannot be right are refused: file, line and column, what was expected, what to do."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from gapscope.arm.errors import InputError
from gapscope.arm.io.formats.table_files import read_parquet
from gapscope.arm.io.import_section import Channel, Import, TimeColumn
from gapscope.arm.io.load_recording import load_recording
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording

N = 50
Rows = list[list[str]]
Change = Callable[[Rows], Rows]


def rows() -> Rows:
    """A sound file: header in line 1, then ``N`` rows."""
    t = np.arange(N) / 100
    sine, cosine = np.sin(9 * t), np.cos(9 * t)
    table = np.column_stack([t, sine, cosine, cosine, -sine])
    lines = [[f"{x:.6f}" for x in row] for row in table]
    return [["t", "q1", "q2", "tau1", "tau2"], *lines]


def cell(line: int, column: int, text: str) -> Change:
    """Put ``text`` into one cell."""

    def change(table: Rows) -> Rows:
        table[line - 1][column] = text
        return table

    return change


def times(factor: float, column: int = 0) -> Change:
    """Multiply one column."""

    def change(table: Rows) -> Rows:
        head, *lines = table
        for row in lines:
            row[column] = repr(float(row[column]) * factor)
        return [head, *lines]

    return change


BAD: list[tuple[str, Change, str, str]] = [
    ("no header", lambda x: x[1:], "has no header, and so no column tau1; it has 5", "gapscope inspect log.csv tells"),
    ("header only", lambda x: x[:1], "has a header and no rows", "samples"),
    ("empty", lambda x: [], "is empty", "give a file with a header"),
    ("one row", lambda x: x[:2], "time stands still in all of its rows (1)", "longer recording"),
    ("missing q2", lambda x: [[*r[:2], *r[3:]] for r in x], "has no column q2; it has t, q1, tau1, tau2", "import:"),
    ("missing tau", lambda x: [r[:4] for r in x], "has no column tau2", "import:"),
    ("missing time", lambda x: [r[1:] for r in x], "has no column t;", "import:"),
    ("third joint", lambda x: [[*r, "q3"] for r in x], "has a column q3, but the arm has only 2 joints: sh", "URDF of"),
    ("column twice", cell(1, 2, "q1"), "line 1: has the column 'q1' twice", "rename"),
    ("back in time", cell(25, 0, "0.1"), "line 25, column t: time jumps back, from 0.22 s to 0.1 s", "split the log"),
    ("ms", times(3e3), "column t: looks like ms: taken as s the rate is 0.0333 Hz", "unit: ms"),
    ("us", times(3e6), "column t: looks like us:", "unit: us"),
    ("ns", times(3e9), "column t: looks like ns:", "unit: ns"),
    ("slow", times(14.0), "column t: the rate is 7.14 Hz", "log at a higher rate"),
    ("hours", times(1 / 3600), "column t: the rate is 3.6e+05 Hz", "correct the unit"),
    ("degrees", times(100, 1), "to 99.92, shoulder is limited to -2 to 2 rad: looks like degrees", "unit: deg"),
    ("motor side", times(9999, 2), "elbow is limited to -2 to 2 rad", "the transmission"),
]  # fmt: skip


LEFT_OUT: list[tuple[str, Change, int, str]] = [
    ("nan", cell(31, 2, "nan"), 31, "column q2: is not a finite number (nan)"),
    ("inf", cell(31, 3, "inf"), 31, "column tau1: is not a finite number (inf)"),
    ("empty cell", cell(12, 3, ""), 12, "column tau1: the cell is empty"),
    ("text", cell(13, 1, "#REF!"), 13, "column q1: expected a number, got '#REF!'"),
    ("absurd", cell(13, 4, "1e154"), 13, "column tau2: holds 1e+154, which no log"),
    ("absurd time", cell(13, 0, "1e154"), 13, "column t: holds 1e+154, which no log"),
    ("ragged", lambda x: [*x[:20], x[20][:3], *x[21:]], 21, "has 3 cells, the header has 5"),
    ("cut short", lambda x: [*x[:-1], x[-1][:2]], N + 1, "has 2 cells"),
]  # fmt: skip


Load = Callable[..., Recording]


@pytest.fixture
def sound(load: Load) -> Recording:
    return load(rows())


@pytest.mark.parametrize(("label", "change", "line", "what"), LEFT_OUT)
def test_a_damaged_row_is_left_out_with_its_place(
    label: str, change: Change, line: int, what: str, sound: Recording, load: Load
) -> None:
    kept = np.delete(np.arange(N), line - 2)
    for every_row in (False, True):
        found = load(change(rows()), complete=True, every_row=every_row)
        np.testing.assert_array_equal(found.q, sound.q[kept])
        np.testing.assert_allclose(found.t, sound.t[kept])
        said = f"rows left out that cannot be read: 1 of 50 (2.00%): line {line}"
        assert found.notes[0].startswith(said) and what in found.notes[0]


def test_many_damaged_rows_are_refused_at_once(sound: Recording, load: Load) -> None:
    several, torques = rows(), rows()
    for line in range(10, 17):
        cell(line, line % 5, "#REF!")(several)
        cell(line, 3, "#REF!")(torques)
    with pytest.raises(InputError) as caught:
        load(several)
    text = str(caught.value)
    assert "7 of 50 rows cannot be read: line 10, column t: expected a number" in text
    assert "line 12, column q2" in text and "and 4 more" in text
    # what is not read may be damaged
    silent = Import(channels={**Import().channels, "tau": None})
    assert load(torques, importing=silent).notes == sound.notes


@pytest.mark.parametrize(("ending", "place"), [("csv", "line 102"), ("npz", "row 101")])
def test_a_block_without_values_is_a_pause(ending: str, place: str, load: Load) -> None:
    t = np.arange(500) / 100
    columns = {"t": t, "q1": np.sin(9 * t), "q2": np.cos(9 * t)}
    columns["q2"][100:220] = np.nan
    found = load(columns, f"log.{ending}")
    assert len(found.t) == 380 and np.isfinite(found.q).all()
    pause = f"rows without values left out as pauses: 120 of 500 in 1 block: {place}"
    assert found.notes[0].startswith(f"{pause}, column q2")
    assert "gaps in time: 1, the longest 1.21" in "".join(found.notes)
    # every second row is none
    columns["q1"][::2] = np.nan
    with pytest.raises(InputError, match="of 500 rows cannot be read: (line 2|row 1),"):
        load(columns, f"log.{ending}")


def test_the_number_of_a_row_counts_on_over_damaged_ones(load: Load) -> None:
    table = cell(31, 1, "?")(rows())
    counted = Import(time=TimeColumn(None, rate=100.0))
    found = load(table, importing=counted)
    assert len(found.t) == N - 1 and found.t[-1] == pytest.approx(0.49)
    part = load(table, importing=counted, rows=(20, 39))
    assert len(part.t) == 19 and part.t[0] == pytest.approx(0.2)


def test_files_side_by_side_lose_the_same_rows(
    sound: Recording, arm: NominalArm, tmp_path: Path
) -> None:
    files, channels = {}, {}
    for name, columns, damaged in (("q", slice(0, 3), 9), ("tau", slice(3, 5), 20)):
        table = [row[columns] for row in rows()]
        table[damaged][0] = ""
        files[name] = tmp_path / f"{name}.csv"
        files[name].write_text("\n".join(map(",".join, table)))
        channels[name] = Channel(name + "{j}", file=name, named=True)
    found = load_recording(files, arm, Import(channels=channels))
    kept = np.delete(np.arange(N), [8, 19])
    np.testing.assert_array_equal(found.tau, sound.tau[kept])
    np.testing.assert_array_equal(found.q, sound.q[kept])
    assert found.notes[0].startswith("rows left out that cannot be read: 2 of 50")


@pytest.mark.parametrize(("label", "change", "message", "remedy"), BAD)
def test_refused(
    label: str, change: Change, message: str, remedy: str, load: Load, tmp_path: Path
) -> None:
    with pytest.raises(InputError) as caught:
        load(change(rows()), complete=True)
    assert str(caught.value).startswith(str(tmp_path / "log.csv"))
    assert message in str(caught.value)
    assert remedy in caught.value.remedy and caught.value.exit_code == 2


def test_sound(load: Load) -> None:
    apart = [line for row in rows() for line in (row, [])]
    assert load(apart, complete=True).notes == ()
    # beyond a limit of the joint, but no other unit
    (note,) = load(times(2.5, 2)(rows())).notes
    assert note.startswith("q2 goes from -2.5")
    assert "elbow is limited to -2 to 2 rad" in note


def test_a_reference_is_on_the_turn_of_its_joint(load: Load) -> None:
    t = np.arange(500) / 100
    q = np.pi - 0.02 + np.sin(3 * t)[:, None] * np.ones(2)
    # counted from minus half a turn to half a turn
    q, q_ref = ((x + np.pi) % (2 * np.pi) - np.pi for x in (q, q + 0.05))
    found = load({"t": t, "q": q, "q_ref": q_ref}, "log.npz", any_unit=True)
    np.testing.assert_allclose(found.q_ref - found.q, 0.05, atol=1e-9)


@pytest.mark.parametrize("value", [int("1" * 400), "error"])
def test_what_is_no_number_in_json_is_damage(value: object, load: Load) -> None:
    """A whole number of any length, and texts, which are no pause even in one block."""
    head, *lines = rows()
    numbers: list[list[Any]] = [list(map(float, row)) for row in lines]
    for row in numbers[10:22]:
        row[1] = value
    objects = (dict(zip(head, row, strict=True)) for row in numbers)
    text = "\n".join(map(json.dumps, objects)).encode()
    with pytest.raises(
        InputError, match="12 of 50 rows cannot be .* line 11, column q1"
    ):
        load(text, "log.jsonl")


SHORT = {"t": np.arange(5.0), "q": np.zeros((4, 2))}
WHOLE: list[tuple[str, Any, str]] = [
    ("log.xlsx", b"PK", "the ending '.xlsx' names no known format"),
    ("log.csv", b"t,q1\n\xff\xfe\x00", "is not a text in UTF-8"),
    ("log.csv", b't,"' + b"q1 " * 50_000, "is not valid CSV"),
    ("log.jsonl", b'[0.0]\n{"t": 0.1', "has no object of JSON on any line"),
    ("log.npz", {"q": np.zeros((100_000, 2))}, "has no column t; it has q1, q2"),
    ("log.npz", SHORT, "its arrays differ in length: t 5, q1 4, q2 4"),
]
"""Files that are no table at all."""


@pytest.mark.parametrize(("name", "content", "message"), WHOLE)
def test_what_is_no_table_is_refused_at_once(
    name: str, content: Any, message: str, load: Load
) -> None:
    begun = time.process_time()
    with pytest.raises(InputError, match=message):
        load(content, name)
    assert time.process_time() - begun < 1.0


def test_parquet_with_any_byte_changed_is_read_or_refused(tmp_path: Path) -> None:
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
