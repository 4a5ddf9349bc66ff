"""Two searches of the same blind cases: that of ``diagnose``, and the one contrast about the data sheet, in pairs.

    .venv/bin/python experiments/11_blind_check.py --out out/one --plan PLAN.yaml --step make
    .venv/bin/python experiments/61_one_question.py --cases out/one/cases --labels out/one/vault/labels \
        --out out/one/pairs [--only new]

Of each case both get the recordings with the set-up put right by ``diagnose``'s own screens; cases whose only cause is
a fault of the set-up, or quantisation, are left out, as no search is asked of them. Names are scored as the blind check
scores them. Resumable: a result file per case and search; processor seconds count the whole of ``diagnose``, and of the
contrast its search and the screens of the set-up.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from gapscope.arm.case import Case, load_case
from gapscope.arm.io.json_file import read_json, write_json
from gapscope.blind_check.generator.laws import SETUP
from gapscope.blind_check.scoring import Compared, compare, wilson
from gapscope.diagnosis.diagnose import diagnose
from gapscope.diagnosis.gap.plausible_data import select_windows
from gapscope.diagnosis.selection.sheet_search import sheet_search
from gapscope.diagnosis.setup_faults.detection import find_setup_faults, upright
from gapscope.diagnosis.setup_faults.found_fault import repaired
from gapscope.diagnosis.study import with_torque
from gapscope.reports.blind_check import Table

NOT_ASKED = {*SETUP, "encoder_quantization"}
"""What no search is asked for: the set-up is screened before, and quantisation shows in the recording itself."""


def by_search(case: Case) -> dict[str, Any]:
    """What ``diagnose`` names."""
    document = diagnose(case).document
    named = {key: document[key] for key in ("verdict", "effects")}
    return {**named, "unknown": document["verdict"] == "unexplained"}


def by_contrast(case: Case) -> dict[str, Any]:
    """What the contrast about the data sheet names."""
    case, _ = with_torque(case)
    case = repaired(case, find_setup_faults(case))
    looked = upright(select_windows(case))
    found = sheet_search(looked.arm, looked.recordings).run()
    terms = found.fit.contrast.design.terms
    theta = np.zeros(terms.size)
    for one, value in found.fit.values.items():
        theta[list(one.term.columns)] = value
    shown = {one.term.finding: float(found.share(one).max()) for one in found.fit.mine}
    effects = [
        {
            "effect": applied.name,
            "joints": list(applied.joints),
            "parameters": {
                k: {"value": x.tolist()} for k, x in applied.parameters.items()
            },
        }
        for applied in terms.effects(terms.clipped(theta))
    ]
    effects.sort(key=lambda entry: -max(_shares(entry["effect"], shown)))
    verdict = "effects_found" if effects else "no_gap"
    return {"verdict": verdict, "effects": effects, "unknown": bool(found.fit.grown)}


def _shares(effect: str, shown: dict[str, float]) -> Iterator[float]:
    return (x for finding, x in shown.items() if finding.split()[0] == effect)


SEARCHES = {"now": by_search, "new": by_contrast}


def run(cases: Path, labels: Path, out: Path, only: list[str]) -> None:
    """Let each search answer each case that has no answer yet."""
    for folder in sorted(cases.glob("case*")):
        label = read_json(labels / "parts" / f"{folder.name}.json", "")
        if NOT_ASKED & {entry["effect"] for entry in label["effects"]}:
            continue
        for name in only:
            file = out / name / f"{folder.name}.json"
            if file.exists():
                continue
            start = time.process_time()
            with threadpool_limits(1):
                answer = SEARCHES[name](load_case(folder / "case.yaml"))
            answer["seconds"] = time.process_time() - start
            file.parent.mkdir(parents=True, exist_ok=True)
            write_json(answer, file)


def scored(labels: Path, out: Path, name: str) -> dict[str, Compared]:
    """What a search answered beside the truth, by case."""
    every = {}
    for file in sorted((out / name).glob("case*.json")):
        answer = read_json(file, "remove it")
        label = read_json(labels / "parts" / file.name, "")
        for effect in answer["effects"]:
            # both are scored by their names alone
            effect.update(alternatives=[], probability=1.0)
        every[file.stem] = compare(file.stem, label, answer, answer["seconds"])
    return every


def right(one: Compared) -> bool:
    """Whether the names are right: all of them, or none where there is none in the catalogue."""
    return one.exact if one.truth else not one.found


def table(labels: Path, out: Path) -> Table:
    """Both searches by kind of case, on those that both answered; and the cases on which they differ."""
    both = {name: scored(labels, out, name) for name in SEARCHES}
    shared = sorted(set(both["now"]) & set(both["new"]))
    rows = []
    for kind in sorted({both["now"][case].kind for case in shared}):
        mine = [case for case in shared if both["now"][case].kind == kind]
        cells = [kind, str(len(mine))]
        for every in both.values():
            hits = sum(right(every[case]) for case in mine)
            least, most = wilson(hits, len(mine))
            cells.append(f"{hits} ({least:.0%} to {most:.0%})")
        now, new = (np.array([right(e[case]) for case in mine]) for e in both.values())
        cells.append(f"{(now & ~new).sum()}, {(new & ~now).sum()}")
        cells += [
            f"{np.mean([every[case].seconds for case in mine]):.1f}"
            for every in both.values()
        ]
        rows.append(tuple(cells))
    head = ("kind", "cases", "names right now", "new", "only now, only new")
    return Table("Two searches", (*head, "processor s now", "new"), tuple(rows))


def differing(labels: Path, out: Path) -> Iterator[str]:
    """The cases that one of them has right, in words."""
    now, new = (scored(labels, out, name) for name in SEARCHES)
    for case in sorted(set(now) & set(new)):
        if right(now[case]) != right(new[case]):
            texts = [
                ", ".join(f"{x.effect} {list(x.joints) or x.link or ''}" for x in some)
                for some in (now[case].truth, now[case].found, new[case].found)
            ]
            yield f"{case}: true {texts[0]}; now {texts[1]}; new {texts[2]}"


def main() -> None:
    """Run what is missing and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--cases", type=Path, required=True)
    parser.add_argument("--labels", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--only", choices=list(SEARCHES), action="append")
    options = parser.parse_args()
    run(options.cases, options.labels, options.out, options.only or list(SEARCHES))
    print(table(options.labels, options.out).markdown())
    for line in differing(options.labels, options.out):
        print(f"- {line}")


if __name__ == "__main__":
    main()
