"""From trajectories to a residual network orthogonal to the effects that fades out away from its training data."""

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
    parameter_moves,
    project_heads,
    share_explained,
    unexplained_by,
)
from gapscope.ident.residual.settings import ResidualSettings
from gapscope.ident.residual.trajectory import Trajectory, groups
from gapscope.ident.signals.conditioning import TORQUE_CUTOFF

LANDMARKS = 200
"""Number of training inputs kept as landmarks, from which the distance of an input is measured."""
REACH = 0.5
"""Quantile of the distance of held-out rows from the others up to which a network is tested, and trusted in full."""
LEAST_GAIN = 0.02
"""A joint on which the members close less than this share of the squared residual held out gets no torque."""


@dataclass(frozen=True)
class Report:
    """Results of a training, on the rows that it was trained on.

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
        residual: of the corrected arm [1], (M, n).
        target: what the columns of the physics do not explain of it [1], (M, n).
        q: orthonormal columns of the physics, (M, n, r).
        parameters: columns of the effects' parameters, (M, n, k).
        group: for a split by trajectory, (M,).
        trajectory: of each row, (M,).
        distance: of each row's input from those of all other groups [1], (M, n); infinite if it is in no group.
        scale: RMS of the residual [N m], (n,).
    """

    inputs: Inputs
    windows: np.ndarray
    residual: np.ndarray
    target: np.ndarray
    q: np.ndarray
    parameters: np.ndarray
    group: np.ndarray
    trajectory: np.ndarray
    distance: np.ndarray
    scale: np.ndarray

    @property
    def reach(self) -> np.ndarray:
        """Distance up to which a network is tested on rows that it has not seen, (n,)."""
        reach = np.zeros(self.distance.shape[1])
        for joint, distance in enumerate(self.distance.T):
            known = np.isfinite(distance)
            if known.any():
                reach[joint] = np.quantile(distance[known], REACH)
        return reach

    @property
    def near(self) -> np.ndarray:
        """Rows within ``reach`` of all other groups, (M, n)."""
        return self.distance <= self.reach


def rows_of(
    trajectories: Sequence[Trajectory], settings: ResidualSettings
) -> ResidualRows:
    """Rows of trajectories as a network sees them."""
    group = groups(trajectories, settings.members)
    residual = np.concatenate([x.residual[x.rows] for x in trajectories])
    scale = np.maximum(np.sqrt((residual**2).mean(axis=0)), 1e-9)
    weighted = residual / scale
    inputs = _inputs(trajectories, settings)
    windows = np.concatenate(
        [inputs.windows(x.motion, x.load, x.rows) for x in trajectories], axis=1
    )
    q = basis(np.concatenate([x.columns for x in trajectories]), scale)
    parameters = np.concatenate([x.parameters for x in trajectories])
    lengths = [len(x.rows) for x in trajectories]
    return ResidualRows(
        inputs=inputs,
        windows=windows,
        residual=weighted,
        target=unexplained_by(q, weighted),
        q=q,
        parameters=parameters / scale[None, :, None],
        group=group,
        trajectory=np.repeat(np.arange(len(trajectories)), lengths),
        distance=_from_other_groups(windows[:, :, -1], group),
        scale=scale,
    )


def _inputs(trajectories: Sequence[Trajectory], settings: ResidualSettings) -> Inputs:
    """Inputs of the network, with their mean and deviation over the rows."""
    series = [channels(x.motion, x.load)[:, x.rows] for x in trajectories]
    seen = np.concatenate(series, axis=1)
    n = len(seen)
    mean, std = seen.mean(axis=1), seen.std(axis=1)
    # sines and cosines have a natural scale: a joint that hardly moved must not be blown up
    least = np.where(scaled(n), 0.1 * std.max(axis=0), 0.2)
    return Inputs(
        n=n,
        taps=settings.taps,
        spacing=settings.spacing,
        mean=mean,
        std=np.maximum(std, least),
    )


