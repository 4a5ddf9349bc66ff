"""Sums of products of columns and gap, per motion, group and joint: all that a contrast asks is algebra on them.

They teach the noise of the joints and the form error of the arm, from data in which nothing changed.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import solve_triangular
from scipy.linalg.lapack import dpotrf, dtrtri, dtrtrs
from scipy.stats import chi2

from gapscope.model.conditioning import BY_CHANCE
from gapscope.model.design import MIN_TORQUE, PRECISE, Design
from gapscope.model.effective_samples import variance_inflation
from gapscope.model.rows import MIN_MOTIONS


@dataclass(frozen=True)
class Cell:
    """Rows of one motion in one group, on one joint.

    Attributes:
        motion, group, recording: numbers; of a motion that comes again, the first recording.
        rows: numbers of the rows, (m,).
        root: no more than p rows with the products of the columns X, (min(m, p), p).
        right: X^T y, (p,).
        power: y^T y.
        count: rows that count, the sum of their weights.
    """

    motion: int
    group: int
    recording: int
    rows: np.ndarray
    root: np.ndarray
    right: np.ndarray
    power: float
    count: float

    @classmethod
    def of(cls, design: Design, j: int, rows: np.ndarray) -> Cell:
        """The sums of some rows of a motion, on a joint from 0."""
        x, y, trust = design.columns[j][rows], design.gap[rows, j], design.rows.trust
        # R of X = Q R has the products of X: no more rows than columns are kept
        root = x if len(x) <= x.shape[1] else np.asarray(np.linalg.qr(x, mode="r"))
        count = trust[rows, j]
        return cls(
            motion=int(design.rows.motion[rows[0]]),
            group=int(design.rows.group[rows[0]]),
            recording=int(design.rows.source[rows[0]]),
            rows=rows,
            root=root,
            right=x.T @ y,
            power=float(y @ y),
            count=float(count @ count),
        )

    @property
    def gram(self) -> np.ndarray:
        """X^T X, (p, p)."""
        return self.root.T @ self.root


@dataclass(frozen=True)
class Equations:
    """The cells of each joint; columns in the order of the joint's own.

    Attributes:
        design: columns and gap.
        cells: of each joint, motion by motion.
        noise2: variance of the noise of each joint [1], (n,), if known.
    """

    design: Design
    cells: list[list[Cell]]
    noise2: np.ndarray | None = None

    @classmethod
    def of(cls, design: Design, noise2: np.ndarray | None = None) -> Equations:
        """The sums of a design, over the rows that are not set aside.

        Args:
            design: columns and gap.
            noise2: variance of the noise of each joint [1], (n,), if known. A column made of the recorded torque holds
                the noise that is in the gap: what they have in common by that is taken out.
        """
        rows = design.rows
        numbers = np.column_stack([rows.motion, rows.group])
        members = [
            np.flatnonzero((numbers == pair).all(axis=1))
            for pair in np.unique(numbers[~rows.set_aside], axis=0)
        ]
        joints = range(len(design.columns))
        cells = [[Cell.of(design, j, own) for own in members] for j in joints]
        made = cls(design, cells, noise2)
        for j, own in enumerate(cells):
            for cell in own:
                made.take_noise(j, cell.rows, cell.right)
        return made

    def take_noise(self, j: int, rows: np.ndarray, right: np.ndarray) -> None:
        """Take from a right side what columns made of the recorded torque have in common with the gap by its noise."""
        if self.noise2 is None:
            return
        for (joint, place), passed in self.design.noisy.items():
            if joint == j:
                right[place] -= self.noise2[j] * passed[rows].sum()


def lower(matrix: np.ndarray) -> np.ndarray:
    """Lower Cholesky factor of I + a matrix, which is written over.

    Raises:
        LinAlgError: the sum is not positive definite.
    """
    matrix[np.diag_indices(len(matrix))] += 1.0
    return _cholesky(matrix)


def _cholesky(matrix: np.ndarray) -> np.ndarray:
    # the matrices are small and many: what checks their shape would cost more than they do
    factor, failed = dpotrf(matrix, lower=1, clean=1)
    if failed:
        raise np.linalg.LinAlgError("the matrix is not positive definite")
    return np.asarray(factor)


def forward(factor: np.ndarray, right: np.ndarray) -> np.ndarray:
    """L^-1 of a lower triangular factor times a right side."""
    if not right.size:
        return np.array(right, dtype=float)
    return np.asarray(dtrtrs(factor, right, lower=1)[0])


def inverse(factor: np.ndarray) -> np.ndarray:
    """L^-1 of a lower triangular factor."""
    return np.asarray(dtrtri(factor, lower=1)[0])


def whitened(cell: Cell, own2: np.ndarray, noise2: float) -> np.ndarray:
    """Rows W with W^T W the information on the joint's columns beside what a motion has of its own, (k, p).

    W = L^-1 X with L L^T = noise2 I + X diag(own2) X^T: of motions of few rows a small matrix.
    """
    X = cell.root
    covariance = (X * own2) @ X.T
    covariance[np.diag_indices(len(X))] += noise2
    return forward(_cholesky(covariance), X)


@dataclass(frozen=True)
class Eliminated:
    """One motion of a group on one joint, what it has of its own eliminated.

    Of k columns of which it has values of its own, over their deviations, r rows tell d = min(k, r) combinations.

    Attributes:
        cell: the motion.
        free: places of these columns among the joint's, (k,).
        basis: the combinations that its rows tell, times the deviations, (k, d).
        factor: L with L L^T = I + the information on them, (d, d).
        cross: L^-1 times their products with all columns, (d, p).
        right: L^-1 times their products with the gap, (d,).
        noise2: variance of the noise.
    """

    cell: Cell
    free: np.ndarray
    basis: np.ndarray
    factor: np.ndarray
    cross: np.ndarray
    right: np.ndarray
    noise2: float

    @property
    def root_of_own(self) -> np.ndarray:
        """Rows with the products of the combinations of its own, (d, d)."""
        own = self.cell.root[:, self.free] @ self.basis
        square = len(own) == own.shape[1]
        return own if square else np.asarray(np.linalg.qr(own, mode="r"))

    @property
    def information(self) -> np.ndarray:
        """Information on the coefficients of the joint's columns, (p, p)."""
        return self.cell.gram / self.noise2 - self.cross.T @ self.cross

    @property
    def pull(self) -> np.ndarray:
        """Its right side, (p,)."""
        return self.cell.right / self.noise2 - self.cross.T @ self.right

    def of_own(self, products: np.ndarray) -> np.ndarray:
        """Products of the combinations of its own, (d, ...), from those of all columns, (p, ...)."""
        return self.basis.T @ products[self.free]

    def inner(self, products: np.ndarray) -> np.ndarray:
        """L^-1 times the products of the own values with further columns, of all columns' products (p, K)."""
        return forward(self.factor, self.of_own(products))


