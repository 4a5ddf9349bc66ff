"""The torque linearised about a model."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.motions.motion import Motion
from gapscope.diagnosis.gap.noise_floor import (
    NoiseFloor,
    dry_friction,
    noise_floor,
    simplified_effect_rms,
    steady_floor,
)
from gapscope.diagnosis.model.fit_data import (
    Discrepancy,
    EquationRows,
    FitData,
    Fold,
    SegmentRows,
    discrepancy,
)
from gapscope.diagnosis.thresholds import (
    EFFECT_FORM,
    FRICTION_FORM,
    MAX_PIECES,
    PIECE_LENGTH,
    SENSOR_LAG,
    SENSOR_SCALE,
    SENSOR_ZERO,
)
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.catalogue import explained
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.effect import (
    LinkChange,
    Signals,
    TorqueLaw,
)
from gapscope.model.body_point import Bodies, rigid_body_jacobian
from gapscope.model.conditioning import Segment
from gapscope.model.jacobian import columns, moved_arms, steps, torque_size
from gapscope.model.prediction import Prediction, without
from gapscope.model.terms import Term, Terms

# What joint torque sensors add to the evidence: the gap of a joint in two parts, one on either side of the sensor.
#
# A sensor behind the gear reads what reaches the link,
#
#     tau_sensor = (1 + e) tau_link(t - T) + z + noise,    tau_link = M(q) ddq + ... + k (q - q0) - J^T f,
#
# with its own zero z, scale e and lag T, all unknown. The residual, tau - tau_sensor, is the actuator's: rotor,
# friction, and all between the recorded torque and the gear. In place of the rows of the recorded torque come those of
#
#     actuator side    tau - tau_sensor    columns A - A_link,    z, e and T with the opposite sign
#     link side        tau_sensor          columns A_link, the nominal inertials' errors, z, e and T
#
# so that an effect has to explain the side that it acts on, and must not show on the other one.


@dataclass(frozen=True)
class LinkRows:
    """Rows of the joint torque sensors on one segment, M of n joints; zeros if the segment has no sensor.

    Attributes:
        gap: sensor less predicted link torque [N m], (M, n).
        columns: derivatives of the link torque by the terms' coordinates, (M, n, P).
        sensor: derivatives of the reading by zero, scale and lag of each sensor, over their spread, (M, n, 3 n).
        known: whether the segment has sensors.
        floors: RMS of a healthy arm, actuator side of each joint, then link side [N m], (2 n,).
    """

    gap: np.ndarray
    columns: np.ndarray
    sensor: np.ndarray
    known: bool
    floors: np.ndarray


def link_torque(corrected: CorrectedArm, body: RigidBody, motion: Motion) -> np.ndarray:
    """Torque behind the gear that an arm predicts [N m], (N, n): bodies, forces from outside, springs."""
    torque = corrected.rigid_torque(body, motion)
    true = corrected.true_position(motion.q)
    for law, values in corrected.of_kind(TorqueLaw):
        if law.side == "link":
            torque = torque + law.law(
                Signals(motion.t[:, None], true, motion.dq, torque), *values
            )
    return torque


def sensor_errors(link: np.ndarray, t: np.ndarray, spread: np.ndarray) -> np.ndarray:
    """Derivatives of the readings by each sensor's zero, scale and lag, over their spread, shape (N, n, 3 n).

    Args:
        link: predicted link torque [N m], (N, n).
        t: time [s], (N,).
        spread: of the zeros [N m], (n,).
    """
    n = link.shape[1]
    out = np.zeros((*link.shape, 3, n))
    for j in range(n):
        out[:, j, 0, j] = spread[j]
        out[:, j, 1, j] = SENSOR_SCALE * link[:, j]
        out[:, j, 2, j] = -SENSOR_LAG * np.gradient(link[:, j], t)
    return out.reshape(len(link), n, 3 * n)


def link_rows(
    corrected: CorrectedArm,
    at: Prediction,
    segment: Segment,
    bodies: Bodies,
    terms: Terms,
    theta: np.ndarray,
    zero: np.ndarray,
) -> LinkRows:
    """Rows of a segment's joint torque sensors at every sample; the columns of changed links are left zero.

    Args:
        corrected: the arm with the effects of theta.
        at: what it predicts on the segment.
        segment: the segment.
        bodies: what its columns need.
        terms: all terms, with the shapes of those that have one.
        theta: linear coordinates around which to differentiate, shape (P,).
        zero: spread of the sensors' zeros [N m], (n,).
    """
    motion, n = segment.motion, corrected.arm.n_joints
    columns = np.zeros((len(motion.t), n, terms.size))
    if segment.torque_sensor is None:
        nothing = np.zeros_like(motion.q)
        return LinkRows(
            nothing, columns, np.zeros((*nothing.shape, 3 * n)), False, np.ones(2 * n)
        )
    arm, laden = at.arm, at.body
    link = link_torque(arm, laden, motion)
    derivatives = rigid_body_jacobian(at, segment, bodies, terms, theta)
    columns[:, :, list(derivatives)] = np.stack(list(derivatives.values()), axis=2)
    joints, size = np.arange(n), torque_size(at)
    for law in explained():
        if not isinstance(law, TorqueLaw) or law.side != "link":
            continue
        step = steps(law, size)
        for i, places in enumerate(terms.block(law.name)):
            arms = moved_arms(arm, terms, theta, law.name, i, step)
            if arms is not None:
                moved, begun = arms
                before = link if begun is None else link_torque(begun, laden, motion)
                change = link_torque(moved, laden, motion) - before
                columns[:, joints, places] = change / step
    floors = [
        floor(corrected, laden, segment) for floor in (actuator_floor, link_floor)
    ]
    return LinkRows(
        segment.torque_sensor - link,
        columns,
        sensor_errors(link, motion.t, zero),
        True,
        np.concatenate(floors),
    )


def link_floor(
    corrected: CorrectedArm, body: RigidBody, segment: Segment
) -> np.ndarray:
    """RMS that a healthy arm and its sensors leave on the link side [N m], (n,)."""
    assert segment.torque_sensor is not None
    body = segment.bodies(body)

    def link(arm: CorrectedArm) -> np.ndarray:
        return link_torque(arm, body, segment.motion)

    form = simplified_effect_rms(corrected, segment, _share(link, corrected))
    gap = segment.torque_sensor - link(corrected)
    return steady_floor(gap, segment.torque_sensor, segment, EFFECT_FORM * form)


def actuator_floor(
    corrected: CorrectedArm, body: RigidBody, segment: Segment
) -> np.ndarray:
    """RMS that a healthy arm leaves on the actuator side where its friction is known [N m], (n,)."""
    assert segment.torque is not None and segment.torque_sensor is not None
    motion, body = segment.motion, segment.bodies(body)

    def actuator(arm: CorrectedArm) -> np.ndarray:
        return arm.unlimited.predict(body, motion) - link_torque(arm, body, motion)

    share = _share(actuator, corrected)
    dry_rms = np.sqrt((dry_friction(corrected, segment) ** 2).mean(axis=0))
    form = np.hypot(
        EFFECT_FORM * simplified_effect_rms(corrected, segment, share),
        FRICTION_FORM * dry_rms,
    )
    gap = (
        corrected.delivered(segment.torque)
        - segment.torque_sensor
        - actuator(corrected)
    )
    return steady_floor(gap, segment.torque, segment, form)


def _share(
    predicted: Callable[[CorrectedArm], np.ndarray], corrected: CorrectedArm
) -> Callable[[AppliedEffect], np.ndarray]:
    """What one of an arm's effects does to the torque that ``predicted`` gives for an arm [N m], (N, n)."""
    whole = predicted(corrected)
    return lambda applied: whole - predicted(without(corrected, applied))