def _from_other_groups(now: np.ndarray, group: np.ndarray) -> np.ndarray:
    """Distance of each row's input, of (n, M, C), from the nearest of another group, (M, n)."""
    distance = np.full((len(group), len(now)), np.inf)
    for g in np.unique(group[group >= 0]):
        own = group == g
        others = now[:, ~own & (group >= 0)]
        if not others.shape[1]:
            continue
        # a thousand of them show the distance well enough
        thinned = others[:, :: max(1, others.shape[1] // 1000)]
        distance[own] = nearest(now[:, own], thinned).T
    return distance


def fit_residual(
    trajectories: Sequence[Trajectory], settings: ResidualSettings
) -> tuple[ResidualNetwork, Report]:
    """Train a residual network on the residual of the corrected arm on some trajectories.

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
    # a joint on which the network is of little use gets less torque, or none
    network = _scaled(network, gain)
    before = network.outputs(rows.windows)[0].mean(axis=0).T
    # after the scaling, which would break the orthogonality
    network = _projected(network, rows, gain > 0)
    after = network.outputs(rows.windows)[0].mean(axis=0).T
    bound = settings.bound * np.abs(rows.residual * rows.scale).max(axis=0)
    trust = _trust(rows)
    residual = ResidualNetwork(
        inputs=rows.inputs,
        network=network,
        trust=trust,
        scale=rows.scale,
        bound=bound,
        cutoff=TORQUE_CUTOFF,
    )
    moved_before = parameter_moves(
        rows.parameters, before, rows.residual, rows.trajectory
    )
    moved_after = parameter_moves(
        rows.parameters, after, rows.residual, rows.trajectory
    )
    target_share = (rows.target**2).sum() / (rows.residual**2).sum()
    clipped = np.abs(after * rows.scale) > bound
    faded = trust.factor(rows.windows[:, :, -1]) < 1.0
    report = Report(
        closed=closed,
        gain=gain,
        in_target=1.0 - float(target_share),
        in_output=(share_explained(rows.q, before), share_explained(rows.q, after)),
        moves=(moved_before, moved_after),
        clipped=float(clipped.mean()),
        doubted=float(faded.mean()),
    )
    return residual, report


def usefulness(
    network: Network, rows: ResidualRows, held: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Share of the squares that members close on rows that they held out, and the best factor for them; each (n,).

    Only rows near others count: the network will not be trusted at far ones. The factor is
    <y, f> / <f, f>, between 0 and 1, and 0 if less than ``LEAST_GAIN`` would be closed with it.
    """
    mean = network.outputs(rows.windows)[0]
    # mean over the members that held a row out
    weight = held[:, None].astype(float)
    predicted = (mean * weight).sum(axis=0) / np.maximum(weight.sum(axis=0), 1.0)
    counted = rows.near.T & held.any(axis=0)
    target = np.where(counted, rows.target.T, 0.0)
    predicted = np.where(counted, predicted, 0.0)
    product = (target * predicted).sum(axis=1)
    square = (predicted * predicted).sum(axis=1)
    gain = np.clip(product / np.maximum(square, 1e-300), 0.0, 1.0)
    error = ((target - gain[:, None] * predicted) ** 2).sum(axis=1)
    closed = 1.0 - error / np.maximum((target**2).sum(axis=1), 1e-300)
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
    ones = np.ones((*hidden.shape[1:3], 1))
    for member in range(network.members):
        seen = np.concatenate([hidden[member], ones], axis=2)
        # weights and bias of the mean; the variance has its own head
        head = np.column_stack([weight[member, :, :, 0], bias[member, :, 0]])
        head = project_heads(seen, head, rows.q, active)
        weight[member, :, :, 0] = head[:, :-1]
        bias[member, :, 0] = head[:, -1]
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
    radius = np.maximum(np.maximum(cover, rows.reach), 1e-9)
    # a little more, so that rounding leaves no row outside
    return Trust(landmarks, radius * (1.0 + 1e-9))


def _spread(points: np.ndarray, count: int) -> np.ndarray:
    """Some of the points (M, C), each as far as possible from those before; (min(count, M), C)."""
    chosen = [0]
    distance = np.full(len(points), np.inf)
    for _ in range(min(count, len(points)) - 1):
        from_last = ((points - points[chosen[-1]]) ** 2).sum(axis=1)
        distance = np.minimum(distance, from_last)
        chosen.append(int(distance.argmax()))
    return points[chosen]
