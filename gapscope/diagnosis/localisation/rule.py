"""A rule that says when the gap of a joint is large, learnt on one half of the rows and tested on the other."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np

from gapscope.arm.display import significant
from gapscope.diagnosis.localisation.region import Region
from gapscope.diagnosis.localisation.rule_variables import RuleVariable, rule_variables
from gapscope.diagnosis.localisation.stacked_rows import MotionRows
from gapscope.diagnosis.localisation.tree import Cut, hottest_leaf
from gapscope.diagnosis.thresholds import (
    INTERVAL_RATIO,
    REGION_ENRICHMENT,
    REGION_SHARE,
    RULE_BLOCK,
    RULE_CAP_QUANTILE,
    RULE_CHANCE,
    RULE_CONDITION_GAIN,
    RULE_CONDITIONS,
    RULE_RATE,
)

MOST_BLOCKS = 100_003
"""More blocks of time than a segment has."""


def rule(
    error: np.ndarray, rows: MotionRows, load: np.ndarray, floor: float, joint: int
) -> Region | None:
    """The rule of one joint, or ``None`` if none holds on held-out rows.

    Args:
        error: gap of the joint [N m], (M,).
        rows: motion of the same rows.
        load: torque that the nominal arm predicts [N m], (M, n).
        floor: RMS that a healthy arm leaves on the joint [N m].
        joint: from 1.
    """
    variables = rule_variables(rows, load, joint - 1)
    values = np.column_stack([variable.values for variable in variables])
    step = max(1, int(min(rows.rates) // RULE_RATE))
    x, above = values[::step], _above_floor(error[::step], floor)
    learnt = _learning_rows(rows, step)
    if not above[learnt].any() or not above[~learnt].any():
        return None
    leaf = hottest_leaf(x[learnt], above[learnt], RULE_CONDITIONS)
    cuts = _worthwhile(tuple(_rounded(cut) for cut in leaf), x[~learnt], above[~learnt])
    # learnt on one half, tested on the other
    if not cuts or not _holds(cuts, variables, x[~learnt], above[~learnt]):
        return None
    inside = _inside(cuts, values)
    share = float((error[inside] ** 2).sum() / (error**2).sum())
    conditions = _conditions(cuts, variables)
    words = " and ".join(_words(condition) for condition in conditions)
    detail = {"conditions": conditions}
    return Region(joint, "rule", words, share, float(inside.mean()), detail)


def _above_floor(error: np.ndarray, floor: float) -> np.ndarray:
    """Squared gap above the floor's square [(N m)^2], (M,), with its spikes cut."""
    square = error**2
    capped = np.minimum(square, np.quantile(square, RULE_CAP_QUANTILE))
    return np.clip(capped - floor**2, 0.0, None)


