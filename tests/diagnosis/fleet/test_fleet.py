"""Units of one type of arm: what they share, whether values agree, and which unit is which."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import Any

import documents
import numpy as np
import pytest
from cases import case_of
from hypothesis import given, settings
from hypothesis import strategies as st
from sweeps import daily
from synthetic import Truth, arm, recordings

from gapscope.arm.display import percent
from gapscope.arm.errors import InputError
from gapscope.arm.io.json_file import write_json
from gapscope.arm.io.write_case import write_case
from gapscope.arm.robots import load_nominal_arm
from gapscope.diagnosis.change_points import (
    appearance,
    change_point,
    change_points,
    scatter,
)
from gapscope.diagnosis.compare_units import (
    DIFFERING,
    NOMINAL,
    ONE,
    SHARED,
    SOME,
    ConfusionColumn,
    FleetUnit,
    compare,
    confusion_column,
    explains_as_much,
    grouped,
    groups,
    other_laws,
    pooled,
    read_ranges,
    units_document,
)
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.corrected_file import write_corrected
from gapscope.many.pages import render_summary
from gapscope.many.rows import Row
from gapscope.many.units import ALIKE, findings, heading, own_rows, told_apart

Found = tuple[str, list[int], dict[str, tuple[Any, Any]]]


def unit(*effects: Found) -> dict[str, Any]:
    """A diagnosis with effects, each a name, joints, and value and deviation of its parameters."""
    document = documents.no_gap()
    document["verdict"] = "effects_found" if effects else "no_gap"
    document["effects"] = []
    for name, joints, parameters in effects:
        entry = documents.two_effects()["effects"][0]
        entry |= {"effect": name, "joints": joints, "share": 0.5, "alternatives": []}
        entry["parameters"] = {
            key: {"unit": "N m", "value": value, "std": std}
            for key, (value, std) in parameters.items()
        }
        document["effects"].append(entry)
    return document


def coulomb(
    values: list[float], stds: list[float] | None, joints: list[int]
) -> dict[str, Any]:
    return unit(("coulomb_friction", joints, {"torque": (values, stds)}))


def kinds(*units: dict[str, Any]) -> dict[tuple[str, int | None], str]:
    found = compare({f"u{k}": one for k, one in enumerate(units)})
    return {(r["effect"], r["joint"]): r["kind"] for r in found}


# Values of one effect on several units, pooled.


def test_pooled_values_by_hand() -> None:
    """Q = 2 (1/2)^2 / 0.1^2 = 50; tau^2 = (Q - 1) / (sum w - sum w^2 / sum w) = 49 / 100."""
    found = pooled([1.0, 2.0], [0.1, 0.1], form=0.0)
    assert (found.q, found.i_squared) == pytest.approx((50.0, 0.98))
    assert (found.between, found.estimate) == pytest.approx((0.7, 1.5))
    assert found.std == pytest.approx(np.sqrt((0.01 + 0.49) / 2))
    # what the form of an effect may be off by is no difference
    assert pooled([3.0, 3.1], [1e-4, 1e-4]).p > 0.05
    assert pooled([3.0, 3.1], [1e-4, 1e-4], form=0.0).p < 1e-6


def test_false_alarms_come_at_the_level() -> None:
    """Of values that differ by their deviations alone, one in a hundred has a p below 0.01."""
    rng, stds = np.random.default_rng(4), [0.2, 0.5, 0.3, 0.4]
    draws = (list(3.0 + rng.normal(0.0, stds)) for _ in range(4000))
    p = np.array([pooled(values, stds, form=0.0).p for values in draws])
    assert 0.005 < (p < 0.01).mean() < 0.017


# What units share.


DEVIATIONS = st.lists(st.floats(0.0, 10.0), min_size=2, max_size=2)


@settings(deadline=None)
@given(
    values=st.lists(st.floats(-1e3, 1e3), min_size=2, max_size=2),
    stds=st.lists(st.none() | DEVIATIONS, min_size=2, max_size=5),
)
def test_identical_values_on_all_units_are_shared(
    values: list[float], stds: list[list[float] | None]
) -> None:
    found = kinds(*(coulomb(values, std, [2, 5]) for std in stds))
    assert found == dict.fromkeys([(FRICTION, 2), (FRICTION, 5)], SHARED)


FRICTION, RIPPLE = "coulomb_friction", "torque_ripple"
PAYLOAD = ("payload", [], {"mass": (1.0, 0.1), "com": ([0.0, 0.0, 0.1], [0.01] * 3)})


def rubbing(*torque: float) -> Found:
    return (FRICTION, [1, 2], {"torque": (list(torque), [0.1, 0.1])})


def test_each_kind() -> None:
    play = ("backlash", [3], {"width": ([0.01], [0.001])})
    first = unit(rubbing(1.0, 2.0), play, PAYLOAD)
    found = kinds(first, unit(rubbing(1.1, 4.0), PAYLOAD), unit(rubbing(0.9, 2.0)))
    expected = {(FRICTION, 1): SHARED, (FRICTION, 2): DIFFERING}
    assert found == expected | {("payload", None): SOME, ("backlash", 3): ONE}


def test_links_are_kept_apart_and_phases_repeat_after_a_turn() -> None:
    values = ({"link": (link, None), "mass": (0.5, 0.1)} for link in (2, 3))
    links = [unit(("link_inertia", [], value)) for value in values]
    rows = compare({"a": links[0], "b": links[1]})
    assert [(row["link"], row["kind"]) for row in rows] == [(2, ONE), (3, ONE)]
    phases = (0.02, 2 * np.pi - 0.02)
    turned = (unit((RIPPLE, [1], {"phase": ([phase], [0.05])})) for phase in phases)
    assert kinds(*turned) == {(RIPPLE, 1): SHARED}


def test_the_same_under_another_name_is_told() -> None:
    lagging = unit(("actuator_lag", [4], {"time_constant": ([0.01], [0.001])}))
    found = compare({"a": lagging, "b": documents.two_effects()})
    (lag,) = (row for row in found if row["effect"] == "actuator_lag")
    assert lag["kind"] == ONE and lag["instead"] == {"b": "actuator_delay"}


def test_only_arms_of_one_type_are_compared() -> None:
    other, bare = documents.no_gap(), documents.no_gap()
    other["arm"]["robot"] = "another"
    del bare["arm"]
    units = {"a": documents.no_gap(), "b": documents.two_effects()}
    found = groups(units | {"c": other, "d": bare})
    assert [list(members) for members in found.values()] == [["a", "b"], ["c"]]


# Which unit a case is of.


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> list[FleetUnit]:
    """Three units: with friction, like it but for its noise, and with a load; each corrected by the truth."""
    folder, com = tmp_path_factory.mktemp("fleet"), (0.1, 0.02, 0.05)
    friction = AppliedEffect(FRICTION, (2,), {"torque": [3.0]})
    load = AppliedEffect("payload", (), {"mass": 1.2, "com": com})
    rough = Truth(coulomb=(0.0, 3.0, 0.0))
    truths = {"rough": (rough, friction), "twin": (rough, friction)}
    truths["loaded"] = (Truth(mass=1.2, com=com), load)
    units = []
    for seed, (name, (truth, effect)) in enumerate(truths.items()):
        made = case_of(name, arm(), *recordings(truth, seed, duration=4.0))
        write_case(made, folder / name)
        write_corrected(name, (effect,), folder / f"{name}.yaml")
        units.append(FleetUnit(name, folder / name, folder / f"{name}.yaml"))
    return units


def test_each_unit_is_known_but_for_its_twin(
    fleet: list[FleetUnit], tmp_path: Path
) -> None:
    columns = {u.name: confusion_column(u, fleet) for u in fleet}
    assert not any(made.problem for made in columns.values())
    assert columns["loaded"].best == "loaded"
    confused = {name: made.confused_with for name, made in columns.items()}
    assert confused == {"loaded": (), "rough": ("twin",), "twin": ("rough",)}
    for name, made in columns.items():
        own, nominal = made.mean(name), made.mean(NOMINAL)
        assert own is not None and nominal is not None and own < 0.5 * nominal
    # a case that cannot be read is a column without values
    gone = FleetUnit("gone", tmp_path / "gone", fleet[0].corrected)
    made = confusion_column(gone, fleet)
    assert "no such file" in made.problem
    assert (made.best, made.confused_with) == (None, ())


@pytest.mark.parametrize(("name", "confused"), [("a", ("b",)), ("b", ())])
def test_not_best_served_by_its_own_arm(name: str, confused: tuple[str, ...]) -> None:
    rows = {"nominal": [0.5, 0.5], "a": [0.2, 0.2], "b": [0.3, 0.05]}
    column = ConfusionColumn(name, {key: np.array(x) for key, x in rows.items()})
    assert (column.best, column.confused_with) == ("b", confused)


def test_an_arm_predicts_with_all_that_its_file_holds(
    fleet: list[FleetUnit], tmp_path: Path
) -> None:
    """A load that no effect names but the remainder of the last link."""
    remainder, file = np.zeros((3, 10)), tmp_path / "corrected.yaml"
    remainder[2, :4] = 1.2, 0.12, 0.024, 0.06
    write_corrected("loaded", (), file, remainder=remainder)
    (loaded,) = (replace(u, corrected=file) for u in fleet if u.name == "loaded")
    made = confusion_column(loaded, [loaded])
    own, nominal = made.mean("loaded"), made.mean(NOMINAL)
    assert own is not None and nominal is not None and own < 0.5 * nominal


@pytest.mark.parametrize("fault", ["zero_offset", "unmeasured_torque"])
def test_a_unit_whose_case_cannot_be_predicted_takes_no_part(
    fault: str, tmp_path: Path
) -> None:
    found = {"a": unit(), "b": unit(), "c": unit((fault, [2], {}))}
    units = [FleetUnit(n, tmp_path / n, tmp_path / f"{n}.yaml") for n in found]
    (group,), _ = grouped(found, units)
    assert set(group.left_out) == {"c"}


# The document of the units, in words and in the summary.


@pytest.fixture
def content(tmp_path: Path) -> dict[str, Any]:
    """Two units compared, without recordings; a third whose set-up is at fault."""
    found = {"a": coulomb([1.0, 2.0], None, [2, 5])}
    found["b"] = coulomb([1.0, 3.0], None, [2, 5])
    found["c"] = unit(("sign_flip", [2], {}))
    units = [FleetUnit(n, tmp_path / n, tmp_path / f"{n}.yaml") for n in found]
    (group,), alone = grouped(found, units)
    assert group.left_out == {"c": "its set-up is at fault: sign flip"} and alone == ()
    assert [u.name for u in group.units] == ["a", "b"]
    same = np.array([0.1, 0.1])
    rows = {"nominal": np.array([0.5, 0.4]), "a": same, "b": same}
    unread = ConfusionColumn("b", {}, "cannot be read")
    compared = [(group, [ConfusionColumn("a", rows), unread])]
    parameters = {"coulomb": {"unit": "N m", "value": 1.0, "std": 0.01}}
    own = {"unit": "b", "what": "friction", "joints": [5], "probability": 0.99}
    return units_document(compared, ["d"], [[own | {"parameters": parameters}]])


def test_the_document_is_whole_and_plain_json(content: dict[str, Any]) -> None:
    assert json.loads(json.dumps(content, allow_nan=False)) == content
    assert content["alone"] == ["d"]
    confusion = content["groups"][0]["confusion"]
    assert set(confusion["left_out"]) == {"b", "c"}
    assert (confusion["rows"], confusion["columns"]) == (["nominal", "a", "b"], ["a"])
    assert confusion["torque_nrmse"] == [[0.45], [0.1], [0.1]]
    assert (confusion["best"], confusion["confused_with"]) == ({"a": "a"}, {"a": ["b"]})


def test_units_in_words(content: dict[str, Any]) -> None:
    (group,) = content["groups"]
    places = {(f["name"], f["place"], f["label"]) for f in findings(group)}
    assert places >= {
        ("Coulomb friction", "joint 2", "on 2 of 3 units, alike"),
        ("Coulomb friction", "joint 5", "on 2 of 3 units, sizes differ"),
        ("Sign flip", "joint 2", "only on c"),
    }
    assert own_rows(group) == [
        ("b", "Friction of joint 5", "coulomb 1.000 ± 0.010 N m", percent(0.99))
    ]
    meaning = {f["place"]: f["meaning"] for f in findings(group)}
    # of joint 2 the recordings show nothing of the kind
    assert meaning["joint 5"] != ALIKE == meaning["joint 2"]
    assert heading(group) == (
        "Effects found: none is shared by all units; 2 on some units and 1 on one unit alone."
    )
    assert told_apart(group["confusion"]) == [
        "a cannot be told from b: its corrected arm predicts a as well as its own does "
        "(or worse by less than 0.01 NRMSE on every joint)."
    ]


def test_units_in_the_summary_with_names_escaped(tmp_path: Path) -> None:
    evil = "<script>alert(1)</script>"
    found = {name: documents.two_effects() for name in (evil, "b")}
    for document in found.values():
        document["arm"]["robot"] = evil
    units = [FleetUnit(name, tmp_path, tmp_path) for name in found]
    (group, *_), alone = grouped(found, units)
    rows = {"nominal": np.array([0.5]), evil: np.array([0.1]), "b": np.array([0.3])}
    told_apart = rows | {"b": np.array([0.05])}
    columns = [ConfusionColumn(evil, rows), ConfusionColumn("b", told_apart)]
    page = tmp_path / "s.html"
    cases = [Row(name, name, document) for name, document in found.items()]
    render_summary(cases, page, units_document([(group, columns)], alone, [None]))
    html = page.read_text(encoding="utf-8")
    assert evil not in html and "<script" not in html
    expected = ("on all 2 units, alike", "+1.051 ± 0.013", "Which unit is this?")
    missing = [x for x in (*expected, "can be told apart", "0.050") if x not in html]
    assert missing == []


# Most units tell the law of a joint on which all have friction; the others are asked again without their own.


PLAIN = (FRICTION, [2], {"torque": ([2.0], [0.1])})
CURVED = ("saturating_friction", [2], {"torque": ([2.0], [0.1])})
ELSEWHERE = ("saturating_friction", [3], {"torque": ([1.0], [0.1])})


@pytest.mark.parametrize(
    ("laws", "asked"),
    [
        ([(PLAIN,), (CURVED,), (PLAIN,)], {1: (CURVED[0],)}),
        # a law that the type has on another joint stays
        ([(PLAIN, ELSEWHERE), (CURVED, ELSEWHERE), (PLAIN, ELSEWHERE)], {}),
        ([(PLAIN,), (CURVED,)], {}),
        ([(PLAIN,), (CURVED,), ()], {}),
        ([(PLAIN,), (PLAIN,), (PLAIN,)], {}),
        ([(PLAIN,), (PLAIN,), (CURVED,), (CURVED,)], {}),
    ],
)
def test_the_odd_one_is_asked_again(
    laws: list[tuple[Found, ...]], asked: dict[int, tuple[str, ...]]
) -> None:
    assert other_laws({k: unit(*some) for k, some in enumerate(laws)}) == asked


def test_it_explains_as_much_up_to_what_an_effect_closes() -> None:
    before, asked = unit(CURVED), unit(PLAIN)
    left = np.array(before["gap"]["after"]["torque_nrmse"])
    for more, as_much in ((0.009, True), (0.011, False)):
        asked["gap"]["after"]["torque_nrmse"] = (left + more).tolist()
        assert explains_as_much(asked, before) is as_much
    before["verdict"] = "no_gap"
    assert not explains_as_much(before, unit(PLAIN))


# Change points: values by hand, rates of false alarms, and changes that are found where they are.


@pytest.mark.parametrize("n", daily((3, 12, 50), 12))
def test_false_alarms_are_no_more_than_stated(n: int) -> None:
    rng, count = np.random.default_rng(n), 1500
    p = np.empty(count)
    for k in range(count):
        stds = np.exp(rng.normal(0.0, 0.5, n))
        p[k] = change_point(stds * rng.standard_normal(n), stds).p
    # three standard deviations of the count above 5 %, and no less than half of it: a bound that is of use
    assert 0.025 < (p <= 0.05).mean() < 0.05 + 3 * np.sqrt(0.05 * 0.95 / count)


def test_several_changes_are_found_in_order() -> None:
    rng = np.random.default_rng(1)
    values = np.repeat([1.0, 2.0, 1.5], 10) + 0.05 * rng.standard_normal(30)
    found = change_points(values, np.full(30, 0.05), level=0.001)
    assert [change.position for change in found] == [10, 20]
    assert change_points(values[:10], np.full(10, 0.05), level=0.001) == ()
    assert change_points(values[9:11], np.full(2, 0.05), level=0.001) == ()


def test_appearance_counts_all_orders() -> None:
    found = appearance([False] * 5 + [True] * 3)
    assert (found.position, found.before, found.after) == (5, 0.0, 1.0)
    assert found.p == pytest.approx(2 / 56)
    n, m = 9, 4
    orders = [[k in chosen for k in range(n)] for chosen in combinations(range(n), m)]
    p = np.array([appearance(order).p for order in orders])
    # exact: as many orders as it says have a probability as small
    for level in np.unique(p):
        assert (p <= level + 1e-12).mean() == pytest.approx(level)


def test_scatter_is_seen_beside_changes() -> None:
    rng = np.random.default_rng(2)
    histories = [(3.0 * rng.standard_normal(10), np.ones(10)) for _ in range(100)]
    for values, _ in histories[:10]:
        values[5:] += 50.0
    assert scatter(histories) == pytest.approx(3.0, rel=0.1)
    assert scatter([(0.1 * values, stds) for values, stds in histories]) == 1.0
    assert scatter(histories[:1]) == 1.0


# Ranges from the files of diagnoses: which deviation belongs to which value, and files that do not fit.


def written(
    folder: Path, delay: list[float], std: list[Any]
) -> tuple[CorrectedArm, Path]:
    """The files of a diagnosis with a delay of joints 4 and 5: its corrected arm."""
    folder.mkdir()
    document = documents.one_possible()
    (finding,) = document["effects"]
    finding["parameters"] = {"delay": {"unit": "s", "value": delay, "std": std}}
    write_json(document, folder / "diagnosis.json")
    effects = (AppliedEffect("actuator_delay", (4, 5), {"delay": delay}),)
    file = folder / "corrected.yaml"
    write_corrected("unit", effects, file)
    return CorrectedArm(load_nominal_arm("xarm6"), effects), file


def test_ranges_are_the_intervals_of_one_unit_or_span_those_of_several(
    tmp_path: Path,
) -> None:
    arm, file = written(tmp_path / "a", [0.008, 0.014], [0.001, None])
    (found,) = read_ranges(file, arm, ()).ranges
    assert found.low.parameters["delay"] == pytest.approx([0.00604, 0.014])
    assert found.high.parameters["delay"] == pytest.approx([0.00996, 0.014])
    written(tmp_path / "b", [0.010, 0.012], [0.0, 0.0])
    (found,) = read_ranges(file, arm, (tmp_path / "b",)).ranges
    assert found.low.parameters["delay"] == pytest.approx([0.00604, 0.012])
    assert found.high.parameters["delay"] == pytest.approx([0.010, 0.014])


def test_a_file_without_its_own_diagnosis_has_no_ranges(tmp_path: Path) -> None:
    arm, file = written(tmp_path / "a", [0.008, 0.014], [0.0, 0.0])
    diagnosis = file.with_name("diagnosis.json")
    other = (AppliedEffect("actuator_delay", (4, 5), {"delay": [0.008, 0.02]}),)
    write_corrected("unit", other, file)
    with pytest.raises(InputError, match="no actuator_delay with the values") as error:
        read_ranges(file, CorrectedArm(arm.arm, other), ())
    assert error.value.file == diagnosis
    diagnosis.unlink()
    with pytest.raises(InputError, match=r"diagnosis\.json"):
        read_ranges(file, arm, ())
