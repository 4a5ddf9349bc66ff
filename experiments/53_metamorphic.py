"""The same diagnosis however a case is written down: in another order, in other units, with other signs and stamps.

    .venv/bin/python experiments/53_metamorphic.py out/metamorphic
    .venv/bin/python experiments/53_metamorphic.py out/metamorphic --relation mirrored --case 5
    .venv/bin/python experiments/53_metamorphic.py out/metamorphic --bitwise

Cases of the blind check's generator (``metamorphic/cases.py``) and a twin of each by every relation
(``metamorphic/relations.py``) are written as a user would have and diagnosed. A diagnosis that is there is kept, so
that a run that was stopped goes on; remove ``OUT/diagnoses`` after a change of the program. Prints what differs,
then a table of the relations as Markdown. Exits with 1 if names or values of a pair differ by more than is tolerated.
``--bitwise`` runs commands twice, with and without ``--jobs``, and compares their files (``metamorphic/bitwise.py``).
"""

from __future__ import annotations

import argparse
import json
import shutil
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from metamorphic.bitwise import repeat
from metamorphic.case_files import CaseFiles
from metamorphic.cases import CASES, SEED, applies, make
from metamorphic.compare import Difference, compare
from metamorphic.relations import RELATIONS, Relation, Twin

from gapscope.arm.case import load_case
from gapscope.diagnosis.diagnose import diagnose

BITWISE = (3, 13)
"""Cases that commands are run on with ``--bitwise``."""


def twin_of(case: Path, number: int, relation: Relation) -> Twin:
    """The twin of a case; the same one each time."""
    place = RELATIONS.index(relation)
    rng = np.random.default_rng([SEED, number, place])
    return relation.twin(CaseFiles.read(case), rng)


def diagnosed(folder: Path, file: Path) -> dict[str, Any]:
    """Diagnosis of a folder; that of ``file`` if it is there."""
    if not file.is_file():
        begun = time.process_time()
        document = dict(diagnose(load_case(folder, any_unit=True)).document)
        seconds = time.process_time() - begun
        aside = file.with_suffix(".aside")
        aside.write_text(json.dumps({**document, "seconds": seconds}), "utf-8")
        aside.replace(file)
    return dict(json.loads(file.read_text("utf-8")))


def examine(number: int, relation: Relation, out: Path) -> Difference:
    """What differs between a case and its twin."""
    name = f"case{number:02d}"
    case = make(number, out / "cases")
    results = out / "diagnoses"
    results.mkdir(exist_ok=True)
    original = diagnosed(case, results / f"{name}.json")
    twin = twin_of(case, number, relation)
    file = results / f"{name}_{relation.name}.json"
    folder = out / "twins" / f"{name}_{relation.name}"
    if not file.is_file():
        shutil.rmtree(folder, ignore_errors=True)
        twin.files.write(folder)
    other = diagnosed(folder, file)
    shutil.rmtree(folder, ignore_errors=True)
    return compare(original, other, twin)


def table(found: dict[str, list[Difference]]) -> str:
    """A line for each relation."""
    head = ["changed", "pairs", "same verdict", "same effects", "same possible ones"]
    head += ["within tolerance", "value [std]", "closed", "share", "probability"]
    head.append("NRMSE")
    lines = [f"| {' | '.join(head)} |", "|---|" + "---:|" * (len(head) - 1)]
    for relation in RELATIONS:
        rows = found.get(relation.name)
        if not rows:
            continue
        cells = [relation.what, str(len(rows))]
        cells += [
            str(sum(getattr(row, key) for row in rows))
            for key in ("verdict", "named", "possible")
        ]
        cells.append(str(sum(_holds(row, relation) for row in rows)))
        # what other effects say about the values is no difference of values
        same = [row for row in rows if row.same_names]
        for key in ("value", "closed", "share", "probability", "nrmse"):
            largest = max((getattr(row, key) for row in same), default=0.0)
            cells.append(f"{largest:.1e}" if largest < 0.01 else f"{largest:.2f}")
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def main(out: Path, relations: list[str], cases: list[int]) -> int:
    """Diagnose what is asked for; 1 if a relation does not hold."""
    out.mkdir(parents=True, exist_ok=True)
    (out / "cases").mkdir(exist_ok=True)
    found: dict[str, list[Difference]] = {}
    failed = False
    for number in cases:
        for relation in RELATIONS:
            if relation.name not in relations or not applies(relation.name, number):
                continue
            difference = examine(number, relation, out)
            found.setdefault(relation.name, []).append(difference)
            failed |= not _holds(difference, relation)
            print(f"case{number:02d} {relation.name}: {_said(difference)}", flush=True)
    print(table(found))
    return int(failed)


def _holds(difference: Difference, relation: Relation) -> bool:
    """Whether a twin has the same names, and the same values within the tolerance."""
    return difference.same_names and difference.value <= relation.tolerance


def _said(difference: Difference) -> str:
    """A line on one pair."""
    return (
        f"value {difference.value:.1e} std, closed {difference.closed:.1e}, share {difference.share:.1e}, "
        f"probability {difference.probability:.1e}, NRMSE {difference.nrmse:.1e}, floor {difference.floor:.1e} "
        f"{difference.words}"
    )


if __name__ == "__main__":
    names = [relation.name for relation in RELATIONS]
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("--relation", action="append", choices=names)
    parser.add_argument("--case", action="append", type=int, choices=range(len(CASES)))
    parser.add_argument("--bitwise", action="store_true", help="repeat commands")
    asked = parser.parse_args()
    if asked.bitwise:
        (asked.out / "cases").mkdir(parents=True, exist_ok=True)
        for case in BITWISE:
            make(case, asked.out / "cases")
        print(repeat(asked.out / "cases", asked.out))
        sys.exit()
    sys.exit(
        main(asked.out, asked.relation or names, asked.case or list(range(len(CASES))))
    )
