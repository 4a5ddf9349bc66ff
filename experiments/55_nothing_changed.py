"""Nothing changed: recordings of one arm compared with each other, and how often an effect is named all the same.

    GAPSCOPE_DATA=.../data .venv/bin/python experiments/55_nothing_changed.py --out out/nothing [--groups ur10,sample]

Whatever ails an arm is in both sides, so that each effect that is named is false. Groups: real arms (``ur10``,
``panda``, ``tx40``, ``emps``: cuts of a recording against each other, and against those of another day), legs of a
robot in the air (``go2``: six repeats of one motion), and simulated cases (``sample``: recordings with other motions).
Between cuts ``GUARD`` seconds are left out.

Resumable: run it again for the rest; each comparison has a result file. ``--results NAME`` keeps the results of several
versions side by side.
``--step agree`` compares the six repeats of each leg of the Go2 with each other, in a table of its own.
"""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml
from common import (
    DATA,
    grouped,
    names_of,
    study,
    study_options,
    verdict_of,
)
from real_carriers import LEGS, go2_leg, load_carrier

from gapscope.arm.case import Case, load_case
from gapscope.arm.io.json_file import read_json, write_json
from gapscope.arm.io.write_case import write_case
from gapscope.arm.recording import Recording
from gapscope.blind_check.scoring import wilson
from gapscope.diagnosis.agreement import (
    AGREES,
    DIFFERS,
    NOT_DETERMINED,
    Agreement,
    agreement,
)
from gapscope.reports.pages import PageSection as Table

REAL = ("ur10", "panda", "tx40", "emps")
GROUPS = (*REAL, "go2", "sample")
GUARD = 0.5
"""Time that is left out between two cuts of a recording, longer than a gap is correlated [s]."""
SHORTEST = 1.55
"""A cut is no shorter than this [s]; a diagnosis needs 1.5 s."""
CUTS = {"half": 2, "third": 3, "quarter": 4}
"""Into how many cuts a recording is taken apart."""
GAINS = np.array([[20.0, 20.0, 40.0], [1.0, 1.0, 2.0]])
"""Proportional [N m/rad] and damping gains [N m s/rad] of hip, thigh and calf, as asked for."""
SCATTERED = ("Coulomb friction", "viscous friction", "torque gain")
"""Quantities whose scatter from repeat to repeat is shown."""
SAMPLES = 9
LETTERS = "abcd"


class Comparison(NamedTuple):
    """One comparison of an arm with itself.

    Attributes:
        group, arm: what is compared.
        relation: how case and reference lie to each other: ``cuts``, ``other day``, ``repeat`` or ``other motion``.
        case, reference: names of their recordings.
    """

    group: str
    arm: str
    relation: str
    case: tuple[str, ...]
    reference: tuple[str, ...]

    @property
    def name(self) -> str:
        """Name of its folder."""
        return f"{self.arm}_{'+'.join(self.case)}_against_{'+'.join(self.reference)}"


def cuts(recording: Recording) -> Iterator[list[Recording]]:
    """The cuts of a recording, a list for each number of them with which they are long enough."""
    for kind, count in CUTS.items():
        edges = np.linspace(0.0, recording.duration, count + 1)
        inner = edges + GUARD / 2
        inner[[0, -1]] = 0.0, recording.duration
        if recording.duration / count - GUARD < SHORTEST:
            continue
        parts = []
        for k in range(count):
            end = edges[k + 1] - GUARD / 2 if k + 1 < count else recording.duration
            inside = (recording.t >= inner[k]) & (recording.t <= end)
            part = recording.part(inside, name=f"{recording.name}_{kind}{k + 1}")
            parts.append(replace(part, t=part.t - part.t[0]))
        yield parts


