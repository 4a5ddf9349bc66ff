"""Dates in names, and which unit a diagnosis is of."""

from __future__ import annotations

from datetime import datetime

import pytest

from gapscope.many.rows import split_date, unit_name


@pytest.mark.parametrize(
    ("name", "date", "rest"),
    [
        ("2026-03-14", datetime(2026, 3, 14), ""),
        ("2026-03", datetime(2026, 3, 1), ""),
        ("arm7_2026_03_14", datetime(2026, 3, 14), "arm7"),
        ("20260314-cell_B", datetime(2026, 3, 14), "cell_B"),
        ("rosbag2_2026_03_14-09_30_05", datetime(2026, 3, 14, 9, 30, 5), "rosbag2"),
        ("a 2026-03-14T0930 b", datetime(2026, 3, 14, 9, 30), "a_b"),
        ("arm7", None, "arm7"),
        ("serial-20261399", None, "serial-20261399"),
        ("2026-02-30", None, "2026-02-30"),
        ("part120260314", None, "part120260314"),
        ("run2026031", None, "run2026031"),
    ],
)
def test_a_date_is_split_off_a_name(name, date, rest):
    assert split_date(name) == (date, rest)


@pytest.mark.parametrize(
    ("case", "folder", "by_case", "by_folder"),
    [
        ("arm7", "2026-03/arm7", "arm7", "arm7"),
        ("arm7_2026-03-14", "arm7_2026-03-14", "arm7", "arm7"),
        ("2026-03-14", "hall/arm7/2026-03-14", "arm7", "arm7"),
        ("run_3", "arm7/run_3", "run_3", "arm7"),
        ("run_3", "arm7/2026-03/run_3", "run_3", "arm7"),
        ("2026-03-14", ".", "2026-03-14", "2026-03-14"),
    ],
)
def test_the_unit_is_what_a_name_says_besides_the_date(
    case, folder, by_case, by_folder
):
    assert unit_name(case, folder) == by_case
    assert unit_name(case, folder, "folder") == by_folder
