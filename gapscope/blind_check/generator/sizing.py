"""Drawing a cause and giving it the size that its severity class asks for."""

from __future__ import annotations

import numpy as np

from gapscope.blind_check.generator.case_setup import CaseSetup
from gapscope.blind_check.generator.conditions import STRONG
from gapscope.blind_check.generator.law import Cause, Law

TRIES = 6
"""Runs of the unseen motion that the sizing of a cause may take."""
OTHERS = (0.6, 1.0)
"""Size of an effect on its further joints, over that on its first."""
SEEN = 0.02
"""Least torque NRMSE that a strong effect adds, on each of its joints where these are sized one by one: an effect that
adds less than 0.01 to no joint's gap need not be named at all, however low the floor is."""
NEAR = 0.2
"""How far, in logarithm, each joint may stay from its own target."""


def draw_cause(
    law: Law,
    setup: CaseSetup,
    severity: tuple[float, float] | None,
    rng: np.random.Generator,
) -> Cause | None:
    """A cause whose own gap on the unseen motion lies in a class; ``None`` where no believable size gives that.

    Args:
        law: its law.
        bench: the case's arm and motions.
        severity: lowest and highest ratio of its own gap to the floor, on the joint where it is widest.
        rng: source of joints and values.
    """
    joints = draw_joints(law.joints, setup.arm.n, rng)
    if joints is None:
        return None
    cause = Cause(law, joints, law.draw(rng, setup.scene, joints))
    if severity is None or law.measure == "none":
        return cause
    low, high = severity
    target = float(np.exp(rng.uniform(np.log(low * 1.08), np.log(high / 1.08))))
    targets = target * rng.uniform(*OTHERS, max(len(joints), 1))
    targets[rng.integers(len(targets))] = target
    targets = np.maximum(targets, min(low, 2.0))
    if law.measure == "step":
        return cause.sized(
            np.full(len(joints), target)
            / (cause.values["step"] / setup.scene.encoder_step)
        )
    return _sized(cause, setup, targets, severity)


def _sized(
    cause: Cause, setup: CaseSetup, targets: np.ndarray, severity: tuple[float, float]
) -> Cause | None:
    """Scale towards the targets: what an effect adds to the gap is nearly proportional to its size.

    A strong effect is lifted to ``SEEN``, if that takes it beyond its class.
    """
    own = cause.law.own
    shrink = 1.0
    for _ in range(TRIES):
        if not cause.believable():
            return None
        found = setup.signature((cause,))
        if found is None:
            cause, shrink = cause.sized(np.full(len(targets), 0.6)), 0.6 * shrink
            if shrink < 0.2:
                return None
            continue
        seen = (
            SEEN / (setup.floor / setup.scene.deviation)
            if severity[0] >= STRONG[0][0]
            else np.zeros(len(found))
        )
        got = found[cause.joints] if own else np.array([found.max()])
        lift = (
            seen[cause.joints]
            if own
            else np.array([found.max() * (seen / np.maximum(found, 1e-9)).min()])
        )
        wanted = np.maximum(targets if own else targets.max(keepdims=True), lift)
        inside = severity[0] <= found.max() <= max(severity[1], 1.2 * wanted.max())
        enough = own or (found >= 0.9 * seen).any()
        if (
            inside
            and enough
            and (np.abs(np.log(got / wanted)) < (NEAR if own else np.inf)).all()
        ):
            return cause
        factor = np.clip(wanted / np.maximum(got, 1e-9), 0.1, 6.0)
        cause = cause.sized(factor if own else np.full(len(targets), factor[0]))
    return None


def draw_joints(kind: str, n: int, rng: np.random.Generator) -> np.ndarray | None:
    """Joints, from 0, of one kind of law (see ``Law``) on an arm of n joints; ``None`` where it has none."""
    first, last = {
        "middle": (1, n - 1),
        "inner": (1, max(n - 2, 2)),
        "later": (1, n),
    }.get(kind, (0, n))
    pool = np.arange(first, last)
    if kind == "arm":
        return np.array([], dtype=int)
    if len(pool) < (2 if kind == "pair" else 1):
        return None
    if kind == "all":
        return pool
    if kind in ("one", "inner", "pair"):
        return np.sort(rng.choice(pool, 2 if kind == "pair" else 1, replace=False))
    chance = rng.random()
    if chance < 0.15:
        return pool
    count = 1 if chance < 0.6 or len(pool) < 3 else int(rng.integers(2, len(pool)))
    return np.sort(rng.choice(pool, count, replace=False))
