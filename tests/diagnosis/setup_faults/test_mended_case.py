"""The mended case: a case with a fault, written, diagnosed, and read again as the diagnosis says."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import synthetic
import yaml
from cases import each
from fault_examples import FAULTS

from gapscope.arm.case import Case, load_case
from gapscope.arm.control import PD
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.io.write_case import write_case
from gapscope.arm.recording import CHANNELS, Recording
from gapscope.diagnosis.setup_faults.found_fault import FoundFault, repaired
from gapscope.diagnosis.setup_faults.references import OtherGainsAtWork
from gapscope.effects.setup_faults import FAULTS as CATALOGUE
from gapscope.effects.setup_faults import (
    Fault,
    GainMismatch,
    IgnoredVelocityReference,
    JointSwap,
    SignFlip,
    SpeedScaling,
    TimeStamps,
    UnitMismatch,
    VelocityOfReference,
)
from gapscope.reports.mended_case import CASE, write_mended_case

N = synthetic.N


def found(fault: Fault) -> FoundFault:
    """A fault as a diagnosis finds it, with values that are exact."""
    return FoundFault(fault, 1.0)


MENDED = (
    *("torque turned", "position turned", "joints exchanged", "torques exchanged"),
    *("degrees", "revolutions", "milliseconds", "a joint on the motor's side"),
    *("inertials shifted", "zero a quarter of a turn off", "gravity left out"),
    *("currents", "torque late", "half the rate"),
)


@cache
def sound() -> Case:
    """A case without a fault."""
    return synthetic.case(synthetic.Truth(), seed=3)


def spoilt(*faults: Fault) -> Case:
    """The case as a set-up with the faults would have recorded it."""
    case, rng = sound(), np.random.default_rng(0)
    for fault in faults:
        case = fault.in_case(case, rng, sound().arm)
    return case


def assert_sound(case: Case, least: float = 1.0) -> None:
    """Every channel is that of the sound case, and its arm weighs the same; of ``least`` [1] of the rows."""
    assert RigidBody(case.arm).inertial_parameters() == pytest.approx(
        RigidBody(sound().arm).inertial_parameters()
    )
    for given, kept in zip(case.recordings, sound().recordings, strict=True):
        assert len(given.t) >= least * len(kept.t)
        rows = np.searchsorted(kept.t, given.t - 1e-6)
        for channel in ("t", "q", "tau"):
            read, right = getattr(given, channel), getattr(kept, channel)[rows]
            np.testing.assert_allclose(read, right, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("label", MENDED)
def test_a_fault_of_the_catalogue_is_put_right(label: str, tmp_path: Path) -> None:
    """Every row but the first and last ones of a torque that was late, by a multiple of the period."""
    fault = FAULTS[label]
    file = write_case(spoilt(fault), tmp_path / "case", ending="npz")
    bad = load_case(file, any_unit=True)
    out = tmp_path / "results" / "here"
    first, *_ = write_mended_case((found(fault),), bad, lambda: file, out)
    right = load_case(first)
    assert first == out / CASE
    assert_sound(right, 0.98 if label == "torque late" else 1.0)


OF_REFERENCES: dict[str, tuple[Fault, str]] = {
    "velocity of the reference": (VelocityOfReference(), "  dq: null"),
    "velocity reference ignored": (
        IgnoredVelocityReference(0.05),
        "    reference: {lead: 0.05}",
    ),
    "slower than the reference": (SpeedScaling(0.6), "    reference: {pace: 0.6}"),
    "other gains": (GainMismatch(4.0, 0.5, (1, 2, 3)), "controller:"),
    "torque of gains": (
        OtherGainsAtWork(kp_at_work=80.0, kd_at_work=4.0),
        "  tau: null",
    ),
}


@pytest.mark.parametrize("label", OF_REFERENCES)
def test_references_and_controller_are_read_as_the_diagnosis_reads_them(
    label: str, tmp_path: Path
) -> None:
    fault, line = OF_REFERENCES[label]
    diagnosed = found(fault)
    gains = {"kp": np.full(N, 80.0), "kd": np.full(N, 4.0)}

    def referred(r: Recording) -> Recording:
        return replace(r, q_ref=r.q + 0.01 * np.sin(r.q), dq=0.9 * r.q, dq_ref=r.q)

    controller = PD(rate=500.0, velocity_cutoff=50.0, **gains)
    case = replace(each(sound(), referred), controller=controller)
    file = write_case(case, tmp_path / "case", ending="npz")
    bad = load_case(file)
    first, *_ = write_mended_case((diagnosed,), bad, lambda: file, tmp_path)
    given, expected = load_case(first), repaired(bad, (diagnosed,))
    assert f"{line}  # {diagnosed}" in first.read_text().splitlines()
    assert isinstance(given.controller, PD) and isinstance(expected.controller, PD)
    np.testing.assert_allclose(given.controller.kp, expected.controller.kp)
    np.testing.assert_allclose(given.controller.kd, expected.controller.kd)
    for one, other in zip(given.recordings, expected.recordings, strict=True):
        # without a torque, whose noise tells, a few more rows are taken for repeated ones
        assert 0 <= len(other.t) - len(one.t) < 10
        rows = np.searchsorted(other.t, one.t - 1e-6)
        for channel in ("t", *CHANNELS):
            series, right = getattr(one, channel), getattr(other, channel)
            assert (series is None) == (right is None), channel
            if right is not None:
                np.testing.assert_allclose(series, right[rows], rtol=1e-9, atol=1e-9)


def test_every_fault_of_the_catalogue_is_tried() -> None:
    tried = {FAULTS[label].name for label in MENDED}
    tried |= {fault.name for fault, _ in OF_REFERENCES.values()}
    # a reference that was recorded coarsely is smoothed by every diagnosis
    assert tried | {"coarse_reference"} == set(CATALOGUE)


def test_what_a_case_file_cannot_say_is_said_to_be_left(tmp_path: Path) -> None:
    """A slider at another place in one recording: its pace is no line of the case."""
    file = write_case(sound(), tmp_path / "case", ending="npz")
    case = load_case(file)
    slider = replace(found(SpeedScaling(0.6)), recordings=(case.recordings[0].name,))
    turned = found(FAULTS["torque turned"])
    first, *_ = write_mended_case((turned, slider), case, lambda: file, tmp_path)
    assert "# left to every diagnosis: speed scaling" in first.read_text()
    assert "pace" not in first.read_text()


def test_two_faults_with_the_reason_on_each_line(tmp_path: Path) -> None:
    """In the order in which they were found: what is exchanged was in degrees before."""
    case = spoilt(UnitMismatch("degrees", (2,)), JointSwap((2, 3), "joint"))
    file = write_case(case, tmp_path / "case", ending="npz")
    exchanged, degrees = FAULTS["joints exchanged"], UnitMismatch("degrees", (2,))
    faults = (found(exchanged), found(degrees))
    first, *_ = write_mended_case(faults, case, lambda: file, tmp_path)
    assert_sound(load_case(first))
    lines = {
        line.split(":")[0].strip(): line for line in first.read_text().splitlines()
    }
    both = "# joint swap (joint) of joints 2 and 3; unit mismatch (degrees) of joint 2"
    assert lines["motion"].endswith(both) and "columns: [1, 3, 2]" in lines["motion"]
    assert lines["torque"].endswith("# joint swap (joint) of joints 2 and 3")


def test_what_asks_for_no_other_reading_leaves_no_file(tmp_path: Path) -> None:
    """Jitter is put right at every diagnosis; what an earlier run has left is removed."""
    (tmp_path / CASE).write_text("name: of an earlier run")
    jitter = found(TimeStamps("jitter", 0.2))
    assert write_mended_case((jitter,), sound(), Path, tmp_path) == ()
    assert not (tmp_path / CASE).exists()


def test_it_comes_on_top_of_the_import_section_of_the_case(tmp_path: Path) -> None:
    """Columns of other names, turned, on the motor's side of a coupled gear; on top of that a torque, twice."""
    case = spoilt(SignFlip((2,)))
    ratios = np.array([[50.0, 0, 0], [0, 60.0, 0], [0, 20.0, 80.0]])
    signs = np.array([1.0, 1.0, -1.0])
    for number, recording in enumerate(case.recordings):
        motor = (recording.q * signs) @ ratios.T
        torque = (recording.tau * signs) @ np.linalg.inv(ratios)
        columns = {"stamp": recording.t * 1e3}
        columns |= {f"pos_{j}": np.rad2deg(motor[:, j]) for j in range(3)}
        columns |= {f"tau_{j}": torque[:, j] for j in range(3)}
        np.savez(tmp_path / f"log_{number}.npz", **columns)
    content: dict[str, Any] = {
        "name": "coupled",
        "robot": str(case.arm.urdf),
        "recordings": [f"log_{k}.npz" for k in range(len(case.recordings))],
        "import": {
            "time": {"column": "stamp", "unit": "ms"},
            "q": {"column": "pos_{j0}", "unit": "deg"},
            "tau": "tau_{j0}",
            "transmission": {"matrix": ratios.tolist()},
            "signs": [1, 1, -1],
        },
    }
    file = tmp_path / "case.yaml"
    file.write_text(yaml.safe_dump(content))
    turned = found(FAULTS["torque turned"])
    exchanged = found(FAULTS["torques exchanged"])
    first, *_ = write_mended_case((turned,), case, lambda: file, tmp_path / "results")
    assert_sound(load_case(first))
    # what exchanges the torques once more on top of that puts them right
    wrong, *_ = write_mended_case((exchanged,), case, lambda: first, tmp_path / "wrong")
    with pytest.raises(AssertionError):
        assert_sound(load_case(wrong))
    again, *_ = write_mended_case((exchanged,), case, lambda: wrong, tmp_path / "again")
    assert_sound(load_case(again))


