"""A known payload: recordings with and without it are used together, and what is found is beyond it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import synthetic
from sensed import reading
from sweeps import daily
from synthetic import Truth

from gapscope.arm.case import Case
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.known_load import KnownLoad
from gapscope.arm.motions.motion import Motion
from gapscope.arm.nominal import NominalArm
from gapscope.diagnosis.assessment.sensor_sides import link_torque
from gapscope.diagnosis.diagnose import diagnose
from gapscope.diagnosis.diagnose_change import (
    Change,
    diagnose_change,
    identify_reference,
)
from gapscope.diagnosis.document.diagnosis_json import validate
from gapscope.diagnosis.gap.predict import predict_torque
from gapscope.diagnosis.result import Diagnosis
from gapscope.diagnosis.setup_faults.detection import find_setup_faults
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected import CorrectedArm
from gapscope.ident.identification import IdentificationSettings, identify
from gapscope.model.conditioning import Segment, blocks, condition, thinned
from gapscope.model.jacobian import Bodies, LinearisationPoint, columns
from gapscope.model.rows import DecimatedSegments
from gapscope.model.terms import Terms

LOAD = KnownLoad(2.0, (0.1, -0.03, 0.05))
CUTOFF = 10.0
HEALTHY = Truth()


def loaded(truth: Truth) -> Truth:
    """The truth with the known load beside what is on the last link already, as one body of the same first moment.

    A point mass more or less than the two differ by a moment of inertia that no test here can see.
    """
    mass = truth.mass + LOAD.mass
    moment = truth.mass * np.array(truth.com) + LOAD.mass * np.array(LOAD.com)
    return replace(truth, mass=mass, com=tuple(moment / mass))


def case(
    truth: Truth = HEALTHY,
    seed: int = 2,
    *,
    declared: bool = True,
    sensors: bool = False,
) -> Case:
    """Three recordings, the second with a load, which the case declares or not; with torque sensors or without."""
    rng, recordings = np.random.default_rng(1000 + seed), []
    for k, frequency in enumerate((0.1, 0.2, 0.3)):
        there, motion = (
            loaded(truth) if k == 1 else truth,
            synthetic.motion(10 * seed + k, frequency, 8.0),
        )
        made = synthetic.recording(there, motion, rng, f"recording_{k}.csv")
        if sensors:
            made = replace(
                made,
                tau_sensor=reading(there, motion, made.t)
                + 0.1 * rng.standard_normal(made.q.shape),
            )
        recordings.append(replace(made, payload=LOAD) if k == 1 and declared else made)
    return Case(
        "synthetic", synthetic.arm().urdf.parent, synthetic.arm(), tuple(recordings)
    )


def segment(k: int = 1) -> Segment:
    """The segment of a recording."""
    (only,) = condition(case().recordings[k], CUTOFF)
    return only


def welded() -> pin.Model:
    """The arm by pinocchio with the load welded to its last link."""
    out = pin.buildModelFromUrdf(str(synthetic.arm().urdf))
    out.appendBodyToJoint(
        3,
        pin.Inertia(LOAD.mass, np.array(LOAD.com), np.zeros((3, 3))),
        pin.SE3.Identity(),
    )
    return out


def urdf_with_load(folder: Path) -> NominalArm:
    """The nominal arm with the load in the inertial of its last link."""
    total = welded().inertias[3]
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = total.inertia
    inertial = (
        f'<mass value="{total.mass!r}"/><origin xyz="{" ".join(map(repr, total.lever.tolist()))}"/>'
        f'<inertia ixx="{xx}" iyy="{yy}" izz="{zz}" ixy="{xy}" ixz="{xz}" iyz="{yz}"/></inertial>'
    )
    start = synthetic.URDF.index(
        "<inertial>", synthetic.URDF.index('link name="link_3"')
    ) + len("<inertial>")
    end = synthetic.URDF.index("</inertial>", start) + len("</inertial>")
    path = folder / "loaded.urdf"
    path.write_text(synthetic.URDF[:start] + inertial + synthetic.URDF[end:])
    return replace(synthetic.arm(), urdf=path)


def named(result: Diagnosis) -> list[tuple[str, tuple[int, ...]]]:
    return sorted((e.name, e.joints) for e in result.effects)


class TestBodies:
    """The arm that carries a load."""

    def test_torque_is_that_of_a_body_that_pinocchio_welds_on(self) -> None:
        model = welded()
        data, rng = model.createData(), np.random.default_rng(0)
        q, dq, ddq = rng.uniform(-1, 1, (3, 20, 3))
        expected = [pin.rnea(model, data, *row) for row in zip(q, dq, ddq, strict=True)]
        laden = synthetic.body().carrying(LOAD)
        np.testing.assert_allclose(
            laden.inverse_dynamics(q, dq, ddq), expected, rtol=1e-9
        )
        motion = Motion(np.arange(20) / 250, q, dq, ddq)
        one = Segment("a", motion, None, None, LOAD)
        bare = synthetic.body().inverse_dynamics(q, dq, ddq)
        np.testing.assert_allclose(
            bare + one.known_torque(synthetic.body()), expected, rtol=1e-9
        )

    def test_errors_of_the_last_link_are_those_of_the_link_itself(self) -> None:
        wrong = AppliedEffect(
            "link_inertia", (), {"link": 3, "mass": 1.0, "com": [0.02, 0.0, 0.0]}
        )
        arm, body = CorrectedArm(synthetic.arm(), (wrong,)), synthetic.body()
        np.testing.assert_array_equal(
            arm.inertial_increments(body.carrying(LOAD)), arm.inertial_increments(body)
        )

    def test_a_payload_found_adds_to_it(self) -> None:
        found = AppliedEffect("payload", (), {"mass": 1.0, "com": [0.2, 0.0, 0.0]})
        arm, body, s = (
            CorrectedArm(synthetic.arm(), (found,)),
            synthetic.body(),
            segment(),
        )
        both = arm.rigid_torque(body.carrying(LOAD), s.motion)
        expected = arm.rigid_torque(body, s.motion) + s.known_torque(body)
        np.testing.assert_allclose(both, expected, atol=1e-9)


class TestSegment:
    """A segment knows what was mounted."""

    def test_it_is_passed_on(self) -> None:
        assert segment(0).payload is None
        for piece in (segment(), thinned(segment(), 100.0), *blocks(segment(), 2)):
            assert piece.payload == LOAD

    @pytest.mark.parametrize("found", [False, True])
    def test_columns_are_those_of_a_nominal_arm_with_the_load_in_its_urdf(
        self, found: bool, tmp_path: Path
    ) -> None:
        """All but those of a force, which acts where it did; around no effects and around some."""
        s, terms = segment(), Terms(3)
        theta = np.zeros(terms.size)
        if found:
            theta[terms.block("payload")[:, 0]] = [1.0, 0.1, 0.0, 0.02]
            theta[terms.block("base_tilt")[:, 0]] = 0.05
            theta[terms.block("encoder_offset")[0, 1]] = 0.03
            theta[terms.block("joint_elasticity")[:, 2]] = [1e-4, 1e-8]
            theta[terms.block("backlash")[0, 1]] = 0.004
        arm = urdf_with_load(tmp_path)
        results = []
        for nominal, piece in ((synthetic.arm(), s), (arm, replace(s, payload=None))):
            bodies = Bodies(RigidBody(nominal), piece)
            corrected = CorrectedArm(nominal, terms.effects(theta))
            at = LinearisationPoint.of(corrected, bodies, terms, theta)
            data = DecimatedSegments([piece], CUTOFF)
            results.append((at.torque, columns(at, data)))
        (base, x), (expected, y) = results
        np.testing.assert_allclose(base, expected, atol=1e-6)
        size = np.abs(y).max(axis=(0, 1)).clip(1e-3)
        np.testing.assert_allclose(x / size, y / size, atol=1e-4)
        assert x.any(axis=(0, 1)).sum() > 30

    def test_it_is_no_fault_of_the_set_up(self) -> None:
        assert find_setup_faults(case()) == ()

    def test_the_sensor_behind_the_gear_carries_it(self) -> None:
        moved = synthetic.motion(21, 0.2, 8.0)
        s = segment()
        predicted = link_torque(
            CorrectedArm(synthetic.arm()), s.bodies(synthetic.body()), s.motion
        )
        expected = reading(loaded(Truth()), moved, s.motion.t)
        error = (predicted - expected)[s.inner]
        assert np.abs(error).max() < 0.02 * np.abs(expected).max()


class TestDiagnosis:
    """Whole diagnoses of three recordings, of which the second carries 2 kg."""

    def test_a_declared_load_is_no_gap(self) -> None:
        document = diagnose(case()).document
        validate(document)
        assert document["verdict"] == "no_gap"
        assert [r.get("payload") for r in document["recordings"]] == [
            None,
            LOAD.entry(),
            None,
        ]

    @pytest.mark.nightly
    def test_one_that_is_not_declared_is(self) -> None:
        document = diagnose(case(declared=False)).document
        assert document["verdict"] != "no_gap"
        assert all("payload" not in r for r in document["recordings"])

    def test_both_sides_of_the_sensors_carry_it(self) -> None:
        document = diagnose(case(sensors=True)).document
        assert document["verdict"] == "no_gap" and set(
            document["sides"]["carried_by"]
        ) == {"neither"}

    def test_load_friction_is_told_from_coulomb_friction(self) -> None:
        result = diagnose(case(Truth(load=(0.0, 0.15, 0.0))))
        assert named(result) == [("load_friction", (2,))]
        assert result.effects[0].parameters["coefficient"] == pytest.approx(
            [0.15], rel=0.1
        )

    @pytest.mark.nightly
    def test_coulomb_friction_is_told_from_load_friction(self) -> None:
        result = diagnose(case(Truth(coulomb=(0.0, 3.0, 0.0))))
        assert named(result) == [("coulomb_friction", (2,))]
        assert result.effects[0].parameters["torque"] == pytest.approx([3.0], rel=0.1)

    def test_an_unknown_payload_is_found_on_top(self) -> None:
        result = diagnose(case(Truth(mass=1.5, com=(0.2, 0.0, 0.0))))
        assert named(result) == [("payload", ())]
        assert float(result.effects[0].parameters["mass"]) == pytest.approx(
            1.5, rel=0.05
        )


def compared(today: Case, before: Case, folder: Path) -> Change:
    return diagnose_change(today, identify_reference(before), folder)


class TestAgainst:
    """What changed since a reference."""

    @pytest.mark.parametrize("known", daily(("case", "reference"), "case"))
    def test_a_declared_load_is_no_news(self, known: str, tmp_path: Path) -> None:
        plain, carried = synthetic.case(seed=4), case()
        today, before = (carried, plain) if known == "case" else (plain, carried)
        document = compared(today, before, tmp_path).diagnosis.document
        assert document["verdict"] == "no_gap"

    @pytest.mark.nightly
    def test_one_that_is_not_declared_is(self, tmp_path: Path) -> None:
        change = compared(case(declared=False), synthetic.case(seed=4), tmp_path)
        assert change.diagnosis.document["verdict"] != "no_gap"


class TestPrediction:
    """Torque of one recording."""

    def test_predicted_torque_carries_it(self) -> None:
        recording = case().recordings[1]
        with_it, without = (
            predict_torque(CorrectedArm(synthetic.arm()), r)
            for r in (recording, replace(recording, payload=None))
        )
        assert recording.tau is not None
        inner = slice(100, -100)
        left, more = (
            np.sqrt(((recording.tau - x)[inner] ** 2).mean(axis=0))
            for x in (with_it, without)
        )
        assert (left[1:] < 0.1 * more[1:]).all()


@pytest.mark.nightly
def test_identification_takes_it_out_of_the_torque() -> None:
    """The arm identified on recordings with and without a declared load is the arm without it."""
    few = IdentificationSettings(plain=True)
    told, hidden = (
        identify(case(declared=declared), few) for declared in (True, False)
    )
    mass = [float(result.validation[0].every.overall) for result in (told, hidden)]
    assert mass[0] < 0.02 and mass[1] > 2 * mass[0]
    nominal = told.columns.nominal(told.choice.law)
    row = told.columns.smooth(segment(0).motion)[:, 1, : told.columns.links]
    difference = row @ (told.physical.value - nominal)[: told.columns.links]
    assert (
        np.abs(difference).max()
        < 0.03 * np.abs(row @ nominal[: told.columns.links]).max()
    )
