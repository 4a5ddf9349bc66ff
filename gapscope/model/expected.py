"""Expected evidence: how large an effect would have to be for these recordings to show it.

Of an effect of size x along its first coordinate e the right side of the information S on it, beside all that is
shared, is b = S e x + n with n ~ N(0, S). With the prior W of its coordinates and M = (S + W^-2)^-1 its evidence

    g = 1/2 b^T M b - 1/2 log det(I + W S W) + prior odds

has mean 1/2 (x^2 e^T S M S e + tr M S) - 1/2 log det(I + W S W) + prior odds and variance
x^2 e^T S M S M S e + 1/2 tr (M S)^2. It is named if g > 0; with g taken as normal, that has probability p at the x at
which the mean is Phi^-1(p) deviations above 0. Another effect may explain the same: with S the information on both and
diag(M, -M') in the place of M, g is the evidence over that rival. To be seen as well, the effect as it is estimated
must widen the gap of some joint beyond what is left there, r, by v: sqrt(r^2 + c^2 x^2) >= r + v, with c the RMS of
its column.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from scipy.linalg import block_diag
from scipy.optimize import brentq
from scipy.stats import norm

from gapscope.effects.effect import External
from gapscope.model.design import MIN_TORQUE, Design, FreeArm, about
from gapscope.model.difference import Difference, Fit, Weigher
from gapscope.model.equations import (
    Equations,
    carried_over,
    forward,
    lower,
)
from gapscope.model.terms import Candidate, Term

HALF, MOST = 0.5, 0.9
"""Probabilities of being named for which sizes are given. (definition)"""
SCATTER = norm.ppf([HALF, MOST])
"""Deviations of an estimate that is larger with that probability [1]."""
LARGEST = 10.0
"""Largest torque of an effect that is looked at, over the joint's scale [1]. (budget)"""


def expected_entries(
    found: Difference, group: int, visible: float = 0.0, proportional: bool = False
) -> list[dict[str, Any]]:
    """``expected`` of a document: sizes at which each further term of a group would be named beside what was found.

    Args:
        found: what was found.
        group: the group.
        visible: v, over the joint's scale [1].
        proportional: without what does not act in proportion to its size, elasticity and backlash.
    """
    fit, own = found.fit, found.fit.own
    charges = {term: searched.charge for term, searched in found.found.items()}
    weigher = Weigher(own, found.arm, charges, found.belief)
    places = own.joined(fit.chosen)
    unit = own.deviations(fit.chosen, fit.answer.sizes)
    inner = own.products(places, places) * unit[:, None] * unit
    # what was found takes its part of the information on a further term
    back = np.linalg.inv(inner + np.eye(len(places))) * unit[:, None] * unit
    known = weigher.odds(fit.chosen)
    rest = np.sqrt((fit.left**2).mean(axis=0))
    # c x of sqrt(r^2 + c^2 x^2) = r + v
    seen = np.sqrt((rest + visible) ** 2 - rest**2)
    further = [
        one
        for one in own.candidates
        # a limit has no size: it is there or not
        if one.groups == (group,)
        and one not in fit.chosen
        and not one.term.definition.limits
    ]
    every = own.joined(further)
    cross = own.products(places, every)
    information = own.products(every, every) - cross.T @ back @ cross
    ends = np.cumsum([len(one.term.columns) for one in further])
    at = dict(zip(further, np.split(np.arange(len(every)), ends[:-1]), strict=True))
    odds = {one: weigher.odds([*fit.chosen, one]) - known for one in further}
    # as wide as a prior gets, an effect explains all that its columns can
    wide = {
        one: _beside_prior(information, at[one], own.deviations([one], [own.sizes[-1]]))
        for one in further
    }
    entries = []
    for one in further:
        unit, mine = own.design.units[one.term], at[one]
        alone = odds[one] - float(np.log(len(own.sizes)))
        sizes = np.full(len(SCATTER), np.inf)
        # of the prior width that serves it best, as in a search
        for size in own.sizes:
            middle, charge = _beside_prior(
                information, mine, own.deviations([one], [size])
            )
            sizes = np.minimum(sizes, _sizes(information, mine, middle, alone + charge))
        # what is estimated scatters about the size that is there
        middle, charge = wide[one]
        least = _least(own.design, one.term, seen) + SCATTER * np.sqrt(middle[0, 0])
        sizes = np.maximum(sizes, least)
        # what explains most of it in its place, if it can have the value
        explained = {}
        # what is never named needs no rival
        for other in further if np.isfinite(sizes[1]) else ():
            pull = information[at[other], mine[0]]
            value = wide[other][0] @ pull
            if other is not one and not _told_apart(one, other):
                scale = own.design.units[other.term]
                std = np.sqrt(np.diag(wide[other][0])) / scale
                chance = weigher.chance(other.term, value * sizes[1] / scale, std)
                if np.isfinite(chance):
                    explained[other] = float(pull @ value)
        if explained:
            rival = max(explained, key=lambda other: explained[other])
            against, penalty = wide[rival]
            # more likely than the rival and nothing together, if these are as likely
            over = odds[one] + charge - odds[rival] - penalty - float(np.log(2.0))
            both = np.concatenate([mine, at[rival]])
            parts = block_diag(middle, -against)
            sizes = np.maximum(sizes, _sizes(information, both, parts, over))
        searched = found.found.get(one.term)
        shape = np.array(searched.values if searched else ()).reshape(-1, 1)
        if one.term.definition.locally_linear or not proportional:
            entries.append(_entry(one.term, sizes / unit[0], shape))
    return entries


