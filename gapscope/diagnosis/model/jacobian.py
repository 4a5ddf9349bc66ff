"""How the recorded torque changes with the linear coordinates of every term, on the rows of one segment.

Most effects on a joint change the torque of that joint alone; their columns are finite differences of the corrected
arm. What moves or loads the bodies changes the torque of all joints, by the derivatives of the inverse dynamics.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from gapscope.arm.motions.motion import Motion
from gapscope.diagnosis.model.body_jacobian import bodily_columns, forced_columns
from gapscope.diagnosis.model.candidate_columns import beyond
from gapscope.diagnosis.model.fit_data import FitData
from gapscope.diagnosis.model.terms import Term, Terms, parametrisation_of
from gapscope.diagnosis.thresholds import LEAST_TORQUE_GAIN, MOST_TORQUE_GAIN
from gapscope.effects.catalogue import effect as by_name
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.effect import Effect, Path, Transmission
from gapscope.ident.signals.conditioning import Segment


def columns(
    corrected: CorrectedArm,
    data: FitData,
    k: int,
    terms: Terms,
    theta: np.ndarray,
    only: frozenset[str] | set[str] | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Predicted torque at theta, (N, n), and rows of its derivatives by theta, (M, n, P); [N m] per unit of theta.

    Those of ``link_inertia`` are left zero: they are combinations of the inertial regressor.

    Args:
        corrected: the arm with the effects of theta.
        data: the data, whose segment ``k`` is meant.
        k: place of the segment.
        terms: all terms, with the shapes of those that have one.
        theta: linear coordinates around which to differentiate, shape (P,).
        only: effects whose columns are wanted; all if ``None``, the others' are zero.
    """
    segment, bodies = data.segments[k], data.bodies[k]
    motion, body = segment.motion, segment.bodies(data.body)
    arm = corrected.unlimited
    rigid = arm.rigid_torque(body, motion)
    base = _recorded(arm, rigid, motion)
    joints = np.arange(arm.arm.n_joints)
    out = np.zeros((len(data.time(segment)), len(joints), terms.size))
    for effect in terms.definitions:
        if only and effect.name not in only:
            continue
        if _acts_on_its_joint(effect, arm):
            steps = _differences(effect, arm, terms, theta, rigid, base, motion)
            for places, change in steps:
                out[:, joints, places] = data.thin(change, segment)
        elif effect.reach == "motor":
            moves = _of_motors(effect, arm, terms, theta, rigid, base, motion)
            for place, change in moves:
                out[:, :, place] = data.thin(change, segment)
    _rest(out, terms, theta)
    for place, j, lost in _saturated(segment, terms):
        out[:, j, place] = data.thin(lost, segment)
    # of the effects that reach other joints only a force has a nonlinear parameter, and is asked for alone
    if only:
        bodily = forced_columns(arm, segment, bodies, terms)
    else:
        bodily = bodily_columns(arm, body, segment, bodies, terms, theta, rigid)
    if bodily:
        torque = np.stack(list(bodily.values()), axis=2)
        recorded = _as_recorded(arm, torque, rigid, motion)
        out[:, :, list(bodily)] = data.thin(recorded, segment)
    return base, out


def _recorded(arm: CorrectedArm, rigid: np.ndarray, motion: Motion) -> np.ndarray:
    """Torque that is recorded if the bodies need ``rigid`` [N m], (N, n)."""
    return arm.recorded_torque(arm.needed_torque(rigid, motion), motion)


def _acts_on_its_joint(effect: Effect, arm: CorrectedArm) -> bool:
    """Whether an effect changes the torque of its own joint alone, in proportion to its coordinates."""
    # behind encoders on the joints a transmission moves the motors, not the links
    behind = isinstance(effect, Transmission) and arm.arm.encoder == "joint"
    return (effect.reach == "joint" or behind) and not effect.limits


