"""What `gapscope matter` says of the effects found on a generated arm and on a real one, for a recorded motion.

    GAPSCOPE_DATA=.../data .venv/bin/python experiments/62_matter.py --out out/matter [--cases generated,ur10]

The generated arm comes from the blind check's generator, with a load and a late motor by its laws. Each case is
diagnosed, unless that is done, and the motion of its first recording is the task. Prints a table for each case.
"""

from __future__ import annotations

import warnings
from pathlib import Path

from common import command_line
from generator_arms import named_case
from threadpoolctl import threadpool_limits

import gapscope
from gapscope.arm.case import load_case
from gapscope.arm.errors import ModelWarning
from gapscope.blind_check.generator.simulate import CaseSpec, Conditions
from gapscope.reports.matter import table

SPEC = CaseSpec(
    "pair",
    ("payload", "actuator_delay"),
    (8.0, 20.0),
    Conditions("small", rate=250, duration=(8.0, 12.0)),
)


def main() -> None:
    """Diagnose each case and rank what was found."""
    arguments = command_line(
        __doc__, out=Path("out/matter"), cases="generated,ur10", seeds=5, jobs=1
    ).parse_args()
    warnings.simplefilter("ignore", ModelWarning)
    threadpool_limits(1)
    for name in arguments.cases.split(","):
        case = load_case(named_case(name, SPEC, (1, 62), arguments.out))
        folder = arguments.out / name
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
