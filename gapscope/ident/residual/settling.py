"""Which joints a network speaks on, and how loud: judged after the projection, on what members had held out."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from gapscope.effects.residual.network import Network
from gapscope.ident.residual.apart import joint_heads, kept_apart, member_of, scaled
from gapscope.ident.residual.folds import GAINS, Folds, shares_closed, usefulness
from gapscope.ident.residual.orthogonality import Head, basis
from gapscope.ident.residual.rows import ResidualRows


class Choice(NamedTuple):
    """What speaks on each of n joints.

    Attributes:
        chosen: number of the network, -1 for none, (n,).
        gain: factor on its output [1], (n,).
        closed: share of the squares held out that it closes [1], (n,).
    """

    chosen: np.ndarray
    gain: np.ndarray
    closed: np.ndarray


def settled(
    choice: Choice,
    networks: Sequence[Network],
    hidden: Sequence[np.ndarray],
    rows: ResidualRows,
    folds: Folds,
) -> Choice:
    """The choice scaled and silenced until what the projection leaves of it stands the strict ``usefulness`` as it is.

    All joints share the constraints of the projection, so that a joint that is silenced or scaled changes the others:
    each round silences one joint or scales some, and judges all again. A joint whose factor would fall below the least
    of ``GAINS`` counts as failing, so that it ends.

    Args:
        choice: before the projection.
        networks: one per form, not scaled.
        hidden: what the heads of each see on all rows, (members or 1, n, N, K).
        rows: all rows.
        folds: which member holds out which.
    """
    chosen, gain, _ = choice
    alone = [
        _of_member(networks, hidden, member) for member in range(len(folds.fitted))
    ]
    heads = [
        _member_heads(member, seen, chosen, rows, fitted)
        for (member, seen), fitted in zip(alone, folds.fitted, strict=True)
    ]
    while True:
        outputs = [
            _outputs(member, seen, head, chosen, gain)
            for (member, seen), head in zip(alone, heads, strict=True)
        ]
        predicted = folds.held_out(np.stack(outputs))
        shares = shares_closed(folds, rows.residual, predicted)
        closed, again = usefulness(shares, strict=True)
        if (again[chosen >= 0] == 1.0).all():
            return Choice(chosen, np.where(chosen >= 0, gain, 0.0), closed)
        failing = np.flatnonzero((chosen >= 0) & (gain * again < GAINS[0]))
        if failing.size:
            # the others may stand once the one that harms a group most is silent
            as_it_is = shares[:, failing, -1].min(axis=0)
            silent = failing[as_it_is.argmin()]
            chosen = np.where(np.arange(len(chosen)) == silent, -1, chosen)
        else:
            gain = gain * again


def _of_member(
    networks: Sequence[Network], hidden: Sequence[np.ndarray], member: int
) -> tuple[list[Network], list[np.ndarray]]:
    """One member of each network, and what its head sees."""
    seen = [each if len(each) == 1 else each[[member]] for each in hidden]
    return [member_of(network, member) for network in networks], seen


def _member_heads(
    networks: Sequence[Network],
    hidden: Sequence[np.ndarray],
    chosen: np.ndarray,
    rows: ResidualRows,
    fitted: np.ndarray,
) -> dict[int, Head]:
    """Heads of a member on the rows that it is fitted to."""
    q = basis(rows.q[fitted], np.ones(rows.q.shape[1]))
    seen = [each[:, :, fitted] for each in hidden]
    return joint_heads(networks, chosen, seen, q)


def _outputs(
    networks: Sequence[Network],
    hidden: Sequence[np.ndarray],
    heads: dict[int, Head],
    chosen: np.ndarray,
    gain: np.ndarray,
) -> np.ndarray:
    """What a member says of all rows once it is kept apart, (N, n)."""
    loud = [scaled(network, gain) for network in networks]
    kept = kept_apart(loud, chosen, heads)
    output = np.zeros((hidden[0].shape[2], len(chosen)))
    for joint in np.flatnonzero(chosen >= 0):
        k = chosen[joint]
        head = kept[k].weights[-1][0, joint, :, 0]
        output[:, joint] = hidden[k][0, joint] @ head + kept[k].biases[-1][0, joint, 0]
    return output
