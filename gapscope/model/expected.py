"""Expected evidence: how large an effect would have to be for these recordings to show it.

Of an effect of size x along its first coordinate e the right side of the information S on it, beside all that is
shared, is b = S e x + n with n ~ N(0, S). With the prior W of its coordinates and M = (S + W^-2)^-1 its evidence

    g = 1/2 b^T M b - 1/2 log det(I + W S W) + prior odds

has mean 1/2 (x^2 e^T S M S e + tr M S) - 1/2 log det(I + W S W) + prior odds and variance
x^2 e^T S M S M S e + 1/2 tr (M S)^2. It is named if g > 0; with g taken as normal, that has probability p at the x at
which the mean is Phi^-1(p) deviations above 0. To be seen as well, the effect as it is estimated must widen
the gap of some joint beyond what is left there, r, by v: sqrt(r^2 + c^2 x^2) >= r + v, with c the RMS of its column.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq
from scipy.stats import norm

from gapscope.effects.effect import External
from gapscope.model.design import MIN_TORQUE, Design, FreeArm, about
from gapscope.model.difference import Difference, Fit, Weigher
from gapscope.model.equations import Equations, carried_over, forward, lower
from gapscope.model.terms import Term

HALF, MOST = 0.5, 0.9
"""Probabilities of being named for which sizes are given. (definition)"""
SCATTER = norm.ppf([HALF, MOST])
"""Deviations of an estimate that is larger with that probability [1]."""
LARGEST = 10.0
"""Largest torque of an effect that is looked at, over the joint's scale [1]. (budget)"""


@dataclass(frozen=True)
class Detectable:
    """Sizes of a term's first coordinate at which it would be named.

    Attributes:
        term: the term.
        half: named with a probability of 0.5.
        most: named with a probability of 0.9.
        shape: its nonlinear parameters, if it has some.
    """

    term: Term
    half: float
    most: float
    shape: tuple[float, ...] = ()


def detectable(
    found: Difference, group: int, visible: float = 0.0
) -> Iterator[Detectable]:
    """Sizes of each further term of a group at which it would be named beside what was found.

    Args:
        found: what was found.
        group: the group.
        visible: v, over the joint's scale [1].
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
    for one in own.candidates:
        mine = own.places(one)
        # a limit has no size: it is there or not
        if one.groups != (group,) or one in fit.chosen or one.term.definition.limits:
            continue
        cross = own.products(places, mine)
        information = own.products(mine, mine) - cross.T @ back @ cross
        odds = weigher.odds([*fit.chosen, one]) - known - float(np.log(len(own.sizes)))
        widths = [own.deviations([one], [size]) for size in own.sizes]
        # of the prior width that serves it best, as in a search
        sizes = [
            min(_size(information, width, odds, p) for width in widths)
            for p in (HALF, MOST)
        ]
        # what is estimated scatters about the size that is there
        told = np.linalg.inv(information + np.diag(widths[-1] ** -2.0))[0, 0]
        least = _least(own.design, one.term, seen) + SCATTER * np.sqrt(told)
        half, most = np.maximum(sizes, least) / own.design.units[one.term][0]
        searched = found.found.get(one.term)
        shape = searched.values if searched else ()
        yield Detectable(one.term, float(half), float(most), tuple(shape))


def _least(made: Design, term: Term, seen: np.ndarray) -> float:
    """Size of a term's first coordinate from which on it makes so much torque on some joint, (n,) over its scale."""
    place, least = made.places[term][0], np.inf
    for j, (x, active) in enumerate(zip(made.columns, made.active, strict=True)):
        column = x[:, active == place]
        size = float(np.sqrt((column**2).mean())) if column.size else 0.0
        if size > MIN_TORQUE:
            least = min(least, float(seen[j]) / size)
    return least


def _size(
    information: np.ndarray, width: np.ndarray, odds: float, probability: float
) -> float:
    """Size of the first coordinate at which evidence is above zero with a probability; infinite if it never is."""
    count = len(width)
    middle = np.linalg.inv(information + np.diag(width**-2.0))
    told = middle @ information
    first = information[0]
    # e^T S M S e and e^T S M S M S e
    slope, spread = (
        first @ middle @ first,
        first @ middle @ information @ middle @ first,
    )
    normal = np.eye(count) + width[:, None] * information * width
    # what of the mean, and below of the variance, does not depend on the size
    charge = odds - float(np.linalg.slogdet(normal)[1]) / 2 + float(np.trace(told)) / 2
    scatter = float((told * told.T).sum()) / 2
    deviations = float(norm.ppf(probability))

    def above(size: float) -> float:
        """Mean of the evidence less so many deviations of it [nats]."""
        mean = slope * size**2 / 2 + charge
        return float(mean - deviations * np.sqrt(spread * size**2 + scatter))

    return rising_root(above, LARGEST) if slope > 0 else float(np.inf)


