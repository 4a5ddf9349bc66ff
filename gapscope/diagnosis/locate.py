"""Where a gap lies: joints, regimes of motion, times and frequencies, and one rule in words."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from scipy.signal import csd, welch

from gapscope.arm.display import significant
from gapscope.diagnosis.thresholds import (
    BAND_COHERENCE,
    BAND_POWER,
    BANDS,
    CHANGE_POINT_PENALTY,
    EQUAL_COHERENCE,
    INTERVAL_RATIO,
    JOINTS_IN_DEPTH,
    LEAF_ROWS,
    LEVEL_WINDOW,
    LINE_ENRICHMENT,
    LINE_LOWEST,
    LINE_SHARE,
    LINE_WIDTH,
    MAX_CHANGE_POINTS,
    MAX_INTERVALS,
    MIN_BAND_POWER,
    MIN_INTERVAL_WINDOWS,
    MIN_LEVEL_NOISE,
    REGION_ENRICHMENT,
    REGION_SHARE,
    REGIONS_PER_JOINT,
    RULE_BLOCK,
    RULE_CAP_QUANTILE,
    RULE_CHANCE,
    RULE_CONDITION_GAIN,
    RULE_CONDITIONS,
    RULE_RATE,
    STILL_QUANTILE,
)
from gapscope.model.conditioning import TORQUE_CUTOFF, Segment

# A region of the motion that holds more of a gap than its size explains.


@dataclass(frozen=True)
class Region:
    """A region that holds more of a joint's gap than its size explains.

    Attributes:
        joint: joint from 1.
        kind: ``regime``, ``position``, ``time`` or ``frequency``: a part cut in advance; ``rule``, ``interval``,
            ``line`` or ``coherence``: learnt from the gap.
        regime: what the region is, in words.
        share: its share of the joint's squared gap, 0..1.
        coverage: its share of the samples; of a frequency band, its share of the power of the nominal torque, 0..1.
        detail: the same as numbers, further keys of the document.
    """

    joint: int
    kind: str
    regime: str
    share: float
    coverage: float
    detail: Mapping[str, Any] = field(default_factory=dict)

    @property
    def enrichment(self) -> float:
        """Share over coverage."""
        return self.share / max(self.coverage, 1e-3)


# Segments stacked as rows: the quantities against which a gap is looked at.


@dataclass(frozen=True)
class MotionRows:
    """Trimmed samples of several segments, stacked, M rows of n joints.

    Attributes:
        t: time since the start of its recording [s], (M,).
        q, dq, ddq: motion [rad], [rad/s], [rad/s^2], (M, n).
        segment: index of the segment of each row, (M,).
        rates: sampling rate of each segment [Hz].
        names: recording that each segment is a part of; empty if that is not known.
        starts: time at which each segment begins in its recording [s]; empty if all begin at 0.
    """

    t: np.ndarray
    q: np.ndarray
    dq: np.ndarray
    ddq: np.ndarray
    segment: np.ndarray
    rates: tuple[float, ...]
    names: tuple[str, ...] = field(default=())
    starts: tuple[float, ...] = field(default=())

    @property
    def clock(self) -> np.ndarray:
        """Time of the recordings' own clocks [s], (M,): a recording may have been cut into several segments."""
        return self.t + np.array(self.starts)[self.segment] if self.starts else self.t

    def recording(self, segment: int) -> str:
        """What the recording of a segment is called."""
        return self.names[segment] if self.names else f"recording {segment + 1}"


def stack(segments: list[Segment]) -> MotionRows:
    """Stack the trimmed samples of segments, in the order in which ``torque_gap`` stacks them."""
    parts = [(s.motion, s.inner) for s in segments]
    lengths = [len(m.t[i]) for m, i in parts]
    return MotionRows(
        t=np.concatenate([m.t[i] - m.t[0] for m, i in parts]),
        q=np.vstack([m.q[i] for m, i in parts]),
        dq=np.vstack([m.dq[i] for m, i in parts]),
        ddq=np.vstack([m.ddq[i] for m, i in parts]),
        segment=np.repeat(np.arange(len(parts)), lengths),
        rates=tuple(m.rate for m, _ in parts),
        names=tuple(s.recording for s in segments),
        starts=tuple(float(m.t[0]) for m, _ in parts),
    )