def two_sides(
    torque: EquationRows, links: list[LinkRows], theta: np.ndarray
) -> EquationRows:
    """Equations of both sides of each joint, the actuator sides, then the link sides.

    Without a sensor the actuator side is the whole joint, and the link side says nothing.

    Args:
        torque: equations of the recorded torque, m = n.
        links: what the sensors measured on these rows.
        theta: linear coordinates around which A was taken, shape (P,).

    Returns:
        Equations with m = 2 n.
    """
    gap = np.vstack([rows.gap for rows in links])
    terms = np.vstack([rows.columns for rows in links])
    errors = np.vstack([rows.sensor for rows in links])
    measured = [np.full((len(rows.gap), 1), float(rows.known)) for rows in links]
    known = np.vstack(measured)
    inertials = known[:, :, None] * torque.inertials
    y = gap + terms @ theta
    without = np.hstack([torque.steady2, np.ones_like(torque.steady2)])
    steady2 = np.where(known > 0, _floors2(links), without)
    return EquationRows(
        terms=np.concatenate([torque.terms - terms, terms], axis=1),
        inertials=np.concatenate([torque.inertials - inertials, inertials], axis=1),
        others=np.concatenate([torque.others - errors, errors], axis=1),
        y=np.hstack([torque.y - y, y]),
        # the skew lies between motion and recorded torque: on the actuator side alone
        rate=np.hstack([torque.rate, np.zeros_like(gap)]),
        sticking=np.hstack([torque.sticking, np.zeros_like(gap)]),
        steady2=steady2,
        known=np.hstack([np.ones(gap.shape), np.broadcast_to(known, gap.shape)]),
    )


