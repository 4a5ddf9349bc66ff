"""What the contrast of ``gapscope.model`` says of a case, as an outside program; see ``outside_program.py``.

    python experiments/contrast_program.py CASE --against REFERENCE

For ``--sketch`` of ``26_real_benchmark.py``, ``55_nothing_changed.py`` and ``56_states.py``, as long as the command
``diagnose --against`` has its own search.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

from gapscope.arm.case import load_case
from gapscope.model.design import fitted_arm
from gapscope.model.difference import Search
from gapscope.model.rows import Rows

NAMED, CLOSED = 0.5, 0.01
"""Probability, and share of some joint's torque, from which on an effect is named [1]."""
DAYS = 0.15
"""Share by which friction differs from day to day at most [1]."""


def main() -> None:
    """Print what changed, the largest first."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("case", type=Path)
    parser.add_argument("--against", type=Path, required=True)
    arguments = parser.parse_args()
    begun = time.process_time()
    case, reference = load_case(arguments.case), load_case(arguments.against)
    rows = Rows([reference.recordings, case.recordings])
    found = Search(rows, fitted_arm(rows, case.arm, {0}), 1, {0}, DAYS).run()
    shares = {term: float(found.share(term).max()) for term in found.terms}
    for term in sorted(shares, key=lambda term: -shares[term]):
        probability = found.probabilities[term]
        if probability >= NAMED and shares[term] >= CLOSED:
            values = [round(float(value), 6) for value in found.value(term)]
            print(term.effect, term.joint, "case", values, round(probability, 3))
    print(f"{time.process_time() - begun:.1f} s of processor time")


if __name__ == "__main__":
    main()
