"""The torque that a known controller commanded, and the integrator it began with."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.interpolate import CubicHermiteSpline, make_interp_spline

from gapscope.arm.case import Case
from gapscope.arm.control import ControlLoop, Targets
from gapscope.arm.controller import Controller
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording
from gapscope.arm.velocity_filter import VelocityFilter
from gapscope.diagnosis.setup_faults.evidence import ordinary_errors
from gapscope.diagnosis.thresholds import (
    FAULT_SIGN_WIDTH,
    INTEGRATOR_SAMPLES,
    MIN_INTEGRATOR_MISFIT,
    MOTION_INDEPENDENT_RATE,
)
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected import CorrectedArm
from gapscope.model.conditioning import (
    TORQUE_CUTOFF,
    Segment,
    condition,
    low_pass,
    pieces,
    torque_scale,
)
from gapscope.model.effective_samples import motion_samples

# What the integrator of a controller held when a recording began, which no recording shows.
#
# Computed from zero, the torque of a stretch lacks a constant z for each joint. It is what makes an arm explain the
# torque best that has, beside the nominal one and another friction, nothing or one thing of its own: with p the nominal
# torque,
#
#     tau_j + z_j = p_j + c_j sgn dq_j + b_j dq_j + X_j theta,
#
# X the columns of a load on the last link, of a tilted base, of a scale of each joint's torque, or of errors of all
# links. Friction and theta are common to all stretches of a case. Which X there is, if any, is chosen by the Bayesian
# information criterion over independent samples: free columns that nothing asks for would shift the constants, which
# gravity resembles. What an arm has beyond all that stays in the constants. Source: schwarz1978.


FITS = 3
"""Fits of one choice of columns, each with the weights that the one before it left."""


def integrator_starts(
    arm: NominalArm, stretches: Sequence[Recording]
) -> list[np.ndarray]:
    """Torque of the integrator at the start of each stretch [N m], (n,) each.

    Args:
        arm: the nominal arm.
        stretches: of all recordings, without gaps, their torque computed with an integrator that starts from zero.
    """
    body = RigidBody(arm)
    rows = [_Rows(arm, body, condition(s)[0]) for s in stretches]
    seconds = sum(stretch.duration for stretch in stretches)
    independent = motion_samples(seconds, MOTION_INDEPENDENT_RATE)
    choices = [_fitted(rows, name, independent) for name in rows[0].columns]
    _, starts = min(choices, key=lambda choice: choice[0])
    return list(starts)


def _fitted(
    rows: Sequence[_Rows], name: str, independent: float
) -> tuple[float, np.ndarray]:
    """Information criterion of one choice of columns [1], and the constants of each stretch [N m], (R, n).

    Constants are eliminated: every column and the torque lose their mean over each stretch.
    """
    missing = [part.missing for part in rows]
    columns = [np.concatenate([p.friction, p.columns[name]], axis=2) for p in rows]
    y = np.concatenate([m - m.mean(axis=0) for m in missing])
    x = np.concatenate([c - c.mean(axis=0) for c in columns])
    least = MIN_INTEGRATOR_MISFIT * torque_scale(np.concatenate(missing))
    misfit = torque_scale(np.concatenate(missing))
    size = x.shape[2]
    for _ in range(FITS):
        # columns have the size of what may ordinarily be: a unit prior
        weighted = x / misfit[:, None]
        normal = np.einsum("mjp,mjq->pq", weighted, weighted) + np.eye(size)
        theta = np.linalg.solve(normal, np.einsum("mjp,mj->p", weighted, y / misfit))
        left = y - x @ theta
        misfit = np.maximum(np.sqrt((left**2).mean(axis=0)), least)
    criterion = 2 * independent * np.log(misfit).sum() + size * np.log(independent)
    starts = [
        (c @ theta - m).mean(axis=0) for c, m in zip(columns, missing, strict=True)
    ]
    return float(criterion), np.array(starts)


class _Rows:
    """Few samples of a stretch, M of them, behind the filter of the torque gap.

    Attributes:
        missing: computed minus nominal torque [N m], (M, n).
        friction: columns of another friction, (M, n, 2 n), which every choice has.
        columns: those of each choice by name, (M, n, P).
    """

    def __init__(self, arm: NominalArm, body: RigidBody, segment: Segment) -> None:
        motion, inner = segment.motion, segment.inner
        assert segment.torque is not None
        nominal = CorrectedArm(arm).predict(segment.bodies(body), motion)
        step = max(1, len(motion.t[inner]) // INTEGRATOR_SAMPLES)

        def thinned(series: np.ndarray) -> np.ndarray:
            flat = series.reshape(len(series), -1)
            smooth = low_pass(flat, motion.rate, TORQUE_CUTOFF)[inner][::step]
            return smooth.reshape(-1, *series.shape[1:])

        q, dq, ddq = motion.q, motion.dq, motion.ddq
        scale = torque_scale(nominal)
        sign = np.tanh(dq / FAULT_SIGN_WIDTH)
        speed = np.maximum(np.abs(dq).max(axis=0), 1e-3)
        regressor = body.regressor(q, dq, ddq) * ordinary_errors(body)
        last = slice(10 * body.last_link, 10 * body.last_link + 10)
        self.missing = thinned(segment.torque - nominal)
        friction = [_diagonal(sign * scale), _diagonal(dq / speed * scale)]
        self.friction = thinned(np.concatenate(friction, axis=2))
        size = float(np.linalg.norm(body.gravity))
        choices = {
            "load": regressor[:, :, last],
            "tilt": body.gravity_regressor(q) * size,
            "scales": _diagonal(nominal),
            "links": regressor,
        }
        nothing = {"nothing": np.zeros((*self.missing.shape, 0))}
        self.columns = nothing | {name: thinned(x) for name, x in choices.items()}


def _diagonal(series: np.ndarray) -> np.ndarray:
    """A column per joint that acts on that joint alone, (M, n, n), from (M, n)."""
    return np.einsum("mj,jk->mjk", series, np.eye(series.shape[1]))


# The torque of recordings that have none: what their known controller must have commanded.
#
# With references and encoders recorded and the controller known, its law gives the torque back, so that a motion which
# differs from the simulated one, the replay gap, becomes a torque gap that effects can explain. What an integrator held
# when a recording began is not recorded: it is estimated (``integrator_start``).


WARNING = (
    "no torque was recorded: it was worked out as what the known controller must have commanded. Encoder noise passes "
    "into it through the gains, and so do wrong gains; the replay gap is measured, the torque gap inferred"
)

UNSURE = (
    "no velocity was recorded either: how the controller discretises its velocity filter cannot be told from armature "
    "of kd / (2 rate), and of the two the former is assumed"
)

STARTED = (
    "what the controller's integrator held at the start of each recording is not recorded: it was estimated, so that "
    "constant torques of a joint cannot be found"
)


def with_commanded_torque(case: Case) -> Case:
    """The case with the torque that its controller commanded, and a warning; as it is if that is not called for.

    That is the case if no recording has a torque, the controller is known, and a recording has its reference.
    """
    every = (*case.recordings, *case.judged)
    referred = any(recording.q_ref is not None for recording in case.recordings)
    if (
        case.controller is None
        or not referred
        or any(recording.tau is not None for recording in every)
    ):
        return case
    warnings = [*case.warnings, WARNING]
    if _unsure(case):
        warnings.append(UNSURE)
    if case.controller.integrates:
        warnings.append(STARTED)
    return replace(_filled(case, "bilinear"), warnings=tuple(warnings))


def with_likelier_rule(case: Case, effects: tuple[AppliedEffect, ...]) -> Case | None:
    """The case with its torque computed by another rule of the velocity filter; ``None`` if none is likelier.

    The rules differ by half a tick each, which looks like kd / (2 rate) of armature on every joint. If that is what
    was found, another rule is the simpler explanation.

    Args:
        case: a case whose torque was computed.
        effects: found in it.
    """
    found = [e for e in effects if "rotor" in e.effect.quantities.values()]
    if (
        WARNING not in case.warnings
        or not _unsure(case)
        or not found
        or case.controller is None
        or case.controller.velocity_gain is None
    ):
        return None
    joints = np.array(found[0].joints) - 1
    half_ticks = (
        next(iter(found[0].parameters.values()))
        * 2
        * case.controller.rate
        / case.controller.velocity_gain[joints]
    )
    shift = float(np.median(half_ticks))
    if not 0.5 < abs(shift) < 1.5:
        return None
    return _filled(case, "semi_implicit" if shift > 0 else "backward")


def _unsure(case: Case) -> bool:
    """Whether the velocity that the controller had is not recorded, and its filter leaves open what it was."""
    known = all(
        recording.dq is not None for recording in (*case.recordings, *case.judged)
    )
    return (
        not known
        and case.controller is not None
        and case.controller.velocity_cutoff is not None
    )


def _filled(case: Case, rule: str) -> Case:
    """The case with the torque of the recordings that have a reference."""
    controller = case.controller
    assert controller is not None
    every = (*case.recordings, *case.judged)
    referred = [recording for recording in every if recording.q_ref is not None]
    torques = commanded_torques(case.arm, controller, referred, rule)
    of_each = {id(r): torque for r, torque in zip(referred, torques, strict=True)}

    def filled(recording: Recording) -> Recording:
        return replace(recording, tau=of_each.get(id(recording)))

    recordings, judged = (
        tuple(map(filled, part)) for part in (case.recordings, case.judged)
    )
    return replace(case, recordings=recordings, judged=judged)


def commanded_torques(
    arm: NominalArm,
    controller: Controller,
    recordings: Sequence[Recording],
    rule: str = "bilinear",
) -> list[np.ndarray]:
    """Torque that a controller commanded at the rows of recordings with ``q_ref`` [N m], shape (N, n) each.

    A stretch between gaps that is too short to be used has none, and holds zeros.

    Args:
        arm: the nominal arm, which the feedforward believes.
        controller: in the arm's joint order.
        recordings: with ``q_ref``; their ``dq``, if recorded, is the velocity that the controller has.
        rule: of its velocity filter, one of ``gapscope.arm.velocity_filter.RULES``.
    """
    spans = [(k, span) for k, r in enumerate(recordings) for span in pieces(r)]
    stretches = [recordings[k].part(span) for k, span in spans]
    if controller.integrates:
        torques = _integrated(arm, controller, stretches, rule)
    else:
        torques = [_stateless(arm, controller, s, rule) for s in stretches]
    out = [np.zeros_like(recording.q) for recording in recordings]
    for (k, span), torque in zip(spans, torques, strict=True):
        out[k][span] = torque
    return out


def _integrated(
    arm: NominalArm, controller: Controller, stretches: list[Recording], rule: str
) -> list[np.ndarray]:
    """Torque that a law with an integrator commanded in stretches without gaps [N m], (N, n) each."""
    if not stretches:
        return []
    from_zero = [
        replace(
            stretch,
            tau=_started(arm, controller, stretch, rule, np.zeros(arm.n_joints)),
        )
        for stretch in stretches
    ]
    starts = integrator_starts(arm, from_zero)
    return [
        _started(arm, controller, stretch, rule, start)
        for stretch, start in zip(stretches, starts, strict=True)
    ]


def _stateless(
    arm: NominalArm, controller: Controller, stretch: Recording, rule: str
) -> np.ndarray:
    """Torque that a law without memory commanded at the rows of a stretch without gaps [N m], (N, n)."""
    t, rows, back = np.unique(stretch.t, return_index=True, return_inverse=True)
    stretch = stretch.part(rows)
    q_ref, dq_ref = _reference(stretch)
    ddq_ref = make_interp_spline(t, dq_ref, k=3)(t, 1)
    targets = Targets.of(arm, controller, q_ref, dq_ref, ddq_ref)
    dq = stretch.dq
    if dq is None:
        ticks = _ticks(controller, t)
        q = make_interp_spline(t, stretch.q, k=3)(ticks)
        velocity = _velocity(controller, q, dq_ref[0], rule)
        dq = velocity[_tick_of(controller, t)]
    return ControlLoop(controller, arm)(targets, stretch.q, dq)[back]


def _started(
    arm: NominalArm,
    controller: Controller,
    stretch: Recording,
    rule: str,
    start: np.ndarray,
) -> np.ndarray:
    """Torque that a law with an integrator, which began with a torque (n,), commanded in a stretch [N m], (N, n)."""
    t, rows, back = np.unique(stretch.t, return_index=True, return_inverse=True)
    stretch = stretch.part(rows)
    ticks = _ticks(controller, t)
    q = make_interp_spline(t, stretch.q, k=3)(ticks)
    q_ref, dq_ref = _reference(stretch)
    velocity = make_interp_spline(t, dq_ref, k=3)
    reference = CubicHermiteSpline(t, q_ref, dq_ref)(ticks)
    targets = Targets.of(
        arm, controller, reference, velocity(ticks), velocity(ticks, 1)
    )
    dq = (
        _velocity(controller, q, dq_ref[0], rule)
        if stretch.dq is None
        else make_interp_spline(t, stretch.dq, k=3)(ticks)
    )
    control = ControlLoop(controller, arm)
    control.integral = start
    torque = np.empty_like(q)
    for i in range(len(ticks)):
        torque[i] = control(targets.at(i), q[i], dq[i])
    return torque[_tick_of(controller, t)][back]


def _reference(stretch: Recording) -> tuple[np.ndarray, np.ndarray]:
    """Reference position [rad] and velocity [rad/s] at the rows of a stretch, (N, n) each."""
    assert stretch.q_ref is not None
    if stretch.dq_ref is not None:
        return stretch.q_ref, stretch.dq_ref
    return stretch.q_ref, make_interp_spline(stretch.t, stretch.q_ref, k=3)(
        stretch.t, 1
    )


def _ticks(controller: Controller, t: np.ndarray) -> np.ndarray:
    """Times of the controller's ticks from the first to the last of the rows' times [s], (K,)."""
    count = int((t[-1] - t[0]) * controller.rate + 1e-6) + 1
    return t[0] + np.arange(count) / controller.rate


def _tick_of(controller: Controller, t: np.ndarray) -> np.ndarray:
    """Number of the tick whose torque is held at each row's time, (N,)."""
    return ((t - t[0]) * controller.rate + 1e-6).astype(int)


def _velocity(
    controller: Controller, q: np.ndarray, start: np.ndarray, rule: str
) -> np.ndarray:
    """Velocity that the controller makes of positions at its ticks [rad/s], (K, n); ``start``: before them."""
    filtered = VelocityFilter(
        controller.rate,
        controller.velocity_cutoff,
        controller.velocity_damping,
        q[0],
        start,
        rule,
    )
    return np.array([filtered(row) for row in q])
