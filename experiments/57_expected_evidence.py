"""Are effects named as often as the sizes say at which they would be?

    .venv/bin/python experiments/57_expected_evidence.py --seconds 600 [--robots small,drawn] [--seed 1] [--out FILE]

Unchanged pairs of ``12_against.py``, each diagnosed once: ``against.expected`` says how large each effect would have to
be to be named with a probability of 0.5 and of 0.9. Then a torque offset, a torque scale and Coulomb friction of a
joint, drawn, are put into the recordings of the case at half the first size, at it, at the second and at twice the
first, with either sign, and diagnosed again. The table has a row for each size: the share named on the joint where it
was put in. This is a recovery check: what is put in follows the laws that are looked for.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from gapscope.arm.case import Case, load_case
from gapscope.arm.io.json_file import write_json
from gapscope.arm.nominal import smooth_sign
from gapscope.arm.recording import Recording
from gapscope.blind_check.scoring.statistics import wilson
from gapscope.diagnosis.reference.diagnose_change import diagnose_change
from gapscope.diagnosis.reference.identify_reference import identify_reference
from gapscope.model.conditioning import condition, position_cutoff

pairs = import_module("12_against")
SIZES = {
    "half the first": lambda one: one["half"] / 2,
    "0.5": lambda one: one["half"],
    "0.9": lambda one: one["nine_of_ten"],
    "twice the first": lambda one: 2 * one["half"],
}
"""Sizes that are put in, by what the table calls them."""
EFFECTS = ("torque_offset", "torque_scale", "coulomb_friction")


def velocity(recording: Recording) -> np.ndarray:
    """Velocity at every sample [rad/s], (N, n)."""
    out = np.zeros_like(recording.q)
    for segment in condition(recording, position_cutoff((recording,))):
        inside = (recording.t >= segment.motion.t[0]) & (
            recording.t <= segment.motion.t[-1]
        )
        for j, column in enumerate(segment.motion.dq.T):
            out[inside, j] = np.interp(recording.t[inside], segment.motion.t, column)
    return out


def changed(recording: Recording, effect: str, joint: int, size: float) -> Recording:
    """A recording with an effect of a joint, from 1."""
    tau, j = np.array(recording.tau), joint - 1
    if effect == "torque_offset":
        tau[:, j] -= size
    elif effect == "torque_scale":
        tau[:, j] /= 1.0 + size
    else:
        tau[:, j] += size * smooth_sign(velocity(recording))[:, j]
    return replace(recording, tau=tau)


def named(case: Case, reference: Any) -> list[tuple[str, list[int]]]:
    """What a comparison names."""
    with tempfile.TemporaryDirectory() as folder:
        change = diagnose_change(case, reference, Path(folder))
    effects = change.diagnosis.document["effects"]
    return [(effect["effect"], effect["joints"]) for effect in effects]


def of_pair(robot: str, seed: tuple[int, ...]) -> list[dict[str, Any]]:
    """A pair, and what is named of each effect and size that is put in."""
    rng, rows = np.random.default_rng(seed), []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        pairs.make_pair(robot, False, seed, folder)
        reference = identify_reference(load_case(folder / "reference"))
        case = load_case(folder / "case")
        change = diagnose_change(case, reference, folder)
        expected = change.diagnosis.document["against"]["expected"]
        for effect in EFFECTS:
            joint = int(rng.integers(case.arm.n_joints)) + 1
            sign = -1.0 if effect != "coulomb_friction" and rng.random() < 0.5 else 1.0
            key = (effect, [joint])
            one = next(e for e in expected if (e["effect"], e["joints"]) == key)
            if one["nine_of_ten"] is None:
                continue
            for text, size in SIZES.items():
                put_in = sign * size(one)
                recordings = tuple(
                    changed(r, effect, joint, put_in) for r in case.recordings
                )
                found = named(replace(case, recordings=recordings), reference)
                hit = any(e == effect and joint in joints for e, joints in found)
                rows.append(
                    {
                        "robot": robot,
                        "seed": list(seed),
                        "effect": effect,
                        "joint": joint,
                        "size": text,
                        "value": put_in,
                        "named": hit,
                        "first": bool(found) and found[0][0] == effect,
                        "found": found,
                    }
                )
    return rows


def show(rows: list[dict[str, Any]]) -> None:
    """Print the figures as a Markdown table."""
    print("\n| size | of | named | 95 % interval | " + " | ".join(EFFECTS) + " |")
    print("|---|---|---|---|" + "---|" * len(EFFECTS))
    for text in SIZES:
        mine = [r for r in rows if r["size"] == text]
        if not mine:
            continue
        hits = sum(r["named"] for r in mine)
        low, high = wilson(hits, len(mine))
        parts = []
        for effect in EFFECTS:
            own = [r["named"] for r in mine if r["effect"] == effect]
            parts.append(f"{sum(own)} of {len(own)}")
        print(
            f"| {text} | {len(mine)} | {hits} ({100 * hits / len(mine):.0f} %) | "
            f"{100 * low:.0f} to {100 * high:.0f} % | {' | '.join(parts)} |"
        )


def main() -> None:
    """Make pairs and put effects in until the time is up."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seconds", type=float, default=600.0)
    parser.add_argument("--robots", default="small")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    robots = arguments.robots.split(",")
    rows: list[dict[str, Any]] = []
    end, k = time.perf_counter() + arguments.seconds, 0
    while time.perf_counter() < end:
        rows += of_pair(robots[k % len(robots)], (arguments.seed, k))
        k += 1
        print(f"{k} pairs, {len(rows)} diagnoses", flush=True)
        if arguments.out:
            write_json(rows, arguments.out)
    show(rows)


if __name__ == "__main__":
    main()
