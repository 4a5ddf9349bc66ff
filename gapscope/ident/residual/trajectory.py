"""What a residual network is trained on: trajectories with the residual of their torque, and their rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.motions.motion import Motion
from gapscope.effects.corrected import CorrectedArm
from gapscope.ident.residual.physics import effect_columns, physics_columns
from gapscope.model.conditioning import TORQUE_CUTOFF, Segment, low_pass

PER_CUTOFF = 4.0
"""Rows per period of the cut-off; more hold no further information."""
EDGE = 0.2
"""Time left out at both ends of a block [s], so that what lies in one is no neighbour of what lies in another."""


@dataclass(frozen=True)
class Trajectory:
    """One trajectory, N samples of n joints on a uniform grid, M rows that count.

    Attributes:
        name: of the recording.
        motion: its motion.
        load: torque that is predicted without a network [N m], (N, n).
        residual: recorded minus predicted torque, low-passed [N m], (N, n).
        recorded: recorded torque, low-passed [N m], (N, n).
        columns: of the physics, low-passed, at the rows only, (M, n, p).
        parameters: columns of the effects' parameters alone, likewise, (M, n, k).
        rows: samples that count, (M,).
    """

    name: str
    motion: Motion
    load: np.ndarray
    residual: np.ndarray
    recorded: np.ndarray
    columns: np.ndarray
    parameters: np.ndarray
    rows: np.ndarray


def from_segment(
    corrected: CorrectedArm, body: RigidBody, segment: Segment
) -> Trajectory:
    """A segment with torque, and the residual of a corrected arm."""
    assert segment.torque is not None
    physical = replace(corrected, residual=None)
    motion, body = segment.motion, segment.bodies(body)
    rows = chosen_rows(segment)

    def smooth(series: np.ndarray) -> np.ndarray:
        return low_pass(series, motion.rate, TORQUE_CUTOFF)

    load = physical.unlimited.predict(body, motion)
    recorded = smooth(physical.delivered(segment.torque))
    return Trajectory(
        name=segment.recording,
        motion=motion,
        load=load,
        residual=recorded - smooth(load),
        recorded=recorded,
        columns=smooth(physics_columns(physical, body, motion))[rows],
        parameters=smooth(effect_columns(physical, body, motion))[rows],
        rows=rows,
    )


def chosen_rows(segment: Segment) -> np.ndarray:
    """Trimmed samples, as many as the band of the torque gap holds."""
    step = max(1, int(segment.motion.rate / (PER_CUTOFF * TORQUE_CUTOFF) + 1e-6))
    inner = segment.inner
    return np.arange(inner.start, inner.stop, step)


def groups(trajectories: Sequence[Trajectory], members: int) -> np.ndarray:
    """Group of each row of all trajectories, for a split by trajectory, (M,); -1 if a row belongs to none.

    With three trajectories or more each is a group; fewer are cut into blocks of time, at least one per member.

    Raises:
        InputError: there is no trajectory.
    """
    if not trajectories:
        raise InputError("no trajectory to train on", "give recordings with a torque")
    # held out by trajectory, which is stricter than by time
    if len(trajectories) >= 3:
        lengths = [len(x.rows) for x in trajectories]
        return np.repeat(np.arange(len(trajectories)), lengths)
    blocks = -(-members // len(trajectories))  # rounded up
    out = []
    for k, trajectory in enumerate(trajectories):
        t = trajectory.motion.t[trajectory.rows]
        cuts = np.linspace(t[0], t[-1], blocks + 1)
        block = np.clip(np.searchsorted(cuts, t, side="right") - 1, 0, blocks - 1)
        # rows near a cut have neighbours in the next block: they belong to none
        to_cut = np.abs(t[:, None] - cuts[None, 1:-1]).min(axis=1, initial=np.inf)
        out.append(np.where(to_cut > EDGE, k * blocks + block, -1))
    return np.concatenate(out)
