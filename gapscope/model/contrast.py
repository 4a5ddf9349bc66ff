"""A contrast: what do groups of data need that the others do not?

Groups g have coefficients beta + delta_g of the columns: beta is shared by all, with a prior that may be wide, delta_g
is what a group has of its own. What each motion has of its own (form error) is eliminated first, so that a group is its
information on its coefficients, M_g and m_g. Of a set S of
columns that are a group's own, with prior deviations u, beside all that is shared,

    log evidence = 1/2 b^T (S_SS + U^-2)^-1 b - 1/2 log det(I + U S_SS U)

where S_SS and b are the information on the own columns when everything shared is eliminated: what explains all groups
is no difference. The size of an effect is not known beforehand: u is one of some ``sizes``, each as likely.
"""

from __future__ import annotations

import itertools
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_triangular

from gapscope.model.design import ROUNDS
from gapscope.model.equations import (
    FUNCTIONS,
    Eliminated,
    Equations,
    FormError,
    eliminated,
    forward,
    function_gains,
    lower,
)
from gapscope.model.terms import Candidate, Term

SIZES = (0.01, 0.03, 0.1, 0.3, 1.0)
"""Prior deviations of an effect, in RMS torque over the joint's scale [1]: from what is not worth a name to all of it.
"""
MANY = 20
"""Columns of terms of which what is shared is eliminated for all at once. (budget)"""
FACTORS = 16
"""Factors of the information on what is shared, for as many priors of it, that are kept. (budget)"""
RESIZED = 6
"""Times that unknown functions are resized. (budget)"""
LARGEST = 2.0
"""Prior deviation of an effect, over its usual size, at most [1]."""

Nuisance = tuple[tuple[int, ...], np.ndarray]
"""Groups with one value of each column, which the others do not have, and its prior variances, (P,)."""


@dataclass(frozen=True)
class Beside:
    """Further columns, K of them.

    Attributes:
        cross: products with the columns of each group, what motions have of their own eliminated, (G, P, K).
        gram, right: information on them beside all that is shared, (K, K), and its right side, (K,).
        back: L^-1 U times their products with what is shared.
    """

    cross: np.ndarray
    gram: np.ndarray
    right: np.ndarray
    back: np.ndarray

    def beside(self, before: Contrast, after: Contrast) -> Beside:
        """The same columns beside what another contrast of the same motions shares."""
        back = after.nuisance_rows(self.cross)
        gram = self.gram + self.back.T @ self.back - back.T @ back
        right = self.right + self.back.T @ before.solved - back.T @ after.solved
        return Beside(self.cross, gram, right, back)


class Functions:
    """Unknown functions of the joints, which are eliminated first: hypotheses share them, and their sizes.

    Attributes:
        unit: their prior deviations U, (H,).
        lower: L with L L^T = I + U A U, A being the information on them, (H, H).
        cross: L^-1 U times their products with all other nuisances, (H, R).
        rest: information on these beside the functions, (R, R).
        of_terms: L^-1 U times the products of the functions with the columns of terms of each group, (H, G, T), and
            what the other nuisances have in common with these beside the functions, (R, G, T), once they are asked for.
    """

    def __init__(self, normal: np.ndarray, unit: np.ndarray) -> None:
        self.unit, count = unit, len(unit)
        self.lower = lower(normal[:count, :count] * unit[:, None] * unit)
        self.cross = forward(self.lower, unit[:, None] * normal[:count, count:])
        self.rest = normal[count:, count:] - self.cross.T @ self.cross
        self.of_terms: tuple[np.ndarray, np.ndarray] | None = None


class Factor:
    """L with L L^T = I + U A U, A being the information on all nuisances, U their prior deviations, (N, N).

    Attributes:
        functions: the first rows and columns.
        unit: deviations of the others, (R,).
        lower: their part of L, (R, R).
        back: L^-1 U times the products of nuisances with the columns of terms of each group, (N, G, T), once they are
            asked for.
    """

    def __init__(self, functions: Functions, unit: np.ndarray) -> None:
        self.functions, self.unit = functions, unit
        self.lower = lower(functions.rest * unit[:, None] * unit)
        self.back: np.ndarray | None = None

    def forward(self, right: np.ndarray) -> np.ndarray:
        """L^-1 times a right side, (N, K)."""
        first = forward(self.functions.lower, right[: len(self.functions.lower)])
        rest = right[len(first) :] - self.unit[:, None] * (
            self.functions.cross.T @ first
        )
        return np.concatenate([first, forward(self.lower, rest)])

    def backward(self, solved: np.ndarray) -> np.ndarray:
        """L^-T times a vector, (N,)."""
        count = len(self.functions.lower)
        rest = solve_triangular(self.lower.T, solved[count:], check_finite=False)
        first = solved[:count] - self.functions.cross @ (self.unit * rest)
        first = solve_triangular(self.functions.lower.T, first, check_finite=False)
        return np.concatenate([first, rest])

    def half_log(self, solved: np.ndarray) -> float:
        """1/2 b^T (I + U A U)^-1 b - 1/2 log det(I + U A U) from L^-1 b, (N,)."""
        of_functions = float(np.log(np.diag(self.functions.lower)).sum())
        return _half_log(self.lower, solved) - of_functions


