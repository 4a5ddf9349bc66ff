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
from gapscope.diagnosis.model.jacobian import columns
from gapscope.diagnosis.model.nonlinear_scan import ScannedArm, search_nonlinear
from gapscope.diagnosis.model.scan import NonlinearParameters, Scan
from gapscope.diagnosis.model.scan_residual import ScanResidual
from gapscope.diagnosis.model.segment_rows import SegmentRows
from gapscope.diagnosis.model.terms import Term, Terms
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.effect import Drift
from gapscope.ident.model.rank import orthonormal_columns
from gapscope.ident.signals.effective_samples import independent_samples

COMMON = (
    "torque_offset",
    "coulomb_friction",
    "viscous_friction",
    "armature",
    "torque_scale",
)
"""Effects that are taken out of a joint's gap before a nonlinear parameter is searched on it."""
FRICTION = ("coulomb_friction", "viscous_friction")
DEPENDENT = 1e-3
"""Directions of a basis smaller than this, over the largest one, say nothing of their own [1]."""


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
        self._common = [COMMON.index(name) for name in FRICTION]
        self._scans = [self._scan(j) for j in range(data.arm.n_joints)]

    def search(self) -> dict[Term, NonlinearParameters]:
        """The most promising nonlinear parameters of every term that has some."""
        found = {
            term: self._best(term)
            for term in self._terms.all
            if term.parametrisation.nonlinear and term.joint > 0
        }
        window = self._force_window()
        if window is not None:
            found[self._terms.of("external_force")[0]] = window
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
        places = [self._terms.of(name)[j].columns[0] for name in COMMON]
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
        # the column of a torque scale is the whole predicted torque, which saturation leaves as it is
        if not term.definition.limits:
            scale = 1.0 + self._corrected.value("torque_scale", "scale")[j]
            common[:, COMMON.index("torque_scale")] += own / scale
        # the columns of friction drift with it
        if isinstance(term.definition, Drift):
            common[:, self._common] = self._steady_friction(j)

    def _steady_friction(self, j: int) -> np.ndarray:
        """Weighted columns of friction on joint j as if there were no drift, (M, 2)."""
        steady = tuple(
            e for e in self._corrected.effects if not isinstance(e.effect, Drift)
        )
        arm = replace(self._corrected, effects=steady)
        places = [self._terms.of(name)[j].columns[0] for name in FRICTION]
        out = []
        for k, part in enumerate(self._rows):
            # a drift moves no bodies
            at = part.at.under(arm)
            x = columns(at, self._data, k, self._terms, self._theta, set(FRICTION))
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

    def _force_window(self) -> NonlinearParameters | None:
        """The window in which an external force explains most."""
        force = self._terms.of("external_force")[0]
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
