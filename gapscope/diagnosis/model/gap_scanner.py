"""The search for parameters in which the torque is not linear, over all joints of one linearisation.

For each joint the plainest effects and the errors of the nominal inertials are taken out of the gap; the values of each
nonlinear parameter are scanned on the residual.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from gapscope.diagnosis.model.fit_data import FitData
from gapscope.diagnosis.model.force_window import force_window
from gapscope.diagnosis.model.nonlinear_scan import ScannedArm, search_nonlinear
from gapscope.diagnosis.model.scan_residual import ScanResidual
from gapscope.diagnosis.model.segment_rows import SegmentRows
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.effect import Drift, Effect, External
from gapscope.ident.model.rank import orthonormal_columns
from gapscope.model.effective_samples import independent_samples
from gapscope.model.jacobian import columns
from gapscope.model.scan import NonlinearParameters, Scan
from gapscope.model.terms import Term, Terms

DEPENDENT = 1e-3
"""Directions of a basis smaller than this, over the largest one, say nothing of their own [1]."""


def _is_plain(effect: Effect) -> bool:
    """Whether an effect is taken out of a joint's gap before a nonlinear parameter is searched on it.

    One number of a joint that no healthy arm should have beyond its data sheet.
    """
    return effect.reach == "joint" and effect.fitted.cost == 1 and not effect.inherent


class GapScanner:
    """Scans the gap that an arm with the effects of theta_0 leaves.

    Args:
        data: the folds.
        corrected: the arm with the effects of theta_0.
        terms: all terms, with the nonlinear parameters of those in use.
        theta: theta_0, shape (P,).
        rows: the rows of each segment.
    """

    def __init__(
        self,
        data: FitData,
        corrected: CorrectedArm,
        terms: Terms,
        theta: np.ndarray,
        rows: Sequence[SegmentRows],
    ) -> None:
        self._data, self._corrected = data, corrected
        self._terms, self._theta, self._rows = terms, theta, rows
        self._arm = ScannedArm(corrected, [part.at for part in rows])
        self._trust = [part.trust for part in rows]
        self._common = [effect for effect in terms.definitions if _is_plain(effect)]
        self._scans = [self._scan(j) for j in range(data.arm.n_joints)]

    def search(self) -> dict[Term, NonlinearParameters]:
        """The most promising nonlinear parameters of every term that has some."""
        found = {
            term: self._best(term)
            for term in self._terms.all
            if term.parametrisation.nonlinear and term.joint > 0
        }
        for term in self._terms.all:
            if isinstance(term.definition, External):
                window = self._force_window(term)
                if window is not None:
                    found[term] = window
        return found

    def residual(self) -> ScanResidual:
        """The residual of all joints."""
        information = [
            1.0 / (scan.noise + self._floor_per_sample(scan, j))
            for j, scan in enumerate(self._scans)
        ]
        return ScanResidual(
            np.array([scan.residual for scan in self._scans]).T,
            [scan.basis for scan in self._scans],
            np.vstack(self._trust),
            np.array(information),
        )

    def _best(self, term: Term) -> NonlinearParameters:
        """The best nonlinear parameters of a term on a joint; near those in use if there are any."""
        j = term.joint - 1
        scan, known = self._scans[j], self._terms.shapes.get(term)
        if known is not None:
            scan = replace(self._scan(j, term), noise=scan.noise)
        value = None if known is None else known[0]
        return search_nonlinear(term, self._arm, self._data, scan, value)

    def _scan(self, j: int, term: Term | None = None) -> Scan:
        """Residual of joint j's gap, and of what a term in use does if one is named."""
        places = [self._terms.of(e.name)[j].columns[0] for e in self._common]
        common = self._weighted([part.columns[:, j, places] for part in self._rows], j)
        gap = self._weighted([part.gap[:, j, None] for part in self._rows], j)[:, 0]
        if term is not None:
            own = self._contribution(term, j)
            gap = gap + own
            self._take_out(common, own, term, j)
        inertials = self._weighted([rows[:, j] for rows in self._data.nuisance], j)
        basis = orthonormal_columns(np.hstack([common, inertials]), DEPENDENT)
        residual = gap - basis @ (basis.T @ gap)
        independent = independent_samples(residual[:, None])[0]

        trust = np.concatenate([of[:, j] for of in self._trust])
        noise = float(residual @ residual / independent)
        return Scan(residual, basis, trust, noise)

    def _take_out(
        self, common: np.ndarray, own: np.ndarray, term: Term, j: int
    ) -> None:
        """Take a term in use out of the common columns, in place; it would lie within the basis otherwise."""
        scales = ["scale" in e.quantities.values() for e in self._common]
        # the column of a torque scale is the whole predicted torque, which saturation leaves as it is
        if any(scales) and not term.definition.limits:
            gain = 1.0 + self._corrected.quantity("scale")[j]
            common[:, scales] += own[:, None] / gain
        # the columns of friction drift with it
        if isinstance(term.definition, Drift):
            frictions = [e for e in self._common if e.family == "friction"]
            places = [self._common.index(e) for e in frictions]
            common[:, places] = self._steady(frictions, j)

    def _steady(self, frictions: Sequence[Effect], j: int) -> np.ndarray:
        """Weighted columns of friction on joint j as if there were no drift, (M, F)."""
        steady = tuple(
            e for e in self._corrected.effects if not isinstance(e.effect, Drift)
        )
        arm = replace(self._corrected, effects=steady)
        names = {e.name for e in frictions}
        places = [self._terms.of(e.name)[j].columns[0] for e in frictions]
        out = []
        for k, part in enumerate(self._rows):
            # a drift moves no bodies
            at = part.at.under(arm)
            x = columns(at, self._data, k, self._terms, self._theta, names)
            out.append(x[:, j, places])
        return self._weighted(out, j)

    def _contribution(self, term: Term, j: int) -> np.ndarray:
        """What a term contributes to joint j at theta_0 [N m], weighted, (M,)."""
        places = list(term.columns)
        values = self._theta[places]
        torque = [part.columns[:, j, places] @ values for part in self._rows]
        return self._weighted([x[:, None] for x in torque], j)[:, 0]

    def _weighted(self, series: Sequence[np.ndarray], j: int) -> np.ndarray:
        """Series of each segment on its rows, (M, K), by the trust in joint j's rows, one below the other."""
        pairs = zip(self._trust, series, strict=True)
        return np.vstack([trust[:, j, None] * x for trust, x in pairs])

    def _floor_per_sample(self, scan: Scan, j: int) -> float:
        """Variance of a healthy arm on joint j, counted per independent sample of a scan's residual [N^2 m^2]."""
        floor2 = np.mean([part.floor.steady[j] ** 2 for part in self._rows])
        power = max(float(scan.residual @ scan.residual), 1e-12)
        return float(floor2 * scan.noise * len(scan.residual) / power)

    def _force_window(self, force: Term) -> NonlinearParameters | None:
        """The window in which a force from outside explains most."""
        scans = self._scans
        if self._theta[list(force.columns)].any():
            scans = [self._scan(j, force) for j in range(self._data.arm.n_joints)]
        residual = np.array([scan.residual for scan in scans]).T
        rotation, data = self._corrected.base_rotation(), self._data
        unit_force = [
            -trust[:, :, None] * data.thin(bodies.force @ rotation.T, s)
            for trust, bodies, s in zip(
                self._trust, data.bodies, data.segments, strict=True
            )
        ]
        floor2 = np.array([part.floor.steady for part in self._rows]) ** 2
        weight = 1.0 / (floor2.mean(axis=0) + (residual**2).mean(axis=0))
        t = np.concatenate([data.time(s) for s in data.segments])
        bases = [scan.basis for scan in scans]
        return force_window(t, residual, np.vstack(unit_force), weight, bases)
