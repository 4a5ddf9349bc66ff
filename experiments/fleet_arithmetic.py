"""From the figures of ``45_fleet_cost.py`` to machines, storage and network of 100 000 robots."""

from __future__ import annotations

from typing import Any

ROBOTS = 100_000
MINUTES = (1, 10)
"""Recorded minutes that each robot sends a day."""
CORES, BUSY = 32, 0.7
"""Cores of a machine, and the share of time that they work; the rest is starts, lost workers and uneven load."""
COMPARED = 30
"""Days of diagnoses that are compared at once."""
PART_HOURS = 8
"""Hours of the day in which all diagnoses have to be made."""

Figures = dict[str, Any]


def print_tables(figures: Figures) -> None:
    """Print what is known as Markdown."""
    if "cost" in figures:
        _print_cost(figures["cost"])
    if {"driver", "compare"} <= figures.keys():
        _print_driver(figures["driver"], figures["compare"])
    if {"cost", "driver", "compare"} <= figures.keys():
        _print_fleet(figures)
    if "alarms" in figures:
        _print_alarms(figures["alarms"])


def _print_cost(cost: Figures) -> None:
    rows = {
        "cases, recorded": f"{cost['cases']}, {cost['recorded_hours']:.3g} h",
        "processor time per case": f"{cost['processor_seconds_per_case']:.2f} s",
        "of it, fixed and per recorded second": f"{cost['processor_seconds_fixed']:.2f} s, "
        f"{cost['processor_seconds_per_second']:.3f} s/s",
        "per robot-hour of these short cases": f"{cost['processor_hours_per_robot_hour']:.3f} core hours",
        "recordings (CSV)": f"{cost['input_bytes_per_hour'] / 1e6:.0f} MB/h",
        "Parquet, a few rows a file": f"{cost['parquet_bytes_per_case'] / 1e3:.1f} kB per case",
        "diagnosis.json, corrected.yaml": f"{cost['kept_bytes_per_case'] / 1e3:.1f} kB per case",
        "peak memory of the driver": f"{cost['driver_memory_mb']:.0f} MB, before the run "
        f"{cost['driver_memory_before_mb']:.0f} MB"
        + (" (the driver is the worker)" if cost["driver_is_worker"] else ""),
    }
    _table(("measured", "value"), [list(row) for row in rows.items()])


def _print_driver(driver: Figures, compare: Figures) -> None:
    rows = {
        "driver, per case": f"{1e3 * driver['processor_seconds_per_case']:.1f} ms, "
        f"{driver['memory_bytes_per_case'] / 1e3:.1f} kB",
        "comparison, per case": f"{1e3 * compare['processor_seconds_per_case']:.2f} ms, "
        f"{compare['memory_bytes_per_case'] / 1e3:.1f} kB",
        "Parquet, thousands of rows a file": f"{compare['parquet_bytes_per_case']:.0f} bytes per case",
    }
    _table(("measured", "value"), [list(row) for row in rows.items()])


def _print_fleet(figures: Figures) -> None:
    """One case per robot and day of one or of 60 minutes."""
    columns = [_column(figures, minutes) for minutes in MINUTES]
    head = ("100 000 robots, a day", *(f"{m} min recorded per robot" for m in MINUTES))
    _table(head, [[name, *(c[name] for c in columns)] for name in columns[0]])


def _column(figures: Figures, minutes: int) -> dict[str, str]:
    cost, driver = figures["cost"], figures["driver"]
    compare = figures["compare"]
    seconds = 60 * minutes
    per_case = (
        cost["processor_seconds_fixed"] + seconds * cost["processor_seconds_per_second"]
    )
    core_hours = ROBOTS * per_case / 3600
    machines = core_hours / (CORES * BUSY * PART_HOURS)
    received = ROBOTS * minutes / 60 * cost["input_bytes_per_hour"]
    # files of a few rows are mostly footer: rows by the thousand are those of the store that is compared
    written = compare["parquet_bytes_per_case"] + cost["kept_bytes_per_case"]
    results = ROBOTS * written
    rate = received * 8 / (PART_HOURS * 3600)
    compared = COMPARED * ROBOTS
    compare_seconds = compared * compare["processor_seconds_per_case"]
    return {
        "processor time per case": f"{per_case:.1f} s",
        "core hours": f"{core_hours:,.0f}",
        f"machines of {CORES} cores, {BUSY:.0%} busy, {PART_HOURS} h a day": f"{machines:.1f}",
        "recordings read": f"{received / 1e12:.2f} TB",
        f"network into the machines, over {PART_HOURS} h": f"{rate / 1e9:.2f} Gbit/s",
        "results written": f"{results / 1e9:.1f} GB",
        "requests to the storage (list, 4 files)": f"{ROBOTS * 5:,}",
        "driver, processor time": f"{ROBOTS * driver['processor_seconds_per_case'] / 60:.0f} min",
        "driver, memory on top of 300 MB": f"{ROBOTS * driver['memory_bytes_per_case'] / 1e6:.0f} MB",
        f"comparison of {COMPARED} days, processor time": f"{compare_seconds / 60:.0f} min",
        f"comparison of {COMPARED} days, memory": f"{compared * compare['memory_bytes_per_case'] / 1e9:.1f} GB",
    }


def _print_alarms(alarms: Figures) -> None:
    levels = alarms["level_at_0.01"]
    _table(
        ("diagnoses of a unit", *levels),
        [
            [
                "false alarms at p = 1 %",
                *(f"{100 * value:.2f} %" for value in levels.values()),
            ]
        ],
    )
    rows = [
        [
            f"{f['diagnoses']}",
            f"{f['step']:g}",
            f"{f['scatter']:g}",
            f"{100 * f['false']:.1f} %",
            "" if not f["step"] else f"{100 * f['found']:.0f} %",
        ]
        for f in alarms["fleets"]
    ]
    _table(
        (
            "diagnoses",
            "step [std]",
            "scatter / stated",
            "false among reported",
            "changed units found",
        ),
        rows,
    )


def _table(head: tuple[str, ...], rows: list[list[str]]) -> None:
    for row in (list(head), ["---"] * len(head), *rows):
        print(f"| {' | '.join(row)} |")
    print()
