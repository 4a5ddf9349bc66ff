"""Whether the torque can be in N m, of the joints that its columns name, and below its limits."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from gapscope.arm.case import Case
from gapscope.case_check.remark import Remark, numbers
from gapscope.case_check.thresholds import AT_LIMIT, EXCHANGED, WEIGHTY
from gapscope.ident.checks.fit_evidence import nominal_similarity
from gapscope.ident.checks.plausible_samples import UNIT_FACTOR, unit_factor
from gapscope.ident.checks.symptoms import exchanged
from gapscope.ident.model.model_columns import ModelColumns
from gapscope.ident.signals.samples import Band, Samples
from gapscope.model.conditioning import Segment


def check_torque_column(
    case: Case, columns: ModelColumns, segments: Sequence[Segment], cutoff: float
) -> Iterator[Remark]:
    """Unit, sign and order of the torque columns against the nominal arm, and samples at the limit."""
    with_torque = [segment for segment in segments if segment.torque is not None]
    if not with_torque:
        return
    found = nominal_similarity(Samples(columns, with_torque, Band(cutoff)))
    odd = [*_unit(unit_factor(found))]
    backwards = np.flatnonzero((found.gain < 0) & (found.weight > WEIGHTY)) + 1
    if len(backwards):
        odd.append(
            Remark(
                "warn",
                "torque",
                numbers(backwards.tolist()),
                "the nominal arm explains the torque with the opposite sign",
                "the diagnosis tests for sign_flip; import: {signs: [...]} puts it right",
            )
        )
    gain, joints = exchanged(found.explained)
    if gain > EXCHANGED:
        odd.append(
            Remark(
                "warn",
                "torque",
                numbers(list(joints)),
                f"torques fit the motion of other joints better, by {gain:.0%} of their variance",
                "check the order of joints: and of the columns in import:; the diagnosis tests for joint_swap",
            )
        )
    yield from odd
    if not odd:
        share = float(np.median(np.diag(found.explained)))
        yield Remark(
            "ok",
            "torque",
            "",
            f"unit, signs and order fit the nominal arm, which explains {share:.0%} of it with its own friction and "
            "scale (median over joints)",
        )
    yield from _limits(case)


def _unit(factor: float) -> Iterator[Remark]:
    if 1 / UNIT_FACTOR < factor < UNIT_FACTOR:
        return
    shown = f"{factor:.3g} times" if factor > 1 else f"1/{1 / factor:.3g} of"
    yield Remark(
        "warn",
        "torque",
        "",
        f"the recorded torque is {shown} the nominal arm's: it may be a motor current, a torque on the motor's side, "
        "or in another unit",
        "say in the case import: {tau: {column: ..., unit: A, motor_constant: [...], gear_ratio: [...]}}, or the unit",
    )


def _limits(case: Case) -> Iterator[Remark]:
    """Samples at the torque limit of the data sheet, or beyond."""
    limit = case.arm.torque_limit
    torque = [r.tau for r in case.recordings if r.tau is not None]
    if limit is None or not torque:
        return
    size = np.abs(np.vstack(torque))
    at_limit = (size > 0.99 * limit).mean(axis=0)
    if (at_limit > AT_LIMIT).any():
        joints = (np.flatnonzero(at_limit > AT_LIMIT) + 1).tolist()
        yield Remark(
            "warn",
            "torque",
            numbers(joints),
            f"at the torque limit in up to {at_limit.max():.0%} of the samples",
            "what is clipped says little of the arm: record a slower motion; if the drive allows more, correct "
            "nominal: {torque_limit: ...}",
        )
