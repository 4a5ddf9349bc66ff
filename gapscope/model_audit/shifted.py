"""Whether inertials, or masses alone, belong to the neighbouring links.

An inertial is compared with the link that carries it and with the links before and behind it, as normal distributions
of the same centre and variance: the squared Wasserstein distance is

    d^2 = |c - g|^2 + tr(S) + tr(G) - 2 tr((S^1/2 G S^1/2)^1/2)

with the body's centre c and variance S and the shape's g and G [m^2]; d^2 / tr(G) is the misfit. A link without usable
shapes is taken as a rod from its frame to the next joints, which says less.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import f as fisher

from gapscope.model_audit.description import Description, Inertial, Link
from gapscope.model_audit.finding import Finding
from gapscope.model_audit.geometry import Geometry
from gapscope.model_audit.thresholds import (
    MASS_SHIFT_LEVEL,
    MASS_SHIFT_SPREAD,
    SHIFT_GAIN,
    SHIFT_LINKS,
    SHIFT_SHARE,
)

ROD_THICKNESS = 0.2
"""Standard deviation of a rod's mass across it, as share of the median length of the arm's links."""
FLOOR = 0.05
"""Added to misfits before their logarithm, so that a perfect fit of one link does not decide [1]."""

TIED = 0.01
"""Gains below this are none: neighbours are the same part."""
LEAST_TOLD = 2
"""Fewest links on which the neighbour's inertial has to make a difference."""
ROUNDING = 0.02
"""Spread of logarithms that numbers of two digits have by rounding [1]."""


@dataclass(frozen=True)
class Extent:
    """Where a link is.

    Attributes:
        centre: [m], shape (3,).
        variance: [m^2], shape (3, 3).
        by_shape: from shapes; else from the joints' frames.
        size: trace of the variance without a rod's thickness [m^2]; 0 of a last link without shapes, whose flange says
            nothing of its size.
    """

    centre: np.ndarray
    variance: np.ndarray
    by_shape: bool
    size: float


@dataclass(frozen=True)
class MassSpread:
    """Spread of the logarithm of moments over mass and squared size.

    Attributes:
        step: which neighbour's mass.
        count: number of links.
        now, then: standard deviation with each link's own mass, and with the neighbour's [1].
        p: of an F test that the neighbour's is no better [1].
    """

    step: int
    count: int
    now: float
    then: float
    p: float


def check_shifted(
    description: Description, geometries: Mapping[str, Geometry]
) -> Iterator[Finding]:
    """Inertials, or masses alone, that fit better if each is taken from the neighbouring link."""
    extents = _extents(description, geometries)
    # a converter goes through the links branch by branch, or as the file lists them
    orders = {
        tuple(link.name for link in order): [x for x in order if x.inertial is not None]
        for order in (description.in_tree_order(), description.links)
    }
    shifts = [shift for links in orders.values() for shift in _whole(links, extents)]
    if shifts:
        yield max(shifts, key=lambda shift: shift.size)
        return
    for links in orders.values():
        for found in _masses(links, extents):
            yield found
            return


def misfit(inertial: Inertial, extent: Extent) -> float:
    """d^2 / tr(G) of a body and the extent of a link [1]."""
    own, shape = inertial.variance, extent.variance
    root = _root(own)
    overlap = np.trace(_root(root @ shape @ root))
    offset = float(np.sum((inertial.com - extent.centre) ** 2))
    total = np.trace(own) + np.trace(shape)
    return max(0.0, float((offset + total - 2 * overlap) / np.trace(shape)))


def _root(matrix: np.ndarray) -> np.ndarray:
    """Square root of a symmetric matrix whose eigenvalues are not negative but for rounding."""
    values, vectors = np.linalg.eigh(matrix)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)) @ vectors.T)


def _whole(links: Sequence[Link], extents: Mapping[str, Extent]) -> Iterator[Finding]:
    """The whole inertials are those of the link before or behind, in this order of the links that have one."""
    bodies = [link.inertial for link in links if link.inertial is not None]
    places = [extents.get(link.name) for link in links]
    best: tuple[float, float, int, int] | None = None
    for step in (1, -1):
        fits = [
            _fits(bodies, places, own, own + step)
            for own in range(len(links))
            if 0 <= own + step < len(links)
        ]
        gains = np.array([gain for gain in fits if gain is not None])
        # neighbours with the same inertial say nothing
        told = gains[np.abs(gains) > TIED]
        if len(gains) < SHIFT_LINKS or len(told) < LEAST_TOLD:
            continue
        mean, share = float(gains.mean()), float(np.mean(told > 0))
        if best is None or mean > best[0]:
            best = mean, share, step, len(told)
    if best is None or best[0] < SHIFT_GAIN or best[1] < SHIFT_SHARE:
        return
    mean, share, step, count = best
    beyond = "next" if step > 0 else "previous"
    yield _shifted(
        links,
        "shifted_inertials",
        places,
        f"the inertials look shifted by one link: {share:.0%} of {count} links are fitted better by the inertial of "
        f"the {beyond} link, whose misfit is {np.exp(-mean):.2g} times that of their own",
        "each inertial within its own link",
        f"give each link the <inertial> of the {beyond} one (converters that lose or add the base do this), and run "
        "the audit again",
        mean,
    )


