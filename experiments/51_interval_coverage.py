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

import xml.etree.ElementTree as ET
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple
from zlib import crc32

import numpy as np
from common import grouped, run_missing, stated, study, study_options
from generator_arms import make_generated
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

from gapscope.arm.case import load_case
from gapscope.arm.io.atomic_write import atomic_write
from gapscope.arm.io.json_file import read_json
from gapscope.blind_check.generator.arms import USUAL, perturb_inertials, text_of
from gapscope.blind_check.generator.simulate import STRONG, CaseSpec, Conditions
from gapscope.blind_check.scoring import named, wilson
from gapscope.reports.pages import PageSection as Table

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


class Simulated(NamedTuple):
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
    places = product(range(rounds), enumerate(EFFECTS), enumerate(WIDTHS))
    out = []
    for number, (turn, (k, effects), (w, width)) in enumerate(places):
        place = k + 2 * w + turn
        robot, rate = USUAL[place % len(USUAL)], RATES[(k + w) % len(RATES)]
        severity = STRONG[place // 2 % len(STRONG)]
        out.append(Simulated(effects, width, robot, severity, rate, number))
    return out


def make_simulated(plan: Simulated, seed: int, out: Path) -> dict[str, Any]:
    """Write one case, and its truth beside the cases, unless both are there; the truth."""
    conditions = Conditions(
        robot=plan.robot,
        inertials_off=plan.width,
        rate=plan.rate,
        duration=LONGEST,
    )
    spec = CaseSpec("single", plan.effects, plan.severity, conditions)
    folder, truth = out / "cases" / plan.name, out / "truth" / f"{plan.name}.json"
    return make_generated(spec, (seed, crc32(plan.name.encode())), folder, truth)


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


class Carried(NamedTuple):
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


def make_carried(plan: Carried, seed: int, out: Path) -> dict[str, Any]:
    """Write one case; its truth. An arm is identified once."""
    folder = out / "cases" / plan.name
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
    entry = label(as_planned, healthy, [injection], entries)
    entry["conditions"]["inertials_off"] = plan.width
    return entry


# Tables

INTERVAL = 1.96
"""Standard deviations to either side in a 95 % interval [1]."""
LEFT_OUT = ("phase", "link")
"""Parameters that are not compared: a phase turns with the number of cycles, a link has no error."""
LIKELY = 0.8
"""Findings at least as probable as this are counted apart [1]."""


class Value(NamedTuple):
    """One value of an effect that was named rightly, on a joint that has it: the true one, the one found, its interval.

    ``group`` is what it is counted with, ``parameter`` its effect and name, ``half`` the half width of the interval.
    """

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
    group: str, truth: dict[str, Any], document: dict[str, Any]
) -> Iterator[Value]:
    """The values of all effects of a label that the diagnosis names, joint by joint or component by component."""
    for true, found in product(truth["effects"], document.get("effects", [])):
        if true["effect"] != found["effect"] or named(true).link != named(found).link:
            continue
        places = [(k, k) for k in range(3)]
        if true["joints"]:
            common = [joint for joint in true["joints"] if joint in found["joints"]]
            index = true["joints"].index, found["joints"].index
            places = [(index[0](joint), index[1](joint)) for joint in common]
        for name, given in true["parameters"].items():
            estimate = found["parameters"].get(name)
            # what has no unit only the generator's law has
            if not estimate or not given.get("unit") or name in LEFT_OUT:
                continue
            if estimate["std"] is None:
                continue
            numbers = given["value"], estimate["value"], estimate["std"]
            expected, value, std = (np.ravel(np.array(x, dtype=float)) for x in numbers)
            for k, i in places[: len(expected)]:
                parameter = f"{true['effect']}.{name}"
                yield Value(group, parameter, expected[k], value[i], INTERVAL * std[i])


def coverage_table(title: str, found: Sequence[Value]) -> Table:
    """Share held with Wilson's interval, and the median of half width over the true value."""

    def cells(own: Sequence[Value]) -> tuple[str, ...]:
        held = sum(value.held for value in own)
        low, high = wilson(held, len(own))
        half = np.median([value.half / max(abs(value.true), 1e-12) for value in own])
        interval = f"{100 * low:.0f} to {100 * high:.0f} %"
        return f"{100 * held / len(own):.0f} %", interval, f"{100 * half:.1f} %"

    head = ("values", "held", "95 % interval", "half width")
    return grouped(title, head, found, lambda x: x[0], cells, found)


def calibration_table(title: str, found: Sequence[tuple[str, float, bool]]) -> Table:
    """Stated probability and share that is right, of groups with (group, probability, right) of each finding."""

    def cells(own: Sequence[tuple[str, float, bool]]) -> tuple[str, ...]:
        p, right = (np.array([x[k] for x in own], dtype=float) for k in (1, 2))
        likely, figures = p >= LIKELY, "–"
        if likely.any():
            hits, count = int(right[likely].sum()), int(likely.sum())
            low, high = wilson(hits, count)
            share = f"{hits / count:.2f} ({low:.2f} to {high:.2f})"
            figures = f"{count}, {p[likely].mean():.2f}, {share}"
        return f"{p.mean():.2f}", f"{right.mean():.2f}", figures

    likely = f"{LIKELY:.1f} and more: findings, stated, right"
    head = ("findings", "stated", "right", likely)
    return grouped(title, head, found, lambda x: x[0], cells, found)


# Make, diagnose and report

LIMIT = 600.0
"""Longest processor time to make a case [s]."""
Plan = Simulated | Carried


def make(plan: Plan, seed: int, out: Path) -> dict[str, Any]:
    """Write one case; its truth."""
    if isinstance(plan, Simulated):
        return make_simulated(plan, seed, out)
    return make_carried(plan, seed, out)


def group_of(plan: Plan) -> str:
    """What a case is counted with: its nominal errors if it is simulated, its arm otherwise."""
    if isinstance(plan, Simulated):
        # a figure space, so that rows are in order
        return f"{100 * plan.width:.0f} %".rjust(4, "\u2007")
    return plan.arm


def tables(rows: Sequence[tuple[Plan, dict[str, Any]]], out: Path) -> list[Table]:
    """The tables of the cases that have a result, simulated and real ones apart."""
    shown = []
    for name, kind in {"Simulated": Simulated, "Real": Carried}.items():
        found = []
        said = []
        for plan, result in rows:
            if isinstance(plan, kind):
                truth = read_json(out / "truth" / f"{plan.name}.json", "--step make")
                document = result.get("document") or {}
                found += values(group_of(plan), truth, document)
                said += [(group_of(plan), *one) for one in stated(truth, document)]
        if found:
            shown += [
                coverage_table(f"{name}, intervals", found),
                calibration_table(f"{name}, probabilities", said),
            ]
    return shown


def main() -> None:
    """Make, diagnose, score."""
    arguments = study_options(
        __doc__, out=Path("out/coverage"), seed=1, rounds=(1, "of simulated cases")
    ).parse_args()
    out = arguments.out
    plans = [*planned_simulated(arguments.rounds), *planned_carried()]
    truths = {out / "truth" / f"{plan.name}.json": plan for plan in plans}

    study(
        arguments,
        # one after the other: the cases of a carrier share its identification
        make=lambda: run_missing(
            lambda plan: make(plan, arguments.seed, out), truths, 1, LIMIT
        ),
        plans=lambda: plans,
        sides=lambda plan: (out / "cases" / plan.name, None),
        tables=lambda rows: tables(rows, out),
    )


if __name__ == "__main__":
    main()
