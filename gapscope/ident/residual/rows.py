"""Rows of all trajectories as a residual network sees them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gapscope.effects.residual.inputs import Inputs, Layout, channels
from gapscope.effects.residual.trust import nearest
from gapscope.ident.residual.orthogonality import basis, unexplained_by
from gapscope.ident.residual.settings import ResidualSettings
from gapscope.ident.residual.trajectory import Trajectory, groups

REACH = 0.99
"""Quantile of the distance of held-out rows from the others up to which a network is tested, and trusted in full."""


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
    apart = [
        x.columns if settings.apart == "all" else x.parameters for x in trajectories
    ]
    q = basis(np.concatenate(apart), scale)
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
        distance=_from_other_groups(
            windows[:, :, -1, inputs.layout.neighbourhood], group
        ),
        scale=scale,
    )


def _inputs(trajectories: Sequence[Trajectory], settings: ResidualSettings) -> Inputs:
    """Inputs of the network, with their scales over the rows."""
    series = [channels(x.motion, x.load)[:, x.rows] for x in trajectories]
    seen = np.concatenate(series, axis=1)
    n = len(seen)
    layout = Layout(n)
    mean, std = seen.mean(axis=1), np.sqrt((seen**2).mean(axis=1))
    # signals keep their zero, at which friction and load turn; postures have none
    mean[:, : layout.angle] = 0.0
    posture = slice(layout.angle, None)
    std[:, posture] = seen[:, :, posture].std(axis=1)
    # a joint that hardly moved must not be blown up
    natural = [
        *range(layout.channels)[layout.direction],
        *range(layout.channels)[posture],
    ]
    least = 0.1 * std.max(axis=0)
    least[natural] = 0.2
    least[layout.memory] = 0.0
    return Inputs(
        n=n,
        taps=settings.taps,
        spacing=settings.spacing,
        mean=mean,
        std=np.maximum(np.maximum(std, least), 1e-9),
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
