"""Recordings that do not share a state, references that are wrong, logs that are poor: a table with a row for each.

    .venv/bin/python experiments/56_states.py --out out/states [--draws 6] [--seed 1] [--rows two_loads,wrong_constants]

The arms are those of the blind check: MuJoCo bodies, LuGre friction, quantised noisy encoders, a sampled controller;
none of the catalogue's laws. Each row has ``--draws`` arms, another robot each. A reference has three recordings of a
healthy arm, a case two of another kind and another day, on which Coulomb and viscous friction of every joint differ by
up to +-12 %. Where the states of a case are asked for, the data sheet is nearly right, and all commands are asked of
the same recordings; in the other rows it is poor, inertials 10 to 30 % off and no friction, and the controller is
unknown. What each command is given:

against, plain   the case, with and without its reference: ``gapscope diagnose``
agree            the two recordings of the case: what differs
watch            the case, after the reference has shown what is normal: alarms, none but in what changes
units            each of the five recordings as a unit of its own: what one unit has alone

Resumable: run it again for the rest; each diagnosis has a result file.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml
from common import (
    diagnosis,
    names_of,
    run_missing,
    study,
    study_options,
    verdict_of,
)
from generator_arms import recorded, write_side

from gapscope.arm.case import load_case
from gapscope.arm.errors import GapscopeError
from gapscope.arm.io.json_file import read_json
from gapscope.blind_check.generator.case import CaseSetup, draw_setup
from gapscope.blind_check.generator.law import Cause
from gapscope.blind_check.generator.laws import LAWS
from gapscope.blind_check.generator.simulate import Conditions
from gapscope.blind_check.generator.true_arm import Columns, TrueArm
from gapscope.blind_check.scoring import Named, matched, named, same
from gapscope.diagnosis.agreement import DIFFERS, agreement
from gapscope.diagnosis.compare_units import FleetUnit, unit_differences
from gapscope.effects.corrected import CorrectedArm
from gapscope.model.changes import PLAIN_FRICTION
from gapscope.reports.pages import PageSection as Table
from gapscope.watching.detector import ALARM, MISFIT, WatchSettings
from gapscope.watching.watch import Watch

ROBOTS = ("ur5_like", "franka_panda", "drawn", "kuka_iiwa", "ur10_like", "xarm6")
ARM = np.array([], dtype=int)
DAY = 0.12
"""Change of friction from day to day, at most [1]."""
DAILY = {"coulomb_friction", "viscous_friction"}
"""Effects that change from day to day."""
COLD = (0.4, 0.8)
"""Rise of the friction of every joint in a cold recording [1]."""
REFERENCE, CASE = (0, 1, 2), (3, -1)
"""Motions that are recorded in either."""
FILES = ("recording_a", "recording_b")
"""The recordings of a case."""
UNITS = ("healthy_a", "healthy_b", "healthy_c", *FILES)
"""Each recording as a unit of its own."""
LEVER = 0.15
"""Distance of two equal loads from the axis of the flange, on opposite sides [m]."""
OTHER_MASS = 0.25
"""Least difference of two loads, over the heavier one [1]."""
CONSTANTS = (0.5, 1.5)
"""Factors of a torque that is off by half [1]."""
REPEATED, STEP = 0.05, 4e-4
"""Share of rows that repeat the one before [1], and step of the encoders [rad]."""
ATTEMPTS = 60


class Row(NamedTuple):
    """A row of the table.

    Attributes:
        text: what it is.
        modes: what is asked.
        poor_sheet: whether the data sheet is poor and the controller unknown.
        rate: of controller and recordings [Hz].
    """

    text: str
    modes: tuple[str, ...] = ("against",)
    poor_sheet: bool = True
    rate: int = 250


BOTH = ("against", "plain")
ALL = (*BOTH, "agree", "watch", "units")
IN_ONE = {
    "zero_in_one": "encoder_offset",
    "friction_in_one": "coulomb_friction",
    "constant_in_one": "torque_scale",
}
"""Rows of which one recording has an effect of one joint."""
ROWS = {
    "same_load": Row("the same load in both recordings", BOTH, False),
    "two_loads": Row("two loads, one in each", BOTH, False),
    "opposite_loads": Row("equal masses on opposite sides", BOTH, False),
    "tool_on_off": Row("a load in one, none in the other", ALL, False),
    "cold_warm": Row("one cold, one warm", ALL, False),
    "wrong_constants": Row("two torque constants off by half, nothing changed"),
    "wrong_constants_load": Row("two torque constants off by half, a load"),
    "poor_log": Row("1 kHz, repeated rows, coarse encoders; nothing", rate=1000),
    "poor_log_load": Row("1 kHz, repeated rows, coarse encoders; a load", rate=1000),
    "poor_log_coulomb": Row(
        "1 kHz, repeated rows, coarse encoders; Coulomb friction", rate=1000
    ),
    "zero_in_one": Row("an encoder zero off in one", ALL, False),
    "friction_in_one": Row("friction of one joint higher in one", ALL, False),
    "constant_in_one": Row("a torque constant off in one", ALL, False),
    # last: the cases of a row are drawn by its place
    "nothing": Row("nothing but another day", ALL, False),
}


class Task(NamedTuple):
    """One diagnosis of a draw of a row."""

    row: str
    draw: int
    mode: str

    @property
    def case(self) -> str:
        """Name of the case."""
        return f"{self.row}_{self.draw}"

    @property
    def name(self) -> str:
        """Name of the result."""
        return f"{self.case}_{self.mode}"


def loads(row: str, setup: CaseSetup, rng: np.random.Generator) -> list[list[Cause]]:
    """The load in each of the two recordings of a case."""
    law = LAWS["payload"]
    first = law.cause(rng, setup, ARM)
    if row == "two_loads":
        while True:
            other = law.cause(rng, setup, ARM)
            masses = sorted(float(c.values["mass"]) for c in (first, other))
            if 1 - masses[0] / masses[1] > OTHER_MASS:
                return [[first], [other]]
    if row == "opposite_loads":
        angle = rng.uniform(0, 2 * np.pi)
        side = LEVER * np.array([np.cos(angle), np.sin(angle), 0.0])
        middle = np.array([0.0, 0.0, 0.05])
        places = [{**first.values, "com": middle + s * side} for s in (1, -1)]
        return [[first._replace(values=values)] for values in places]
    if row == "tool_on_off":
        several = [[first], []]
        return several if rng.random() < 0.5 else several[::-1]
    loaded = row in ("same_load", "wrong_constants_load", "poor_log_load")
    return [[first] if loaded else []] * 2


Truth = list[dict[str, Any]]
"""Effects that a right answer names, each with ``recordings``: the files of the case that have it."""


def drawn_case(row: str, number: int, seed: int, folder: Path) -> Truth:
    """Write ``reference`` and ``case`` of a draw; what changed."""
    kind = ROWS[row]
    rng = np.random.default_rng([seed, list(ROWS).index(row), number])
    # every row begins with another robot
    robot = ROBOTS[(number + list(ROWS).index(row)) % len(ROBOTS)]
    off = (0.1, 0.3) if kind.poor_sheet else (0.01, 0.05)
    conditions = Conditions(
        robot,
        inertials_off=float(rng.uniform(*off)),
        rate=kind.rate,
        loop_rate=max(500, kind.rate),
        recordings=4,
        duration=(8.0, 12.0),
    )
    for _ in range(ATTEMPTS):
        setup = draw_setup(conditions, rng)
        if setup is None:
            continue
        today, truth = plants(row, setup, rng)
        ever = [*[setup.plant(())] * len(REFERENCE), *today]
        ran = recorded(setup, ever, (*REFERENCE, *CASE))
        if ran is None:
            continue
        logged = as_logged(row, ran, setup.arm.n, rng)
        write_logged(row, setup, logged[: len(REFERENCE)], folder / "reference")
        write_logged(row, setup, logged[len(REFERENCE) :], folder / "case")
        for unit, one in zip(UNITS, logged, strict=True):
            write_logged(row, setup, [one], folder / "units" / unit)
        return truth
    raise GapscopeError(f"{row} {number} did not come about", "take another seed")


def plants(
    row: str, setup: CaseSetup, rng: np.random.Generator
) -> tuple[list[TrueArm], Truth]:
    """The arm in each recording of the case, and what it has that the reference has not."""
    n = setup.arm.n
    causes = loads(row, setup, rng)
    if row == "poor_log_coulomb" or row in IN_ONE:
        law, joint = LAWS[IN_ONE.get(row, "coulomb_friction")], rng.integers(n, size=1)
        if row == "zero_in_one":
            # a zero about the vertical shows in no torque, one of the last joint hardly
            joint = rng.integers(1, n - 2, size=1)
        causes = [[law.cause(rng, setup, joint)]] * 2
        if row in IN_ONE:
            causes[int(rng.integers(2))] = []
    today = [setup.plant(several) for several in causes]
    labels = [[cause.label() for cause in several] for several in causes]
    cold = int(rng.integers(2)) if row == "cold_warm" else None
    for name in ("coulomb", "viscous"):
        day = 1.0 + rng.uniform(-DAY, DAY, n)
        for plant in today:
            plant.values[name] = plant.values[name] * day
        if cold is not None:
            rise = rng.uniform(*COLD, n)
            today[cold].values[name] = today[cold].values[name] * (1.0 + rise)
            joints = list(range(1, n + 1))
            parameters = {"rise": {"unit": "1", "value": rise.tolist()}}
            entry = {"effect": f"{name}_friction", "joints": joints}
            labels[cold].append({**entry, "parameters": parameters})
    effects = {}
    for file, several in zip(FILES, labels, strict=True):
        for entry in several:
            # of the same cause in both recordings, and of two loads, one entry
            one = effects.setdefault(entry["effect"], {**entry, "recordings": []})
            one["recordings"].append(file)
    return today, [*effects.values()]


def as_logged(
    row: str, recordings: list[Columns], n: int, rng: np.random.Generator
) -> list[Columns]:
    """Recordings as the log of a row holds them: torques of wrong constants, or coarse and repeated rows."""
    if row.startswith("wrong_constants"):
        factor = np.ones(n)
        factor[rng.choice(n, 2, replace=False)] = rng.choice(CONSTANTS, 2)
        return [{**r, "tau": r["tau"] * factor} for r in recordings]
    if not row.startswith("poor_log"):
        return recordings
    out = []
    for rows in recordings:
        count = len(rows["t"])
        fresh = rng.random(count) >= REPEATED
        # the last row before that was measured; the clock goes on
        source = np.maximum.accumulate(np.where(fresh, np.arange(count), 0))
        coarse = {**rows, "q": np.round(rows["q"] / STEP) * STEP}
        out.append({k: x if k == "t" else x[source] for k, x in coarse.items()})
    return out


def write_logged(row: str, setup: CaseSetup, rows: list[Columns], folder: Path) -> None:
    """Write a case of some recordings."""
    poor = ROWS[row].poor_sheet
    write_side(setup, rows, folder, bare=poor, poor=poor)
    if poor:
        file = folder / "case.yaml"
        content = yaml.safe_load(file.read_text(encoding="utf-8"))
        # nobody says how coarse the encoders are
        content["nominal"].pop("encoder_step")
        file.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")


def make(cases: Sequence[tuple[str, int]], seed: int, out: Path, jobs: int) -> None:
    """Make all cases that are not there yet."""

    def made(one: tuple[str, int]) -> Truth:
        return drawn_case(*one, seed, out / "cases" / f"{one[0]}_{one[1]}")

    files = {out / "truth" / f"{row}_{k}.json": (row, k) for row, k in cases}
    run_missing(made, files, jobs, 600.0)


# What each command says of a case, as a document with the effects that it says have changed


def named_effect(what: str) -> str:
    """The effect that stands for plain friction, by what a finding calls it."""
    return "coulomb_friction" if what == PLAIN_FRICTION else what


def agreed(case: Path, reference: Path | None) -> dict[str, Any]:
    """What differs between the recordings of a case."""
    found = agreement(load_case(case))
    effects = [
        {"effect": line.term.effect, "joints": [line.joint] * bool(line.joint)}
        for line in found.having(DIFFERS)
    ]
    return {"effects": effects, "verdict": "something else" * bool(found.unknown)}


def watched(case: Path, reference: Path | None) -> dict[str, Any]:
    """What a watch alarms of, once for each effect, when it has seen the reference."""
    healthy = load_case(reference)
    settings = WatchSettings(case, learning=0.0, rest=0.0, until_idle=0.0)
    events = list(Watch(CorrectedArm(healthy.arm), settings, healthy).run())
    found = {}
    for event in events:
        if event.event == ALARM:
            # what comes with one recording goes with the next: told twice it is one
            entry = {"effect": named_effect(event.effect), "joints": list(event.joints)}
            entry["sentence"] = event.sentence
            found.setdefault((event.effect, *event.joints), entry)
    misfits = [event.sentence for event in events if event.event == MISFIT]
    return {"effects": [*found.values()], "verdict": "; ".join(misfits)}


def compared(case: Path, reference: Path | None) -> dict[str, Any]:
    """What one unit has of its own, of those that each recording is."""
    folder = case.parent / "units"
    units = [FleetUnit(unit, folder / unit, folder) for unit in UNITS]
    own = unit_differences(units)
    effects = [
        entry | {"effect": named_effect(entry["what"]), "recording": entry["unit"]}
        for entry in own or ()
    ]
    return {"effects": effects, "verdict": "" if own is not None else "not compared"}


ASKED = {"agree": agreed, "watch": watched, "units": compared}
"""What makes the document of a mode; ``diagnose`` of all others."""


class Judged(NamedTuple):
    """A result beside its truth.

    Attributes:
        first, exact: whether the first name is right, and the set with its joints; without a truth, no name at all.
        false: names that are not true.
        failed, unexplained, seconds: of the diagnosis.
    """

    first: bool
    exact: bool
    false: int
    failed: bool
    unexplained: bool
    seconds: float


def judged(truth: Truth, result: dict[str, Any], n: int) -> Judged:
    """Set a result beside its truth."""
    document = result.get("document") or {"effects": [], "verdict": "failed"}
    true = [named(entry) for entry in truth]
    having = {entry["effect"]: entry["recordings"] for entry in truth}
    found = []
    for entry in document["effects"]:
        one = named(entry)
        # where a command says in which recording, it must be that
        if entry.get("recording") not in (None, *having.get(one.effect, ())):
            one = replace(one, effect=f"{one.effect} in {entry['recording']}")
        found.append(one)
    pairs = matched(true, found, n, [])
    done = result["status"] == "done"
    whole = len(pairs) == len(true) == len(found)
    first = found[:1]
    right = any(same(t, f, n, []) for t in true for f in first) or not (true or found)
    return Judged(
        first=done and right,
        exact=done and whole and all(_joints(true[i], found[j]) for i, j in pairs),
        false=len(found) - len(pairs),
        failed=not done,
        unexplained=document["verdict"] == "unexplained",
        seconds=float(result["cpu_seconds"]),
    )


def _joints(true: Named, found: Named) -> bool:
    return set(true.joints) == set(found.joints) or true.effect != found.effect


def tables(rows: Sequence[tuple[Task, dict[str, Any]]], out: Path) -> list[Table]:
    """The tables of all tasks that have a result."""
    groups = {}
    said = []
    for task, result in rows:
        truth = read_json(out / "truth" / f"{task.case}.json", "--step make")
        answer = "; ".join([*names_of(result), verdict_of(result)])
        if task.mode == "plain" and result.get("document"):
            # friction that differs from the data sheet by a day's change may be said
            stated = {entry["effect"] for entry in truth}
            told = result["document"]["effects"]
            kept = [e for e in told if e["effect"] not in DAILY - stated]
            result["document"]["effects"] = kept
        arm = yaml.safe_load((out / "cases" / task.case / "case/case.yaml").read_text())
        one = judged(truth, result, len(arm["nominal"]["armature"]))
        groups.setdefault((task.row, task.mode), []).append(one)
        true = ", ".join(f"{e['effect']} {e['joints']}" for e in truth) or "–"
        said.append((task.name, true, answer))
    head = ("", "question", "cases", "first right", "exact", "false names")
    head = (*head, "unexplained", "failed", "seconds: median, worst")
    figures = [
        (ROWS[row].text, mode, *_figures(several))
        for (row, mode), several in groups.items()
    ]
    answers = Table("Answers", ("case", "truth", "answer"), tuple(said))
    return [Table("States", head, tuple(figures)), answers]


def _figures(several: Sequence[Judged]) -> tuple[str, ...]:
    """The cells of a row."""
    total = len(several)

    def of(key: str) -> str:
        return f"{sum(getattr(one, key) for one in several)}/{total}"

    seconds = [one.seconds for one in several]
    return (
        str(total),
        of("first"),
        of("exact"),
        str(sum(one.false for one in several)),
        of("unexplained"),
        of("failed"),
        f"{np.median(seconds):.1f}, {max(seconds):.1f}",
    )


def main() -> None:
    """Make, run and score."""
    arguments = study_options(
        __doc__, out=Path("out/states"), rows=",".join(ROWS), draws=6, seed=1
    ).parse_args()
    out = arguments.out
    cases = list(itertools.product(arguments.rows.split(","), range(arguments.draws)))
    tasks = [Task(row, draw, mode) for row, draw in cases for mode in ROWS[row].modes]

    def sides(task: Task) -> tuple[Path, Path | None]:
        folder = out / "cases" / task.case
        with_it = task.mode in ("against", "watch")
        reference = folder / "reference" if with_it else None
        return folder / "case", reference

    study(
        arguments,
        make=lambda: make(cases, arguments.seed, out, arguments.jobs),
        plans=lambda: tasks,
        sides=sides,
        tables=lambda rows: tables(rows, out),
        asked=lambda task: ASKED.get(task.mode, diagnosis),
    )


if __name__ == "__main__":
    main()