def _fits(
    bodies: Sequence[Inertial], places: Sequence[Extent | None], own: int, giver: int
) -> float | None:
    """By how much the giver's inertial fits a link better than its own, as a logarithm; ``None`` if not known."""
    extent = places[own]
    if extent is None or not (bodies[own].is_body and bodies[giver].is_body):
        return None
    now, then = (misfit(bodies[k], extent) for k in (own, giver))
    return float(np.log((FLOOR + now) / (FLOOR + then)))


def _masses(links: Sequence[Link], extents: Mapping[str, Extent]) -> Iterator[Finding]:
    """Only the masses are those of the link before or behind: moments per mass then follow the links' sizes.

    With s_i = ln(tr(I_i) / L_i^2), L the links' sizes, and masses m, arms have similar s_i - ln(m_i) on all links; the
    F test compares its spread with that of s_i - ln(m_k), k the neighbour.
    """
    bodies = [link.inertial for link in links if link.inertial is not None]
    places = [extents.get(link.name) for link in links]
    spreads = [
        spread
        for step in (1, -1)
        if (spread := _mass_spread(bodies, places, step)) is not None
    ]
    best = min(spreads, key=lambda spread: spread.p, default=None)
    if best is None or best.p > MASS_SHIFT_LEVEL or best.then > MASS_SHIFT_SPREAD:
        return
    now, then = best.now, best.then
    beyond = "next" if best.step > 0 else "previous"
    yield _shifted(
        links,
        "shifted_masses",
        places,
        f"the masses look shifted by one link: moments over mass and size differ by {np.expm1(now):.0%} between "
        f"{best.count} links, with the mass of the {beyond} link each by {np.expm1(then):.0%} (p = {best.p:.1g}); "
        "centres and moments are in place",
        "mass and moments of the same link",
        f"give each link the <mass> of the {beyond} one, compare with the data sheet, and run the audit again",
        float(np.log(now / then)),
    )


def _mass_spread(
    bodies: Sequence[Inertial], places: Sequence[Extent | None], step: int
) -> MassSpread | None:
    """How moments over mass and size spread, now and with the masses ``step`` links further; ``None`` of few links."""
    sizes, own_masses, other_masses = [], [], []
    for own, extent in enumerate(places):
        giver = own + step
        if extent is None or not extent.size or not 0 <= giver < len(bodies):
            continue
        # moments that no body has say nothing of the mass
        if possible(bodies[own]) and bodies[giver].is_body:
            sizes.append(np.log(np.trace(bodies[own].moments) / extent.size))
            own_masses.append(np.log(bodies[own].mass))
            other_masses.append(np.log(bodies[giver].mass))
    count = len(sizes)
    if count < SHIFT_LINKS + 1 or np.ptp(own_masses) == 0:
        return None
    now = float(np.std(np.subtract(sizes, own_masses), ddof=1))
    then = float(np.std(np.subtract(sizes, other_masses), ddof=1))
    then = max(ROUNDING, then)
    p = float(fisher.sf((now / then) ** 2, count - 1, count - 1))
    return MassSpread(step, count, now, then, p)


def possible(inertial: Inertial) -> bool:
    """Whether a body has such moments, the triangle inequality included."""
    if not inertial.is_body:
        return False
    moments = np.linalg.eigvalsh(inertial.moments)
    return bool(moments[2] <= 1.01 * (moments[0] + moments[1]))


def _shifted(
    links: Sequence[Link],
    kind: str,
    places: Sequence[Extent | None],
    found: str,
    expected: str,
    remedy: str,
    size: float,
) -> Finding:
    by_shape = [place.by_shape for place in places if place is not None]
    if not all(by_shape):
        found += "; judged by the joints' frames where shapes are missing, which is less certain"
    line = links[0].inertial.line if links[0].inertial else 0
    return Finding("implausible", kind, "", line, found, expected, remedy, 10.0 + size)


def _extents(
    description: Description, geometries: Mapping[str, Geometry]
) -> dict[str, Extent]:
    """Extent of each link of which something is known."""
    rods = {
        link.name: points
        for link in description.links
        if len(points := _frames(description, link)) > 1
    }
    lengths = [np.ptp(points, axis=0).max() for points in rods.values()]
    across = ROD_THICKNESS * float(np.median(lengths)) if lengths else 0.0
    found = {}
    for name, points in rods.items():
        # of a rod the variance is L^2 / 12, of its two ends L^2 / 4
        along = np.cov(points.T, bias=True) / 3
        variance = along + across**2 * np.eye(3)
        size = float(np.trace(along)) if _carries_a_joint(description, name) else 0.0
        found[name] = Extent(points.mean(axis=0), variance, False, size)
    for name, geometry in geometries.items():
        size = float(np.trace(geometry.variance))
        found[name] = Extent(geometry.centre, geometry.variance, True, size)
    return found


def _carries_a_joint(description: Description, link: str) -> bool:
    """Whether a link, or what is fixed to it, holds a moving joint."""
    parts = [part.name for part, _ in description.rigid_part(link)]
    return any(joint.parent in parts for joint in description.moving)


def _frames(description: Description, link: Link) -> np.ndarray:
    """Places of a link's frame and of the joints that it holds, in its frame [m], shape (K, 3), each once."""
    points = [np.zeros(3)]
    for part, place in description.rigid_part(link.name):
        points += [
            (place * joint.place).translation
            for joint in description.joints_below(part.name)
        ]
    return np.unique(np.round(points, 4), axis=0)