def test_stamps_of_some_files_alone(tmp_path: Path) -> None:
    case = sound()
    first, *others = case.recordings
    first = replace(first, t=1e3 * first.t)
    stamped = replace(case, recordings=(first, *others))
    file = write_case(stamped, tmp_path / "case", ending="npz")
    name = load_case(file, any_unit=True).recordings[0].name
    diagnosed = replace(found(FAULTS["milliseconds"]), recordings=(name,))
    made, *_ = write_mended_case((diagnosed,), case, lambda: file, tmp_path)
    assert_sound(load_case(made))


def test_a_mend_that_does_not_fit_the_arm_is_refused(tmp_path: Path) -> None:
    file = write_case(sound(), tmp_path / "case", ending="npz")
    content = yaml.safe_load(file.read_text())
    for entry, message in (
        ({"columns": [1, 2]}, "import.mend.motion.columns: expected 3 entries"),
        ({"columns": [1, 2, 4]}, "expected each of the numbers 1 to 3 once"),
        ({"scale": [1.0, 2.0]}, "import.mend.motion.scale: expected 3 entries"),
    ):
        section = {"import": {"mend": {"motion": entry}}}
        file.write_text(yaml.safe_dump(content | section))
        with pytest.raises(InputError) as caught:
            load_case(file)
        assert message in str(caught.value)
