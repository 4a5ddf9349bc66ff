"""The commands record, replay and gap: a case from a simulated arm, aligned, sealed where asked, and replayed."""

import json
from dataclasses import replace
from pathlib import Path

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
from gapscope.cli import main
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected_file import write_corrected
from gapscope.envs.engines import ENGINES
from gapscope.envs.mystery_arm import iiwa
from gapscope.envs.recorder import Plan, hidden_by_reading_back, record_case

PAYLOAD = AppliedEffect("payload", (), {"mass": 1.2345, "com": [0.0, 0.01, 0.05]})
DELAY = AppliedEffect("actuator_delay", (2,), {"delay": [0.0087]})
SEED = 918273
READERS = {"csv": read_csv, "parquet": read_parquet, "npz": read_npz}


@pytest.fixture
def effects(tmp_path: Path) -> Path:
    write_corrected("made", (PAYLOAD, DELAY), tmp_path / "effects.yaml")
    return tmp_path / "effects.yaml"


def _run(*arguments: object) -> int:
    """Exit code of a command."""
    with pytest.raises(SystemExit) as stopped:
        main([str(argument) for argument in arguments])
    return int(stopped.value.code or 0)


def _record(
    effects: Path, out: Path, *options: object, robot: object = "kuka_iiwa"
) -> int:
    short = ("--recordings", 2, "--duration", 1.5, "--seed", SEED)
    return _run("record", robot, "--effects", effects, "--out", out, *short, *options)


def _case(arm: NominalArm, *applied: AppliedEffect, **settings: object) -> Case:
    plan = replace(Plan(recordings=1, duration=2.0), **settings)
    return record_case("made", arm, applied, plan, np.random.default_rng(0))


def _effects(path: Path) -> list[str]:
    content = yaml.safe_load(path.read_text(encoding="utf-8"))
    return [entry["effect"] for entry in content["effects"]]


