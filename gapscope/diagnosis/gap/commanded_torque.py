"""The torque that a known controller commanded, and the integrator it began with."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.interpolate import make_interp_spline

from gapscope.arm.case import Case
from gapscope.arm.control import ControlLoop, Targets
from gapscope.arm.controller import Controller
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.nominal import NominalArm, smooth_sign
from gapscope.arm.recording import Recording
from gapscope.arm.velocity_filter import VelocityFilter
from gapscope.diagnosis.thresholds import STICKING_SPEED
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
from gapscope.model.design import ROUNDS
from gapscope.model.effective_samples import motion_samples
from gapscope.model.equations import MIN_NOISE
from gapscope.model.readings import (
    FAULT_SAMPLES,
    MOTION_INDEPENDENT_RATE,
    ordinary_errors,
)

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


def integrator_starts(
    arm: NominalArm, stretches: Sequence[Recording]
) -> list[np.ndarray]:
    """Torque of the integrator at the start of each stretch [N m], (n,) each.

    Constants are eliminated: every column and the torque lose their mean over each stretch. What is left are sums of
    products, on which every choice of columns is algebra.

    Args:
        arm: the nominal arm.
        stretches: of all recordings, without gaps, their torque computed with an integrator that starts from zero.
    """
    body, n = RigidBody(arm), arm.n_joints
    parts = [_rows(arm, body, condition(s)[0]) for s in stretches]
    missing, columns = (np.concatenate(series) for series in zip(*parts, strict=True))
    means = [(m.mean(axis=0), c.mean(axis=0)) for m, c in parts]
    y = np.concatenate([m - of for (m, _), (of, _) in zip(parts, means, strict=True)])
    x = np.concatenate([c - of for (_, c), (_, of) in zip(parts, means, strict=True)])
    gram, cross = np.einsum("mjp,mjq->jpq", x, x), np.einsum("mjp,mj->jp", x, y)
    square, scale = (y**2).sum(axis=0), torque_scale(missing)
    seconds = sum(stretch.duration for stretch in stretches)
    independent = motion_samples(seconds, MOTION_INDEPENDENT_RATE)
    friction, links, tilt, scales = np.split(
        np.arange(columns.shape[2]), np.cumsum([2 * n, 10 * n, 3])
    )
    load = links[10 * body.last_link : 10 * body.last_link + 10]
    least, starts = np.inf, []
    for choice in (links[:0], load, tilt, scales, links):
        used = np.concatenate([friction, choice])
        own, size, misfit = gram[:, used][:, :, used], len(used), scale
        # each fit with the weights that the one before it left
        for _ in range(ROUNDS):
            # columns have the size of what may ordinarily be: a unit prior
            weight = misfit**-2.0
            normal = np.tensordot(weight, own, 1) + np.eye(size)
            theta = np.linalg.solve(normal, weight @ cross[:, used])
            left = square + ((own @ theta) - 2 * cross[:, used]) @ theta
            rms = np.sqrt(np.maximum(left, 0.0) / len(y))
            misfit = np.maximum(rms, MIN_NOISE * scale)
        criterion = 2 * independent * np.log(misfit).sum() + size * np.log(independent)
        if criterion < least:
            least = criterion
            starts = [of[:, used] @ theta - lost for lost, of in means]
    return starts


def _rows(
    arm: NominalArm, body: RigidBody, segment: Segment
) -> tuple[np.ndarray, np.ndarray]:
    """Computed minus nominal torque [N m], (M, n), and columns, (M, n, 14 n + 3), of few samples of a stretch.

    Columns of another friction, 2 n, of errors of all links, 10 n, of which the last is that of a load, of another
    direction of gravity, 3, and of a scale of each joint's torque, n; all behind the filter of the torque gap.
    """
    motion, inner, q, dq = (
        segment.motion,
        segment.inner,
        segment.motion.q,
        segment.motion.dq,
    )
    assert segment.torque is not None
    nominal = CorrectedArm(arm).predict(segment.bodies(body), motion)
    scale, each = torque_scale(nominal), np.eye(arm.n_joints)
    sign = smooth_sign(dq)
    speed = np.maximum(np.abs(dq).max(axis=0), STICKING_SPEED)
    # a column per joint that acts on that joint alone
    coulomb, viscous, scales = (
        series[:, :, None] * each
        for series in (sign * scale, dq / speed * scale, nominal)
    )
    links = body.regressor(q, dq, motion.ddq) * ordinary_errors(body)
    tilt = body.gravity_regressor(q) * float(np.linalg.norm(body.gravity))
    columns = np.concatenate([coulomb, viscous, links, tilt, scales], axis=2)
    step = max(1, len(motion.t[inner]) // FAULT_SAMPLES)
    missing, columns = (
        low_pass(series, motion.rate, TORQUE_CUTOFF)[inner][::step]
        for series in (segment.torque - nominal, columns)
    )
    return missing, columns


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
    return replace(filled(case), warnings=tuple(warnings))


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
    if round(abs(shift)) != 1:
        return None
    return filled(case, "semi_implicit" if shift > 0 else "backward")


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


def filled(case: Case, rule: str = "bilinear") -> Case:
    """The case with the torque that its controller commanded, by a rule, in the recordings that have a reference."""
    controller = case.controller
    assert controller is not None
    every = (*case.recordings, *case.judged)
    referred = [recording for recording in every if recording.q_ref is not None]
    torques = commanded_torques(case.arm, controller, referred, rule)
    of_each = {id(r): torque for r, torque in zip(referred, torques, strict=True)}
    return case.each(
        lambda recording: replace(recording, tau=of_each.get(id(recording)))
    )


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
    torques = [_commanded(arm, controller, s, rule) for s in stretches]
    if controller.integrates and stretches:
        from_zero = [
            replace(stretch, tau=torque)
            for stretch, torque in zip(stretches, torques, strict=True)
        ]
        torques = [
            _commanded(arm, controller, stretch, rule, start)
            for stretch, start in zip(
                stretches, integrator_starts(arm, from_zero), strict=True
            )
        ]
    out = [np.zeros_like(recording.q) for recording in recordings]
    for (k, span), torque in zip(spans, torques, strict=True):
        out[k][span] = torque
    return out


def _commanded(
    arm: NominalArm,
    controller: Controller,
    stretch: Recording,
    rule: str,
    start: np.ndarray | None = None,
) -> np.ndarray:
    """Torque that a law commanded at the rows of a stretch without gaps [N m], (N, n).

    A law with an integrator began with a torque ``start``, (n,), zero by default, and goes from tick to tick.
    """
    t, rows, back = np.unique(stretch.t, return_index=True, return_inverse=True)
    stretch = stretch.part(rows)
    # from the first to the last of the rows' times, which round
    held = ((t - t[0]) * controller.rate + 1e-6).astype(int)
    ticks = t[0] + np.arange(held[-1] + 1) / controller.rate
    times = ticks if controller.integrates else t
    targets = Targets.recorded(arm, controller, stretch, times)
    q, dq = make_interp_spline(t, stretch.q, k=3)(ticks), stretch.dq
    velocity = None
    if dq is None:
        velocity = _velocity(controller, q, targets.dq[0], rule)
        dq = velocity[held]
    control = ControlLoop(controller, arm)
    if not controller.integrates:
        return control(targets, stretch.q, dq)[back]
    if velocity is None:
        velocity = make_interp_spline(t, dq, k=3)(ticks)
    control.integral = np.zeros(arm.n_joints) if start is None else start
    torque = np.empty_like(q)
    for i in range(len(ticks)):
        torque[i] = control(targets.at(i), q[i], velocity[i])
    return torque[held][back]


def _velocity(
    controller: Controller, q: np.ndarray, start: np.ndarray, rule: str
) -> np.ndarray:
    """Velocity that the controller makes of positions at its ticks [rad/s], (K, n); ``start``: before them."""
    filtered = VelocityFilter(
        controller.estimate,
        q[0],
        start,
        rule,
    )
    return np.array([filtered(row) for row in q])
