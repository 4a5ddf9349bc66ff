"""How often the 95 % intervals and the probabilities in ``diagnosis.json`` hold; prints the tables as Markdown.

    GAPSCOPE_DATA=.../data .venv/bin/python experiments/51_interval_coverage.py --out out/coverage [--jobs 2]

Simulated cases are made by the blind check's generator, whose laws are not the catalogue's, with nominal inertials up
to 3, 6 and 10 % off: masses by up to the width, evenly, centres by up to that share of their distance. Real ones carry
an effect of known size, by the laws of the benchmark of real arms, on a piece of a recording of six arms; the nominal
arm is the one identified on all recordings, which stands for the true one as nearly as can be, with its inertials put
off as far. Intervals are counted of effects that were named rightly, on joints that have them; probabilities of all
findings.

Resumable: each case has a result file that is written whole. ``--results NAME`` keeps the results of several versions
of the diagnosis side by side. Needs the extra ``blind``.
"""

from __future__ import annotations

import argparse
import shutil
import warnings
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple
from zlib import crc32

import numpy as np
from common import command_line, run_tasks
from real_carriers import (
    ARMS,
    cut,
    left,
    load_carrier,
    model_residual,
    prepare_arm,
    windows,
    write_piece,
)
from real_cases import Planned, draw, inject, label
from real_laws import Scene
from threadpoolctl import threadpool_limits

import gapscope
from gapscope.arm.case import load_case
from gapscope.arm.errors import ModelWarning
from gapscope.arm.io.atomic_write import atomic_write
from gapscope.arm.io.json_file import plain, read_json, write_json
from gapscope.blind_check.generator.arms import USUAL, perturb_inertials, text_of
from gapscope.blind_check.generator.case import make_case, write_case
from gapscope.blind_check.generator.simulate import STRONG, CaseSpec, Conditions
from gapscope.blind_check.scoring import named, same, wilson
from gapscope.reports.blind_check import Table

# Simulated cases

WIDTHS = (0.03, 0.06, 0.1)
"""Largest relative errors of the nominal inertials [1]."""
EFFECTS = (
    ("payload",),
    ("payload", "coulomb_friction"),
    ("payload", "viscous_friction"),
    ("armature", "coulomb_friction"),
    ("armature", "torque_offset"),
    ("viscous_friction", "torque_offset"),
    ("torque_scale",),
    ("encoder_offset",),
    ("actuator_delay",),
    ("actuator_lag",),
    ("parallel_spring",),
    ("joint_elasticity",),
    ("base_tilt",),
    ("link_inertia",),
    ("torque_ripple",),
)
"""Effects of the cases; each set is made once per width."""
RATES = (100, 250)
"""Rates of the recordings [Hz]."""
LONGEST = (8.0, 12.0)
"""Shortest and longest recording [s]."""


@dataclass(frozen=True)
class Simulated:
    """One simulated case.

    Attributes:
        effects: laws at work.
        width: largest relative error of the nominal inertials [1].
        robot: name of the arm.
        severity: RMS of each effect over the floor of a healthy arm, from and to [1].
        rate: of the recordings [Hz].
        number: within the plan, from 0.
    """

    effects: tuple[str, ...]
    width: float
    robot: str
    severity: tuple[float, float]
    rate: int
    number: int

    @property
    def name(self) -> str:
        """Name of the case; it tells nothing of the truth."""
        return f"simulated_{self.number:03d}"


