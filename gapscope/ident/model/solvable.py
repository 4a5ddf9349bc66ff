"""Whether samples can determine parameters, and if not, why: causes before a solver meets them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gapscope.arm.errors import InputError
from gapscope.ident.model.linear_problem import Problem

STILL = 1e-9
"""A regressor whose columns vary by less than this, relative to its largest entry, belongs to an arm that rests."""
DEPENDENT = 1e-10
"""Pivots of R below this, relative, with columns of unit norm, mark columns that depend on those before them."""
UNIT_FACTOR = 5.0
"""Torque larger or smaller than the nominal arm's by more than this is suspected of another unit."""


def check_samples(
    problem: Problem, *, full_rank: bool = True, rows: np.ndarray | None = None
) -> None:
    """Check that the samples determine the parameters.

    Args:
        problem: to be solved.
        full_rank: whether every parameter must be determined by the samples alone.
        rows: fewer rows than the problem's with the same sums of squares, (K, b), if there are some.

    Raises:
        InputError: a value is not finite; too few samples; a trajectory that rests; columns that depend on each other.
    """
    _check_finite(problem)
    equations, b = problem.torque.size, problem.matrix.shape[2]
    if full_rank and equations <= b:
        raise InputError(
            f"{len(problem.torque)} samples of {problem.n_joints} joints are {equations} equations for {b} parameters: "
            "too few. Either (a) the recording is too short, (b) filtering and trimming left little of it, or (c) the "
            "model has more parameters than this arm needs",
            "record for longer, or use base parameters, or an estimator with a prior (ridge, partial update)",
            where="samples",
        )
    spread = np.ptp(problem.matrix, axis=0).max(initial=0.0)
    if spread <= STILL * max(float(np.abs(problem.matrix).max(initial=0.0)), 1e-300):
        raise InputError(
            "the trajectory is constant: every sample gives the same equations. Either (a) the arm rested while it was "
            "recorded, (b) the position columns are not those of the moving joints, or (c) positions were rounded away",
            "record an exciting trajectory (`gapscope excite`)",
            where="q",
        )
    if full_rank:
        check_rank(problem.stacked()[0] if rows is None else rows, problem.names)


def unit_warnings(problem: Problem, nominal: np.ndarray) -> tuple[str, ...]:
    """Warnings about torque that is suspiciously small or large against the nominal arm's.

    Args:
        problem: with torque [N m] as recorded.
        nominal: parameters of the nominal arm, shape (b,), in the problem's columns.
    """
    recorded, expected = (
        np.sqrt((x**2).mean(axis=0)) for x in (problem.torque, problem.matrix @ nominal)
    )
    loaded = expected > 0.05 * expected.max(initial=0.0)
    if not loaded.any():
        return ()
    factor = float(np.median(recorded[loaded] / expected[loaded]))
    if 1 / UNIT_FACTOR < factor < UNIT_FACTOR:
        return ()
    size = "large" if factor > 1 else "small"
    return (
        f"the recorded torque is suspiciously {size}: {factor:.3g} times the nominal arm's. Either (a) its unit is not "
        "N m (N mm: 1000, N cm: 100), (b) it is a motor current, or a motor-side torque without the gear ratio, or (c) "
        "the nominal arm is another arm; state unit and transmission in import:, or correct the URDF",
    )


def _check_finite(problem: Problem) -> None:
    for values, what, remedy in (
        (
            problem.torque,
            "torque",
            "drop or repair the rows; a missing value is never guessed",
        ),
        (
            problem.matrix,
            "matrix",
            "look for rows of q, dq or ddq that are not finite, and drop them",
        ),
    ):
        bad = np.argwhere(~np.isfinite(values))
        if len(bad):
            rows = len(np.unique(bad[:, 0]))
            raise InputError(
                f"is not a finite number in {rows} of {len(values)} samples, first in sample {bad[0][0] + 1}, joint "
                f"{bad[0][1] + 1}. Either (a) the log has gaps filled with NaN, (b) a column holds text or is empty, "
                "or (c) a division in the import went wrong",
                remedy,
                where=what,
            )


def check_rank(matrix: np.ndarray, names: Sequence[str]) -> None:
    """Check that rows of equations, (K, b), determine every parameter; raises ``InputError`` otherwise."""
    missing = max(0, matrix.shape[1] - len(matrix))
    matrix = np.pad(matrix, ((0, missing), (0, 0)))
    norms = np.linalg.norm(matrix, axis=0)
    pivots = np.abs(
        np.diag(np.linalg.qr(matrix / np.where(norms > 0, norms, 1.0), mode="r"))
    )
    if (pivots > DEPENDENT).all():
        return
    open_names = ", ".join(np.asarray(names)[pivots <= DEPENDENT])
    raise InputError(
        f"the samples do not determine {open_names}. Either (a) the trajectory does not excite them, (b) the columns "
        "are not base parameters, so that some depend on others, or (c) a joint that they need did not move",
        "record an exciting trajectory (`gapscope excite`), use base parameters, or an estimator with a prior",
        where="matrix",
    )
