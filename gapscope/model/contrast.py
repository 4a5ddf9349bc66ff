"""A contrast: what does one group of data need that the others do not?

Groups g have coefficients beta + delta_g of the columns: beta is shared by all, with a prior that may be wide, delta_g
is what a group has of its own. What each motion has of its own (form error) is eliminated first, so that a group is its
information on its coefficients, M_g and m_g. Of a set S of
columns that are a group's own, with prior deviations u, beside all that is shared,

    log evidence = 1/2 b^T (S_SS + U^-2)^-1 b - 1/2 log det(I + U S_SS U)

where S_SS and b are the information on the own columns when everything shared is eliminated: what explains all groups
is no difference. The size of an effect is not known beforehand: u is one of ``SIZES``, each as likely.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import solve_triangular

from gapscope.model.equations import (
    Eliminated,
    Equations,
    eliminated,
    forward,
    lower,
)
from gapscope.model.form_error import FormError
from gapscope.model.terms import Term

SIZES = np.array([0.01, 0.03, 0.1, 0.3, 1.0])
"""Prior deviations of an effect, in RMS torque over the joint's scale [1]: from what is not worth a name to all of it.
"""


LARGEST = 2.0
"""Prior deviation of an effect, over its usual size, at most [1]."""


@dataclass(frozen=True)
class Beside:
    """Further columns that one group has of its own, K of them.

    Attributes:
        cross: products with the columns of the group, what motions have of their own eliminated, (P, K).
        gram, right: information on them beside all that is shared, (K, K), and its right side, (K,).
        back: L^-1 U times their products with what is shared.
    """

    cross: np.ndarray
    gram: np.ndarray
    right: np.ndarray
    back: np.ndarray


class Contrast:
    """The information of groups, and what follows for columns that one group has of its own.

    Args:
        equations: of all groups.
        error: noise and form error.
        day: of a group, prior variance of what differs from day to day of each column, (P,).
        grown: of a joint from 0 and a motion, by how much more variance form error has there than elsewhere [1].

    Attributes:
        motions: per joint its motions, what they have of their own eliminated.
        gap: that is explained [1], (M, n).
    """

    def __init__(
        self,
        equations: Equations,
        error: FormError,
        day: Mapping[int, np.ndarray],
        grown: Mapping[tuple[int, int], float],
    ) -> None:
        self.equations, self.design, self.error = equations, equations.design, error
        self.groups = int(self.design.rows.group.max()) + 1
        self.gap = self.design.gap
        self.motions = [
            [
                eliminated(
                    cell,
                    error.own2[j] * grown.get((j, cell.motion), 1.0),
                    error.noise2[j],
                )
                for cell in cells
            ]
            for j, cells in enumerate(equations.cells)
        ]
        self._gram = self._information()
        self._right = self._right_sides()
        self._eliminate_nuisances(day)

    def _information(self) -> np.ndarray:
        """Information of each group on its coefficients, (G, P, P)."""
        size = self.design.size
        gram = np.zeros((self.groups, size, size))
        for j, motions in enumerate(self.motions):
            places = np.ix_(self.design.active[j], self.design.active[j])
            for one in motions:
                gram[one.cell.group][places] += one.information
        return gram

    def _right_sides(self) -> np.ndarray:
        """Right side of that information, (G, P)."""
        right = np.zeros((self.groups, self.design.size))
        for j, motions in enumerate(self.motions):
            active = self.design.active[j]
            for one in motions:
                right[one.cell.group, active] += one.pull
        return right

    def _eliminate_nuisances(self, day: Mapping[int, np.ndarray]) -> None:
        """Eliminate what is shared, and what differs from day to day."""
        prior = self.design.prior
        self._shared = np.flatnonzero(prior > 0)
        self._days = [(g, p) for g, own in day.items() for p in np.flatnonzero(own > 0)]
        of_days = [np.sqrt(day[g][p]) for g, p in self._days]
        self._units = np.array([*prior[self._shared], *of_days])
        by_shared = self._gram[:, self._shared]
        by_days = np.zeros((len(self._days), self.groups, self.design.size))
        for row, (g, p) in zip(by_days, self._days, strict=True):
            row[g] = self._gram[g, p]
        # (nuisances, G, P): products of each nuisance with the columns of each group
        self._cross = np.concatenate([by_shared.transpose(1, 0, 2), by_days])
        normal = self._of_nuisances(self._cross.transpose(1, 2, 0))
        self._factor = lower(normal * self._units[:, None] * self._units)
        self._solved = self._solve()

    def _of_nuisances(self, of_groups: np.ndarray) -> np.ndarray:
        """Products of the nuisances with something, from those of the columns of each group, (G, P, ...)."""
        shared = of_groups[:, self._shared].sum(axis=0)
        days = [of_groups[g, p][None] for g, p in self._days]
        return np.concatenate([shared, *days])

    def _solve(self) -> np.ndarray:
        right = self._units * self._of_nuisances(self._right)
        count = len(self._shared)
        # the prior counts from the arm that was believed
        right[:count] -= self.design.taken[self._shared] / self._units[:count]
        return forward(self._factor, right)

    def nuisance_rows(self, of_groups: np.ndarray) -> np.ndarray:
        """L^-1 U times the products of the nuisances with columns whose products with each group's are (G, P, K)."""
        return forward(
            self._factor, self._units[:, None] * self._of_nuisances(of_groups)
        )

    def without_nuisances(
        self, group: int, everybody: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Information on a group's own columns, and on further ones that all have, beside all that is shared.

        Args:
            group: the group.
            everybody: places of the further columns, (S,).

        Returns:
            The information, (P + S, P + S), its right side, (P + S,), and L^-1 U times their products with what is
            shared.
        """
        own = self._gram[group]
        both = self._gram.sum(axis=0)[np.ix_(everybody, everybody)]
        gram = np.block([[own, own[:, everybody]], [own[everybody], both]])
        of_all = self._right.sum(axis=0)[everybody]
        right = np.concatenate([self._right[group], of_all])
        cross = np.hstack(
            [self._cross[:, group], self._cross.sum(axis=1)[:, everybody]]
        )
        back = forward(self._factor, self._units[:, None] * cross)
        return gram - back.T @ back, right - back.T @ self._solved, back

    @property
    def evidence(self) -> float:
        """Log probability of the gaps if no group has anything of its own [nats], but for a constant."""
        total = _half_log(self._factor, self._solved)
        for motions, noise2 in zip(self.motions, self.error.noise2, strict=True):
            for one in motions:
                total += _half_log(one.factor, one.right) - one.cell.power / noise2 / 2
        return total

    @property
    def solved(self) -> np.ndarray:
        """L^-1 U times the right side of the nuisances."""
        return self._solved

    def for_gap(self, gap: np.ndarray) -> Contrast:
        """The same question to another gap of the same columns, (M, n): that of another arm."""
        other = copy(self)
        other.gap = gap
        other.motions = [
            [self._with_gap(j, one, gap[:, j]) for one in motions]
            for j, motions in enumerate(self.motions)
        ]
        other._right = other._right_sides()
        other._solved = other._solve()
        return other

    def _with_gap(self, j: int, one: Eliminated, gap: np.ndarray) -> Eliminated:
        """One motion of a joint with another gap, (M,)."""
        rows = one.cell.rows
        noise = self.equations.shared_noise(j)[rows].sum(axis=0)
        right = self.design.columns[j][rows].T @ gap[rows] - noise
        cell = replace(one.cell, right=right, power=float(gap[rows] @ gap[rows]))
        own = one.size * right[one.free] / self.error.noise2[j]
        return replace(one, cell=cell, right=forward(one.factor, own))

    def beside(self, columns: Sequence[np.ndarray], group: int) -> Beside:
        """What K further columns that one group has of its own have in common with all else.

        Args:
            columns: per joint over its scale, (M, K), on the rows of the group.
            group: the group.
        """
        count = columns[0].shape[1]
        cross = np.zeros((self.groups, self.design.size, count))
        gram, right = np.zeros((count, count)), np.zeros(count)
        for j, motions in enumerate(self.motions):
            active, noise2 = self.design.active[j], self.error.noise2[j]
            for one in motions:
                rows = one.cell.rows
                x = columns[j][rows]
                if one.cell.group != group or not x.any():
                    continue
                products = self.design.columns[j][rows].T @ x / noise2
                inner = one.inner(products)
                gram += x.T @ x / noise2 - inner.T @ inner
                right += x.T @ self.gap[rows, j] / noise2 - inner.T @ one.right
                cross[group, active] += products - one.cross.T @ inner
        back = self.nuisance_rows(cross)
        return Beside(
            cross[group], gram - back.T @ back, right - back.T @ self._solved, back
        )

    def growth_gains(
        self, group: int, growths: Sequence[float]
    ) -> dict[tuple[int, int, float], float]:
        """About what more form error explains, by joint from 0, motion of a group, and growth of its variance [nats].

        What is shared is held where it is likeliest.
        """
        shared, out = self.shared_values(), {}
        for j, motions in enumerate(self.motions):
            noise2, beta = self.error.noise2[j], shared[self.design.active[j]]
            for one in motions:
                cell = one.cell
                if cell.group != group:
                    continue
                left = replace(cell, right=cell.right - cell.gram @ beta)
                own2 = np.zeros(len(cell.right))
                own2[one.free] = one.size**2
                known = eliminated(left, own2, noise2)
                before = _half_log(known.factor, known.right)
                for growth in growths:
                    tried = eliminated(left, own2 * growth, noise2)
                    gain = _half_log(tried.factor, tried.right) - before
                    out[j, cell.motion, growth] = gain
        return out

    def values_of(self, groups: Collection[int]) -> np.ndarray:
        """Likeliest values of what is shared by what some groups say, (P,)."""
        chosen, shared = list(groups), self._shared
        unit = self.design.prior[shared]
        gram = self._gram[chosen].sum(axis=0)[np.ix_(shared, shared)]
        right = self._right[chosen].sum(axis=0)[shared]
        factor = lower(gram * unit[:, None] * unit)
        solved = forward(factor, unit * right - self.design.taken[shared] / unit)
        value = np.zeros(self.design.size)
        value[shared] = unit * solve_triangular(factor.T, solved, check_finite=False)
        return value

    def shared_values(self) -> np.ndarray:
        """Likeliest values of what is shared if nobody has anything of its own, (P,)."""
        value = np.zeros(self.design.size)
        back = solve_triangular(self._factor.T, self._solved, check_finite=False)
        value[self._shared] = (self._units * back)[: len(self._shared)]
        return value


def _half_log(factor: np.ndarray, solved: np.ndarray) -> float:
    """1/2 b^T (I + A)^-1 b - 1/2 log det(I + A) from L L^T = I + A and L^-1 b."""
    return float(solved @ solved) / 2 - float(np.log(np.diag(factor)).sum())


@dataclass(frozen=True)
class Candidate:
    """A term that a group has of its own, or one with a searched form that everybody has."""

    term: Term
    everybody: bool = False

    @property
    def effect(self) -> str:
        """Name of its effect."""
        return self.term.effect


@dataclass(frozen=True)
class Answer:
    """Values of a set of candidates.

    Attributes:
        evidence: of the set over that of none [nats].
        values: of each candidate, (linear,), in its own units.
        covariance: of all of them, in the order of the candidates.
        sizes: prior deviation of each, one of ``SIZES``.
    """

    evidence: float
    values: Mapping[Candidate, np.ndarray]
    covariance: np.ndarray
    sizes: tuple[float, ...]

    def deviation(self, candidate: Candidate) -> np.ndarray:
        """Standard deviations of the values of a candidate, (linear,)."""
        at = 0
        for one, value in self.values.items():
            if one == candidate:
                own = slice(at, at + len(value))
                return np.asarray(np.sqrt(np.diag(self.covariance)[own]))
            at += len(value)
        raise KeyError(candidate)


class OwnTerms:
    """Evidence and values of sets of candidates of one group.

    Attributes:
        places: of the coordinates of each candidate.
    """

    def __init__(
        self,
        contrast: Contrast,
        group: int,
        about: Mapping[Term, list[np.ndarray]] | None = None,
    ) -> None:
        """About: columns of terms about their own values, over the joints' scale, per joint (M, linear)."""
        made = self.design = contrast.design
        self._group, self._about = group, about or {}
        searched = [t for t in made.places if t.parametrisation.nonlinear and t.joint]
        everybody = [made.places[t] for t in searched]
        joined = np.concatenate([*everybody, np.zeros(0, dtype=int)]).astype(int)
        self._columns = np.append(joined, 0)
        self.gram, self.right, self.back = contrast.without_nuisances(group, joined)
        self.places = {Candidate(t): own for t, own in made.places.items()}
        count = made.size
        for term, own in zip(searched, everybody, strict=True):
            self.places[Candidate(term, everybody=True)] = np.arange(
                count, count + len(own)
            )
            count += len(own)
        if about:
            self._replaced(contrast, group, about, count)

    def _replaced(
        self,
        contrast: Contrast,
        group: int,
        about: Mapping[Term, list[np.ndarray]],
        count: int,
    ) -> None:
        """Put columns about their own values in the place of those of some terms."""
        joints = range(len(self.design.active))
        joined = [np.hstack([about[t][j] for t in about]) for j in joints]
        further = contrast.beside(joined, group)
        cross = self.rows(further.cross, np.arange(count)) - self.back.T @ further.back
        self.gram = np.vstack(
            [np.hstack([self.gram, cross]), np.hstack([cross.T, further.gram])]
        )
        self.right = np.concatenate([self.right, further.right])
        self.back = np.hstack([self.back, further.back])
        for term, columns in about.items():
            width = columns[0].shape[1]
            self.places[Candidate(term)] = np.arange(count, count + width)
            count += width

    def deviations(
        self, some: Sequence[Candidate], sizes: Sequence[float]
    ) -> np.ndarray:
        """Prior deviations of the coordinates of some candidates, of a size each."""
        own = [
            self._widths(one.term, size) for one, size in zip(some, sizes, strict=True)
        ]
        return np.concatenate(own) if own else np.zeros(0)

    def _widths(self, term: Term, size: float) -> np.ndarray:
        """Prior deviations of a term's coordinates of a size, in torque, (linear,)."""
        unit, fitted = self.design.units[term], term.parametrisation
        widths = np.full(len(unit), size)
        if fitted.proportions is not None:
            torque = unit * np.array(fitted.proportions)
            widths = size * torque / torque.max()
        # no arm has much more of an effect than is usual where it is one
        return np.minimum(widths, LARGEST * fitted.usual * unit)

    def torque(self, values: Mapping[Candidate, np.ndarray]) -> np.ndarray:
        """What values of candidates do to the torque, over the joints' scale [1], (M, n)."""
        made, out = self.design, np.zeros_like(self.design.gap)
        mine = made.rows.of(self._group)
        for one, value in values.items():
            scaled = value * made.units[one.term]
            if one.term in self._about and not one.everybody:
                out += np.stack([x @ scaled for x in self._about[one.term]], axis=1)
                continue
            torque = made.torque(one.term, value)
            out += torque if one.everybody else torque * mine[:, None]
        return out

    def joined(self, some: Sequence[Candidate]) -> np.ndarray:
        """Places of the coordinates of some candidates."""
        own = [self.places[one] for one in some]
        return np.concatenate(own) if own else np.zeros(0, dtype=int)

    def rows(self, of_group: np.ndarray, places: np.ndarray) -> np.ndarray:
        """Products of coordinates with columns on the group's rows alone, from those of its columns, (P, K)."""
        size = self.design.size
        of_all = self._columns[np.maximum(places - size, -1)]
        return np.asarray(of_group[np.where(places < size, places, of_all)])

    def evidence(self, terms: Sequence[Candidate], sizes: Sequence[float]) -> float:
        """Log evidence of terms of given sizes over none [nats]."""
        return self._fit(terms, sizes)[0]

    def _fit(
        self, terms: Sequence[Candidate], sizes: Sequence[float]
    ) -> tuple[float, np.ndarray, np.ndarray, np.ndarray]:
        places = self.joined(terms)
        unit = self.deviations(terms, sizes)
        factor = lower(self.gram[np.ix_(places, places)] * unit[:, None] * unit)
        solved = forward(factor, unit * self.right[places])
        return _half_log(factor, solved), solved, factor, unit

    def answer(
        self, terms: Sequence[Candidate], sizes: Sequence[float] | None = None
    ) -> Answer:
        """Evidence and values of a set, each term of its likeliest size."""
        found = list(sizes) if sizes is not None else [float(SIZES[2])] * len(terms)
        for _ in range(3 if terms else 0):
            before = list(found)
            for k in range(len(terms)):
                tried = [
                    self.evidence(terms, [*found[:k], size, *found[k + 1 :]])
                    for size in SIZES
                ]
                found[k] = float(SIZES[int(np.argmax(tried))])
            if found == before:
                break
        if not terms:
            return Answer(0.0, {}, np.zeros((0, 0)), ())
        evidence, solved, factor, unit = self._fit(terms, found)
        # prior of the sizes
        evidence -= len(terms) * float(np.log(len(SIZES)))
        back = solve_triangular(factor.T, np.eye(len(unit)), check_finite=False)
        scale = unit / np.concatenate([self.design.units[t.term] for t in terms])
        value = scale * (back @ solved)
        covariance = (back @ back.T) * scale[:, None] * scale
        ends = np.cumsum([len(self.places[t]) for t in terms])
        parts = np.split(value, ends[:-1])
        return Answer(
            evidence, dict(zip(terms, parts, strict=True)), covariance, tuple(found)
        )

    def additions(
        self,
        terms: Sequence[Candidate],
        sizes: Sequence[float],
        others: Sequence[Candidate],
    ) -> Iterator[tuple[Candidate, float, np.ndarray, np.ndarray]]:
        """Each other candidate in its likeliest size: evidence of the set with it [nats], value and deviation."""
        places = self.joined(terms)
        unit = self.deviations(terms, sizes)
        factor = lower(self.gram[np.ix_(places, places)] * unit[:, None] * unit)
        back = forward(factor, unit[:, None] * self.gram[places])
        solved = forward(factor, unit * self.right[places])
        known = _half_log(factor, solved)
        for term in others:
            own = self.places[term]
            gram = self.gram[np.ix_(own, own)] - back[:, own].T @ back[:, own]
            right = self.right[own] - back[:, own].T @ solved
            widths = [self._widths(term.term, size) for size in SIZES]
            best = max((_alone(gram, right, w) for w in widths), key=lambda x: x[0])
            gain, value, deviation = best
            charge = (len(terms) + 1) * float(np.log(len(SIZES)))
            unit_of = self.design.units[term.term]
            yield term, known + gain - charge, value / unit_of, deviation / unit_of


def _alone(
    gram: np.ndarray, right: np.ndarray, unit: np.ndarray
) -> tuple[float, np.ndarray, np.ndarray]:
    """Evidence, values and deviations of the coordinates of one candidate, with the information on them."""
    factor = lower(gram * unit[:, None] * unit)
    solved = forward(factor, unit * right)
    back = unit[:, None] * solve_triangular(
        factor.T, np.eye(len(right)), check_finite=False
    )
    return _half_log(factor, solved), back @ solved, np.sqrt((back**2).sum(axis=1))
