"""What the scorer counts, on diagnoses written by hand and figures worked out by hand."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from gapscope.blind_check.baselines import (
    Design,
    classified,
    features,
    forward_bic,
    largest_r2,
    ridge,
    train,
)
from gapscope.blind_check.scoring import (
    Named,
    brier,
    compare,
    ece,
    first_parameter,
    matched,
    reliability,
    same,
    smallest_set,
    summary,
    wilson,
)
from gapscope.reports.blind_check import FIGURES, brief_tables, tables

CONDITIONS = {"robot": "small", "rate": 250, "bare": False, "inertials_off": 0.0}


def label(
    *effects: dict[str, Any], kind: str = "single", fast: bool = True
) -> dict[str, Any]:
    """A label of an arm with three joints."""
    sizes = {"measure": "torque", "gap": [0.1] * 3, "floor": [0.01] * 3}
    severity = [3.0, 5.0] if effects else None
    motions = ["slow", "fast" if fast else "middle", "fast"]
    known = {"kind": kind, "effects": list(effects), "severity": severity}
    return known | sizes | {"motions": motions, "conditions": CONDITIONS}


def effect(
    name: str, joints: list[int], probability: float = 1.0, **parameters: Any
) -> dict[str, Any]:
    """An entry of ``effects``."""
    values = {
        key: {"unit": "1", "value": value, "std": np.full(np.shape(value), 0.3)}
        for key, value in parameters.items()
    }
    known = {"effect": name, "joints": joints, "probability": probability}
    return known | {"alternatives": [], "parameters": values}


def said(*effects: dict[str, Any], verdict: str = "effects_found") -> dict[str, Any]:
    """A document, as far as the scorer reads it."""
    return {"verdict": verdict, "effects": list(effects)}


def test_wilson_interval() -> None:
    """None of 80: z^2 / (80 + z^2) = 0.0458."""
    assert wilson(0, 80) == (0.0, pytest.approx(0.04582, abs=1e-5))
    assert wilson(0, 0) == (0.0, 1.0)


def test_brier_and_ece() -> None:
    """Brier: (0.04 + 0.64 + 0.01 + 0.01) / 4. ECE: bin 0.8 holds p 0.8, 0.8 with half right, bin 0.9 two right."""
    p, right = np.array([0.8, 0.8, 0.9, 0.9]), np.array([1.0, 0.0, 1.0, 1.0])
    assert brier(p, right) == pytest.approx(0.175)
    assert ece(p, right) == pytest.approx(0.5 * 0.3 + 0.5 * 0.1)
    bins = [(row["count"], row["right"]) for row in reliability(p, right)]
    assert bins == [(2, 0.5), (2, 1.0)]
    assert ece(np.array([]), np.array([])) is None


def test_the_smallest_set_stops_at_its_level() -> None:
    candidates = [("b", 0.3), ("a", 0.65), ("c", 0.05)]
    assert smallest_set(candidates, 0.9) == ["a", "b"]
    assert smallest_set(candidates, 0.6) == ["a"]


@pytest.mark.parametrize(
    ("one", "other", "motions", "expected"),
    [
        (Named("actuator_delay", (1,)), Named("actuator_lag", (1,)), ["slow"], True),
        (Named("actuator_delay", (1,)), Named("actuator_lag", (1,)), ["fast"], False),
        (Named("armature", (1, 2)), Named("link_inertia", (), 2), [], True),
        (Named("armature", (1, 3)), Named("link_inertia", (), 2), [], False),
        (Named("payload"), Named("link_inertia", (), 6), [], True),
        (Named("payload"), Named("link_inertia", (), 5), [], False),
    ],
)
def test_effects_of_a_class_count_as_the_same_under_its_condition(
    one: Named, other: Named, motions: list[str], expected: bool
) -> None:
    assert same(one, other, 6, motions) is expected


def test_equal_names_are_matched_before_classes() -> None:
    truth = [Named("actuator_lag", (1,)), Named("actuator_delay", (2,))]
    found = [Named("actuator_delay", (2,)), Named("actuator_lag", (1,))]
    assert sorted(matched(truth, found, 3, ["slow"])) == [(0, 1), (1, 0)]


PAYLOAD = effect("payload", [], mass=1.0, com=[0, 0, 0])
RUBBING = effect("coulomb_friction", [2, 1], torque=[2.0, 4.0])
NONE = said(verdict="no_gap")
COMPARED = {
    # top, exact, exact_strict, jaccard
    "right": (label(RUBBING), said(RUBBING), (True, True, True, 1.0)),
    "one too many": (
        label(PAYLOAD),
        said(PAYLOAD, effect("armature", [3], inertia=[0.1])),
        (True, False, False, 0.5),
    ),
    "possible is not named": (
        label(PAYLOAD),
        NONE | {"possible": [PAYLOAD]},
        (False, False, False, 0.0),
    ),
    "possible on a healthy arm": (
        label(kind="healthy"),
        NONE | {"possible": [PAYLOAD]},
        (False, False, False, 1.0),
    ),
    "of its class": (
        label(effect("actuator_lag", [1]), fast=False),
        said(effect("actuator_delay", [1])),
        (True, True, False, 1.0),
    ),
}


@pytest.mark.parametrize("name", COMPARED)
def test_a_diagnosis_compared_with_its_label(name: str) -> None:
    truth, found, expected = COMPARED[name]
    case = compare("c", truth, found)
    assert (case.top, case.exact, case.exact_strict, case.jaccard) == expected
    assert len(case.findings) == len(found["effects"])
    assert bool(case.found) == bool(found["effects"])


def test_errors_and_findings_of_a_diagnosis() -> None:
    found = effect("coulomb_friction", [1, 2], 0.9, torque=[4.4, 2.0])
    beside = effect("armature", [3], inertia=[0.1])
    case = compare("c", label(RUBBING), said(found, beside))
    assert case.joints == (True,)
    assert case.errors == (pytest.approx(0.05),)  # median of 0 and 10 %
    assert case.held == (True, True)
    # an interval holds what is within two deviations
    far = effect("coulomb_friction", [2, 1], torque=[2.7, 4.5])
    assert compare("c", label(RUBBING), said(far)).held == (False, True)
    assert [finding.right for finding in case.findings] == [True, False]
    assert case.findings[0].probability == 0.9


def test_the_error_of_a_tilt_is_that_of_the_vector() -> None:
    true, found = (effect("base_tilt", [], roll=0.03, pitch=x) for x in (0.04, 0.05))
    size = first_parameter(true, found)
    assert size is not None and size.error == pytest.approx(0.2)


def test_the_summary_counts_alarms_unknowns_and_failures() -> None:
    beyond = effect("unknown", [1]) | {"kind": "hysteresis"}
    rotor = effect("armature", [1])
    unexplained = said(verdict="unexplained")
    outside = label(beyond, kind="outside")
    documents = {
        "a": (label(kind="healthy"), NONE),
        "b": (label(kind="healthy"), said(effect("payload", [], mass=1.0))),
        "c": (outside, unexplained),
        "d": (outside, said(effect("coulomb_friction", [1]))),
        "e": (label(rotor), said(rotor)),
        "f": (label(rotor), unexplained),
        "g": (label(rotor), None),
    }
    cases = [compare(name, *pair) for name, pair in documents.items()]
    figures = summary(cases)
    assert figures["healthy"]["false_alarms"]["hits"] == 1
    unknown = figures["unknown"]
    assert unknown["recall"]["hits"] == unknown["false_unknown"]["hits"] == 1
    assert figures["failed"] == ["g"]
    assert figures["by_kind"]["single"]["exact"]["hits"] == 1
    counts = dict.fromkeys(("armature", "unexplained", "failed"), 1)
    assert figures["confusion"]["armature"] == counts
    # what the hashes of the run have shown is told where its shares are
    fixed = {"complete": True, "source_changed_during_the_run": True}
    figures["frozen"] = {**fixed, "changed_after_the_run": ["b", "c"]}
    assert all(table.markdown() and table.on_terminal() for table in tables(figures))
    (shown,) = (x for x in brief_tables(figures) if x.title.startswith("Verdicts"))
    assert "source changed during the run | yes" in shown.markdown()
    assert "diagnoses changed after the run | b, c" in shown.markdown()
    assert all(make(figures).to_json() for _, make, _ in FIGURES.values())


def plain_case(weights: list[float], noise: float = 0.01) -> Design:
    """A regression with three columns that are not correlated."""
    rng = np.random.default_rng(1)
    columns = np.linalg.qr(rng.standard_normal((6000, 3)))[0]
    names = ("payload", "armature", "armature")
    terms = [(name, joint) for joint, name in enumerate(names)]
    gap = 60.0 * columns @ np.array(weights) + noise * rng.standard_normal(6000)
    return Design(gap, terms, columns, np.full(2, float(np.sqrt((gap**2).mean()))), 2)


@pytest.mark.parametrize("method", [largest_r2, forward_bic, ridge])
def test_a_plain_method_finds_one_effect_and_its_joint_or_no_gap(method: Any) -> None:
    found = method(plain_case([0.0, 0.0, 1.0]))
    assert found["verdict"] == "effects_found"
    assert [(e["effect"], e["joints"]) for e in found["effects"]] == [("armature", [2])]
    assert method(plain_case([0.0, 0.0, 0.0]))["verdict"] == "no_gap"


def test_forward_selection_finds_a_pair() -> None:
    found = forward_bic(plain_case([1.0, 0.0, 0.7]))
    assert [e["effect"] for e in found["effects"]] == ["payload", "armature"]


def test_the_classifier_learns_what_no_line_divides() -> None:
    """Exclusive or: the network's hidden layer has something to do."""
    pytest.importorskip("sklearn", reason="gapscope[learn] is not installed")
    x = np.random.default_rng(0).uniform(-1.0, 1.0, (300, 2))
    names = np.where(x[:, 0] * x[:, 1] > 0, "same", "other")
    assert (train(x, names.tolist()).predict(x) == names).mean() > 0.9


@pytest.mark.filterwarnings("error")
def test_a_case_without_any_gap_is_classified_as_healthy() -> None:
    """Nominal predictions that are exact to the last digit, on an arm of one joint too."""
    pytest.importorskip("sklearn", reason="gapscope[learn] is not installed")
    exact = plain_case([0.0, 0.0, 0.0], noise=0.0)
    cases = (exact, plain_case([0.0, 0.0, 1.0]), plain_case([1.0, 0.0, 0.0]))
    rows = np.repeat([features(case) for case in cases], 5, axis=0)
    network = train(rows, np.repeat(["healthy", "armature", "payload"], 5).tolist())
    assert classified(network, exact)["verdict"] == "no_gap"
    assert np.isfinite(features(exact._replace(nrmse=np.zeros(1)))).all()
