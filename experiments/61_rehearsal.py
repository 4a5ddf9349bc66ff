"""What `gapscope rehearse` finds of effects put into recordings: of a generated healthy arm, and of real ones.

    GAPSCOPE_DATA=.../data .venv/bin/python experiments/61_rehearsal.py --out out/rehearsal [--jobs 2]
        [--cases generated,emps] [--effects payload,torque_scale] [--sizes nine_of_ten]

The generated arm comes from the blind check's generator, and has nothing but what a healthy arm has. The page quotes
one row for each case and size: effects put in, found, taken for something else, missed, and the median of value said
over value put in. Run it again for the rest.
"""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
from common import command_line, markdown
from generator_arms import GENERATED, named_case
from threadpoolctl import threadpool_limits

import gapscope
from gapscope.arm.errors import ModelWarning
from gapscope.blind_check.generator.simulate import CaseSpec, Conditions

SPEC = CaseSpec(
    "healthy", (), None, Conditions("small", rate=250, duration=(8.0, 12.0))
)


def main() -> None:
    """Rehearse each case and print the table."""
    arguments = command_line(
        __doc__,
        out=Path("out/rehearsal"),
        cases=f"{GENERATED},emps",
        effects="",
        sizes="half,nine_of_ten",
        jobs=1,
        seed=1,
    ).parse_args()
    warnings.simplefilter("ignore", ModelWarning)
    threadpool_limits(1)
    rows = []
    for name in arguments.cases.split(","):
        folder = arguments.out / name
        result = gapscope.rehearse(
            named_case(name, SPEC, (1, 61), arguments.out),
            folder,
            effects=[effect for effect in arguments.effects.split(",") if effect],
            sizes=arguments.sizes.split(","),
            seed=arguments.seed,
            jobs=arguments.jobs,
            progress=lambda message, name=name: print(f"{name}: {message}", flush=True),
        )
        result.save(folder)
        print(result)
        every = result.to_frame()
        for chance, own in every.groupby("chance"):
            counts = own["outcome"].value_counts()
            ratio = np.median((own["value"] / own["size"]).dropna())
            numbers = [counts.get(k, 0) for k in ("found", "confused", "missed")]
            rows.append([name, chance, len(own), *numbers, f"{ratio:.2f}"])
    head = ("case", "size", "put in", "found", "confused", "missed", "said over put in")
    print(markdown(head, rows))


if __name__ == "__main__":
    main()