def test_record_makes_a_case_where_a_killed_one_left_its_lock(
    effects: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "case"
    folder.mkdir()
    (folder / LOCK).write_text("{}")
    assert _record(effects, folder) == 0
    names = {"case.yaml", "robot.urdf", "truth.yaml"}
    recordings = ["recording_1.csv", "recording_2.csv"]
    assert {path.name for path in folder.iterdir()} == {*names, *recordings}
    case = load_case(folder)
    assert case.name == "case" and case.arm.n_joints == 7
    assert case.controller is not None
    assert [recording.name for recording in case.recordings] == recordings
    for recording in case.recordings:
        assert recording.rate == pytest.approx(250.0)
        assert recording.duration == pytest.approx(1.5)
        channels = (recording.q_ref, recording.dq_ref, recording.dq)
        assert all(channel is not None for channel in channels)
    slow, fast = (np.abs(recording.dq_ref).max() for recording in case.recordings)
    assert slow < 0.7 * fast
    assert _effects(folder / "truth.yaml") == ["payload", "actuator_delay"]
    # a case lends its data sheet and controller, and is never overwritten
    assert _record(effects, tmp_path / "second", robot=folder) == 0
    second = load_case(tmp_path / "second")
    np.testing.assert_array_equal(second.controller.kp, case.controller.kp)
    before = (folder / "recording_1.csv").read_bytes()
    assert _record(effects, folder, "--noise", 0.5) == 2
    assert (folder / "recording_1.csv").read_bytes() == before


def test_a_trajectory_from_a_file_is_followed_and_slowed_down(
    effects: Path, tmp_path: Path, capsys
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
    assert _record(effects, tmp_path / "case", "--trajectory", file) == 0
    slow, fast = load_case(tmp_path / "case").recordings
    assert slow.duration == pytest.approx(2.0 / 0.4)
    assert fast.duration == pytest.approx(2.0)
    np.testing.assert_allclose(fast.q_ref[-1], start + 0.3, atol=1e-3)
    speeds = [np.abs(recording.dq_ref).max() for recording in (slow, fast)]
    assert speeds[0] == pytest.approx(0.4 * speeds[1], rel=0.02)
    (tmp_path / "cut.csv").write_text("t,q_ref1\n0,0\n")
    options = ("--trajectory", tmp_path / "cut.csv")
    assert _record(effects, tmp_path / "other", *options) == 2
    assert "has no column q_ref2" in capsys.readouterr().err


COLUMNS = {"t"} | {
    f"{name}{j}" for name in ("q", "dq", "tau", "q_ref", "dq_ref") for j in range(1, 8)
}


@pytest.mark.parametrize("ending", ["csv", "parquet", "npz"])
def test_sealed_truth_leaves_no_trace_in_the_case(
    effects: Path, tmp_path: Path, ending: str
) -> None:
    """The case is that of an arm without effects but for the numbers in the recordings."""
    write_corrected("made", (), tmp_path / "none.yaml")
    case, plain = tmp_path / "with" / "case", tmp_path / "without" / "case"
    for file, out, safe in (
        (effects, case, tmp_path / "safe"),
        (tmp_path / "none.yaml", plain, tmp_path / "empty"),
    ):
        assert _record(file, out, "--sealed", safe, "--format", ending) == 0
    truth = tmp_path / "safe" / "truth.yaml"
    assert _effects(truth) == ["payload", "actuator_delay"]
    files = sorted(path.name for path in case.rglob("*"))
    recordings = [f"recording_{k}.{ending}" for k in (1, 2)]
    assert files == ["case.yaml", *recordings, "robot.urdf"]
    assert (case / "case.yaml").read_bytes() == (plain / "case.yaml").read_bytes()
    assert (case / "robot.urdf").read_bytes() == iiwa().urdf.read_bytes()
    for name in files[1:3]:
        table = READERS[ending](case / name)
        assert set(table.columns) == COLUMNS
        secrets = [1.2345, 0.0087, float(SEED)]
        assert not any(
            np.isin(secrets, np.asarray(cells, dtype=float)).any()
            for cells in table.columns.values()
        )
    for path in (case / name for name in files):
        content = path.read_bytes().lower()
        assert not [
            word for word in (b"payload", b"delay", b"safe", b"seed") if word in content
        ], path


def test_the_same_seed_records_the_same(effects: Path, tmp_path: Path) -> None:
    for name in ("a", "b"):
        assert _record(effects, tmp_path / name) == 0
    first, second = (tmp_path / name / "recording_2.csv" for name in ("a", "b"))
    assert first.read_bytes() == second.read_bytes()


def test_without_a_seed_each_session_differs() -> None:
    plan, arm = Plan(recordings=1, duration=1.0), iiwa()
    first, second = (
        record_case("made", arm, (), plan, np.random.default_rng()).recordings[0]
        for _ in range(2)
    )
    assert not np.allclose(first.q, second.q)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--trajectory", "fourrier"), "fourier"),
        (("--engine", "ode"), "pybullet"),
        (("--format", "xlsx"), "npz"),
        (("--controller", "lqr"), "controller: section of a case"),
        (("--rate", 300), "divide"),
        (("--duration", 0.2), "at least"),
        (("--duration", 1e9), "5e+11 samples"),
        (("--rate", 1e9), "beyond any robot's log"),
        (("--recordings", 1_000_000), "at most 4,000,000"),
        (("--recordings", 0), "whole number"),
    ],
)
def test_bad_options_are_named(
    effects: Path, tmp_path: Path, capsys, options: tuple, message: str
) -> None:
    assert _record(effects, tmp_path / "case", *options) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "case").exists()


