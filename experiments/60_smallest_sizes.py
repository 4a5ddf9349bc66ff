"""Are effects named at the sizes that a diagnosis states? Put into recordings, simulated and real.

A case is diagnosed as it is. Of every effect below, on the arm and on each joint that states a size, the torque of a
multiple of that size along the recorded motion is added to the recorded torque, and the case is diagnosed again. The
table counts how often the effect was named where it is, by the multiple of the size of probability one half, and how
often it was found there with a lesser probability.

    python experiments/60_smallest_sizes.py CASE... [--terms 4] [--multiples 0.5 0.8 1 1.25 2] [--seed 0]
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from common import command_line
from threadpoolctl import threadpool_limits

from gapscope.arm.case import Case, load_case
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.diagnosis.diagnose import SheetComparison, examine
from gapscope.diagnosis.selection.search import nameable
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected import CorrectedArm
from gapscope.model.conditioning import condition
from gapscope.model.expected import Detectable

ASKED = (
    "payload",
    "viscous_friction",
    "coulomb_friction",
    "parallel_spring",
    "torque_offset",
    "armature",
)
"""Effects that add a torque of their own to a recorded one."""


def with_effect(case: Case, effect: AppliedEffect) -> Case:
    """The case with the torque of an effect in its recordings, judged ones too."""
    body = RigidBody(case.arm)

    def changed(recording):
        torque = recording.tau.copy()
        for segment in condition(recording):
            laden, motion = segment.bodies(body), segment.motion
            added = CorrectedArm(case.arm, (effect,)).predict(laden, motion)
            added = added - CorrectedArm(case.arm).predict(laden, motion)
            inside = (recording.t >= motion.t[0]) & (recording.t <= motion.t[-1])
            for j, column in enumerate(added.T):
                torque[inside, j] += np.interp(recording.t[inside], motion.t, column)
        return replace(recording, tau=torque)

    return replace(
        case,
        recordings=tuple(map(changed, case.recordings)),
        judged=tuple(map(changed, case.judged)),
    )


def places(effects: tuple[AppliedEffect, ...], name: str) -> set[int]:
    """Joints on which an effect is among others, 0 for the arm."""
    joints = [effect.joints or (0,) for effect in effects if effect.name == name]
    return {joint for some in joints for joint in some}


def tried(
    found: SheetComparison, one: Detectable, multiples: list[float]
) -> Iterator[dict[str, object]]:
    """A term at some sizes."""
    terms, term = found.terms, one.term
    for multiple in multiples:
        theta = np.zeros(terms.size)
        theta[term.columns[0]] = multiple * one.half
        (effect,) = terms.effects(theta, [term])
        with threadpool_limits(1):
            again = examine(with_effect(found.case, effect))
            possible = tuple(map(again.change, again.possible))
        yield {
            "case": found.case.name,
            "effect": term.effect,
            "joint": term.joint,
            "multiple": multiple,
            "nine_of_ten": one.most / one.half,
            "named": term.joint in places(again.effects, term.effect),
            "possible": term.joint in places(possible, term.effect),
            "instead": sorted(
                {e.name for e in again.effects} - {e.name for e in found.effects}
            ),
        }


def main() -> None:
    """Try all cases and print the rates."""
    parser = command_line(__doc__, terms=4, seed=0)
    parser.add_argument("cases", nargs="+", type=Path)
    parser.add_argument("--multiples", type=float, nargs="+")
    arguments = parser.parse_args()
    multiples = arguments.multiples or [0.5, 0.8, 1.0, 1.25, 2.0]
    rng = np.random.default_rng(arguments.seed)
    rows, file = [], Path("out/smallest_sizes.jsonl")
    file.parent.mkdir(exist_ok=True)
    for path in arguments.cases:
        case = load_case(path)
        with threadpool_limits(1):
            here = examine(case)
        asked = [
            one
            for one in nameable(here.difference)
            if one.term.effect in ASKED and np.isfinite(one.half)
        ]
        for k in rng.permutation(len(asked))[: arguments.terms]:
            for row in tried(here, asked[k], multiples):
                rows.append(row)
                with file.open("a", encoding="utf-8") as out:
                    print(json.dumps(row), file=out)
                print(json.dumps(row), flush=True)
    for multiple in multiples:
        mine = [row for row in rows if row["multiple"] == multiple]
        named = sum(bool(row["named"]) for row in mine)
        found_at_all = sum(bool(row["named"] or row["possible"]) for row in mine)
        print(f"{multiple:5g}: named {named}, found {found_at_all} of {len(mine)}")


if __name__ == "__main__":
    main()
