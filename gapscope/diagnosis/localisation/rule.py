"""A rule that says when the gap of a joint is large, learnt on one half of the rows and tested on the other."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np

from gapscope.diagnosis.display import significant
from gapscope.diagnosis.localisation.region import Region
from gapscope.diagnosis.localisation.rule_variables import Quantity, quantities
from gapscope.diagnosis.localisation.stacked_rows import Rows
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


def rule(
    error: np.ndarray, rows: Rows, load: np.ndarray, floor: float, joint: int
) -> Region | None:
    """The rule of one joint, or ``None`` if none holds on held-out rows.

    Args:
        error: gap of the joint [N m], (M,).
        rows: motion of the same rows.
        load: torque that the nominal arm predicts [N m], (M, n).
        floor: RMS that a healthy arm leaves on the joint [N m].
        joint: from 1.
    """
    known = quantities(rows, load, joint - 1)
    step = max(1, int(min(rows.rates) // RULE_RATE))
    x = np.column_stack([q.values for q in known])[::step]
    square = error[::step] ** 2
    above = np.clip(
        np.minimum(square, np.quantile(square, RULE_CAP_QUANTILE)) - floor**2, 0.0, None
    )
    blocks = (rows.t[::step] // RULE_BLOCK).astype(int) + 100_003 * rows.segment[::step]
    seen = np.unique(blocks, return_inverse=True)[1] % 2 == 0
    if not above[seen].any() or not above[~seen].any():
        return None
    cuts = tuple(
        _rounded(cut) for cut in hottest_leaf(x[seen], above[seen], RULE_CONDITIONS)
    )
    cuts = _worthwhile(cuts, x[~seen], above[~seen])
    if not cuts or not _holds(cuts, known, x[~seen], above[~seen]):
        return None
    inside = _inside(cuts, np.column_stack([q.values for q in known]))
    share = float((error[inside] ** 2).sum() / (error**2).sum())
    conditions = _conditions(cuts, known)
    words = " and ".join(_words(condition) for condition in conditions)
    return Region(
        joint, "rule", words, share, float(inside.mean()), {"conditions": conditions}
    )


def _rounded(cut: Cut) -> Cut:
    """With two significant digits, as it is told."""
    return Cut(cut.index, float(f"{cut.threshold:.2g}"), cut.above)


def _inside(cuts: tuple[Cut, ...], x: np.ndarray) -> np.ndarray:
    return np.logical_and.reduce(
        [np.ones(len(x), dtype=bool), *(cut.holds(x) for cut in cuts)]
    )


def _worth(cuts: tuple[Cut, ...], x: np.ndarray, y: np.ndarray) -> float:
    """Share times log enrichment of a rule: large if little of the time holds much of the gap."""
    inside = _inside(cuts, x)
    share, coverage = float(y[inside].sum() / y.sum()), float(inside.mean())
    return share * float(np.log(max(share, 1e-9) / max(coverage, 1e-3)))


def _worthwhile(cuts: tuple[Cut, ...], x: np.ndarray, y: np.ndarray) -> tuple[Cut, ...]:
    """The fewest of the conditions that do nearly as well as any others on held-out rows."""
    subsets = [s for k in range(len(cuts) + 1) for s in itertools.combinations(cuts, k)]
    best: tuple[Cut, ...] = ()
    for subset in subsets:
        if _worth(subset, x, y) > max(
            RULE_CONDITION_GAIN ** (len(subset) - len(best)) * _worth(best, x, y), 0.0
        ):
            best = subset
    return best


def _holds(
    cuts: tuple[Cut, ...], known: list[Quantity], x: np.ndarray, y: np.ndarray
) -> bool:
    """Whether a rule holds on held-out rows."""
    inside = _inside(cuts, x)
    if not inside.any() or inside.all():
        return False
    share, coverage = float(y[inside].sum() / y.sum()), float(inside.mean())
    if share < REGION_SHARE or share / coverage < REGION_ENRICHMENT:
        return False
    if any(known[cut.index].name == "time" for cut in cuts):
        return bool(y[inside].mean() > INTERVAL_RATIO * y[~inside].mean())
    return share > _by_chance(inside, y)


def _by_chance(inside: np.ndarray, y: np.ndarray) -> float:
    """Share that a rule would reach with ``RULE_CHANCE`` if the gap were elsewhere in time: over all circular shifts.

    A shift keeps how gap and motion hang together in themselves, and breaks what they have to do with each other.
    """
    shifted = (
        np.fft.irfft(
            np.fft.rfft(inside.astype(float)) * np.conj(np.fft.rfft(y)), len(y)
        )
        / y.sum()
    )
    near = int(RULE_BLOCK * RULE_RATE)
    return (
        float(np.quantile(shifted[near : len(y) - near], 1 - RULE_CHANCE))
        if len(y) > 4 * near
        else 1.0
    )


def _conditions(cuts: tuple[Cut, ...], known: list[Quantity]) -> list[dict[str, Any]]:
    """Conditions as numbers, those on one quantity together; ``above`` and ``below`` are ``None`` if open."""
    out: dict[int, dict[str, Any]] = {}
    for cut in cuts:
        quantity = known[cut.index]
        empty = {
            "quantity": quantity.name,
            "symbol": quantity.symbol,
            "unit": quantity.unit,
        }
        entry = out.setdefault(cut.index, {**empty, "above": None, "below": None})
        side, pick = ("above", max) if cut.above else ("below", min)
        entry[side] = (
            cut.threshold if entry[side] is None else pick(entry[side], cut.threshold)
        )
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
