"""Are effects named at the sizes that a diagnosis states? Put into recordings, simulated and real.

    .venv/bin/python experiments/60_smallest_sizes.py [CASE...] [--terms 4] [--seed 1]
    .venv/bin/python experiments/60_smallest_sizes.py --pairs 8 [--robots small,drawn]

A case is diagnosed as it is: ``expected`` says how large each effect would have to be to be named with a probability of
0.5 and of 0.9. Then some of the effects that `gapscope rehearse` knows are put in, by its laws, at half the first size,
at it, at the second and at twice the first, and the case is diagnosed again. ``--pairs`` makes unchanged pairs of
``12_against.py``, whose case is compared with its reference. The table has a row for each size: the share named where
it was put in, and found there with a lesser probability.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from common import command_line, markdown, share_text
from threadpoolctl import threadpool_limits

import gapscope
from gapscope.arm.case import Case, load_case
from gapscope.arm.io.json_file import write_json
from gapscope.blind_check.generator.recorded import RECORDED_LAWS
from gapscope.many.rehearse import Planned, put_in

SIZES = {
    "half the first": lambda one: one["half"] / 2,
    "0.5": lambda one: one["half"],
    "0.9": lambda one: one["nine_of_ten"],
    "twice the first": lambda one: 2 * one["half"],
}
"""Sizes that are put in, by what the table calls them."""


def diagnosed(case: Case, reference: Case | None) -> dict[str, Any]:
    """The document of a diagnosis, by one thread."""
    with threadpool_limits(1):
        return dict(gapscope.diagnose(case, against=reference).document)


def tried(
    case: Case, reference: Case | None, terms: int, rng: np.random.Generator
) -> Iterator[dict[str, Any]]:
    """Some effects at each size, and what is found of them."""
    before = diagnosed(case, reference)
    known = (before.get("against") or before)["expected"]
    asked = [
        e
        for e in known
        if e["effect"] in RECORDED_LAWS and e["nine_of_ten"] is not None
    ]
    for k in rng.permutation(len(asked))[:terms]:
        one = asked[k]
        joint, draws = sum(one["joints"]), int(rng.integers(2**31))
        for text, size in SIZES.items():
            law = RECORDED_LAWS[one["effect"]]
            planned = Planned(law, joint, "", abs(size(one)))
            after = diagnosed(put_in(case, planned, draws), reference)

            def hit(key: str, one: Any = one, after: Any = after) -> bool:
                places = [
                    e["joints"] for e in after[key] if e["effect"] == one["effect"]
                ]
                return any(set(one["joints"]) <= set(joints) for joints in places)

            row = {"case": case.name, **one, "size": text, "put_in": size(one)}
            yield row | {"named": hit("effects"), "possible": hit("possible")}


def cases(arguments: Any) -> Iterator[tuple[Case, Case | None]]:
    """The cases given, or pairs, each with its reference."""
    for path in arguments.cases:
        yield load_case(path), None
    against, robots = import_module("12_against"), arguments.robots.split(",")
    for k in range(arguments.pairs):
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            seed = (arguments.seed, k)
            against.make_pair(robots[k % len(robots)], False, seed, folder)
            yield load_case(folder / "case"), load_case(folder / "reference")


def main() -> None:
    """Try all cases and print the rates."""
    out = Path("out/smallest_sizes.json")
    parser = command_line(
        __doc__, terms=4, seed=1, pairs=0, robots="small,drawn", out=out
    )
    parser.add_argument("cases", nargs="*", type=Path)
    arguments = parser.parse_args()
    rng, rows = np.random.default_rng(arguments.seed), []
    for case, reference in cases(arguments):
        for row in tried(case, reference, arguments.terms, rng):
            rows.append(row)
            print(row, flush=True)
            write_json(rows, arguments.out)
    table = []
    for text in SIZES:
        own = [row for row in rows if row["size"] == text]
        named = sum(row["named"] for row in own)
        found = sum(row["named"] or row["possible"] for row in own)
        table.append([text, share_text(named, len(own)), share_text(found, len(own))])
    print(f"\n{markdown(('size', 'named', 'found'), table)}")


if __name__ == "__main__":
    main()
