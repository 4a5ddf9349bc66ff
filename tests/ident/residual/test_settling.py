"""A joint speaks only if what the projection leaves of it helps on every recording that was held out."""

from __future__ import annotations

import numpy as np
import toy

from gapscope.effects.residual.network import Network
from gapscope.ident.residual.additive import fit_additive
from gapscope.ident.residual.folds import (
    GAINS,
    Folds,
    make_folds,
    shares_closed,
    usefulness,
)
from gapscope.ident.residual.rows import ResidualRows, rows_of
from gapscope.ident.residual.settling import Choice, settled


def test_shares_are_of_each_groups_own_squares() -> None:
    group = np.repeat([0, 1], 4)
    folds = Folds(group, np.stack([group == 0, group == 1]), np.zeros(0), np.zeros(0))
    residual = np.array([[1.0]] * 4 + [[10.0]] * 4)
    shares = shares_closed(folds, residual, np.ones((8, 1)))
    assert np.allclose(shares[:, 0, -1], [1.0, 1.0 - 0.9**2])
    assert np.allclose(shares[0, 0], 1.0 - (1.0 - GAINS) ** 2)


def test_strict_judgement_silences_what_one_recording_does_not_need() -> None:
    # joint 1 closes half of each recording, joint 2 nothing of one of them
    full = np.array([[0.5, 0.5], [0.5, 0.5], [0.5, 0.0], [0.52, 0.5]])
    shares = full[:, :, None] * GAINS
    assert np.allclose(usefulness(shares)[1], [1.0, 1.0])
    closed, gain = usefulness(shares, strict=True)
    assert np.allclose(gain, [1.0, 0.0]) and np.allclose(closed, [0.505, 0.0])


def test_the_judgement_is_repeated_until_nothing_changes() -> None:
    rows, folds, network = _fitted()
    # joint 2 has nothing to learn; it has to be silenced, and joint 1 judged without it
    both = Choice(np.zeros(2, int), np.ones(2), np.ones(2))
    hidden = [network.hidden(rows.windows)]
    choice = settled(both, [network], hidden, rows, folds)
    assert choice.chosen.tolist() == [0, -1]
    assert choice.closed[0] > 0.4 and 0.6 < choice.gain[0] <= 1.0
    assert choice.gain[1] == choice.closed[1] == 0.0
    again = settled(choice, [network], hidden, rows, folds)
    assert all(np.array_equal(a, b) for a, b in zip(choice, again, strict=True))


def _fitted() -> tuple[ResidualRows, Folds, Network]:
    """An additive network of three toy trajectories, before it is kept apart."""
    settings = toy.quick()
    rows = rows_of([toy.trajectory(k) for k in range(3)], settings)
    folds = make_folds(rows.group, settings.members, rows.residual, rows.q)
    network = fit_additive(rows.windows, rows.residual, rows.target, folds, 0)
    return rows, folds, network
