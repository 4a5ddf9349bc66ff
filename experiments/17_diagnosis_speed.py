"""What a diagnosis costs: time per stage and peak memory on 3 recordings, 60 s in all at 500 Hz, of 7 joints.

    .venv/bin/python experiments/17_diagnosis_speed.py [--out out/speed]

The arm is a simulated KUKA iiwa with Coulomb friction on two joints and a payload; in a second case a joint rings.
Prints a Markdown table of wall-clock and processor time; on a machine that does other work the former means little.
"""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import yaml

from gapscope.arm.case import load_case
from gapscope.diagnosis.diagnose import diagnose

CASES = {
    "friction and payload": [
        {
            "effect": "coulomb_friction",
            "joints": [2, 4],
            "parameters": {"torque": [4.0, 2.0]},
        },
        {"effect": "payload", "parameters": {"mass": 1.0, "com": [0.0, 0.0, 0.08]}},
    ],
    "a joint that rings, friction": [
        {
            "effect": "coulomb_friction",
            "joints": [2, 4],
            "parameters": {"torque": [4.0, 2.0]},
        },
        {
            "effect": "joint_elasticity",
            "joints": [2],
            "parameters": {"stiffness": [6000.0], "damping": [8.0]},
        },
        {"effect": "armature", "joints": [2], "parameters": {"inertia": [0.5]}},
    ],
}


class Stages:
    """Wall-clock and processor time [s] of each stage that a diagnosis tells of."""

    def __init__(self) -> None:
        self.spent: dict[str, tuple[float, float]] = {}
        self._name, self._wall, self._cpu = (
            "reads the case",
            time.perf_counter(),
            time.process_time(),
        )

    def __call__(self, message: str) -> None:
        """End a stage and begin the next; what a search adds belongs to the search."""
        if message.startswith(("adds ", "finds ")):
            return
        wall, cpu = time.perf_counter(), time.process_time()
        before = self.spent.get(self._name, (0.0, 0.0))
        self.spent[self._name] = (
            before[0] + wall - self._wall,
            before[1] + cpu - self._cpu,
        )
        self._name, self._wall, self._cpu = message, wall, cpu


def recorded(name: str, out: Path) -> Path:
    """The case, recorded if it is not there yet."""
    folder = out / name.replace(" ", "_").replace(",", "")
    if not (folder / "case.yaml").is_file():
        out.mkdir(parents=True, exist_ok=True)
        effects = out / f"{folder.name}.yaml"
        effects.write_text(
            yaml.safe_dump({"schema": 1, "effects": CASES[name]}), encoding="utf-8"
        )
        options = [
            "--recordings",
            "3",
            "--duration",
            "20",
            "--rate",
            "500",
            "--encoder-noise",
            "2e-5",
            "--seed",
            "1",
        ]
        command = [
            sys.executable,
            "-m",
            "gapscope",
            "record",
            "kuka_iiwa",
            "--effects",
            str(effects),
            *options,
        ]
        subprocess.run(
            [
                *command,
                "--out",
                str(folder),
                "--sealed",
                str(out / "truth" / folder.name),
            ],
            check=True,
        )
    return folder


@contextmanager
def measured() -> Iterator[Stages]:
    """Stages until the end of the block."""
    stages = Stages()
    yield stages
    stages("")


def main() -> None:
    """Record, diagnose, print."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--out", type=Path, default=Path("out/speed"))
    out = parser.parse_args().out
    for name in CASES:
        folder = recorded(name, out)
        with measured() as stages:
            result = diagnose(load_case(folder), stages)
        named = ", ".join(
            f"{e['effect']} {e['joints']}" for e in result.document["effects"]
        )
        print(
            f"\n{name}: {result.document['verdict']}, {named}\n\n| stage | wall [s] | processor [s] |\n|---|---|---|"
        )
        for stage, (wall, cpu) in stages.spent.items():
            print(f"| {stage} | {wall:.1f} | {cpu:.1f} |")
        total = [sum(x) for x in zip(*stages.spent.values(), strict=True)]
        print(f"| **all** | **{total[0]:.1f}** | **{total[1]:.1f}** |")
    print(
        f"\npeak memory {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20:.2f} GiB"
    )


if __name__ == "__main__":
    main()