# The quantities that a rule may speak of.


@dataclass(frozen=True)
class RuleVariable:
    """One quantity at every row.

    Attributes:
        name: in the document: ``speed``, ``direction``, ``load``, ``acceleration``, ``position`` or ``time``.
        symbol, unit: in words.
        values: shape (M,).
    """

    name: str
    symbol: str
    unit: str
    values: np.ndarray


def rule_variables(rows: MotionRows, load: np.ndarray, j: int) -> list[RuleVariable]:
    """Of joint j (from 0): speed, direction (-1, 0, 1), |nominal torque|, |acceleration|, position, time; each (M,)."""
    velocity = rows.dq[:, j]
    speed = np.abs(velocity)
    moves = speed > np.quantile(speed, STILL_QUANTILE)
    direction = np.where(moves, np.sign(velocity), 0.0)
    return [
        RuleVariable("speed", "|dq|", "rad/s", speed),
        RuleVariable("direction", "direction", "", direction),
        RuleVariable("load", "|load|", "N m", np.abs(load[:, j])),
        RuleVariable("acceleration", "|ddq|", "rad/s²", np.abs(rows.ddq[:, j])),
        RuleVariable("position", "q", "rad", rows.q[:, j]),
        RuleVariable("time", "t", "s", rows.clock),
    ]


# A shallow regression tree over a few quantities [breiman1984].


SPLITS = 48
"""Thresholds that are tried per quantity, at equal shares of the rows."""


@dataclass(frozen=True)
class Cut:
    """One condition: the quantity with this index lies above ``threshold``, or else not."""

    index: int
    threshold: float
    above: bool

    def holds(self, x: np.ndarray) -> np.ndarray:
        """Mask over rows x of shape (M, K); shape (M,)."""
        higher = x[:, self.index] > self.threshold
        return higher if self.above else ~higher


def hottest_leaf(x: np.ndarray, y: np.ndarray, depth: int) -> tuple[Cut, ...]:
    """The cuts that lead to the leaf with the largest mean of y; empty if no cut is worth anything.

    At each node the cut with the largest fall of the sum of squares n1 n2 / n (mean1 - mean2)^2 is made, and the hotter
    side is followed: a tree of which one branch is grown.

    Args:
        x: quantities, shape (M, K).
        y: what is predicted, shape (M,).
        depth: most cuts.
    """
    cuts: list[Cut] = []
    inside = np.ones(len(y), dtype=bool)
    least = max(4, int(LEAF_ROWS * len(y)))
    for _ in range(depth):
        cut = _best_cut(x[inside], y[inside], least)
        if cut is None:
            break
        cuts.append(cut)
        inside &= cut.holds(x)
    return tuple(cuts)


def _best_cut(x: np.ndarray, y: np.ndarray, least: int) -> Cut | None:
    """The cut with the largest fall of the sum of squares; ``None`` if no cut leaves ``least`` rows on both sides."""
    if len(y) <= 2 * least:
        return None
    counts = np.unique(np.linspace(least, len(y) - least, SPLITS).astype(int))
    largest_fall, best = 0.0, None
    for index, values in enumerate(x.T):
        order = np.argsort(values, kind="stable")
        ordered, total = values[order], np.cumsum(y[order])
        for below in counts:
            low_value, high_value = ordered[below - 1], ordered[below]
            if low_value == high_value:
                continue  # no threshold lies between equal values
            above = len(y) - below
            low_mean = total[below - 1] / below
            high_mean = (total[-1] - total[below - 1]) / above
            fall = below * above / len(y) * (high_mean - low_mean) ** 2
            if fall > largest_fall:
                threshold = float(0.5 * (low_value + high_value))
                largest_fall = fall
                best = Cut(index, threshold, bool(high_mean > low_mean))
    return best


# A rule that says when the gap of a joint is large, learnt on one half of the rows and tested on the other.


MAX_BLOCKS = 100_003
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
    words = " and ".join(_rule_words(condition) for condition in conditions)
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
    blocks = block_in_segment + MAX_BLOCKS * rows.segment[::step]
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


def _rule_words(condition: dict[str, Any]) -> str:
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


# How a gap follows the joint's own signals: coherence, and gain and phase of the transfer function [bendat2010].


