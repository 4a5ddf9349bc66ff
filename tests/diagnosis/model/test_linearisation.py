"""The linearised torque against finite differences of the corrected arm, through the normal equations it hands out.

With X' the columns found here, every entry of X^T W X must equal that of X'^T W X': norms and angles of all columns,
those with the gap included."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import synthetic

from gapscope.diagnosis.gap.noise_floor import noise_floor
from gapscope.diagnosis.model.fit_data import FitData
from gapscope.diagnosis.model.linearisation import Linearisation
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.catalogue import explained
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.effect import Effect
from gapscope.effects.transmission import PLAY_START, PLAY_STEP
from gapscope.model.body_point import Bodies, LinearisationPoint
from gapscope.model.conditioning import Segment, condition, thinned
from gapscope.model.prediction import Prediction
from gapscope.model.terms import Term, Terms

N = synthetic.N
PLAIN = Terms(N)
CUTOFF = 12.0
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
    "link_inertia": [
        [0.0, 0.5, 0.0],
        [0.0, 0.03, 0.0],
        [0.0, -0.02, 0.0],
        [0.0, 0.01, 0.0],
    ],
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
STEP = {
    "payload": 1e-3,
    "link_inertia": 1e-4,
    "base_tilt": 1e-4,
    "encoder_offset": 1e-4,
}
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
def segment() -> Segment:
    """Six seconds of an arm with a little more friction."""
    recording = synthetic.recordings(
        synthetic.Truth(coulomb=(1.0, 0.0, 0.0)), duration=6.0
    )[2]
    return thinned(condition(recording, 20.0)[0], 100.0)


def predict(effects: tuple[AppliedEffect, ...]) -> np.ndarray:
    return CorrectedArm(synthetic.arm(), effects).predict(
        synthetic.body(), segment().motion
    )


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
    out = np.zeros((*segment().motion.q.shape, known.size))
    for term in (t for t in known.selectable if t.effect in names):
        if term.effect == "parallel_spring" and not around[list(term.columns)].any():
            # 1 N m/rad, then 1 N m more at q = 0: a rest means nothing without a spring
            steps = np.cumsum([np.eye(known.size)[k] for k in term.columns], axis=0)
            torque = [
                predict(known.effects(around + x)) for x in (0.0 * steps[0], *steps)
            ]
            out[:, :, list(term.columns)] = np.diff(torque, axis=0).transpose(1, 2, 0)
            continue
        for i, k in enumerate(term.columns):
            h, used = step(term, around), around[list(term.columns)].any()
            if term.effect == "payload" and not used:
                out[:, :, k] = massless(i - 1, known.effects(around))
            else:
                up, down = (
                    around + sign * h * np.eye(known.size)[k] for sign in (1, -1)
                )
                least = term.parametrisation.lowest
                if not callable(least) and least >= 0.0 and around[k] < h:
                    down = around
                span = (up - down).sum()
                out[:, :, k] = (
                    predict(known.effects(up)) - predict(known.effects(down))
                ) / span
    return out


def massless(axis: int, others: tuple[AppliedEffect, ...]) -> np.ndarray:
    """By mass: a mass at the joint's centre. By first moment: the odd part in c, as inertia is even in it."""

    def with_load(mass: float, com: np.ndarray) -> np.ndarray:
        return predict(
            (*others, AppliedEffect("payload", (), {"mass": mass, "com": com}))
        )

    if axis < 0:
        return with_load(1.0, np.zeros(3)) - predict(others)
    c = 0.1 * np.eye(3)[axis]
    return (with_load(1.0, c) - with_load(1.0, -c)) / 0.2


DIFFERENTIABLE = [effect.name for effect in explained() if not effect.limits]
AROUND = {
    **{name: (name,) for name in DIFFERENTIABLE},
    "the way to the joint": (
        "torque_scale",
        "torque_offset",
        "actuator_delay",
        "torque_ripple",
    ),
    "friction": (
        "coulomb_friction",
        "viscous_friction",
        "load_friction",
        "stribeck_friction",
        "friction_drift",
    ),
}
ON_EACH_OTHER = [
    ("payload", "encoder_offset", "torque_scale"),
    ("payload", "base_tilt"),
    ("joint_elasticity", "payload"),
]
"""Effects of which one changes what another does to the bodies; columns leave that out."""