def _floors2(links: list[LinkRows]) -> np.ndarray:
    """Mean square of a healthy arm with sensors on each row, (M, 2 n)."""
    rows = [np.tile(rows.floors**2, (len(rows.gap), 1)) for rows in links]
    return np.vstack(rows)


# The corrected arm's torque, linearised in the parameters of all terms, as normal equations.
#
# Around theta_0 the gap of joint j is
#
#     y_j = r_j(theta_0) + A_j theta_0 = A_j theta + N_j delta + d_j T + noise
#
# with r the gap at theta_0, A the derivatives of the predicted torque, N the nominal arm's inertial regressor, delta
# the errors of the nominal inertials, d the rate of the predicted torque and T a skew of sampling common to all
# joints. Everything later needs only A^T A and its like per piece of the data, so a log's length does not matter.


class Linearisation:
    """Normal equations per fold and joint around the parameters theta_0.

    Args:
        data: the folds.
        theta: theta_0, shape (P,).
        terms: all terms, with the nonlinear parameters of those that have columns.

    Attributes:
        folds: two for each fold of the data, its first and its second half.
        discrepancy: what a healthy arm leaves of the scored rows, learnt from these.
    """

    def __init__(self, data: FitData, theta: np.ndarray, terms: Terms) -> None:
        self.data, self.arm, self.body, self.theta = data, data.arm, data.body, theta
        self.terms = terms
        self._corrected = CorrectedArm(self.arm, terms.effects(theta))
        self._rows = [self._segment_rows(k) for k in range(len(data.segments))]
        self._links: list[LinkRows] = []
        if data.sensed:
            self._links = [self._link_rows(k) for k in range(len(data.segments))]
        cut = [self._cut(places) for places in self._fold_places()]
        self.folds = [fold for folds, _ in cut for fold in folds]
        self.discrepancy = self._discrepancy(
            [half for _, halves in cut for half in halves]
        )

    def departure(self, theta: np.ndarray) -> np.ndarray:
        """How far the torque at other values departs from the linearisation, RMS over what a healthy arm leaves, (n,).

        Args:
            theta: the values, (P,), of terms whose torque is smooth in them.
        """
        moved = CorrectedArm(self.arm, self.terms.effects(theta))
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
        most = MAX_PIECES // (2 * len(self.data.folds))
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
