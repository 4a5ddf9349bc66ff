"""A benchmark of the diagnosis on real arms with known truth: make, diagnose, score; prints the tables as Markdown.

    GAPSCOPE_DATA=.../data .venv/bin/python experiments/26_real_benchmark.py --out out/real [--jobs 2] [--per-arm 36]

Recordings of seven real arms are carriers (``real_carriers.py``): the unchanged recording is a healthy case, and
effects of known size are put into it by laws that are not the catalogue's (``real_cases.py``); see
``docs/real_arms.md``.

Resumable: run it again for the rest; each case has a result file that is written whole. ``--step check`` shows that the
injected truth closes the gap. ``--results NAME`` keeps the results of several versions of the diagnosis side by side.
"""

from __future__ import annotations

import sys
import warnings
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from common import (
    Progress,
    grouped,
    run_missing,
    run_tasks,
    stated,
    study,
    study_options,
)
from real_carriers import (
    ARMS,
    WINDOW_FILE,
    cut_folder,
    load_prepared,
    prepare_arm,
    prepare_cut,
)
from real_cases import (
    MODES,
    PER_ARM,
    SIZES,
    Planned,
    counts,
    make_case,
    planned,
    read_truth,
    reference_of,
    truth_file,
)

from gapscope.arm.case import load_case
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import ModelWarning
from gapscope.arm.io.json_file import read_json
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording
from gapscope.blind_check.scoring import (
    Compared,
    brier,
    compare,
    reliability,
    wilson,
)
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected import CorrectedArm
from gapscope.model.conditioning import condition, position_cutoff
from gapscope.model.torque_gap import torque_gap
from gapscope.reports.pages import PageSection as Table

# Whether the truth of a case closes its gap

CHECK_LIMIT = 300.0
"""Longest time to check one case [s]."""


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


def check(plan: Planned, out: Path) -> dict[str, Any]:
    """The gap of one case against the identified arm; empty if its effects predict no torque."""
    truth = read_truth(plan, out)
    effects = truth_effects(truth)
    if not effects:
        return {}
    prepared = load_prepared(plan.arm, plan.cut, out)
    # the arm identified on all recordings fits best, and stands for the true one
    base = prepared.whole.arm if plan.mode == "against" else prepared.identified.arm
    unchanged = prepared.case if plan.mode == "against" else prepared.identified
    changed = load_case(out / "cases" / plan.name).recordings[0]
    return {
        "healthy": rms(base, (), unchanged.recordings[0]),
        "before": rms(base, (), changed),
        "after": rms(base, effects, changed),
    }


def check_table(cases: list[Planned], out: Path, jobs: int) -> Table:
    """A row for each case with effects: RMS of the gap on the joint where it grows most."""
    files = {out / "check" / f"{c.name}.json": c for c in cases if c.kind != "healthy"}
    run_missing(lambda plan: check(plan, out), files, jobs, CHECK_LIMIT)
    rows = [
        _row(plan, read_truth(plan, out), read_json(file, "remove it"))
        for file, plan in files.items()
        if file.is_file()
    ]
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


class Scored(NamedTuple):
    """A case with its truth, its result and how they compare.

    Attributes:
        plan, truth: the case.
        result: of the diagnosis: ``status``, ``document``, seconds.
        compared: names, joints and parameters beside the truth.
    """

    plan: Planned
    truth: dict[str, Any]
    result: dict[str, Any]
    compared: Compared

    @property
    def document(self) -> dict[str, Any]:
        """The diagnosis, empty if there is none."""
        return dict(self.result.get("document") or {})


def scored(plan: Planned, truth: dict[str, Any], result: dict[str, Any]) -> Scored:
    """Set a result beside its truth."""
    document = result.get("document") or {}
    slide = len(truth["gap"]) == 1
    for entry in (*document.get("effects", []), *document.get("possible", [])):
        for one in (entry, *entry.get("alternatives", [])):
            if one["probability"] is None:
                # what is no number says nothing in favour of the effect
                one["probability"] = 0.0
            if slide and one["effect"] in ("armature", "link_inertia"):
                # the mass of a slide has one name
                one["effect"], one["joints"] = "payload", []
    compared = compare(
        plan.name, truth, result.get("document"), result.get("cpu_seconds")
    )
    return Scored(plan, truth, result, compared)


