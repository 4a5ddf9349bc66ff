"""Replay: the simulated arm, nominal or corrected, under the same commands as a recording.

If the controller is known, its commands are the references, and the torque is what it makes of the simulated
encoders. Otherwise the command is the recorded torque, held to for short horizons only: without a controller a small
error of the torque grows into any error of the position.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.signal import butter, sosfiltfilt

from gapscope.arm.control import ControlLoop, Targets, integral_at_start
from gapscope.arm.controller import Controller
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.dynamics.rollout import LONGEST_STEP, steps_per_tick
from gapscope.arm.errors import GapscopeError, InputError
from gapscope.arm.io.table import GAP_STEPS
from gapscope.arm.motions.motion import Motion
from gapscope.arm.nominal import NominalArm
from gapscope.arm.reading import interpolated
from gapscope.arm.recording import Recording
from gapscope.arm.root_mean_square import rms
from gapscope.arm.velocity_filter import VelocityFilter, rule_of
from gapscope.effects.applied import AppliedEffect, State
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.residual import ResidualNetwork
from gapscope.envs.drive.arm_drive import nominal_body
from gapscope.envs.simulated_arm import (
    NetworkTorque,
    SimulatedArm,
    closed_loop,
    diverged,
    fastest,
)
from gapscope.model.conditioning import TRIM

HORIZON = 0.2
"""Length of the stretches that are replayed under recorded torque [s]."""
CUTOFF = 20.0
"""Cut-off of the measured states from which replays under recorded torque start [Hz]; at most 0.4 of the rate."""

CHECK_CONTROLLER = (
    "check the controller's gains and units, and the effects of the model"
)

GIVE_DATA_SHEET = "give armature and friction in nominal:, or a model with them"
"""What to do if the replayed arm diverges under its controller, and under the recorded torque."""


class Replay(NamedTuple):
    """A replayed motion, at the times of the recording, N samples of n joints.

    Attributes:
        t: time [s], shape (N,).
        q: position as the simulated encoders read it [rad], shape (N, n).
        tau: torque commanded [N m], shape (N, n).
        rmse: replay gap, RMS of replayed minus recorded position without ``TRIM`` at both ends [rad], shape (n,).
        through_controller: whether the controller made the torque; otherwise it is the recorded one.
        sliding: whether each joint is prismatic, its position and gap in m, (n,); empty if none is.
    """

    t: np.ndarray
    q: np.ndarray
    tau: np.ndarray
    rmse: np.ndarray
    through_controller: bool
    sliding: tuple[bool, ...] = ()


def replay(
    arm: NominalArm,
    effects: tuple[AppliedEffect, ...],
    recording: Recording,
    controller: Controller | None,
    *,
    engine: str | None = None,
    residual: ResidualNetwork | None = None,
    states: tuple[State, ...] = (),
) -> Replay:
    """Run the simulated arm under the commands of a recording.

    Args:
        arm: the nominal arm, which is also what the controller's feedforward believes.
        effects: what the simulated arm has beyond it and the known payload of the recording.
        recording: with ``q_ref`` if the replay goes through the controller, with ``tau`` otherwise.
        controller: the controller, if known.
        engine: ``pybullet`` or ``mujoco``; by default PyBullet if it is installed, else MuJoCo.
        residual: a residual network of the arm with these effects, or ``None``: its torque is taken off the command.
        states: what it has in this recording, or spans of it, in place of ``effects``; the replay starts anew at each.

    Raises:
        InputError: the recording has neither a reference for a known controller nor a torque, or lasts less than
            three times ``TRIM``, or an effect cannot be simulated on this arm.
        GapscopeError: the simulated arm diverged.
    """
    if recording.duration < 3 * TRIM:
        raise InputError(
            f"lasts {recording.duration:.3g} s, a replay needs {3 * TRIM:.2g} s",
            file=recording.name,
        )
    whole = CorrectedArm(arm, effects, residual, states=states)
    whole.check()
    q, tau = recording.q.copy(), np.zeros_like(recording.q)
    through_controller = controller is not None and recording.q_ref is not None
    for rows, corrected in _stretches(recording, whole):
        if controller is not None and recording.q_ref is not None:
            q[rows], tau[rows] = _tracked(
                corrected, recording, rows, controller, engine
            )
        elif recording.tau is not None:
            q[rows], tau[rows] = _driven(corrected, recording, rows, engine)
        else:
            raise InputError(
                "has no torque, and no reference that a known controller follows",
                "give columns tau1.., or q_ref1.. and controller: in the case file",
                file=recording.name,
            )
    t = recording.t
    inner = (t >= t[0] + TRIM) & (t <= t[-1] - TRIM)
    rmse = rms((q - recording.q)[inner])
    return Replay(t, q, tau, rmse, through_controller, arm.sliding)


def _stretches(
    recording: Recording, whole: CorrectedArm
) -> Iterator[tuple[slice, CorrectedArm]]:
    """Slices of a recording between its gaps and within a state, those of at least four samples, and the arm there."""
    gaps = np.flatnonzero(np.diff(recording.t) > GAP_STEPS / recording.rate) + 1
    for inside, corrected in whole.spans(recording.name, recording.t):
        # repeated, so that a state of a single row has a first row and a last
        first, *_, last = np.flatnonzero(inside).repeat(2).tolist()
        cuts = [first, *(c for c in gaps.tolist() if first < c <= last), last + 1]
        for a, b in itertools.pairwise(cuts):
            # a spline of third order needs four
            if b - a >= 4:
                yield slice(a, b), corrected


def _simulated(
    corrected: CorrectedArm, recording: Recording, dt: float, engine: str | None
) -> SimulatedArm:
    """The arm with the known body that was mounted, in steps of dt [s]."""
    arm, effects = corrected.arm, corrected.effects
    step, bodies = arm.encoder_step or 0.0, nominal_body(arm, recording.payload)
    return SimulatedArm(
        arm, effects, dt, engine=engine, encoder_step=step, nominal=bodies
    )


def _tracked(
    corrected: CorrectedArm,
    recording: Recording,
    rows: slice,
    controller: Controller,
    engine: str | None,
) -> tuple[np.ndarray, np.ndarray]:
    """Positions [rad] and commanded torques [N m] of a stretch under its controller, each (N, n)."""
    t = recording.t[rows]
    # the last tick lies behind the last row
    count = int((t[-1] - t[0]) * controller.rate + 1e-6) + 2
    ticks = t[0] + np.arange(count) / controller.rate
    part = recording.part(rows)
    commands = Targets.recorded(corrected.arm, controller, part, ticks)
    reference = Motion(ticks, commands.q, commands.dq, commands.ddq)
    start, first = part.q[0], commands.at(0)
    recorded = None if part.dq is None else part.dq[0]
    # by the rule that comes nearest to the velocity recorded
    velocity = VelocityFilter(
        controller.estimate,
        start,
        first.dq,
        rule_of(recording, controller),
        recorded,
    )
    control = ControlLoop(controller, corrected.arm)
    # what an integrator holds is not recorded, but the torque that it leaves shows it
    if controller.integrator is not None and recording.tau is not None:
        held = integral_at_start(part, controller, commands)
        control.integral = controller.integrator.bounded(held)
    elif controller.integrator is not None:
        speed = first.dq if recorded is None else recorded
        # what the arm needs at the start of its reference
        body = RigidBody(corrected.arm).carrying(recording.payload)
        needed = replace(corrected, residual=None).predict(body, reference)[0]
        control.start_with(needed, first, start, speed)
    q, tau = np.empty((2, *commands.q.shape))
    steps = steps_per_tick(controller)
    dt = 1.0 / (controller.rate * steps)
    network = None
    if corrected.residual is not None:
        # the reference is at ticks here, so that each tick is an action of the network
        network = NetworkTorque(corrected, reference, 1, recording.payload)
    with _simulated(corrected, recording, dt, engine) as simulated:
        simulated.start(start, first.dq, ticks[0])
        loop = closed_loop(
            simulated, commands, control, lambda _, at: velocity(at), steps, network
        )
        for i, (q[i], _, tau[i]) in enumerate(loop):
            _check(simulated, ticks[i], CHECK_CONTROLLER)
    # a row holds the torque of the last tick before it
    tick = ((t - t[0]) * controller.rate + 1e-6).astype(int)
    return interpolated(t, ticks, q), tau[tick]


def _driven(
    corrected: CorrectedArm,
    recording: Recording,
    rows: slice,
    engine: str | None,
) -> tuple[np.ndarray, np.ndarray]:
    """Positions [rad] under the recorded torque, from the measured state every ``HORIZON``, and that torque, (N, n)."""
    assert recording.tau is not None
    t, tau = recording.t[rows], recording.tau[rows]
    period = 1.0 / recording.rate
    # measured positions through a zero-phase low-pass
    cutoff = min(CUTOFF, 0.4 * recording.rate)
    sos = butter(2, cutoff, output="sos", fs=recording.rate)
    # the padding has to be shorter than the stretch
    padding = min(len(t) - 1, int(3 * recording.rate / cutoff))
    smooth = sosfiltfilt(sos, recording.q[rows], axis=0, padlen=padding)
    speed = make_interp_spline(t, smooth, k=3)(t, 1)
    # the recorded torque holds what the network stands for, the arm does not
    applied = tau
    if corrected.residual is not None:
        # accelerations are smooth; the shortest stretches have four rows
        spline = make_interp_spline(t, smooth, k=5 if len(t) > 5 else 3)
        motion = Motion(t, smooth, spline(t, 1), spline(t, 2))
        body = RigidBody(corrected.arm).carrying(recording.payload)
        load = replace(corrected, residual=None).predict(body, motion)
        applied = tau - corrected.residual.torque(motion, load)
    q = np.empty_like(tau)
    # a whole number of steps for a row, none longer than rigid bodies are stepped
    dt = period / max(1, int(np.ceil(period / LONGEST_STEP - 1e-9)))
    count = max(2, round(HORIZON / period))
    with _simulated(corrected, recording, dt, engine) as simulated:
        for first in range(0, len(t), count):
            window = slice(first, min(first + count, len(t)))
            # one step beyond the last row, which so lies between two
            grid = np.arange(t[window][0], t[window][-1] + dt, dt)
            torque = interpolated(grid, t, applied)
            positions = np.empty((len(grid), tau.shape[1]))
            # back to what was measured: errors grow no longer than a horizon
            simulated.start(smooth[first], speed[first], grid[0])
            for i, held in enumerate(torque):
                positions[i] = simulated.encoders()
                simulated.step(held)
                _check(simulated, grid[i], GIVE_DATA_SHEET)
            q[window] = interpolated(t[window], grid, positions)
    return q, tau


def _check(simulated: SimulatedArm, time: float, remedy: str) -> None:
    """Stop an arm that diverges."""
    dq = simulated.dq
    if diverged(dq):
        raise GapscopeError(
            f"the replayed arm diverged at joint {fastest(dq) + 1}, at t = {time:.3g} s",
            remedy,
        )
