"""Units of one type of arm: what they share, whether values agree, and which unit is which."""

from __future__ import annotations

import copy
import json
from itertools import combinations
from pathlib import Path
from typing import Any

import documents
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import norm
from synthetic import Truth, arm, recordings

from gapscope.arm.case import Case
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
from gapscope.many.units import findings, heading, told_apart


def unit(*effects: tuple[str, list[int], dict[str, tuple[Any, Any]]]) -> dict[str, Any]:
    """A diagnosis with effects, each a name, joints, and value and deviation of its parameters."""
    document = documents.no_gap()
    document["verdict"] = "effects_found" if effects else "no_gap"
    template = documents.two_effects()["effects"][0]
    document["effects"] = [
        copy.deepcopy(template)
        | {
            "effect": name,
            "joints": joints,
            "share": 0.5,
            "alternatives": [],
            "parameters": {
                key: {"unit": "N m", "value": v, "std": s}
                for key, (v, s) in parameters.items()
            },
        }
        for name, joints, parameters in effects
    ]
    return document


def coulomb(
    values: list[float], stds: list[float] | None, joints: list[int]
) -> dict[str, Any]:
    return unit(("coulomb_friction", joints, {"torque": (values, stds)}))


def kinds(**units: dict[str, Any]) -> dict[tuple[str, int | None], str]:
    return {(r["effect"], r["joint"]): r["kind"] for r in compare(units)}


class TestPooled:
    def test_golden_values_by_hand(self) -> None:
        """Q = 2 (1/2)^2 / 0.1^2 = 50; tau^2 = (Q - 1) / (sum w - sum w^2 / sum w) = 49 / 100."""
        found = pooled([1.0, 2.0], [0.1, 0.1], form=0.0)
        assert found.q == pytest.approx(50.0) and found.i_squared == pytest.approx(0.98)
        assert found.between == pytest.approx(0.7) and found.estimate == pytest.approx(
            1.5
        )
        assert found.std == pytest.approx(np.sqrt((0.01 + 0.49) / 2))

    def test_false_alarms_come_at_the_level(self) -> None:
        """Of values that differ by their deviations alone, one in a hundred has a p below 0.01."""
        rng = np.random.default_rng(4)
        stds = [0.2, 0.5, 0.3, 0.4]
        p = [
            pooled(list(3.0 + rng.normal(0.0, stds)), stds, form=0.0).p
            for _ in range(4000)
        ]
        assert 0.005 < np.mean(np.array(p) < 0.01) < 0.017

    def test_form_of_the_effects_is_no_difference(self) -> None:
        assert pooled([3.0, 3.1], [1e-4, 1e-4]).p > 0.05
        assert pooled([3.0, 3.1], [1e-4, 1e-4], form=0.0).p < 1e-6