def _learning_rows(rows: MotionRows, step: int) -> np.ndarray:
    """Mask of every ``step``-th row that a rule is learnt from: every other block of time; the rest tests it."""
    block_in_segment = (rows.t[::step] // RULE_BLOCK).astype(int)
    blocks = block_in_segment + MOST_BLOCKS * rows.segment[::step]
    number = np.unique(blocks, return_inverse=True)[1]
    return np.asarray(number % 2 == 0)


def _rounded(cut: Cut) -> Cut:
    """With two significant digits, as the report gives it."""
    return Cut(cut.index, float(f"{cut.threshold:.2g}"), cut.above)


def _inside(cuts: tuple[Cut, ...], x: np.ndarray) -> np.ndarray:
    """Mask of the rows x that meet all conditions, (M,)."""
    inside = np.ones(len(x), dtype=bool)
    for cut in cuts:
        inside &= cut.holds(x)
    return inside


def _share_and_coverage(inside: np.ndarray, y: np.ndarray) -> tuple[float, float]:
    """Share of y and share of the rows inside."""
    return float(y[inside].sum() / y.sum()), float(inside.mean())


def _worth(cuts: tuple[Cut, ...], x: np.ndarray, y: np.ndarray) -> float:
    """Share times log enrichment of a rule: large if little of the time holds much of the gap."""
    share, coverage = _share_and_coverage(_inside(cuts, x), y)
    return share * float(np.log(max(share, 1e-9) / max(coverage, 1e-3)))


def _worthwhile(cuts: tuple[Cut, ...], x: np.ndarray, y: np.ndarray) -> tuple[Cut, ...]:
    """The fewest of the conditions that do nearly as well as any others on held-out rows."""
    best: tuple[Cut, ...] = ()
    for count in range(len(cuts) + 1):
        for subset in itertools.combinations(cuts, count):
            # each further condition must be worth it
            needed_gain = RULE_CONDITION_GAIN ** (count - len(best))
            if _worth(subset, x, y) > max(needed_gain * _worth(best, x, y), 0.0):
                best = subset
    return best


def _holds(
    cuts: tuple[Cut, ...],
    variables: list[RuleVariable],
    x: np.ndarray,
    y: np.ndarray,
) -> bool:
    """Whether a rule holds on held-out rows."""
    inside = _inside(cuts, x)
    if not inside.any() or inside.all():
        return False
    share, coverage = _share_and_coverage(inside, y)
    if share < REGION_SHARE or share / coverage < REGION_ENRICHMENT:
        return False
    # Most gaps vary over time: a rule that names a time needs a sharp contrast to what lies outside.
    if any(variables[cut.index].name == "time" for cut in cuts):
        return bool(y[inside].mean() > INTERVAL_RATIO * y[~inside].mean())
    return share > _by_chance(inside, y)


def _by_chance(inside: np.ndarray, y: np.ndarray) -> float:
    """Share that a rule would reach with ``RULE_CHANCE`` if the gap were elsewhere in time: over all circular shifts.

    A shift keeps gap and motion as they are in themselves, and breaks the relation between them.
    """
    near = int(RULE_BLOCK * RULE_RATE)
    if len(y) <= 4 * near:
        return 1.0
    # correlation theorem: sum of y over the mask, for every circular shift of y at once
    mask_spectrum = np.fft.rfft(inside.astype(float))
    overlap = np.fft.irfft(mask_spectrum * np.conj(np.fft.rfft(y)), len(y))
    shares = overlap / y.sum()
    return float(np.quantile(shares[near : len(y) - near], 1 - RULE_CHANCE))


def _conditions(
    cuts: tuple[Cut, ...], variables: list[RuleVariable]
) -> list[dict[str, Any]]:
    """Conditions as numbers, those on one quantity together; ``above`` and ``below`` are ``None`` if open."""
    out: dict[int, dict[str, Any]] = {}
    for cut in cuts:
        variable = variables[cut.index]
        new = {
            "quantity": variable.name,
            "symbol": variable.symbol,
            "unit": variable.unit,
            "above": None,
            "below": None,
        }
        entry = out.setdefault(cut.index, new)
        side, tighter = ("above", max) if cut.above else ("below", min)
        known = entry[side]
        entry[side] = cut.threshold if known is None else tighter(known, cut.threshold)
    return list(out.values())


def _words(condition: dict[str, Any]) -> str:
    """One condition in words."""
    low, high, symbol = condition["above"], condition["below"], condition["symbol"]
    unit = f" {condition['unit']}".rstrip()
    if condition["quantity"] == "direction":
        if low is not None and high is not None:
            return "nearly at rest"
        if low is not None:
            return "moving forward" if low >= 0 else "not moving backward"
        return "moving backward" if high < 0 else "not moving forward"
    if low is None:
        return f"{symbol} < {significant(high, 2)}{unit}"
    if high is None:
        return f"{symbol} > {significant(low, 2)}{unit}"
    return f"{significant(low, 2)} < {symbol} < {significant(high, 2)}{unit}"