def score_tables(cases: Sequence[Scored]) -> list[Table]:
    """All tables."""
    faulty = [c for c in cases if c.plan.kind != "healthy"]
    return [
        _overview("Total", cases, lambda c: "all"),
        _overview("By mode", cases, lambda c: c.plan.mode),
        _overview("By arm", cases, lambda c: c.plan.arm),
        _overview("By kind", cases, lambda c: c.plan.kind),
        _overview("By size (times what a full model leaves)", faulty, _size),
        _verdicts(cases),
        _calibration(cases),
        _wrong(cases),
    ]


def _size(case: Scored) -> str:
    return "fault" if case.truth["measure"] == "none" else f"{case.plan.size:g}"


def _share(values: Sequence[bool]) -> str:
    """Hits of a count with the percentage."""
    if not values:
        return "–"
    hits, total = sum(values), len(values)
    return f"{hits}/{total} ({100 * hits / total:.0f} %)"


def _overview(
    title: str, cases: Sequence[Scored], key: Callable[[Scored], str]
) -> Table:
    """One row for each value of a key."""
    head = ("cases", "healthy: named", "first answer", "exact set", "joints")
    head = (*head, "parameter error", "seconds: median, worst", "failed")
    return grouped(title, head, cases, key, _figures)


def _figures(cases: Sequence[Scored]) -> tuple[str, ...]:
    healthy = [c for c in cases if c.plan.kind == "healthy"]
    faulty = [c.compared for c in cases if c.plan.kind != "healthy"]
    errors = [e for c in faulty for e in c.errors]
    seconds = [float(c.result["cpu_seconds"]) for c in cases]
    failed = sum(c.result["status"] != "done" for c in cases)
    return (
        _share([bool(c.compared.found) for c in healthy]),
        _share([c.top for c in faulty]),
        _share([c.exact for c in faulty]),
        _share([right for c in faulty for right in c.joints]),
        f"{100 * np.median(errors):.0f} %" if errors else "–",
        f"{np.median(seconds):.0f}, {max(seconds):.0f}",
        str(failed),
    )


def _verdicts(cases: Sequence[Scored]) -> Table:
    """How often each verdict, by kind and mode."""
    names = ("no_gap", "effects_found", "unexplained", "failed")
    counts = Counter((_kind(case), case.compared.verdict) for case in cases)
    groups = sorted(set(map(_kind, cases)))
    rows = [(group, *(str(counts[group, x]) for x in names)) for group in groups]
    return Table("Verdicts", ("", *names), rows)


def _kind(case: Scored) -> str:
    return f"{case.plan.kind}, {case.plan.mode}"


def _calibration(cases: Sequence[Scored]) -> Table:
    """Stated probability of all named and possible effects against how often they are right."""
    found = [one for case in cases for one in stated(case.truth, case.document)]
    p, r = np.array(found, dtype=float).reshape(-1, 2).T
    rows = []
    for row in reliability(p, r):
        low, high = wilson(round(row["right"] * row["count"]), int(row["count"]))
        rows.append(
            (
                f"{row['from']:.1f} to {row['to']:.1f}",
                str(row["count"]),
                f"{row['probability']:.2f}",
                f"{row['right']:.2f}",
                f"{low:.2f} to {high:.2f}",
            )
        )
    score = brier(p, r)
    title = "Calibration" if score is None else f"Calibration (Brier {score:.2f})"
    head = ("probability", "effects", "mean stated", "right", "95 % interval")
    return Table(title, head, tuple(rows))


