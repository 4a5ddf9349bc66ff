"""Columns of every effect against finite differences of what the corrected arm predicts."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import synthetic

from gapscope.effects.applied import AppliedEffect
from gapscope.effects.catalogue import explained
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.effect import Effect
from gapscope.effects.transmission import PLAY_START, PLAY_STEP
from gapscope.model.conditioning import Segment
from gapscope.model.design import Design, FreeArm, about, design
from gapscope.model.jacobian import Bodies, LinearisationPoint
from gapscope.model.rows import Rows
from gapscope.model.terms import Candidate, Term, Terms

N = synthetic.N
PLAIN = Terms(N)
BENDING = ("joint_elasticity", "backlash")
"""Effects whose columns, until they are in use, come from the recorded torque or from a little free play."""

LINEAR = {
    "coulomb_friction": [[0.5, -1.0, 0.3]],
    "viscous_friction": [[1.0, 0.5, -0.4]],
    "load_friction": [[0.1, 0.05, 0.15]],
    "stribeck_friction": [[1.0, 0.8, 0.5]],
    "saturating_friction": [[1.5, 0.8, 0.6]],
    "friction_drift": [[0.4, 0.3, -0.2]],
    "payload": [[1.5], [0.3], [-0.075], [0.15]],
    "link_inertia": [[0.0, x, 0.0] for x in (0.5, 0.03, -0.02, 0.01)],
    "armature": [[0.2, -0.3, 0.1]],
    "base_tilt": [[0.06], [-0.04]],
    "joint_elasticity": [[2e-4, 1e-4, 2e-4], [2e-7, 1e-7, 3e-7]],
    "backlash": [[0.008, 0.01, 0.006]],
    "torque_ripple": [[0.8, 0.0, 0.3], [-0.4, 0.9, 0.0]],
    "parallel_spring": [[3.0, -4.0, 2.0], [1.0, 2.0, -0.5]],
    "torque_scale": [[0.15, -0.2, 0.1]],
    "torque_offset": [[1.0, -2.0, 0.5]],
    "actuator_lag": [[0.006, 0.01, 0.004]],
    "actuator_delay": [[0.004, 0.008, 0.006]],
    "encoder_offset": [[0.03, -0.05, 0.04]],
    "external_force": [[8.0], [-5.0], [6.0]],
}
"""Linear coordinates of each effect around which to differentiate, (linear, places)."""
SHAPES = {
    "stribeck_friction": [(0.2,), (0.4,), (0.3,)],
    "saturating_friction": [(0.3,), (0.5,), (0.2,)],
    "friction_drift": [(2.0,), (3.0,), (1.5,)],
    "torque_ripple": [(11.0,), (17.0,), (23.0,)],
    "external_force": [(1.5, 3.5)],
}
STEP = {"payload": 1e-3, "link_inertia": 1e-4, "base_tilt": 1e-4}
STEP["encoder_offset"] = 1e-4
"""Steps for central differences; 1e-4 times the values where there are any otherwise."""


def terms(*names: str) -> Terms:
    """All terms, with the shapes of some effects."""
    shapes = {
        t: shape
        for name in names
        for t, shape in zip(PLAIN.of(name), SHAPES.get(name, ()), strict=False)
    }
    return Terms(N, shapes)


def theta(*names: str) -> np.ndarray:
    """Parameter vector with the values of some effects."""
    out = np.zeros(PLAIN.size)
    for name in names:
        out[PLAIN.block(name)] = LINEAR[name]
    return out


@cache
def rows() -> Rows:
    """Six seconds of an arm with a little more friction."""
    stiff = synthetic.Truth(coulomb=(1.0, 0.0, 0.0))
    return Rows.recorded([[synthetic.recordings(stiff, duration=6.0)[2]]])


def segment() -> Segment:
    (only,) = rows().segments
    return only


def arm(around: np.ndarray) -> FreeArm:
    """The nominal arm with the values of some effects."""
    nominal = FreeArm.nominal(synthetic.arm())
    return replace(nominal, theta=nominal.theta + around)


def column(made: Design, term: Term, k: int) -> np.ndarray:
    """Torque by a coordinate of a term [N m], (M, n)."""
    unit = np.eye(len(term.columns))[k]
    return made.torque(term, unit) * made.rows.scale


def predict(effects: tuple[AppliedEffect, ...]) -> np.ndarray:
    corrected = CorrectedArm(synthetic.arm(), effects)
    return corrected.predict(synthetic.body(), segment().motion)


def step(term: Term, around: np.ndarray) -> float:
    size = np.abs(around[list(term.columns)]).max()
    if term.effect == "backlash" and size:
        # impacts: the derivative is meant as a difference over a part of the width
        return PLAY_STEP * size
    return STEP.get(term.effect, 1e-4 * size if size else 1e-4)


def by_differences(known: Terms, around: np.ndarray, names: set[str]) -> np.ndarray:
    """Derivatives of the predicted torque by the coordinates of some effects, (N, n, P), zeros for the others.

    By central differences; one-sided where less than nothing cannot be.
    """
    out, unit = np.zeros((*segment().motion.q.shape, known.size)), np.eye(known.size)

    def torque(values: np.ndarray) -> np.ndarray:
        return predict(known.effects(values))

    for term in (t for t in known.all if known.can_choose(t) and t.effect in names):
        places = list(term.columns)
        used = around[places].any()
        if term.effect == "parallel_spring" and not used:
            # 1 N m/rad, then 1 N m more at q = 0: a rest means nothing without a spring
            first, both = np.cumsum(unit[places], axis=0)
            steps = [torque(around + x) for x in (0.0 * first, first, both)]
            out[:, :, places] = np.diff(steps, axis=0).transpose(1, 2, 0)
            continue
        for i, k in enumerate(places):
            if term.effect == "payload" and not used:
                out[:, :, k] = massless(i - 1, known.effects(around))
                continue
            h, least = step(term, around), term.parametrisation.lowest
            up, down = around + h * unit[k], around - h * unit[k]
            if not callable(least) and least >= 0.0 and around[k] < h:
                down = around
            out[:, :, k] = (torque(up) - torque(down)) / (up - down).sum()
    return out


def massless(axis: int, others: tuple[AppliedEffect, ...]) -> np.ndarray:
    """By mass: a mass at the joint's centre. By first moment: the odd part in c, as inertia is even in it."""

    def with_load(mass: float, com: np.ndarray) -> np.ndarray:
        load = AppliedEffect("payload", (), {"mass": mass, "com": com})
        return predict((*others, load))

    if axis < 0:
        return with_load(1.0, np.zeros(3)) - predict(others)
    c = 0.1 * np.eye(3)[axis]
    return (with_load(1.0, c) - with_load(1.0, -c)) / 0.2


