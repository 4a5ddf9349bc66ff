"""Form error and noise, learnt from data in which nothing changed.

No catalogue has the whole truth of an arm. On joint j, motion b is taken to leave

    A_j theta_bj + e_j,    theta_bj ~ N(0, diag omega_j^2),    e_j ~ N(0, sigma_j^2)

beside what all motions of a group share: a repeatable function of the motion, spanned by the columns A_j of the
candidates themselves, with an amplitude omega per joint. The same motion again has the same theta: it teaches noise,
not form. Noise is what is left of motions held out when each has values of its own; neighbours in time resemble each
other, so that 1 + 2 sum_k rho_k of them count as one (bayley1946). The amplitude follows from the evidence of the
motions of each group (mackay1992b), with gamma the number of values that data determine,

    omega_j^2 = sum theta^2 / sum gamma,

and is no less than what makes motions held out as surprising as they are.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from gapscope.ident.signals.effective_samples import variance_inflation
from gapscope.model.equations import Cell, Equations, eliminated, forward, lower

ROUNDS = 12
"""Updates of the amplitudes. (budget)"""
FIRST_FORM, FIRST_FREEDOM = 0.02, 0.1
"""Form error at first, and what a motion may have of its own when noise is measured, of each column [1]."""
LEAST_NOISE = 4e-3
"""Noise of a joint over its torque's deviation at least [1]: recordings without noise have finite weights."""
LEAST_FORM = 2e-3
"""Form error of one column at least [1]: no arm is modelled better than to a few thousandths."""
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
    """

    noise2: np.ndarray
    white2: np.ndarray
    own2: list[np.ndarray]
    joint2: np.ndarray


def learn(equations: Equations, groups: Collection[int]) -> FormError:
    """Noise and amplitudes of form error by the evidence of the motions of groups in which nothing changes."""
    noise2, white2, own2, joint2 = [], [], [], []
    for j, every in enumerate(equations.cells):
        cells = [cell for cell in every if cell.group in groups]
        one = _learn_joint(equations, j, cells)
        noise2.append(one[0])
        white2.append(one[1])
        own2.append(one[2])
        joint2.append(one[3])
    return FormError(np.array(noise2), np.array(white2), own2, np.array(joint2))


def carried_over(error: FormError, before: Equations, after: Equations) -> FormError:
    """The same amplitudes for other columns of the same joints: by term, and of new terms that of the joint."""
    old, new = before.design, after.design
    own2 = []
    for j, active in enumerate(new.active):
        size2 = (new.columns[j] ** 2).mean(axis=0)
        variance = np.where(new.own[active], error.joint2[j] / size2, 0.0)
        for term, places in new.places.items():
            if term not in old.places:
                continue
            here, there = (
                np.isin(active, places),
                np.isin(old.active[j], old.places[term]),
            )
            if here.sum() == there.sum():
                # in the term's own units: the columns count in their torque
                ratio = (new.units[term] / old.units[term])[np.isin(places, active)]
                variance[here] = error.own2[j][there] * ratio**2
        own2.append(variance)
    return FormError(error.noise2, error.white2, own2, error.joint2)


def _learn_joint(
    equations: Equations, j: int, cells: list[Cell]
) -> tuple[float, float, np.ndarray, float]:
    """Noise variance, that of a row by itself, variances of the columns, and that of the joint."""
    design = equations.design
    active = design.active[j]
    prior, own = design.prior[active], design.own[active]
    shared, free = np.flatnonzero(prior > 0), np.flatnonzero(own)
    unit = prior[shared]
    groups = sorted({cell.group for cell in cells})
    # amplitudes count in torque of this joint
    size2 = np.maximum((design.columns[j][:, free] ** 2).mean(axis=0), 1e-12)
    noise2, white2, missed2 = _noise(equations, j, cells, free, size2)
    joint2 = FIRST_FORM**2
    own2 = joint2 / size2
    variance = np.zeros(len(active))
    for _ in range(ROUNDS):
        variance[free] = own2
        squares, determined = np.zeros(len(free)), np.zeros(len(free))
        for group in groups:
            mine = [cell for cell in cells if cell.group == group]
            parts = [eliminated(cell, variance, noise2) for cell in mine]
            total = np.sum([part.information for part in parts], axis=0)
            total = total[np.ix_(shared, shared)]
            back = forward(lower(total * unit[:, None] * unit), np.diag(unit))
            right = np.sum([part.pull for part in parts], axis=0)[shared]
            beta = back.T @ (back @ right)
            for cell, part in zip(mine, parts, strict=True):
                open_right = cell.right[free] - cell.gram[np.ix_(free, shared)] @ beta
                half = forward(part.factor, np.diag(part.size))
                theta = half.T @ (half @ open_right) / noise2
                by_shared = half.T @ (half @ cell.gram[np.ix_(free, shared)]) / noise2
                of_theta = (half**2).sum(axis=0)
                of_theta += ((by_shared @ back.T) ** 2).sum(axis=1)
                squares += theta**2
                determined += np.clip(1.0 - of_theta / own2, 0.0, 1.0)
        joint2 = max(squares @ size2 / max(determined.sum(), 1e-3), LEAST_FORM**2)
        own2 = (squares + OF_THE_JOINT * joint2 / size2) / (determined + OF_THE_JOINT)
    # no less than what is missed on motions held out
    variance[free] = own2
    variance *= _growth(cells, shared, unit, variance, noise2, missed2)
    joint2 = float((variance[free] * size2).mean())
    return noise2, white2, variance, float(joint2)


def _others(cell: Cell, cells: list[Cell]) -> list[Cell]:
    """Cells of the same group by which one is predicted: other recordings, or other motions of the only one."""
    group = [c for c in cells if c.group == cell.group and c is not cell]
    return [c for c in group if c.recording != cell.recording] or group


def _growth(
    cells: list[Cell],
    shared: np.ndarray,
    unit: np.ndarray,
    own2: np.ndarray,
    noise2: float,
    missed2: float,
) -> float:
    """Factor, 1 or more, by which form error has to grow to miss motions held out as far as the arm is missed.

    ``missed2`` is the mean square that is missed beyond noise. What is shared is not known exactly either.
    """
    count = sum(len(cell.rows) for cell in cells)
    parts = [eliminated(cell, own2, noise2) for cell in cells]
    estimated, form = 0.0, 0.0
    for cell in cells:
        held_out = _others(cell, cells)
        others = [
            part.information
            for other, part in zip(cells, parts, strict=True)
            if any(other is one for one in held_out)
        ]
        normal = sum(others, np.zeros_like(cell.gram))[np.ix_(shared, shared)]
        normal = normal * unit[:, None] * unit + np.eye(len(unit))
        covariance = np.linalg.inv(normal) * unit[:, None] * unit
        estimated += float((cell.gram[np.ix_(shared, shared)] * covariance).sum())
        form += float(np.diag(cell.gram) @ own2)
    return max((missed2 - estimated / count) / max(form / count, 1e-12), 1.0)


def _held_out(equations: Equations, j: int, cells: list[Cell]) -> np.ndarray:
    """What is missed of motions of a joint that are predicted from others of their group, over its scale, (M,)."""
    design = equations.design
    prior = design.prior[design.active[j]]
    shared = np.flatnonzero(prior > 0)
    unit, x, y = prior[shared], design.columns[j], design.gap[:, j]
    count = sum(len(cell.rows) for cell in cells)
    missed2 = max(sum(cell.power for cell in cells) / count, LEAST_NOISE**2)
    missed = np.zeros(len(y))
    # the noise by which the prior counts is what is missed
    for _ in range(2):
        for cell in cells:
            others = _others(cell, cells)
            gram = sum((c.gram for c in others), np.zeros_like(cell.gram))
            right = sum((c.right for c in others), np.zeros_like(cell.right))
            normal = gram[np.ix_(shared, shared)] * unit[:, None] * unit / missed2
            normal[np.diag_indices(len(unit))] += 1.0
            beta = unit * np.linalg.solve(normal, unit * right[shared] / missed2)
            missed[cell.rows] = y[cell.rows] - x[np.ix_(cell.rows, shared)] @ beta
        missed2 = max(float(missed @ missed) / count, LEAST_NOISE**2)
    return missed


def _noise(
    equations: Equations,
    j: int,
    cells: list[Cell],
    free: np.ndarray,
    size2: np.ndarray,
) -> tuple[float, float, float]:
    """Variance of the noise, neighbours counted once and each for itself, and mean square of what is missed.

    Noise is what is left of motions held out, each predicted from others of its group, with values of its own.
    """
    design = equations.design
    count = sum(len(cell.rows) for cell in cells)
    x, y = design.columns[j], design.gap[:, j]
    missed = _held_out(equations, j, cells)
    missed2 = max(float(missed @ missed) / count, LEAST_NOISE**2)
    left, spent = np.zeros(len(y)), 0.0
    for cell in cells:
        own = x[np.ix_(cell.rows, free)] * (FIRST_FREEDOM / np.sqrt(size2))
        normal = own.T @ own / missed2 + np.eye(len(free))
        value = np.linalg.solve(normal, own.T @ missed[cell.rows] / missed2)
        spent += len(free) - float(np.trace(np.linalg.inv(normal)))
        left[cell.rows] = missed[cell.rows] - own @ value
    rows = np.sort(np.concatenate([cell.rows for cell in cells]))
    inflation = variance_inflation(left[rows, None], design.rows.segment[rows])[0]
    mean2 = float((left[rows] ** 2).sum()) / max(count - spent, 1.0)
    white2 = max(mean2, LEAST_NOISE**2)
    return white2 * float(inflation), white2, missed2
