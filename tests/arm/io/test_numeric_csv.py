"""CSV parsed in blocks holds the same numbers as CSV read cell by cell."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from gapscope.arm.errors import InputError
from gapscope.arm.io.formats.table_files import read_csv
from gapscope.arm.io.log import open_log
from gapscope.arm.io.table import without_damage


def text(rows: int) -> list[str]:
    """Numbers of all sizes, with as many digits as they have."""
    rng = np.random.default_rng(0)
    values = rng.normal(size=rows) * 10.0 ** rng.integers(-30, 30, size=rows)
    return [f"{0.002 * k!r}, {values[k].item()!r}, run" for k in range(rows)]


def test_every_number_is_the_one_that_python_reads(tmp_path: Path) -> None:
    file, lines = tmp_path / "log.csv", text(2000)
    file.write_text("t,q1,mode\n" + "\n".join(lines) + "\n", encoding="utf-8")
    columns = read_csv(file).columns
    # parsed in blocks
    assert isinstance(columns["q1"], np.ndarray)
    cells = [line.split(",") for line in lines]
    np.testing.assert_array_equal(columns["t"], [float(row[0]) for row in cells])
    np.testing.assert_array_equal(columns["q1"], [float(row[1]) for row in cells])
    assert set(columns["mode"]) == {"run"}


@pytest.mark.parametrize("odd", ["", "0.1,,run", "0.1,nan,run", "0.1,1.5;,run"])
def test_what_is_no_number_is_left_to_the_text_reader(tmp_path: Path, odd: str) -> None:
    file, lines = tmp_path / "log.csv", text(20)
    file.write_text("\n".join(["t,q1,mode", *lines, odd, *lines]), encoding="utf-8")
    table = read_csv(file)
    if odd:
        with pytest.raises(InputError, match="line 22, column q1"):
            table.numbers("q1")
    else:
        assert len(table.numbers("q1")) == 40
        assert table.where(20, "q1") == "line 23, column q1"


ROWS = np.round(np.random.default_rng(1).normal(size=(30, 3)), 6)


def lines(delimiter: str, point: str, mixed: bool = False) -> list[str]:
    """Rows of numbers; a mixed one has text in the column of the last, which no block of numbers holds."""
    cells = [[str(x).replace(".", point) for x in row] for row in ROWS.tolist()]
    if mixed:
        cells[20][2] = "-"
    return [delimiter.join(row) for row in cells]


HEADER = "t{d}q1{d}q2"
ABOVE = {
    "header": [HEADER],
    "comments": ["# robot log", "", "# of a Monday", HEADER],
    "remarks": ["Robot log{d}{d}", "Operator", "", HEADER],
    "nothing": [],
}


@pytest.mark.parametrize("mixed", [False, True])
@pytest.mark.parametrize(("delimiter", "point"), [(",", "."), (";", ","), ("\t", ",")])
@pytest.mark.parametrize("above", ABOVE)
def test_remarks_above_the_header_and_decimal_commas(
    tmp_path: Path, above: str, delimiter: str, point: str, mixed: bool
) -> None:
    file, text = tmp_path / "log.csv", lines(delimiter, point, mixed)
    top = [line.replace("{d}", delimiter) for line in ABOVE[above]]
    file.write_text("\n".join([*top, *text]) + "\n", encoding="utf-8")
    table, names = read_csv(file), ["t", "q1", "q2"] if top else ["1", "2", "3"]
    assert list(table.columns) == names
    assert table.where(0, names[0]).startswith(f"line {len(top) + 1},")
    for name, expected in zip(names[:2], ROWS.T[:2], strict=True):
        np.testing.assert_array_equal(table.numbers(name), expected)
    found, sound = table.values(names[2]), np.ones(len(ROWS), dtype=bool)
    sound[20] = not mixed
    np.testing.assert_array_equal(found[sound], ROWS[sound, 2])
    assert np.isnan(found[~sound]).all()


def test_lines_of_json_with_lists_and_nested_objects(tmp_path: Path) -> None:
    file = tmp_path / "log.jsonl"
    objects = [{"t": t, "state": {"q": q}} for t, *q in ROWS.tolist()]
    # the last line is cut, as by a logger that was stopped
    text = "\n\n".join(map(json.dumps, objects)) + '\n\n{"t": 0.3, "st'
    file.write_text(text, encoding="utf-8")
    (whole,) = open_log(file).tables
    assert whole.cut == {2 * len(objects) + 1: "is no object of JSON"}
    table = without_damage(whole)
    np.testing.assert_array_equal(table.values("state.q"), ROWS[:, 1:])
    np.testing.assert_array_equal(table.numbers("t"), ROWS[:, 0])
    assert table.where(1, "t") == "line 3, column t"
