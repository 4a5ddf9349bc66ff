"""How the torque of the bodies changes with elasticity and free play of joints: where they begin, and in use."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from gapscope.diagnosis.model.body_point import BodyPoint
from gapscope.diagnosis.model.terms import Term
from gapscope.diagnosis.thresholds import PLAY_STEP
from gapscope.effects.corrected import CorrectedArm, slow_with_rates
from gapscope.effects.deflection import Springs
from gapscope.effects.transmission import BACKLASH, ELASTICITY
from gapscope.ident.signals.conditioning import Segment

Columns = Iterator[tuple[int, np.ndarray]]
"""Places in theta with their derivatives, (N, n)."""


def elasticity(point: BodyPoint) -> Columns:
    """Derivatives by elasticity where it begins, and then by that in use, which takes their place."""
    yield from _beginning_elasticity(point)
    yield from _elasticity_in_use(point)


def backlash(point: BodyPoint) -> Columns:
    """The same by free play."""
    yield from _beginning_backlash(point)
    yield from _backlash_in_use(point)


def _beginning_elasticity(point: BodyPoint) -> Columns:
    """A joint that bends by torque times compliance, less damping times its rate, moves its link as slowly."""
    motion = point.motion
    twist = _transmitted(point.arm, point.segment)
    per_coordinate = (twist, -np.gradient(twist, motion.t, axis=0))
    blocks = point.terms.block(ELASTICITY.name)
    for unit, places in zip(per_coordinate, blocks, strict=True):
        deflections = slow_with_rates(unit, motion)
        for j, place in enumerate(places):
            torque = [
                matrix[:, :, j] * x[:, j, None]
                for matrix, x in zip(point.sensitivities, deflections, strict=True)
            ]
            yield int(place), -sum(torque, np.zeros(1))


def _beginning_backlash(point: BodyPoint) -> Columns:
    """Free play as it begins."""
    for j, place in enumerate(point.terms.block(BACKLASH.name)[0]):
        yield int(place), point.bodies.play[:, :, j]


def _elasticity_in_use(point: BodyPoint) -> Columns:
    """Around values that are not zero elasticity has other columns than where it begins."""
    terms = [t for t in point.terms.of(ELASTICITY.name) if point.in_use(t)]
    springs = _springs(point) if terms else None
    if springs is not None:
        yield from _by_springs(point, springs, terms)
        return
    largest = np.abs(point.theta[point.terms.block(ELASTICITY.name)[0]]).max()
    for term in terms:
        for place in term.columns:
            step = 1e-3 * max(abs(point.theta[place]), 1e-3 * largest)
            moved = point.rigid_with(ELASTICITY.name, place, step)
            yield place, (moved - point.rigid) / step


def _springs(point: BodyPoint) -> Springs | None:
    """The springs at theta; ``None`` if one lies behind free play of its own joint, or cannot hold its link."""
    arm, motion = point.arm, point.motion
    stiffness, damping = (arm.value(ELASTICITY.name, x) for x in ELASTICITY.names)
    if (arm.value(BACKLASH.name, "width")[stiffness > 0] > 0).any():
        return None
    others = tuple(e for e in arm.effects if e.name != ELASTICITY.name)
    torque = replace(arm, effects=others).rigid_torque(point.body, motion)
    springs = Springs(point.sensitivities, motion.rate, torque, stiffness, damping)
    return springs if springs.followed else None


def _by_springs(point: BodyPoint, springs: Springs, terms: list[Term]) -> Columns:
    """By the derivatives of the springs' torque by stiffness and damping, and of these by the coordinates."""
    by_value = springs.columns()
    for term in terms:
        spring = int(np.searchsorted(springs.elastic, term.joint - 1))
        for place in term.columns:
            rates = _value_rates(point, term, place)
            parts = [
                columns[:, :, spring] * rate
                for columns, rate in zip(by_value, rates, strict=True)
            ]
            yield place, np.asarray(sum(parts))


def _value_rates(point: BodyPoint, term: Term, place: int) -> list[float]:
    """Derivatives of a joint's stiffness and damping by one of its coordinates."""
    largest = np.abs(point.theta[point.terms.block(ELASTICITY.name)[0]]).max()
    step = 1e-4 * max(abs(point.theta[place]), 1e-3 * largest)
    ends = []
    for side in (step, -step):
        moved = point.theta.copy()
        moved[place] += side
        (effect,) = point.terms.effects(moved, [term])
        ends.append([float(effect.parameters[x][0]) for x in ELASTICITY.names])
    return [(above - below) / (2 * step) for above, below in zip(*ends, strict=True)]


def _backlash_in_use(point: BodyPoint) -> Columns:
    """The same of free play, whose motion is no smooth function of its width."""
    for term in point.terms.of(BACKLASH.name):
        for place in term.columns if point.in_use(term) else ():
            step = PLAY_STEP * abs(point.theta[place])
            above = point.rigid_with(BACKLASH.name, place, step)
            below = point.rigid_with(BACKLASH.name, place, -step)
            yield place, (above - below) / (2 * step)


def _transmitted(arm: CorrectedArm, segment: Segment) -> np.ndarray:
    """Torque through the transmission as recorded [N m], (N, n): what reached the motors less what they need."""
    assert segment.torque is not None
    bare = replace(
        arm,
        effects=tuple(
            e for e in arm.effects if e.effect.family in ("friction", "rigid_body")
        ),
    )
    scale = 1.0 + arm.value("torque_scale", "scale")
    return scale * arm.delivered(segment.torque) - bare.needed_torque(
        np.zeros_like(segment.torque), segment.motion
    )