def eliminated(cell: Cell, own2: np.ndarray, noise2: float) -> Eliminated:
    """Eliminate what a motion has of its own, of variance ``own2``, (p,)."""
    free = np.flatnonzero(own2 > 0)
    size = np.sqrt(own2[free])
    own, basis = cell.root[:, free] * size, np.diag(size)
    if len(own) < len(size):
        # of motions of few rows few combinations: X = R^T Q^T, and what is orthogonal to Q no row tells
        turned, triangle = np.linalg.qr(own.T)
        own, basis = triangle.T, size[:, None] * turned
    factor = lower(own.T @ own / noise2)
    cross = forward(factor, own.T @ cell.root / noise2)
    right = forward(factor, basis.T @ cell.right[free] / noise2)
    return Eliminated(cell, free, basis, factor, cross, right, noise2)


# Form error and noise, learnt from data in which nothing changed.
#
# No catalogue has the whole truth of an arm. On joint j, motion b is taken to leave
#
#     f_j(x) + A_j theta_bj + e_j,    theta_bj ~ N(0, diag omega_j^2),    e_j ~ N(0, sigma_j^2)
#
# beside what all motions share: unknown functions f_j of the joint's own state and of the arm's (``design.py``), each
# of the size of a grid that makes the data likeliest, and what each motion has of its own, spanned by the columns A_j
# of the candidates themselves, with an amplitude omega per joint. The same motion again has the same theta: it teaches
# noise, not form. Noise is what is left of motions held out when each has values of its own; neighbours in time
# resemble each other, so that 1 + 2 sum_k rho_k of them count as one (bayley1946). The amplitude follows from the
# evidence of the motions of each group (mackay1992b), with gamma the number of values that data determine,
#
#     omega_j^2 = sum theta^2 / sum gamma,
#
# and is no less than what makes motions held out as surprising as they are.