def _told_apart(one: Candidate, other: Candidate) -> bool:
    """Whether two effects are equal to first order: least squares tell them apart, not what is asked here."""
    near = one.term.definition.near_equivalent, other.term.definition.near_equivalent
    return other.effect == near[0] or one.effect == near[1]


def _beside_prior(
    information: np.ndarray, at: np.ndarray, width: np.ndarray
) -> tuple[np.ndarray, float]:
    """M of coordinates with prior deviations W, (k, k), and -1/2 log det(I + W S W) [nats]."""
    own = information[np.ix_(at, at)]
    normal = np.eye(len(width)) + width[:, None] * own * width
    charge = -float(np.linalg.slogdet(normal)[1]) / 2
    return np.linalg.inv(own + np.diag(width**-2.0)), charge


def _entry(term: Term, sizes: np.ndarray, shape: np.ndarray) -> dict[str, Any]:
    """Sizes of a term's first coordinate as those of its first own parameter, with its nonlinear ones, (K, 1)."""
    fitted = term.parametrisation
    apart = ("link", *fitted.nonlinear)
    parameter = next(p for p in term.definition.parameters if p.name not in apart)
    low, high = parameter.bounds
    values: list[float | None] = []
    for size in sizes:
        coordinates = np.zeros((fitted.linear, 1))
        coordinates[0] = size if np.isfinite(size) else 0.0
        value = np.ravel(fitted.values(coordinates, shape)[parameter.name])[0]
        # what cannot be is never named
        possible = np.isfinite(size) and low <= value <= high
        values.append(float(value) if possible else None)
    return {
        "effect": term.effect,
        "joints": [term.joint] if term.joint else [],
        "parameter": parameter.name,
        "unit": parameter.unit,
        "half": values[0],
        "nine_of_ten": values[1],
    }


def _least(made: Design, term: Term, seen: np.ndarray) -> float:
    """Size of a term's first coordinate from which on it makes so much torque on some joint, (n,) over its scale."""
    place, least = made.places[term][0], np.inf
    for j, (x, active) in enumerate(zip(made.columns, made.active, strict=True)):
        column = x[:, active == place]
        size = float(np.sqrt((column**2).mean())) if column.size else 0.0
        if size > MIN_TORQUE:
            least = min(least, float(seen[j]) / size)
    return least