def of_real_arm(arm: str, out: Path) -> tuple[Case, list[Comparison]]:
    """A real arm with its recordings and their cuts, and what is compared."""
    case = load_carrier(arm, out / "carriers" / arm)
    whole = [
        replace(r, name=f"day{k}", t=r.t - r.t[0])
        for k, r in enumerate(case.recordings, 1)
    ]
    recordings, found = list(whole), []

    def compared(relation: str, one: str, *others: str) -> None:
        found.append(Comparison(arm, arm, relation, (one,), others))

    for day in whole:
        sides = [day.name]
        for parts in cuts(day):
            recordings += parts
            names = [r.name for r in parts]
            for one in names:
                compared("cuts", one, *(n for n in names if n != one))
            sides += names if len(parts) == CUTS["half"] else []
        for other_day in whole:
            for one in sides if other_day is not day else ():
                compared("other day", one, other_day.name)
    return replace(case, recordings=tuple(recordings)), found


def of_leg(leg: str, out: Path) -> tuple[Case, list[Comparison]]:
    """A leg of the Go2, its torque from the gains that were asked for, and its repeats compared."""
    case, (kp, kd) = go2_leg(leg, out / "carriers"), GAINS
    recordings = []
    for r in case.recordings:
        tau = kp * (r.q_ref - r.q) + kd * (r.dq_ref - r.dq)
        recordings.append(replace(r, tau=tau, q_ref=None, dq_ref=None))
    found = []
    for k in range(6):
        reference = tuple(f"repeat{(k + more) % 6}" for more in (1, 2))
        found.append(Comparison("go2", case.name, "repeat", (f"repeat{k}",), reference))
    return replace(case, recordings=tuple(recordings)), found


def of_sample(number: int, out: Path) -> tuple[Case, list[Comparison]]:
    """A simulated case with all four recordings, each compared with every two of the others."""
    source = DATA / "sample_cases" / f"case{number:03d}"
    content = yaml.safe_load((source / "case.yaml").read_text(encoding="utf-8"))
    content["robot"] = str(source / content["robot"])
    content["recordings"] = [str(source / f"recording_{k}.csv") for k in LETTERS]
    file = out / "carriers" / f"{source.name}.yaml"
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(yaml.safe_dump(content), encoding="utf-8")
    case = load_case(file)
    recordings = tuple(
        replace(r, name=name) for r, name in zip(case.recordings, LETTERS, strict=True)
    )
    name = f"sample{number}"
    found = []
    for one in LETTERS:
        others = [n for n in LETTERS if n != one]
        for pair in itertools.combinations(others, 2):
            found.append(Comparison("sample", name, "other motion", (one,), pair))
    return replace(case, name=name, recordings=recordings), found


def arms(group: str, out: Path) -> Iterator[tuple[Case, list[Comparison]]]:
    """Every arm of a group, with its recordings and comparisons."""
    if group == "go2":
        yield from (of_leg(leg, out) for leg in LEGS)
    elif group == "sample":
        yield from (of_sample(k, out) for k in range(SAMPLES))
    else:
        yield of_real_arm(group, out)


def make(groups: Sequence[str], out: Path) -> None:
    """Write the recordings of each arm once, and case files that list them."""
    for group in groups:
        plan = out / "plans" / f"{group}.json"
        if plan.is_file():
            continue
        planned = []
        for case, found in arms(group, out):
            folder = out / "arms" / case.name
            write_case(case, folder, overwrite=True)
            for one in found:
                write_sides(one, folder, out)
            planned += found
            print(f"{case.name}: {len(found)} comparisons", flush=True)
        write_json([one._asdict() for one in planned], plan)


def write_sides(one: Comparison, arm: Path, out: Path) -> None:
    """Write ``case`` and ``reference`` of a comparison: case files that list recordings of the arm's folder."""
    content = yaml.safe_load((arm / "case.yaml").read_text(encoding="utf-8"))
    beside = Path("../../..") / "arms" / arm.name
    content["robot"] = str(beside / content["robot"])
    for side, names in (("case", one.case), ("reference", one.reference)):
        folder = out / "cases" / one.name / side
        folder.mkdir(parents=True, exist_ok=True)
        content["name"] = f"{arm.name} {side}"
        content["recordings"] = [str(beside / f"{name}.csv") for name in names]
        text = yaml.safe_dump(content, sort_keys=False)
        (folder / "case.yaml").write_text(text, encoding="utf-8")


