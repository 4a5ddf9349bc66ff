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

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq
from scipy.stats import norm

from gapscope.model.design import MIN_TORQUE, Design
from gapscope.model.difference import Difference, Weigher
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
