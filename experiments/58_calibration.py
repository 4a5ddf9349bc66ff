"""Simulation-based calibration of ``--against``: arms whose torque has a share that no catalogue knows.

    .venv/bin/python experiments/58_calibration.py --out out/calibration [--draws 8] [--seconds 60] [--jobs 2]

For each pair are drawn: friction, Fourier motions, noise of the torque of 1 %
and of the encoders of 10 urad, friction that differs by up to 12 % from day to day, and a smooth random function of
positions and velocities, the same on both days, of 0, 2, 5, 10 or 20 % of each joint's torque. Reference and case have
one motion or five, and a minute or ten; their motions are different. Half of the cases have nothing of their own, half
one effect, whose torque is 2 to 60 % of that of a joint where it acts most. This is a recovery check: what is drawn
follows the laws that are looked for; what is tested is whether probabilities and intervals say what they should when
the model of the arm is not true. Resumable: each pair has a result file that is written whole.
"""

from __future__ import annotations

import tempfile
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from common import command_line, markdown, run_missing, share_text
from threadpoolctl import threadpool_limits

from gapscope.arm.case import Case
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.motions.motion import Motion
from gapscope.arm.motions.trajectory import Fourier, motion_of, urdf_limits
from gapscope.arm.nominal import NominalArm
from gapscope.arm.robots import load_nominal_arm
from gapscope.arm.root_mean_square import rms
from gapscope.diagnosis.diagnose_change import diagnose_change, identify_reference
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected import CorrectedArm

SHARES = (0.0, 0.02, 0.05, 0.1, 0.2)
LAYOUTS = {
    "one motion, one minute": (1, 60.0),
    "five motions, one minute": (5, 12.0),
    "one motion, ten minutes": (1, 600.0),
    "five motions, ten minutes": (5, 120.0),
}
"""Motions, and seconds of each."""
ROBOTS = ("kuka_iiwa", "franka_panda")
EFFECTS = {
    "torque_offset": "torque",
    "torque_scale": "scale",
    "coulomb_friction": "torque",
    "viscous_friction": "coefficient",
    "payload": "mass",
}
"""What may have changed, and its parameter."""
RATE, NOISE, ENCODER, DAY = 100.0, 0.01, 1e-5, 0.12
FEATURES = 12
"""Waves of which the unknown torque consists."""


class Unknown(NamedTuple):
    """A smooth function of positions and velocities, tau_j = a_j sum_k c_jk cos(w_k . [q, dq] + p_k)."""

    waves: np.ndarray
    phases: np.ndarray
    weights: np.ndarray

    @classmethod
    def drawn(cls, n: int, rng: np.random.Generator) -> Unknown:
        """One for n joints; a radian and a radian per second change it."""
        return cls(
            rng.normal(size=(2 * n, FEATURES)) / np.sqrt(n),
            rng.uniform(0, 2 * np.pi, FEATURES),
            rng.normal(size=(FEATURES, n)) * np.sqrt(2 / FEATURES),
        )

    def __call__(self, motion: Motion) -> np.ndarray:
        """Its torque, about 1 in RMS, (N, n)."""
        state = np.hstack([motion.q, motion.dq])
        return np.cos(state @ self.waves + self.phases) @ self.weights


def motion(arm: NominalArm, seconds: float, rng: np.random.Generator) -> Motion:
    """A Fourier motion of five harmonics whose first period is 10 s, within the limits."""
    n, order = arm.n_joints, 5
    limits = urdf_limits(RigidBody(arm), 10.0)
    t = np.arange(0.0, seconds, 1.0 / RATE)
    size = rng.uniform(0.3, 1.0) / np.arange(1, order + 1)[:, None]
    middle = (limits.lower + limits.upper) / 2
    reach = np.minimum((limits.upper - limits.lower) / 2, 1.0)
    series = Fourier(
        centre=middle + rng.uniform(-0.3, 0.3, n) * reach,
        sine=size * rng.normal(size=(order, n)) * reach / 3,
        cosine=size * rng.normal(size=(order, n)) * reach / 3,
        frequency=0.1,
        duration=seconds,
        ramp=1.0,
    )
    return motion_of(series, t)


