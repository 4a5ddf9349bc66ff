"""What the reference leaves open about the arm on the day of the case, and whether an effect is more than that.

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
from gapscope.diagnosis.reference.reference import IdentifiedReference, names_of
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
class EffectColumns:
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
class ReferenceFit:
    """The gap with the reference's uncertainty and some terms fitted.

    Attributes:
        change: nu + u, change of x within that uncertainty, (p,).
        nrmse: torque NRMSE left, (n,).
    """

    change: np.ndarray
    nrmse: np.ndarray


class ReferenceUncertainty:
    """The gap of a case against the identified arm, and what the reference leaves open of it.

    Args:
        reference: the identified arm.
        value: x of the nominal arm of the case, (p,): that of the reference, or moved within its uncertainty.
        case: the case, the baseline's effects taken out of its torque.
        effects: found in it.
    """

    def __init__(
        self,
        reference: IdentifiedReference,
        value: np.ndarray,
        case: Case,
        effects: tuple[AppliedEffect, ...],
    ) -> None:
        self.reference = reference
        recordings = tuple(
            r for r in (*case.recordings, *case.judged) if r.tau is not None
        )
        result = reference.result
        cutoff = position_cutoff(recordings)
        self.rows = stack(result.columns, result.choice.law, recordings, cutoff)
        self._body = RigidBody(case.arm)
        nominal = CorrectedArm(case.arm)
        corrected = replace(nominal, effects=effects)
        moved = self.rows.matrix @ (value - reference.value)
        self.gap = self.rows.torque - self._predicted(nominal) + moved
        self.scale = torque_scale(self.rows.torque)
        self.terms = tuple(self._terms(corrected))
        self.friction = names_of(result, ("c", "b", "d")).ravel()
        self._box = FRICTION_DAY_TO_DAY * np.abs(reference.value[self.friction]) + 1e-9
        self._variance = self._gap_variance(corrected)

    @property
    def _blocks(self) -> tuple[slice, slice, int]:
        """Places in the unknowns: the p errors nu, the changes of friction u, and the skew T; free sizes follow."""
        p, friction = self.rows.matrix.shape[2], len(self.friction)
        return slice(0, p), slice(p, p + friction), p + friction

    def _predicted(self, arm: CorrectedArm) -> np.ndarray:
        """Torque that an arm predicts on the rows less that of known loads, as the rows' torque is, (M, n)."""
        parts = []
        for segment in self.rows.segments:
            body = segment.bodies(self._body)
            predicted = arm.unlimited.predict(body, segment.motion)
            parts.append(predicted - segment.known_torque(self._body))
        return filtered(self.rows, parts)

    def _terms(self, whole: CorrectedArm) -> Iterator[EffectColumns]:
        """Each effect on each of its joints; of a body, mass and first moment are free as well."""
        everything = self._predicted(whole)
        for applied in whole.effects:
            others = tuple(e for e in whole.effects if e is not applied)
            for index, joint in enumerate(applied.joints or (0,)):
                kept = (*others, *_without_joint(applied, index))
                change = everything - self._predicted(replace(whole, effects=kept))
                columns = [change[:, :, None]]
                if isinstance(applied.effect, LinkChange):
                    columns.append(self._mass_and_moment(applied))
                yield EffectColumns(
                    applied.name, joint, np.concatenate(columns, axis=2)
                )

    def _mass_and_moment(self, applied: AppliedEffect) -> np.ndarray:
        """Columns of W of the changed link's mass and first moment, (M, n, 4)."""
        link = self._body.last_link
        if "link" in applied.parameters:
            link = int(applied.parameters["link"]) - 1
        return self.rows.matrix[:, :, 10 * link : 10 * link + 4]

    def _gap_variance(self, whole: CorrectedArm) -> np.ndarray:
        """Mean square of the residual with all effects, no less than the residual on the reference [(N m)^2], (n,)."""
        residual = self.rows.torque - self._predicted(whole)
        return np.asarray(
            np.maximum((residual**2).mean(axis=0), self.reference.rest**2)
        )

    def fit(self, terms: tuple[EffectColumns, ...]) -> ReferenceFit:
        """Fit uncertainty and terms together; twice, the second time with the weights of the residual."""
        x = self._design([term.columns for term in terms])
        gram = np.einsum("mja,mjb->jab", x, x, optimize=True)
        right = np.einsum("mja,mj->ja", x, self.gap)
        square = (self.gap**2).sum(axis=0)
        variance = self._variance
        # joints that the terms explain better weigh more the second time
        for _ in range(2):
            u = self._solve(gram, right, variance, len(x))
            fitted_square = np.einsum("a,jab,b->j", u, gram, u)
            squared_error = square - 2 * right @ u + fitted_square
            mean = np.maximum(squared_error, 0.0) / len(x)
            variance = np.maximum(mean, self.reference.rest**2)
        identified, friction, _ = self._blocks
        change = u[identified].copy()
        change[self.friction] += u[friction]
        return ReferenceFit(change, np.sqrt(mean) / self.scale)

    def _solve(
        self, gram: np.ndarray, right: np.ndarray, variance: np.ndarray, count: int
    ) -> np.ndarray:
        """Unknowns of least squares from normal equations per joint; friction stays within its box, (P,)."""
        weight = ar1_samples(self.gap) / count / variance
        target = weight @ right
        normal = self._with_prior(np.tensordot(weight, gram, axes=1))
        unit, scaled = _scaled(normal)
        root = np.linalg.cholesky(scaled + 1e-12 * np.eye(len(normal))).T
        goal = np.linalg.solve(root.T, unit * target)
        u = np.linalg.solve(root, goal)
        _, friction, _ = self._blocks
        # The bounded problem is solved only if the free solution leaves the box.
        if (np.abs(unit[friction] * u[friction]) > self._box).any():
            bound = np.full(len(normal), np.inf)
            bound[friction] = self._box / unit[friction]
            u = lsq_linear(root, goal, (-bound, bound), method="bvls", max_iter=200).x
        return np.asarray(unit * u)

    def _with_prior(self, normal: np.ndarray) -> np.ndarray:
        """Normal equations with the precision of nu, that of u (its box as a deviation), of T, and flat ones."""
        identified, friction, skew = self._blocks
        diagonal = np.zeros(len(normal))
        diagonal[friction] = 3.0 / self._box**2  # a box of half width b has b^2 / 3
        diagonal[skew] = REFERENCE_SKEW**-2
        diagonal[skew + 1 :] = FLAT * np.diag(normal)[skew + 1 :] + 1e-12
        prior = np.diag(diagonal)
        prior[identified, identified] = self.reference.precision
        return np.asarray(normal + prior)

    def covariances(self) -> tuple[tuple[EffectColumns, np.ndarray], ...]:
        """Covariance of the factors of each term's columns, (k, k), the reference's uncertainty included.

        Of a body, mass and first moment alone; the factor of a joint effect counts in its own size.
        """
        columns = []
        for term in self.terms:
            is_body = term.columns.shape[2] > 1
            columns.append(term.columns[:, :, 1:] if is_body else term.columns)
        x = self._design(columns)
        gram = np.einsum("mja,mjb->jab", x, x, optimize=True)
        weight = ar1_samples(self.gap) / len(x) / self._variance
        normal = self._with_prior(np.tensordot(weight, gram, axes=1))
        unit, scaled = _scaled(normal)
        covariance = np.linalg.inv(scaled) * unit[:, None] * unit
        _, _, skew = self._blocks
        begin, found = skew + 1, []
        for term, block in zip(self.terms, columns, strict=True):
            end = begin + block.shape[2]
            found.append((term, covariance[begin:end, begin:end]))
            begin = end
        return tuple(found)

    def _design(self, columns: list[np.ndarray]) -> np.ndarray:
        """[W, W of friction, d, C], (M, n, ...)."""
        parts = [
            self.rows.matrix,
            self.rows.matrix[:, :, self.friction],
            self.rows.rate[:, :, None],
            *columns,
        ]
        return np.concatenate(parts, axis=2)

    def torque_nrmse_of(self, change: np.ndarray) -> np.ndarray:
        """RMS of what a change of x does to the torque of the case, over the joint's torque scale, (n,)."""
        torque = self.rows.matrix @ change
        return np.asarray(np.sqrt((torque**2).mean(axis=0)) / self.scale)

    def significant_terms(
        self,
    ) -> tuple[tuple[EffectColumns, ...], tuple[tuple[EffectColumns, float], ...]]:
        """The terms beyond the reference's uncertainty, and the others, each with what it closes beyond it [NRMSE].

        The term that closes least is dropped as long as it closes less than ``MIN_CHANGE``.
        """
        kept, dropped = list(self.terms), []
        while kept:
            best = self.fit(tuple(kept)).nrmse
            closes = []
            for term in kept:
                others = tuple(t for t in kept if t is not term)
                closes.append(float((self.fit(others).nrmse - best).max()))
            least = int(np.argmin(closes))
            if closes[least] >= MIN_CHANGE:
                break
            dropped.append((kept.pop(least), closes[least]))
        return tuple(kept), tuple(dropped)


def _without_joint(applied: AppliedEffect, index: int) -> tuple[AppliedEffect, ...]:
    """The effect on its joints but the one of this place; nothing if it has no other."""
    rest = [k for k in range(len(applied.joints)) if k != index]
    if not rest:
        return ()
    joints = tuple(applied.joints[k] for k in rest)
    values = {name: value[rest] for name, value in applied.parameters.items()}
    return (AppliedEffect(applied.name, joints, values),)


def _scaled(normal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Units of the unknowns in which a normal matrix has a diagonal of ones, (P,), and the matrix in them, (P, P)."""
    unit = 1.0 / np.sqrt(np.diag(normal))
    return unit, normal * unit[:, None] * unit
