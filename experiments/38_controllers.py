"""Control laws: an arm recorded under each, its torque taken away, and diagnosed from positions and commands.

    .venv/bin/python experiments/38_controllers.py --out out/controllers

A KUKA iiwa of PyBullet follows three motions under each law with gains of the same bandwidth (4 Hz), healthy and with
one effect. The torque column is dropped, so that the diagnosis works with the torque that the law must have
commanded. Simulator and diagnosis share the laws and the effects' formulas: a recovery check. Printed for each law:
what was found with its value, the replay gap before and after, and the gain margin of the loop, the smallest factor on
its gains at which a mode is unstable at a posture of the motions, with torque one period late. A run that was
interrupted goes on.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import brentq

import gapscope
from gapscope.arm.control.laws import LAWS
from gapscope.arm.controller import Controller
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.io.json_file import read_json, write_json
from gapscope.arm.velocity_filter import filter_gains
from gapscope.effects.applied import AppliedEffect
from gapscope.envs.mystery_arm import iiwa
from gapscope.envs.position_controller import SampledLoop
from gapscope.envs.recorder import Plan, record_case

EFFECTS: dict[str, tuple[AppliedEffect, ...]] = {
    "healthy": (),
    "payload": (AppliedEffect("payload", (), {"mass": 2.0, "com": [0.0, 0.0, 0.08]}),),
    "coulomb_friction": (AppliedEffect("coulomb_friction", (2,), {"torque": [4.0]}),),
}
"""What the arm has beyond its data sheet."""
PLAN = Plan(recordings=3, duration=8.0, engine="pybullet")
POSTURES = 40
"""Postures of the motions at which the margin is taken, evenly spread."""


def gain_margin(controller: Controller, postures: np.ndarray) -> float:
    """Smallest factor on all gains at which a mode of the loop is unstable, torque one period late [1]."""
    arm = iiwa()
    body = RigidBody(arm)
    masses = [body.mass_matrix(q) + np.diag(arm.armature) for q in postures]
    estimate = filter_gains(
        controller.rate, controller.velocity_cutoff, controller.velocity_damping
    )

    def growth(log_factor: float) -> float:
        scaled = {
            gain.name: np.exp(log_factor) * getattr(controller, gain.name)
            for gain in controller.gains
        }
        # a cascade's torque is the product of two of its gains
        if controller.kind == "cascade":
            scaled["kp"] = controller.kp  # type: ignore[attr-defined]
        law = replace(controller, **scaled)
        loop = SampledLoop(law, 1.0 / law.rate, estimate, late=1)
        return max(loop.spectral_radius(m, arm.viscous) for m in masses) - 1.0

    return float(np.exp(brentq(growth, 0.0, np.log(100.0), rtol=1e-3)))


def diagnosed(kind: str, label: str, file: Path) -> None:
    """Record and diagnose one arm under one law, unless that was done."""
    if file.exists():
        return
    rng = np.random.default_rng(38)
    case = record_case(label, iiwa(), EFFECTS[label], PLAN, rng, controller=kind)
    assert isinstance(case.controller, Controller)
    references = np.vstack([r.q_ref for r in case.recordings if r.q_ref is not None])
    chosen = np.linspace(0, len(references) - 1, POSTURES).astype(int)
    bare = tuple(replace(r, tau=None) for r in case.recordings)
    document = gapscope.diagnose(replace(case, recordings=bare)).document
    content = {
        "law": kind,
        "case": label,
        "margin": gain_margin(case.controller, references[chosen]),
        "verdict": document["verdict"],
        "effects": document["effects"],
        "possible": [e["effect"] for e in document["possible"]],
        "replay": [
            document["gap"][stage]["replay_rmse"] for stage in ("before", "after")
        ],
    }
    write_json(content, file)
    print(line(content), flush=True)


def line(content: dict[str, Any]) -> str:
    """One row of the table."""
    found = []
    for effect in content["effects"]:
        joints = "".join(f" J{j}" for j in effect["joints"])
        first = next(iter(effect["parameters"].values()))
        value = np.round(np.atleast_1d(first["value"]), 3).tolist()
        found.append(f"{effect['effect']}{joints} {value} {first['unit']}")
    before, after = (np.mean(gap) * 1e3 if gap else np.nan for gap in content["replay"])
    words = "; ".join(found) or content["verdict"]
    return (
        f"| {content['law']} | {content['case']} | {words} | {before:.3f} | {after:.3f} "
        f"| {content['margin']:.1f} |"
    )


def main() -> None:
    """Diagnose all cases and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("out/controllers"))
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    files = {
        (kind, label): args.out / f"{kind}_{label}.json"
        for kind in LAWS
        for label in EFFECTS
    }
    for (kind, label), file in files.items():
        diagnosed(kind, label, file)
    print("| law | arm | found | replay before [mrad] | after [mrad] | gain margin |")
    print("|---|---|---|---|---|---|")
    for file in files.values():
        print(line(read_json(file, "remove it")))


if __name__ == "__main__":
    main()
