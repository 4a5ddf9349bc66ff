"""Commands as instruments: what the noise of the encoders does to the values found.

Columns X of a noisy motion are noisy. Least squares takes this noise for variation that the torque does not follow, so
that values shrink. Columns Z of the commanded motion have no such noise, and they vary with X, as the arm follows its
commands. Then

    theta = (Z^T W X)^-1 Z^T W y

is free of that bias, however noisy the encoders are, as long as the arm tracks. Source: soderstrom2002.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from gapscope.arm.recording import Recording
from gapscope.diagnosis.selection.search import SheetSearch
from gapscope.model.design import Design, about
from gapscope.model.difference import Fit
from gapscope.model.terms import Candidate


def instrumented(
    searching: SheetSearch, fit: Fit, recordings: Sequence[Recording]
) -> Mapping[Candidate, np.ndarray]:
    """Coordinates of the terms of a hypothesis by the commands as instruments, (linear,) each.

    Args:
        searching: the search that found it.
        fit: the hypothesis.
        recordings: of the search, as it took them.

    Returns:
        Values of all terms; none if the commands are not known, or an equation has no solution.
    """
    made, values = fit.contrast.design, fit.values
    commanded = _commanded(recordings)
    rows = None if commanded is None else made.rows.moved_as(commanded)
    if rows is None or not values:
        return {}
    by_commands = searching.design_on(rows, {one.effect for one in values})
    bodies = 10 * searching.arm.arm.n_joints
    measured = _columns(searching, made, values, bodies)
    instruments = _columns(searching, by_commands, values, bodies)
    gap, _ = about(made, searching.arm, values)
    size = measured[0].shape[1]
    left, right = np.zeros((size, size)), np.zeros(size)
    # errors of the bodies follow the columns of the terms; their prior keeps them small
    prior = made.prior[:bodies]
    # a prior of zero: that parameter has no error
    told = np.flatnonzero(prior > 0)
    left[size - bodies + told, size - bodies + told] = prior[told] ** -2.0
    for j, (x, z) in enumerate(zip(measured, instruments, strict=True)):
        noise2 = fit.contrast.error.noise2[j]
        # instruments on the left, measured columns on the right: no symmetric matrix
        left += z.T @ x / noise2
        right += z.T @ gap[:, j] / noise2
    some = np.r_[0 : size - bodies, size - bodies + told]
    # columns differ by orders of magnitude: scaled to a unit diagonal, the system is better conditioned
    scale = 1.0 / np.sqrt(np.maximum(np.abs(np.diag(left))[some], 1e-12))
    try:
        scaled = np.linalg.solve(
            left[np.ix_(some, some)] * np.outer(scale, scale), scale * right[some]
        )
    except np.linalg.LinAlgError:
        return {}
    # terms come first; the errors of the bodies behind them are of no interest
    ends = np.cumsum([len(x) for x in values.values()])
    parts = np.split((scale * scaled)[: ends[-1]], ends[:-1])
    return {
        one: part / made.units[one.term]
        for one, part in zip(values, parts, strict=True)
    }


def _columns(
    searching: SheetSearch,
    made: Design,
    values: Mapping[Candidate, np.ndarray],
    bodies: int,
) -> list[np.ndarray]:
    """Columns of terms about their values, then of errors of the bodies, per joint over its scale, (M, K)."""
    _, moved = about(made, searching.arm, values)
    out = []
    for j, (x, active) in enumerate(zip(made.columns, made.active, strict=True)):
        # columns that never act on a joint are zero there
        whole = np.zeros((len(x), made.size))
        whole[:, active] = x
        own = [
            moved[one][j] if one in moved else made.of_term(one.term, j)
            for one in values
        ]
        out.append(np.hstack([*own, whole[:, :bodies]]))
    return out


def _commanded(recordings: Sequence[Recording]) -> list[Recording] | None:
    """The recordings with the commanded motion instead of the measured one; ``None`` if it is not known."""
    out = []
    for recording in recordings:
        # without its commands a recording would have rows in X and none in Z
        if recording.q_ref is None:
            return None
        out.append(replace(recording, q=recording.q_ref, dq=recording.dq_ref))
    return out