def _sizes(
    information: np.ndarray, at: np.ndarray, middle: np.ndarray, charge: float
) -> np.ndarray:
    """Sizes of the first coordinate at which evidence is above zero with ``HALF`` and ``MOST``; infinite if never.

    Args:
        information: S on all coordinates.
        at: places of those that count, the first one that of the size.
        middle: M of these, less that of a rival, (k, k).
        charge: of the evidence what depends on no data [nats].
    """
    own = information[np.ix_(at, at)]
    told, first = middle @ own, own[0]
    # e^T S M S e and e^T S M S M S e
    slope, spread = first @ middle @ first, first @ middle @ own @ middle @ first
    # no rival explains more of an effect than that itself: of twins prior odds decide
    slope = max(float(slope), 0.0)
    # what of the mean, and below of the variance, does not depend on the size
    mean, variance = charge + np.trace(told) / 2, (told * told.T).sum() / 2

    def above(size: float, deviations: float) -> float:
        """Mean of the evidence less so many deviations of it [nats]."""
        # of twins nothing scatters, but for rounding
        scatter = deviations * np.sqrt(max(spread * size**2 + variance, 0.0))
        return float(slope * size**2 / 2 + mean - scatter)

    return np.array([_rising_root(partial(above, deviations=d)) for d in SCATTER])


def _rising_root(above: Callable[[float], float]) -> float:
    """Where a rising function crosses zero; infinite if beyond ``LARGEST``."""
    if above(0.0) >= 0:
        return 0.0
    if above(LARGEST) < 0:
        return float(np.inf)
    return float(brentq(above, 0.0, LARGEST, xtol=1e-6 * LARGEST))


# What a motion that is only planned would tell between hypotheses of the recordings at hand.
#
# If A holds, the motion has the torque y_A. B says y_B + X d of it, with d ~ N(0, C) what the recordings at hand leave
# open of B, and N the covariance of noise and of what each motion has of its own. The evidence for A that is expected,
#
#     1/2 (y_A - y_B)^T (N + X C X^T)^-1 (y_A - y_B),
#
# is what B cannot follow: the T-criterion for rival models, with what is known already as a part of the data
# [atkinson1975]. The lesser of A, B and B, A counts.


@dataclass(frozen=True)
class ExpectedEvidence:
    """What a planned motion is expected to say between two hypotheses.

    Attributes:
        first, second: their places.
        evidence: for the one that holds [nats].
        joint: the joint that says most, from 1.
    """

    first: int
    second: int
    evidence: float
    joint: int


