"""A diagnosis as a whole: what it uses, what it must not use, and odd cases."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from dataclasses import replace

import numpy as np
import pytest
import synthetic
from cases import case_of
from sweeps import nightly
from synthetic import Truth

import gapscope
from gapscope.arm.case import Case
from gapscope.arm.errors import GapscopeError, InputError
from gapscope.arm.io.json_file import plain
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording
from gapscope.diagnosis import diagnose as of_sheet
from gapscope.diagnosis.diagnose import diagnose
from gapscope.diagnosis.document.diagnosis_json import validate
from gapscope.diagnosis.document.wording import verdict_sentence
from gapscope.diagnosis.result import Diagnosis

COULOMB = Truth(coulomb=(0.0, 2.0, 0.0))


@pytest.fixture(scope="module")
def judged() -> Case:
    """A case with a recording that is set aside."""
    return synthetic.case(COULOMB, seed=7, judged=True)


@pytest.fixture(scope="module")
def found(judged: Case) -> Diagnosis:
    return diagnose(judged)


def changed(
    recording: Recording, change: Callable[[np.ndarray], np.ndarray]
) -> Recording:
    assert recording.tau is not None
    return replace(recording, tau=change(np.array(recording.tau)))


def values(result: Diagnosis) -> list[tuple[str, list[int], list[object]]]:
    """Name, joints and values of what is named or possible."""
    found = (*result.document["effects"], *result.document["possible"])
    return [
        (e["effect"], e["joints"], [p["value"] for p in e["parameters"].values()])
        for e in found
    ]


def test_document_is_valid_json(found: Diagnosis) -> None:
    validate(found.document)
    text = json.dumps(plain(found.document), allow_nan=False)
    assert json.loads(text) == plain(found.document)
    assert (
        json.loads(json.dumps(found.document, allow_nan=False)) == found.document
    )  # plain values already


def test_same_case_same_diagnosis_and_progress_is_told(
    judged: Case, found: Diagnosis
) -> None:
    told: list[str] = []
    assert diagnose(judged, told.append).document == found.document
    assert len(told) > 3 and any("coulomb_friction" in message for message in told)


def test_case_is_described(found: Diagnosis) -> None:
    document = found.document
    assert document["arm"] == {
        "robot": "yaw_pitch_pitch",
        "joints": ["joint_1", "joint_2", "joint_3"],
    }
    assert [(r["name"], r["role"]) for r in document["recordings"]] == [
        ("recording_0.csv", "fit"),
        ("recording_1.csv", "fit"),
        ("recording_2.csv", "fit"),
        ("judged.csv", "judge"),
    ]
    assert document["judged_on"] == "recordings set aside for judging"
    assert document["case"] == "synthetic" and document["schema"] == 1
    assert document["states"]["shared"] and document["states"]["differs"] == []
    assert "share a state" not in verdict_sentence(document)
    assert "sides" not in document and document["torque_from"] == "recorded"
    assert not any("must have commanded" in text for text in document["warnings"])


def test_curves_fit_the_document(found: Diagnosis) -> None:
    (trace,) = found.traces
    assert trace.recording == "judged.csv"
    assert (
        trace.measured.shape
        == trace.nominal.shape
        == trace.corrected.shape
        == (len(trace.t), 3)
    )
    assert {s.effect for s in found.signatures} == {"coulomb_friction"}
    assert found.spectrum.before.shape == (len(found.spectrum.frequency), 3)


class TestJudgedRecordings:
    @pytest.mark.nightly
    def test_torque_of_a_judged_recording_changes_no_value(
        self, judged: Case, found: Diagnosis
    ) -> None:
        other = replace(
            judged,
            judged=tuple(
                changed(r, lambda tau: 1.3 * tau + 1.0) for r in judged.judged
            ),
        )
        result = diagnose(other)
        assert values(result) == values(found)
        gaps = [
            np.array(d.document["gap"]["after"]["torque_nrmse"])
            for d in (found, result)
        ]
        assert (gaps[1] > gaps[0] + 0.02).all()

    def test_gaps_are_those_of_the_judged_recording(
        self, judged: Case, found: Diagnosis, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """Only the judged arm has a further effect: the gap after it shows there, and is not explained.

        What an audit finds in the robot file is said first then.
        """
        (aside,) = judged.judged
        monkeypatch.setattr(of_sheet, "odd_kinds", lambda urdf: "mass (2)")
        result = diagnose(
            replace(
                judged,
                judged=(changed(aside, lambda tau: tau + np.array([3.0, 0.0, 0.0])),),
            )
        )
        assert values(result) == values(found)
        assert result.document["gap"]["after"]["torque_nrmse"][0] > 0.1
        assert result.document["verdict"] == "unexplained"
        first = result.document["warnings"][0]
        assert first.startswith("in the robot file: mass (2); see gapscope audit /")

    @pytest.mark.nightly
    def test_motion_of_a_judged_recording_changes_no_value(
        self, judged: Case, found: Diagnosis
    ) -> None:
        (aside,) = judged.judged
        shaken = aside.q + 0.01 * np.sin(2 * np.pi * 25 * aside.t)[:, None]
        assert values(
            diagnose(replace(judged, judged=(replace(aside, q=shaken),)))
        ) == values(found)

    def test_healthy_judged_recording_does_not_undo_what_was_fitted(
        self, judged: Case, found: Diagnosis
    ) -> None:
        result = diagnose(
            replace(judged, judged=synthetic.case(Truth(), seed=7, judged=True).judged)
        )
        assert result.document["verdict"] != "no_gap"

    def test_judged_recording_without_torque_is_not_said_to_be_judged_on(
        self, judged: Case
    ) -> None:
        silent = tuple(replace(r, tau=None) for r in judged.judged)
        document = diagnose(replace(judged, judged=silent)).document
        assert document["judged_on"].startswith("each motion")


def test_a_single_recording() -> None:
    case = synthetic.case(COULOMB, seed=8)
    result = diagnose(replace(case, recordings=case.recordings[2:]))
    validate(result.document)
    assert "states" not in result.document
    assert [(e.name, e.joints) for e in result.effects] == [("coulomb_friction", (2,))]
    assert result.effects[0].parameters["torque"] == pytest.approx([2.0], rel=0.05)
    assert result.document["judged_on"].startswith("each motion")


@pytest.mark.nightly
def test_a_single_healthy_recording() -> None:
    case = synthetic.case(Truth(), seed=8)
    assert (
        diagnose(replace(case, recordings=case.recordings[1:2])).document["verdict"]
        == "no_gap"
    )


def silent(recording: Recording) -> Recording:
    return replace(recording, tau=None)


def late(recording: Recording) -> Recording:
    """At half the rate as well."""
    return replace(
        recording,
        t=recording.t[::2] + 1.7e9,
        q=recording.q[::2],
        tau=recording.tau[::2],
    )


def torn(recording: Recording) -> Recording:
    keep = (recording.t < 3.0) | (recording.t > 3.4)
    return replace(
        recording, t=recording.t[keep], q=recording.q[keep], tau=recording.tau[keep]
    )


Change = Callable[[Recording], Recording]


def kept(recording: Recording) -> Recording:
    return recording


@pytest.mark.parametrize(
    "changes",
    [
        (silent, late, torn),
        nightly((silent, kept, kept)),
        nightly((late, late, late)),
        nightly((kept, kept, torn)),
    ],
)
def test_one_without_torque_one_that_starts_late_and_one_with_a_gap(
    changes: tuple[Change, ...],
) -> None:
    """What is without torque is left out; time may start anywhere, and gaps in it are survived."""
    case = synthetic.case(COULOMB, seed=7)
    recordings = [change(r) for change, r in zip(changes, case.recordings, strict=True)]
    result = diagnose(replace(case, recordings=tuple(recordings)))
    assert [(e.name, e.joints) for e in result.effects] == [("coulomb_friction", (2,))]
    assert result.effects[0].parameters["torque"] == pytest.approx([2.0], rel=0.05)


def test_no_torque_at_all() -> None:
    case = synthetic.case(COULOMB, seed=7)
    silent = tuple(replace(r, tau=None) for r in case.recordings)
    with pytest.raises(
        GapscopeError, match=r"synthetic: no recording carries a torque(.|\n)*tau1"
    ) as caught:
        diagnose(replace(case, recordings=silent))
    assert caught.value.exit_code == 1


def test_too_short() -> None:
    case = synthetic.case(COULOMB, seed=7)
    short = case.recordings[0]
    cut = Recording(short.name, short.t[:200], short.q[:200], short.tau[:200])
    with pytest.raises(
        InputError, match=r"recording_0\.csv: lasts 0\.796 s, at least 1 s"
    ):
        diagnose(replace(case, recordings=(cut,)))


ORDER = np.array([2, 0, 1])
"""Column k holds joint ORDER[k] + 1 of the URDF."""


def reordered(recordings: Iterable[Recording]) -> Case:
    """The same arm with its joints listed in another order."""
    base = synthetic.arm()
    sheet = {
        name: getattr(base, name)[ORDER] for name in ("armature", "coulomb", "viscous")
    }
    joints = tuple(base.joints[j] for j in ORDER)
    turned = (
        Recording(r.name, r.t, r.q[:, ORDER], r.tau[:, ORDER]) for r in recordings
    )
    return case_of("turned", NominalArm(base.name, base.urdf, joints, **sheet), *turned)


def test_order_of_the_columns() -> None:
    """It gives the same effects on the joints renumbered."""
    truth = Truth(mass=1.0, com=(0.2, 0.0, 0.0), encoder=(0.0, 0.06, 0.0))
    result = diagnose(reordered(synthetic.recordings(truth, 2)))
    assert sorted((e.name, e.joints) for e in result.effects) == [
        ("encoder_offset", (3,)),
        ("payload", ()),
    ]
    payload = next(e for e in result.effects if e.name == "payload")
    assert payload.parameters["mass"] == pytest.approx(1.0, rel=0.03)
    np.testing.assert_allclose(payload.parameters["com"], [0.2, 0.0, 0.0], atol=0.01)
    encoder = next(e for e in result.effects if e.name == "encoder_offset")
    assert encoder.parameters["offset"] == pytest.approx([0.06], rel=0.05)


@pytest.mark.nightly
def test_order_of_the_columns_of_other_effects() -> None:
    """As above, of effects that are no load."""
    truth = Truth(force=(8.0, 0.0, -12.0), window=(2.0, 4.0), ripple=(1.5, 0.0, 0.0))
    result = diagnose(reordered(synthetic.recordings(truth, 2, duration=6.0)))
    assert sorted((e.name, e.joints) for e in result.effects) == [
        ("external_force", ()),
        ("torque_ripple", (2,)),
    ]
    force = next(e for e in result.effects if e.name == "external_force")
    np.testing.assert_allclose(force.parameters["force"], [8.0, 0.0, -12.0], atol=0.5)


def test_a_joint_that_never_moves() -> None:
    case = synthetic.case(COULOMB, seed=7)
    held = []
    for k, r in enumerate(case.recordings):
        motion = synthetic.motion(70 + k, (0.1, 0.2, 0.3)[k], 8.0)
        motion = replace(
            motion, sine=motion.sine * [1, 1, 0], cosine=motion.cosine * [1, 1, 0]
        )
        held.append(
            synthetic.recording(COULOMB, motion, np.random.default_rng(k), r.name)
        )
    result = diagnose(replace(case, recordings=tuple(held)))
    validate(result.document)
    assert [(e.name, e.joints) for e in result.effects] == [("coulomb_friction", (2,))]


@pytest.mark.nightly
def test_recordings_of_different_rates() -> None:
    """A sine of 5 Hz is found in its band although the recordings have 125, 250 and 250 Hz."""

    def ripple(t: np.ndarray, q: np.ndarray, dq: np.ndarray) -> np.ndarray:
        return np.outer(np.sin(2 * np.pi * 5 * t), [0.0, 3.0, 0.0])

    truth = Truth(extra=ripple)
    fast, slow = (synthetic.recordings(truth, 3, rate=rate) for rate in (250.0, 125.0))
    case = replace(synthetic.case(truth, 3), recordings=(slow[0], *fast[1:]))
    document = diagnose(case).document
    assert "4 to 8 Hz" in [
        region["regime"] for region in document["unexplained"]["where"]
    ]


@pytest.fixture(scope="module")
def foreign(tmp_path_factory: pytest.TempPathFactory) -> Case:
    """Recordings of the arm with the URDF of another."""
    urdf = tmp_path_factory.mktemp("foreign") / "other.urdf"
    text = synthetic.URDF.replace('axis xyz="0 1 0"', 'axis xyz="1 0 0"')
    urdf.write_text(text.replace('mass value="5"', 'mass value="60"'))
    case = synthetic.case(COULOMB, seed=7)
    return replace(case, arm=NominalArm("other", urdf, case.arm.joints))


def test_another_robot_is_said_and_nothing_is_found_of_it(foreign: Case) -> None:
    result = diagnose(foreign)
    document = result.document
    validate(document)
    assert verdict_sentence(document).startswith("Probably another robot")
    assert document["verdict"] == "unexplained" and result.faults == ()
    assert not document["effects"] + document["possible"] + document["changes"]


def test_an_arm_that_its_data_sheet_makes_unlikely_is_no_other_robot() -> None:
    # eighteen times the deviation of what the joint has otherwise
    unlikely = Truth(coulomb=(0.0, 2.0, 0.0), offset=(0.0, 0.0, 40.0))
    document = diagnose(synthetic.case(unlikely, seed=7)).document
    assert document["verdict"] == "effects_found" and "misread" not in document
    named = {(e["effect"], *e["joints"]) for e in document["effects"]}
    assert named == {("torque_offset", 3), ("coulomb_friction", 2)}


def test_nothing_is_identified_of_another_robot(foreign: Case) -> None:
    with pytest.raises(InputError, match="probably another robot"):
        gapscope.identify(foreign)
