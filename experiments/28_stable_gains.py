"""Healthy arms that stay stable: named robots, recorded without any effect.

    .venv/bin/python experiments/28_stable_gains.py [--data FOLDER] [--seeds 10] [--robots kuka_iiwa,ur5]
        [--out out/stable_gains.json]

Each robot is recorded as `gapscope record ROBOT` does without a data sheet: four Fourier motions of 10 s from slow to
fast, PD with nominal feedforward at 4 Hz and 1 kHz, a velocity filter of 80 Hz, PyBullet. Twice per seed: with gains on
the joints' own inertia at one posture, M_ii, and with those of `gapscope.envs.position_controller`, which hold along
the whole motion. The table counts the seeds in which an arm diverged, and shows for the first seed the stiffest mode
lambda of M(q)^-1 D along the motions (kp = w^2 D), the joint whose gains were lowered most, and the tracking error.
Then the stiffest mode of the Panda, and the demonstration of `gapscope.agents.instability_demo`; `--robots ""` prints
these alone.

The first three robots come with PyBullet, two with the blind check; the others with `example-robot-data` 6.0.0
(`pip install --no-deps --target FOLDER example-robot-data`), whose folder is given by `--data`.
"""

from __future__ import annotations

import argparse
import tempfile
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from gapscope.agents.instability_demo import run_instability_demo
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import GapscopeError
from gapscope.arm.io.json_file import write_json
from gapscope.arm.known_robots import KNOWN_ROBOTS
from gapscope.arm.motions.named_motions import workspace
from gapscope.arm.nominal import NominalArm
from gapscope.arm.robots import load_nominal_arm
from gapscope.blind_check.generator.arms import DH, draw_arm
from gapscope.envs.mystery_arm import iiwa
from gapscope.envs.position_controller import (
    GAIN_MARGIN,
    pd_gains,
    position_controller,
    stiffest_mode,
)
from gapscope.envs.recorder import Plan, record_case

BANDWIDTH = 4.0
"""Of the loop [Hz]."""
SHARE = Path("cmeel.prefix/share/example-robot-data/robots")


def numbered(pattern: str, count: int) -> list[str]:
    """Names of joints 1 to ``count``."""
    return [pattern.format(joint) for joint in range(1, count + 1)]


PR2 = "shoulder_pan shoulder_lift upper_arm_roll elbow_flex forearm_roll wrist_flex wrist_roll"
ROMEO = "ShoulderPitch ShoulderYaw ElbowRoll ElbowYaw WristRoll WristYaw WristPitch"
G1 = "shoulder_pitch shoulder_roll shoulder_yaw elbow wrist_roll wrist_pitch wrist_yaw"
FILES: dict[str, tuple[str, list[str] | None]] = {
    "ur3": ("ur_description/urdf/ur3_robot.urdf", None),
    "ur5": ("ur_description/urdf/ur5_robot.urdf", None),
    "ur10": ("ur_description/urdf/ur10_robot.urdf", None),
    "kinova_j2s6s200": ("kinova_description/robots/kinova.urdf", None),
    "xarm7": ("xarm_description/urdf/xarm7.urdf", None),
    "unitree_z1": ("z1_description/urdf/z1.urdf", numbered("joint{}", 6)),
    "so100": ("so_arm_description/urdf/so100.urdf", None),
    "so101": ("so_arm_description/urdf/so101.urdf", None),
    "talos": ("talos_data/robots/talos_full_v2.urdf", numbered("arm_left_{}_joint", 7)),
    "tiago_pro": (
        "tiago_pro_description/robots/tiago_pro.urdf",
        numbered("arm_left_{}_joint", 7),
    ),
    "baxter": (
        "baxter_description/urdf/baxter.urdf",
        [f"left_{name}" for name in ("s0", "s1", "e0", "e1", "w0", "w1", "w2")],
    ),
    "pr2": (
        "pr2_description/urdf/pr2.urdf",
        [f"r_{name}_joint" for name in PR2.split()],
    ),
    "romeo": (
        "romeo_description/urdf/romeo.urdf",
        [f"L{name}" for name in ROMEO.split()],
    ),
    "centauro": ("centauro_description/urdf/centauro.urdf", numbered("j_arm1_{}", 6)),
    "g1": (
        "g1_description/urdf/g1_29dof_rev_1_0.urdf",
        [f"left_{name}_joint" for name in G1.split()],
    ),
}
"""Arms of example-robot-data: file, and the joints of the arm on a larger robot, whose other joints are locked."""


def load(name: str, data: Path | None, folder: Path) -> NominalArm:
    """A robot without a data sheet; a model of the blind check is written to the folder."""
    if name in KNOWN_ROBOTS:
        return load_nominal_arm(name)
    if name in DH:
        file = folder / f"{name}.urdf"
        file.write_text(draw_arm(name, np.random.default_rng(0)).urdf, encoding="utf-8")
        return load_nominal_arm(file)
    if data is None:
        raise SystemExit(
            f"{name} needs --data FOLDER, see {Path(__file__).name} --help"
        )
    file, joints = FILES[name]
    return load_nominal_arm(data / SHARE / file, joints=joints)


def recorded(arm: NominalArm, seed: int, whole_motion: bool) -> Any:
    """The case of a seed; ``None`` if the arm diverged."""
    controller = None
    if not whole_motion:
        posture = workspace(RigidBody(arm)).posture
        own = np.diag(RigidBody(arm).mass_matrix(posture)) + arm.armature
        gains = pd_gains(own, BANDWIDTH)
        usual = position_controller(arm, posture, BANDWIDTH)
        controller = replace(usual, **gains._asdict())
    rng = np.random.default_rng(seed)
    try:
        return record_case(arm.name, arm, (), Plan(), rng, controller=controller)
    except GapscopeError as error:
        print(f"  {arm.name}, seed {seed}: {error.message}", flush=True)
        return None