def effect_of(
    arm: NominalArm, motions: list[Motion], scale: np.ndarray, rng: np.random.Generator
) -> AppliedEffect:
    """One effect on a joint, or a load, whose torque is 2 to 60 % of that of a joint where it acts most."""
    name = rng.choice(list(EFFECTS))
    key, size = EFFECTS[name], float(np.exp(rng.uniform(np.log(0.02), np.log(0.6))))
    if name == "payload":
        com = np.array([0.0, 0.0, rng.uniform(0.03, 0.12)])
        unit = {"mass": np.array(1.0), "com": com}
        applied, joints = AppliedEffect(name, (), unit), slice(None)
    else:
        joint = int(rng.integers(arm.n_joints)) + 1
        small = 0.1 if name == "torque_scale" else 1.0
        applied = AppliedEffect(name, (joint,), {key: np.array([small])})
        joints = slice(joint - 1, joint)
    body = RigidBody(arm)
    moved = [
        CorrectedArm(arm, (applied,)).predict(body, one)
        - CorrectedArm(arm, ()).predict(body, one)
        for one in motions
    ]
    torque = rms(np.concatenate(moved)) / scale
    ratio = size / float(torque[joints].max())
    if name == "payload":
        return AppliedEffect(name, (), {"mass": np.array(min(ratio, 8.0)), "com": com})
    sign = rng.choice([-1.0, 1.0]) if name in ("torque_offset", "torque_scale") else 1.0
    value = sign * ratio
    if name == "torque_scale":
        value = 0.1 * min(ratio, 8.0) * sign
    return AppliedEffect(name, applied.joints, {key: np.array([value])})


def recorded(
    name: str,
    true: CorrectedArm,
    motions: list[Motion],
    unknown: Unknown,
    share: float,
    scale: np.ndarray,
    rng: np.random.Generator,
) -> Case:
    """A case of an arm as its maker declares it, without friction."""
    body, n = RigidBody(true.arm), true.arm.n_joints
    torques = [
        true.predict(body, one)
        + scale * (share * unknown(one) + NOISE * rng.normal(size=one.q.shape))
        for one in motions
    ]
    positions = [one.q + ENCODER * rng.normal(size=one.q.shape) for one in motions]
    return Case.from_arrays(
        replace(true.arm, coulomb=np.zeros(n), viscous=np.zeros(n)),
        t=[one.t for one in motions],
        q=positions,
        tau=torques,
        name=name,
    )


def pair(
    robot: str, share: float, layout: str, changed: bool, seed: tuple[int, ...]
) -> tuple[Case, Case, tuple[AppliedEffect, ...]]:
    """Reference and case, and the effect that the case has of its own, if any."""
    rng = np.random.default_rng(seed)
    arm = load_nominal_arm(robot)
    count, seconds = LAYOUTS[layout]
    motions = [[motion(arm, seconds, rng) for _ in range(count)] for _ in range(2)]
    body = RigidBody(arm)
    bare = CorrectedArm(arm, ())
    torque = np.concatenate([bare.predict(body, one) for one in motions[0]])
    # no joint counts less than a hundredth of the strongest
    scale = np.maximum(rms(torque), 0.01 * rms(torque).max())
    unknown = Unknown.drawn(arm.n_joints, rng)
    # Coulomb and viscous friction [N m]
    dry = rng.uniform(0.05, 0.3, (2, arm.n_joints)) * scale
    days = [dry, dry * (1.0 + rng.uniform(-DAY, DAY, dry.shape))]
    own = (effect_of(arm, motions[1], scale, rng),) if changed else ()
    made = []
    for name, (coulomb, viscous), effects, of_day in zip(
        ("reference", "case"), days, ((), own), motions, strict=True
    ):
        arm_then = replace(arm, coulomb=coulomb, viscous=viscous)
        true = CorrectedArm(arm_then, effects)
        made.append(recorded(name, true, of_day, unknown, share, scale, rng))
    return made[0], made[1], own