class TestCompare:
    @given(
        values=st.lists(st.floats(-1e3, 1e3), min_size=2, max_size=2),
        stds=st.lists(
            st.one_of(
                st.none(), st.lists(st.floats(0.0, 10.0), min_size=2, max_size=2)
            ),
            min_size=2,
            max_size=5,
        ),
    )
    def test_identical_values_on_all_units_are_shared(
        self, values: list[float], stds: list[list[float] | None]
    ) -> None:
        units = {f"u{i}": coulomb(values, s, [2, 5]) for i, s in enumerate(stds)}
        assert kinds(**units) == {
            ("coulomb_friction", 2): SHARED,
            ("coulomb_friction", 5): SHARED,
        }

    def test_each_kind(self) -> None:
        a = unit(
            ("coulomb_friction", [1, 2], {"torque": ([1.0, 2.0], [0.1, 0.1])}),
            ("backlash", [3], {"width": ([0.01], [0.001])}),
            (
                "payload",
                [],
                {"mass": (1.0, 0.1), "com": ([0.0, 0.0, 0.1], [0.01, 0.01, 0.01])},
            ),
        )
        b = unit(
            ("coulomb_friction", [1, 2], {"torque": ([1.1, 4.0], [0.1, 0.1])}),
            (
                "payload",
                [],
                {"mass": (1.0, 0.1), "com": ([0.0, 0.0, 0.1], [0.01, 0.01, 0.01])},
            ),
        )
        c = coulomb([0.9, 2.0], [0.1, 0.1], [1, 2])
        assert kinds(a=a, b=b, c=c) == {
            ("coulomb_friction", 1): SHARED,
            ("coulomb_friction", 2): DIFFERING,
            ("payload", None): SOME,
            ("backlash", 3): ONE,
        }

    def test_links_are_kept_apart(self) -> None:
        a, b = (
            unit(("link_inertia", [], {"link": (link, None), "mass": (0.5, 0.1)}))
            for link in (2, 3)
        )
        assert [(row["link"], row["kind"]) for row in compare({"a": a, "b": b})] == [
            (2, ONE),
            (3, ONE),
        ]

    def test_phases_repeat_after_a_turn(self) -> None:
        a, b = (
            unit(("torque_ripple", [1], {"phase": ([phase], [0.05])}))
            for phase in (0.02, 2 * np.pi - 0.02)
        )
        assert kinds(a=a, b=b) == {("torque_ripple", 1): SHARED}

    def test_the_same_under_another_name_is_told(self) -> None:
        a, b = (
            unit(("actuator_lag", [4], {"time_constant": ([0.01], [0.001])})),
            documents.two_effects(),
        )
        rows = {row["effect"]: row for row in compare({"a": a, "b": b})}
        lag = rows["actuator_lag"]
        assert lag["kind"] == ONE and lag["instead"] == {"b": "actuator_delay"}

    def test_only_arms_of_one_type_are_compared(self) -> None:
        other, bare = documents.no_gap(), documents.no_gap()
        other["arm"]["robot"] = "another"
        del bare["arm"]
        found = groups(
            {
                "a": documents.no_gap(),
                "b": documents.two_effects(),
                "c": other,
                "d": bare,
            }
        )
        assert [list(members) for members in found.values()] == [["a", "b"], ["c"]]


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> list[FleetUnit]:
    """Three units: with friction, like it but for its noise, and with a load; each corrected by the truth."""
    folder = tmp_path_factory.mktemp("fleet")
    friction = AppliedEffect("coulomb_friction", (2,), {"torque": np.array([3.0])})
    load = AppliedEffect(
        "payload", (), {"mass": np.array(1.2), "com": np.array([0.1, 0.02, 0.05])}
    )
    rough = Truth(coulomb=(0.0, 3.0, 0.0))
    truths = [("rough", rough, friction), ("twin", rough, friction)]
    truths.append(("loaded", Truth(mass=1.2, com=(0.1, 0.02, 0.05)), load))
    units = []
    for seed, (name, truth, effect) in enumerate(truths):
        case = Case(
            name, arm().urdf.parent, arm(), recordings(truth, seed, duration=4.0)
        )
        write_case(case, folder / name)
        write_corrected(name, (effect,), folder / f"{name}.yaml")
        units.append(FleetUnit(name, folder / name, folder / f"{name}.yaml"))
    return units


class TestConfusion:
    def test_each_unit_is_known_but_for_its_twin(self, fleet: list[FleetUnit]) -> None:
        columns = {u.name: confusion_column(u, fleet) for u in fleet}
        assert not any(made.problem for made in columns.values())
        assert (
            columns["loaded"].best == "loaded" and columns["loaded"].confused_with == ()
        )
        assert columns["rough"].confused_with == ("twin",) and columns[
            "twin"
        ].confused_with == ("rough",)
        for name, made in columns.items():
            own, nominal = made.mean(name), made.mean(NOMINAL)
            assert own is not None and nominal is not None and own < 0.5 * nominal

    def test_a_case_that_cannot_be_read_is_a_column_without_values(
        self, fleet: list[FleetUnit], tmp_path: Path
    ) -> None:
        made = confusion_column(
            FleetUnit("gone", tmp_path / "gone", fleet[0].corrected), fleet
        )
        assert (
            "no such file" in made.problem
            and made.best is None
            and made.confused_with == ()
        )

    def test_not_best_served_by_its_own_arm(self) -> None:
        rows = {
            "nominal": np.array([0.5, 0.5]),
            "a": np.array([0.2, 0.2]),
            "b": np.array([0.3, 0.05]),
        }
        assert ConfusionColumn("a", rows).best == "b" and ConfusionColumn(
            "a", rows
        ).confused_with == ("b",)
        assert (
            ConfusionColumn("b", rows).best == "b"
            and ConfusionColumn("b", rows).confused_with == ()
        )


