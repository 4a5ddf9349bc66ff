"""CSV parsed in blocks holds the same numbers as CSV read cell by cell."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gapscope.arm.errors import InputError
from gapscope.arm.io.formats.table_files import read_csv


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
def test_what_is_no_row_of_numbers_is_left_to_the_text_reader(
    tmp_path: Path, odd: str
) -> None:
    file, lines = tmp_path / "log.csv", text(20)
    file.write_text("\n".join(["t,q1,mode", *lines, odd, *lines]), encoding="utf-8")
    table = read_csv(file)
    if odd:
        with pytest.raises(InputError, match="line 22, column q1"):
            table.numbers("q1")
    else:
        assert len(table.numbers("q1")) == 40
        assert table.where(20, "q1") == "line 23, column q1"