class Rivals:
    """Hypotheses of the same recordings; a force that one of them has is none of another motion.

    Args:
        arm: what all groups share.
        fits: the hypotheses.

    Attributes:
        effects: whose columns a planned motion needs: those of the hypotheses, and of the data sheet.
    """

    def __init__(self, arm: FreeArm, fits: Sequence[Fit]) -> None:
        self.arm, self.fits = arm, fits
        self._believed = [_believed(fit) for fit in fits]
        self.effects = {one.effect for fit in fits for one in fit.mine}
        for term in fits[0].contrast.design.places:
            if term.parametrisation.data_sheet is not None:
                self.effects.add(term.effect)

    def on(self, made: Design) -> list[ExpectedEvidence]:
        """What a planned motion is expected to say between each two of them, whatever torque its design takes.

        Args:
            made: columns of the motion, those of ``effects``.
        """
        asked = self.fits[0].contrast
        planned = Equations(made, [])
        error = carried_over(asked.error, asked.equations, planned)
        form = zip(made.columns, error.own2, error.noise2, strict=True)
        factors = [
            lower((x * own2) @ x.T / noise2) * np.sqrt(noise2)
            for x, own2, noise2 in form
        ]
        every = [self._predicted(k, made, factors) for k in range(len(self.fits))]
        out = []
        for a, b in itertools.combinations(range(len(every)), 2):
            apart = every[b][0] - every[a][0]
            told = [_beyond(apart, every[k][1]) for k in (a, b)]
            least = min(told, key=lambda by_joint: float(by_joint.sum()))
            joint = int(least.argmax()) + 1
            out.append(ExpectedEvidence(a, b, float(least.sum()) / 2, joint))
        return out

    def _predicted(
        self, number: int, made: Design, factors: Sequence[np.ndarray]
    ) -> tuple[np.ndarray, np.ndarray]:
        """What a hypothesis leaves of the torque, (n, M), and columns of what is open of it, (n, M, Q), over noise."""
        fit, (value, root) = self.fits[number], self._believed[number]
        known, bodies = fit.contrast.design, 10 * self.arm.arm.n_joints
        place_of = np.full(made.size, -1)
        place_of[:bodies] = range(bodies)
        for term, places in made.places.items():
            place_of[places] = known.places.get(term, -1)
        # what the recordings at hand do not show is as it was believed
        new = np.flatnonzero((place_of < 0) & (made.prior > 0))
        as_believed = np.diag(made.prior)[:, new]
        lasting = {
            one: x
            for one, x in fit.values.items()
            if not isinstance(one.term.definition, External)
        }
        gap, columns_of = about(made, self.arm, lasting)
        places_of = dict(zip(fit.values, _split(fit, known.size), strict=True))
        own = [places_of[one] for one in lasting]
        rows, slopes = [], []
        for j, (factor, active) in enumerate(zip(factors, made.active, strict=True)):
            # those that others do not move are the design's
            moved = [
                columns_of[one][j] if one in columns_of else made.of_term(one.term, j)
                for one in lasting
            ]
            x = [made.columns[j], *moved]
            at = np.concatenate([place_of[active], *own])
            left = gap[:, j] - np.hstack(x) @ value[at]
            rows.append(forward(factor, left))
            both = [np.hstack(x) @ root[at], made.columns[j] @ as_believed[active]]
            slopes.append(forward(factor, np.hstack(both)))
        return np.array(rows), np.array(slopes)


def _split(fit: Fit, start: int) -> list[np.ndarray]:
    """Places of the coordinates of each term that groups have, one after the other from a start on."""
    ends = np.cumsum([start, *(len(value) for value in fit.values.values())])
    return [np.arange(a, b) for a, b in itertools.pairwise(ends.tolist())]


def _believed(fit: Fit) -> tuple[np.ndarray, np.ndarray]:
    """Values b of all columns and of terms that groups have, (P + K + 1,), in torque, and root R of their covariance.

    The last one is zero: of what is no column.
    """
    own, made, values = fit.own, fit.contrast.design, fit.values
    shared, more = own.nuisances(values)
    none = np.zeros(0)
    unit = np.concatenate([none, *(made.units[one.term] for one in values)])
    mine = np.concatenate([none, *values.values()]) * unit
    value = np.concatenate([shared + more[0], mine, [0.0]])
    of_shared = own.contrast.nuisance_roots()
    places = own.joined(fit.mine)
    of_own = unit[:, None] * np.linalg.cholesky(fit.answer.covariance)
    whole = np.block(
        [
            [of_shared, -of_shared @ own.back(places) @ of_own],
            [np.zeros((len(places), of_shared.shape[1])), of_own],
        ]
    )
    # unknown functions are of the states that were passed
    waves = [some for of_joint in made.waves for some in of_joint]
    kept = np.setdiff1d(np.arange(len(whole)), np.concatenate(waves))
    root = np.zeros((len(value), len(kept)))
    root[kept] = np.asarray(np.linalg.qr(whole[kept].T, "r")).T
    return value, root


def _beyond(apart: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Squares of a difference, (n, M), beyond what columns of unit deviation can follow, (n, M, Q), by joint, (n,)."""
    x, y = columns.reshape(-1, columns.shape[2]), apart.ravel()
    solved = np.linalg.solve(x.T @ x + np.eye(x.shape[1]), x.T @ y)
    return np.asarray((apart * (apart - columns @ solved)).sum(axis=1))
