"""Pairs of a healthy reference and a case of the same arm: false alarms on unchanged arms, and loads found.

    .venv/bin/python experiments/12_against.py --seconds 720 [--robots small,drawn] [--seed 1] [--out FILE.json]

The arms are those of the blind check: MuJoCo bodies, LuGre friction, quantised noisy encoders, a sampled controller.
The believed URDF is a poor one, its inertials 10 to 30 % off, and its data sheet has no friction. The reference has
three recordings: slow, faster, and point to point or a crawl; the case two others, of another kind and another draw.
From one day to the other Coulomb and viscous friction of every joint change by up to +-12 %, each on its own. Two pairs
in three are unchanged otherwise, the third carries a load in the case.

How many: with no false alarm among n unchanged pairs Wilson's interval ends at 3.8 / (n + 3.8), so that 73 without one
bound the rate by 5 %, and 100 with two by 7 %. Pairs are made until the time is up, each from a seed of its own.
"""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from common import command_line, markdown, share_text
from generator_arms import recorded, write_side

from gapscope.arm.case import load_case
from gapscope.arm.errors import GapscopeError
from gapscope.arm.io.json_file import write_json
from gapscope.blind_check.generator.case import draw_setup
from gapscope.blind_check.generator.laws import LAWS
from gapscope.blind_check.generator.simulate import Conditions
from gapscope.diagnosis.diagnose_change import diagnose_change, identify_reference

DAY = 0.12
"""Change of friction from day to day, at most [1]."""
REFERENCE, CASE = (0, 1, 2), (3, -1)
"""Motions of a bench with four recordings and a held-out one that are recorded on either day."""


def make_pair(
    robot: str, loaded: bool, seed: tuple[int, ...], folder: Path
) -> dict[str, Any]:
    """Write ``reference`` and ``case`` into a folder; the label of the load, empty if there is none."""
    rng = np.random.default_rng(seed)
    perturb_inertials = float(rng.uniform(0.1, 0.3))
    conditions = Conditions(
        robot,
        inertials_off=perturb_inertials,
        rate=250,
        loop_rate=500,
        recordings=4,
        duration=(8.0, 12.0),
    )
    for _ in range(40):
        setup = draw_setup(conditions, rng)
        if setup is None:
            continue
        none = np.array([], dtype=int)
        causes = [LAWS["payload"].cause(rng, setup, none)] if loaded else []
        healthy, today = setup.plant(()), setup.plant(causes)
        for name in ("coulomb", "viscous"):
            today.values[name] = today.values[name] * (
                1.0 + rng.uniform(-DAY, DAY, setup.arm.n)
            )
        before, after = (
            recorded(setup, healthy, REFERENCE),
            recorded(setup, today, CASE),
        )
        if before is None or after is None:
            continue
        write_side(setup, before, folder / "reference", bare=False)
        write_side(setup, after, folder / "case", bare=False)
        return causes[0].label()["parameters"] if causes else {}
    raise GapscopeError(f"no pair of {robot} came about", "draw from another seed")


def judged(robot: str, loaded: bool, seed: tuple[int, ...]) -> dict[str, Any]:
    """One pair, made and diagnosed."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        truth = make_pair(robot, loaded, seed, folder)
        started = time.perf_counter()
        reference = identify_reference(load_case(folder / "reference"))
        change = diagnose_change(load_case(folder / "case"), reference, folder)
        document = change.diagnosis.document
    found = {effect["effect"]: effect["parameters"] for effect in document["effects"]}
    out = {
        "robot": robot,
        "seed": list(seed),
        "loaded": loaded,
        "verdict": document["verdict"],
        "effects": sorted(found),
        "seconds": time.perf_counter() - started,
        "inertials": document["against"]["torque_ratio_to_nominal"],
    }
    if loaded:
        mass = truth["mass"]["value"]
        out["mass"] = mass
        if "payload" in found:
            value = found["payload"]["mass"]
            out["error"] = value["value"] / mass - 1.0
            out["deviations"] = (value["value"] - mass) / max(value["std"], 1e-9)
            com = np.array(found["payload"]["com"]["value"]) - np.array(
                truth["com"]["value"]
            )
            out["com_error"] = float(np.linalg.norm(com))
    return out


def show_pairs(pairs: list[dict[str, Any]]) -> None:
    """Print the figures as a Markdown table."""
    same, loaded = ([r for r in pairs if r["loaded"] is x] for x in (False, True))
    named = [r for r in loaded if "payload" in r["effects"]]
    error = np.abs([r["error"] for r in named])
    figures = {
        "unchanged: an effect named": [bool(r["effects"]) for r in same],
        "unchanged: `unexplained`": [r["verdict"] == "unexplained" for r in same],
        "load found": ["payload" in r["effects"] for r in loaded],
        "load found, nothing else": [r["effects"] == ["payload"] for r in loaded],
        "mass within 5 %": [abs(r.get("error", 1.0)) < 0.05 for r in loaded],
        "mass within two deviations": [abs(r["deviations"]) < 2 for r in named],
    }
    rows = [(text, share_text(sum(x), len(x))) for text, x in figures.items() if x]
    print(f"\n{markdown(('', 'cases'), rows)}")
    if named:
        com = 1e3 * np.array([r["com_error"] for r in named])
        off = (
            f"median {100 * np.median(error):.2f} %, largest {100 * error.max():.1f} %"
        )
        print(f"\nmass error: {off}; ", end="")
        print(f"centre: median {np.median(com):.1f} mm, largest {com.max():.0f} mm")
    print(f"seconds per pair: median {np.median([r['seconds'] for r in pairs]):.1f}")
    for r in pairs:
        right = r["effects"] == ["payload"] if r["loaded"] else r["verdict"] == "no_gap"
        if not right:
            where = f"{r['robot']} {r['seed']}: loaded {r['loaded']}"
            print(f"{where}, {r['verdict']}, {', '.join(r['effects'])}")


def main() -> None:
    """Make and diagnose pairs until the time is up."""
    arguments = command_line(
        __doc__, seconds=720.0, robots="small", seed=1, out=Path
    ).parse_args()
    robots = arguments.robots.split(",")
    rows = []
    end, k = time.perf_counter() + arguments.seconds, 0
    while time.perf_counter() < end:
        seed = (arguments.seed, k)
        rows.append(judged(robots[k // 3 % len(robots)], k % 3 == 2, seed))
        print(f"{k}: {rows[-1]}", flush=True)
        if arguments.out:
            write_json(rows, arguments.out)
        k += 1
    show_pairs(rows)


if __name__ == "__main__":
    main()
