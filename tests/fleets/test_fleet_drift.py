"""A fleet over time: what changed is found on the unit and the day where it changed, and on no other."""

from __future__ import annotations

from datetime import datetime, timedelta, timezone
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import ArrayLike

from gapscope.many import compare
from gapscope.many.compare import fleet_document
from gapscope.many.pages import change_line, headline, render_fleet
from gapscope.many.rows import FleetStore

FIRST = datetime(2026, 1, 1)
DAYS = 12


def fill(
    folder: Path, values: dict[str, ArrayLike], first: int = 0, **case: Any
) -> FleetStore:
    """A store with a value of Coulomb friction for each unit and day, not finite if it is not named."""
    store, cases, effects = FleetStore(folder), [], []
    for unit, of_unit in values.items():
        for day, value in enumerate(np.array(of_unit, dtype=float), first):
            cases.append(row_of(unit, day) | case)
            if np.isfinite(value):
                effects.append(effect_of(cases[-1], value))
    store.append(cases, effects)
    return store


def row_of(unit: str, day: int) -> dict[str, Any]:
    """The row of a case."""
    time, place = FIRST + timedelta(days=day), f"{unit}/{day}"
    row = {"result": f"{unit}-{day}", "case": f"/cases/{place}", "unit": unit}
    row |= {"robot": "two joints/a", "joints": ["yaw", "pitch"], "nominal_sha256": "n"}
    row |= {"date": f"{time:%Y-%m-%d}", "recorded_at": time}
    row |= {"finished": datetime.now(timezone.utc), "tries": 1, "error": ""}
    row |= {"verdict": "effects_found", "effects": ["coulomb_friction"]}
    row |= {"excess": 0.1 * len(unit), "gap": 0.2, "left": 0.0}
    row |= {"recorded_seconds": 60.0, "processor_seconds": 5.0}
    return row | {"kept": f"diagnoses/{place}"}


def effect_of(row: dict[str, Any], value: float) -> dict[str, Any]:
    """The number of an effect."""
    keys = ("result", "case", "unit", "robot", "date", "nominal_sha256")
    number = {key: row[key] for key in keys}
    number |= {"effect": "coulomb_friction", "joint": 2, "named": True}
    number |= {"parameter": "torque", "component": "", "si_unit": "N m"}
    return number | {"value": value, "std": 0.02, "share": 0.5}


def quiet(seed: int, units: int, std: float) -> dict[str, np.ndarray]:
    """Units whose friction of 2 N m does not change."""
    values = 2.0 + std * np.random.default_rng(seed).standard_normal((units, DAYS))
    return {f"arm{k:02d}": of_unit for k, of_unit in enumerate(values)}


def test_a_step_is_found_and_nothing_else(tmp_path: Path) -> None:
    values = quiet(1, 20, 0.06)
    values["arm07"][5:] += 0.6
    values["arm09"][:8] = np.nan
    content = fleet_document(fill(tmp_path, values))
    step, appeared = content["changes"]
    assert (step["unit"], step["kind"], step["joint"]) == ("arm07", "value", 2)
    assert (step["last_before"], step["first_after"]) == ("2026-01-05", "2026-01-06")
    assert step["kept"] == "diagnoses/arm07/5"
    rise = step["after"]["value"] - step["before"]["value"]
    assert rise == pytest.approx(0.6, abs=0.1)
    assert (appeared["unit"], appeared["kind"]) == ("arm09", "appeared")
    assert appeared["first_after"] == "2026-01-09"
    assert "torque from 2.0" in change_line(step)
    (robot,) = content["robots"]
    (effect,) = robot["effects"]
    assert (robot["units"], effect["units"]) == (20, 20)
    assert effect["kind"] == "shared_differing_size"
    assert effect["parameters"][0]["extremes"][0]["unit"] == "arm07"
    kept = tmp_path / "diagnoses/arm07/5"
    kept.mkdir(parents=True)
    (kept / "report.html").touch()
    render_fleet(content, tmp_path / "fleet.html")
    page = (tmp_path / "fleet.html").read_text("utf-8")
    assert 'href="diagnoses/arm07/5/report.html"' in page
    assert page.count('class="sparkline"') == 2
    assert headline(content).endswith("2 units changed")


def test_units_that_changed_are_counted_beyond_the_list(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    values = quiet(4, 20, 0.06)
    for of_unit in list(values.values())[:5]:
        of_unit[5:] += 1.0
    monkeypatch.setattr(compare, "MOST", 2)
    content = fleet_document(fill(tmp_path, values))
    assert len(content["changes"]) == 2 < content["changes_in_all"]
    assert headline(content).endswith("5 units changed")


def test_scatter_of_the_whole_fleet_is_no_change(tmp_path: Path) -> None:
    """Estimates that scatter five times as much as they say, as from day to day."""
    values = quiet(2, 20, 5 * 0.063)
    content = fleet_document(fill(tmp_path, values))
    assert content["changes"] == []
    (scatter,) = content["scatter"]
    assert scatter["factor"] == pytest.approx(5.0, rel=0.2)


def test_a_new_nominal_arm_is_no_change(tmp_path: Path) -> None:
    values = quiet(3, 4, 0.06)
    fill(tmp_path, values)
    later = {unit: old + 1.0 for unit, old in values.items()}
    store = fill(tmp_path, later, first=DAYS, nominal_sha256="m")
    content = fleet_document(store)
    assert content["cases"] == 8 * DAYS and content["changes"] == []


def test_the_last_row_of_a_case_and_date_counts(tmp_path: Path) -> None:
    store = fill(tmp_path, {"arm": [1.0, 1.0]})
    newer = row_of("arm", 0) | {"result": "newer", "excess": 7.0}
    store.append([newer], [effect_of(newer, 3.0)])
    for _ in range(2):
        cases = store.cases()
        assert sorted(cases["result"]) == ["arm-1", "newer"]
        values = store.effects("two joints/a", cases["result"])["value"]
        assert sorted(values) == [1.0, 3.0]
        store.merge()  # changes nothing but the number of files
    assert len(list((tmp_path / "cases").rglob("*.parquet"))) == 2


def test_a_failure_counts_until_the_case_is_diagnosed(tmp_path: Path) -> None:
    failed = {"robot": "unknown", "error": "lost", "date": "2025-12-31"}
    store = fill(tmp_path, {"arm": [np.nan]}, **failed)
    assert fleet_document(store)["failed"] == 1
    fill(tmp_path, {"arm": [1.0]})
    content = fleet_document(store)
    assert (content["failed"], content["cases"]) == (0, 1)