DIFFERENTIABLE = [effect.name for effect in explained() if not effect.limits]
RIGID = [name for name in DIFFERENTIABLE if name not in BENDING]
TOGETHER = [
    ("torque_scale", "torque_offset", "actuator_delay", "torque_ripple"),
    ("coulomb_friction", "viscous_friction", "load_friction", "stribeck_friction"),
    ("payload", "encoder_offset", "torque_scale"),
    ("payload", "base_tilt"),
    ("payload", "viscous_friction"),
    ("torque_scale", "actuator_lag"),
]


@pytest.mark.parametrize("name", RIGID)
def test_columns_where_no_effect_is_in_use(name: str) -> None:
    compare((), {name})


# those of links are about the nominal ones
@pytest.mark.parametrize("name", [n for n in DIFFERENTIABLE if n != "link_inertia"])
def test_columns_around_values(name: str) -> None:
    """Of the effect in use, and of what is fitted beside almost everything."""
    compare((name,), {name, "coulomb_friction", "torque_offset", "armature"})


@pytest.mark.parametrize("names", TOGETHER)
def test_columns_beside_other_effects(names: tuple[str, ...]) -> None:
    """Of the effects in use, and of those that may come next, which some leave out that act by the true position."""
    apart = {"link_inertia", "encoder_offset", "external_force"} - {*names}
    compare(names, {*names, *RIGID} - apart, tolerance=0.02)


def test_columns_of_a_load_behind_joints_that_bend() -> None:
    """They leave out that the joints bend under it."""
    names = "joint_elasticity", "payload"
    compare(names, set(names), tolerance=0.15)


