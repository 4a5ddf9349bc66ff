"""The same diagnosis however a case is written down: in another order, in other units, with other signs and stamps.

    .venv/bin/python experiments/53_metamorphic.py out/metamorphic
    .venv/bin/python experiments/53_metamorphic.py out/metamorphic --relation mirrored --case 5
    .venv/bin/python experiments/53_metamorphic.py out/metamorphic --bitwise

Cases of the blind check's generator and a twin of each by every relation (``metamorphic.py``) are written as a user
would have and diagnosed. A diagnosis that is there is kept, so that a run that was stopped goes on; remove
``OUT/diagnoses`` after a change of the program. Prints what differs, then a table of the relations as Markdown. Exits
with 1 if names or values of a pair differ by more than is tolerated.

``--bitwise`` runs commands twice, each in a process of its own, whatever the hash seed, the threads of the libraries,
and with and without ``--jobs``. Files of both runs are compared byte by byte; of JSON files what names the program, the
folder or the time of a run is left out.
"""

from __future__ import annotations

import io
import json
import os
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from common import command_line, kept, markdown
from generator_arms import make_generated
from metamorphic import RELATIONS, CaseFiles, Difference, Relation, compare

from gapscope.arm.case import load_case
from gapscope.blind_check.generator.simulate import STRONG, CaseSpec, Conditions
from gapscope.diagnosis.diagnose import diagnose

DURATION = (8.0, 10.0)
"""Shortest and longest recording [s]."""


def wanted(robot: str, *laws: str, kind: str = "single", **conditions: Any) -> CaseSpec:
    """A case of a robot with laws, two recordings at 250 Hz unless said otherwise."""
    usual = {"rate": 250, "recordings": 2, "duration": DURATION}
    severity = None if kind == "healthy" else STRONG[1]
    return CaseSpec(kind, laws, severity, Conditions(robot, **(usual | conditions)))


CASES = (
    wanted("small", kind="healthy"),
    wanted("franka_panda", bare=True, inertials_off=0.05, kind="healthy"),
    wanted("ur5_like", rate=100, recordings=3, kind="healthy"),
    wanted("small", "coulomb_friction"),
    wanted("xarm6", "payload", recordings=3, inertials_off=0.03),
    wanted("small", "joint_elasticity"),
    wanted("franka_panda", "actuator_delay"),
    wanted("kuka_iiwa", "torque_scale", rate=100, bare=True),
    wanted("ur5_like", "backlash"),
    wanted("drawn", "torque_ripple", recordings=3),
    wanted("xarm6", "encoder_offset", rate=100, inertials_off=0.02),
    wanted("drawn", "external_force", bare=True),
    wanted("ur10_like", "base_tilt", recordings=3),
    wanted("small", "parallel_spring", "actuator_lag", kind="pair"),
    wanted("drawn", "torque_offset", "viscous_friction", bare=True, kind="pair"),
    wanted("xarm6", "armature", "load_friction", kind="pair"),
    wanted("franka_panda", "sign_flip", rate=100),
    wanted("small", "joint_swap"),
    wanted("small", "hysteresis", kind="outside"),
    wanted("ur5_like", "link_inertia", inertials_off=0.02),
    wanted("small", "friction_drift", rate=500),
    wanted("small", "actuator_lag", rate=1000),
)
"""Robots, effects and conditions dealt out by hand, so that each occurs; sizes and joints are drawn."""
SEED = 53


def make(number: int, folder: Path) -> Path:
    """One of ``CASES`` in a folder of its own, made unless it is there; its truth lies beside it."""
    place = folder / f"case{number:02d}"
    make_generated(CASES[number], (SEED, number), place)
    return place


def applies(relation: str, number: int) -> bool:
    """Whether a relation makes a twin of a case: a joint whose columns were exchanged has no sense of its own."""
    return not (relation == "mirrored" and "joint_swap" in CASES[number].laws)


# The same command twice

NOT_COMPARED = {
    "made_from": "versions and hashes",
    "seconds": "time of a run",
    "processor_hours": "time of a run",
    "salt": "secret of a sealed set",
}
"""Keys of JSON files that differ by their nature, and what they hold."""
UNREPEATABLE = ("frozen.json", "labels.json", "plan.json", "commitment.json")
"""Files with the time, the salt or the hashes of a run."""
NUMBER = re.compile(r"-?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?")
TEXT = (".json", ".yaml", ".csv", ".npz", ".urdf", ".txt")
"""Endings of the files that are compared; reports and the tables of a fleet hold the same numbers once more."""
RUN = re.compile(r"(?<=_r)[0-9a-f]{10}")
"""Number of a run in the folders of a fleet, which is drawn."""


BLIND = "--seed 7 --singles 2 --pairs 0 --triples 0 --outside 0 --healthy 1 --ladder 0 --robots small"
"""What ``gapscope blind make`` makes."""