def _differences(
    effect: Effect,
    arm: CorrectedArm,
    terms: Terms,
    theta: np.ndarray,
    rigid: np.ndarray,
    base: np.ndarray,
    motion: Motion,
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Finite differences by each coordinate of an effect, moved on all joints at once: its places, (n,), and (N, n)."""
    step = parametrisation_of(effect).step
    for coordinate, places in enumerate(terms.block(effect.name)):
        moved = moved_arm(arm, terms, theta, effect.name, coordinate)
        if moved is not None:
            yield places, (_recorded(moved, rigid, motion) - base) / step


def _of_motors(
    effect: Effect,
    arm: CorrectedArm,
    terms: Terms,
    theta: np.ndarray,
    rigid: np.ndarray,
    base: np.ndarray,
    motion: Motion,
) -> Iterator[tuple[int, np.ndarray]]:
    """Finite differences by the coordinate of an effect on each coupled motor: its place, and (N, n)."""
    step = parametrisation_of(effect).step
    motors = terms.of(effect.name)
    for term in motors:
        place = term.columns[0]
        moved = _stepped(arm, terms, theta, motors, [place])
        yield place, (_recorded(moved, rigid, motion) - base) / step


def moved_arm(
    arm: CorrectedArm, terms: Terms, theta: np.ndarray, name: str, coordinate: int
) -> CorrectedArm | None:
    """The arm with one coordinate of an effect moved by a step on all joints; ``None`` if no term of it is open."""
    chosen = [t for t in terms.of(name) if t in terms.open]
    if not chosen:
        return None
    places = [t.columns[coordinate] for t in chosen]
    return _stepped(arm, terms, theta, chosen, places)


def _stepped(
    arm: CorrectedArm,
    terms: Terms,
    theta: np.ndarray,
    chosen: Sequence[Term],
    places: list[int],
) -> CorrectedArm:
    """The arm with the terms of one effect moved by a step at some places of theta."""
    name, moved = chosen[0].effect, theta.copy()
    moved[places] += parametrisation_of(by_name(name)).step
    others = tuple(e for e in arm.effects if e.name != name)
    return replace(arm, effects=(*others, *terms.effects(moved, chosen)))


def _as_recorded(
    arm: CorrectedArm, columns: np.ndarray, rigid: np.ndarray, motion: Motion
) -> np.ndarray:
    """Columns of the bodies' torque, (N, n, K), as they are recorded: through friction, scale, delay and lag."""
    step = 1e-3
    above = _recorded(arm, rigid + step, motion)
    below = _recorded(arm, rigid - step, motion)
    # where dry friction changes its sign the difference is no derivative
    gain = np.clip((above - below) / (2 * step), LEAST_TORQUE_GAIN, MOST_TORQUE_GAIN)
    return _delayed(arm, columns, motion.t) * gain[:, :, None]


def _rest(out: np.ndarray, terms: Terms, theta: np.ndarray) -> None:
    """The rest of a spring of stiffness zero is undefined; its coordinate k q0 is a constant torque."""
    stiffness, rest = terms.block("parallel_spring")
    unused = theta[stiffness] == 0
    out[:, :, rest[unused]] = out[:, :, terms.block("torque_offset")[0][unused]]


def _saturated(segment: Segment, terms: Terms) -> Iterator[tuple[int, int, np.ndarray]]:
    """What saturation keeps from a joint: place of its term, joint from 0, recorded torque beyond the limit, (N,)."""
    assert segment.torque is not None
    for term in terms.of("torque_saturation"):
        if term in terms.shapes:
            j = term.joint - 1
            torque, limit = segment.torque[:, j], np.array(terms.shapes[term])
            yield term.columns[0], j, beyond(torque, limit)


def _delayed(corrected: CorrectedArm, columns: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Columns (N, n, K) of the needed torque, each joint's shifted by its delay and lag, to first order in time."""
    times = (values[0] for effect, values in corrected.of_kind(Path) if effect.delays)
    ahead: np.ndarray = sum(times, np.zeros(corrected.arm.n_joints))
    if not ahead.any():
        return columns
    return columns + ahead[:, None] * np.gradient(columns, t, axis=0)