ROUNDS = 12
"""Updates of the amplitudes. (budget)"""
SETTLED = 0.02
"""An amplitude whose square changes by less is settled, and so are values of a law about which it is linear [1]."""
FIRST_FREEDOM = 0.1
"""What a motion may have of its own when noise is measured, of each column [1]."""
MIN_NOISE = 4e-3
"""Noise of a joint over its torque's deviation at least [1]: recordings without noise have finite weights."""
MIN_FORM = 2e-3
"""Form error of one column at least [1]: no arm is modelled better than to a few thousandths."""
FUNCTIONS = np.geomspace(MIN_FORM, 0.5, 9)
"""Sizes of an unknown function that are tried, over the joint's scale [1]. (budget)"""
OF_THE_JOINT = 2.0
"""Values that the joint's amplitude counts for beside those of a column alone [1]: few motions determine it."""


@dataclass(frozen=True)
class FormError:
    """Noise, and amplitudes of form error, of n joints.

    Attributes:
        noise2: variance of the noise by which rows count, over the square of the joint's scale [1], (n,).
        white2: the same of a row by itself.
        own2: per joint the variance of what a motion has of its own of each of its columns, (p_j,).
        joint2: the same of a column that was not there when it was learnt, (n,).
        missed2: mean square that was missed of motions held out, (n,).
        function2: variance of unknown functions of the joint's own state and of the arm's, (n, 2).
    """

    noise2: np.ndarray
    white2: np.ndarray
    own2: list[np.ndarray]
    joint2: np.ndarray
    missed2: np.ndarray
    function2: np.ndarray

    def primed(self, design: Design) -> Design:
        """A design whose unknown functions have the sizes that were learnt."""
        prior = design.prior.copy()
        for places, size2 in zip(design.waves, self.function2, strict=True):
            for some, own2 in zip(places, size2, strict=True):
                prior[some] = np.sqrt(own2)
        return replace(design, prior=prior)


def learn(
    equations: Equations,
    groups: Collection[int],
    *,
    alike: bool = False,
    priors: Sequence[np.ndarray] = (),
) -> FormError:
    """Noise and amplitudes of form error by the evidence of the motions of groups in which nothing changes.

    Args:
        equations: of all groups.
        groups: those in which nothing changes.
        alike: whether they are taken to differ in nothing: then each is predicted from the others.
        priors: deviations of what is shared, (P,) each: of every joint those count that predict motions held out best;
            none: those of the design.
    """
    every_joint = []
    for j, every in enumerate(equations.cells):
        cells = [cell for cell in every if cell.group in groups]
        if alike:
            cells = [replace(cell, group=0) for cell in cells]
        every_joint.append(_Joint(equations.design, j, cells).learn(priors))
    noise2, white2, own2, joint2, missed2, function2 = zip(*every_joint, strict=True)
    return FormError(
        np.array(noise2),
        np.array(white2),
        list(own2),
        np.array(joint2),
        np.array(missed2),
        np.array(function2),
    )


def noise_of_motions(equations: Equations, j: int) -> tuple[np.ndarray, np.ndarray]:
    """First row of each motion, (B,), rising, and variance of a joint's noise in it, over its scale's square [1], (B,).

    All groups are taken to be alike.
    """
    cells = [replace(cell, group=0) for cell in equations.cells[j]]
    cells.sort(key=lambda cell: int(cell.rows[0]))
    left, *_ = _Joint(equations.design, j, cells).noise()
    own = [(left[cell.rows] ** 2).sum() / max(cell.count, 1.0) for cell in cells]
    first = np.array([cell.rows[0] for cell in cells])
    return first, np.maximum(own, MIN_NOISE**2)


def carried_over(error: FormError, before: Equations, after: Equations) -> FormError:
    """The same amplitudes for other columns of the same joints: by term, and of new terms that of the joint."""
    old, new = before.design, after.design
    # of each column where it was, if it was there, and its unit over that which it had
    place, ratio = np.full(new.size, -1), np.zeros(new.size)
    for term, places in new.places.items():
        if term in old.places:
            place[places] = old.places[term]
            ratio[places] = new.units[term] / old.units[term]
    own2 = []
    for j, active in enumerate(new.active):
        variance = np.where(new.own[active], error.joint2[j] / new.size2(j), 0.0)
        # one more, for columns that were nowhere
        known = np.full(old.size + 1, np.nan)
        known[old.active[j]] = error.own2[j]
        # in the term's own units: the columns count in their torque
        carried = known[place[active]] * ratio[active] ** 2
        own2.append(np.where(np.isnan(carried), variance, carried))
    return replace(error, own2=own2)


