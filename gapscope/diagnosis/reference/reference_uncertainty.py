"""Leeway: what the reference leaves open about the arm on the day of the case, and whether an effect is more than that.

The gap y of the case against the identified arm, on rows as the torque gap sees them, is taken as

    y_j = W_j nu + W_j u + d_j T + C_j a + noise

with nu the error of the identified parameters, whose precision the reference gives; u the change of friction from
one day to another, within a box of +-15 % of what was identified; T a skew of sampling; and C what the effects found
do to the torque, of free size. An effect is a change only if the gap without it stays wider, whatever nu, u and T.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import lsq_linear

from gapscope.arm.case import Case
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.diagnosis.gap.torque_gap import torque_scale
from gapscope.diagnosis.reference.reference import Reference, names_of
from gapscope.diagnosis.reference.reference_rows import filtered, stack
from gapscope.diagnosis.thresholds import (
    FRICTION_DAY_TO_DAY,
    MIN_CHANGE,
    REFERENCE_SKEW,
)
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.effect import LinkChange
from gapscope.ident.signals.conditioning import position_cutoff
from gapscope.ident.signals.effective_samples import ar1_samples

FLAT = 1e-6
"""Prior precision of sizes that are free, over that of the data."""


@dataclass(frozen=True)
class Term:
    """What one effect does to one joint, or to all if it acts on a link or the arm.

    Attributes:
        effect: name of the effect.
        joint: from 1; 0 if it acts on all.
        columns: of free size, (M, n, k).
    """

    effect: str
    joint: int
    columns: np.ndarray


@dataclass(frozen=True)
class Fit:
    """The gap with leeway and some terms fitted.

    Attributes:
        change: nu + u, change of x within the leeway, (p,).
        nrmse: torque NRMSE left, (n,).
    """

    change: np.ndarray
    nrmse: np.ndarray


class ReferenceUncertainty:
    """The gap of a case against the identified arm, and what the reference leaves open of it.

    Args:
        reference: the identified arm.
        value: x of the nominal arm of the case, (p,): that of the reference, or moved within the leeway.
        case: the case, the baseline's effects taken out of its torque.
        effects: found in it.
    """

    def __init__(
        self,
        reference: Reference,
        value: np.ndarray,
        case: Case,
        effects: tuple[AppliedEffect, ...],
    ) -> None:
        self.reference = reference
        told = tuple(r for r in (*case.recordings, *case.judged) if r.tau is not None)
        result = reference.result
        self.rows = stack(
            result.columns, result.choice.law, told, position_cutoff(told)
        )
        self._body = RigidBody(case.arm)
        bare = CorrectedArm(case.arm)
        self.gap = (
            self.rows.torque
            - self._predicted(bare)
            + self.rows.matrix @ (value - reference.value)
        )
        self.scale = torque_scale(self.rows.torque)
        whole = replace(bare, effects=effects)
        self.terms = tuple(self._terms(whole))
        self.friction = names_of(result, ("c", "b", "d")).ravel()
        self._box = FRICTION_DAY_TO_DAY * np.abs(reference.value[self.friction]) + 1e-9
        self._variance = self._gap_variance(whole)

    def _predicted(self, arm: CorrectedArm) -> np.ndarray:
        """Torque that an arm predicts on the rows less that of known loads, as the rows' torque is, (M, n)."""
        parts = [
            arm.unlimited.predict(s.bodies(self._body), s.motion)
            - s.known_torque(self._body)
            for s in self.rows.segments
        ]
        return filtered(self.rows, parts)

    def _terms(self, whole: CorrectedArm) -> Iterator[Term]:
        """Each effect on each of its joints; of a body, mass and first moment are free as well."""
        everything = self._predicted(whole)
        for applied in whole.effects:
            others = tuple(e for e in whole.effects if e is not applied)
            for i, joint in enumerate(applied.joints or (0,)):
                rest = [k for k in range(len(applied.joints)) if k != i]
                kept = others
                if rest:
                    values = {
                        name: value[rest] for name, value in applied.parameters.items()
                    }
                    kept = (
                        *others,
                        AppliedEffect(
                            applied.name, tuple(applied.joints[k] for k in rest), values
                        ),
                    )
                does = everything - self._predicted(replace(whole, effects=kept))
                columns = [does[:, :, None]]
                if isinstance(applied.effect, LinkChange):
                    link = (
                        int(applied.parameters["link"]) - 1
                        if "link" in applied.parameters
                        else self._body.last_link
                    )
                    columns.append(self.rows.matrix[:, :, 10 * link : 10 * link + 4])
                yield Term(applied.name, joint, np.concatenate(columns, axis=2))

    def _gap_variance(self, whole: CorrectedArm) -> np.ndarray:
        """Mean square of the residual with all effects, no less than the residual on the reference [N^2 m^2], (n,)."""
        left = self.rows.torque - self._predicted(whole)
        return np.asarray(np.maximum((left**2).mean(axis=0), self.reference.rest**2))

    def fit(self, terms: tuple[Term, ...]) -> Fit:
        """Fit leeway and terms together; twice, the second time with the weights of the residual."""
        x = self._design([t.columns for t in terms])
        gram = np.einsum("mja,mjb->jab", x, x, optimize=True)
        right = np.einsum("mja,mj->ja", x, self.gap)
        variance, square = self._variance, (self.gap**2).sum(axis=0)
        nrmse, u = np.zeros(len(self.scale)), np.zeros(x.shape[2])
        for _ in range(2):
            u = self._solve(gram, right, variance, len(x))
            squares = square - 2 * right @ u + np.einsum("a,jab,b->j", u, gram, u)
            mean = np.maximum(squares, 0.0) / len(x)
            nrmse, variance = (
                np.sqrt(mean) / self.scale,
                np.maximum(mean, self.reference.rest**2),
            )
        p, q = self.rows.matrix.shape[2], len(self.friction)
        change = u[:p].copy()
        change[self.friction] += u[p : p + q]
        return Fit(change, nrmse)

    def _solve(
        self, gram: np.ndarray, right: np.ndarray, variance: np.ndarray, count: int
    ) -> np.ndarray:
        weight = ar1_samples(self.gap) / count / variance
        target = weight @ right
        normal = self._with_prior(np.tensordot(weight, gram, axes=1))
        p, q = self.rows.matrix.shape[2], len(self.friction)
        day = np.arange(p, p + q)
        unit = 1.0 / np.sqrt(np.diag(normal))
        root = np.linalg.cholesky(
            normal * unit[:, None] * unit + 1e-12 * np.eye(len(normal))
        ).T
        goal = np.linalg.solve(root.T, unit * target)
        u = np.linalg.solve(root, goal)
        if (np.abs(unit[day] * u[day]) > self._box).any():
            wide = np.full(len(normal), np.inf)
            wide[day] = self._box / unit[day]
            u = lsq_linear(root, goal, (-wide, wide), method="bvls", max_iter=200).x
        return np.asarray(unit * u)

    def _with_prior(self, normal: np.ndarray) -> np.ndarray:
        """Normal equations with the precision of nu, that of u (its box as a deviation), of T, and flat ones."""
        p, q = self.rows.matrix.shape[2], len(self.friction)
        prior = np.zeros_like(normal)
        prior[:p, :p] = self.reference.precision
        day = np.arange(p, p + q)
        prior[day, day] = 3.0 / self._box**2
        prior[p + q, p + q] = REFERENCE_SKEW**-2
        free = np.arange(p + q + 1, len(normal))
        prior[free, free] = FLAT * np.diag(normal)[free] + 1e-12
        return np.asarray(normal + prior)

    def covariances(self) -> tuple[tuple[Term, np.ndarray], ...]:
        """Covariance of each term's columns' factors, leeway and all, (k, k); of a body mass and first moment alone.

        The factor of a joint effect counts in its own size.
        """
        columns = [
            t.columns[:, :, 1:] if t.columns.shape[2] > 1 else t.columns
            for t in self.terms
        ]
        x = self._design(columns)
        left = self._variance
        gram = np.einsum("mja,mjb->jab", x, x, optimize=True)
        normal = self._with_prior(
            np.tensordot(ar1_samples(self.gap) / len(x) / left, gram, axes=1)
        )
        unit = 1.0 / np.sqrt(np.diag(normal))
        covariance = np.linalg.inv(normal * unit[:, None] * unit) * unit[:, None] * unit
        starts = (
            len(normal)
            - sum(c.shape[2] for c in columns)
            + np.cumsum([0, *(c.shape[2] for c in columns)])
        )
        return tuple(
            (t, covariance[a:b, a:b])
            for t, a, b in zip(self.terms, starts, starts[1:], strict=False)
        )

    def _design(self, columns: list[np.ndarray]) -> np.ndarray:
        """[W, W of friction, d, C], (M, n, ...)."""
        parts = [
            self.rows.matrix,
            self.rows.matrix[:, :, self.friction],
            self.rows.rate[:, :, None],
            *columns,
        ]
        return np.concatenate(parts, axis=2)

    def does(self, change: np.ndarray) -> np.ndarray:
        """RMS of what a change of x does to the torque of the case, over the joint's torque scale, (n,)."""
        return np.asarray(
            np.sqrt(((self.rows.matrix @ change) ** 2).mean(axis=0)) / self.scale
        )

    def news(self) -> tuple[tuple[Term, ...], tuple[tuple[Term, float], ...]]:
        """The terms that are more than leeway, and those that are not, each with what it closes beyond it [NRMSE]."""
        kept, dropped = list(self.terms), []
        while kept:
            best = self.fit(tuple(kept)).nrmse
            closes = [
                float(
                    (
                        self.fit(tuple(t for t in kept if t is not term)).nrmse - best
                    ).max()
                )
                for term in kept
            ]
            least = int(np.argmin(closes))
            if closes[least] >= MIN_CHANGE:
                break
            dropped.append((kept.pop(least), closes[least]))
        return tuple(kept), tuple(dropped)