def test_the_seal_must_lie_outside_the_case(
    effects: Path, tmp_path: Path, capsys
) -> None:
    case = tmp_path / "case"
    assert _record(effects, case, "--sealed", case / "safe") == 2
    assert "sealed" in capsys.readouterr().err


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("read_back", daily((False, True), False))
def test_torque_and_motion_belong_to_the_same_instant(
    engine: str, read_back: bool
) -> None:
    """Inverse dynamics of central differences against the torque of the same row, not of the one before or after."""
    pytest.importorskip(ENGINES[engine].library)
    dt, known = 1e-3, iiwa()
    bare = NominalArm("bare", known.urdf, known.joints)
    made = _case(
        bare, rate=1.0 / dt, noise=0.0, read_back=read_back, engine=engine
    ).recordings[0]
    q, torque = made.q, made.tau
    ddq, dq = (q[2:] - 2 * q[1:-1] + q[:-2]) / dt**2, (q[2:] - q[:-2]) / (2 * dt)
    needed = RigidBody(bare).inverse_dynamics(q[1:-1], dq, ddq)
    rate = (torque[2:] - torque[:-2]) / (2 * dt)
    skew = ((needed - torque[1:-1]) * rate).sum(axis=0) / (rate**2).sum(axis=0)
    assert np.abs(skew).max() < 0.1 * dt, skew / dt


def test_what_is_read_back_behind_a_delay_lags_what_is_commanded_by_it() -> None:
    delay = AppliedEffect("actuator_delay", (1, 2), {"delay": [0.02, 0.02]})
    applied, commanded = (
        _case(iiwa(), delay, noise=0.0, read_back=kind).recordings[0]
        for kind in (True, False)
    )
    np.testing.assert_array_equal(applied.q, commanded.q)
    np.testing.assert_allclose(applied.tau[5:, :2], commanded.tau[:-5, :2], atol=1e-9)
    np.testing.assert_allclose(applied.tau[:, 2:], commanded.tau[:, 2:], atol=1e-9)
    assert hidden_by_reading_back((delay, PAYLOAD)) == ("actuator_delay",)


def test_the_command_line_records_the_command_and_with_read_back_what_reached_the_joints(
    effects: Path, tmp_path: Path, capsys
) -> None:
    """Joint 2, behind a delay of 8.7 ms, differs between the two; the note says what reading back hides."""
    assert _record(effects, tmp_path / "commanded", "--noise", 0) == 0
    assert "read-back" not in capsys.readouterr().err
    assert _record(effects, tmp_path / "applied", "--noise", 0, "--read-back") == 0
    assert "actuator_delay: torque that is read back" in capsys.readouterr().err
    commanded, applied = (
        load_case(tmp_path / name).recordings[0] for name in ("commanded", "applied")
    )
    np.testing.assert_array_equal(commanded.q, applied.q)
    differs = np.abs(commanded.tau - applied.tau).max(axis=0) > 1e-9
    assert differs.tolist() == [False, True, False, False, False, False, False]


KP = [200.0, 200.0, 100.0, 100.0, 20.0, 10.0, 1.0]
CONTROLLER = {
    "kind": "pd",
    "rate": 500,
    "kp": KP,
    "kd": [0.05 * k for k in KP],
    "feedforward": "gravity",
}


@pytest.mark.parametrize("key", [None, "controller"])
def test_a_controller_from_a_file(
    effects: Path, tmp_path: Path, key: str | None
) -> None:
    """The section alone, or under its key; it goes before the controller of a case."""
    file = tmp_path / "controller.yaml"
    file.write_text(yaml.safe_dump(CONTROLLER if key is None else {key: CONTROLLER}))
    assert _record(effects, tmp_path / "first") == 0
    second = tmp_path / "second"
    options = ("--controller", file)
    assert _record(effects, second, *options, robot=tmp_path / "first") == 0
    used = load_case(second).controller
    assert (used.rate, used.feedforward) == (500.0, "gravity")
    assert used.velocity_cutoff is None
    np.testing.assert_array_equal(used.kp, KP)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (
            CONTROLLER | {"kp": KP[:6]},
            "controller.yaml, field kp: expected 7 numbers, one per joint, got 6",
        ),
        (CONTROLLER | {"kd": [float("nan")] * 7}, "field kd: expected 7 numbers"),
        (CONTROLLER | {"kb": [1.0] * 7}, "unknown key 'kb'"),
        (
            CONTROLLER | {"feedforward": "inverse"},
            "field feedforward: expected one of none, gravity, nominal",
        ),
        (CONTROLLER | {"rate": 0}, "field rate: expected a number above 0"),
        ({"rate": 500, "kp": KP}, "lacks the key 'kd'"),
        (None, "holds no controller"),
        ([1, 2], "expected a mapping"),
    ],
)
def test_a_controller_file_at_fault_is_named(
    effects: Path, tmp_path: Path, capsys, content: object, message: str
) -> None:
    file = tmp_path / "controller.yaml"
    file.write_text(yaml.safe_dump(content))
    assert _record(effects, tmp_path / "case", "--controller", file) == 2
    assert message in " ".join(capsys.readouterr().err.split())
    assert not (tmp_path / "case").exists()


