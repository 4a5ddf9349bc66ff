"""Samples that can be identified from: what is odd about them, and whether a controller computed the torque."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.interpolate import make_interp_spline

from gapscope.arm.case import Case
from gapscope.arm.control import PD
from gapscope.arm.dynamics.rollout import Commands
from gapscope.arm.errors import InputError
from gapscope.arm.recording import STILL, Recording, resting
from gapscope.arm.root_mean_square import rms
from gapscope.arm.velocity_filter import VelocityFilter
from gapscope.ident.samples import Samples
from gapscope.model.conditioning import TORQUE_CUTOFF, TRIM, low_pass
from gapscope.model.effective_samples import band_samples

# Whether samples can be identified from at all; what cannot is refused with the reason, before any fit.


PER_PARAMETER = 2.0
"""Independent samples that each base parameter needs at least; a band of f Hz holds 2 f a second and joint."""


def check_bare(recording: Recording) -> None:
    """Check that a recording carries no known payload; raises ``InputError`` otherwise."""
    if recording.payload is not None:
        raise InputError(
            "carries a known payload, and what simulates the arm to identify it simulates it without",
            "leave the recording out, or use an estimator that does not simulate",
            file=recording.name,
        )


def check_recordings(
    recordings: Sequence[Recording],
    held_out: Sequence[Recording],
    case: Case,
) -> None:
    """Check that there is torque to fit and to hold out, and that something moves.

    Raises:
        InputError: no recording has a torque that can be trusted, or all joints rest.
    """
    if not any(recording.tau is not None for recording in recordings):
        notes = "; ".join(
            dict.fromkeys(note for recording in recordings for note in recording.notes)
        )
        raise InputError(
            "no recording holds a torque" + (f" ({notes})" if notes else ""),
            "record tau1..taun, the torque commanded or derived from motor current, or name its columns in the case's "
            "import: {tau: ...}; what the torque is not known of cannot be identified",
            file=case.name,
        )
    if not any(recording.tau is not None for recording in held_out):
        raise InputError(
            f"{', '.join(r.name for r in held_out)}, held out, has no torque",
            "name another recording with --judge",
            file=case.name,
        )
    if resting([r for r in recordings if r.tau is not None], case.arm.per_radian).all():
        raise InputError(
            f"the trajectory is constant: no joint moves by {STILL:g} rad within a recording",
            "record a motion in which all joints speed up, slow down and turn round (`gapscope excite` plans one)",
            file=recordings[0].name,
            where="columns q1 on",
        )


def check_count(samples: Samples, base_count: int, name: str) -> None:
    """Check that there are samples enough for the parameters.

    Raises:
        InputError: fewer than ``PER_PARAMETER`` independent samples per base parameter.
    """
    seconds = len(samples.torque) * samples.interval
    n_joints = samples.torque.shape[1]
    independent = n_joints * band_samples(seconds, samples.band.cutoff)
    if independent < PER_PARAMETER * base_count:
        per_second = n_joints * band_samples(1.0, samples.band.cutoff)
        needed = PER_PARAMETER * base_count / per_second
        raise InputError(
            f"{seconds:.2g} s in a band of {samples.band.cutoff:g} Hz hold {independent:.0f} independent samples, too "
            f"few for {base_count} base parameters",
            f"record for at least {np.ceil(needed + 1):.0f} s, ten times that for good measure, or raise --cutoff",
            file=name,
        )


# Whether a recorded torque is what the declared controller commands; wrong gains ruin every simulated closed loop.


AGREES = 0.3
"""A torque whose feedback part differs by less than this share agrees with its controller [1]."""
NOISE = 0.02
"""So does one that differs by less than this share of the joint's torque: noise may do that [1]."""
OFF = 0.1
"""Gains that fit better when scaled by more than this are wrong [1]."""
EXPLAINED = 0.5
"""Share of the miss that other gains must explain before they are called wrong [1]."""
AT_LIMIT = 0.99
"""Share of its limit from which a torque is at it [1]."""
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
    velocity = recording.dq
    if velocity is None:
        # the controller's, at its ticks
        q = make_interp_spline(recording.t, recording.q, k=3)(
            np.minimum(commands.t, recording.t[-1])
        )
        filtered = VelocityFilter(
            controller.rate,
            controller.velocity_cutoff,
            controller.velocity_damping,
            q[0],
            commands.dq[0],
        )
        velocity = np.array([filtered(row) for row in q])[rows]
    terms = [
        recording.tau - commands.torque[rows],
        controller.kp * (commands.q[rows] - recording.q),
        controller.kd * (commands.dq[rows] - velocity),
    ]
    edge = int(TRIM * rate)
    feedback, stiff, damped = (
        low_pass(x, rate, TORQUE_CUTOFF)[edge : len(rows) - edge] for x in terms
    )
    free: np.ndarray = np.ones(feedback.shape, dtype=bool)
    if limit is not None:
        below = np.abs(recording.tau) < AT_LIMIT * limit
        free = below[edge : len(rows) - edge]
    spread = recording.tau.std(axis=0)
    found: list[str] = []
    for j, rows_free in enumerate(free.T):
        own, both = feedback[rows_free, j], (stiff[rows_free, j], damped[rows_free, j])
        size, error = rms(own), rms(own - sum(both))
        # too small to test gains, or within what noise may do
        if size < SEEN * spread.max() or error < max(AGREES * size, NOISE * spread[j]):
            continue
        columns = np.stack(both, axis=1)
        scale = np.linalg.lstsq(columns, own, rcond=None)[0]
        # other gains that explain the torque: a wrong gain or unit; otherwise another controller
        explained = rms(own - columns @ scale) < (1 - EXPLAINED) * error
        if explained and np.abs(scale - 1).max() > OFF:
            raise InputError(
                f"the torque of joint {j + 1} fits kp times {scale[0]:.3g} and kd times {scale[1]:.3g}",
                "correct the gains, or their unit, in controller:; a simulated closed loop needs those of the "
                "recording",
                file=recording.name,
                where="controller.kp, controller.kd",
            )
        found.append(
            f"{recording.name}: {error / size:.0%} of the feedback torque of joint {j + 1} is not what the controller "
            "commands; check feedforward, delay, and whether the recorded torque is the command"
        )
    return found
