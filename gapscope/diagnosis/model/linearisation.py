"""The corrected arm's torque, linearised in the parameters of all terms, as normal equations.

Around theta_0 the gap of joint j is

    y_j = r_j(theta_0) + A_j theta_0 = A_j theta + N_j delta + d_j T + noise

with r the gap at theta_0, A the derivatives of the predicted torque, N the nominal arm's inertial regressor, delta the
errors of the nominal inertials, d the rate of the predicted torque and T a skew of sampling common to all joints.
Everything later needs only A^T A and its like per piece of the data, so a log's length does not matter.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from gapscope.diagnosis.gap.noise_floor import NoiseFloor, noise_floor
from gapscope.diagnosis.model.discrepancy import Discrepancy, discrepancy
from gapscope.diagnosis.model.fit_data import FitData
from gapscope.diagnosis.model.fold import EquationRows, Fold
from gapscope.diagnosis.model.gap_scanner import GapScanner
from gapscope.diagnosis.model.segment_rows import SegmentRows
from gapscope.diagnosis.model.torque_sensor import LinkRows, link_rows, two_sides
from gapscope.diagnosis.thresholds import MOST_PIECES, PIECE_LENGTH, SENSOR_ZERO
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.effect import LinkChange
from gapscope.model.jacobian import columns
from gapscope.model.prediction import Prediction
from gapscope.model.scan import NonlinearParameters
from gapscope.model.terms import Term, Terms


class Linearisation:
    """Normal equations per fold and joint around the parameters theta_0.

    Args:
        data: the folds.
        theta: theta_0, shape (P,).
        terms: all terms, with the nonlinear parameters of those that theta_0 uses.

    Attributes:
        terms: all terms, with the nonlinear parameters of those used, and for the others the most promising ones.
        refined: for the terms used, the nonlinear parameters that now explain most.
        scan_residual: the residual, for effects that no column represents.
        folds: two for each fold of the data, its first and its second half.
        discrepancy: what a healthy arm leaves of the scored rows, learnt from these.
    """

    def __init__(self, data: FitData, theta: np.ndarray, terms: Terms) -> None:
        self.data, self.arm, self.body, self.theta = data, data.arm, data.body, theta
        used = {
            term: values
            for term, values in terms.shapes.items()
            if theta[list(term.columns)].any()
        }
        motors = data.arm.coupled_motors
        self.terms = Terms(data.arm.n_joints, used, motors)
        self._corrected = CorrectedArm(self.arm, self.terms.effects(theta))
        self._rows = [self._segment_rows(k) for k in range(len(data.segments))]
        scanner = GapScanner(data, self._corrected, self.terms, theta, self._rows)
        found = scanner.search()
        self.scan_residual = scanner.residual()
        self.refined: Mapping[Term, NonlinearParameters] = {t: found[t] for t in used}
        proposed = {t: best.values for t, best in found.items() if t not in used}
        self.terms = Terms(data.arm.n_joints, {**used, **proposed}, motors)
        self._add_proposed(list(proposed))
        self._links: list[LinkRows] = []
        if data.sensed:
            self._links = [self._link_rows(k) for k in range(len(data.segments))]
        cut = [self._cut(places) for places in self._fold_places()]
        self.folds = [fold for folds, _ in cut for fold in folds]
        self.discrepancy = self._discrepancy(
            [half for _, halves in cut for half in halves]
        )

    def nonlinear(self, term: Term) -> NonlinearParameters:
        """The nonlinear parameters of a term in use, with their standard deviations; empty if its effect has none."""
        values = self.terms.shapes.get(term, ())
        if term in self.refined:
            return NonlinearParameters(values, self.refined[term].std)
        return NonlinearParameters(values, (0.0,) * len(values))

    def departure(self, theta: np.ndarray) -> np.ndarray:
        """How far the torque at other values departs from the linearisation, RMS over what a healthy arm leaves, (n,).

        Args:
            theta: the values, (P,), of terms whose torque is smooth in them; those used may have a refined shape.
        """
        refined = {t: shape.values for t, shape in self.refined.items()}
        terms = replace(self.terms, shapes={**self.terms.shapes, **refined})
        moved = CorrectedArm(self.arm, terms.effects(theta))
        squares = []
        for part, segment in zip(self._rows, self.data.segments, strict=True):
            assert segment.torque is not None
            predicted = moved.predict(segment.bodies(self.body), segment.motion)
            gap = segment.bridged(segment.torque - predicted)
            gap = self.data.thin(gap, segment)
            tangent = part.gap - part.columns @ (theta - self.theta)
            squares.append(part.trust**2 * (gap - tangent) ** 2)
        healthy = self.discrepancy.mean_square[: self.arm.n_joints]
        return np.sqrt(np.vstack(squares).mean(axis=0) / healthy)

    def squared_gap(self, corrected: CorrectedArm) -> np.ndarray:
        """Squared gap of an arm of the same bodies over all rows, and by how far they are trusted [N^2 m^2], (2, n)."""
        total = np.zeros((2, self.arm.n_joints))
        for part, segment in zip(self._rows, self.data.segments, strict=True):
            assert segment.torque is not None
            predicted = corrected.predict(segment.bodies(self.body), segment.motion)
            recorded = corrected.delivered(segment.torque)
            gap = segment.bridged(recorded - predicted)
            square = part.known * self.data.thin(gap, segment) ** 2
            total += [square.sum(axis=0), (part.trust**2 * square).sum(axis=0)]
        return total

    def rows(
        self, k: int, places: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Equations of segment k: [A, N], (M, n, C + K), y and trust, each (M, n); A are the columns in ``places``."""
        part = self._rows[k]
        x = [part.columns[:, :, places], self.data.nuisance[k]]
        y = part.gap + part.columns @ self.theta
        return np.concatenate(x, axis=2), y, part.trust

    def columns_on(self, data: FitData, k: int, terms: frozenset[Term]) -> np.ndarray:
        """[A, N] on segment k of other data of the same arm, (M, n, C + K), with the columns of some terms in A."""
        segment, places = data.segments[k], sorted(c for t in terms for c in t.columns)
        bodies = segment.bodies(self.body)
        at = Prediction.of(self._corrected, bodies, segment.motion)
        only = {t.effect for t in terms}
        x = columns(at, data, k, self.terms, self.theta, only)
        self._add_changed_links(x, data.nuisance[k], self._torque_gain)
        return np.concatenate([x[:, :, places], data.nuisance[k]], axis=2)

    def _fold_places(self) -> list[list[int]]:
        """Places of each fold's segments among all."""
        places, start = [], 0
        for fold in self.data.folds:
            places.append(list(range(start, start + len(fold))))
            start += len(fold)
        return places

    def _segment_rows(self, k: int) -> SegmentRows:
        """Rows of segment k."""
        data, segment = self.data, self.data.segments[k]
        assert segment.torque is not None
        bodies = segment.bodies(self.body)
        at = Prediction.of(self._corrected, bodies, segment.motion)
        x = columns(at, data, k, self.terms, self.theta)
        gap = segment.bridged(self._corrected.delivered(segment.torque) - at.torque)
        rate = np.gradient(at.torque, segment.motion.t, axis=0)
        floor = noise_floor(self._corrected, self.body, segment, at)
        sticking = floor.sticking[:: data.step(segment)]
        self._add_changed_links(x, data.nuisance[k], self._torque_gain)
        return SegmentRows(
            data.thin(gap, segment),
            x,
            data.thin(rate, segment),
            NoiseFloor(floor.steady, sticking),
            at,
            data.known(segment),
        )

    @property
    def _torque_gain(self) -> np.ndarray:
        """What a recorded torque is of the one that reaches its joint, by the scale of the torque, (n,)."""
        return np.asarray(1.0 / (1.0 + self._corrected.quantity("scale")))

    def _link_rows(self, k: int) -> LinkRows:
        """What the joint torque sensors measured on a segment; all zero if it has none."""
        segment, bodies = self.data.segments[k], self.data.bodies[k]
        zero = SENSOR_ZERO * self.data.torque_deviation
        at = self._rows[k].at
        rows = link_rows(
            self._corrected, at, segment, bodies, self.terms, self.theta, zero
        )
        gap, x, errors = (
            self.data.thin(series, segment)
            for series in (rows.gap, rows.columns, rows.sensor)
        )
        gain = np.full(self.arm.n_joints, float(rows.known))
        self._add_changed_links(x, self.data.nuisance[k], gain)
        return replace(rows, gap=gap, columns=x, sensor=errors)

    def _add_changed_links(
        self, x: np.ndarray, nuisance: np.ndarray, gain: np.ndarray
    ) -> None:
        """Columns of changed links from those of the inertial regressor; ``gain`` on the bodies' torque, (n,)."""
        own = self.body.inertial_parameters().reshape(-1, 10)
        regressor = nuisance.reshape(*nuisance.shape[:2], -1, 10)
        units = self.data.units.reshape(-1, 10)
        for term in self.terms.all:
            effect, link, places = term.definition, term.joint - 1, list(term.columns)
            if not isinstance(effect, LinkChange) or effect.scope != "link":
                continue
            tangent = effect.tangent(own[link], link, self.theta[places])
            # the regressor is per unit of an inertial error; links without mass have none
            per_unit = np.divide(
                tangent.T,
                units[link],
                out=np.zeros_like(tangent.T),
                where=units[link] > 0,
            )
            x[:, :, places] = gain[:, None] * (regressor[:, :, link] @ per_unit.T)

    def _add_proposed(self, proposed: list[Term]) -> None:
        """Columns of the terms whose nonlinear parameters were proposed, into those of the rows."""
        if not proposed:
            return
        names = {t.effect for t in proposed}
        places = [c for t in proposed for c in t.columns]
        for k, rows in enumerate(self._rows):
            x = columns(rows.at, self.data, k, self.terms, self.theta, names)
            rows.columns[:, :, places] = x[:, :, places]

    def _cut(
        self, places: list[int]
    ) -> tuple[list[Fold], tuple[EquationRows, EquationRows]]:
        """The rows of some segments, cut in the middle, as normal equations, and the rows that are scored."""
        torque, count = self._equations(places), self._pieces(places)
        halves = torque.halves()
        folds = [Fold(half, count) for half in halves]
        if not self._links:
            return folds, halves
        both = two_sides(torque, [self._links[k] for k in places], self.theta).halves()
        sides = [Fold(half, count) for half in both]
        sensed = [
            replace(fold, sides=side) for fold, side in zip(folds, sides, strict=True)
        ]
        return sensed, both

    def _discrepancy(self, halves: list[EquationRows]) -> Discrepancy:
        """What a healthy arm leaves of the scored rows, from the rows of each half."""
        deviation = self.data.torque_deviation
        if self._links:
            deviation = np.tile(deviation, 2)
        scored = [fold.scored for fold in self.folds]
        return discrepancy(scored, halves, deviation, self.theta)

    def _pieces(self, places: list[int]) -> int:
        """Number of pieces of half a fold: two at least."""
        motions = [self.data.segments[k].motion for k in places]
        seconds = sum(float(motion.t[-1] - motion.t[0]) for motion in motions) / 2
        most = MOST_PIECES // (2 * len(self.data.folds))
        return int(np.clip(seconds / PIECE_LENGTH, 2, max(2, most)))

    def _equations(self, places: list[int]) -> EquationRows:
        """Equations of the recorded torque on some segments."""
        parts = [self._rows[k] for k in places]
        gap = np.vstack([part.gap for part in parts])
        terms = np.vstack([part.columns for part in parts])
        steady2 = [np.broadcast_to(p.floor.steady**2, p.gap.shape) for p in parts]
        return EquationRows(
            terms=terms,
            inertials=np.vstack([self.data.nuisance[k] for k in places]),
            others=np.zeros((*gap.shape, self.data.sensor_errors)),
            y=gap + terms @ self.theta,
            rate=np.vstack([part.rate for part in parts]),
            sticking=np.vstack([part.floor.sticking for part in parts]),
            steady2=np.vstack(steady2),
            known=np.vstack([part.known for part in parts]),
        )