BASE = {"PYTHONHASHSEED": "1", "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
TWO_THREADS = {"OMP_NUM_THREADS": "2", "OPENBLAS_NUM_THREADS": "2"}
VARIANTS = {
    "first": ({}, "--jobs 1"),
    "again": ({}, "--jobs 2"),
    "other hash seed": ({"PYTHONHASHSEED": "2"}, ""),
    "two threads": (TWO_THREADS, ""),
}
"""Ways to run a command, the first one being what the others are compared with: environment, and jobs if it has any."""
COMMANDS = {
    "diagnose": "diagnose {one} --out {out}",
    "diagnose, two cases": "diagnose {one} {other} --out {out}",
    "diagnose --against": "diagnose {after} --against {before} --out {out}",
    "identify": "identify {one} --out {out}",
    "agree": "agree {one} --out {out}",
    "fleet": "fleet {one} {other} --out {out}",
    "excite": "excite {one} --seed 1 --evaluations 60 --out {out}/e.csv",
    "record": "record {one} --effects {effects} --trajectory fourier --recordings 2 --duration 4 --engine mujoco "
    "--seed 3 --out {out}/case",
    "blind make": f"blind make {BLIND} --out {{out}}/set",
    "blind run": "blind run {sealed} --out {out}",
    "evaluate": "evaluate nominal --robot {one} --engine mujoco --motions fourier --seeds 1 --duration 2 --out {out}",
}
"""Commands of ``gapscope`` that are repeated."""
WITH_JOBS = ("diagnose, two cases", "fleet", "blind make", "blind run")
"""Those that take ``--jobs``."""


def inputs(cases: Path, folder: Path) -> dict[str, Path]:
    """What the commands are given: two cases with three joints, and what is made of them."""
    one, effects = cases / "case03", folder / "effects.yaml"
    # the case with its first recording alone, and with its second
    files, parts = CaseFiles.read(one), [folder / name for name in ("before", "after")]
    for place, recording in zip(parts, files.content["recordings"], strict=False):
        if not place.is_dir():
            content = {**files.content, "recordings": [recording]}
            files._replace(content=content).write(place)
    effects.write_text(
        "schema: 1\neffects:\n- {effect: coulomb_friction, joints: [1], parameters: {torque: [2.0]}}\n"
    )
    # a small set of blind cases, whose labels are taken away as the check asks
    sealed = folder / "sealed"
    if not sealed.is_dir():
        call = [sys.executable, "-m", "gapscope", "blind", "make", *BLIND.split()]
        subprocess.run([*call, "--out", str(sealed)], check=True)
        shutil.rmtree(folder / "sealed-labels")
    given = {"one": one, "other": cases / "case13", "effects": effects}
    return given | {"before": parts[0], "after": parts[1], "sealed": sealed}


def results(folder: Path) -> dict[str, Any]:
    """What a run wrote: bytes of files by their place, of JSON files the data."""
    found = {}
    for path in sorted(folder.rglob("*")):
        if path.suffix not in TEXT or path.name in UNREPEATABLE or not path.is_file():
            continue
        place = RUN.sub("RUN", str(path.relative_to(folder)))
        found[place] = path.read_bytes()
        if path.suffix == ".json":
            text = path.read_text("utf-8").replace(str(folder), "OUT")
            text = RUN.sub("RUN", text)
            found[place] = json.dumps(_comparable(json.loads(text)))
    return found


def _comparable(data: Any) -> Any:
    """JSON data without the keys that differ by their nature."""
    if isinstance(data, dict):
        return {
            key: _comparable(value)
            for key, value in data.items()
            if key not in NOT_COMPARED
        }
    return [_comparable(value) for value in data] if isinstance(data, list) else data


def repeat(cases: Path, out: Path) -> str:
    """Run all commands in all ways; a table of which results are bit by bit the same.

    What has been run is kept.
    """
    folder = out / "bitwise"
    folder.mkdir(parents=True, exist_ok=True)
    head = ("command", "files", "run again, or with `--jobs 2`", "other hash seed")
    rows = []
    given = inputs(cases, folder)
    for name in COMMANDS:
        found = [_run(name, variant, given, folder) for variant in VARIANTS]
        first, others = found[0], found[1:]
        # what a run ended with is no file
        cells = [f"`gapscope {name}`", str(len(first) - 1)]
        for other in others:
            places = sorted(first.keys() | other.keys())
            differing = [p for p in places if first.get(p) != other.get(p)]
            only_digits = all(_alike(first.get(p), other.get(p)) for p in differing)
            names = ", ".join(f"`{p}`" for p in differing[:4])
            said = f"last digits of {names}" if only_digits else f"{names} differ"
            cells.append(said if differing else "same")
        rows.append(cells)
        print(*cells, flush=True)
    return markdown((*head, "two threads"), rows)


def _alike(one: Any, other: Any) -> bool:
    """Whether two files differ in what rounding does to their numbers alone."""
    numbers, rest = zip(
        *(_taken_apart(content) for content in (one, other)), strict=True
    )
    same_size = len(numbers[0]) == len(numbers[1])
    return (
        same_size and rest[0] == rest[1] and np.allclose(*numbers, rtol=1e-6, atol=1e-8)
    )


def _taken_apart(content: Any) -> tuple[list[float], Any]:
    """The numbers of a file, and the rest of it."""
    if isinstance(content, bytes) and content.startswith(b"PK"):
        with np.load(io.BytesIO(content), allow_pickle=False) as stored:
            arrays = {name: stored[name] for name in sorted(stored.files)}
        of_numbers = {n: x for n, x in arrays.items() if x.dtype.kind in "if"}
        numbers = [float(v) for x in of_numbers.values() for v in x.ravel()]
        return numbers, {
            n: x.tolist() for n, x in arrays.items() if n not in of_numbers
        }
    text = content if isinstance(content, str) else (content or b"").decode("latin-1")
    return [float(x) for x in NUMBER.findall(text)], NUMBER.sub("#", text)


def _run(
    command: str, variant: str, given: dict[str, Path], folder: Path
) -> dict[str, Any]:
    """What one run of a command wrote."""
    name = f"{command}_{variant}".translate(str.maketrans(" ,", "__"))
    place, done = folder / name, folder / f"{name}.done"
    environment, jobs = VARIANTS[variant]
    if not done.is_file():
        shutil.rmtree(place, ignore_errors=True)
        place.mkdir()
        words = [x.format(out=place, **given) for x in COMMANDS[command].split()]
        words += jobs.split() if command in WITH_JOBS else []
        with (folder / f"{name}.log").open("w") as log:
            process = subprocess.run(
                [sys.executable, "-m", "gapscope", *words],
                env={**os.environ, **BASE, **environment},
                stdout=log,
                stderr=log,
                check=False,
            )
        done.write_text(f"{process.returncode}\n")
    return {"exit": done.read_text(), **results(place)}


# Cases and their twins

BITWISE = (3, 13)
"""Cases that commands are run on with ``--bitwise``."""


def diagnosed(folder: Path) -> dict[str, Any]:
    """Diagnosis of a folder, with its processor time [s]."""
    begun = time.process_time()
    document = dict(diagnose(load_case(folder, any_unit=True)).document)
    return {**document, "seconds": time.process_time() - begun}


def examine(number: int, relation: Relation, out: Path) -> Difference:
    """What differs between a case and its twin."""
    name = f"case{number:02d}"
    case = make(number, out / "cases")
    results = out / "diagnoses"
    original = kept(results / f"{name}.json", diagnosed, case)
    rng = np.random.default_rng([SEED, number, RELATIONS.index(relation)])
    twin = relation.twin(CaseFiles.read(case), rng)
    file = results / f"{name}_{relation.name}.json"
    folder = out / "twins" / f"{name}_{relation.name}"
    if not file.is_file():
        shutil.rmtree(folder, ignore_errors=True)
        twin.files.write(folder)
    other = kept(file, diagnosed, folder)
    shutil.rmtree(folder, ignore_errors=True)
    return compare(original, other, twin)


def table(found: dict[str, list[Difference]]) -> str:
    """A line for each relation."""
    head = ["changed", "pairs", "same verdict", "same effects", "same possible ones"]
    head += ["within tolerance", "value [std]", "closed", "share"]
    lines = []
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
        for key in ("value", "closed", "share"):
            largest = max((getattr(row, key) for row in same), default=0.0)
            cells.append(f"{largest:.1e}" if largest < 0.01 else f"{largest:.2f}")
        lines.append(cells)
    return markdown(head, lines)


def main(out: Path, relations: list[str], cases: list[int]) -> int:
    """Diagnose what is asked for; 1 if a relation does not hold."""
    out.mkdir(parents=True, exist_ok=True)
    (out / "cases").mkdir(exist_ok=True)
    found = {}
    failed = False
    for number in cases:
        for relation in RELATIONS:
            if relation.name not in relations or not applies(relation.name, number):
                continue
            difference = examine(number, relation, out)
            found.setdefault(relation.name, []).append(difference)
            failed |= not _holds(difference, relation)
            said = f"value {difference.value:.1e} std, closed {difference.closed:.1e}"
            said += f", share {difference.share:.1e} {difference.words}"
            print(f"case{number:02d} {relation.name}: {said}", flush=True)
    print(table(found))
    return int(failed)


def _holds(difference: Difference, relation: Relation) -> bool:
    """Whether a twin has the same names, and the same values within the tolerance."""
    return difference.same_names and difference.value <= relation.tolerance


if __name__ == "__main__":
    names = [relation.name for relation in RELATIONS]
    asked = command_line(
        __doc__,
        "out",
        relation={"action": "append", "choices": names},
        case={"action": "append", "type": int, "choices": range(len(CASES))},
        bitwise=(False, "repeat commands"),
    ).parse_args()
    if asked.bitwise:
        (asked.out / "cases").mkdir(parents=True, exist_ok=True)
        for case in BITWISE:
            make(case, asked.out / "cases")
        print(repeat(asked.out / "cases", asked.out))
        sys.exit()
    sys.exit(
        main(asked.out, asked.relation or names, asked.case or list(range(len(CASES))))
    )