def read_plans(groups: Sequence[str], out: Path) -> list[Comparison]:
    """The comparisons of some groups."""
    found = []
    for group in groups:
        content = read_json(out / "plans" / f"{group}.json", "--step make")
        for entry in content:
            sides = {key: tuple(entry[key]) for key in ("case", "reference")}
            found.append(Comparison(**{**entry, **sides}))
    return found


def changes_of(result: dict[str, Any]) -> list[str]:
    """Changes during a recording that a result states, with their joints and times; they are false too."""
    changes = (result.get("document") or {}).get("changes") or []
    return [f"{c['what']} {c['joints']} at {c['time']:.1f} s" for c in changes]


def tables(rows: Sequence[tuple[Comparison, dict[str, Any]]]) -> list[Table]:
    """Rates by group and relation; and all that was named."""
    head = ("comparisons", "named", "rate", "95 % interval", "change during")
    head = (*head, "unexplained", "failed", "effects", "seconds: median, worst")
    wrong = [
        (
            plan.name,
            verdict_of(result),
            "; ".join(names_of(result)),
            "; ".join(changes_of(result)),
        )
        for plan, result in rows
        if names_of(result) or changes_of(result) or result["status"] != "done"
    ]
    return [
        grouped(
            "Nothing changed",
            head,
            rows,
            lambda row: f"{row[0].group}, {row[0].relation}",
            lambda own: _figures([result for _, result in own]),
            rows,
        ),
        Table(
            "Named or failed",
            ("comparison", "verdict", "effects", "changes during a recording"),
            wrong,
        ),
    ]


def _figures(results: Sequence[dict[str, Any]]) -> tuple[str, ...]:
    done = [r for r in results if r["status"] == "done"]
    named = [r for r in done if names_of(r)]
    low, high = wilson(len(named), len(done))
    effects = Counter(name.split()[0] for r in named for name in names_of(r))
    seconds = [float(r["cpu_seconds"]) for r in results]
    return (
        str(len(named)),
        f"{100 * len(named) / max(len(done), 1):.1f} %",
        f"{100 * low:.1f} to {100 * high:.1f} %",
        str(sum(bool(changes_of(r)) for r in done)),
        str(sum(verdict_of(r) == "unexplained" for r in done)),
        str(len(results) - len(done)),
        ", ".join(f"{n} {name}" for name, n in effects.most_common()) or "–",
        f"{np.median(seconds):.1f}, {max(seconds):.1f}",
    )


def agree(out: Path) -> None:
    """Print whether the six repeats of each leg agree, and how far values scatter from repeat to repeat."""
    rows = []
    for leg in LEGS:
        case, _ = of_leg(leg, out)
        found = agreement(case)
        differing = [line.name for line in found.having(DIFFERS)]
        cells = (
            str(len(found.having(AGREES))),
            ", ".join(differing) or "–",
            str(len(found.having(NOT_DETERMINED))),
        )
        rows.append(
            (leg, *cells, *(scatter(found, quantity) for quantity in SCATTERED))
        )
    head = ("leg", "agree", "differ", "not determined", *SCATTERED)
    print(Table("Repeats of the Go2", head, tuple(rows)).markdown())


def scatter(found: Agreement, quantity: str) -> str:
    """Deviation of a quantity from repeat to repeat over its mean, joint by joint [%]."""
    texts = []
    for line in found.parameters:
        if line.name.startswith(quantity):
            share = 100 * line.value.std(ddof=1) / abs(line.value.mean())
            texts.append(f"{share:.1f}" if np.isfinite(share) else "–")
    return ", ".join(texts)


def main() -> None:
    """Make, run and score."""
    arguments = study_options(
        __doc__, "agree", out=Path("out/nothing_changed"), groups=",".join(GROUPS)
    ).parse_args()
    groups, out = arguments.groups.split(","), arguments.out
    if arguments.step == "agree":
        agree(out)
        return
    study(
        arguments,
        make=lambda: make(groups, out),
        plans=lambda: read_plans(groups, out),
        sides=lambda plan: tuple(
            out / "cases" / plan.name / side for side in ("case", "reference")
        ),
        tables=tables,
    )


if __name__ == "__main__":
    main()
