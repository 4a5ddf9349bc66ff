"""How the joints move, and what cannot be told from that."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.motions.motion import Motion
from gapscope.case_check.remark import Remark, numbers
from gapscope.case_check.thresholds import (
    FEW_EXCITED,
    FEW_REVERSALS,
    GRAVITY_SHARE,
    INDEPENDENT,
    KNOWN,
    LEAST_GRAVITY,
    LEAST_LOAD,
    LEFT_OVER,
    ONE_SPEED,
    ONE_WAY,
    SLIDING,
    STILL,
)
from gapscope.ident.model.base_parameters import random_states, structural_base
from gapscope.ident.model.friction_law import FrictionLaw
from gapscope.ident.model.model_columns import ModelColumns
from gapscope.ident.model.regressor import Regressor
from gapscope.model.conditioning import Segment

SEED = 0
"""Of the random postures."""
MOST_NAMED = 8
"""Most parameters that are named."""


@dataclass(frozen=True)
class JointMotions:
    """How n joints move in all recordings that are fitted.

    Attributes:
        range: of the positions [rad or m], shape (n,).
        slow, fast: 10 and 90 % quantile of the speed of sliding samples [rad/s or m/s], (n,); 0 if it never slides.
        reversals: changes of direction, shape (n,).
        one_speed: cosine between the velocity and its sign over sliding samples [1], (n,); nan if it never slides.
        forward: share of sliding samples with positive velocity [1], (n,); nan if it never slides.
        gravity: range of the nominal arm's gravity torque [N m], (n,).
        possible_gravity: the same over random postures within the limits [N m], (n,).
        excited: share of the base parameters of the bodies that the motion excites [1].
        silent: names of those that it does not.
    """

    range: np.ndarray
    slow: np.ndarray
    fast: np.ndarray
    reversals: np.ndarray
    one_speed: np.ndarray
    forward: np.ndarray
    gravity: np.ndarray
    possible_gravity: np.ndarray
    excited: float
    silent: tuple[str, ...]


def joint_motions(columns: ModelColumns, segments: Sequence[Segment]) -> JointMotions:
    """Measure how the joints move.

    Args:
        columns: model of the nominal arm.
        segments: of the recordings that are fitted, with torque or without.
    """
    arm, body = columns.arm, columns.body
    q, dq = (
        np.concatenate([getattr(s.motion, name)[s.inner] for s in segments])
        for name in ("q", "dq")
    )
    speed = np.abs(dq) / arm.per_radian
    sliding = speed > SLIDING
    each = [np.abs(dq[sliding[:, j], j]) for j in range(arm.n_joints)]
    states = random_states(Regressor(arm, body, ()), np.random.default_rng(SEED), 200)
    silent, count = _silent(columns, segments)
    return JointMotions(
        range=np.ptp(q, axis=0),
        slow=np.array([np.quantile(v, 0.1) if len(v) else 0.0 for v in each]),
        fast=np.array([np.quantile(v, 0.9) if len(v) else 0.0 for v in each]),
        reversals=_reversals(segments, arm.per_radian),
        one_speed=np.array([_cosine(v) for v in each]),
        forward=np.array(
            [_share(dq[sliding[:, j], j] > 0) for j in range(arm.n_joints)]
        ),
        gravity=np.ptp(_gravity(body, q), axis=0),
        possible_gravity=np.ptp(_gravity(body, states.q), axis=0),
        excited=1 - len(silent) / count,
        silent=silent,
    )


def check_motion(motions: JointMotions, per_radian: np.ndarray) -> Iterator[Remark]:
    """What cannot be told from the motion, joint by joint.

    Args:
        motions: how the joints move.
        per_radian: what counts as a radian of each joint [rad or m], shape (n,).
    """
    still = motions.range / per_radian < STILL
    moving = ~still
    one_speed = moving & ~(motions.one_speed < ONE_SPEED)
    share = np.minimum(motions.forward, 1 - motions.forward)
    one_way = moving & ~one_speed & ~(share > ONE_WAY)
    few = moving & (motions.reversals < FEW_REVERSALS) & ~one_way
    could = np.maximum(motions.possible_gravity, LEAST_GRAVITY)
    flat = moving & (motions.possible_gravity > LEAST_GRAVITY)
    flat &= motions.gravity < GRAVITY_SHARE * could
    yield from _of_joints(
        still,
        "at rest: nothing can be told of friction and rotor",
        "record a motion to and fro",
    )
    yield from _of_joints(
        one_speed,
        "hardly more than one speed: Coulomb and viscous friction cannot be told apart",
        "repeat the motion ten times slower, and faster",
    )
    yield from _of_joints(
        one_way,
        "one direction only: friction cannot be told from a constant torque",
        "move it to and fro",
    )
    yield from _of_joints(
        few,
        f"fewer than {FEW_REVERSALS} reversals: backlash and dry friction show at reversals",
        "move it to and fro several times",
    )
    yield from _of_joints(
        flat,
        "hardly any change of gravity torque: torque scale, offset and joint zero cannot be told apart",
        "record in postures that differ more, arm stretched and folded",
    )
    if not (still | one_speed | one_way | few | flat).any():
        yield Remark(
            "ok", "excitation", "", "all joints move to and fro, slowly and fast"
        )
    yield _of_bodies(motions)


def _of_joints(mask: np.ndarray, said: str, remedy: str) -> Iterator[Remark]:
    joints = (np.flatnonzero(mask) + 1).tolist()
    if joints:
        yield Remark("warn", "excitation", numbers(joints), said, remedy)


def _of_bodies(motions: JointMotions) -> Remark:
    said = f"{motions.excited:.0%} of the base parameters of the bodies show in the torque by themselves"
    if motions.silent:
        named = ", ".join(motions.silent[:MOST_NAMED])
        rest = len(motions.silent) - MOST_NAMED
        said += f", not {named}" + (f" and {rest} more" if rest > 0 else "")
    if motions.excited >= FEW_EXCITED:
        return Remark("ok", "excitation", "", said)
    return Remark(
        "warn",
        "excitation",
        "",
        f"{said}: errors of these stay hidden",
        "record an exciting trajectory (gapscope excite)",
    )


def _silent(
    columns: ModelColumns, segments: Sequence[Segment]
) -> tuple[tuple[str, ...], int]:
    """Base parameters of the bodies that would not be known to half of their size, and how many there are in all.

    X are the columns of the base parameters times 100 % of each, rows over the RMS of the joint's nominal torque. If a
    healthy arm leaves a share s of the torque, column k has the standard deviation s sqrt([(X^T X)^-1]_kk / r), r the
    share of independent samples.
    """
    regressor = Regressor(columns.arm, columns.body, ())
    base = structural_base(regressor, np.random.default_rng(SEED))
    scale = columns.scale(FrictionLaw())[: columns.links][base.kept]
    rows = np.vstack([regressor.matrix(_inner(segment)) for segment in segments])
    torque = np.sqrt(np.mean((rows @ columns.body.inertial_parameters()) ** 2, axis=0))
    # a joint that nothing loads has no torque to compare with
    least = LEAST_LOAD * torque.max()
    rows = rows[:, :, base.kept] * scale / np.maximum(torque, least)[:, None]
    scaled = rows.reshape(-1, len(base.kept))
    norms = np.linalg.norm(scaled, axis=0)
    full = norms > 1e-12 * norms.max()
    unit = np.where(full, scaled / np.where(full, norms, 1.0), 0.0)
    values, vectors = np.linalg.eigh(unit.T @ unit)
    inverse = (vectors**2 / np.maximum(values, 1e-14)) @ np.ones(len(values))
    own = np.where(full, norms, 1e-12) / np.sqrt(inverse)
    deviation = LEFT_OVER / own / np.sqrt(INDEPENDENT)
    names = [base.names[k] for k in base.kept]
    silent = tuple(
        name for name, std in zip(names, deviation, strict=True) if std > KNOWN
    )
    return silent, len(names)


def _inner(segment: Segment) -> Motion:
    m, rows = segment.motion, segment.inner
    return Motion(m.t[rows], m.q[rows], m.dq[rows], m.ddq[rows])


def _gravity(body: RigidBody, q: np.ndarray) -> np.ndarray:
    still = np.zeros_like(q)
    return body.inverse_dynamics(q, still, still)


def _reversals(segments: Sequence[Segment], per_radian: np.ndarray) -> np.ndarray:
    """Changes of direction between sliding samples of each joint, shape (n,)."""
    counts = np.zeros(len(per_radian), dtype=int)
    for segment in segments:
        velocity = segment.motion.dq / per_radian
        for j in range(len(counts)):
            direction = np.sign(velocity[np.abs(velocity[:, j]) > SLIDING, j])
            counts[j] += int((np.diff(direction) != 0).sum())
    return counts


def _cosine(speed: np.ndarray) -> float:
    return float(speed.mean() / np.sqrt((speed**2).mean())) if len(speed) else np.nan


def _share(mask: np.ndarray) -> float:
    return float(mask.mean()) if len(mask) else np.nan
