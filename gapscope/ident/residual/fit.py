"""From trajectories to a residual network that leaves physics to the effects and is silent outside its data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gapscope.effects.residual.inputs import Inputs, channels, scaled
from gapscope.effects.residual.model import ResidualNetwork
from gapscope.effects.residual.network import Network
from gapscope.effects.residual.trust import Trust, nearest
from gapscope.ident.residual.orthogonality import (
    basis,
    left_by,
    parameter_moves,
    project_heads,
    share_explained,
)
from gapscope.ident.residual.settings import ResidualSettings
from gapscope.ident.residual.trajectory import Trajectory, groups
from gapscope.ident.signals.conditioning import TORQUE_CUTOFF

LANDMARKS = 200
"""Inputs that are remembered to tell how far others lie from them."""
REACH = 0.5
"""Quantile of the distance of held-out rows from the others up to which a network is judged, and trusted in full."""
LEAST_GAIN = 0.02
"""A joint on which the members close less than this share of the squared residual held out is left alone."""


@dataclass(frozen=True)
class Report:
    """What a training says of itself, on the rows that it was trained on.

    Attributes:
        closed: share of the squared residual that the members close on rows that they had held out [1], (n,).
        gain: factor on each joint's output, from the same rows; 0 if the network is no use [1], (n,).
        in_target: share of the residual's squares that lay in the span of the physics and was taken out [1].
        in_output: the same of the network's output, before and after the projection of the heads [1].
        moves: by how many standard deviations each parameter of the effects would move if it were refitted with the
            network in place, before and after the projection; each (k,).
        clipped, doubted: share of the rows on which the bound, and trust below 1, act [1].
    """

    closed: np.ndarray
    gain: np.ndarray
    in_target: float
    in_output: tuple[float, float]
    moves: tuple[np.ndarray, np.ndarray]
    clipped: float
    doubted: float


@dataclass(frozen=True)
class ResidualRows:
    """Rows of all trajectories, M of n joints, in weighted torque: over ``scale``.

    Attributes:
        inputs: what a network sees.
        windows: of the rows, (n, M, taps, C).
        left: what the corrected arm leaves [1], (M, n).
        target: what the columns of the physics do not explain of it [1], (M, n).
        q: orthonormal columns of the physics, (M, n, r).
        parameters: columns of the effects' parameters, (M, n, k).
        group: for a split by trajectory, (M,).
        trajectory: of each row, (M,).
        distance: of each row's input from those of all other groups [1], (M, n); infinite if it is in no group.
        scale: RMS residual [N m], (n,).
    """

    inputs: Inputs
    windows: np.ndarray
    left: np.ndarray
    target: np.ndarray
    q: np.ndarray
    parameters: np.ndarray
    group: np.ndarray
    trajectory: np.ndarray
    distance: np.ndarray
    scale: np.ndarray

    @property
    def reach(self) -> np.ndarray:
        """Distance up to which a network is asked whether it is of use on rows that it has not seen, (n,)."""
        known = np.isfinite(self.distance)
        return np.array(
            [
                np.quantile(d[k], REACH) if k.any() else 0.0
                for d, k in zip(self.distance.T, known.T, strict=True)
            ]
        )

    @property
    def near(self) -> np.ndarray:
        """Rows within ``reach`` of all other groups, (M, n)."""
        return self.distance <= self.reach


def rows_of(
    trajectories: Sequence[Trajectory], settings: ResidualSettings
) -> ResidualRows:
    """Rows of trajectories as a network sees them."""
    group = groups(trajectories, settings.members)
    left = np.concatenate([x.left[x.rows] for x in trajectories])
    scale = np.maximum(np.sqrt((left**2).mean(axis=0)), 1e-9)
    seen = np.concatenate(
        [channels(x.motion, x.load)[:, x.rows] for x in trajectories], axis=1
    )
    mean, std = seen.mean(axis=1), seen.std(axis=1)
    # sines and cosines have a natural scale: a joint that hardly moved must not be blown up
    std = np.maximum(std, np.where(scaled(left.shape[1]), 0.1 * std.max(axis=0), 0.2))
    inputs = Inputs(left.shape[1], settings.taps, settings.spacing, mean, std)
    windows = np.concatenate(
        [inputs.windows(x.motion, x.load, x.rows) for x in trajectories], axis=1
    )
    q = basis(np.concatenate([x.columns for x in trajectories]), scale)
    parameters = (
        np.concatenate([x.parameters for x in trajectories]) / scale[None, :, None]
    )
    trajectory = np.repeat(
        np.arange(len(trajectories)), [len(x.rows) for x in trajectories]
    )
    distance = _from_other_groups(windows[:, :, -1], group)
    return ResidualRows(
        inputs,
        windows,
        left / scale,
        left_by(q, left / scale),
        q,
        parameters,
        group,
        trajectory,
        distance,
        scale,
    )


def _from_other_groups(now: np.ndarray, group: np.ndarray) -> np.ndarray:
    """Distance of each row's input, of (n, M, C), from the nearest of another group, (M, n)."""
    out = np.full((len(group), len(now)), np.inf)
    for g in np.unique(group[group >= 0]):
        others = now[:, (group != g) & (group >= 0)]
        if others.shape[1]:
            out[group == g] = nearest(
                now[:, group == g], others[:, :: max(1, others.shape[1] // 1000)]
            ).T
    return out


def fit_residual(
    trajectories: Sequence[Trajectory], settings: ResidualSettings
) -> tuple[ResidualNetwork, Report]:
    """Train a residual network on what the corrected arm leaves of some trajectories.

    The columns of the physics are taken out of the target; the members are trained; on rows that they had held out
    each joint's output is scaled down to what it is good for; and the heads are projected, so that the output of every
    member is orthogonal to the columns over the rows.
    """
    from gapscope.ident.residual.training import held_out, train  # torch

    rows = rows_of(trajectories, settings)
    network = train(
        settings, rows.inputs, rows.windows, rows.target, rows.group, rows.near
    )
    closed, gain = usefulness(network, rows, held_out(rows.group, settings.members))
    network = _scaled(network, gain)
    before = network.outputs(rows.windows)[0].mean(axis=0).T
    network = _projected(network, rows, gain > 0)
    after = network.outputs(rows.windows)[0].mean(axis=0).T
    bound = settings.bound * np.abs(rows.left * rows.scale).max(axis=0)
    trust = _trust(rows)
    residual = ResidualNetwork(
        rows.inputs, network, trust, rows.scale, bound, TORQUE_CUTOFF
    )
    moves = [
        parameter_moves(rows.parameters, x, rows.left, rows.trajectory)
        for x in (before, after)
    ]
    report = Report(
        closed,
        gain,
        1.0 - float((rows.target**2).sum() / (rows.left**2).sum()),
        (share_explained(rows.q, before), share_explained(rows.q, after)),
        (moves[0], moves[1]),
        float((np.abs(after * rows.scale) > bound).mean()),
        float((trust.factor(rows.windows[:, :, -1]) < 1.0).mean()),
    )
    return residual, report


def usefulness(
    network: Network, rows: ResidualRows, held: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Share of the squares that members close on rows that they held out, and the best factor for them; each (n,).

    Only rows near others count: far ones say nothing of where the network will be trusted. The factor is
    <y, f> / <f, f>, between 0 and 1, and 0 if less than ``LEAST_GAIN`` would be closed with it.
    """
    mean = network.outputs(rows.windows)[0]
    weight = held[:, None].astype(float)
    f = (mean * weight).sum(axis=0) / np.maximum(weight.sum(axis=0), 1.0)
    counted = rows.near.T & held.any(axis=0)
    y, f = np.where(counted, rows.target.T, 0.0), np.where(counted, f, 0.0)
    gain = np.clip(
        (y * f).sum(axis=1) / np.maximum((f * f).sum(axis=1), 1e-300), 0.0, 1.0
    )
    closed = 1.0 - ((y - gain[:, None] * f) ** 2).sum(axis=1) / np.maximum(
        (y**2).sum(axis=1), 1e-300
    )
    return closed, np.where(closed < LEAST_GAIN, 0.0, gain)


def _scaled(network: Network, gain: np.ndarray) -> Network:
    """The network with the means of each joint multiplied by its gain."""
    weight, bias = network.weights[-1].copy(), network.biases[-1].copy()
    weight[..., 0] *= gain[:, None]
    bias[..., 0] *= gain
    return replace(
        network,
        weights=(*network.weights[:-1], weight),
        biases=(*network.biases[:-1], bias),
    )


def _projected(network: Network, rows: ResidualRows, active: np.ndarray) -> Network:
    """The network with heads whose output is orthogonal to the physics on the rows."""
    hidden = network.hidden(rows.windows)
    weight, bias = network.weights[-1].copy(), network.biases[-1].copy()
    for m in range(network.members):
        seen = np.concatenate([hidden[m], np.ones((*hidden.shape[1:3], 1))], axis=2)
        head = np.column_stack([weight[m, :, :, 0], bias[m, :, 0]])
        head = project_heads(seen, head, rows.q, active)
        weight[m, :, :, 0], bias[m, :, 0] = head[:, :-1], head[:, -1]
    return replace(
        network,
        weights=(*network.weights[:-1], weight),
        biases=(*network.biases[:-1], bias),
    )


def _trust(rows: ResidualRows) -> Trust:
    """Landmarks spread over the inputs seen, and the radius within which everything seen lies.

    The radius is at least ``reach``: up to there the network was shown to be of use on rows that it had not seen.
    """
    now = rows.windows[:, :, -1]
    landmarks = np.stack([_spread(points, LANDMARKS) for points in now])
    cover = nearest(now, landmarks).max(axis=1)
    return Trust(
        landmarks, np.maximum(np.maximum(cover, rows.reach), 1e-9) * (1.0 + 1e-9)
    )


def _spread(points: np.ndarray, count: int) -> np.ndarray:
    """Some of the points (M, C), each as far from those before as there is any; (min(count, M), C)."""
    chosen = [0]
    distance = np.full(len(points), np.inf)
    for _ in range(min(count, len(points)) - 1):
        distance = np.minimum(
            distance, ((points - points[chosen[-1]]) ** 2).sum(axis=1)
        )
        chosen.append(int(distance.argmax()))
    return points[chosen]