def test_setup_faults_are_recorded(effects: Path, tmp_path: Path) -> None:
    """The same session with and without them: a torque mirrored, inertials on other links, other gains declared."""
    faulty = tmp_path / "faulty.yaml"
    faults = [
        "{effect: sign_flip, joints: [4], variant: torque}",
        "{effect: shifted_inertials, parameters: {by: 1}}",
        "{effect: gain_mismatch, parameters: {kp_factor: 2, kd_factor: 0.5}}",
    ]
    added = "".join(f"- {fault}\n" for fault in faults)
    faulty.write_text(effects.read_text() + added)
    for file, name in ((effects, "right"), (faulty, "wrong")):
        assert _record(file, tmp_path / name) == 0
    right, wrong = load_case(tmp_path / "right"), load_case(tmp_path / "wrong")
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
    clean, noisy = (_case(iiwa(), noise=share).recordings[0] for share in (0.0, 0.05))
    np.testing.assert_array_equal(clean.q, noisy.q)
    share = (noisy.tau - clean.tau).std(axis=0)[1] / clean.tau.std(axis=0)[1]
    assert share == pytest.approx(0.05, rel=0.2)
    assert not np.array_equal(
        _case(iiwa(), encoder_noise=1e-4).recordings[0].q, clean.q
    )


@pytest.mark.parametrize("engine", ENGINES)
def test_replay_with_the_truth_follows_the_recording(
    effects: Path, tmp_path: Path, engine: str, capsys
) -> None:
    pytest.importorskip(ENGINES[engine].library)
    case, out = tmp_path / "case", tmp_path / "replayed.csv"
    assert _record(effects, case) == 0
    recording = load_case(case).recordings[1]
    common = ("replay", case, "--engine", engine, "--out", out, "--recording")
    misses = []
    for model in ((), ("--model", case / "truth.yaml")):
        assert _run(*common, case / recording.name, *model) == 0
        table = np.genfromtxt(out, delimiter=",", names=True)
        q = np.column_stack([table[f"q{j}"] for j in range(1, 8)])
        np.testing.assert_allclose(table["t"], recording.t)
        misses.append(np.sqrt(np.mean((q - recording.q) ** 2)))
    assert misses[1] < 1e-3 and misses[1] < 0.1 * misses[0]
    assert "wrote" in capsys.readouterr().out
    assert _run(*common, case / "none.csv") == 2
    assert "none.csv" in capsys.readouterr().err


def test_gap_gives_the_replay_gap_too(effects: Path, tmp_path: Path, capsys) -> None:
    case = tmp_path / "case"
    assert _record(effects, case) == 0
    capsys.readouterr()
    gaps = []
    for model in ((), ("--model", case / "truth.yaml")):
        assert _run("gap", case, "--json", *model) == 0
        row = json.loads(capsys.readouterr().out)["recordings"][1]
        assert row["replayed"] == "controller" and len(row["replay_rmse"]) == 7
        gaps.append(np.mean(row["replay_rmse"]))
    assert gaps[1] < 1e-3 and gaps[1] < 0.1 * gaps[0]
    assert _run("gap", case) == 0
    assert "replay gap in mrad" in capsys.readouterr().out