def planned_simulated(rounds: int) -> list[Simulated]:
    """All cases: every set of effects at every width, on another arm each time; so many rounds of them."""
    out: list[Simulated] = []
    for turn in range(rounds):
        for k, effects in enumerate(EFFECTS):
            for w, width in enumerate(WIDTHS):
                number = len(out)
                place = k + 2 * w + turn
                out.append(
                    Simulated(
                        effects,
                        width,
                        USUAL[place % len(USUAL)],
                        STRONG[(place // 2) % len(STRONG)],
                        RATES[(k + w) % len(RATES)],
                        number,
                    )
                )
    return out


def make_simulated(plan: Simulated, seed: int, out: Path) -> None:
    """Write one case, and its truth beside the cases, unless both are there."""
    truth, folder = out / "truth" / f"{plan.name}.json", out / "cases" / plan.name
    if truth.is_file() and folder.is_dir():
        return
    conditions = Conditions(
        robot=plan.robot,
        inertials_off=plan.width,
        rate=plan.rate,
        duration=LONGEST,
    )
    spec = CaseSpec("single", plan.effects, plan.severity, conditions)
    made = make_case(spec, (seed, crc32(plan.name.encode())))
    aside = out / "cases" / f".{plan.name}"
    shutil.rmtree(aside, ignore_errors=True)
    shutil.rmtree(folder, ignore_errors=True)
    write_case(made, plan.name, False, aside, out / "unseen" / f"{plan.name}.csv")
    truth.parent.mkdir(parents=True, exist_ok=True)
    write_json(made.label, truth)
    aside.rename(folder)


# Cases of real arms

CARRIED_EFFECTS = (
    "payload",
    "coulomb_friction",
    "viscous_friction",
    "torque_scale",
    "torque_offset",
    "armature",
    "encoder_offset",
    "base_tilt",
    "parallel_spring",
    "actuator_delay",
)
"""Effects of the cases; an arm gets a load at every width, and of the others one after the other."""
SIZES = (4.0, 8.0)
"""RMS of an effect over what a full model leaves [1]."""
OTHERS = 4
"""Cases of an arm beside those with a load."""


@dataclass(frozen=True)
class Carried:
    """One case of a real arm.

    Attributes:
        arm: short name of the carrier.
        effect: the effect that is wanted; if the arm cannot have it in this size, the next ``CARRIED_EFFECTS``.
        width: largest relative error of the nominal inertials that is added [1].
        size: RMS of the effect over what a full model leaves [1].
        number: within the arm, from 0.
    """

    arm: str
    effect: str
    width: float
    size: float
    number: int

    @property
    def name(self) -> str:
        """Name of the case; it tells nothing of the truth."""
        return f"real_{self.arm}_{self.number:02d}"


def planned_carried() -> list[Carried]:
    """All cases, arm by arm."""
    out = []
    for place, arm in enumerate(ARMS):
        others = [CARRIED_EFFECTS[1 + (OTHERS * place + k) % 9] for k in range(OTHERS)]
        for number, effect in enumerate((*["payload"] * len(WIDTHS), *others)):
            width = WIDTHS[(number + place) % len(WIDTHS)]
            size = SIZES[(number + place) % len(SIZES)]
            out.append(Carried(arm, effect, width, size, number))
    return out


def make_carried(plan: Carried, seed: int, out: Path) -> None:
    """Write one case, and its truth beside the cases, unless both are there; an arm is identified once."""
    truth, folder = out / "truth" / f"{plan.name}.json", out / "cases" / plan.name
    if truth.is_file() and (folder / "case.yaml").is_file():
        return
    prepare_arm(plan.arm, out)
    carrier = load_carrier(plan.arm, out / "carriers" / plan.arm)
    whole = load_case(out / "carriers" / plan.arm / "whole")
    _, piece = cut(whole, windows(carrier, plan.number, seed)[0])
    rest = np.maximum(model_residual(carrier), left(piece))
    healthy = Scene(piece.recordings[0], piece.arm, piece.arm, rest)
    rng = np.random.default_rng([seed, crc32(plan.name.encode())])
    first = CARRIED_EFFECTS.index(plan.effect)
    names = np.roll(CARRIED_EFFECTS, -first).tolist()
    found = (draw(healthy, name, plan.size, rng) for name in names)
    injection = next(one for one in found if one is not None)
    recording, entries = inject(healthy, [injection])
    recording = replace(recording, name="recording")
    urdf = out / f".{plan.name}.urdf"
    root = ET.parse(healthy.nominal.urdf).getroot()
    perturb_inertials(root, plan.width, rng)
    with atomic_write(urdf) as aside:
        aside.write_text(text_of(root), encoding="utf-8")
    arm = replace(healthy.nominal, urdf=urdf)
    case = replace(piece, name=plan.name, arm=arm, recordings=(recording,))
    write_piece(case, folder)
    urdf.unlink()
    as_planned = Planned(plan.arm, "plain", "single", plan.number, plan.size)
    stated = label(as_planned, healthy, [injection], entries)
    stated["conditions"]["inertials_off"] = plan.width
    truth.parent.mkdir(parents=True, exist_ok=True)
    write_json(stated, truth)


# Tables

INTERVAL = 1.96
"""Standard deviations to either side in a 95 % interval [1]."""
LEFT_OUT = ("phase", "link")
"""Parameters that are not compared: a phase turns with the number of cycles, a link has no error."""


@dataclass(frozen=True)
class Value:
    """One value of an effect that was named rightly, on a joint that has it.

    Attributes:
        case: name of the case.
        group: what it is of: width of the nominal errors, or the arm.
        parameter: effect and parameter.
        true, found: the value that was put in, and the one of the diagnosis.
        half: half width of the 95 % interval.
    """

    case: str
    group: str
    parameter: str
    true: float
    found: float
    half: float

    @property
    def held(self) -> bool:
        """Whether the interval holds the true value."""
        return abs(self.found - self.true) <= self.half


def values(
    case: str, group: str, truth: dict[str, Any], document: dict[str, Any]
) -> Iterator[Value]:
    """The values of all effects of a label that the diagnosis names."""
    for true in truth["effects"]:
        for found in document.get("effects", []):
            if _same(true, found):
                for name, *numbers in _numbers(true, found):
                    yield Value(case, group, f"{true['effect']}.{name}", *numbers)


def _same(true: dict[str, Any], found: dict[str, Any]) -> bool:
    if true["effect"] != found["effect"]:
        return False
    links = [
        float(np.ravel(entry["parameters"]["link"]["value"])[0])
        for entry in (true, found)
        if "link" in entry["parameters"]
    ]
    return len(set(links)) < 2


def _numbers(
    true: dict[str, Any], found: dict[str, Any]
) -> Iterator[tuple[str, float, float, float]]:
    """Parameter, true value, value found and half width, joint by joint or component by component."""
    for name, stated in true["parameters"].items():
        estimate = found["parameters"].get(name)
        if estimate is None or estimate["std"] is None or name in LEFT_OUT:
            continue
        if not stated.get("unit"):
            # what only the generator's law has
            continue
        expected, value, std = (
            np.ravel(np.array(x, dtype=float))
            for x in (stated["value"], estimate["value"], estimate["std"])
        )
        places = range(len(expected))
        if true["joints"]:
            pairs = [
                (k, found["joints"].index(joint))
                for k, joint in enumerate(true["joints"])
                if joint in found["joints"]
            ]
        else:
            pairs = [(k, k) for k in places]
        for k, i in pairs:
            yield name, expected[k], value[i], INTERVAL * std[i]


def coverage_table(title: str, found: Sequence[Value]) -> Table:
    """A row for each group, and one for all."""
    groups: dict[str, list[Value]] = {}
    for value in found:
        groups.setdefault(value.group, []).append(value)
    rows = [_coverage_row(name, groups[name]) for name in sorted(groups)]
    head = ("", "values", "held", "95 % interval", "half width")
    return Table(title, head, (*rows, _coverage_row("all", found)))


def _coverage_row(name: str, found: Sequence[Value]) -> tuple[str, ...]:
    """Share held with Wilson's interval, and the median of half width over the true value."""
    held = sum(value.held for value in found)
    low, high = wilson(held, len(found))
    half = [value.half / max(abs(value.true), 1e-12) for value in found]
    return (
        name,
        str(len(found)),
        f"{100 * held / len(found):.0f} %",
        f"{100 * low:.0f} to {100 * high:.0f} %",
        f"{100 * np.median(half):.1f} %",
    )


LIKELY = 0.8
"""Findings at least as probable as this are counted apart [1]."""


class Stated(NamedTuple):
    """A finding: what it is of, its probability, and whether it is in the label."""

    group: str
    probability: float
    right: bool


def stated(group: str, truth: dict[str, Any], document: dict[str, Any]) -> list[Stated]:
    """All findings of a diagnosis, named or possible, beside the label."""
    true = [named(entry) for entry in truth["effects"]]
    motions = truth.get("motions", [])[:-1]
    entries = [*document.get("effects", []), *document.get("possible", [])]
    return [
        Stated(
            group,
            float(entry["probability"] or 0.0),
            any(same(one, named(entry), len(truth["gap"]), motions) for one in true),
        )
        for entry in entries
    ]


def calibration_table(title: str, found: Sequence[Stated]) -> Table:
    """A row for each group, and one for all."""
    groups = sorted({one.group for one in found})
    rows = [
        _calibration_row(name, [one for one in found if one.group == name])
        for name in groups
    ]
    likely = f"{LIKELY:.1f} and more: findings, stated, right"
    head = ("", "findings", "stated", "right", likely)
    return Table(title, head, (*rows, _calibration_row("all", found)))


def _calibration_row(name: str, found: Sequence[Stated]) -> tuple[str, ...]:
    p = np.array([one.probability for one in found])
    right = np.array([one.right for one in found], dtype=float)
    likely = p >= LIKELY
    figures = "–"
    if likely.any():
        hits, count = int(right[likely].sum()), int(likely.sum())
        low, high = wilson(hits, count)
        share = f"{hits / count:.2f} ({low:.2f} to {high:.2f})"
        figures = f"{count}, {p[likely].mean():.2f}, {share}"
    return name, str(len(found)), f"{p.mean():.2f}", f"{right.mean():.2f}", figures


# Make, diagnose and report

LIMIT = 600.0
"""Longest processor time to make or to diagnose a case [s]."""
Plan = Simulated | Carried
KINDS = {"Simulated": Simulated, "Real": Carried}


def make(plan: Plan, seed: int, out: Path) -> None:
    """Write one case and its truth."""
    if isinstance(plan, Simulated):
        make_simulated(plan, seed, out)
    else:
        make_carried(plan, seed, out)


def diagnose(plan: Plan, out: Path, results: Path) -> None:
    """Diagnose one case; of its document only the effects are kept."""
    case = load_case(out / "cases" / plan.name, any_unit=True)
    document: Any = gapscope.diagnose(case).document
    kept = {key: document[key] for key in ("verdict", "effects", "possible")}
    content = plain(kept, null_if_not_finite=True)
    write_json(content, results / f"{plan.name}.json")


def ended(what: str, plan: Plan, how: str, seconds: float) -> None:
    """Print that a task ended."""
    print(f"{what} {plan.name} {how} {seconds:.0f} s", flush=True)


def group_of(plan: Plan) -> str:
    """What a case is counted with: its nominal errors if it is simulated, its arm otherwise."""
    if isinstance(plan, Simulated):
        # a figure space, so that rows are in order
        return f"{100 * plan.width:.0f} %".rjust(4, "\u2007")
    return plan.arm


def tables(name: str, plans: list[Plan], out: Path, results: Path) -> list[Table]:
    """The tables of the cases of one kind that have a result."""
    found: list[Value] = []
    said: list[Stated] = []
    for plan in plans:
        file = results / f"{plan.name}.json"
        if file.is_file():
            document = read_json(file, "--step run")
            truth = read_json(out / "truth" / f"{plan.name}.json", "--step make")
            found += values(plan.name, group_of(plan), truth, document)
            said += stated(group_of(plan), truth, document)
    if not found:
        return []
    return [
        coverage_table(f"{name}, intervals", found),
        calibration_table(f"{name}, probabilities", said),
    ]


def report(plans: list[Plan], out: Path, results: Path) -> None:
    """Print the tables, and write them beside the results."""
    shown = []
    for name, kind in KINDS.items():
        chosen = [plan for plan in plans if isinstance(plan, kind)]
        shown += tables(name, chosen, out, results)
    text = "\n".join(table.markdown() for table in shown)
    print(text)
    results.with_suffix(".md").write_text(text, encoding="utf-8")


def parsed() -> argparse.Namespace:
    """The arguments."""
    parser = command_line(__doc__, out=Path("out/coverage"), seed=1, jobs=1)
    parser.add_argument("--rounds", type=int, default=1, help="of simulated cases")
    parser.add_argument("--results", default="results", help="folder in OUT")
    parser.add_argument(
        "--step", choices=("make", "run", "score", "all"), default="all"
    )
    return parser.parse_args()


def main() -> None:
    """Make, diagnose, score."""
    arguments = parsed()
    warnings.simplefilter("ignore", ModelWarning)
    out, seed, jobs = arguments.out, arguments.seed, arguments.jobs
    results = out / arguments.results
    results.mkdir(parents=True, exist_ok=True)
    simulated = planned_simulated(arguments.rounds)
    plans: list[Plan] = [*simulated, *planned_carried()]
    with threadpool_limits(1):
        if arguments.step in ("make", "all"):
            making = partial(make, seed=seed, out=out)
            # one after the other: the cases of a carrier share its identification
            run_tasks(making, plans, 1, LIMIT, partial(ended, "make"))
        if arguments.step in ("run", "all"):
            left = [p for p in plans if not (results / f"{p.name}.json").is_file()]
            diagnosing = partial(diagnose, out=out, results=results)
            run_tasks(diagnosing, left, jobs, LIMIT, partial(ended, "diagnose"))
    if arguments.step in ("score", "all"):
        report(plans, out, results)


if __name__ == "__main__":
    main()