class _Joint:
    """What some motions of a joint, from 0, teach.

    Attributes:
        prior: of what is shared, (p_j,).
        free, size2: columns of which a motion may have values of its own, and their mean squares.
        waves: which columns make up each unknown function, masks (p_j,).
        rows: of all motions, rising.
        count: rows that count.
    """

    def __init__(self, design: Design, j: int, cells: list[Cell]) -> None:
        self.cells, self._active = cells, design.active[j]
        self.x, self.y = design.columns[j], design.gap[:, j]
        self.rows = np.sort(np.concatenate([cell.rows for cell in cells]))
        self.segment = design.rows.segment[self.rows]
        self.count = sum(cell.count for cell in cells)
        self.waves = [np.isin(self._active, some) for some in design.waves[j]]
        self.prior = design.prior[self._active].copy()
        # what was not believed stays out of each prior that is tried
        self._believed = self.prior > 0
        for some in self.waves:
            self.prior[some] = PRECISE
        self.free = np.flatnonzero(design.own[self._active])
        # amplitudes count in torque of this joint
        self.size2 = np.maximum(design.size2(j)[self.free], MIN_TORQUE**2)
        # held out by sums: all of a group less the part that is predicted
        grams = _of_others(cells, [cell.gram for cell in cells])
        rights = _of_others(cells, [cell.right for cell in cells])
        self._others = list(zip(cells, grams, rights, strict=True))

    def learn(
        self, priors: Sequence[np.ndarray]
    ) -> tuple[float, float, np.ndarray, float, float, np.ndarray]:
        """Variances of noise, of a row by itself, of the columns, of the joint, of what is missed, and of functions."""
        # of several beliefs the one by which motions predict each other best
        if priors:
            every, missed = [], []
            for some in priors:
                prior = np.where(self._believed, some[self._active], self.prior)
                every.append(prior)
                missed.append((self.held_out(prior) ** 2).sum())
            self.prior = every[int(np.argmin(missed))]
        cells, free, size2 = self.cells, self.free, self.size2
        shared = np.flatnonzero(self.prior > 0)
        unit = self.prior[shared]
        in_shared = [some[shared] for some in self.waves]
        groups = sorted({cell.group for cell in cells})
        left, noise2, white2, missed2 = self.noise()
        # at first all columns together leave ``PRECISE`` of the torque
        joint2 = PRECISE**2 / len(free)
        own2 = joint2 / size2
        variance = np.zeros(len(self.prior))
        for _ in range(ROUNDS):
            variance[free] = own2
            squares, determined = np.zeros(len(free)), np.zeros(len(free))
            gains = np.zeros((len(in_shared), len(FUNCTIONS)))
            for group in groups:
                mine = [cell for cell in cells if cell.group == group]
                white = [whitened(cell, variance, noise2) for cell in mine]
                # what a motion leaves of right sides beside its own
                rights = [
                    # A = s^2 I + X O X^T, and A^-1 = (I - A^-1 X O X^T) / s^2
                    cell.right / noise2 - W.T @ (W @ (variance * cell.right)) / noise2
                    for cell, W in zip(mine, white, strict=True)
                ]
                rows_of_all = np.concatenate(white)[:, shared]
                total = rows_of_all.T @ rows_of_all
                right_of_all = np.sum(rights, axis=0)[shared]
                # beta = back^T back right, the posterior of what is shared
                back = inverse(lower(total * unit[:, None] * unit)) * unit
                beta = back.T @ (back @ right_of_all)
                for k, some in enumerate(in_shared):
                    # of a function in units of its size, as ``function_gains`` wants it
                    half, size = back[:, some] / unit[some], unit[some]
                    mean = beta[some] / size
                    gains[k] += function_gains(half.T @ half, mean, size[0])
                for cell, W in zip(mine, white, strict=True):
                    of_all = cell.root[:, shared] @ beta
                    right = cell.right[free] - cell.root[:, free].T @ of_all
                    mine_of_all = W[:, free] * own2
                    inner = W[:, free] @ (own2 * right)
                    # theta by the same identity; to its variance comes that of beta
                    theta = (own2 * right - mine_of_all.T @ inner) / noise2
                    of_theta = own2 - (mine_of_all**2).sum(axis=0)
                    by_shared = mine_of_all.T @ (W[:, shared] @ back.T)
                    of_theta += (by_shared**2).sum(axis=1)
                    squares += theta**2
                    # gamma, 1 - posterior over prior variance, lies between 0 and 1
                    determined += np.clip(1.0 - of_theta / own2, 0.0, 1.0)
            before2, before = joint2, unit.copy()
            # of the joint, and of each column, beside which the joint counts as well
            joint2 = max(squares @ size2 / max(determined.sum(), 1e-3), MIN_FORM**2)
            of_joint = OF_THE_JOINT * joint2 / size2
            own2 = (squares + of_joint) / (determined + OF_THE_JOINT)
            for some, gain in zip(in_shared, gains, strict=True):
                unit[some] = FUNCTIONS[int(gain.argmax())]
            settled = abs(joint2 - before2) <= SETTLED * before2
            if settled and np.array_equal(unit, before):
                break
        # as much as is missed on motions held out
        variance[free] = own2
        variance *= self._growth(shared, unit, variance, noise2, missed2)
        joint2 = float((variance[free] * size2).mean())
        # only now: what is noise by a vibration may be form error as well
        noise2 = max(noise2, _vibration(left[self.rows], self.segment, noise2))
        function2 = np.array([unit[some][0] ** 2 for some in in_shared])
        return noise2, white2, variance, joint2, missed2, function2

    def held_out(self, prior: np.ndarray) -> np.ndarray:
        """What is missed of motions that are predicted from others of their group, over the joint's scale, (M,)."""
        missed, beta = np.zeros(len(self.y)), np.zeros(len(prior))
        power = sum(cell.power for cell in self.cells)
        missed2 = max(power / self.count, MIN_NOISE**2)
        shared = np.flatnonzero(prior > 0)
        # the noise by which the prior counts is what is missed
        for _ in range(2):
            unit = prior[shared] / np.sqrt(missed2)
            for cell, gram, right in self._others:
                normal = gram[np.ix_(shared, shared)] * unit[:, None] * unit
                factor = lower(normal)
                half = forward(factor, unit * right[shared])
                back = solve_triangular(factor.T, half, check_finite=False)
                beta[shared] = unit * back
                missed[cell.rows] = self.y[cell.rows] - self.x[cell.rows] @ beta
            missed2 = max(float(missed @ missed) / self.count, MIN_NOISE**2)
        return missed

    def noise(self) -> tuple[np.ndarray, float, float, float]:
        """Noise (M,), its variance, neighbours counted once and each for itself, and mean square of what is missed.

        Noise is what is left of motions held out, each predicted from others of its group, with values of its own.
        """
        missed, rows, free = self.held_out(self.prior), self.rows, self.free
        missed2 = max(float(missed @ missed) / self.count, MIN_NOISE**2)
        left, spent = np.zeros(len(self.y)), 0.0
        for cell in self.cells:
            x, here = self.x[np.ix_(cell.rows, free)], missed[cell.rows]
            # values of a tenth of the torque each, so that hysteresis is no noise
            own = x * (FIRST_FREEDOM / np.sqrt(self.size2))
            # what is left of rows y is (I + X X^T / s^2)^-1 y
            # by whichever of the two matrices is smaller
            if len(own) > len(free):
                half = inverse(lower(own.T @ own / missed2))
                explained = own @ (half.T @ (half @ (own.T @ here))) / missed2
                left[cell.rows] = here - explained
            else:
                half = inverse(lower(own @ own.T / missed2))
                left[cell.rows] = half.T @ (half @ here)
            # degrees of freedom spent: the trace of I - (I + A)^-1
            spent += len(half) - float((half**2).sum())
        inflation = variance_inflation(left[rows, None], self.segment)[0]
        mean2 = float((left[rows] ** 2).sum()) / max(self.count - spent, 1.0)
        white2 = max(mean2, MIN_NOISE**2)
        return left, white2 * float(inflation), white2, missed2

    def _growth(
        self,
        shared: np.ndarray,
        unit: np.ndarray,
        own2: np.ndarray,
        noise2: float,
        missed2: float,
    ) -> float:
        """Factor by which form error has to change to miss motions held out as far as they are missed.

        ``missed2`` is the mean square that is missed. What is shared is not known exactly either.
        """
        white = [whitened(cell, own2, noise2)[:, shared] * unit for cell in self.cells]
        estimated, form = 0.0, 0.0
        informations = _of_others(self.cells, [W.T @ W for W in white])
        for cell, others in zip(self.cells, informations, strict=True):
            half = forward(lower(others), (cell.root[:, shared] * unit).T)
            estimated += float((half**2).sum())
            form += float((cell.root**2 @ own2).sum())
        form = max(form, MIN_TORQUE**2)
        least, most = missed2 * self.count - estimated, missed2 * self.count
        # no less than what is missed beyond what is not known, no more than all of it
        return max(least / form, min(1.0, most / form))