class TestDocument:
    def made(self, tmp_path: Path) -> dict[str, Any]:
        """Two units compared, without recordings; a third whose set-up is at fault."""
        found = {
            "a": coulomb([1.0, 2.0], None, [2, 5]),
            "b": coulomb([1.0, 3.0], None, [2, 5]),
        }
        found["c"] = unit(("sign_flip", [2], {}))
        units = [
            FleetUnit(name, tmp_path / name, tmp_path / f"{name}.yaml")
            for name in found
        ]
        made, alone = grouped(found, units)
        (group,) = made
        assert (
            group.left_out == {"c": "its set-up is at fault: sign flip"} and alone == ()
        )
        assert [u.name for u in group.units] == ["a", "b"]
        rows = {
            "nominal": np.array([0.5, 0.4]),
            "a": np.array([0.1, 0.1]),
            "b": np.array([0.1, 0.1]),
        }
        return units_document(
            [
                (
                    group,
                    [
                        ConfusionColumn("a", rows),
                        ConfusionColumn("b", {}, "cannot be read"),
                    ],
                )
            ],
            ["d"],
        )

    def test_is_whole_and_plain_json(self, tmp_path: Path) -> None:
        content = self.made(tmp_path)
        write_json(content, tmp_path / "units.json")
        assert (
            json.loads((tmp_path / "units.json").read_text(encoding="utf-8")) == content
        )
        (group,) = content["groups"]
        confusion = group["confusion"]
        assert (confusion["rows"], confusion["columns"]) == (
            ["nominal", "a", "b"],
            ["a"],
        )
        assert confusion["torque_nrmse"] == [[0.45], [0.1], [0.1]]
        assert confusion["best"] == {"a": "a"} and confusion["confused_with"] == {
            "a": ["b"]
        }
        assert set(confusion["left_out"]) == {"b", "c"} and content["alone"] == ["d"]

    def test_in_words(self, tmp_path: Path) -> None:
        (group,) = self.made(tmp_path)["groups"]
        places = {(f["name"], f["place"], f["label"]) for f in findings(group)}
        assert ("Coulomb friction", "joint 2", "on 2 of 3 units, alike") in places
        assert (
            "Coulomb friction",
            "joint 5",
            "on 2 of 3 units, sizes differ",
        ) in places
        assert ("Sign flip", "joint 2", "only on c") in places
        assert heading(group) == (
            "Effects found: none is shared by all units; 2 on some units and 1 on one unit alone."
        )
        assert told_apart(group["confusion"]) == [
            "a cannot be told from b: its corrected arm predicts a as well as its own does "
            "(or worse by less than 0.01 NRMSE on every joint)."
        ]

    def test_in_the_summary_with_names_escaped(self, tmp_path: Path) -> None:
        evil = "<script>alert(1)</script>"
        found = {evil: documents.two_effects(), "b": documents.two_effects()}
        for document in found.values():
            document["arm"]["robot"] = evil
        made, alone = grouped(
            found, [FleetUnit(name, tmp_path, tmp_path) for name in found]
        )
        rows = {"nominal": np.array([0.5]), evil: np.array([0.1]), "b": np.array([0.3])}
        columns = [
            ConfusionColumn(evil, rows),
            ConfusionColumn("b", rows | {"b": np.array([0.05])}),
        ]
        content = units_document([(made[0], columns)], alone)
        render_summary(
            [Row(n, n, d) for n, d in found.items()],
            tmp_path / "s.html",
            content,
        )
        html = (tmp_path / "s.html").read_text(encoding="utf-8")
        assert evil not in html and "<script" not in html
        for expected in (
            "on all 2 units, alike",
            "+1.051 ± 0.013",
            "Which unit is this?",
            "can be told apart",
            "0.050",
        ):
            assert expected in html, expected


class TestFrictionOfAType:
    """Most units tell the law of a joint on which all have friction; the others are asked again without their own."""

    PLAIN = ("coulomb_friction", [2], {"torque": ([2.0], [0.1])})
    CURVED = ("saturating_friction", [2], {"torque": ([2.0], [0.1])})

    def test_the_odd_one_is_asked_again(self) -> None:
        units = {"a": unit(self.PLAIN), "b": unit(self.CURVED), "c": unit(self.PLAIN)}
        assert other_laws(units) == {"b": ("saturating_friction",)}

    def test_a_law_that_the_type_has_on_another_joint_stays(self) -> None:
        elsewhere = ("saturating_friction", [3], {"torque": ([1.0], [0.1])})
        units = {
            "a": unit(self.PLAIN, elsewhere),
            "b": unit(self.CURVED, elsewhere),
            "c": unit(self.PLAIN, elsewhere),
        }
        assert other_laws(units) == {}

    @pytest.mark.parametrize(
        "units",
        [
            {"a": unit(PLAIN), "b": unit(CURVED)},
            {"a": unit(PLAIN), "b": unit(CURVED), "c": unit()},
            {"a": unit(PLAIN), "b": unit(PLAIN), "c": unit(PLAIN)},
            {f"{k}": unit(law) for k, law in enumerate([PLAIN, PLAIN, CURVED, CURVED])},
        ],
        ids=["two", "one without friction", "alike", "as many of each"],
    )
    def test_nobody_is_asked(self, units: dict[str, Any]) -> None:
        assert other_laws(units) == {}

    def test_it_explains_as_much_up_to_what_an_effect_closes(self) -> None:
        before, asked = unit(self.CURVED), unit(self.PLAIN)
        left = np.array(before["gap"]["after"]["torque_nrmse"])
        for more, as_much in ((0.009, True), (0.011, False)):
            asked["gap"]["after"]["torque_nrmse"] = (left + more).tolist()
            assert explains_as_much(asked, before) is as_much
        before["verdict"] = "no_gap"
        assert not explains_as_much(before, unit(self.PLAIN))


