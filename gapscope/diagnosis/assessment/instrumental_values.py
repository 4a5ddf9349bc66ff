"""Commands as instruments: what the noise of the encoders does to the values found.

Columns X of a noisy motion are noisy. Least squares takes this noise for variation that the torque does not follow, so
that values shrink. Columns Z of the commanded motion have no such noise, and they vary with X, as the arm follows its
commands. Then

    theta = (Z^T W X)^-1 Z^T W y

is free of that bias, however noisy the encoders are, as long as the arm tracks. Source: soderstrom2002.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gapscope.arm.case import Case
from gapscope.diagnosis.model.fit_data import FitData
from gapscope.diagnosis.selection.fitted_model import Selection, searched_folds
from gapscope.effects.applied import AppliedEffect
from gapscope.model.conditioning import Segment


def instrumented(
    case: Case, selection: Selection, folds: list[list[Segment]]
) -> tuple[AppliedEffect, ...] | None:
    """The effects found with values by the commands as instruments.

    Args:
        case: the nominal arm and its controller.
        selection: result of the search.
        folds: the commanded motions in the places of the measured ones, segment by segment; see ``commanded``.

    Returns:
        The effects, or ``None`` if an equation has no solution.
    """
    evidence, terms = selection.evidence, selection.fit.terms
    columns = np.array(sorted(c for t in terms for c in t.columns), dtype=int)
    left, right = _equations(case, selection, folds, columns)

    # Errors of the nominal inertials follow the columns of the terms; their prior keeps them small.
    inertials = len(right) - len(columns)
    left[len(columns) :, len(columns) :] += evidence.prior[:inertials, :inertials]

    # Columns differ by orders of magnitude: scaled to a unit diagonal, the system is better conditioned.
    scale = 1.0 / np.sqrt(np.maximum(np.abs(np.diag(left)), 1e-12))
    try:
        scaled = np.linalg.solve(left * np.outer(scale, scale), scale * right)
    except np.linalg.LinAlgError:
        return None

    solution = scale * scaled
    theta = selection.fit.theta.copy()
    theta[columns] = solution[: len(columns)]
    clipped = evidence.terms.clipped(theta)
    return evidence.terms.effects(clipped, terms)


def _equations(
    case: Case, selection: Selection, folds: list[list[Segment]], columns: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Z^T W X and Z^T W y over the terms in ``columns`` and errors of the nominal inertials, (C, C) and (C,)."""
    linear, evidence = selection.evidence.linear, selection.evidence
    looked_at = searched_folds(folds)
    commanded_data = FitData(case.arm, linear.body, looked_at, linear.data.cutoff)

    # Weights of the evidence, the mean over the folds: what is fitted here is all of them at once.
    rows = evidence.torque
    independent = rows.independent / np.maximum(rows.count, 1e-9)
    variance = selection.fit.held_out_mse + rows.expected2
    weight = (independent / variance).mean(axis=0)

    size = len(columns) + len(linear.data.units)
    left, right = np.zeros((size, size)), np.zeros(size)
    for k in range(len(commanded_data.segments)):
        x, y, trust = linear.rows(k, columns)
        z = linear.columns_on(commanded_data, k, selection.fit.terms)

        # Rows on which dry friction is not determined count less.
        w = weight * trust**2
        # one product of matrices of all rows of all joints
        weighted = (z * w[..., None]).reshape(-1, size)
        left += weighted.T @ x.reshape(-1, size)
        right += weighted.T @ y.ravel()
    return left, right


def commanded(case: Case) -> Case | None:
    """The case with the commanded motion instead of the measured one; ``None`` if it is not known."""
    if case.controller is None:
        return None

    recordings = []
    for recording in case.recordings:
        # Recordings without torque are not fitted: their references do not matter.
        if recording.tau is None:
            continue
        if recording.q_ref is None:
            return None
        as_commanded = replace(recording, q=recording.q_ref, dq=recording.dq_ref)
        recordings.append(as_commanded)
    return replace(case, recordings=tuple(recordings))