@pytest.mark.parametrize(
    "name",
    [
        e.name
        for e in explained()
        # free play is differentiated by a part of its width, across impacts
        if type(e).columns is not Effect.columns and e.name != "backlash"
    ],
)
def test_a_law_gives_the_columns_that_differences_give(name: str) -> None:
    """What a kind of effects knows of its derivatives is what an effect of a kind without them gets."""
    known, around = terms(name), theta(name)
    arm = CorrectedArm(synthetic.arm(), known.effects(around))
    bodies, motion = Bodies(synthetic.body(), segment()), segment().motion
    point = LinearisationPoint.of(arm, bodies, known, around)
    effect = known.of(name)[0].definition
    x = around[known.block(name)]
    searched = np.array([known.shapes.get(t, ()) for t in known.of(name)]).T
    by_law = effect.columns(point, x, searched)
    by_differences = Effect.columns(effect, point, x, searched)
    assert by_law.shape == (*motion.q.shape, *x.shape)
    for own, other in zip(by_law.T, by_differences.T, strict=True):
        assert np.abs(own - other).max() <= 2e-3 * np.abs(own).max()


def compare(names: tuple[str, ...], effects: set[str], tolerance: float = 0.01) -> None:
    known, around = terms(*names, *effects), theta(*names)
    made = design(rows(), arm(around), known.shapes)
    expected = rows().thin(by_differences(known, around, effects), segment())
    moving = set()
    for term in (t for t in known.all if known.can_choose(t) and t.effect in effects):
        for k, place in enumerate(term.columns):
            moves = close(column(made, term, k), expected[:, :, place], tolerance)
            moving |= {term.effect} if moves else set()
    # an effect that does nothing anywhere would be right by any column
    assert moving == effects


def close(found: np.ndarray, expected: np.ndarray, tolerance: float) -> bool:
    """Whether there is a torque to compare, (M, n), which has to agree on each joint that it moves."""
    size = np.sqrt((expected**2).mean(axis=0))
    error = np.sqrt(((found - expected) ** 2).mean(axis=0))
    assert (error <= tolerance * np.maximum(size, 0.05 * size.max()) + 1e-6).all()
    return bool(size.max() > 1e-6)


@pytest.mark.parametrize("name", DIFFERENTIABLE)
def test_what_values_do_is_what_the_corrected_arm_predicts(name: str) -> None:
    """As a fit has it: columns about the values, and a gap to go with them."""
    known, around = terms(name), theta(name)
    made = design(rows(), arm(0.0 * around), known.shapes)
    shown = [t for t in known.of(name) if t in made.places]
    own = {Candidate(t, (0,)): around[list(t.columns)] for t in shown}
    left, columns = about(made, arm(0.0 * around), own)
    for one, value in own.items():
        if one in columns:
            scaled = value * made.units[one.term]
            left -= np.stack([x @ scaled for x in columns[one]], axis=1)
        else:
            left -= made.torque(one.term, value)
    expected = predict(known.effects(around, shown)) - predict(())
    done = (made.gap - left) * rows().scale
    assert close(done, rows().thin(expected, segment()), 0.01)


def test_saturation_counts_the_torque_beyond_the_limit() -> None:
    """In use the gap is that of the torque let through; what was cut off goes with the coordinate 1."""
    torque = segment().torque
    assert torque is not None
    limit = 0.6 * np.abs(torque[:, 1]).max()
    term = PLAIN.of("torque_saturation")[1]
    around = np.zeros(PLAIN.size)
    around[list(term.columns)] = 1.0
    made = design(rows(), arm(around), {term: (limit,)})
    passed = np.clip(torque, -limit, limit) * [0.0, 1.0, 0.0] + torque * [1.0, 0.0, 1.0]
    gap = rows().thin(passed - predict(()), segment())
    assert close(made.gap * rows().scale, gap, 1e-6)
    assert close(column(made, term, 0), rows().thin(torque - passed, segment()), 1e-6)


@pytest.mark.parametrize(
    ("name", "joint", "coordinates"),
    [
        ("joint_elasticity", 2, [4e-5, 4e-8]),
        ("joint_elasticity", 3, [4e-5, 4e-8]),
        ("backlash", 1, [PLAY_START]),
    ],
)
def test_columns_before_a_joint_bends_or_plays(
    name: str, joint: int, coordinates: list[float]
) -> None:
    """Recorded with a small deflection the columns at nothing explain most of the gap that it leaves."""
    term = PLAIN.of(name)[joint - 1]
    around = np.zeros(PLAIN.size)
    around[list(term.columns)] = coordinates
    bent = replace(segment(), torque=predict(PLAIN.effects(around)))
    made = design(Rows([[[bent]]], rows().cutoff, 1), arm(0.0 * around), {})
    left = made.gap - made.torque(term, np.array(coordinates))
    before, after = ((x[:, joint - 1] ** 2).sum() for x in (made.gap, left))
    assert 0 < after < 0.15 * before