def rising_root(above: Callable[[float], float], largest: float) -> float:
    """Where a rising function crosses zero; infinite if beyond the largest size."""
    if above(largest) < 0:
        return float(np.inf)
    if above(0.0) >= 0:
        return 0.0
    return float(brentq(above, 0.0, largest, xtol=1e-6 * largest))


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
    """Hypotheses of the same recordings, none of whose terms is of one recording alone on another motion.

    Args:
        arm: what all groups share.
        fits: the hypotheses, H of them.
    """

    def __init__(self, arm: FreeArm, fits: Sequence[Fit]) -> None:
        self.arm, self.fits = arm, fits
        effects = {one.effect for fit in fits for one in fit.mine}
        places = fits[0].contrast.design.places
        sheet = {t.effect for t in places if t.parametrisation.data_sheet is not None}
        self.effects = effects | sheet
        bodies = np.arange(10 * arm.arm.n_joints)
        asked = [own for term, own in places.items() if term.effect in self.effects]
        self._asked = np.concatenate([bodies, *asked])
        self._left_open = [_left_open(fit, self._asked) for fit in fits]

    def on(self, made: Design) -> list[ExpectedEvidence]:
        """What a planned motion is expected to say between each two of them, whatever torque its design takes.

        Args:
            made: columns of the motion, those of ``effects``.
        """
        contrast = self.fits[0].contrast
        error = carried_over(
            contrast.error,
            contrast.equations,
            Equations(made, [[] for _ in made.gap.T]),
        )
        factors = [
            lower((x * own2) @ x.T / noise2) * np.sqrt(noise2)
            for x, own2, noise2 in zip(
                made.columns, error.own2, error.noise2, strict=True
            )
        ]
        every = [self._predicted(h, made, factors) for h in range(len(self.fits))]
        out = []
        for a, b in itertools.combinations(range(len(every)), 2):
            apart = every[b][0] - every[a][0]
            told = [_beyond(apart, columns) for _, columns in (every[a], every[b])]
            least = min(told, key=lambda each: float(each.sum()))
            joint = int(least.argmax()) + 1
            out.append(ExpectedEvidence(a, b, float(least.sum()) / 2, joint))
        return out

    def _predicted(
        self, number: int, made: Design, factors: Sequence[np.ndarray]
    ) -> tuple[np.ndarray, np.ndarray]:
        """What a hypothesis leaves of the torque, (n, M), and columns of what is open of it, (n, M, Q), over noise."""
        fit, root = self.fits[number], self._left_open[number]
        known, count = fit.contrast.design, len(self._asked)
        values = {
            one: value
            for one, value in fit.values.items()
            if not isinstance(one.term.definition, External)
        }
        gap, columns_of = about(made, self.arm, values)
        # what the recordings at hand do not show is as it was believed
        place_of = np.full(made.size, -1)
        bodies = 10 * self.arm.arm.n_joints
        place_of[:bodies] = range(bodies)
        for term, places in made.places.items():
            if term in known.places:
                place_of[places] = known.places[term]
        told = place_of >= 0
        shared, own = fit.own.nuisances(fit.values)
        value = np.where(told, (shared + own[0])[place_of], 0.0)
        row_of = {place: row for row, place in enumerate(self._asked.tolist())}
        new = np.flatnonzero(~told & (made.prior > 0))
        open_ = np.zeros((made.size, root.shape[1] + len(new)))
        rows_of = [row_of[place] for place in place_of[told].tolist()]
        open_[told, : root.shape[1]] = root[rows_of]
        open_[new, root.shape[1] + np.arange(len(new))] = made.prior[new]
        left = gap - made.shared_torque(value)
        starts = dict(zip(fit.values, _places_of(fit), strict=True))
        rows, slopes = [], []
        for j, factor in enumerate(factors):
            x = made.columns[j] @ open_[made.active[j]]
            for one, columns in columns_of.items():
                scaled = values[one] * made.units[one.term]
                left[:, j] -= columns[j] @ scaled
                x[:, : root.shape[1]] += columns[j] @ root[count + starts[one]]
            rows.append(forward(factor, left[:, j]))
            slopes.append(forward(factor, x))
        return np.array(rows), np.array(slopes)


def _places_of(fit: Fit) -> list[np.ndarray]:
    """Places of the coordinates of each term that groups have among those of all of them."""
    ends = np.cumsum([len(value) for value in fit.values.values()])
    return np.split(np.arange(ends[-1]), ends[:-1]) if len(ends) else []


def _left_open(fit: Fit, asked: np.ndarray) -> np.ndarray:
    """Root R of the covariance R R^T of some columns and of the terms that groups have, in torque, (P + K, Q)."""
    own, units = fit.own, fit.contrast.design.units
    shared = own.contrast.nuisance_roots()[asked]
    if not fit.mine:
        return np.asarray(np.linalg.qr(shared.T, "r")).T
    scale = np.concatenate([units[one.term] for one in fit.mine])
    places = [k for k, one in enumerate(fit.chosen) if not one.everybody]
    ends = np.cumsum([0, *(len(fit.answer.values[one]) for one in fit.chosen)])
    mine = np.concatenate([np.arange(ends[k], ends[k + 1]) for k in places])
    covariance = fit.answer.covariance[np.ix_(mine, mine)] * scale[:, None] * scale
    power, axes = np.linalg.eigh(covariance)
    root = axes * np.sqrt(np.maximum(power, 0.0))
    moved = -shared @ own.back(own.joined(fit.mine)) @ root
    none = np.zeros((len(root), shared.shape[1]))
    whole = np.block([[shared, moved], [none, root]])
    return np.asarray(np.linalg.qr(whole.T, "r")).T


def _beyond(apart: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Squares of a difference, (n, M), beyond what columns of unit deviation can follow, (n, M, Q), by joint, (n,)."""
    x, y = columns.reshape(-1, columns.shape[2]), apart.ravel()
    solved = np.linalg.solve(x.T @ x + np.eye(x.shape[1]), x.T @ y)
    return np.asarray((apart * (apart - columns @ solved)).sum(axis=1))