def stiffest(arm: NominalArm, case: Any, kp: np.ndarray) -> float:
    """Largest eigenvalue of M^-1 D along the recordings [1], D = kp / w^2."""
    body, root = RigidBody(arm), np.sqrt(kp) / (2 * np.pi * BANDWIDTH)
    found = []
    for recording in case.recordings:
        for q in recording.q_ref[::25]:
            inverse = np.linalg.inv(body.mass_matrix(q) + np.diag(arm.armature))
            found.append(np.linalg.eigvalsh(root[:, None] * inverse * root)[-1])
    return float(max(found))


def measured(name: str, arm: NominalArm, seeds: int) -> dict[str, Any]:
    """One row of the table."""
    body = RigidBody(arm)
    own = np.diag(body.mass_matrix(workspace(body).posture)) + arm.armature
    one_posture = pd_gains(own, BANDWIDTH).kp
    before = sum(recorded(arm, seed, False) is None for seed in range(seeds))
    cases = [recorded(arm, seed, True) for seed in range(seeds)]
    done = [case for case in cases if case is not None]
    row: dict[str, Any] = {"robot": name, "joints": arm.n_joints, "seeds": seeds}
    row |= {"diverged_one_posture": before, "diverged": seeds - len(done)}
    if done:
        kp = [case.controller.kp for case in done]
        errors = [
            np.sqrt(np.mean((recording.q_ref - recording.q) ** 2))
            for case in done
            for recording in case.recordings
        ]
        row |= {
            "mode_one_posture": stiffest(arm, done[0], one_posture),
            "mode": stiffest(arm, done[0], kp[0]),
            "least_kp_share": float((kp[0] / one_posture).min()),
            "joint": int((kp[0] / one_posture).argmin()) + 1,
            "error": float(np.median(errors)),
            "largest_error": float(max(errors)),
        }
    return row


def show(rows: list[dict[str, Any]]) -> None:
    """Print the table as Markdown."""
    print(f"\nallowed: lambda {stiffest_mode(BANDWIDTH):.2f}\n")
    print(
        "| robot | joints | diverged, gains of one posture | of the whole motion | lambda, one posture | whole motion "
        "| kp left at least | joint error, median [mrad] | largest |"
    )
    print("|" + "---|" * 9)
    for row in rows:
        texts = [row["robot"], str(row["joints"])]
        texts += [
            f"{row[key]} of {row['seeds']}"
            for key in ("diverged_one_posture", "diverged")
        ]
        if "mode" in row:
            texts += [f"{row[key]:.3g}" for key in ("mode_one_posture", "mode")]
            texts += [f"{100 * row['least_kp_share']:.3g} % (joint {row['joint']})"]
            texts += [f"{1e3 * row[key]:.2g}" for key in ("error", "largest_error")]
        print(f"| {' | '.join(texts)} |")


def show_mode() -> None:
    """Print the stiffest mode of the Panda's first session, with gains on the own inertia at the working posture."""
    arm = load_nominal_arm("franka_panda")
    body, case = RigidBody(arm), recorded(arm, 0, True)
    own = np.diag(body.mass_matrix(workspace(body).posture)) + arm.armature
    postures = np.vstack([recording.q_ref[::12] for recording in case.recordings])
    masses = np.array([body.mass_matrix(q) for q in postures]) + np.diag(arm.armature)
    inverses, root = np.linalg.inv(masses), np.sqrt(own)
    values, vectors = np.linalg.eigh(root[:, None] * inverses * root)
    worst = int(values[:, -1].argmax())
    mode = vectors[worst, :, -1] / root
    least = 1.0 / np.diagonal(inverses, axis1=1, axis2=2).max(axis=0)
    bears = GAIN_MARGIN * stiffest_mode(BANDWIDTH, late=0)
    print(
        f"\nPanda, first session: own inertia {own.round(2)} kg m^2, least {least.round(3)}"
    )
    print(
        f"stiffest mode {values.max():.3g}, joints {(mode / np.abs(mode).max()).round(2)}"
    )
    share = float(np.mean(values[:, -1] > bears))
    print(
        f"the loop bears {bears:.3g}, exceeded in {100 * share:.0f} % of the postures"
    )


def show_shaking() -> None:
    """Print what a wrong model does outside the loop and inside it, on an arm whose drives have a delay."""
    print("\n| controller | joint error [mrad] | torque rate [N m/s] | diverged |")
    print("|---|---|---|---|")
    for one in run_instability_demo(iiwa()):
        measures = one.measures
        texts = [f"{1e3 * measures.joint_error:.3g}", f"{measures.torque_rate:.3g}"]
        print(
            f"| {one.case} | {' | '.join(texts)} | {'yes' if measures.diverged else 'no'} |"
        )


def main() -> None:
    """Record every robot, then print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--data", type=Path)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--robots", default=",".join([*KNOWN_ROBOTS, *DH, *FILES]))
    parser.add_argument("--out", type=Path, default=Path("out/stable_gains.json"))
    arguments = parser.parse_args()
    warnings.simplefilter("ignore")
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory(prefix="gapscope_") as folder:
        for name in filter(None, arguments.robots.split(",")):
            arm = load(name, arguments.data, Path(folder))
            rows.append(measured(name, arm, arguments.seeds))
            print(rows[-1], flush=True)
            write_json({"rows": rows}, arguments.out)
    if rows:
        show(rows)
    show_mode()
    show_shaking()


if __name__ == "__main__":
    main()
