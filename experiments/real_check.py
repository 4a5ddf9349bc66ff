"""Whether the truth of a made case closes its gap: predicted with the identified arm, without and with the truth."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from common import run_tasks
from real_carriers import load_prepared
from real_plan import Planned, read_truth

from gapscope.arm.case import load_case
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.io.json_file import read_json, write_json
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected import CorrectedArm
from gapscope.model.conditioning import condition, position_cutoff
from gapscope.model.torque_gap import torque_gap
from gapscope.reports.blind_check.tables import Table

LIMIT = 300.0
"""Longest time for one case [s]."""


def rms(
    arm: NominalArm, effects: tuple[AppliedEffect, ...], r: Recording
) -> np.ndarray:
    """RMS of the torque gap of an arm with effects on a recording [N m], (n,)."""
    segments = condition(r, position_cutoff((r,)))
    return torque_gap(CorrectedArm(arm, effects), RigidBody(arm), segments).rmse


def truth_effects(truth: dict[str, Any]) -> tuple[AppliedEffect, ...] | None:
    """The effects of a label; ``None`` if it holds what predicts no torque: a fault, or rounding."""
    names = {entry["effect"] for entry in truth["effects"]}
    if truth["measure"] == "none" or "encoder_quantization" in names:
        return None
    out = []
    for entry in truth["effects"]:
        values = {k: np.array(v["value"]) for k, v in entry["parameters"].items()}
        out.append(AppliedEffect(entry["effect"], tuple(entry["joints"]), values))
    return tuple(out)


def check(plan: Planned, out: Path, file: Path) -> None:
    """Measure the gap of one case against the identified arm, and write it to a file."""
    truth = read_truth(plan, out)
    effects = truth_effects(truth)
    if not effects:
        write_json({}, file)
        return
    prepared = load_prepared(plan.arm, plan.cut, out)
    # the arm identified on all recordings fits best, and stands for the true one
    base = prepared.whole.arm if plan.mode == "against" else prepared.identified.arm
    unchanged = prepared.case if plan.mode == "against" else prepared.identified
    changed = load_case(out / "cases" / plan.name).recordings[0]
    write_json(
        {
            "healthy": rms(base, (), unchanged.recordings[0]),
            "before": rms(base, (), changed),
            "after": rms(base, effects, changed),
        },
        file,
    )


def check_table(cases: list[Planned], out: Path, jobs: int) -> Table:
    """A row for each case with effects: RMS of the gap on the joint where it grows most."""
    folder = out / "check"
    chosen = [c for c in cases if c.kind != "healthy"]
    run_tasks(
        lambda plan: check(plan, out, folder / f"{plan.name}.json"),
        chosen,
        jobs,
        LIMIT,
        lambda plan, how, s: print(plan.name, how, f"{s:.0f} s", flush=True),
    )
    rows = []
    for plan in chosen:
        file = folder / f"{plan.name}.json"
        if file.is_file():
            rows.append(_row(plan, read_truth(plan, out), read_json(file, "")))
    head = ("case", "size", "effects", "joint", "healthy", "before", "after", "closed")
    return Table("Gap with the true effects [N m]", head, tuple(rows))


def _row(plan: Planned, truth: dict[str, Any], gap: dict[str, Any]) -> tuple[str, ...]:
    names = ", ".join(e["effect"] for e in truth["effects"])
    if not gap:
        return (plan.name, f"{plan.size:g}", names, *["–"] * 5)
    healthy, before, after = (np.array(gap[k]) for k in ("healthy", "before", "after"))
    joint = int(np.argmax(truth["gap"]))
    power = before[joint] ** 2 - healthy[joint] ** 2
    closed = (before[joint] ** 2 - after[joint] ** 2) / max(power, 1e-12)
    figures = [f"{x[joint]:.3g}" for x in (healthy, before, after)]
    return (
        plan.name,
        f"{plan.size:g}",
        names,
        str(joint + 1),
        *figures,
        f"{100 * closed:.0f} %",
    )