# Change points: values by hand, rates of false alarms, and changes that are found where they are.


def test_two_estimates_are_compared_as_by_hand() -> None:
    found = change_point(np.array([1.0, 2.0]), np.array([0.3, 0.4]))
    assert (found.position, found.before, found.after) == (1, 1.0, 2.0)
    assert found.z == pytest.approx(1.0 / 0.5)
    assert found.p == pytest.approx(2 * norm.sf(2.0))


def test_units_and_zero_do_not_matter() -> None:
    rng = np.random.default_rng(4)
    values, stds = rng.standard_normal(8), rng.uniform(0.5, 2.0, 8)
    plain = change_point(values, stds)
    scaled = change_point(1e-9 * (values + 7.0), 1e-9 * stds)
    assert (scaled.position, scaled.p) == pytest.approx((plain.position, plain.p))


@pytest.mark.parametrize("n", [3, 12, 50])
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


def test_an_effect_that_is_always_named_has_not_appeared() -> None:
    assert appearance([True] * 6).p == appearance([False] * 6).p == 1.0


def test_scatter_is_seen_beside_changes() -> None:
    rng = np.random.default_rng(2)
    histories = [(3.0 * rng.standard_normal(10), np.ones(10)) for _ in range(100)]
    for values, _ in histories[:10]:
        values[5:] += 50.0
    assert scatter(histories) == pytest.approx(3.0, rel=0.1)
    assert scatter([(0.1 * values, stds) for values, stds in histories]) == 1.0
    assert scatter(histories[:1]) == 1.0


# Ranges from the files of diagnoses: which deviation belongs to which value, and files that do not fit.


def written(folder: Path, delay: list[float], std: Any) -> CorrectedArm:
    """The files of a diagnosis with a delay of joints 4 and 5."""
    folder.mkdir()
    document = copy.deepcopy(documents.one_possible())
    (finding,) = document["effects"]
    finding["parameters"] = {"delay": {"unit": "s", "value": delay, "std": std}}
    write_json(document, folder / "diagnosis.json")
    effects = (AppliedEffect("actuator_delay", (4, 5), {"delay": delay}),)
    write_corrected("unit", effects, folder / "corrected.yaml")
    return CorrectedArm(load_nominal_arm("xarm6"), effects)


def test_one_unit_has_the_intervals_of_its_diagnosis(tmp_path: Path) -> None:
    arm = written(tmp_path / "a", [0.008, 0.014], [0.001, None])
    (found,) = read_ranges(tmp_path / "a" / "corrected.yaml", arm, ()).ranges
    value, half = np.array([0.008, 0.014]), np.array([0.00196, 0.0])
    assert found.low.parameters["delay"] == pytest.approx(value - half)
    assert found.high.parameters["delay"] == pytest.approx(value + half)


def test_two_units_span_both(tmp_path: Path) -> None:
    arm = written(tmp_path / "a", [0.008, 0.014], [0.0, 0.0])
    written(tmp_path / "b", [0.010, 0.012], [0.0, 0.0])
    file = tmp_path / "a" / "corrected.yaml"
    (found,) = read_ranges(file, arm, (tmp_path / "b",)).ranges
    assert found.low.parameters["delay"] == pytest.approx([0.008, 0.012])
    assert found.high.parameters["delay"] == pytest.approx([0.010, 0.014])


def test_a_changed_file_is_not_given_the_intervals_of_another(tmp_path: Path) -> None:
    written(tmp_path / "a", [0.008, 0.014], [0.0, 0.0])
    effects = (AppliedEffect("actuator_delay", (4, 5), {"delay": [0.008, 0.02]}),)
    write_corrected("unit", effects, tmp_path / "a" / "corrected.yaml")
    arm = CorrectedArm(load_nominal_arm("xarm6"), effects)
    with pytest.raises(InputError, match="no actuator_delay with the values") as error:
        read_ranges(tmp_path / "a" / "corrected.yaml", arm, ())
    assert error.value.file == tmp_path / "a" / "diagnosis.json"


def test_a_missing_diagnosis_is_told(tmp_path: Path) -> None:
    arm = written(tmp_path / "a", [0.008, 0.014], [0.0, 0.0])
    (tmp_path / "a" / "diagnosis.json").unlink()
    with pytest.raises(InputError, match=r"diagnosis\.json"):
        read_ranges(tmp_path / "a" / "corrected.yaml", arm, ())
