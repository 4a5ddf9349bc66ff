"""The corrected arm's torque, linearised in the parameters of all terms, as normal equations.

Around theta_0 the gap of joint j is

    y_j = r_j(theta_0) + A_j theta_0 = A_j theta + N_j delta + d_j T + noise

with r the gap at theta_0, A the derivatives of the predicted torque, N the nominal arm's inertial regressor, delta the
errors of the nominal inertials, d the rate of the predicted torque and T a skew of sampling common to all joints.
Everything later needs only A^T A and its like per piece of the data, so a log's length does not matter.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gapscope.diagnosis.gap.noise_floor import NoiseFloor, noise_floor
from gapscope.diagnosis.model.fit_data import FitData
from gapscope.diagnosis.model.jacobian import columns, link_tangent
from gapscope.diagnosis.model.nonlinear_scan import (
    Scan,
    Shape,
    force_window,
    search_shape,
)
from gapscope.diagnosis.model.terms import Term, Terms
from gapscope.diagnosis.model.torque_sensor import LinkRows, link_rows, two_sides
from gapscope.diagnosis.thresholds import MOST_PIECES, PIECE_LENGTH, SENSOR_ZERO
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.effect import Drift
from gapscope.ident.signals.effective_samples import ar1_samples

COMMON = (
    "torque_offset",
    "coulomb_friction",
    "viscous_friction",
    "armature",
    "torque_scale",
)
"""Effects that are taken out of a joint's gap before a shape is searched on it."""


@dataclass(frozen=True)
class Fold:
    """Normal equations of half a recording, B pieces in time, n joints.

    X = [A, N, y, d] has P columns for the parameters, K for the nominal inertials, one for the gap, one for the skew.

    Attributes:
        gram: X^T W X per piece and joint, shape (B, n, P + K + 2, P + K + 2); W weighs rows down by the uncertainty of
            dry friction.
        rows: weight of the rows of each piece, decimated to about twice the filter's cut-off, shape (B, n).
        floor: RMS of a healthy arm on this fold where its friction is not uncertain [N m], (n,).
        independent: effective number of independent samples, (n,), in the residual when every term is fitted.
        sides: with a joint torque sensor the same of 2 n rows, the actuator side of each joint, then the link side;
            K counts the sensor's errors too.
    """

    gram: np.ndarray
    rows: np.ndarray
    floor: np.ndarray
    independent: np.ndarray
    sides: Fold | None = None

    @property
    def scored(self) -> Fold:
        """Rows from which evidence is computed: both sides if they are known, the joint's torque otherwise."""
        return self.sides or self


@dataclass(frozen=True)
class _Part:
    """Rows of one segment, M of them: gap and rate (M, n), columns (M, n, P), weight (M, n), and its healthy rest."""

    gap: np.ndarray
    columns: np.ndarray
    rate: np.ndarray
    floor: NoiseFloor
    predicted: np.ndarray

    def trust(self, j: int) -> np.ndarray:
        """Square root of the weight of joint j's rows, (M,): less if it may stick."""
        return 1.0 / np.sqrt(
            1.0 + (self.floor.sticking[:, j] / self.floor.steady[j]) ** 2
        )


@dataclass(frozen=True)
class ScanResidual:
    """What the nominal inertials and the plainest effects leave of the gap, M rows.

    Attributes:
        residual: per joint [N m], weighed by trust, (M, n).
        bases: per joint what was taken out of it, orthonormal columns, (M, K).
        trust: square root of the weight of each row, (M, n).
        information: nats per square of the gap [1/(N m)^2], (n,).
    """

    residual: np.ndarray
    bases: list[np.ndarray]
    trust: np.ndarray
    information: np.ndarray

    def gain(self, torque: np.ndarray, free: np.ndarray | None = None) -> float:
        """What a predicted torque, (M, n), explains of the residual, as it stands [nats].

        Args:
            torque: per joint [N m]; joints with none do not count.
            free: one more column per joint that takes its own best value.
        """
        gain = 0.0
        for j in np.flatnonzero(torque.any(axis=0)):
            change, basis = torque[:, j] * self.trust[:, j], self.bases[j]
            change = change - basis @ (basis.T @ change)
            residual = self.residual[:, j]
            if free is not None:
                column = free[:, j] * self.trust[:, j]
                column = column - basis @ (basis.T @ column)
                column /= max(float(np.linalg.norm(column)), 1e-12)
                change, residual = (
                    x - column * (column @ x) for x in (change, residual)
                )
            gain += self.information[j] * float(
                residual @ change - 0.5 * change @ change
            )
        return gain


