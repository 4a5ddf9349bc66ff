"""The torque linearised about a model, and scans of what else the gap looks like."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

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
    force_window,
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
    Drift,
    Effect,
    External,
    LinkChange,
    Signals,
    TorqueLaw,
)
from gapscope.ident.model.base_parameters import orthonormal_columns
from gapscope.model.body_point import Bodies, rigid_body_jacobian
from gapscope.model.candidate_columns import JointSignals, shows_at_rest, unit_columns
from gapscope.model.conditioning import Segment
from gapscope.model.effective_samples import independent_samples
from gapscope.model.jacobian import columns, moved_arms, steps, torque_size
from gapscope.model.prediction import Prediction, without
from gapscope.model.scan import NonlinearParameters, Scan
from gapscope.model.terms import Term, Terms

# The residual of all joints, for effects that no column of the linearisation represents.


@dataclass(frozen=True)
class ScanResidual:
    """What the nominal inertials and the plainest effects leave of the gap, M rows.

    Attributes:
        residual: per joint [N m], weighted by trust, (M, n).
        bases: per joint what was taken out of it, orthonormal columns, (M, K).
        trust: square root of the weight of each row, (M, n).
        information: nats per square of the gap [1/(N m)^2], (n,).
    """

    residual: np.ndarray
    bases: list[np.ndarray]
    trust: np.ndarray
    information: np.ndarray

    def gain(self, torque: np.ndarray, free: np.ndarray | None = None) -> float:
        """What a predicted torque, (M, n), explains of the residual, without any factor [nats].

        Args:
            torque: per joint [N m]; joints with none do not count.
            free: one more column per joint that takes its own best value.
        """
        gain = 0.0
        for j in np.flatnonzero(torque.any(axis=0)):
            change, residual = self._outside_basis(torque, j), self.residual[:, j]
            if free is not None:
                column = self._outside_basis(free, j)
                column = column / max(float(np.linalg.norm(column)), 1e-12)
                change = change - column * (column @ change)
                residual = residual - column * (column @ residual)
            # |r|^2 / 2 - |r - c|^2 / 2
            fallen = float(residual @ change - 0.5 * change @ change)
            gain += self.information[j] * fallen
        return gain

    def _outside_basis(self, torque: np.ndarray, j: int) -> np.ndarray:
        """Weighted torque of joint j less its projection on what was taken out, (M,)."""
        weighted, basis = torque[:, j] * self.trust[:, j], self.bases[j]
        return weighted - basis @ (basis.T @ weighted)


# The search for parameters in which the torque is not linear, scanned over what they can be.
#
# For each candidate the columns of its linear coordinates are projected on the residual of a joint's gap when
# everything that acts on that joint is taken out; the gain of a candidate is the sum of squares that its columns
# explain.


class ScannedArm:
    """The arm whose gap is scanned.

    Args:
        corrected: the arm.
        predictions: what it predicts on each segment.
    """

    def __init__(
        self, corrected: CorrectedArm, predictions: Sequence[Prediction]
    ) -> None:
        self.corrected, self._predictions = corrected, predictions

    def torque(self, j: int) -> list[np.ndarray]:
        """Torque that the arm predicts on a joint [N m], (N,) for each segment."""
        return [at.torque[:, j] for at in self._predictions]

    @cached_property
    def steady_friction(self) -> list[np.ndarray]:
        """Friction of the joints as if it did not drift [N m], (N, n) for each segment."""
        effects = self.corrected.effects
        steady = tuple(e for e in effects if not isinstance(e.effect, Drift))
        arm = replace(self.corrected, effects=steady)
        smooth, out = _without_friction(arm), []
        for at in self._predictions:
            none = np.zeros_like(at.rigid)
            both = (one.needed_torque(none, at.motion) for one in (arm, smooth))
            out.append(np.subtract(*both))
        return out

    def signals(self, j: int, data: FitData) -> list[JointSignals]:
        """What the laws on a joint, from 0, depend on, on each segment."""
        out = []
        for k, segment in enumerate(data.segments):
            assert segment.torque is not None
            position = self.corrected.true_position(segment.motion.q)
            columns = (
                position,
                segment.motion.dq,
                segment.torque,
                self._predictions[k].torque,
                self.steady_friction[k],
            )
            time = segment.motion.t[:, None]
            out.append(JointSignals(time, *(x[:, j, None] for x in columns)))
        return out


def search_nonlinear(
    term: Term, arm: ScannedArm, data: FitData, scan: Scan, known: float | None
) -> NonlinearParameters:
    """The best nonlinear parameters of a joint effect's term; near ``known`` if it has been found before.

    Raises:
        KeyError: the effect has no nonlinear parameter on a joint.
    """
    effect, fitted, j = term.definition, term.parametrisation, term.joint - 1
    series = data.candidates.series(j)
    first = data.candidates.of(term) if known is None else None
    assert fitted.grid is not None
    values = fitted.grid(series, known) if first is None else first.values
    if fitted.possible is not None and len(values):
        needed = np.concatenate(arm.torque(j))
        kept = fitted.possible(values, np.concatenate(series.recorded), needed)
        values = values[kept]
        if first is not None:
            first = first._replace(values=values, columns=first.columns[:, kept])
    found = None
    if len(values):
        if first is None:
            of_segments = [
                unit_columns(effect, values, signals)
                for signals in arm.signals(j, data)
            ]
            columns, known_products = scan.weighted(data.rows(of_segments)), None
        else:
            columns, known_products = first.columns, first.products
            if not shows_at_rest(effect):
                columns = scan.weighted(columns)
        found = scan.best(values, columns, fitted.linear, known_products)
    if fitted.otherwise is None:
        assert found is not None
        return found
    other = fitted.otherwise(series, None if found is None else found.values[0])
    if other is None:
        assert found is not None
        return found
    value, std = other
    return NonlinearParameters((value,), (std,))


def _without_friction(arm: CorrectedArm) -> CorrectedArm:
    """The same arm without any friction."""
    bare = replace(
        arm.arm, coulomb=0.0 * arm.arm.coulomb, viscous=0.0 * arm.arm.viscous
    )
    return CorrectedArm(
        bare, tuple(e for e in arm.effects if e.effect.family != "friction")
    )


# The search for parameters in which the torque is not linear, over all joints of one linearisation.
#
# For each joint the plainest effects and the errors of the nominal inertials are taken out of the gap; the values of
# each nonlinear parameter are scanned on the residual.


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
