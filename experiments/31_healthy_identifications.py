"""Healthy arms, identified: how often a warning cries wolf.

    .venv/bin/python experiments/31_healthy_identifications.py --out out/healthy --count 100 --jobs 2

Half of the arms are recorded in PyBullet and MuJoCo without any effect, with the data sheets of the mystery arm or
none, and noise of 0 to 3 % of the torque and 0 to 20 urad of the encoders; half are healthy cases of the blind check's
generator, whose friction is not the model's and whose nominal inertials are up to 10 % off. Each is identified with the
default settings. Printed: for each kind of warning the number of arms that got it. Of the warnings, those that say that
the arm or the data has something that it has not are false; advice on more data and on files is not counted. A run that
was interrupted goes on.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
from joblib import Parallel, delayed
from threadpoolctl import threadpool_limits

import gapscope
from gapscope.arm.case import Case, load_case
from gapscope.arm.errors import GapscopeError
from gapscope.arm.io.json_file import read_json, write_json
from gapscope.arm.known_robots import KNOWN_ROBOTS
from gapscope.arm.robots import load_nominal_arm
from gapscope.blind_check.make import make
from gapscope.blind_check.plan import BlindPlan
from gapscope.envs.mystery_arm import iiwa
from gapscope.envs.recorder import Plan, record_case

ENGINES = ("pybullet", "mujoco")
NOISES = ((0.0, 0.0), (0.003, 2e-6), (0.01, 1e-5), (0.03, 2e-5))
"""Noise of the torque over its deviation [1] and of the encoders [rad]."""
ADVICE = ("independent samples", "cannot express", "rests in every", "are advised")
"""What a warning says that asks for more data or tells what a file cannot hold: no claim about the arm."""


def own_case(seed: int) -> Case:
    """A healthy arm of our own simulators."""
    rng = np.random.default_rng(seed)
    names = (*KNOWN_ROBOTS, "mystery")
    name = names[seed % len(names)]
    arm = iiwa() if name == "mystery" else load_nominal_arm(name)
    noise, encoder_noise = NOISES[seed % 4 if seed % 3 else rng.integers(4)]
    engine = ENGINES[seed % 2]
    plan = Plan(noise=noise, encoder_noise=encoder_noise, engine=engine)
    return record_case(f"{name}_{seed}", arm, (), plan, rng)


def identified(name: str, source: int | Path, out: Path) -> None:
    """Identify one arm and keep its warnings, unless that was done."""
    file = out / f"{name}.json"
    if file.exists():
        return
    begin = time.process_time()
    with threadpool_limits(1):
        try:
            case = own_case(source) if isinstance(source, int) else load_case(source)
            found = list(gapscope.identify(case).identification.warnings)
        except GapscopeError as error:
            found = [f"ERROR: {error}"]
    seconds = time.process_time() - begin
    write_json({"case": name, "warnings": found, "seconds": seconds}, file)
    print(f"{name}: {len(found)} warnings, {seconds:.0f} s", flush=True)


def kind(warning: str) -> str:
    """The warning without its numbers, shortened."""
    words = [word for word in warning.split() if not any(c.isdigit() for c in word)]
    return " ".join(words[:9])


def show(results: list[dict[str, Any]]) -> None:
    """Print how many arms got each kind of warning."""
    counts: Counter[str] = Counter()
    false = 0
    for result in results:
        claims = {
            kind(w) for w in result["warnings"] if not any(a in w for a in ADVICE)
        }
        counts.update(claims)
        false += bool(claims)
    print(f"{false} of {len(results)} healthy arms got a warning that is no advice")
    print(f"CPU time, median {np.median([r['seconds'] for r in results]):.0f} s")
    for words, count in counts.most_common():
        print(f"{count:4d}  {words}")


def main() -> None:
    """Make the arms, identify them, print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("out/healthy"))
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--jobs", type=int, default=1)
    args = parser.parse_args()
    half = args.count // 2
    counts = dict.fromkeys(("singles", "pairs", "triples", "outside", "ladder"), 0)
    plan = BlindPlan(healthy=half, **counts)
    cases = args.out / "cases"
    make(cases, plan, seed=31, labels=args.out / "labels", jobs=args.jobs)
    sources: dict[str, int | Path] = {f"own{k:03d}": k for k in range(half)}
    sources |= {path.name: path for path in sorted(cases.glob("case*"))}
    results = args.out / "results"
    results.mkdir(parents=True, exist_ok=True)
    Parallel(args.jobs)(
        delayed(identified)(name, source, results) for name, source in sources.items()
    )
    show([read_json(f, "remove it") for f in sorted(results.glob("*.json"))])


if __name__ == "__main__":
    main()