@pytest.mark.parametrize(
    "name", [name for name in DIFFERENTIABLE if name not in BENDING]
)
def test_columns_where_no_effect_is_in_use(name: str) -> None:
    compare((), {name})


@pytest.mark.parametrize("names", AROUND.values(), ids=AROUND)
def test_columns_around_values(names: tuple[str, ...]) -> None:
    """Those of the effects in use, and of what is fitted beside almost everything."""
    compare(names, {*names, "coulomb_friction", "torque_offset", "armature"})


@pytest.mark.parametrize(
    "names", [("payload", "viscous_friction"), ("torque_scale", "actuator_lag")]
)
def test_columns_of_effects_that_may_come_next(names: tuple[str, ...]) -> None:
    """Columns of the links are not delayed by a lag in use: an entry is right to a tenth."""
    compare(
        names, {name for name in DIFFERENTIABLE if name not in BENDING}, tolerance=0.1
    )


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
    bodies, motion = synthetic.body(), segment().motion
    regressor = bodies.regressor(motion.q, motion.dq, motion.ddq)
    at = Prediction.of(arm, bodies, motion)
    own = Bodies(bodies, motion, regressor)
    point = LinearisationPoint(at, segment(), own, known, around)
    effect = known.of(name)[0].definition
    x = around[known.block(name)]
    searched = np.array([known.shapes.get(t, ()) for t in known.of(name)]).T
    by_law = effect.columns(point, x, searched)
    by_differences = Effect.columns(effect, point, x, searched)
    assert by_law.shape == (*motion.q.shape, *x.shape)
    for own, other in zip(by_law.T, by_differences.T, strict=True):
        assert np.abs(own - other).max() <= 2e-3 * np.abs(own).max()


@pytest.mark.parametrize("names", ON_EACH_OTHER)
def test_columns_of_effects_that_change_each_other(names: tuple[str, ...]) -> None:
    """To first order only: an entry of X^T W X is right to a tenth, or a fifth where the joints bend."""
    compare(names, set(names), tolerance=0.2 if "joint_elasticity" in names else 0.1)


def compare(names: tuple[str, ...], effects: set[str], tolerance: float = 0.05) -> None:
    around = theta(*names)
    data = FitData(synthetic.arm(), synthetic.body(), [[segment()]], CUTOFF)
    known = terms(*names, *effects)
    linear = Linearisation(data, around, known)
    columns = data.thin(by_differences(known, around, effects), segment())
    torque = segment().torque
    assert torque is not None
    gap = data.thin(torque - predict(known.effects(around)), segment())
    full = np.concatenate([columns, gap[:, :, None]], axis=2)
    doubt = noise_floor(
        CorrectedArm(synthetic.arm(), known.effects(around)),
        synthetic.body(),
        segment(),
    )
    friction = doubt.sticking[:: data.step(segment())]
    weight = 1.0 / (1.0 + (friction / doubt.steady) ** 2)
    expected = np.einsum("tja,tj,tjb->jab", full, weight, full)

    owners = {c: t for t in known.selectable if t.effect in effects for c in t.columns}
    moving = {c for c in owners if np.abs(columns[:, :, c]).max() > 1e-9}
    assert {owners[c].effect for c in moving} == effects, (
        "an effect that does nothing anywhere"
    )
    gram = sum(fold.total for fold in linear.folds)
    for c in owners.keys() - moving:  # the offset of an encoder on a vertical axis, say
        assert np.abs(gram[:, c]).max() < 1e-6 * np.abs(gram).max()
    places = sorted(moving)
    chosen = [*places, known.size]
    size_of = linear.folds[0].total.shape[-1]
    to = np.eye(size_of)[:, [*range(known.size), size_of - 2]]
    to[: known.size, -1] = -around  # the gap at theta_0 is y - A theta_0
    found = (to.T @ gram @ to)[:, chosen][:, :, chosen]
    expected = expected[:, chosen][:, :, chosen]

    size = np.sqrt(np.einsum("jaa->ja", expected))
    by_column = size / np.maximum(size.max(axis=0), 1e-300)
    for j in range(N):
        there = by_column[j] > 1e-3  # joints that an effect hardly moves do not count
        scale = np.where(there, size[j], size.max(axis=0))
        difference = (found[j] - expected[j]) / np.outer(scale, scale)
        worst = np.unravel_index(np.abs(difference).argmax(), difference.shape)
        who = [
            f"{owners[places[w]].effect} {owners[places[w]].joint}"
            if w < len(places)
            else "gap"
            for w in worst
        ]
        largest = float(np.abs(difference).max())
        assert largest < tolerance, (
            f"joint {j + 1}, columns of {who}: {difference[worst]:.3g}"
        )


