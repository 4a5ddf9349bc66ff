"""What `gapscope matter` says of the effects found on a generated arm and on a real one, for a recorded motion.

    GAPSCOPE_DATA=.../data .venv/bin/python experiments/62_matter.py --out out/matter [--cases generated,ur10]

The generated arm comes from the blind check's generator, with a load and a late motor by its laws. Each case is
diagnosed, unless that is done, and the motion of its first recording is the task. Prints a table for each case.
"""

from __future__ import annotations

import warnings
from importlib import import_module
from pathlib import Path

from common import command_line
from generator_arms import make_generated
from threadpoolctl import threadpool_limits

import gapscope
from gapscope.arm.case import load_case
from gapscope.arm.errors import ModelWarning
from gapscope.blind_check.generator.simulate import CaseSpec, Conditions
from gapscope.reports.matter import table

REAL = import_module("61_rehearsal").CASES


def case_of(name: str, out: Path) -> Path:
    """The case of a name: one that is made, or a file of the real ones."""
    if name != "generated":
        return REAL / f"{name}.yaml"
    conditions = Conditions(robot="small", rate=250, duration=(8.0, 12.0))
    effects = ("payload", "actuator_delay")
    spec = CaseSpec("pair", effects, (8.0, 20.0), conditions)
    folder = out / "cases" / name
    make_generated(spec, (1, 62), folder, out / "cases" / f"{name}.json")
    return folder


def main() -> None:
    """Diagnose each case and rank what was found."""
    parser = command_line(
        __doc__, out=Path("out/matter"), cases="generated,ur10", seeds=5, jobs=1
    )
    arguments = parser.parse_args()
    warnings.simplefilter("ignore", ModelWarning)
    threadpool_limits(1)
    for name in arguments.cases.split(","):
        case, folder = load_case(case_of(name, arguments.out)), arguments.out / name
        if not (folder / "diagnosis.json").is_file():
            gapscope.diagnose(case).save(folder)
        task = case.recordings[0]
        ranked = gapscope.matter(
            case, task, diagnosis=folder, seeds=arguments.seeds, jobs=arguments.jobs
        )
        ranked.save(folder)
        print(f"{name}: {ranked.document['summary']}\n")
        print(table(ranked.document).markdown(), flush=True)


if __name__ == "__main__":
    main()
