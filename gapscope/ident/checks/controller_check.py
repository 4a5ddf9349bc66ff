"""Whether a recorded torque is what the declared controller commands; wrong gains ruin every simulated closed loop."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import make_interp_spline

from gapscope.arm.control.pd import PD
from gapscope.arm.dynamics.rollout import Commands
from gapscope.arm.errors import InputError
from gapscope.arm.recording import Recording
from gapscope.arm.velocity_filter import VelocityFilter, rule_of
from gapscope.model.conditioning import TORQUE_CUTOFF, TRIM, low_pass

AGREES = 0.3
"""A torque whose feedback part differs by less than this share agrees with its controller [1]."""
NOISE = 0.02
"""So does one that differs by less than this share of the joint's torque: noise may do that [1]."""
OFF = 0.1
"""Gains that fit better when scaled by more than this are wrong [1]."""
EXPLAINED = 0.5
"""Share of the miss that other gains must explain before they are called wrong [1]."""
SEEN = 0.01
"""Feedback below this share of the torque's spread is too small to test gains [1]."""


def check_controller(
    recording: Recording,
    controller: PD,
    commands: Commands,
    limit: np.ndarray | None = None,
) -> list[str]:
    """Compare tau with feedforward + kp (q_ref - q) + kd (dq_ref - dq), both low-passed; warnings, one per joint.

    Args:
        recording: with q_ref and tau.
        controller: as declared.
        commands: its reference and feedforward at its ticks from the recording's first row on.
        limit: of the torque [N m], shape (n,); samples at it are not compared.

    Raises:
        InputError: other gains explain a joint's torque clearly better.
    """
    assert recording.tau is not None
    rate = recording.rate
    rows = ((recording.t - recording.t[0]) * controller.rate + 1e-6).astype(int)
    velocity = (
        recording.dq
        if recording.dq is not None
        else _velocity(recording, controller, commands)[rows]
    )
    terms = [
        recording.tau - commands.torque[rows],
        controller.kp * (commands.q[rows] - recording.q),
        controller.kd * (commands.dq[rows] - velocity),
    ]
    edge = int(TRIM * rate)
    feedback, stiff, damped = (
        low_pass(x, rate, TORQUE_CUTOFF)[edge : len(rows) - edge] for x in terms
    )
    free = np.ones(feedback.shape, dtype=bool)
    if limit is not None:
        free = (np.abs(recording.tau) < 0.999 * limit)[edge : len(rows) - edge]
    spread = recording.tau.std(axis=0).max()
    found = []
    for j in range(recording.n_joints):
        rows_free = free[:, j]
        found.append(
            _joint(
                recording,
                j,
                feedback[rows_free, j],
                stiff[rows_free, j],
                damped[rows_free, j],
                spread,
            )
        )
    return [warning for warning in found if warning]


def _velocity(recording: Recording, controller: PD, commands: Commands) -> np.ndarray:
    """The controller's velocity at its ticks [rad/s], from recorded positions, shape (K, n)."""
    q = make_interp_spline(recording.t, recording.q, k=3)(
        np.minimum(commands.t, recording.t[-1])
    )
    filtered = VelocityFilter(
        controller.rate,
        controller.velocity_cutoff,
        controller.velocity_damping,
        q[0],
        commands.dq[0],
        rule_of(recording, controller),
    )
    return np.array([filtered(row) for row in q])


def _joint(
    recording: Recording,
    joint: int,
    feedback: np.ndarray,
    stiff: np.ndarray,
    damped: np.ndarray,
    spread: float,
) -> str:
    """A warning about one joint, or an empty string."""
    assert recording.tau is not None
    size = _rms(feedback)
    if size < SEEN * spread:
        return ""
    error = _rms(feedback - (stiff + damped))
    noise = NOISE * float(recording.tau[:, joint].std())
    if error < max(AGREES * size, noise):
        return ""
    terms = np.stack([stiff, damped], axis=1)
    scale = np.linalg.lstsq(terms, feedback, rcond=None)[0]
    rescaled_error = _rms(feedback - terms @ scale)
    # other gains that explain the torque: a wrong gain or unit; otherwise another controller
    other_gains = np.abs(scale - 1).max() > OFF
    if other_gains and rescaled_error < (1 - EXPLAINED) * error:
        raise InputError(
            f"the torque of joint {joint + 1} fits kp times {scale[0]:.3g} and kd times {scale[1]:.3g}",
            "correct the gains, or their unit, in controller:; a simulated closed loop needs those of the recording",
            file=recording.name,
            where="controller.kp, controller.kd",
        )
    return (
        f"{recording.name}: {error / size:.0%} of the feedback torque of joint {joint + 1} is not what the controller "
        "commands; check feedforward, delay, and whether the recorded torque is the command"
    )


def _rms(series: np.ndarray) -> float:
    return float(np.sqrt(np.mean(series**2)))