def _wrong(cases: Sequence[Scored]) -> Table:
    """Cases whose answer is not the truth."""
    head = ("case", "kind", "size", "truth", "answer", "possible", "verdict")
    rows = []
    for case in cases:
        c = case.compared
        right = not c.found if case.plan.kind == "healthy" else c.exact
        if right and case.result["status"] == "done":
            continue
        document = case.document
        rows.append(
            (
                case.plan.name,
                case.plan.kind,
                f"{case.plan.size:g}",
                ", ".join(_short(e) for e in case.truth["effects"]) or "–",
                ", ".join(_short(e) for e in document.get("effects", [])) or "–",
                ", ".join(_short(e) for e in document.get("possible", [])) or "–",
                str(document.get("verdict", case.result.get("error", "")))[:90],
            )
        )
    return Table("Wrong cases", head, tuple(rows))


def _short(entry: dict[str, Any]) -> str:
    """``coulomb_friction [3] 1.2 N m (97 %)``."""
    values = []
    for parameter in list(entry["parameters"].values())[:2]:
        value = parameter["value"]
        text = (
            value
            if isinstance(value, str)
            else np.array2string(
                np.asarray(value, dtype=float), precision=3, separator=", "
            )
        )
        values.append(f"{text} {parameter['unit']}".strip())
    joints = entry["joints"] or ""
    chance = f" ({100 * entry['probability']:.0f} %)" if "probability" in entry else ""
    return f"{entry['effect']} {joints} {'; '.join(values)}{chance}".replace("  ", " ")


# Make and diagnose

MAKE_LIMIT = 900.0
"""Longest time to prepare a carrier or to make a case [s]."""


def make(cases: list[Planned], seed: int, out: Path, jobs: int) -> None:
    """Prepare carriers and cuts, then make the cases."""
    arms = sorted({c.arm for c in cases})
    cuts = sorted({(c.arm, c.cut) for c in cases})
    progress = Progress("identify", len(arms))
    run_tasks(
        lambda arm: prepare_arm(arm, out),
        arms,
        jobs,
        MAKE_LIMIT,
        lambda arm, how, s: progress(arm, f"{how} {s:.0f} s"),
    )
    windows = {cut_folder(*c, out) / WINDOW_FILE: c for c in cuts}
    run_missing(lambda c: prepare_cut(*c, seed, out), windows, jobs, MAKE_LIMIT)
    truths = {truth_file(plan, out): plan for plan in cases}
    run_missing(lambda plan: make_case(plan, seed, out), truths, jobs, MAKE_LIMIT)


def score(rows: Sequence[tuple[Planned, dict[str, Any]]], out: Path) -> Sequence[Table]:
    """The tables of all cases that have a result."""
    done = [scored(plan, read_truth(plan, out), result) for plan, result in rows]
    return score_tables(done) if done else ()


def main() -> None:
    """Do what the arguments say."""
    arguments = study_options(
        __doc__,
        "check",
        jobs=2,
        out=Path("out/real_benchmark"),
        arms=",".join(ARMS),
        modes=",".join(MODES),
        sizes=",".join(f"{s:g}" for s in SIZES),
        seed=1,
        per_arm=(PER_ARM, "cases per arm and mode"),
    ).parse_args()
    arms, modes = arguments.arms.split(","), arguments.modes.split(",")
    unknown = {*arms, *modes} - {*ARMS, *MODES}
    if unknown:
        sys.exit(f"unknown: {', '.join(sorted(unknown))}")
    sizes = [float(size) for size in arguments.sizes.split(",")]
    cases, out = planned(arms, modes, sizes, counts(arguments.per_arm)), arguments.out
    if arguments.step == "check":
        warnings.simplefilter("ignore", ModelWarning)
        print(check_table(cases, out, arguments.jobs).markdown())
        return

    def sides(plan: Planned) -> tuple[Path, Path | None]:
        reference = reference_of(plan, out) if plan.mode == "against" else None
        return out / "cases" / plan.name, reference

    study(
        arguments,
        make=lambda: make(cases, arguments.seed, out, arguments.jobs),
        plans=lambda: cases,
        sides=sides,
        tables=lambda rows: score(rows, out),
    )


if __name__ == "__main__":
    main()