def test_saturation_counts_the_torque_beyond_the_limit() -> None:
    """In use the gap is that of the torque let through; what was cut off goes with the coordinate 1."""
    torque = segment().torque
    assert torque is not None
    limit = 0.6 * np.abs(torque[:, 1]).max()
    term = PLAIN.of("torque_saturation")[1]
    around = np.zeros(PLAIN.size)
    around[list(term.columns)] = 1.0
    data = FitData(synthetic.arm(), synthetic.body(), [[segment()]], CUTOFF)
    linear = Linearisation(data, around, Terms(N, {term: (limit,)}))
    beyond = np.where(
        np.abs(torque[:, 1]) > limit, torque[:, 1] - limit * np.sign(torque[:, 1]), 0.0
    )[:, None]
    cut, gap = (
        data.thin(x, segment())
        for x in (beyond, torque[:, 1:2] - beyond - predict(())[:, 1:2])
    )
    y, k = gap + cut, term.columns[0]
    gram = sum(fold.total[1] for fold in linear.folds)
    limited = AppliedEffect("torque_saturation", (2,), {"limit": [limit]})
    doubt = noise_floor(
        CorrectedArm(synthetic.arm(), (limited,)), synthetic.body(), segment()
    )
    weight = 1.0 / (
        1.0 + (doubt.sticking[:: data.step(segment()), 1] / doubt.steady[1]) ** 2
    )
    assert gram[k, k] == pytest.approx(float(weight @ cut[:, 0] ** 2), rel=0.05)
    assert gram[k, -2] == pytest.approx(float(weight @ (cut * y)[:, 0]), rel=0.05)


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
    around = np.zeros(PLAIN.size)
    places = PLAIN.block(name)[:, joint - 1]
    around[places] = coordinates
    assert tuple(places) == PLAIN.of(name)[joint - 1].columns
    bent = replace(segment(), torque=predict(PLAIN.effects(around)))
    data = FitData(synthetic.arm(), synthetic.body(), [[bent]], CUTOFF)
    gram = sum(f.total for f in Linearisation(data, np.zeros(PLAIN.size), PLAIN).folds)
    columns, last = gram[:, places[:, None], places], gram[:, places, -2]
    before = gram[:, -2, -2]
    after = (
        before
        - 2 * last @ around[places]
        + np.einsum("jab,a,b->j", columns, around[places], around[places])
    )
    assert before[joint - 1] > 0
    assert after[joint - 1] < 0.15 * before[joint - 1]


def test_terms_of_one_half_do_not_reach_the_other() -> None:
    """A recording is judged in halves: rows add up, and each half has its own."""
    data = FitData(
        synthetic.arm(), synthetic.body(), [[segment()], [segment(), segment()]], CUTOFF
    )
    first, second, of_two, other_of_two = Linearisation(
        data, np.zeros(PLAIN.size), PLAIN
    ).folds
    one, two = (a.total + b.total for a, b in ((first, second), (of_two, other_of_two)))
    np.testing.assert_allclose(two, 2 * one, rtol=1e-6, atol=1e-6 * two.max())
    for half in (
        of_two,
        other_of_two,
    ):  # each is the whole of one of the two equal segments
        np.testing.assert_allclose(half.total, one, rtol=1e-6, atol=1e-6 * one.max())
        np.testing.assert_allclose(half.count, first.count + second.count)
    assert not np.allclose(first.total, second.total, rtol=0.1)


# Values that cannot be.


def test_a_spring_that_rests_where_no_joint_can_be_is_impossible() -> None:
    """It would stand for a constant torque."""
    plain = Terms(synthetic.N)
    term, theta = plain.of("parallel_spring")[1], np.zeros(plain.size)
    lowest = np.full(plain.size, -np.inf)
    for stiffness, rest, impossible in (
        (5.0, 0.4, False),
        (-5.0, -0.4, False),
        (0.1, 10.0, True),
        (0.0, 1.0, True),
    ):
        theta[list(term.columns)] = stiffness, stiffness * rest or rest
        assert (
            term in plain.impossible(theta, frozenset({term}), lowest)
        ) == impossible