STRETCH = 2.0
"""Length of the stretches over which spectra are averaged [s]."""
STEP = 0.25
"""Grid of frequencies on which recordings of different length are averaged [Hz]."""
CHANCE = 0.01
"""Probability with which signals without relation reach the coherence of ``Spectra.chance`` [1]."""
MIN_SIZE = 16
"""Segments with fewer samples have no spectrum."""
TINY = 1e-300
"""Keeps a quotient of powers finite."""


@dataclass(frozen=True)
class Drive:
    """A signal that a gap may follow: name and unit of gap over signal."""

    name: str
    unit: str


DRIVES = (
    Drive("torque", "N m per N m"),
    Drive("velocity", "N m s/rad"),
    Drive("acceleration", "N m s²/rad"),
)
"""The joint's own nominal torque, velocity and acceleration."""


@dataclass(frozen=True)
class Spectra:
    """Spectra of one joint's gap e and of K signals x, averaged over stretches of all recordings; F frequencies.

    Attributes:
        frequency: [Hz], (F,).
        gap: power density S_ee [(N m)^2/Hz], (F,).
        signals: S_xx, in the squared unit of the signal per Hz, (K, F).
        cross: S_xe, complex, (K, F).
        averages: number of stretches that count, half of overlapping ones being new [1].
    """

    frequency: np.ndarray
    gap: np.ndarray
    signals: np.ndarray
    cross: np.ndarray
    averages: float

    @property
    def coherence(self) -> np.ndarray:
        """gamma^2 = |S_xe|^2 / (S_xx S_ee), the share of the gap's power that follows each signal, (K, F)."""
        return np.abs(self.cross) ** 2 / np.maximum(self.signals * self.gap, TINY)

    def chance(self, lines: int) -> float:
        """Coherence that signals without relation exceed with probability ``CHANCE``, over a band of so many lines.

        Of N independent averages the coherence exceeds c with probability (1 - c)^(N - 1) [bendat2010].
        """
        independent_lines = max(lines * STEP * STRETCH / 1.5, 1.0)
        freedom = max(self.averages * independent_lines - 1, 1.0)
        return float(1 - CHANCE ** (1 / freedom))

    def band(self, mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Coherence, (K,), and transfer function S_xe / S_xx, complex, (K,), over a band of frequencies."""
        cross = self.cross[:, mask].sum(axis=1)
        signals = self.signals[:, mask].sum(axis=1)
        gap = self.gap[mask].sum()
        coherence = np.abs(cross) ** 2 / np.maximum(signals * gap, TINY)
        return coherence, cross / np.maximum(signals, TINY)


def spectra(
    error: np.ndarray, rows: MotionRows, load: np.ndarray, joint: int
) -> Spectra:
    """Spectra of one joint's gap [N m], (M,), and of ``DRIVES``; load is the nominal torque [N m], (M, n)."""
    j = joint - 1
    signals = (load[:, j], rows.dq[:, j], rows.ddq[:, j])
    frequency = np.arange(0.0, TORQUE_CUTOFF + STEP / 2, STEP)
    gap = np.zeros(len(frequency))
    own = np.zeros((len(signals), len(frequency)))
    cross = np.zeros(own.shape, dtype=complex)
    averages, total = 0.0, 0
    for segment, rate in enumerate(rows.rates):
        inside = rows.segment == segment
        count = int(inside.sum())
        size = min(count, int(STRETCH * rate))
        if size < MIN_SIZE:
            continue
        # a segment weighs as many samples as it has
        grid, power = welch(error[inside], rate, nperseg=size)
        gap += count * np.interp(frequency, grid, power)
        for k, signal in enumerate(signals):
            _, power = welch(signal[inside], rate, nperseg=size)
            own[k] += count * np.interp(frequency, grid, power)
            _, density = csd(signal[inside], error[inside], rate, nperseg=size)
            cross[k] += count * np.interp(frequency, grid, density)
        averages += count / size
        total += count
    total = max(total, 1)
    return Spectra(frequency, gap / total, own / total, cross / total, averages)


# Where a gap lies in frequency: lines of its own, and bands in which it follows the joint's own signals.


def line(found: Spectra, joint: int) -> Region | None:
    """A narrow line in the spectrum of the gap that the torque does not have."""
    frequency, gap, torque = found.frequency, found.gap, found.signals[0]
    candidates = frequency >= LINE_LOWEST
    if gap.sum() <= 0 or not candidates.any():
        return None
    peak = float(frequency[candidates][int(gap[candidates].argmax())])
    near = np.abs(frequency - peak) <= LINE_WIDTH
    share = float(gap[near].sum() / gap.sum())
    coverage = _power_share(torque, near)
    # White noise would hold near.mean() of its power there.
    least = max(LINE_SHARE, LINE_ENRICHMENT * coverage, 2 * float(near.mean()))
    if share < least:
        return None
    centre = float((frequency[near] * gap[near]).sum() / gap[near].sum())
    words = f"line at {significant(centre, 2)} Hz"
    detail = {"frequency": centre}
    return Region(joint, "line", words, min(share, 1.0), min(coverage, 1.0), detail)


def _power_share(power: np.ndarray, mask: np.ndarray) -> float:
    """Share of a power density in some of its frequencies, at least ``MIN_BAND_POWER``."""
    share = float(power[mask].sum() / max(power.sum(), 1e-300))
    return max(share, MIN_BAND_POWER)


def coherent(found: Spectra, joint: int) -> list[Region]:
    """Bands in which the gap follows the joint's own torque, velocity or acceleration; the largest share first."""
    whole = max(found.gap.sum(), 1e-300)
    out = []
    for low, high in BANDS:
        mask = (found.frequency >= low) & (found.frequency < high)
        share = float(found.gap[mask].sum() / whole)
        if share < BAND_POWER:
            continue
        coherence, transfer = found.band(mask)
        best = _plainest(coherence, transfer)
        if coherence[best] < max(BAND_COHERENCE, found.chance(int(mask.sum()))):
            continue
        gain, phase = float(np.abs(transfer[best])), float(np.angle(transfer[best]))
        drive = DRIVES[best]
        words = (
            f"{low:g} to {high:g} Hz, follows the joint's {drive.name} {_phase(phase)}: {significant(gain, 2)} "
            f"{drive.unit}, coherence {coherence[best]:.2f}"
        )
        detail = {
            "band": [low, high],
            "signal": drive.name,
            "coherence": float(coherence[best]),
            "gain": gain,
            "unit": drive.unit,
            "phase": phase,
        }
        coverage = min(_power_share(found.signals[0], mask), 1.0)
        out.append(Region(joint, "coherence", words, share, coverage, detail))
    return sorted(out, key=lambda region: -region.share)


def _plainest(coherence: np.ndarray, transfer: np.ndarray) -> int:
    """Of the signals that the gap follows about as well as any, the one that it is most in step with.

    In a narrow band velocity and acceleration are the same but for a quarter of a period.
    """
    as_good = coherence > coherence.max() - EQUAL_COHERENCE
    in_step = np.abs(np.cos(np.angle(transfer)))
    return int(np.where(as_good, in_step, -1.0).argmax())


def _phase(phase: float) -> str:
    """A phase [rad] in words; positive if the gap is ahead."""
    if abs(phase) < np.pi / 6:
        return "in step"
    if abs(phase) > 5 * np.pi / 6:
        return "with the sign reversed"
    degrees = f"{abs(np.rad2deg(phase)):.0f}°"
    return f"{degrees} {'ahead' if phase > 0 else 'behind'}"


# When a gap starts and stops: change points of its level over time, by penalised least squares [killick2012].


@dataclass(frozen=True)
class GapLevels:
    """Level of a gap over one recording: W windows in S stretches between change points.

    Attributes:
        recording: name, or its number in words.
        t: middle of the windows [s], (W,).
        rms: RMS of the gap in each [N m], (W,).
        edges: windows at which the stretches begin, and the end, (S + 1,).
    """

    recording: str
    t: np.ndarray
    rms: np.ndarray
    edges: tuple[int, ...]

    @property
    def steps(self) -> np.ndarray:
        """RMS over the stretch that each window belongs to [N m], (W,)."""
        stretches = [slice(a, b) for a, b in itertools.pairwise(self.edges)]
        means = [np.sqrt(np.mean(self.rms[stretch] ** 2)) for stretch in stretches]
        return np.repeat(means, np.diff(self.edges))


def levels(error: np.ndarray, rows: MotionRows, floor: float) -> list[GapLevels]:
    """Level of one joint's gap [N m], (M,), over each recording; ``floor`` is what a healthy arm leaves [N m]."""
    names = [rows.recording(segment) for segment in range(len(rows.rates))]
    out = []
    for name in dict.fromkeys(names):
        segments = [segment for segment, other in enumerate(names) if other == name]
        inside = np.isin(rows.segment, segments)
        if inside.any():
            out.append(
                _recording_levels(name, rows.clock[inside], error[inside], floor)
            )
    return out


def _recording_levels(
    name: str, t: np.ndarray, error: np.ndarray, floor: float
) -> GapLevels:
    """Level of a gap [N m], (M,), at times t [s], (M,), of one recording."""
    square = error**2
    window = ((t - t[0]) // LEVEL_WINDOW).astype(int)
    count = np.bincount(window)
    # windows cut short by a gap in the recording are left out
    used = count >= 0.5 * np.median(count[count > 0])
    mean = np.bincount(window, square)[used] / count[used]
    middle = t[0] + LEVEL_WINDOW * (np.flatnonzero(used) + 0.5)
    level = np.log(mean + floor**2 + 1e-12 * square.max() + 1e-300)
    return GapLevels(name, middle, np.sqrt(mean), change_points(level))


def change_points(series: np.ndarray) -> tuple[int, ...]:
    """Windows at which the mean of a series (W,) changes: 0, the change points, W.

    Least sum over the stretches of squared deviations from their mean, plus ``CHANGE_POINT_PENALTY`` var log W for each
    stretch, by dynamic programming with the pruning of [killick2012]; var from the differences of neighbours.
    """
    n = len(series)
    if n < 2 * MIN_INTERVAL_WINDOWS:
        return (0, n)
    charge = CHANGE_POINT_PENALTY * _noise_of(series) ** 2 * np.log(n)
    sums = np.concatenate([[0.0], np.cumsum(series)])
    squares = np.concatenate([[0.0], np.cumsum(series**2)])
    # cost[end]: least cost of the windows before end; last[end]: where its last stretch begins
    cost, last = np.full(n + 1, np.inf), np.zeros(n + 1, dtype=int)
    cost[0] = -charge
    starts = np.array([0])
    for end in range(MIN_INTERVAL_WINDOWS, n + 1):
        length = end - starts
        sum_of_stretch = sums[end] - sums[starts]
        deviation = squares[end] - squares[starts] - sum_of_stretch**2 / length
        too_short = length < MIN_INTERVAL_WINDOWS
        reached = np.where(too_short, np.inf, cost[starts] + deviation)
        cost[end] = reached.min() + charge
        last[end] = starts[int(reached.argmin())]
        # a start that costs more already without the charge of a new stretch stays worse
        keep = too_short | (reached <= cost[end])
        starts = np.append(starts[keep], end - MIN_INTERVAL_WINDOWS + 1)
    edges = [n]
    while edges[-1] > 0:
        edges.append(int(last[edges[-1]]))
    return tuple(edges[::-1])


def _noise_of(series: np.ndarray) -> float:
    """Standard deviation of a series' noise, from the median step between neighbours (a normal one's is 0.6745)."""
    step = float(np.median(np.abs(np.diff(series))))
    return max(step / (0.6745 * np.sqrt(2)), MIN_LEVEL_NOISE)


class _Stretch(NamedTuple):
    """A stretch between change points: windows ``begin`` to ``end`` of a level, ``place`` among those of all levels."""

    level: GapLevels
    begin: int
    end: int
    place: slice


def intervals(found: list[GapLevels], joint: int) -> list[Region]:
    """The stretches in which a joint's gap is far above that in the rest of all recordings; the largest first.

    The hottest stretch is tried, then the hottest two: a contact may come twice.
    """
    if not found:
        return []
    square = np.concatenate([level.rms for level in found]) ** 2
    hottest = sorted(
        _stretches(found), key=lambda stretch: -square[stretch.place].mean()
    )
    for count in range(1, min(MAX_INTERVALS, len(hottest)) + 1):
        chosen = hottest[:count]
        if _stand_out(chosen, square):
            regions = [_interval_region(stretch, square, joint) for stretch in chosen]
            return sorted(regions, key=lambda region: -region.share)
    return []


def _stretches(found: list[GapLevels]) -> list[_Stretch]:
    """Stretches of the levels that have few change points; with many, the gap follows the motion and not the time."""
    stretches, first = [], 0
    for level in found:
        if len(level.edges) - 2 <= MAX_CHANGE_POINTS:
            for begin, end in itertools.pairwise(level.edges):
                place = slice(first + begin, first + end)
                stretches.append(_Stretch(level, begin, end, place))
        first += len(level.rms)
    return stretches


def _stand_out(chosen: list[_Stretch], square: np.ndarray) -> bool:
    """Whether stretches hold much of the squared level, (W,), and each is far above what lies outside of them all."""
    outside = np.ones(len(square), dtype=bool)
    for stretch in chosen:
        outside[stretch.place] = False
    if not outside.any():
        return False
    share = float(square[~outside].sum() / max(square.sum(), 1e-300))
    coverage = float((~outside).mean())
    if share < max(REGION_SHARE, REGION_ENRICHMENT * coverage):
        return False
    return all(_is_far_above(square[s.place], square[outside]) for s in chosen)


def _is_far_above(inside: np.ndarray, outside: np.ndarray) -> bool:
    """Whether the squared level in an interval is far above that of any stretch outside of the same length."""
    length = min(len(inside), len(outside))
    elsewhere = np.convolve(outside, np.full(length, 1.0 / length), mode="valid").max()
    return bool(inside.mean() > INTERVAL_RATIO * elsewhere)


def _interval_region(stretch: _Stretch, square: np.ndarray, joint: int) -> Region:
    level = stretch.level
    share = float(square[stretch.place].sum() / square.sum())
    coverage = (stretch.end - stretch.begin) / len(square)
    start = end = None
    if stretch.begin > 0:
        start = float(level.t[stretch.begin] - LEVEL_WINDOW / 2)
    if stretch.end < len(level.t):
        end = float(level.t[stretch.end - 1] + LEVEL_WINDOW / 2)
    detail = {"recording": level.recording, "start": start, "end": end}
    words = _interval_words(level.recording, start, end)
    return Region(joint, "interval", words, share, coverage, detail)


def _interval_words(recording: str, start: float | None, end: float | None) -> str:
    if start is None and end is None:
        return f"all of {recording}"
    if start is None:
        return f"{recording}, until it stops at {end:.1f} s"
    if end is None:
        return f"{recording}, from {start:.1f} s, where it starts, to the end"
    return f"{recording}, starts at {start:.1f} s and stops at {end:.1f} s"


# Localisation in depth of the gap of some joints.


BINS = 24
"""Bins of the quantity of a rule in ``JointLocalisation.profile``."""


@dataclass(frozen=True)
class Profile:
    """RMS of a gap over bins of one quantity.

    Attributes:
        symbol, unit: of the quantity.
        x: middle of the bins, (B,).
        rms: RMS of the gap in each [N m], (B,).
        above, below: the rule's bounds on the quantity; ``None`` if open.
        words: the whole rule.
    """

    symbol: str
    unit: str
    x: np.ndarray
    rms: np.ndarray
    above: float | None
    below: float | None
    words: str


@dataclass(frozen=True)
class JointLocalisation:
    """Where the gap of one joint lies.

    Attributes:
        joint: from 1.
        floor: RMS that a healthy arm leaves [N m].
        regions: in which the gap lies.
        profile: of the rule's first quantity with a scale; ``None`` if there is no rule.
        levels: level over time, one per recording.
        spectra: of the gap and of the joint's own signals.
    """

    joint: int
    floor: float
    regions: tuple[Region, ...]
    profile: Profile | None
    levels: tuple[GapLevels, ...]
    spectra: Spectra


def locate(
    error: np.ndarray,
    rows: MotionRows,
    load: np.ndarray,
    floor: np.ndarray,
    joints: list[int],
) -> list[JointLocalisation]:
    """Rules, intervals, lines and bands of the gap of some joints.

    Args:
        error: gap [N m], (M, n).
        rows: motion of the same rows.
        load: torque that the nominal arm predicts [N m], (M, n).
        floor: RMS that a healthy arm leaves [N m], (n,).
        joints: from 1; a joint whose gap is zero is left out.
    """
    return [
        _localised(error[:, j - 1], rows, load, float(floor[j - 1]), j)
        for j in joints
        if error[:, j - 1].any()
    ]


def _localised(
    error: np.ndarray, rows: MotionRows, load: np.ndarray, floor: float, joint: int
) -> JointLocalisation:
    """Where the gap of one joint (M,) lies."""
    over_time = levels(error, rows, floor)
    bursts = intervals(over_time, joint)[:REGIONS_PER_JOINT]
    own_rule = rule(error, rows, load, floor, joint)
    # Intervals say more than a rule over time: they know which recording.
    if own_rule is not None and bursts and _is_over_time(own_rule):
        own_rule = None
    in_frequency = spectra(error, rows, load, joint)
    bands = coherent(in_frequency, joint)[:REGIONS_PER_JOINT]
    found = [own_rule, *bursts, line(in_frequency, joint), *bands]
    return JointLocalisation(
        joint,
        floor,
        tuple(region for region in found if region is not None),
        _profile(own_rule, error, rows, load, joint),
        tuple(over_time),
        in_frequency,
    )


def _is_over_time(region: Region) -> bool:
    """Whether a rule has a condition on time."""
    conditions = region.detail["conditions"]
    return any(condition["quantity"] == "time" for condition in conditions)


def _profile(
    own_rule: Region | None,
    error: np.ndarray,
    rows: MotionRows,
    load: np.ndarray,
    joint: int,
) -> Profile | None:
    """RMS over bins of equal width between the outer percentiles of the rule's first quantity with a scale."""
    if own_rule is None:
        return None
    conditions = [c for c in own_rule.detail["conditions"] if c["unit"]]
    if not conditions:
        return None
    first = conditions[0]
    variables = {v.name: v.values for v in rule_variables(rows, load, joint - 1)}
    values = variables[first["quantity"]]
    low, high = np.percentile(values, [0.5, 99.5])
    edges = np.linspace(low, high, BINS + 1)
    index = np.clip(np.digitize(values, edges) - 1, 0, BINS - 1)
    count = np.bincount(index, minlength=BINS)
    square = np.bincount(index, error**2, minlength=BINS)
    used = count > 0
    middle = (edges[:-1] + edges[1:]) / 2
    return Profile(
        first["symbol"],
        first["unit"],
        middle[used],
        np.sqrt(square[used] / count[used]),
        first["above"],
        first["below"],
        own_rule.regime,
    )


# Where a gap lies: by regime of motion, by position, in time and by frequency, cut in advance.
#
# ``gapscope.diagnosis.localisation`` learns from the gap itself what such cuts are too coarse for.


def located(
    error: np.ndarray,
    rows: MotionRows,
    load: np.ndarray,
    floor: np.ndarray,
    joints: list[int],
) -> list[Region]:
    """All regions in which the gap of some joints lies, joint by joint in the order given.

    Args:
        error: gap [N m], (M, n).
        rows: motion of the same rows.
        load: torque that the nominal arm predicts [N m], (M, n).
        floor: RMS that a healthy arm leaves [N m], (n,).
        joints: from 1, the worst first; only the first ``JOINTS_IN_DEPTH`` are looked at in depth.
    """
    found = locate(error, rows, load, floor, joints[:JOINTS_IN_DEPTH])
    in_depth = {place.joint: place.regions for place in found}
    out = []
    for joint in joints:
        out += regions(error, rows, load, [joint])
        out += in_depth.get(joint, ())
    return out


def regions(
    error: np.ndarray,
    rows: MotionRows,
    load: np.ndarray,
    joints: list[int],
    most: int = 2,
) -> list[Region]:
    """The regions where the gap of some joints is concentrated, the strongest first.

    Args:
        error: gap [N m], (M, n).
        rows: motion of the same rows.
        load: torque that the nominal arm predicts [N m], (M, n).
        joints: joints to look at, from 1.
        most: regions per joint.
    """
    found: list[Region] = []
    for joint in joints:
        gap, nominal = error[:, joint - 1], load[:, joint - 1]
        if not gap.any():
            continue
        candidates = [
            _regime_region(joint, part, gap**2)
            for part in _parts(rows, load, joint - 1)
        ]
        candidates += _bands(gap, nominal, rows, joint)
        named = [
            region
            for region in candidates
            if region.share >= REGION_SHARE and region.enrichment >= REGION_ENRICHMENT
        ]
        found += sorted(named, key=_strength, reverse=True)[:most]
    return found


def _strength(region: Region) -> float:
    return region.share * float(np.log(region.enrichment))


class _Part(NamedTuple):
    """A part of the rows, cut in advance: its kind, in words, and the mask over the rows, (M,)."""

    kind: str
    words: str
    mask: np.ndarray


def _regime_region(joint: int, part: _Part, square: np.ndarray) -> Region:
    share = float(square[part.mask].sum() / square.sum())
    return Region(joint, part.kind, part.words, share, float(part.mask.mean()))


def _parts(rows: MotionRows, load: np.ndarray, j: int) -> list[_Part]:
    """Parts of the motion of joint j (from 0) that hold any rows."""
    parts = [
        *_motion_parts(rows, load[:, j], j),
        *_position_parts(rows.q[:, j]),
        *_time_parts(rows),
    ]
    return [part for part in parts if part.mask.any()]


def _motion_parts(rows: MotionRows, load: np.ndarray, j: int) -> list[_Part]:
    """The fifth of the rows at the lowest and highest speed, acceleration and load, and both directions."""
    velocity = rows.dq[:, j]
    speed, acceleration = np.abs(velocity), np.abs(rows.ddq[:, j])
    torque = np.abs(load)
    slow, fast = np.quantile(speed, [0.2, 0.8])
    strong, heavy = np.quantile(acceleration, 0.8), np.quantile(torque, 0.8)
    named = [
        (f"near velocity reversal, |dq| below {slow:.2g} rad/s", speed <= slow),
        (f"high speed, |dq| above {fast:.2g} rad/s", speed >= fast),
        (
            f"high acceleration, |ddq| above {strong:.2g} rad/s²",
            acceleration >= strong,
        ),
        (f"high load, nominal torque above {heavy:.2g} N m", torque >= heavy),
        ("moving forward", velocity > slow),
        ("moving backward", velocity < -slow),
    ]
    return [_Part("regime", words, mask) for words, mask in named]


def _position_parts(q: np.ndarray) -> list[_Part]:
    """Fifths of the range of positions."""
    parts = []
    for low, high in itertools.pairwise(np.linspace(q.min(), q.max(), 6)):
        words = f"position {low:.2f} to {high:.2f} rad"
        parts.append(_Part("position", words, (q >= low) & (q <= high)))
    return parts


def _time_parts(rows: MotionRows) -> list[_Part]:
    """Fifths of the time of each segment."""
    clock = rows.clock
    parts = []
    for segment in np.unique(rows.segment):
        inside = rows.segment == segment
        t = clock[inside]
        for low, high in itertools.pairwise(np.linspace(t[0], t[-1], 6)):
            words = f"{rows.recording(segment)}, {low:.1f} to {high:.1f} s"
            mask = inside & (clock >= low) & (clock <= high)
            parts.append(_Part("time", words, mask))
    return parts


def _bands(
    error: np.ndarray, load: np.ndarray, rows: MotionRows, joint: int
) -> list[Region]:
    """Frequency bands of one joint; what a band covers is its share of the power of the nominal torque."""
    shares = band_powers(error, rows)
    coverages = np.maximum(band_powers(load, rows), MIN_BAND_POWER)
    return [
        Region(
            joint, "frequency", f"{low:g} to {high:g} Hz", float(share), float(coverage)
        )
        for (low, high), share, coverage in zip(BANDS, shares, coverages, strict=True)
    ]


def band_powers(series: np.ndarray, rows: MotionRows) -> np.ndarray:
    """Share of the power of a series (M,) in each of ``BANDS``, over all segments; shape (len(BANDS),)."""
    powers = np.zeros(len(BANDS))
    for segment, rate in enumerate(rows.rates):
        part = series[rows.segment == segment]
        frequency, density = welch(part, rate, nperseg=min(len(part), int(4 * rate)))
        resolution = frequency[1] - frequency[0]
        for k, (low, high) in enumerate(BANDS):
            band = (frequency >= low) & (frequency < high)
            powers[k] += density[band].sum() * resolution * len(part) / rate
    return powers / max(powers.sum(), 1e-300)
