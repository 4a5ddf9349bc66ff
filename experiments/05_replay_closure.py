"""How far the labelled effects close the replay gap of the sample cases: one table, per case and engine.

The cases come from another simulator, with LuGre friction, a sampled and clipped controller and a filtered velocity.
Columns: mean over the joints of the replay gap [mrad] without and with the effects, the share closed, the joint that
closes least of those with a gap above 0.3 mrad, and the time for both replays [s]. Give the folder of the cases.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from time import perf_counter

import numpy as np

from gapscope.arm.case import load_case
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.io.load_recording import load_recording
from gapscope.arm.nominal import NominalArm
from gapscope.effects.applied import AppliedEffect
from gapscope.envs.engines import ENGINES, installed
from gapscope.envs.replay import replay

CASES = tuple(f"case00{i}" for i in (0, 1, 2, 3, 4, 5, 7))
DAMPING_RATIO = 0.05
"""Of the elastic joint, whose damper the labels do not give."""
SEEN = 3e-4
"""Joints with a smaller gap than this are left out of the worst one [rad]."""


def labelled(label: dict, arm: NominalArm) -> tuple[AppliedEffect, ...]:
    """The effects of a label."""
    effects = []
    for entry in label["effects"]:
        values = {
            name: parameter["value"] for name, parameter in entry["parameters"].items()
        }
        if entry["effect"] == "joint_elasticity":
            joint = entry["joints"][0] - 1
            link = RigidBody(arm).mass_matrix(np.zeros(arm.n_joints))[joint, joint]
            inertia = 1 / (1 / link + 1 / arm.armature[joint])
            values["damping"] = [
                2 * DAMPING_RATIO * np.sqrt(values["stiffness"][0] * inertia)
            ]
        effects.append(AppliedEffect(entry["effect"], tuple(entry["joints"]), values))
    return tuple(effects)


def main(folder: Path) -> None:
    """Print the table."""
    labels = {
        label["case"]: label
        for label in json.loads((folder / "labels.json").read_text())
    }
    print(
        f"{'case':8} {'engine':9} {'before':>8} {'after':>8} {'closed':>7} {'least':>14} {'time':>5}"
    )
    for name in CASES:
        case = load_case(folder / name, read_recordings=False)
        recording = load_recording(folder / name / "recording_d.csv", case.arm)
        for engine in filter(installed, ENGINES):
            start = perf_counter()
            before, after = (
                1e3
                * replay(
                    case.arm, effects, recording, case.controller, engine=engine
                ).rmse
                for effects in ((), labelled(labels[name], case.arm))
            )
            closed = np.where(before > 1e3 * SEEN, 1 - after / before, np.inf)
            print(
                f"{name:8} {engine:9} {before.mean():8.3f} {after.mean():8.3f} {1 - after.mean() / before.mean():7.1%} "
                f"{closed.min():8.1%} (J{closed.argmin() + 1}) {perf_counter() - start:5.1f}"
            )


if __name__ == "__main__":
    main(
        Path(
            sys.argv[1]
            if len(sys.argv) > 1
            else Path(__file__).parents[2] / "shared/data/sample_cases"
        )
    )