def judged(plan: tuple[str, float, str, bool, int], seed: int) -> dict[str, Any]:
    """What a comparison says of one pair, beside the truth."""
    robot, share, layout, changed, draw = plan
    cell = list(LAYOUTS).index(layout), SHARES.index(share), int(changed)
    reference, case, own = pair(robot, share, layout, changed, (seed, draw, *cell))
    with tempfile.TemporaryDirectory() as folder, threadpool_limits(1):
        known = identify_reference(reference)
        document = diagnose_change(case, known, Path(folder)).diagnosis.document
    truth = {(true.name, tuple(true.joints)): true for true in own}
    found, inside = [], None
    for one in document["effects"]:
        true = truth.get((one["effect"], tuple(one["joints"])))
        found.append({key: one[key] for key in ("effect", "joints", "probability")})
        found[-1]["right"] = true is not None
        if true is not None:
            key = EFFECTS[true.name]
            value = one["parameters"][key]
            off = np.ravel(value["value"])[0] - np.ravel(true.parameters[key])[0]
            inside = bool(abs(off) <= 1.96 * np.ravel(value["std"])[0])
    row = {"share": share, "layout": layout, "found": found, "inside": inside}
    return row | {"true": [f"{true.name} {list(true.joints)}" for true in own]}


def show(rows: list[dict[str, Any]]) -> None:
    """Print the figures as a Markdown table, a row for each share and for each layout."""
    head = ("", "healthy: something named", "changed: that alone", "named first")
    head = (*head, "probability above 0.8: right", "true value in the 95 % interval")
    groups = [
        *((f"{100 * share:.0f} % unknown", "share", share) for share in SHARES),
        *((layout, "layout", layout) for layout in LAYOUTS),
    ]
    table = []
    for text, key, value in groups:
        mine = [row for row in rows if row[key] == value]
        changed = [row for row in mine if row["true"]]
        every = [f for row in mine for f in row["found"]]
        columns = (
            [bool(row["found"]) for row in mine if not row["true"]],
            [[f["right"] for f in row["found"]] == [True] for row in changed],
            [bool(row["found"]) and row["found"][0]["right"] for row in changed],
            [f["right"] for f in every if f["probability"] > 0.8],
            [row["inside"] for row in changed if row["inside"] is not None],
        )
        table.append([text, *(share_text(sum(hits), len(hits)) for hits in columns)])
    print(f"\n{markdown(head, table)}")


def main() -> None:
    """Draw pairs, compare them, and count."""
    arguments = command_line(
        __doc__,
        seed=1,
        jobs=1,
        out={"type": Path, "required": True},
        draws=(8, "of each cell"),
        seconds=(float, "layouts of this length only"),
        limit=(900.0, "of a pair [s]"),
    ).parse_args()
    layouts = [
        layout
        for layout, (count, seconds) in LAYOUTS.items()
        if arguments.seconds in (None, count * seconds)
    ]
    plans = [
        (ROBOTS[draw % len(ROBOTS)], share, layout, changed, draw)
        for draw, changed, layout, share in product(
            range(arguments.draws), (False, True), layouts, SHARES
        )
    ]
    folder = arguments.out / f"seed{arguments.seed}"
    files = {}
    for plan in plans:
        name = "_".join(str(part).replace(" ", "-") for part in plan)
        files[folder / f"{name}.json"] = plan
    judge = partial(judged, seed=arguments.seed)
    show(run_missing(judge, files, arguments.jobs, arguments.limit))


if __name__ == "__main__":
    main()
