"""How the recorded torque changes with the linear coordinates of every term, on the rows of one segment.

Most effects on a joint change the torque of that joint alone; their columns are finite differences of the corrected
arm. What moves or loads the bodies changes the torque of all joints, by the derivatives of the inverse dynamics.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.effect import Effect, Path, TorqueLaw
from gapscope.model.body_point import acts_on_bodies, rigid_body_jacobian
from gapscope.model.conditioning import Segment
from gapscope.model.decimated_segments import DecimatedSegments
from gapscope.model.prediction import Prediction
from gapscope.model.terms import Term, Terms

TORQUE_STEP = 1e-4
"""Step of coordinates that go with a torque, over the joint's own [1]: friction that depends on the load is no linear
function of the others, and fingers have a ten-thousandth of the torque of a shoulder."""
MIN_TORQUE = 1e-3
"""A joint's torque is taken as no less than this share of the largest [1]."""
MIN_TORQUE_GAIN, MAX_TORQUE_GAIN = 0.2, 5.0
"""Recorded over needed torque lies between these [1]: a wider finite difference crosses a reversal of friction."""
MAX_NUMBERS = 2_000_000
"""Numbers up to which the torques of moved arms are held at once, so that a long segment costs no more memory."""


def columns(
    at: Prediction,
    data: DecimatedSegments,
    k: int,
    terms: Terms,
    theta: np.ndarray,
    only: Collection[str] | None = None,
) -> np.ndarray:
    """Rows of the derivatives of the predicted torque by theta, (M, n, P) [N m] per unit of theta.

    Those of changed links are left zero: they are combinations of the inertial regressor.

    Args:
        at: what the arm with the effects of theta predicts on the segment.
        data: the data, whose segment ``k`` is meant.
        k: place of the segment.
        terms: all terms, with the shapes of those that have one.
        theta: linear coordinates around which to differentiate, shape (P,).
        only: effects whose columns are wanted; all if ``None``, the others' are zero.
    """
    segment, bodies = data.segments[k], data.bodies[k]
    out = np.zeros((len(data.time(segment)), at.arm.arm.n_joints, terms.size))
    moves = list(_moves(at, terms, theta, only))
    at_once = max(1, MAX_NUMBERS // at.torque.size)
    for start in range(0, len(moves), at_once):
        some = moves[start : start + at_once]
        begun = [move.begun for move in some if move.begun is not None]
        arms = [*(move.arm for move in some), *begun]
        changes = np.moveaxis(data.thin(at.changes(arms), segment), 1, 0)
        before = iter(changes[len(some) :])
        for move, change in zip(some, changes, strict=False):
            own = change if move.begun is None else change - next(before)
            out[:, move.joints, move.places] = own / move.step
    for place, j, lost in _lost(segment, terms):
        out[:, j, place] = data.thin(lost, segment)
    bodily = rigid_body_jacobian(at, segment, bodies, terms, theta, only)
    if bodily:
        torque = np.stack(list(bodily.values()), axis=2)
        out[:, :, list(bodily)] = data.thin(as_recorded(at, torque), segment)
    return out


class _Perturbation(NamedTuple):
    """The arm with some coordinates moved by a step, and the columns that the change of its torque gives.

    Attributes:
        arm: with the coordinates moved.
        begun: the arm from which they are moved; ``None`` for the arm itself.
        step: by which they are, of each of these joints or of all.
        joints, places: of the columns: whose torque they are of, and where they lie in theta.
    """

    arm: CorrectedArm
    begun: CorrectedArm | None
    step: np.ndarray | float
    joints: np.ndarray | slice
    places: np.ndarray | int


def steps(effect: Effect, size: np.ndarray) -> np.ndarray:
    """Steps of an effect's linear coordinates for finite differences, on each joint, in their units, (n,).

    ``size`` is the ``torque_size`` of the joints [N m], (n,).
    """
    step = effect.fitted.step
    return TORQUE_STEP * size if step is None else np.full(len(size), step)


def torque_size(at: Prediction) -> np.ndarray:
    """RMS of the torque of each joint [N m], (n,), not far below that of others; 1 of an arm without any."""
    size = np.sqrt((at.torque**2).mean(axis=0))
    largest = float(size.max())
    return np.maximum(size, MIN_TORQUE * largest) if largest else np.ones(len(size))


def _moves(
    at: Prediction,
    terms: Terms,
    theta: np.ndarray,
    only: Collection[str] | None,
) -> Iterator[_Perturbation]:
    """The moves for effects on a joint, by each coordinate on all joints at once, and for those on a motor."""
    arm, joints, size = at.arm, np.arange(at.arm.arm.n_joints), torque_size(at)
    for effect in terms.definitions:
        if only is not None and effect.name not in only:
            continue
        step = steps(effect, size)
        if effect.reach == "motor":
            motors = terms.of(effect.name)
            largest = float(step.max())
            for term in motors:
                place = term.columns[0]
                moved = _stepped(arm, terms, theta, motors, [place], largest)
                yield _Perturbation(moved, None, largest, slice(None), place)
        # what cuts the delivered torque changes none that is needed
        elif not (effect.limits or acts_on_bodies(effect, arm)):
            for coordinate, places in enumerate(terms.block(effect.name)):
                arms = moved_arms(arm, terms, theta, effect.name, coordinate, step)
                if arms is not None:
                    yield _Perturbation(*arms, step, joints, places)


def moved_arms(
    arm: CorrectedArm,
    terms: Terms,
    theta: np.ndarray,
    name: str,
    coordinate: int,
    step: np.ndarray,
) -> tuple[CorrectedArm, CorrectedArm | None] | None:
    """The arm with one coordinate of an effect moved by a step on all joints; ``None`` if no term of it is open.

    Coordinates beyond the first mean nothing of a torque law that is off, as the rest of a spring without stiffness:
    they are moved from an arm on which it has begun by a step of the first, which comes second.
    """
    chosen = [t for t in terms.of(name) if terms.can_choose(t)]
    if not chosen:
        return None
    places = [t.columns[coordinate] for t in chosen]
    own = step[[t.joint - 1 for t in chosen]]
    if coordinate == 0 or not isinstance(chosen[0].definition, TorqueLaw):
        return _stepped(arm, terms, theta, chosen, places, own), None
    on, first = theta.copy(), [t.columns[0] for t in chosen]
    on[first] += np.where(theta[first] == 0, own, 0.0)
    begun = _stepped(arm, terms, on, chosen, [], 0.0)
    return _stepped(arm, terms, on, chosen, places, own), begun


def _stepped(
    arm: CorrectedArm,
    terms: Terms,
    theta: np.ndarray,
    chosen: Sequence[Term],
    places: list[int],
    step: np.ndarray | float,
) -> CorrectedArm:
    """The arm with the terms of one effect moved by a step at some places of theta."""
    name, moved = chosen[0].effect, theta.copy()
    moved[places] += step
    others = tuple(e for e in arm.effects if e.name != name)
    return replace(arm, effects=(*others, *terms.effects(moved, chosen)))


def as_recorded(at: Prediction, columns: np.ndarray) -> np.ndarray:
    """Columns of the bodies' torque, (N, n, K), as they are recorded: through friction, scale, delay and lag."""
    step = TORQUE_STEP * torque_size(at)
    above, below = (replace(at, rigid=at.rigid + side) for side in (step, -step))
    difference = above.by(at.arm) - below.by(at.arm)
    # where dry friction changes its sign the difference is no derivative
    gain = np.clip(difference / (2 * step), MIN_TORQUE_GAIN, MAX_TORQUE_GAIN)
    return _delayed(at.arm, columns, at.motion.t) * gain[:, :, None]


def _lost(segment: Segment, terms: Terms) -> Iterator[tuple[int, int, np.ndarray]]:
    """What is not delivered of a recorded torque: place of the term, joint from 0, torque lost on the way, (N,)."""
    assert segment.torque is not None
    for term in terms.all:
        effect = term.definition
        if isinstance(effect, Path) and effect.limits and term in terms.shapes:
            searched = np.array(terms.shapes[term])[:, None]
            values = effect.values_at(np.ones((len(term.columns), 1)), searched)
            torque = segment.torque[:, term.joint - 1]
            delivered = effect.applied(torque, None, *values.values())
            yield term.columns[0], term.joint - 1, torque - delivered


def _delayed(corrected: CorrectedArm, columns: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Columns (N, n, K) of the needed torque, each joint's shifted by its delay and lag, to first order in time."""
    times = (values[0] for effect, values in corrected.of_kind(Path) if effect.delays)
    ahead: np.ndarray = sum(times, np.zeros(corrected.arm.n_joints))
    if not ahead.any():
        return columns
    return columns + ahead[:, None] * np.gradient(columns, t, axis=0)
