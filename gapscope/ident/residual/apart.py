"""Networks whose heads are changed so that what the mean of the members says is orthogonal to the physics."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from gapscope.effects.residual.network import Network
from gapscope.ident.residual.orthogonality import Head, head_of, project_heads

STIFFNESS = 0.1
"""Penalty of a change of a weight in the head, over the squares of what it sees: keeps the change small elsewhere."""


def joint_heads(
    networks: Sequence[Network],
    chosen: np.ndarray,
    hidden: Sequence[np.ndarray],
    q: np.ndarray,
) -> dict[int, Head]:
    """The members of each joint that speaks as one linear head on some rows, by joint from 0.

    Args:
        networks: in one or several forms.
        chosen: which of them speaks on each joint, -1 if none does, (n,).
        hidden: what the heads of each see, (members, n, N, K), or (1, n, N, K) if all members see the same.
        q: orthonormal columns of the physics on these rows, (N, n, r).
    """
    heads = {}
    for joint in np.flatnonzero(chosen >= 0):
        by_member = hidden[chosen[joint]][:, joint]
        count, rows = by_member.shape[:2]
        seen = by_member.transpose(1, 0, 2).reshape(rows, -1) / count
        penalty = STIFFNESS * rows * np.append(seen.var(axis=0), 1.0)
        heads[int(joint)] = head_of(
            np.hstack([seen, np.ones((rows, 1))]), penalty, q[:, joint]
        )
    return heads


def kept_apart(
    networks: Sequence[Network], chosen: np.ndarray, heads: dict[int, Head]
) -> tuple[Network, ...]:
    """The networks with heads such that the mean of the members is orthogonal to the physics on the rows of ``heads``.

    The mean alone speaks, so that its constraints are shared by the weights of all members.
    """
    weights = {
        int(joint): _mean_head(networks[chosen[joint]], int(joint))
        for joint in np.flatnonzero(chosen >= 0)
    }
    found = project_heads(heads, weights)
    kept = []
    for k, network in enumerate(networks):
        weight, bias = network.weights[-1].copy(), network.biases[-1].copy()
        for joint in np.flatnonzero(chosen == k):
            change = found[joint] - weights[joint]
            # members that see the same share one change
            weight[:, joint, :, 0] += change[:-1].reshape(-1, weight.shape[2])
            bias[:, joint, 0] += change[-1]
        kept.append(_with_head(network, weight, bias))
    return tuple(kept)


def scaled(network: Network, gain: np.ndarray) -> Network:
    """The network with the means of each joint multiplied by its gain, (n,)."""
    weight, bias = network.weights[-1].copy(), network.biases[-1].copy()
    weight[..., 0] *= gain[:, None]
    bias[..., 0] *= gain
    return _with_head(network, weight, bias)


def member_of(network: Network, member: int) -> Network:
    """One member of a network as a network."""
    return replace(
        network,
        weights=tuple(weight[[member]] for weight in network.weights),
        biases=tuple(bias[[member]] for bias in network.biases),
    )


def _mean_head(network: Network, joint: int) -> np.ndarray:
    """Weights and offset of the mean of a joint's members, in the order of ``joint_heads``."""
    weight = network.weights[-1][:, joint, :, 0]
    # members that see the same have one mean weight; the others share the mean of their outputs
    shared = weight if network.basis is None else weight.mean(axis=0)
    return np.append(shared.ravel(), network.biases[-1][:, joint, 0].mean())


def _with_head(network: Network, weight: np.ndarray, bias: np.ndarray) -> Network:
    """The network with another last layer."""
    return replace(
        network,
        weights=(*network.weights[:-1], weight),
        biases=(*network.biases[:-1], bias),
    )
