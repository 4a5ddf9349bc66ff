"""The commands record, replay and gap: a case from a simulated arm, aligned, sealed where asked, and replayed."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from sweeps import daily

from gapscope.arm.case import Case, load_case
from gapscope.arm.control import PD
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.io.formats.table_files import read_csv, read_npz, read_parquet
from gapscope.arm.io.locked_section import LOCK
from gapscope.arm.nominal import NominalArm
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected_file import write_corrected
from gapscope.envs.engines import ENGINES
from gapscope.envs.mystery_arm import iiwa
from gapscope.envs.recorder import Plan, record_case

Command = Callable[..., Any]
PAYLOAD = AppliedEffect("payload", (), {"mass": 1.2345, "com": [0.0, 0.01, 0.05]})
DELAY = AppliedEffect("actuator_delay", (2,), {"delay": [0.0087]})
SEED = 918273
RECORDINGS = ["recording_1.csv", "recording_2.csv"]
READERS = {"csv": read_csv, "parquet": read_parquet, "npz": read_npz}


@pytest.fixture
def effects(tmp_path: Path) -> Path:
    write_corrected("made", (PAYLOAD, DELAY), tmp_path / "effects.yaml")
    return tmp_path / "effects.yaml"


@pytest.fixture
def record(gapscope: Command, effects: Path, tmp_path: Path) -> Command:
    """Records two short motions into a folder; its outcome and, if there is one, the case."""

    def call(name: str, *options: object, robot: object = "kuka_iiwa") -> Any:
        out = tmp_path / name
        given = ["--effects", effects, "--recordings", 2, "--duration", 1.5]
        given += ["--out", out, "--seed", SEED, *options]
        done = gapscope("record", robot, *given)
        return done, load_case(out) if done.code == 0 else None

    return call


def _case(arm: NominalArm, *applied: AppliedEffect, **settings: object) -> Case:
    plan = replace(Plan(recordings=1, duration=2.0), **settings)
    return record_case("made", arm, applied, plan, np.random.default_rng(0))


def _effects(path: Path) -> list[str]:
    content = yaml.safe_load(path.read_text(encoding="utf-8"))
    return [entry["effect"] for entry in content["effects"]]


def test_record_makes_a_case_where_a_killed_one_left_its_lock(
    record: Command, tmp_path: Path
) -> None:
    folder = tmp_path / "case"
    folder.mkdir()
    (folder / LOCK).write_text("{}")
    _, case = record("case")
    names = {"case.yaml", "robot.urdf", "truth.yaml", *RECORDINGS}
    assert {path.name for path in folder.iterdir()} == names
    assert (case.name, case.arm.n_joints) == ("case", 7)
    assert [recording.name for recording in case.recordings] == RECORDINGS
    for recording in case.recordings:
        assert recording.rate == pytest.approx(250.0)
        assert recording.duration == pytest.approx(1.5)
        channels = (recording.q_ref, recording.dq_ref, recording.dq)
        assert all(channel is not None for channel in channels)
    slow, fast = (np.abs(recording.dq_ref).max() for recording in case.recordings)
    assert slow < 0.7 * fast
    assert _effects(folder / "truth.yaml") == ["payload", "actuator_delay"]
    # a case lends its data sheet and controller, the same seed records the same, and nothing is overwritten
    _, second = record("second", robot=folder)
    np.testing.assert_array_equal(second.controller.kp, case.controller.kp)
    before = (folder / RECORDINGS[1]).read_bytes()
    assert before == (tmp_path / "second" / RECORDINGS[1]).read_bytes()
    assert record("case", "--noise", 0.5)[0].code == 2
    assert (folder / RECORDINGS[1]).read_bytes() == before


def test_a_trajectory_from_a_file_is_followed_and_slowed_down(
    record: Command, tmp_path: Path
) -> None:
    t = np.linspace(0.0, 2.0, 201)
    rise = 10 * (t / 2) ** 3 - 15 * (t / 2) ** 4 + 6 * (t / 2) ** 5
    start = np.array([0.0, 0.6, 0.0, -1.2, 0.0, 0.8, 0.0])
    q = start + np.outer(rise, np.full(7, 0.3))
    dq = np.gradient(q, t, axis=0)
    rows = np.column_stack([t, q, dq, np.gradient(dq, t, axis=0)])
    names = [f"{n}{j}" for n in ("q_ref", "dq_ref", "ddq_ref") for j in range(1, 8)]
    file, header = tmp_path / "motion.csv", ",".join(["t", *names])
    np.savetxt(file, rows, delimiter=",", header=header, comments="")
    slow, fast = record("case", "--trajectory", file)[1].recordings
    assert slow.duration == pytest.approx(2.0 / 0.4)
    assert fast.duration == pytest.approx(2.0)
    np.testing.assert_allclose(fast.q_ref[-1], start + 0.3, atol=1e-3)
    speeds = [np.abs(recording.dq_ref).max() for recording in (slow, fast)]
    assert speeds[0] == pytest.approx(0.4 * speeds[1], rel=0.02)
    (tmp_path / "cut.csv").write_text("t,q_ref1\n0,0\n")
    done, _ = record("other", "--trajectory", tmp_path / "cut.csv")
    assert done.code == 2 and "has no column q_ref2" in done.err


COLUMNS = {"t"} | {
    f"{name}{j}" for name in ("q", "dq", "tau", "q_ref", "dq_ref") for j in range(1, 8)
}


@pytest.mark.parametrize("ending", READERS)
def test_sealed_truth_leaves_no_trace_in_the_case(
    record: Command, tmp_path: Path, ending: str
) -> None:
    """The case is that of an arm without effects but for the numbers in the recordings."""
    write_corrected("made", (), tmp_path / "none.yaml")
    form, nothing = ("--format", ending), ("--effects", tmp_path / "none.yaml")
    record("with/case", "--sealed", tmp_path / "safe", *form)
    record("without/case", "--sealed", tmp_path / "empty", *form, *nothing)
    truth = _effects(tmp_path / "safe" / "truth.yaml")
    assert truth == ["payload", "actuator_delay"]
    case, plain = tmp_path / "with" / "case", tmp_path / "without" / "case"
    files = sorted(path.name for path in case.rglob("*"))
    recordings = [f"recording_{k}.{ending}" for k in (1, 2)]
    assert files == ["case.yaml", *recordings, "robot.urdf"]
    assert (case / "case.yaml").read_bytes() == (plain / "case.yaml").read_bytes()
    assert (case / "robot.urdf").read_bytes() == iiwa().urdf.read_bytes()
    for name in recordings:
        table = READERS[ending](case / name)
        assert set(table.columns) == COLUMNS
        cells = np.concatenate([np.ravel(x) for x in table.columns.values()])
        assert not np.isin([1.2345, 0.0087, SEED], cells.astype(float)).any()
    for path in (case / name for name in files):
        content = path.read_bytes().lower()
        secrets = (b"payload", b"delay", b"safe", b"seed")
        assert not [word for word in secrets if word in content], path


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("read_back", daily((False, True), False))
def test_torque_and_motion_belong_to_the_same_instant(
    engine: str, read_back: bool
) -> None:
    """Inverse dynamics of central differences against the torque of the same row, not of the one before or after."""
    pytest.importorskip(engine)
    dt, known = 1e-3, iiwa()
    bare = NominalArm("bare", known.urdf, known.joints)
    how = {"rate": 1.0 / dt, "noise": 0.0, "read_back": read_back, "engine": engine}
    made = _case(bare, **how).recordings[0]
    q, torque = made.q, made.tau
    ddq, dq = (q[2:] - 2 * q[1:-1] + q[:-2]) / dt**2, (q[2:] - q[:-2]) / (2 * dt)
    needed = RigidBody(bare).inverse_dynamics(q[1:-1], dq, ddq)
    rate = (torque[2:] - torque[:-2]) / (2 * dt)
    skew = ((needed - torque[1:-1]) * rate).sum(axis=0) / (rate**2).sum(axis=0)
    assert np.abs(skew).max() < 0.1 * dt, skew / dt


def test_the_command_line_records_the_command_and_with_read_back_what_reached_the_joints(
    record: Command, tmp_path: Path
) -> None:
    """Joint 2, behind a delay of five samples, lags; the note says what reading back hides."""
    late = AppliedEffect("actuator_delay", (2,), {"delay": [0.02]})
    write_corrected("made", (PAYLOAD, late), tmp_path / "effects.yaml")
    done, commanded = record("commanded", "--noise", 0)
    assert "read-back" not in done.err
    done, applied = record("applied", "--noise", 0, "--read-back")
    assert "actuator_delay: torque that is read back" in done.err
    one, other = commanded.recordings[0], applied.recordings[0]
    np.testing.assert_array_equal(one.q, other.q)
    np.testing.assert_allclose(other.tau[5:, 1], one.tau[:-5, 1], atol=1e-9)
    others = [0, 2, 3, 4, 5, 6]
    np.testing.assert_allclose(other.tau[:, others], one.tau[:, others], atol=1e-9)


KP = [200.0, 200.0, 100.0, 100.0, 20.0, 10.0, 1.0]
CONTROLLER = {"kind": "pd", "rate": 500, "kp": KP, "kd": [0.05 * k for k in KP]}
CONTROLLER["feedforward"] = "gravity"


def test_a_controller_from_a_file(record: Command, tmp_path: Path) -> None:
    """The section alone, or under its key; it goes before the controller of a case."""
    record("case")
    file, case = tmp_path / "controller.yaml", tmp_path / "case"
    for robot, content in (("kuka_iiwa", CONTROLLER), (case, {"controller": CONTROLLER})):  # fmt: skip
        file.write_text(yaml.safe_dump(content))
        name = Path(robot).name
        used = record(f"of_{name}", "--controller", file, robot=robot)[1].controller
        assert (used.rate, used.feedforward) == (500.0, "gravity")
        assert used.velocity_cutoff is None
        np.testing.assert_array_equal(used.kp, KP)


def test_setup_faults_are_recorded(
    record: Command, effects: Path, tmp_path: Path
) -> None:
    """The same session with and without them: a torque mirrored, inertials on other links, other gains declared."""
    _, right = record("right")
    faults = [
        "{effect: sign_flip, joints: [4], variant: torque}",
        "{effect: shifted_inertials, parameters: {by: 1}}",
        "{effect: gain_mismatch, parameters: {kp_factor: 2, kd_factor: 0.5}}",
    ]
    with effects.open("a") as file:
        file.writelines(f"- {fault}\n" for fault in faults)
    _, wrong = record("wrong")
    for one, other in zip(right.recordings, wrong.recordings, strict=True):
        np.testing.assert_allclose(other.tau, one.tau * [1, 1, 1, -1, 1, 1, 1])
    masses = [RigidBody(c.arm).model.inertias[3].mass for c in (right, wrong)]
    assert masses[0] != masses[1]
    assert isinstance(right.controller, PD) and isinstance(wrong.controller, PD)
    np.testing.assert_allclose(wrong.controller.kp, right.controller.kp / 2)
    np.testing.assert_allclose(wrong.controller.kd, right.controller.kd * 2)
    named = ["sign_flip", "shifted_inertials", "gain_mismatch"]
    truth = _effects(tmp_path / "wrong" / "truth.yaml")
    assert truth == ["payload", "actuator_delay", *named]


def test_noise_is_a_share_of_the_torque() -> None:
    clean, noisy, shaken = (
        _case(iiwa(), **{"noise": 0.0, **how}).recordings[0]
        for how in ({}, {"noise": 0.05}, {"encoder_noise": 1e-4})
    )
    np.testing.assert_array_equal(clean.q, noisy.q)
    share = (noisy.tau - clean.tau).std(axis=0)[1] / clean.tau.std(axis=0)[1]
    assert share == pytest.approx(0.05, rel=0.2)
    assert not np.array_equal(shaken.q, clean.q)


@pytest.mark.parametrize("engine", daily(ENGINES, "mujoco"))
def test_replay_with_the_truth_follows_the_recording(
    gapscope: Command, record: Command, tmp_path: Path, engine: str
) -> None:
    """The torque gap comes with the replay gap."""
    pytest.importorskip(engine)
    folder, out = tmp_path / "case", tmp_path / "replayed.csv"
    recording = record("case")[1].recordings[1]
    more = ("--engine", engine, "--out", out, "--recording", folder / recording.name)
    misses, gaps = [], []
    for model in ((), ("--model", folder / "truth.yaml")):
        assert "wrote" in gapscope("replay", folder, *more, *model).out
        table = np.genfromtxt(out, delimiter=",", names=True)
        q = np.column_stack([table[f"q{j}"] for j in range(1, 8)])
        np.testing.assert_allclose(table["t"], recording.t)
        misses.append(np.sqrt(np.mean((q - recording.q) ** 2)))
        row = json.loads(gapscope("gap", folder, "--json", *model).out)["recordings"][1]
        assert row["replayed"] == "controller" and len(row["replay_rmse"]) == 7
        gaps.append(np.mean(row["replay_rmse"]))
    for before, after in (misses, gaps):
        assert after < 1e-3 and after < 0.1 * before
    assert "replay gap in mrad" in gapscope("gap", folder).out