def function_gains(covariance: np.ndarray, mean: np.ndarray, size: float) -> np.ndarray:
    """Evidence of an unknown function of each size of ``FUNCTIONS`` over that of the one it has [nats].

    Of a function with information S and right side r beside all else, in units of its size, a size rho times as large
    has the evidence 1/2 rho^2 r^T (I + rho^2 S)^-1 r - 1/2 log det(I + rho^2 S).

    Args:
        covariance, mean: of its coefficients, in units of their size, (k, k) and (k,).
        size: of the function, over the joint's scale [1].
    """
    # S + I is the inverse of the posterior covariance; of S one basis serves all sizes
    known = np.linalg.inv(covariance)
    values, vectors = np.linalg.eigh(known - np.eye(len(known)))
    right2 = (vectors.T @ (known @ mean)) ** 2
    values = np.maximum(values, 0.0)

    def evidence(ratio2: np.ndarray) -> np.ndarray:
        determined = 1.0 + ratio2 * values
        explained = ratio2 * right2 / determined - np.log(determined)
        return np.asarray(explained.sum(axis=-1) / 2)

    return evidence((FUNCTIONS[:, None] / size) ** 2) - evidence(np.ones(1))


def _of_others(cells: list[Cell], parts: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Sum over the cells by which each is predicted: of other recordings of its group, or of the only one.

    Args:
        cells: of a joint.
        parts: what is summed, one of each cell.
    """
    groups: dict[int, np.ndarray] = {}
    recordings: dict[tuple[int, int], np.ndarray] = {}
    for cell, part in zip(cells, parts, strict=True):
        groups[cell.group] = groups.get(cell.group, 0.0) + part
        own = cell.group, cell.recording
        recordings[own] = recordings.get(own, 0.0) + part
    count = Counter(group for group, _ in recordings)
    return [
        groups[cell.group]
        - (recordings[cell.group, cell.recording] if count[cell.group] > 1 else part)
        for cell, part in zip(cells, parts, strict=True)
    ]


def _vibration(left: np.ndarray, segment: np.ndarray, noise2: float) -> float:
    """Density of what is left at the frequency where it is strongest; 0 if noise of a density makes as much.

    A vibration shakes the joint, so that columns of accelerations and delays hold it as well as the gap: they are as
    uncertain as it is strong.

    Args:
        left: what is left, (m,).
        segment: number of the segment of each row, (m,).
        noise2: the density.
    """
    parts = np.split(left, np.flatnonzero(np.diff(segment)) + 1)
    cuts = [max(1, round(MIN_MOTIONS * len(part) / len(left))) for part in parts]
    # pieces of one length, so that their spectra can be averaged
    count = min(len(part) // cut for part, cut in zip(parts, cuts, strict=True))
    pieces = [
        part[k * count : (k + 1) * count]
        for part in parts
        for k in range(len(part) // count)
    ]
    power = (np.abs(np.fft.rfft(pieces, axis=1)[:, 1:]) ** 2).mean(axis=0) / count
    # of noise twice the power over its density is distributed as chi-squared; the largest of all frequencies
    freedom = 2 * len(pieces)
    chance = chi2.ppf((1.0 - BY_CHANCE) ** (1.0 / len(power)), freedom) / freedom
    strongest = float(power.max())
    return strongest if strongest > chance * noise2 else 0.0
