"""Plan, time limit, cuts and scores of the benchmark of real arms."""

import importlib
import time

import common as runner
import numpy as np
import pytest
import real_carriers as carriers
import real_cases as plan
from guard import HANG

from gapscope.arm.case import Case
from gapscope.arm.io.import_section import Import
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording

scoring = importlib.import_module("26_real_benchmark")
SIZES = [2.5, 4.0, 8.0]


def test_cases_of_an_arm_do_not_depend_on_the_other_arms():
    every = plan.planned(list(carriers.ARMS), list(plan.MODES), SIZES, plan.COUNTS)
    alone = plan.planned(["z1"], ["plain"], SIZES, plan.COUNTS)
    assert set(alone) <= set(every)


def test_all_effects_come_first_somewhere_in_the_default_set():
    cases = plan.planned(list(carriers.ARMS), list(plan.MODES), SIZES, plan.COUNTS)
    singles = [c for c in cases if c.kind == "single"]
    assert {plan.order(c, 1)[0] for c in singles} == set(plan.LAWS)


def test_reference_and_piece_share_no_sample(tmp_path):
    arm = NominalArm("a", tmp_path / "a.urdf", ("j1",))
    t = np.arange(1000) / 100
    long = Recording("long", t, t[:, None], t[:, None])
    short = Recording("short", t[:300], -t[:300, None], t[:300, None])
    case = Case("a", tmp_path, arm, (long, short))
    reference, piece = carriers.cut(case, (0.4, 0.7))
    names = [r.name for r in reference.recordings]
    assert names == ["before", "after", "short"]
    inside = piece.recordings[0]
    assert inside.t[0] == 0
    assert inside.q.min() > reference.recordings[0].q.max()
    assert inside.q.max() < reference.recordings[1].q.min()
    assert len(inside.t) + sum(len(r.t) for r in reference.recordings) == 1300


def test_coupled_motors_stay_declared(tmp_path):
    # motor 2 turns twice for joint 2 and once for joint 1: 3 and 2 rad are 3 and 7 rad of the motors
    coupled = np.array([[1.0, 0.0], [1.0, 2.0]])
    recording = Recording("r", np.arange(2.0), [[3.0, 2.0]] * 2, [[5.0, 4.0]] * 2)
    moved = carriers.on_motor_side(recording, coupled)
    assert moved.q[0].tolist() == [3.0, 7.0]
    # power is the same: 5 w1 + 4 w2 = 3 u1 + 2 u2 with u1 = w1, u2 = w1 + 2 w2
    assert moved.tau[0].tolist() == [3.0, 2.0]
    back = Import(transmission=coupled).to_joint_side({"q": moved.q, "tau": moved.tau})
    assert back["q"] == pytest.approx(recording.q)
    assert back["tau"] == pytest.approx(recording.tau)


@pytest.mark.nightly
def test_task_beyond_its_time_is_ended_and_one_that_fails_is_told(tmp_path):
    def work(task):
        if task == "slow":
            time.sleep(HANG)
        while task == "busy":
            pass
        if task == "broken":
            # a process that dies without a word, as of a fault in C
            import os

            os._exit(3)
        (tmp_path / task).touch()

    ended = {}
    # what is to end has time for it on a busy machine; what never ends need not wait
    for tasks, limit in ((["good", "broken"], HANG), (["slow", "busy"], 1.0)):
        runner.run_tasks(
            work, tasks, 2, limit, lambda x, how, _: ended.update({x: how})
        )
    late = {"slow": "timed out", "busy": "timed out"}
    assert ended == late | {"good": "ended", "broken": "died"}
    assert (tmp_path / "good").exists()


def entry(name, joints, value, **more):
    parameter = "torque" if "torque" in name or "coulomb" in name else "mass"
    parameters = {parameter: {"unit": "N m", "value": value, "std": value}}
    return {"effect": name, "joints": joints, "parameters": parameters, **more}


def scored(kind, effects, number=0, **result):
    """The row of a case by its hidden effects and what came of it."""
    size = 4.0 if effects else 0.0
    case = plan.Planned("ur10", "plain", kind, number, size)
    truth = {"kind": kind, "effects": list(effects), "gap": [0.0] * 6}
    truth |= {"motions": ["slow", "slow"], "severity": [4, 4] if effects else None}
    truth |= {"measure": "torque", "conditions": {"robot": "ur10"}}
    return scoring.scored(case, truth, {"cpu_seconds": 10.0, **result})


def one(kind, effects, *found, number=0):
    """A case that was diagnosed, with what was found: name, joints and value."""
    reported = [entry(*x, probability=0.9, alternatives=[]) for x in found]
    verdict = "effects_found" if reported else "no_gap"
    document = {"verdict": verdict, "effects": reported, "possible": []}
    return scored(kind, effects, number, status="done", document=document)


def table(rows, title):
    tables = {t.title.split(" (")[0]: t for t in scoring.score_tables(rows)}
    return tables[title]


def test_scores_of_right_wrong_and_healthy_cases():
    offset = entry("torque_offset", [2], [2.0])
    rows = [
        one("single", [offset], ("torque_offset", [2], [2.2])),
        one("single", [offset], ("coulomb_friction", [2], [2.0]), number=1),
        one("healthy", []),
        one("healthy", [], ("torque_offset", [1], [1.0]), number=1),
    ]
    (row,) = table(rows, "Total").rows
    assert row[:7] == ("all", "4", *["1/2 (50 %)"] * 3, "1/1 (100 %)", "10 %")
    wrong = [r[0] for r in table(rows, "Wrong cases").rows]
    assert wrong == [rows[1].plan.name, rows[3].plan.name]
    (bin_,) = table(rows, "Calibration").rows
    assert bin_[1:4] == ("3", "0.90", "0.33")


def test_failed_case_counts_as_wrong_and_failed():
    offset = entry("torque_offset", [2], [2.0])
    row = scored("single", [offset], status="failed", error="LinAlgError")
    total = table([row], "Total").rows[0]
    assert total[3] == "0/1 (0 %)"
    assert total[-1] == "1"
