"""Kill tests: what has to fail when the truth is taken away, and to turn round when the roles are exchanged."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
from small_cases import CLEAN, Solved, solve

from gapscope.arm.case import load_case
from gapscope.blind_check.generator.case import make_case, write_case
from gapscope.blind_check.generator.simulate import CaseSpec
from gapscope.blind_check.scoring import compare
from gapscope.diagnosis.diagnose import diagnose
from gapscope.effects.catalogue import without

pytestmark = [pytest.mark.slow, pytest.mark.nightly]


def test_effects_are_found_under_their_own_labels_and_permuted_ones_score_as_chance_does(
    solved: dict[str, Solved],
) -> None:
    cases = list(solved.values())
    assert all(compare("case", case.label, case.document).top for case in cases)
    for case, other in zip(cases, [*cases[1:], cases[0]], strict=True):
        assert not compare("case", other.label, case.document).exact


def test_an_effect_that_is_no_longer_in_the_catalogue_is_called_unexplained(
    solved: dict[str, Solved],
) -> None:
    case = solved["torque_ripple"]
    assert case.document["verdict"] == "effects_found"
    with without(["torque_ripple"]):
        document = diagnose(load_case(case.folder)).document
    assert document["verdict"] == "unexplained"
    assert "torque_ripple" not in [finding["effect"] for finding in document["effects"]]


def test_nominal_and_real_exchanged_give_the_same_effect_with_the_other_sign(
    tmp_path: Path,
) -> None:
    one = solve(("coulomb_friction",), tmp_path / "one", seed=4)
    entry = one.label["effects"][0]
    more = np.zeros(3)
    more[np.array(entry["joints"]) - 1] = entry["parameters"]["torque"]["value"]
    healthy = make_case(CaseSpec("healthy", (), None, CLEAN), (4,))
    write_case(healthy, "case", False, tmp_path / "other", tmp_path / "other.csv")
    file = tmp_path / "other" / "case.yaml"
    content = yaml.safe_load(file.read_text())
    believed = np.array(content["nominal"]["coulomb"]) + more
    content["nominal"]["coulomb"] = believed.tolist()
    # the controller knows the true friction, not the one that is believed now
    del content["controller"]
    file.write_text(yaml.safe_dump(content))
    other = diagnose(load_case(tmp_path / "other")).document

    documents = (one.document, other)
    effects = [{e["effect"]: e for e in each["effects"]} for each in documents]
    found = [each["coulomb_friction"] for each in effects]
    assert found[0]["joints"] == found[1]["joints"] == entry["joints"]
    there, back = (np.array(e["parameters"]["torque"]["value"]) for e in found)
    assert (there > 0).all()
    assert there == pytest.approx(-back, rel=0.15)