class Linearisation:
    """Normal equations per fold and joint around the parameters theta_0.

    Args:
        data: the folds.
        theta: theta_0, shape (P,).
        terms: all terms, with the shapes of those that theta_0 uses.

    Attributes:
        terms: all terms, with the shapes of those used, and for the others the most promising ones.
        refined: for the terms used, the shapes that now explain most.
        left: the residual gap, for effects without a column.
    """

    def __init__(self, data: FitData, theta: np.ndarray, terms: Terms) -> None:
        self.data, self.arm, self.body, self.theta = data, data.arm, data.body, theta
        self._used = frozenset(t for t in terms.shapes if theta[list(t.columns)].any())
        known = {t: terms.shapes[t] for t in self._used}
        self.terms = Terms(data.arm.n_joints, known)
        self._corrected = CorrectedArm(self.arm, self.terms.effects(theta))
        parts = [self._part(k) for k in range(len(data.segments))]
        found = self._search(parts)
        self.refined: Mapping[Term, Shape] = {t: found[t] for t in self._used}
        proposed = {
            t: shape.values for t, shape in found.items() if t not in self._used
        }
        self.terms = Terms(data.arm.n_joints, {**known, **proposed})
        self._add_shaped(parts, frozenset(proposed))
        self._parts = parts
        self._links = [self._link(k) for k in range(len(parts))] if data.sensed else []
        self.folds = [
            half for places in self._places() for half in self._halves(places, parts)
        ]

    def shape(self, term: Term) -> Shape:
        """The shape of a term in use, with its standard deviations; empty if its effect has none."""
        values = self.terms.shapes.get(term, ())
        return Shape(
            values,
            self.refined[term].std if term in self.refined else (0.0,) * len(values),
        )

    def _places(self) -> list[list[int]]:
        """Places of each fold's segments among all."""
        ends = np.cumsum([len(fold) for fold in self.data.folds])
        return [
            list(range(end - len(fold), end))
            for fold, end in zip(self.data.folds, ends, strict=True)
        ]

    def rows(
        self, data: FitData, k: int, places: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Equations of segment k of some data of the same arm: [A, N], (M, n, C + K), y and trust, each (M, n).

        A are the columns in ``places``, shape (C,).
        """
        part = self._parts[k] if data is self.data else self._part(k, data)
        x = np.concatenate([part.columns[:, :, places], data.nuisance[k]], axis=2)
        trust = np.array([part.trust(j) for j in range(self.arm.n_joints)]).T
        return x, part.gap + part.columns @ self.theta, trust

    def _part(self, k: int, data: FitData | None = None) -> _Part:
        data = data or self.data
        segment, bodies = data.segments[k], data.bodies[k]
        predicted, x = columns(
            self._corrected, self.body, segment, bodies, self.terms, self.theta
        )
        floor = noise_floor(self._corrected, self.body, segment)
        assert segment.torque is not None
        gap = data.thin(self._corrected.delivered(segment.torque) - predicted, segment)
        rate = data.thin(np.gradient(predicted, segment.motion.t, axis=0), segment)
        sticking = floor.sticking[:: data.step(segment)]
        x = data.thin(x, segment)
        self._add_links(x, data.nuisance[k])
        return _Part(gap, x, rate, NoiseFloor(floor.steady, sticking), predicted)

    def _link(self, k: int) -> LinkRows:
        """What the joint torque sensors measured on a segment; all zero if it has none."""
        segment = self.data.segments[k]
        bodies, zero = self.data.bodies[k], SENSOR_ZERO * self.data.torque_deviation
        rows = link_rows(
            self._corrected, self.body, segment, bodies, self.terms, self.theta, zero
        )
        gap, x, errors = (
            self.data.thin(series, segment)
            for series in (rows.gap, rows.columns, rows.sensor)
        )
        self._add_links(
            x, self.data.nuisance[k], np.full(self.arm.n_joints, float(rows.known))
        )
        return replace(rows, gap=gap, columns=x, sensor=errors)

    def _add_links(
        self, x: np.ndarray, nuisance: np.ndarray, gain: np.ndarray | None = None
    ) -> None:
        """Columns of link inertia from those of the inertial regressor; ``gain`` on the bodies' torque, (n,)."""
        own = self.body.inertial_parameters().reshape(-1, 10)
        by_link = nuisance.reshape(*nuisance.shape[:2], -1, 10)
        gain = (
            1.0 / (1.0 + self._corrected.value("torque_scale", "scale"))
            if gain is None
            else gain
        )
        for link, places in enumerate(self.terms.block("link_inertia").T):
            tangent = link_tangent(own[link], link, self.theta[places])
            units = self.data.units[10 * link : 10 * link + 10]
            scaled = np.divide(
                tangent.T, units, out=np.zeros((4, 10)), where=units > 0
            ).T
            x[:, :, places] = gain[:, None] * (by_link[:, :, link] @ scaled)

    def _add_shaped(self, parts: list[_Part], proposed: frozenset[Term]) -> None:
        """Columns of the terms whose shapes were proposed, into those of the parts."""
        if not proposed:
            return
        names = {t.effect for t in proposed}
        places = [c for t in proposed for c in t.columns]
        for k, part in enumerate(parts):
            segment, bodies = self.data.segments[k], self.data.bodies[k]
            _, x = columns(
                self._corrected,
                self.body,
                segment,
                bodies,
                self.terms,
                self.theta,
                names,
            )
            part.columns[:, :, places] = self.data.thin(x[:, :, places], segment)

    def _search(self, parts: list[_Part]) -> dict[Term, Shape]:
        """The most promising shape of every term that has one."""
        found = {}
        force = self.terms.of("external_force")[0]
        residuals, bases, scans = [], [], []
        for j in range(self.arm.n_joints):
            scan = self._scan(parts, j)
            scans.append(scan)
            pushed = self._scan(parts, j, force)
            residuals.append(pushed.residual)
            bases.append(pushed.basis)
            for term in (
                t
                for t in self.terms.all
                if t.parametrisation.nonlinear and t.joint == j + 1
            ):
                known = self.terms.shapes.get(term)
                if term.effect == "torque_ripple" and known is None:
                    found[term] = scan.best(*self.data.ripples(j), 2)
                    continue
                own = (
                    replace(self._scan(parts, j, term), noise=scan.noise)
                    if known
                    else scan
                )
                segments = self.data.segments
                needed = [p.predicted[:, j] for p in parts]
                found[term] = search_shape(
                    term,
                    self._corrected,
                    segments,
                    own,
                    known[0] if known else None,
                    needed,
                )
        self.scan_residual = ScanResidual(
            np.array([scan.residual for scan in scans]).T,
            [scan.basis for scan in scans],
            np.array(
                [
                    np.concatenate([p.trust(j) for p in parts])
                    for j in range(self.arm.n_joints)
                ]
            ).T,
            np.array(
                [
                    1.0 / (scan.noise + self._doubt(parts, scan, j))
                    for j, scan in enumerate(scans)
                ]
            ),
        )
        window = self._window(parts, np.array(residuals).T, bases)
        if window is not None:
            found[force] = window
        return found

    def _doubt(self, parts: list[_Part], scan: Scan, j: int) -> float:
        """Variance of a healthy arm on joint j, counted per independent sample of what a scan leaves [N^2 m^2]."""
        floor2 = np.mean([p.floor.steady[j] ** 2 for p in parts])
        return float(
            floor2
            * scan.noise
            * len(scan.residual)
            / max(float(scan.residual @ scan.residual), 1e-12)
        )

    def _scan(self, parts: list[_Part], j: int, term: Term | None = None) -> Scan:
        """The residual gap of joint j, and of what a term in use does if one is named.

        The column of a torque scale is the whole torque; the term's own part is taken out of it, and drift out of the
        columns of friction, or else the term would lie within the basis.
        """
        weight = [p.trust(j) for p in parts]

        def thin(series: Sequence[np.ndarray]) -> np.ndarray:
            return np.vstack(
                [
                    w[:, None] * self.data.thin(x, s)
                    for w, x, s in zip(weight, series, self.data.segments, strict=True)
                ]
            )

        common = [self.terms.of(name)[j].columns[0] for name in COMMON]
        known = np.vstack(
            [
                w[:, None] * p.columns[:, j][:, common]
                for w, p in zip(weight, parts, strict=True)
            ]
        )
        bodies = np.vstack(
            [
                w[:, None] * x[:, j]
                for w, x in zip(weight, self.data.nuisance, strict=True)
            ]
        )
        gap = np.concatenate(
            [w * p.gap[:, j] for w, p in zip(weight, parts, strict=True)]
        )
        if term is not None:
            own = self._own(parts, term, j)
            gap = gap + own
            if not term.definition.limits:  # which leaves the predicted torque as it is
                scale = 1.0 + self._corrected.value("torque_scale", "scale")[j]
                known[:, COMMON.index("torque_scale")] += own / scale
            if isinstance(term.definition, Drift):
                names = ("coulomb_friction", "viscous_friction")
                steady = np.vstack(
                    [
                        w[:, None] * x
                        for w, x in zip(
                            weight, self._steady_friction(j, names), strict=True
                        )
                    ]
                )
                known[:, [COMMON.index(name) for name in names]] = steady
        basis = _basis(np.hstack([known, bodies]))
        residual = gap - basis @ (basis.T @ gap)
        independent = ar1_samples(residual[:, None])[0]
        return Scan(residual, basis, thin, float(residual @ residual / independent))

    def _steady_friction(self, j: int, names: tuple[str, ...]) -> list[np.ndarray]:
        """Columns of friction on joint j of each segment as if there were no drift, (M, names)."""
        arm = replace(
            self._corrected,
            effects=tuple(
                e for e in self._corrected.effects if not isinstance(e.effect, Drift)
            ),
        )
        places, out = [self.terms.of(name)[j].columns[0] for name in names], []
        for segment, bodies in zip(self.data.segments, self.data.bodies, strict=True):
            _, x = columns(
                arm, self.body, segment, bodies, self.terms, self.theta, set(names)
            )
            out.append(self.data.thin(x[:, j, places], segment))
        return out

    def _own(self, parts: list[_Part], term: Term, j: int) -> np.ndarray:
        """What a term contributes to joint j at theta_0 [N m], weighed, (M,)."""
        places = list(term.columns)
        return np.concatenate(
            [p.trust(j) * (p.columns[:, j, places] @ self.theta[places]) for p in parts]
        )

    def _window(
        self, parts: list[_Part], residual: np.ndarray, bases: list[np.ndarray]
    ) -> Shape | None:
        """The window in which an external force explains most."""
        segments = self.data.segments
        rotation = self._corrected.base_rotation()
        force = np.vstack(
            [
                -np.stack([p.trust(j) for j in range(self.arm.n_joints)], axis=1)[
                    :, :, None
                ]
                * self.data.thin(b.force @ rotation.T, s)
                for p, b, s in zip(parts, self.data.bodies, segments, strict=True)
            ]
        )
        t = np.concatenate([self.data.time(s) for s in segments])
        steady = np.array([p.floor.steady for p in parts]) ** 2
        weight = 1.0 / (steady.mean(axis=0) + (residual**2).mean(axis=0))
        return force_window(t, residual, force, weight, bases)

    def _halves(self, places: list[int], parts: list[_Part]) -> list[Fold]:
        """The rows of some segments, cut in the middle."""
        chosen = [parts[k] for k in places]
        segments = [self.data.segments[k] for k in places]
        sticking = np.vstack([p.floor.sticking for p in chosen])
        steady2 = np.vstack(
            [np.broadcast_to(p.floor.steady**2, p.gap.shape) for p in chosen]
        )
        seconds = sum(float(s.motion.t[-1] - s.motion.t[0]) for s in segments) / 2
        count = int(
            np.clip(
                seconds / PIECE_LENGTH,
                2,
                max(2, MOST_PIECES // (2 * len(self.data.folds))),
            )
        )
        gap, x, rate = (
            np.vstack([getattr(p, name) for p in chosen])
            for name in ("gap", "columns", "rate")
        )
        nuisance = np.vstack([self.data.nuisance[k] for k in places])
        y = gap + x @ self.theta
        errors = np.zeros((*y.shape, 3 * self.arm.n_joints if self._links else 0))
        full = np.concatenate(
            [x, nuisance, errors, y[:, :, None], rate[:, :, None]], axis=2
        )
        middle = len(y) // 2
        halves = slice(middle), slice(middle, None)
        folds = [self._fold(full[h], sticking[h], steady2[h], count) for h in halves]
        if not self._links:
            return folds
        full, steady2, known = two_sides(
            full, steady2, nuisance, [self._links[k] for k in places], self.theta
        )
        sticking = np.hstack([sticking, np.zeros_like(sticking)])
        sides = [
            self._fold(full[h], sticking[h], steady2[h], count, known[h])
            for h in halves
        ]
        return [
            replace(fold, sides=side) for fold, side in zip(folds, sides, strict=True)
        ]

    def _fold(
        self,
        full: np.ndarray,
        sticking: np.ndarray,
        steady2: np.ndarray,
        count: int,
        known: np.ndarray | float = 1.0,
    ) -> Fold:
        """Normal equations of rows X (M, n, P + K + 2), in ``count`` pieces; ``known``: 0 for rows that say nothing."""
        floor2 = steady2.mean(axis=0)
        weight = known / (1.0 + sticking**2 / floor2)
        full = (full * np.sqrt(weight)[:, :, None]).transpose(1, 0, 2)
        cuts = np.linspace(0, full.shape[1], count + 1).astype(int)
        spans = list(itertools.pairwise(cuts))
        gram = np.array(
            [full[:, a:b].transpose(0, 2, 1) @ full[:, a:b] for a, b in spans]
        )
        rows = np.array([weight[a:b].sum(axis=0) for a, b in spans])
        bodies = self.terms.size + len(self.data.units)
        explaining = np.concatenate(
            [full[:, :, : self.terms.size], full[:, :, bodies:-1]], axis=2
        )
        independent = ar1_samples(_richest_residual(explaining)) * weight.mean(axis=0)
        return Fold(gram, rows, np.sqrt(floor2), independent)


def _basis(x: np.ndarray) -> np.ndarray:
    """Orthonormal basis of the columns of x, those that hardly count left out."""
    norms = np.linalg.norm(x, axis=0)
    u, size, _ = np.linalg.svd(x[:, norms > 0] / norms[norms > 0], full_matrices=False)
    return u[:, size > 1e-3 * size[0]]


def _richest_residual(full: np.ndarray) -> np.ndarray:
    """The residual of y after a fit of all its columns, (M, n), from X of shape (n, M, columns + 1).

    A gap that some effect explains leaves noise, many independent samples; one that nothing explains leaves its own
    slow structure, few samples, and so little evidence for anything.
    """
    residual = np.empty(full.shape[:2])
    for j, x in enumerate(full):
        used = x[:, :-1][:, np.ptp(x[:, :-1], axis=0) > 0]
        scaled = used / np.linalg.norm(used, axis=0)
        residual[j] = (
            x[:, -1] - scaled @ np.linalg.lstsq(scaled, x[:, -1], rcond=1e-6)[0]
        )
    return residual.T
