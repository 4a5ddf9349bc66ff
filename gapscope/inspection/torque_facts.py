"""What the torque columns are by the log alone: silent, unsigned, computed; and which columns are the arm's joints."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from gapscope.arm.nominal import NominalArm
from gapscope.arm.robots import load_nominal_arm
from gapscope.inspection.channels import ChannelGuess
from gapscope.inspection.columns import ColumnGroup
from gapscope.inspection.words import LARGEST

# What a torque column can be, by the log alone: silent, unsigned, computed, or another column times a factor.


EXACT = 1e-3
"""Share of a column's deviation that rounding leaves if it is computed from others [1]; a measurement leaves more."""
SAMPLES = 20_000
"""Rows that are looked at, evenly taken."""


def torque_facts(torque: ChannelGuess, others: Sequence[ChannelGuess]) -> list[str]:
    """Sentences on one torque column, each with its figures; empty if nothing strikes.

    Args:
        torque: the columns in question.
        others: all channels of the same table.
    """
    values = _thinned(torque.group.values)
    if not _usable(values):
        return ["it holds cells that are no numbers, or beyond any torque"]
    others = [other for other in others if _usable(other.group.values)]
    silent = np.ptp(values, axis=0) == 0
    if silent.all():
        constant = float(values[0, 0])
        return [f"it is {constant:g} throughout: nothing was measured"]
    facts = []
    if silent.any():
        facts.append(f"it never changes on joint {_numbers(silent)}")
    if (values >= 0).all():
        facts.append("it is never negative: a magnitude, whose sign is lost")
    facts += _quantised(values[:, ~silent])
    facts += _multiples(torque, others)
    facts += _controllers(torque, others)
    return facts


def _quantised(values: np.ndarray) -> Iterator[str]:
    """A column of few different values."""
    counts = [len(np.unique(column)) for column in values.T]
    most = max(counts)
    if most <= min(200, len(values) // 20):
        steps = [
            np.diff(np.unique(column)).min()
            for column in values.T
            if len(np.unique(column)) > 1
        ]
        yield f"it has {most} different values at most, in steps of {min(steps):.3g}"


def _multiples(torque: ChannelGuess, others: Sequence[ChannelGuess]) -> Iterator[str]:
    """Columns that it is a multiple of, joint by joint."""
    values = _thinned(torque.group.values)
    for other in others:
        if other is torque or other.group.width != torque.group.width:
            continue
        source = _thinned(other.group.values)
        factors = _factors(values, source)
        if factors is None:
            continue
        if np.allclose(factors, 1.0, atol=1e-3):
            yield f"it equals {other.group.pattern}"
        else:
            listed = ", ".join(f"{factor:.4g}" for factor in factors)
            yield f"it is {other.group.pattern} times {listed}"


def _factors(values: np.ndarray, source: np.ndarray) -> np.ndarray | None:
    """Factor of each joint if all columns are multiples of the others', (k,), or ``None``."""
    power = (source**2).sum(axis=0)
    if (power == 0).any():
        return None
    factors = (values * source).sum(axis=0) / power
    left = np.sqrt(((values - factors * source) ** 2).mean(axis=0))
    exact = left <= EXACT * values.std(axis=0)
    return np.asarray(factors) if exact.all() else None


def _controllers(torque: ChannelGuess, others: Sequence[ChannelGuess]) -> Iterator[str]:
    """A column that is computed from reference and position by gains."""
    values = _thinned(torque.group.values)
    series = {
        other.channel: _thinned(other.group.values)
        for other in reversed(others)
        if _thinned(other.group.values).shape == values.shape
    }
    if "q" not in series or "q_ref" not in series:
        return
    error = series["q_ref"] - series["q"]
    rate = series.get("dq_ref", 0.0) - series.get("dq", np.zeros_like(error))
    gains, left = [], []
    for e, de, tau in zip(error.T, rate.T, values.T, strict=True):
        design = np.column_stack([e, de])
        gain = np.linalg.lstsq(design, tau, rcond=None)[0]
        left.append(np.std(tau - design @ gain) / max(tau.std(), 1e-12))
        gains.append(gain)
    if np.median(left) <= 10 * EXACT:
        kp, kd = (", ".join(f"{x:.4g}" for x in own) for own in np.transpose(gains))
        yield (
            f"it is computed, not measured: kp (q_ref - q) + kd (dq_ref - dq) with kp {kp} and kd {kd}. "
            "As a command that is what it should be; whether the arm obeyed these gains, the log does not say"
        )


def _usable(values: np.ndarray) -> bool:
    """Whether all values are numbers of a size that robots have in any unit."""
    return bool(np.isfinite(values).all() and np.abs(values).max() < LARGEST)


def _thinned(values: np.ndarray) -> np.ndarray:
    return values[:: max(1, len(values) // SAMPLES)]


def _numbers(mask: np.ndarray) -> str:
    return ", ".join(str(j + 1) for j in np.flatnonzero(mask))


# Which columns are the joints of the arm.


def arm_of_columns(arm: NominalArm, group: ColumnGroup) -> NominalArm:
    """The arm with those of its joints that a log has: by name, or the first if it has fewer and names none."""
    named = [joint for joint in arm.joints if joint in group.labels]
    kept = named or list(arm.joints[: group.width])
    if len(kept) == arm.n_joints:
        return arm
    return load_nominal_arm(arm.urdf, joints=kept, gravity=tuple(arm.gravity))


def columns_of_arm(group: ColumnGroup, joints: Sequence[str]) -> list[int] | None:
    """Places in a group, from 0, of the joints of the arm; ``None`` if it has fewer columns.

    By name if the columns carry the names of the joints, in their order otherwise.
    """
    if set(joints) <= set(group.labels):
        return [group.labels.index(joint) for joint in joints]
    return list(range(len(joints))) if group.width >= len(joints) else None
