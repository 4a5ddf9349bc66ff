"""The torque of recordings that have none: what their known controller must have commanded.

With references and encoders recorded and the controller known, its law gives the torque back,

    tau = feedforward(q_ref, dq_ref, ddq_ref) + kp (q_ref - q) + kd (dq_ref - dq),    clipped at the torque limit,

so that a motion which differs from the simulated one, the replay gap, becomes a torque gap that effects can explain.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.interpolate import make_interp_spline

from gapscope.arm.case import Case
from gapscope.arm.controller import Controller
from gapscope.arm.dynamics.feedforward import feedforward
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording
from gapscope.arm.velocity_filter import VelocityFilter
from gapscope.effects.applied import AppliedEffect
from gapscope.ident.signals.conditioning import pieces

WARNING = (
    "no torque was recorded: it was worked out as what the known controller must have commanded. Encoder noise passes "
    "into it through the gains, and so do wrong gains; the replay gap is measured, the torque gap inferred"
)

UNSURE = (
    "no velocity was recorded either: how the controller discretises its velocity filter cannot be told from armature "
    "of kd / (2 rate), and of the two the former is assumed"
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
    warnings = (*case.warnings, WARNING, *([UNSURE] if _unsure(case) else []))
    return replace(_filled(case, "bilinear"), warnings=warnings)


def with_likelier_rule(case: Case, effects: tuple[AppliedEffect, ...]) -> Case | None:
    """The case with its torque computed by another rule of the velocity filter; ``None`` if none is likelier.

    The rules differ by half a tick each, which looks like kd / (2 rate) of armature on every joint. If that is what
    was found, another rule is the simpler explanation.

    Args:
        case: a case whose torque was computed.
        effects: found in it.
    """
    found = [e for e in effects if e.name == "armature"]
    if (
        WARNING not in case.warnings
        or not _unsure(case)
        or not found
        or case.controller is None
    ):
        return None
    joints = np.array(found[0].joints) - 1
    half_ticks = (
        found[0].parameters["inertia"]
        * 2
        * case.controller.rate
        / case.controller.kd[joints]
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

    def filled(recording: Recording) -> Recording:
        if recording.q_ref is None or case.controller is None:
            return recording
        return replace(
            recording, tau=commanded_torque(case.arm, case.controller, recording, rule)
        )

    recordings, judged = (
        tuple(map(filled, part)) for part in (case.recordings, case.judged)
    )
    return replace(case, recordings=recordings, judged=judged)


def commanded_torque(
    arm: NominalArm,
    controller: Controller,
    recording: Recording,
    rule: str = "bilinear",
) -> np.ndarray:
    """Torque that a controller commanded at the rows of a recording with ``q_ref`` [N m], shape (N, n).

    A stretch between gaps that is too short to be used has none, and holds zeros.

    Args:
        arm: the nominal arm, which the feedforward believes.
        controller: in the arm's joint order.
        recording: with ``q_ref``; its ``dq``, if recorded, is the velocity that the controller has.
        rule: of its velocity filter, one of ``gapscope.arm.velocity_filter.RULES``.
    """
    assert recording.q_ref is not None
    out, body, limit = np.zeros_like(recording.q), RigidBody(arm), arm.torque_limit
    for span in pieces(recording):
        t, first, back = np.unique(
            recording.t[span], return_index=True, return_inverse=True
        )
        q, q_ref = recording.q[span][first], recording.q_ref[span][first]
        dq_ref = (
            make_interp_spline(t, q_ref, k=3)(t, 1)
            if recording.dq_ref is None
            else recording.dq_ref[span][first]
        )
        ddq_ref = make_interp_spline(t, dq_ref, k=3)(t, 1)
        torque = feedforward(
            arm, body, controller.feedforward, q_ref, dq_ref, ddq_ref
        ) + controller.kp * (q_ref - q)
        dq = (
            recording.dq[span][first]
            if recording.dq is not None
            else _velocity(controller, t, q, dq_ref[0], rule)
        )
        out[span] = (torque + controller.kd * (dq_ref - dq))[back]
    return out if limit is None else np.clip(out, -limit, limit)


def _velocity(
    controller: Controller, t: np.ndarray, q: np.ndarray, start: np.ndarray, rule: str
) -> np.ndarray:
    """Velocity that the controller makes of positions [rad/s], (N, n), at times t [s]; ``start``: before them."""
    ticks = (
        t[0]
        + np.arange(int((t[-1] - t[0]) * controller.rate + 1e-6) + 1) / controller.rate
    )
    positions = make_interp_spline(t, q, k=3)(ticks)
    filtered = VelocityFilter(
        controller.rate,
        controller.velocity_cutoff,
        controller.velocity_damping,
        q[0],
        start,
        rule,
    )
    velocity = np.array([filtered(row) for row in positions])
    return velocity[
        np.minimum(((t - t[0]) * controller.rate + 1e-6).astype(int), len(ticks) - 1)
    ]
