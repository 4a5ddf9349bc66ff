"""Commands as instruments: what the noise of the encoders does to the values found.

Columns X of a noisy motion are noisy, and least squares takes their noise for variation that the torque does not
follow: values shrink. Columns Z of the commanded motion have no such noise, and as the arm follows its commands they
vary with X. Then

    theta = (Z^T W X)^-1 Z^T W y

is free of that pull, however loud the encoders are, as long as the arm tracks. Source: soderstrom2002.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gapscope.arm.case import Case
from gapscope.diagnosis.model.fit_data import Data
from gapscope.diagnosis.selection.search import Selection
from gapscope.diagnosis.thresholds import SEARCH_RATE
from gapscope.effects.applied import AppliedEffect
from gapscope.ident.signals.conditioning import Segment, thinned


def instrumented(
    case: Case, selection: Selection, folds: list[list[Segment]]
) -> tuple[AppliedEffect, ...] | None:
    """The effects found with values by the commands as instruments.

    Args:
        case: the nominal arm and its controller.
        found: result of the search.
        folds: the commanded motions in the places of the measured ones, segment by segment; see ``commanded``.

    Returns:
        The effects, or ``None`` where an equation has no solution.
    """
    linear, evidence = selection.evidence.linear, selection.evidence
    commanded = Data(
        case.arm,
        linear.body,
        [[thinned(s, SEARCH_RATE) for s in f] for f in folds],
        linear.data.cutoff,
    )
    columns = np.array(
        sorted(c for t in selection.fit.terms for c in t.columns), dtype=int
    )
    size = len(columns) + len(linear.data.units)
    left, right = np.zeros((size, size)), np.zeros(size)
    weight = evidence.torque.independent / np.maximum(evidence.torque.count, 1e-9)
    weight = (weight / (selection.fit.held_out_mse + evidence.floor2)).mean(axis=0)
    for k in range(len(commanded.segments)):
        x, y, trust = linear.rows(linear.data, k, columns)
        z, _, _ = linear.rows(commanded, k, columns)
        w = weight * trust**2
        left += np.einsum("mjx,mj,mjy->xy", z, w, x)
        right += np.einsum("mjx,mj,mj->x", z, w, y)
    nuisances = np.arange(size) >= len(columns)
    left += np.diag(np.where(nuisances, 1.0 / evidence.sigma**2, 0.0))
    scale = 1.0 / np.sqrt(np.maximum(np.abs(np.diag(left)), 1e-12))
    try:
        solved = scale * np.linalg.solve(left * np.outer(scale, scale), scale * right)
    except np.linalg.LinAlgError:
        return None
    theta = selection.fit.theta.copy()
    theta[columns] = solved[: len(columns)]
    return evidence.terms.effects(evidence.terms.clipped(theta), selection.fit.terms)


def commanded(case: Case) -> Case | None:
    """The case with the commanded motion in the place of the measured one; ``None`` where it is not known."""
    recordings = [r for r in case.recordings if r.tau is not None]
    if case.controller is None or any(r.q_ref is None for r in recordings):
        return None
    return replace(
        case,
        recordings=tuple(
            replace(r, q=r.q_ref, dq=r.dq_ref)
            for r in recordings
            if r.q_ref is not None
        ),
    )