class Contrast:
    """The information of groups, and what follows for columns that one group has of its own.

    Args:
        equations: of all groups.
        error: noise and form error.
        nuisances: what groups have, alone or together, that is no term: the groups, and prior variances of the columns,
            (P,).

    Attributes:
        motions: per joint its motions, what they have of their own eliminated.
        information: per joint and group on the coefficients of the joint's columns, (p_j, p_j).
        gap: that is explained [1], (M, n).
    """

    def __init__(
        self,
        equations: Equations,
        error: FormError,
        nuisances: Sequence[Nuisance],
    ) -> None:
        self.equations, self.design, self.error = equations, equations.design, error
        self.groups = int(self.design.rows.group.max()) + 1
        self.gap = self.design.gap
        self.motions = [
            [eliminated(cell, error.own2[j], error.noise2[j]) for cell in cells]
            for j, cells in enumerate(equations.cells)
        ]
        self._nuisances = tuple(nuisances)
        every = itertools.product(range(len(self.motions)), range(self.groups))
        # information is kept per joint, as most columns move few joints
        self.information = [
            [np.zeros((len(a), len(a))) for _ in range(self.groups)]
            for a in self.design.active
        ]
        self._inform(every)
        self.right = self._right_sides()
        self._eliminate_nuisances()

    def _changed(
        self,
        motions: list[list[Eliminated]] | None = None,
        touched: Collection[tuple[int, int]] = (),
        nuisances: Sequence[Nuisance] = (),
        prior: np.ndarray | None = None,
    ) -> Contrast:
        """The same question of other motions, which change some joints and groups, or beside other nuisances."""
        # lists are replaced, not written to: copies share what has not changed
        other = copy(self)
        if motions is not None:
            other.motions = motions
            other._inform(touched)
            other.right = other._right_sides()
        if prior is not None:
            other.design = replace(self.design, prior=prior)
        other._nuisances = (*self._nuisances, *nuisances)
        other._eliminate_nuisances()
        return other

    def grown(self, larger: Mapping[tuple[int, int], float]) -> Contrast:
        """The same question with more form error.

        Args:
            larger: of a joint from 0 and a motion, by how much more variance form error has there than elsewhere [1].
        """
        if not larger:
            return self
        motions, touched = [list(own) for own in self.motions], set()
        for (j, motion), growth in larger.items():
            for k, one in enumerate(motions[j]):
                if one.cell.motion == motion:
                    # of all columns alike: form error keeps its shape
                    own2 = self.error.own2[j] * growth
                    motions[j][k] = eliminated(one.cell, own2, one.noise2)
                    touched.add((j, one.cell.group))
        return self._changed(motions, touched)

    def _inform(self, some: Iterable[tuple[int, int]]) -> None:
        """Sum the information of some joints and groups on the coefficients."""
        # a list of its own: the contrast it was copied from keeps its sums
        self.information = [list(groups) for groups in self.information]
        self._of_terms: np.ndarray | None = None
        for j, group in some:
            total = np.zeros_like(self.information[j][group])
            for one in self.motions[j]:
                if one.cell.group == group:
                    total += one.information
            self.information[j][group] = total

    def _total(self, groups: Collection[int]) -> np.ndarray:
        """Information of some groups on all columns, (P, P)."""
        out = np.zeros((self.design.size, self.design.size))
        for active, information in zip(
            self.design.active, self.information, strict=True
        ):
            out[np.ix_(active, active)] += sum(information[g] for g in groups)
        return out

    def _gathered(self, some: np.ndarray, others: np.ndarray) -> np.ndarray:
        """Information of each group on some columns and others, (G, K, L)."""
        out = np.zeros((self.groups, len(some), len(others)))
        if not out.size:
            return out
        place = np.full((2, self.design.size), -1)
        place[0, some], place[1, others] = range(len(some)), range(len(others))
        for active, information in zip(
            self.design.active, self.information, strict=True
        ):
            mine, theirs = place[:, active] >= 0
            here, there = place[0, active[mine]][:, None], place[1, active[theirs]]
            for group, own in enumerate(information):
                out[group, here, there] += own[np.ix_(mine, theirs)]
        return out

    def _right_sides(self) -> np.ndarray:
        """Right side of that information, (G, P)."""
        right = np.zeros((self.groups, self.design.size))
        for j, motions in enumerate(self.motions):
            active = self.design.active[j]
            for one in motions:
                right[one.cell.group, active] += one.pull
        return right

    def _eliminate_nuisances(self) -> None:
        """Eliminate what is shared by all, and what groups have that is no term."""
        prior, self._alike = self.design.prior, np.zeros(self.design.size)
        # the groups and the column of each nuisance that is not shared by all
        self._own: list[tuple[list[int], int]] = []
        unit = []
        for groups, variance in self._nuisances:
            # what every group has is shared
            if len(groups) == self.groups:
                self._alike += variance
                continue
            places = np.flatnonzero(variance > 0)
            self._own += [(list(groups), p) for p in places.tolist()]
            unit.append(np.sqrt(variance[places]))
        # unknown functions first, whose sizes no hypothesis changes
        is_shared = (prior > 0) | (self._alike > 0)
        is_function = np.zeros(self.design.size, dtype=bool)
        is_function[list(itertools.chain(*itertools.chain(*self.design.waves)))] = True
        functions = np.flatnonzero(is_shared & is_function)
        self._first = len(functions)
        self._shared = np.append(functions, np.flatnonzero(is_shared & ~is_function))
        self._own_units = np.concatenate([np.zeros(0), *unit])
        by_own = np.zeros((len(self._own), self.groups, self.design.size))
        places = np.unique([p for _, p in self._own]).astype(int)
        rows = self._gathered(places, np.arange(self.design.size))
        # a nuisance of some groups has products with the rows of these alone
        for row, (some, p) in zip(by_own, self._own, strict=True):
            row[some] = rows[some, np.searchsorted(places, p)]
        own = self._of_nuisances(by_own.transpose(1, 2, 0))
        count, shared = len(self._shared), self._shared
        self._normal = np.empty((len(own), len(own)))
        # shared by shared, shared by own, own by own: the matrix is symmetric
        every = self._total(range(self.groups))
        self._normal[:count, :count] = every[np.ix_(shared, shared)]
        self._normal[:, count:], self._normal[count:] = own, own.T
        self._by_own = by_own[:, :, self.design.told]
        self._cross: np.ndarray | None = None
        self._functions: Functions | None = None
        # of all questions to the same information, whatever their gap: copies hold the same ones
        self._factors: dict[bytes, Factor] = {}
        self._factorise()

    def _factorise(self) -> None:
        """Factorise the information on nuisances, in units of their deviations U: I + U A U."""
        shared = self._shared
        deviation = np.sqrt(self.design.prior[shared] ** 2 + self._alike[shared])
        self._units = np.append(deviation, self._own_units)
        first, rest = np.split(self._units, [self._first])
        if self._functions is None or (first != self._functions.unit).any():
            self._functions, self._factors = Functions(self._normal, first), {}
        kept, prior = self._factors, rest.tobytes()
        if prior not in kept:
            # the oldest goes
            if len(kept) >= FACTORS:
                del kept[next(iter(kept))]
            kept[prior] = Factor(self._functions, rest)
        self._factor = kept[prior]
        self.solved = self._solve()

    @property
    def of_terms(self) -> np.ndarray:
        """Information of each group on the columns of terms, (G, T, T)."""
        if self._of_terms is None:
            told = self.design.told
            self._of_terms = self._gathered(told, told)
        return self._of_terms

    @property
    def _crossed(self) -> np.ndarray:
        """Products of the nuisances with the columns of terms of each group, (N, G, T)."""
        if self._cross is None:
            by_shared = self._gathered(self._shared, self.design.told)
            self._cross = np.concatenate([by_shared.transpose(1, 0, 2), self._by_own])
        return self._cross

    @property
    def taken_by_nuisances(self) -> np.ndarray:
        """What the likeliest nuisances take of the right sides of the columns of terms of each group, (G, T)."""
        return np.tensordot(self._likeliest(self.solved), self._crossed, 1)

    def _likeliest(self, solved: np.ndarray) -> np.ndarray:
        """Likeliest values of the nuisances, from L^-1 U times their right side, (N,)."""
        return np.asarray(self._units * self._factor.backward(solved))

    def back(self, groups: Sequence[int], columns: np.ndarray) -> np.ndarray:
        """L^-1 U times the products of the nuisances with columns of terms of some groups, (N, K): once for many."""
        known = self._factor
        first, rest = self._beside_functions
        if known.back is None and len(columns) >= MANY:
            scaled = known.unit[:, None] * rest.reshape(len(rest), -1)
            beside = forward(known.lower, scaled).reshape(rest.shape)
            known.back = np.concatenate([first, beside])
        some = np.array(groups)[:, None]
        if known.back is not None:
            return known.back[:, some, columns].sum(axis=1)
        # for a few columns it is not worth solving for all of them
        first, rest = (x[:, some, columns].sum(axis=1) for x in (first, rest))
        beside = forward(known.lower, known.unit[:, None] * rest)
        return np.concatenate([first, beside])

    @property
    def _beside_functions(self) -> tuple[np.ndarray, np.ndarray]:
        """``Functions.of_terms`` of the unknown functions."""
        known, count = self._factor.functions, self._first
        if known.of_terms is None:
            cross = self._crossed.reshape(len(self._units), -1)
            first = forward(known.lower, self._units[:count, None] * cross[:count])
            rest, shape = cross[count:] - known.cross.T @ first, self._crossed.shape
            known.of_terms = (
                first.reshape(-1, *shape[1:]),
                rest.reshape(-1, *shape[1:]),
            )
        return known.of_terms

    def _of_nuisances(self, of_groups: np.ndarray) -> np.ndarray:
        """Products of the nuisances with something, from those of the columns of each group, (G, P, ...)."""
        shared = of_groups[:, self._shared].sum(axis=0)
        own = [of_groups[some, p].sum(axis=0)[None] for some, p in self._own]
        return np.concatenate([shared, *own])

    def _solve(self) -> np.ndarray:
        right = self._units * self._of_nuisances(self.right)
        count = len(self._shared)
        # the prior counts from the arm that was believed
        right[:count] -= self.design.taken[self._shared] / self._units[:count]
        return self._factor.forward(right[:, None])[:, 0]

    def nuisance_rows(self, of_groups: np.ndarray) -> np.ndarray:
        """L^-1 U times the products of the nuisances with columns whose products with each group's are (G, P, K)."""
        return self._factor.forward(
            self._units[:, None] * self._of_nuisances(of_groups)
        )

    @property
    def evidence(self) -> float:
        """Log probability of the gaps if no group has anything of its own [nats], but for a constant."""
        total = self._factor.half_log(self.solved)
        # what the motions have of their own explains a part; the rest is noise
        for motions, noise2 in zip(self.motions, self.error.noise2, strict=True):
            for one in motions:
                total += _half_log(one.factor, one.right) - one.cell.power / noise2 / 2
                total -= one.cell.count * float(np.log(noise2)) / 2
        return total

    def for_gap(self, gap: np.ndarray) -> Contrast:
        """The same question to another gap of the same columns, (M, n): that of another arm."""
        other = copy(self)
        # the gap stands in right sides alone: information and factors hold
        other.gap = gap
        other.motions = [
            [self._with_gap(j, one, gap[:, j]) for one in motions]
            for j, motions in enumerate(self.motions)
        ]
        other.right = other._right_sides()
        other.solved = other._solve()
        return other

    def without(self, group: int, left_out: Collection[int]) -> Contrast:
        """The same question without some motions of a group: what the others say of them is a prediction."""
        motions = [
            [
                one
                for one in own
                if one.cell.group != group or one.cell.motion not in left_out
            ]
            for own in self.motions
        ]
        return self._changed(motions, {(j, group) for j in range(len(motions))})

    def further(self, nuisances: Sequence[Nuisance]) -> Contrast:
        """The same question beside further nuisances of some groups."""
        if not nuisances:
            return self
        alike = sum(own for groups, own in nuisances if len(groups) == self.groups)
        shared = self.design.prior + self._alike > 0
        # what all groups have, and share already, is shared the more
        if any(len(groups) < self.groups for groups, _ in nuisances) or np.any(
            (alike > 0) & ~shared
        ):
            return self._changed(nuisances=nuisances)
        other = copy(self)
        other._nuisances = (*self._nuisances, *nuisances)
        other._alike = self._alike + alike
        other._factorise()
        return other

    def with_prior(self, prior: np.ndarray) -> Contrast:
        """The same question with other prior deviations of what is shared, (P,)."""
        other = copy(self)
        other.design = replace(self.design, prior=prior)
        other._factorise()
        return other

    def likeliest_functions(self) -> np.ndarray:
        """Prior deviations of what is shared, (P,), those of unknown functions such that the data are likeliest."""
        asked = self
        for _ in range(RESIZED):
            prior = asked.design.prior.copy()
            # (L L^T)^-1 = L^-T L^-1 is the covariance, in units of the prior
            half = asked._factor.forward(np.eye(len(asked._units)))
            # each as if all others stayed as large as they are
            for some in itertools.chain.from_iterable(asked.design.waves):
                at = np.flatnonzero(np.isin(asked._shared, some))
                mine = half[:, at]
                mean = mine.T @ asked.solved
                gain = function_gains(mine.T @ mine, mean, prior[some[0]])
                prior[some] = FUNCTIONS[int(gain.argmax())]
            if np.array_equal(prior, asked.design.prior):
                break
            other = asked.with_prior(prior)
            # together they may be too large
            if other.evidence <= asked.evidence:
                break
            asked = other
        return asked.design.prior

    def unshared(self, places: np.ndarray) -> Contrast:
        """The same question if some columns are nobody's but each group's own."""
        prior = self.design.prior.copy()
        prior[places] = 0.0
        return self._changed(prior=prior)

    def without_form(self, noise2: np.ndarray, prior: np.ndarray) -> Contrast:
        """The same question of rows of noise alone, without form error.

        Args:
            noise2: variance of the noise of each joint, (n,).
            prior: deviations of what is shared, (P,).
        """
        none = [np.zeros_like(own2) for own2 in self.error.own2]
        error = replace(self.error, own2=none, noise2=noise2)
        design = replace(self.design, prior=prior)
        other = Contrast(replace(self.equations, design=design), error, self._nuisances)
        # the equations are of the arm's gap, this question may be of another
        return other.for_gap(self.gap)

    def _with_gap(self, j: int, one: Eliminated, gap: np.ndarray) -> Eliminated:
        """One motion of a joint with another gap, (M,)."""
        rows = one.cell.rows
        right = self.design.columns[j][rows].T @ gap[rows]
        # columns made of the recorded torque share its noise with any gap of it
        self.equations.take_noise(j, rows, right)
        cell = replace(one.cell, right=right, power=float(gap[rows] @ gap[rows]))
        return replace(one, cell=cell, right=one.inner(right) / one.noise2)

    def beside(self, columns: Sequence[np.ndarray]) -> Beside:
        """What K further columns have in common with all else.

        Args:
            columns: per joint over its scale, zero on the rows of the groups that do not have them, (M, K).
        """
        count = columns[0].shape[1]
        cross = np.zeros((self.groups, self.design.size, count))
        gram, right = np.zeros((count, count)), np.zeros(count)
        for j, motions in enumerate(self.motions):
            active, noise2 = self.design.active[j], self.error.noise2[j]
            for one in motions:
                rows = one.cell.rows
                x = columns[j][rows]
                if not x.any():
                    continue
                products = self.design.columns[j][rows].T @ x / noise2
                # what the motion has of its own explains a part of the columns as well
                inner = one.inner(products)
                gram += x.T @ x / noise2 - inner.T @ inner
                right += x.T @ self.gap[rows, j] / noise2 - inner.T @ one.right
                cross[one.cell.group, active] += products - one.cross.T @ inner
        # so far without own values of motions alone: what is shared is eliminated last
        back = self.nuisance_rows(cross)
        return Beside(cross, gram - back.T @ back, right - back.T @ self.solved, back)

    def growth_gains(
        self, group: int, growths: Sequence[float]
    ) -> dict[tuple[int, int, float], float]:
        """About what more form error explains, by joint from 0, motion of a group, and growth of its variance [nats].

        What is shared is held where it is likeliest, and so is what the group has that is no term.
        """
        shared, own = self.nuisance_values(self.solved)
        mine, out = shared + own[group], {}
        # 1 first: a gain counts over form error as it was learnt
        tried = np.array([1.0, *growths])
        for j, motions in enumerate(self.motions):
            noise2, beta = self.error.noise2[j], mine[self.design.active[j]]
            for one in motions:
                cell = one.cell
                if cell.group != group:
                    continue
                # X^T X beta by the root of the products: the rows are not needed
                of_all = cell.root.T @ (cell.root @ beta)
                left = one.of_own(cell.right - of_all) / noise2
                gains = _of_sizes(one.root_of_own, left, noise2, tried)
                for growth, gain in zip(growths, gains[1:] - gains[0], strict=True):
                    out[j, cell.motion, growth] = float(gain)
        return out

    def values_of(self, groups: Collection[int], held: np.ndarray) -> np.ndarray:
        """Likeliest values of what is shared by what some groups say, (P,).

        Args:
            groups: the groups.
            held: values that are what they are, (P,); not a number for all others.
        """
        chosen, free = list(groups), (self.design.prior > 0) & np.isnan(held)
        value = np.where(free, 0.0, np.nan_to_num(held))
        # what is held acts on the right side of all others
        gram = self._total(chosen)[free]
        right = self.right[chosen].sum(axis=0)[free] - gram @ value
        unit = self.design.prior[free]
        factor = lower(gram[:, free] * unit[:, None] * unit)
        # as everywhere the prior counts from the arm that was believed
        solved = forward(factor, unit * right - self.design.taken[free] / unit)
        value[free] = unit * solve_triangular(factor.T, solved, check_finite=False)
        return value

    def nuisance_values(self, solved: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Values of what is shared, (P,), and of the nuisances of each group, (G, P), from L^-1 U b."""
        shared, own = np.zeros(self.design.size), np.zeros(self.right.shape)
        value, count = self._likeliest(solved), len(self._shared)
        shared[self._shared] = value[:count]
        for (some, p), one in zip(self._own, value[count:], strict=True):
            own[some, p] += one
        return shared, own

    def nuisance_roots(self) -> np.ndarray:
        """Root R of the covariance R R^T of what is shared and of what groups have that is no term, (P, N)."""
        half = self._factor.forward(np.diag(self._units))
        out = np.zeros((self.design.size, len(half)))
        count = len(self._shared)
        out[self._shared] = half[:, :count].T
        for (_, place), row in zip(self._own, half[:, count:].T, strict=True):
            out[place] += row
        return out

    def covariance(self) -> np.ndarray:
        """Covariance of what is shared, (P, P)."""
        out = np.zeros((self.design.size, self.design.size))
        half = self._factor.forward(np.diag(self._units))[:, : len(self._shared)]
        out[np.ix_(self._shared, self._shared)] = half.T @ half
        return out

    def own_covariance(self, places: Sequence[int]) -> np.ndarray:
        """Covariance of what the groups of the first nuisance have of some columns, (K, K)."""
        # what these groups have stands behind all that is shared
        count, some = len(self._shared), list(self._nuisances[0][0])
        every = [count + k for k, own in enumerate(self._own) if own[0] == some]
        at = [next(k for k in every if self._own[k - count][1] == p) for p in places]
        unit = np.zeros((len(self._units), len(at)))
        unit[at, range(len(at))] = self._units[at]
        half = self._factor.forward(unit)
        return half.T @ half

    @property
    def determined(self) -> float:
        """Number of shared values that the data determine: those of which they say more than the prior does [1]."""
        left = np.diag(self.covariance())[self._shared]
        return float((1.0 - left / self._units[: len(left)] ** 2).sum())


def _half_log(factor: np.ndarray, solved: np.ndarray) -> float:
    """1/2 b^T (I + A)^-1 b - 1/2 log det(I + A) from L L^T = I + A and L^-1 b."""
    return float(solved @ solved) / 2 - float(np.log(np.diag(factor)).sum())


def _of_sizes(
    root: np.ndarray, right: np.ndarray, noise2: float, sizes2: np.ndarray
) -> np.ndarray:
    """Evidence of values of variances g, with X^T X / s^2 the information on them and b its right side, of every g.

    As rows of X are few, 1/2 b^T (g^-1 I + X^T X / s^2)^-1 b = g/2 b^T b - g^2/2 (X b)^T (s^2 I + g X X^T)^-1 X b.

    Args:
        root: X, (r, k).
        right: b, (k,).
        noise2: s^2.
        sizes2: the variances, (Z,).
    """
    of_rows = root @ right
    covariance = sizes2[:, None, None] * (root @ root.T) / noise2 + np.eye(len(root))
    solved = np.linalg.solve(covariance, of_rows[:, None])[:, :, 0] @ of_rows
    explained = sizes2 * (right @ right) - sizes2**2 * solved / noise2
    return np.asarray((explained - np.linalg.slogdet(covariance)[1]) / 2)


@dataclass(frozen=True)
class Answer:
    """Values of a set of candidates.

    Attributes:
        evidence: of the set over that of none [nats].
        values: of each candidate, (linear,), in its own units.
        covariance: of all of them, in the order of the candidates.
        sizes: prior deviation of each.
    """

    evidence: float
    values: Mapping[Candidate, np.ndarray]
    covariance: np.ndarray
    sizes: tuple[float, ...]

    @cached_property
    def deviations(self) -> dict[Candidate, np.ndarray]:
        """Standard deviations of the values of each candidate, (linear,)."""
        ends = np.cumsum([len(value) for value in self.values.values()])
        parts = np.split(np.sqrt(np.diag(self.covariance)), ends[:-1])
        return dict(zip(self.values, parts, strict=True)) if self.values else {}


class Additions(NamedTuple):
    """What each of m further candidates adds to a set.

    Attributes:
        evidence: of the set with it [nats], (m,).
        values, deviations: of its coordinates, (linear,) each.
    """

    evidence: np.ndarray
    values: list[np.ndarray]
    deviations: list[np.ndarray]


class OwnTerms:
    """Evidence and values of sets of candidates.

    A coordinate is a column of the design on the rows of some groups: a candidate's groups have one value.

    Args:
        contrast: of all groups.
        sets: groups that may have a term of their own, each set of them with one value.
        about: columns of candidates about their own values, over the joints' scale, per joint (M, linear).
        sizes: prior deviations of an effect, in RMS torque over the joint's scale, each as likely.

    Attributes:
        places: of the coordinates of each candidate.
        right: right side of the information on the coordinates beside all that is shared, (K,).
    """

    def __init__(
        self,
        contrast: Contrast,
        sets: Sequence[tuple[int, ...]],
        about: Mapping[Candidate, list[np.ndarray]] | None = None,
        sizes: Sequence[float] = SIZES,
    ) -> None:
        made = self.design = contrast.design
        self.sizes = tuple(sizes)
        self.contrast, self._sets, self._about = contrast, sets, about or {}
        every = tuple(range(contrast.groups))
        # the groups of each block of coordinates, one for each column
        self._blocks = [tuple(sorted(some)) for some in (*sets, every)]
        self._grams: dict[tuple[int, ...], np.ndarray] = {}
        self._of_terms = {
            term: np.searchsorted(made.told, own) for term, own in made.places.items()
        }
        self._number = {some: k for k, some in enumerate((*sets, None))}
        self._replaced: dict[Candidate, np.ndarray] = {}
        self._width_of: dict[Term, np.ndarray] = {}
        # columns about own values come behind all blocks
        self._further = contrast.beside(self._replacing()) if self._about else None
        self.right = self._right()

    def _right(self) -> np.ndarray:
        told, contrast = self.design.told, self.contrast
        of_groups = contrast.right[:, told] - contrast.taken_by_nuisances
        right = [of_groups[list(block)].sum(axis=0) for block in self._blocks]
        further = [] if self._further is None else [self._further.right]
        return np.concatenate([*right, *further])

    @property
    def candidates(self) -> Iterator[Candidate]:
        """All that there are: terms of each set of groups, and those with a searched form of everybody."""
        for term, some in itertools.product(self._of_terms, self._number):
            # plain terms of everybody are shared already, not those with a searched form
            if some is not None or term.parametrisation.nonlinear:
                yield Candidate(term, some)

    def has(self, term: Term) -> bool:
        """Whether the rows show a term."""
        return term in self._of_terms

    def places(self, one: Candidate) -> np.ndarray:
        """Places of the coordinates of a candidate, (linear,)."""
        # about its own values a candidate has other columns than its term
        if one in self._replaced:
            return self._replaced[one]
        own = self._of_terms[one.term]
        return own + self._number[one.groups] * len(self.design.told)

    def back(self, places: np.ndarray) -> np.ndarray:
        """L^-1 U times the products of coordinates with what is shared, (N, K)."""
        out = np.empty((len(self.contrast.solved), len(places)))
        for block, mine, columns in self._by_block(places):
            if block is not None:
                out[:, mine] = self.contrast.back(block, columns)
            elif self._further is not None:
                out[:, mine] = self._further.back[:, columns]
        return out

    def _replacing(self) -> list[np.ndarray]:
        """Columns about their own values, in the place of those of some candidates; per joint (M, K)."""
        count = len(self._blocks) * len(self.design.told)
        for one, columns in self._about.items():
            width = columns[0].shape[1]
            self._replaced[one] = np.arange(count, count + width)
            count += width
        joints = range(len(self.design.active))
        every = self._about.values()
        return [np.hstack([columns[j] for columns in every]) for j in joints]

    def products(self, some: np.ndarray, others: np.ndarray) -> np.ndarray:
        """Information that coordinates have in common beside all that is shared, (K, K')."""
        of_others = self.back(others)
        mine = of_others if some is others else self.back(some)
        # Schur complement: what both have in common with what is shared is taken off
        out = -mine.T @ of_others
        for block, mine, columns in self._by_block(some):
            for other, theirs, other_columns in self._by_block(others):
                out[np.ix_(mine, theirs)] += self._in_common(
                    block, columns, other, other_columns
                )
        return out

    def _by_block(
        self, places: np.ndarray
    ) -> Iterator[tuple[tuple[int, ...] | None, np.ndarray, np.ndarray]]:
        """Coordinates by the groups that have them: which they are, and of which column; ``None``: further ones."""
        count = len(self.design.told)
        number, column = np.divmod(places, count)
        # what lies behind the last block is further columns, however many
        number = np.minimum(number, len(self._blocks))
        for k in np.unique(number).tolist():
            mine = np.flatnonzero(number == k)
            if k < len(self._blocks):
                yield self._blocks[k], mine, column[mine]
            else:
                yield None, mine, places[mine] - k * count

    def _in_common(
        self,
        block: tuple[int, ...] | None,
        columns: np.ndarray,
        other: tuple[int, ...] | None,
        other_columns: np.ndarray,
    ) -> np.ndarray | float:
        """Products of columns of some groups with columns of others, but for what is shared."""
        if block is not None and other is not None:
            # groups that only one of them has give no products
            both = tuple(group for group in block if group in other)
            if not both:
                return 0.0
            return np.asarray(self._gram(both)[np.ix_(columns, other_columns)])
        further = self._further
        assert further is not None
        if block is not None:
            cross = further.cross[list(block)].sum(axis=0)[self.design.told]
            return np.asarray(cross[np.ix_(columns, other_columns)])
        if other is not None:
            return np.asarray(self._in_common(other, other_columns, block, columns)).T
        # with what is shared put back, as ``products`` takes it off from all alike
        known = further.gram + further.back.T @ further.back
        return np.asarray(known[np.ix_(columns, other_columns)])

    def _gram(self, groups: tuple[int, ...]) -> np.ndarray:
        """Information of some groups on the columns of terms, (T, T)."""
        if groups not in self._grams:
            self._grams[groups] = self.contrast.of_terms[list(groups)].sum(axis=0)
        return self._grams[groups]

    def _alone(self, places: np.ndarray) -> np.ndarray:
        """Information on each of m candidates, coordinates in rows of ``places``, (m, k): (m, k, k)."""
        out = np.empty((*places.shape, places.shape[1]))
        back = self.back(places.ravel()).reshape(-1, *places.shape)
        for block, mine, columns in self._by_block(places[:, 0]):
            # columns of their own are few, those of the design one batch per block
            if block is None:
                for k in mine:
                    out[k] = self.products(places[k], places[k])
                continue
            # the coordinates of a candidate follow on each other
            at = columns[:, None] + places[mine] - places[mine, :1]
            own = back[:, mine]
            out[mine] = self._gram(block)[at[:, :, None], at[:, None, :]]
            out[mine] -= np.einsum("nmk,nml->mkl", own, own)
        return out

    def deviations(
        self, some: Sequence[Candidate], sizes: Sequence[float]
    ) -> np.ndarray:
        """Prior deviations of the coordinates of some candidates, of a size each."""
        number = {size: k for k, size in enumerate(self.sizes)}
        own = [
            self._widths(one.term)[number[size]]
            for one, size in zip(some, sizes, strict=True)
        ]
        return np.concatenate(own) if own else np.zeros(0)

    def _widths(self, term: Term) -> np.ndarray:
        """Prior deviations of a term's coordinates of each of the Z ``sizes``, in torque, (Z, linear)."""
        if term not in self._width_of:
            unit, fitted = self.design.units[term], term.parametrisation
            shares = np.ones(len(unit))
            if fitted.proportions is not None:
                # the coordinate that moves most torque has the size, others their share
                torque = unit * np.array(fitted.proportions)
                shares = torque / torque.max()
            # no arm has much more of an effect than is usual where it is one
            most = LARGEST * self.design.usual[term] * unit
            sizes = np.array(self.sizes)[:, None]
            self._width_of[term] = np.minimum(sizes * shares, most)
        return self._width_of[term]

    def within(self, contrast: Contrast) -> OwnTerms:
        """The same columns in another contrast of the same groups, such as one without some motions."""
        mine = self.contrast
        if contrast.motions is not mine.motions:
            return OwnTerms(contrast, self._sets, self._about, self.sizes)
        # what motions say of the columns is the same, whatever is believed of what is shared
        other = copy(self)
        other.contrast = contrast
        if self._further is not None:
            other._further = self._further.beside(mine, contrast)
        other.right = other._right()
        return other

    def nuisances(
        self, values: Mapping[Candidate, np.ndarray]
    ) -> tuple[np.ndarray, np.ndarray]:
        """What is shared, (P,), and the nuisances of each group, (G, P), beside values of candidates."""
        solved = self.contrast.solved
        # what is shared is fitted to what the candidates leave of its right side
        for one, value in values.items():
            scaled = value * self.design.units[one.term]
            solved = solved - self.back(self.places(one)) @ scaled
        return self.contrast.nuisance_values(solved)

    def torque(self, values: Mapping[Candidate, np.ndarray]) -> np.ndarray:
        """What values of candidates do to the torque, over the joints' scale [1], (M, n)."""
        made, out = self.design, np.zeros_like(self.design.gap)
        for one, value in values.items():
            if one in self._about:
                scaled = value * made.units[one.term]
                out += np.stack([x @ scaled for x in self._about[one]], axis=1)
                continue
            torque = made.torque(one.term, value)
            if one.groups is not None:
                torque *= np.isin(made.rows.group, one.groups)[:, None]
            out += torque
        return out

    def joined(self, some: Sequence[Candidate]) -> np.ndarray:
        """Places of the coordinates of some candidates."""
        own = [self.places(one) for one in some]
        return np.concatenate(own) if own else np.zeros(0, dtype=int)

    def of_others(
        self, others: Sequence[Candidate], cross: np.ndarray, back: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """L^-1 times the products of other candidates with further columns, (K', K), and times their right side, (K',).

        Args:
            others: the candidates, whose information beside all that is shared is L L^T - I.
            cross: products of the further columns with those of each group, (G, P, K).
            back: L^-1 U times their products with what is shared.
        """
        places = self.joined(others)
        shared = np.zeros((len(places), back.shape[1]))
        for block, mine, columns in self._by_block(places):
            # columns about their own values are not among those of the design
            if block is not None:
                of_terms = cross[list(block)].sum(axis=0)[self.design.told]
                shared[mine] = of_terms[columns]
        factor = lower(self.products(places, places))
        inner = forward(factor, shared - self.back(places).T @ back)
        return inner, forward(factor, self.right[places])

    def answer(
        self, terms: Sequence[Candidate], sizes: Sequence[float] | None = None
    ) -> Answer:
        """Evidence and values of a set, each term of its likeliest size."""
        if not terms:
            return Answer(0.0, {}, np.zeros((0, 0)), ())
        places = self.joined(terms)
        gram, right = self.products(places, places), self.right[places]
        found = tuple(sizes or self._likeliest(terms, gram, right))
        unit = self.deviations(terms, found)
        factor = lower(gram * unit[:, None] * unit)
        solved = forward(factor, unit * right)
        evidence = _half_log(factor, solved)
        # prior of the sizes
        evidence -= len(terms) * float(np.log(len(self.sizes)))
        back = solve_triangular(factor.T, np.eye(len(unit)), check_finite=False)
        # from torque back to the terms' own units
        scale = unit / np.concatenate([self.design.units[t.term] for t in terms])
        value = scale * (back @ solved)
        covariance = (back @ back.T) * scale[:, None] * scale
        ends = np.cumsum([len(t.term.columns) for t in terms])
        parts = np.split(value, ends[:-1])
        return Answer(evidence, dict(zip(terms, parts, strict=True)), covariance, found)

    def _likeliest(
        self, terms: Sequence[Candidate], gram: np.ndarray, right: np.ndarray
    ) -> list[float]:
        """Size of each of some candidates that makes the data likeliest, one after the other beside the others.

        With C = (I + U A U)^-1 and m = C U b of all, the information on the coordinates k of one beside the others is
        U_k^-1 (C_kk^-1 - I) U_k^-1, and its right side U_k^-1 C_kk^-1 m_k.

        Args:
            terms: the candidates.
            gram, right: A and b, information on their coordinates beside all that is shared.
        """
        widths = [self._widths(one.term) for one in terms]
        ends = np.cumsum([0, *(each.shape[1] for each in widths)]).tolist()
        # all start at a tenth of the torque, ``SIZES[2]``
        found = [2] * len(terms)
        unit = np.concatenate([each[2] for each in widths])
        covariance, changed = np.empty(0), True
        for _ in range(ROUNDS):
            before = list(found)
            for k, (start, end) in enumerate(pairwise(ends)):
                # the inverse of all holds until a width changes
                if changed:
                    covariance = np.linalg.inv(
                        gram * unit[:, None] * unit + np.eye(len(unit))
                    )
                own = slice(start, end)
                alone = np.linalg.inv(covariance[own, own])
                mean = covariance[own] @ (unit * right)
                within = (alone - np.eye(end - start)) / unit[own, None] / unit[own]
                right_side = alone @ mean / unit[own]
                gains, *_ = of_widths(within, right_side, widths[k])
                best = int(np.argmax(gains))
                changed, found[k] = best != found[k], best
                unit[own] = widths[k][best]
            if found == before:
                break
        return [self.sizes[k] for k in found]

    def additions(
        self,
        terms: Sequence[Candidate],
        sizes: Sequence[float],
        others: Sequence[Candidate],
    ) -> Additions:
        """What each other candidate, in its likeliest size, adds to a set."""
        places = self.joined(terms)
        unit = self.deviations(terms, sizes)
        factor = lower(self.products(places, places) * unit[:, None] * unit)
        solved = forward(factor, unit * self.right[places])
        known = _half_log(factor, solved)
        # the further one pays for its choice of a size, as the others do
        known -= (len(terms) + 1) * float(np.log(len(self.sizes)))
        none = np.zeros(0)
        out = Additions(
            np.zeros(len(others)), [none] * len(others), [none] * len(others)
        )
        # those with as many coordinates are one batch
        by_width: dict[int, list[int]] = {}
        for k, one in enumerate(others):
            by_width.setdefault(len(one.term.columns), []).append(k)
        for some in by_width.values():
            at = np.array([self.places(others[k]) for k in some])
            x = forward(factor, unit[:, None] * self.products(places, at.ravel()))
            x = x.reshape(len(places), *at.shape)
            # information and right side of each beside the set
            gram = self._alone(at) - np.einsum("smk,sml->mkl", x, x)
            right = self.right[at] - np.einsum("smk,s->mk", x, solved)
            each = self.alone([others[k].term for k in some], gram, right)
            for k, gain, value, deviation in zip(some, *each, strict=True):
                out.evidence[k] = known + gain
                out.values[k], out.deviations[k] = value, deviation
        return out

    def alone(
        self, terms: Sequence[Term], gram: np.ndarray, right: np.ndarray
    ) -> tuple[list[float], np.ndarray, np.ndarray]:
        """Each of m terms of k coordinates in its likeliest size: its evidence [nats], value and deviation, (m, k).

        Args:
            terms: the terms, (m,).
            gram, right: information on their coordinates beside all else, (m, k, k) and (m, k).
        """
        widths = {term: self._widths(term) for term in set(terms)}
        units = np.array([self.design.units[term] for term in terms])
        every = np.stack([widths[term] for term in terms], axis=1)
        evidence, scaled, inverse = of_widths(gram, right, every)
        best = np.argmax(evidence, axis=0), np.arange(len(right))
        # the posterior variance of a coordinate is u (I + U A U)^-1 u
        deviations = every * np.sqrt(np.diagonal(inverse, axis1=2, axis2=3))
        values = (every * scaled)[best] / units
        return evidence[best].tolist(), values, deviations[best] / units


def of_widths(
    gram: np.ndarray, right: np.ndarray, widths: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Evidence of k coordinates of each size [nats], (Z, ...), their values over the widths, and their covariance.

    Args:
        gram, right: information on the coordinates, (..., k, k) and (..., k).
        widths: prior deviations of each size, (Z, ..., k).
    """
    scaled = right * widths
    if right.shape[-1] == 1:
        # most have one coordinate: numbers, and no matrices
        inverse = 1.0 / (gram * widths[..., None] ** 2 + 1.0)
        solved, spread = inverse[..., 0] * scaled, -np.log(inverse[..., 0, 0])
    else:
        normal = gram * widths[..., None] * widths[..., None, :]
        normal += np.eye(right.shape[-1])
        inverse, spread = np.linalg.inv(normal), np.linalg.slogdet(normal)[1]
        solved = (inverse @ scaled[..., None])[..., 0]
    evidence = (scaled * solved).sum(axis=-1) - spread
    return evidence / 2, solved, inverse
