"""Accuracy on recordings as loggers leave them: rows lost, wrong stamps, spikes, stuck sensors, rates, lengths.

    .venv/bin/python -m experiments.52_data_as_it_is OUT [--only NAME ...] [--cases N] [--into docs/PAGE.md]

Makes a set of cases with the blind check's generator, each recorded at 1 kHz: one of every effect of the catalogue, the
rest healthy. Each damage of ``damages.py`` is done to copies of the recordings, the labels untouched; the
cases are read and diagnosed as a user's are, and scored as ``gapscope blind score`` does. The set-up fault that
is what a damage is may be named, and does not count as an effect. Recordings of other lengths are made from the same
seed.

Resumable: a diagnosis that is in OUT is kept. ``--only`` restricts the damages, ``--cases`` takes the first N of the
cases. ``--fresh`` forgets the diagnoses of these damages. ``--into`` writes the table into a page.
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
import time
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml

from experiments.benchmarks.measure import put_into
from experiments.damaged_recordings import read, sampled, write
from experiments.damages import DAMAGES, ROBOTS, Damage, Length
from gapscope.arm.case import load_case
from gapscope.arm.errors import GapscopeError
from gapscope.arm.io.json_file import read_json, write_json
from gapscope.blind_check.generator.case import make_case, write_case
from gapscope.blind_check.generator.laws import INSIDE
from gapscope.blind_check.plan import BlindPlan, allocate_cases
from gapscope.blind_check.scoring.compare import Compared, compare
from gapscope.diagnosis.diagnose import diagnose

SEED = 52
HEALTHY = 8
"""Cases without an effect."""
HEAD = "| recordings | cases | first effect right | exact | false alarms | unexplained | refused | told of |"
WORSE = 0.1
"""Share of the cases by which the table marks a fall [1]."""


class Outcome(NamedTuple):
    """What became of one case.

    Attributes:
        compared: the diagnosis beside its label.
        fault: whether the damage was named as a fault of the set-up.
        notes: warnings and notes.
        error: why there is no diagnosis, or ``""``.
    """

    compared: Compared
    fault: bool
    notes: frozenset[str]
    error: str


def made(
    out: Path, length: Length, count: int, robots: Sequence[str]
) -> Iterator[tuple[str, Path, Any]]:
    """Cases of some robots with recordings of a length: name, folder and label; those that are there are kept."""
    effects = length.effects or INSIDE
    plan = BlindPlan(
        singles=len(effects),
        pairs=0,
        triples=0,
        outside=0,
        healthy=0 if length.effects else HEALTHY,
        ladder=0,
        effects=effects,
        robots=length.robots,
        duration=(length.seconds, length.seconds),
    )
    specs = allocate_cases(plan, SEED)[: min(count, length.cases)]
    for k, spec in enumerate(specs):
        if spec.conditions.robot not in robots:
            continue
        conditions = replace(
            spec.conditions,
            loop_rate=1000,
            rate=length.rate,
            recordings=length.recordings,
        )
        spec = replace(spec, conditions=conditions)
        name = f"case{k:04d}"
        folder, label = out / name, out / "labels" / f"{name}.json"
        if not label.is_file():
            shutil.rmtree(folder, ignore_errors=True)
            case = make_case(spec, (SEED, 2, k))
            unseen = out / "labels" / f"{name}.csv"
            write_case(case, name, spec.conditions.bare, folder, unseen)
            write_json(case.label, label)
            print(f"{length.seconds:g} s: {name} made", flush=True)
        yield name, folder, read_json(label, "remove it")


def damaged(case: Path, damage: Damage, out: Path) -> None:
    """Write the case with damaged recordings into a folder."""
    content = yaml.safe_load((case / "case.yaml").read_text(encoding="utf-8"))
    rng = np.random.default_rng(zlib.crc32(f"{damage.name} {case.name}".encode()))
    recordings = [sampled(read(case / f), damage.rate) for f in content["recordings"]]
    for name, columns in zip(
        content["recordings"], damage.change(recordings, rng), strict=True
    ):
        write(columns, out / name)
    for name in ("case.yaml", "robot.urdf"):
        shutil.copy(case / name, out / name)


def diagnosed(case: Path, damage: Damage, file: Path) -> dict[str, Any]:
    """Diagnosis of a case under a damage, or why there is none; stored in a file."""
    if file.is_file():
        return read_json(file, "remove it")
    begun = time.process_time()
    result: dict[str, Any] = {"error": "", "document": None}
    with tempfile.TemporaryDirectory(prefix="gapscope_damaged_") as folder:
        damaged(case, damage, Path(folder))
        try:
            result["document"] = diagnose(load_case(folder, any_unit=True)).document
        except GapscopeError as error:
            result["error"] = str(error).replace(f"{folder}/", "")
    result["seconds"] = round(time.process_time() - begun, 2)
    write_json(result, file)
    return result


def outcome(
    name: str, label: dict[str, Any], damage: Damage, result: dict[str, Any]
) -> Outcome:
    """A diagnosis beside its label, without the fault that the damage is."""
    document = result["document"]
    if document is None:
        return Outcome(compare(name, label, None), False, frozenset(), result["error"])
    notes = frozenset(document["warnings"])
    effects = [e for e in document["effects"] if e["effect"] != damage.fault]
    named = len(effects) < len(document["effects"])
    if named:
        document = {**document, "effects": effects}
        if document["verdict"] == "effects_found" and not effects:
            document["verdict"] = "no_gap"
    return Outcome(compare(name, label, document), named, notes, "")


def shares(outcomes: list[Outcome], clean: dict[str, Outcome]) -> dict[str, float]:
    """Figures of a damage [1], those of healthy arms and of the others apart."""
    cases = [o.compared for o in outcomes]
    single = [c for c in cases if c.kind == "single"]
    healthy = [c for c in cases if c.kind == "healthy"]
    told = [bool(o.fault or o.error or new_notes(o, clean)) for o in outcomes]
    false = [c.verdict not in ("no_gap", "failed") for c in healthy]
    return {
        "top": share([c.top for c in single]),
        "exact": share([c.exact for c in single]),
        "false": share(false),
        "unexplained": share([c.verdict == "unexplained" for c in single]),
        "refused": share([c.verdict == "failed" for c in cases]),
        "told": share(told),
    }


def share(values: list[bool]) -> float:
    """Share of what is true [1]; nan of nothing."""
    return sum(values) / len(values) if values else float("nan")


def new_notes(own: Outcome, clean: dict[str, Outcome]) -> frozenset[str]:
    """What was said of a case that was not said of the sound recordings."""
    before = clean.get(own.compared.name)
    return own.notes - (before.notes if before else frozenset())


def line(
    damage: Damage, count: int, own: dict[str, float], clean: dict[str, float]
) -> str:
    """A row of the table; a fall beyond ``WORSE`` is marked."""
    cells = []
    for key, value in own.items():
        worse = key in ("top", "exact") and value < clean[key] - WORSE
        worse |= key == "false" and value > clean[key] + WORSE
        shown = "–" if np.isnan(value) else f"{value:.0%}".replace("%", " %")
        cells.append(f"**{shown}**" if worse else shown)
    return f"| {damage.text} | {count} | " + " | ".join(cells) + " |"


def main() -> None:
    """Make, damage, diagnose, score."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("--only", nargs="*", choices=[d.name for d in DAMAGES])
    parser.add_argument("--cases", type=int, default=30)
    parser.add_argument("--robots", nargs="*", choices=ROBOTS, default=ROBOTS)
    parser.add_argument("--fresh", action="store_true")
    parser.add_argument("--detail", action="store_true", help="each case that differs")
    parser.add_argument("--into", type=Path)
    options = parser.parse_args()
    rows = [HEAD, "|---" * 8 + "|"]
    clean: dict[str, Outcome] = {}
    for damage in DAMAGES:
        if options.only and damage.name not in (*options.only, "clean"):
            continue
        results = options.out / "results" / damage.name
        if options.fresh and damage.name in (options.only or ()):
            shutil.rmtree(results, ignore_errors=True)
        cases = options.out / f"cases_{damage.length.seconds:g}s"
        outcomes = []
        for name, case, label in made(
            cases, damage.length, options.cases, options.robots
        ):
            result = diagnosed(case, damage, results / f"{name}.json")
            outcomes.append(outcome(name, label, damage, result))
        if not outcomes:
            continue
        clean = clean or {o.compared.name: o for o in outcomes}
        if options.detail:
            print(*differing(damage, outcomes, clean), sep="\n")
        sound = [
            o
            for o in clean.values()
            if o.compared.name in {x.compared.name for x in outcomes}
        ]
        before = shares(sound, clean)
        rows.append(line(damage, len(outcomes), shares(outcomes, clean), before))
        print(rows[-1], flush=True)
    text = "\n".join(rows)
    print(text)
    if options.into:
        put_into(options.into, "data", "Accuracy", text)


def differing(
    damage: Damage, outcomes: list[Outcome], clean: dict[str, Outcome]
) -> Iterator[str]:
    """A line for each case that is not exact, or a false alarm, with what was said of it."""
    for own in outcomes:
        c = own.compared
        if c.exact if c.truth else c.verdict == "no_gap":
            continue
        truth = ", ".join(f"{e.effect}{list(e.joints)}" for e in c.truth) or "healthy"
        found = ", ".join(f"{e.effect}{list(e.joints)}" for e in c.found)
        yield f"  {damage.name} {c.name} {c.robot} {truth}: {c.verdict} {found} {own.error}"
        yield from (f"      {note}" for note in sorted(new_notes(own, clean)))


if __name__ == "__main__":
    main()
