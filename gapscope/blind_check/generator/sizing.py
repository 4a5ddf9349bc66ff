"""Drawing a cause and giving it the size that its severity class asks for."""

from __future__ import annotations

import numpy as np

from gapscope.blind_check.generator.case_setup import CaseSetup
from gapscope.blind_check.generator.conditions import STRONG
from gapscope.blind_check.generator.law import Cause, Law

TRIES = 6
"""Runs of the held-out motion that the sizing of a cause may take."""
OTHERS = (0.6, 1.0)
"""Size of an effect on its further joints, over that on its first."""
MIN_NRMSE = 0.02
"""Least torque NRMSE that a strong effect adds, on each of its joints if these are sized one by one: an effect that
adds less than 0.01 to no joint's gap need not be named at all, however low the floor is."""
NEAR = 0.2
"""How far, in logarithm, each joint may stay from its own target."""


def draw_cause(
    law: Law,
    setup: CaseSetup,
    severity: tuple[float, float] | None,
    rng: np.random.Generator,
) -> Cause | None:
    """A cause whose own gap on the held-out motion lies in a class; ``None`` if no believable size gives that.

    Args:
        law: its law.
        bench: the case's arm and motions.
        severity: lowest and highest ratio of its own gap to the floor, on the joint where it is widest.
        rng: source of joints and values.
    """
    joints = draw_joints(law.joints, setup.arm.n, rng)
    if joints is None:
        return None
    cause = Cause(law, joints, law.draw(rng, setup.context, joints))
    if severity is None or law.measure == "none":
        return cause
    low, high = severity
    # a little inside the class, evenly in the logarithm
    target = float(np.exp(rng.uniform(np.log(low * 1.08), np.log(high / 1.08))))
    targets = target * rng.uniform(*OTHERS, max(len(joints), 1))
    targets[rng.integers(len(targets))] = target
    targets = np.maximum(targets, min(low, 2.0))
    if law.measure == "step":
        now = cause.values["step"] / setup.context.encoder_step
        return cause.sized(np.full(len(joints), target) / now)
    return _sized(cause, setup, targets, severity)


def _sized(
    cause: Cause,
    setup: CaseSetup,
    targets: np.ndarray,
    severity: tuple[float, float],
) -> Cause | None:
    """Scale towards the targets: what an effect adds to the gap is nearly proportional to its size.

    A strong effect is lifted to ``MIN_NRMSE``, if that takes it beyond its class.
    """
    own = cause.law.own
    least = np.zeros(setup.arm.n)
    if severity[0] >= STRONG[0][0]:
        least = MIN_NRMSE / (setup.floor / setup.context.deviation)
    shrunk = 1.0
    for _ in range(TRIES):
        if not cause.believable():
            return None
        ratios = setup.signature((cause,))
        if ratios is None:
            # the loop became unstable: try a smaller effect
            cause = cause.sized(np.full(len(targets), 0.6))
            shrunk = 0.6 * shrunk
            if shrunk < 0.2:
                return None
            continue
        reached, wanted = _reached_and_wanted(cause, ratios, targets, least)
        highest = max(severity[1], 1.2 * wanted.max())
        in_class = severity[0] <= ratios.max() <= highest
        visible = own or (ratios >= 0.9 * least).any()
        tolerance = NEAR if own else np.inf
        near = (np.abs(np.log(reached / wanted)) < tolerance).all()
        if in_class and visible and near:
            return cause
        factor = np.clip(wanted / np.maximum(reached, 1e-9), 0.1, 6.0)
        cause = cause.sized(factor if own else np.full(len(targets), factor[0]))
    return None


def _reached_and_wanted(
    cause: Cause, ratios: np.ndarray, targets: np.ndarray, least: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Ratio to the floor that a cause reaches, and the one that it should reach.

    Per joint of the cause; a single pair, of the joint where it is widest, if its joints are not sized one by one.

    Args:
        cause: the cause.
        ratios: what it adds to the gap over the floor, (n,).
        targets: ratios wanted, (1,) or one per joint of the cause.
        least: ratio of each joint at which the effect becomes visible, (n,).
    """
    if cause.law.own:
        return ratios[cause.joints], np.maximum(targets, least[cause.joints])
    visible_at = ratios.max() * (least / np.maximum(ratios, 1e-9)).min()
    wanted = np.maximum(targets.max(keepdims=True), np.array([visible_at]))
    return np.array([ratios.max()]), wanted


def draw_joints(kind: str, n: int, rng: np.random.Generator) -> np.ndarray | None:
    """Joints, from 0, of one kind of law (see ``Law``) on an arm of n joints; ``None`` if it has none."""
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
        count = 2 if kind == "pair" else 1
        return np.sort(rng.choice(pool, count, replace=False))
    # mostly one joint, at times several, rarely all
    chance = rng.random()
    if chance < 0.15:
        return pool
    count = 1 if chance < 0.6 or len(pool) < 3 else int(rng.integers(2, len(pool)))
    return np.sort(rng.choice(pool, count, replace=False))
