"""Where a gap lies: joints, regimes of motion, times and frequencies, and one rule in words."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from scipy.signal import csd

from gapscope.arm.display import significant
from gapscope.arm.root_mean_square import SMALLEST
from gapscope.diagnosis.change_points import change_points
from gapscope.diagnosis.thresholds import (
    BANDS,
    FALSE_ALARM_RATE,
    INTERVAL_RATIO,
    JOINTS_IN_DEPTH,
    LEVEL_WINDOW,
    MAX_INTERVALS,
    REGION_ENRICHMENT,
    REGION_SHARE,
    REGIONS_PER_JOINT,
    RULE_BLOCK,
    RULE_CONDITIONS,
)
from gapscope.model.conditioning import TORQUE_CUTOFF
from gapscope.model.rows import PER_CUTOFF, DecimatedSegments

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
        coverage: its share of the samples; of frequencies, what they would hold of white noise, or of a gap that goes
            like the nominal torque, if that is more; 0..1.
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
        return self.share / max(self.coverage, SMALLEST)

    @property
    def worth(self) -> float:
        """Share times log enrichment [nats]: large if little of the time holds much of the gap."""
        return self.share * float(np.log(max(self.enrichment, SMALLEST)))

    @property
    def stands_out(self) -> bool:
        """Whether it holds much of the gap, and much more than its size explains."""
        return self.share >= REGION_SHARE and self.enrichment >= REGION_ENRICHMENT


# Segments stacked as rows: the quantities against which a gap is looked at.


@dataclass(frozen=True)
class MotionRows:
    """Rows of several segments, stacked, M rows of n joints.

    Attributes:
        t: time since the first row of its segment [s], (M,).
        q, dq, ddq: motion [rad], [rad/s], [rad/s^2], (M, n).
        segment: index of the segment of each row, (M,).
        rates: rows a second of each segment [Hz].
        names: recording that each segment is a part of; empty if that is not known.
        starts: time of the first row of each segment in its recording [s]; empty if all begin at 0.
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

    @property
    def edges(self) -> tuple[int, ...]:
        """Row at which each segment begins, and the end."""
        changes = np.diff(self.segment, prepend=-1, append=-1)
        return tuple(np.flatnonzero(changes).tolist())


def stacked(
    rows: DecimatedSegments, mine: np.ndarray | slice = slice(None)
) -> MotionRows:
    """Rows of segments, or some of them: a mask."""
    counts = [len(rows.time(s)) for s in rows.segments]
    # a part of all segments may be looked at: these are counted from 0 again
    every = np.repeat(np.arange(len(counts)), counts)[mine]
    numbers, segment = np.unique(every, return_inverse=True)
    own = [rows.segments[k] for k in numbers]
    motions = [(s.motion, rows.taken(s)) for s in rows.segments]
    t, q, dq = (
        np.concatenate([getattr(m, name)[taken] for m, taken in motions])[mine]
        for name in ("t", "q", "dq")
    )
    first = np.array([t[segment == k][0] for k in range(len(own))])
    return MotionRows(
        t=t - first[segment],
        q=q,
        dq=dq,
        # in the band of the gap, as torque follows it
        ddq=rows.rows(s.motion.ddq for s in rows.segments)[mine],
        segment=segment,
        rates=tuple(s.motion.rate / rows.step(s) for s in own),
        names=tuple(s.recording for s in own),
        starts=tuple(first.tolist()),
    )


# A rule that says when the gap of a joint is large: one branch of a regression tree [breiman1984], learnt on every
# other second and tested on the rest.


SPLITS = 48
"""Thresholds that are tried per quantity, at equal shares of the rows: a part holds one of them at least. (budget)"""
QUANTITIES = {
    "speed": ("|dq|", "rad/s"),
    "direction": ("direction", ""),
    "load": ("|load|", "N m"),
    "acceleration": ("|ddq|", "rad/s²"),
    "position": ("q", "rad"),
}
"""What a rule may speak of: symbol and unit in words. Of times, intervals say more: they know the recording."""


def rule_quantities(rows: MotionRows, load: np.ndarray, j: int) -> np.ndarray:
    """``QUANTITIES`` of joint j (from 0) at every row, (M, 5); load is the nominal torque [N m], (M, n)."""
    velocity, acceleration = rows.dq[:, j], rows.ddq[:, j]
    series = (
        np.abs(velocity),
        np.sign(velocity),
        np.abs(load[:, j]),
        np.abs(acceleration),
        rows.q[:, j],
    )
    return np.column_stack(series)


class Cut(NamedTuple):
    """One condition: the quantity with this number lies above ``threshold``, or else not."""

    quantity: int
    threshold: float
    above: bool


def meeting(cuts: tuple[Cut, ...], x: np.ndarray) -> np.ndarray:
    """Mask of the rows x, (M, K), that meet all conditions, (M,)."""
    inside = np.ones(len(x), dtype=bool)
    for index, threshold, above in cuts:
        inside &= (x[:, index] > threshold) == above
    return inside


def hottest_leaf(x: np.ndarray, y: np.ndarray, depth: int) -> tuple[Cut, ...]:
    """The cuts that lead to the leaf with the largest mean of y; empty if no cut is worth anything.

    At each node the cut with the largest fall of the sum of squares n1 n2 / n (mean1 - mean2)^2 is made, and the hotter
    side is followed: a tree of which one branch is grown.

    Args:
        x: quantities, shape (M, K).
        y: what is predicted, shape (M,).
        depth: most cuts.
    """
    cuts: tuple[Cut, ...] = ()
    least = max(1, len(y) // SPLITS)
    for _ in range(depth):
        inside = meeting(cuts, x)
        cut = _best_cut(x[inside], y[inside], least)
        if cut is None:
            break
        cuts = (*cuts, cut)
    return cuts


def _best_cut(x: np.ndarray, y: np.ndarray, least: int) -> Cut | None:
    """The cut with the largest fall of the sum of squares; ``None`` if no cut leaves ``least`` rows on both sides."""
    if len(y) <= 2 * least:
        return None
    # thresholds as numbers of rows below, with enough rows on either side
    below = np.unique(np.linspace(least, len(y) - least, SPLITS).astype(int))
    above = len(y) - below
    largest, best = 0.0, None
    for index, values in enumerate(x.T):
        order = np.argsort(values, kind="stable")
        ordered, total = values[order], np.cumsum(y[order])
        # mean above less mean below, from running sums
        step = (total[-1] - total[below - 1]) / above - total[below - 1] / below
        # no threshold lies between equal values
        parted = ordered[below - 1] < ordered[below]
        fall = np.where(parted, below * above / len(y) * step**2, 0.0)
        k = int(fall.argmax())
        if fall[k] > largest:
            threshold = float(ordered[below[k] - 1] + ordered[below[k]]) / 2
            # with two significant digits, as the report gives it
            largest = fall[k]
            best = Cut(index, float(f"{threshold:.2g}"), bool(step[k] > 0))
    return best


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
    every = rule_quantities(rows, load, joint - 1)
    # more rows than twice the band hold nothing new
    step = max(1, int(min(rows.rates) / (2 * TORQUE_CUTOFF)))
    # what a healthy arm leaves needs no rule
    x, above = every[::step], np.clip(error[::step] ** 2 - floor**2, 0.0, None)
    # blocks alternate, and each segment begins with the other kind
    learnt = (rows.t[::step] // RULE_BLOCK + rows.segment[::step]) % 2 == 0
    # nothing to learn, or nothing to test on
    if not above[learnt].any() or not above[~learnt].any():
        return None
    leaf = hottest_leaf(x[learnt], above[learnt], RULE_CONDITIONS)
    cuts = _worthwhile(leaf, x[~learnt], above[~learnt], joint)
    inside = meeting(cuts, x[~learnt])
    there = _rule_region(cuts, inside, above[~learnt], joint)
    # shifted by less, gap and motion still go together
    near = int(RULE_BLOCK * min(rows.rates) / step)
    if not there.stands_out or there.share <= _by_chance(inside, above[~learnt], near):
        return None
    # which rule holds is told by the test rows, how much it holds by all
    return _rule_region(cuts, meeting(cuts, every), error**2, joint)


def _worthwhile(
    cuts: tuple[Cut, ...], x: np.ndarray, y: np.ndarray, joint: int
) -> tuple[Cut, ...]:
    """The conditions that are worth most on held-out rows, of which each is due what a fitted value owes.

    What a rule is worth counts as often as y has independent samples, (sum y)^2 / sum y^2: few rows that hold most of
    it decide little.
    """
    samples = float(y.sum() ** 2 / (y**2).sum())

    def evidence(some: tuple[Cut, ...]) -> float:
        region = _rule_region(some, meeting(some, x), y, joint)
        return samples * region.worth - len(some) * np.log(samples)

    counts = range(len(cuts) + 1)
    # few conditions: all subsets can be tried
    subsets = (c for count in counts for c in itertools.combinations(cuts, count))
    return max(subsets, key=evidence)


def _rule_region(
    cuts: tuple[Cut, ...], inside: np.ndarray, square: np.ndarray, joint: int
) -> Region:
    """A rule as a region of a squared gap, given the mask over its rows, (M,) both.

    Conditions on one quantity are one; ``above`` and ``below`` are ``None`` if open.
    """
    conditions: dict[int, dict[str, Any]] = {}
    names = list(QUANTITIES)
    for index, threshold, above in cuts:
        symbol, unit = QUANTITIES[names[index]]
        new = {"quantity": names[index], "symbol": symbol, "unit": unit}
        entry = conditions.setdefault(index, {**new, "above": None, "below": None})
        # of two thresholds on one side the tighter one decides
        side, tighter = ("above", max) if above else ("below", min)
        known = entry[side]
        entry[side] = threshold if known is None else tighter(known, threshold)
    share = float(square[inside].sum() / square.sum())
    words = " and ".join(map(_rule_words, conditions.values()))
    detail = {"conditions": list(conditions.values())}
    return Region(joint, "rule", words, share, float(inside.mean()), detail)


def _by_chance(inside: np.ndarray, y: np.ndarray, near: int) -> float:
    """Share that a rule would seldom reach if the gap were elsewhere in time: over circular shifts by ``near`` or more.

    A shift keeps gap and motion as they are in themselves, and breaks the relation between them.
    """
    if len(y) <= 4 * near:
        return 1.0
    # correlation theorem: sum of y over the mask, for every circular shift of y at once
    mask_spectrum = np.fft.rfft(inside.astype(float))
    overlap = np.fft.irfft(mask_spectrum * np.conj(np.fft.rfft(y)), len(y))
    shares = overlap[near : len(y) - near] / y.sum()
    return float(np.quantile(shares, 1 - FALSE_ALARM_RATE))


def _rule_words(condition: dict[str, Any]) -> str:
    """One condition in words."""
    low, high, symbol = condition["above"], condition["below"], condition["symbol"]
    if condition["quantity"] == "direction":
        return "moving backward" if low is None else "moving forward"
    parts = [symbol]
    if low is not None:
        parts = [f"{significant(low, 2)} <", symbol]
    if high is not None:
        parts.append(f"< {significant(high, 2)}")
    elif low is not None:
        parts = [symbol, f"> {significant(low, 2)}"]
    return " ".join([*parts, condition["unit"]])


# How a gap follows the joint's own signals: coherence, and gain and phase of the transfer function [bendat2010].


STEP = 0.25
"""Grid of frequencies [Hz]; spectra are averaged over stretches that resolve it, of 1 / ``STEP``. (budget)"""
FREQUENCIES = STEP * np.arange(int(TORQUE_CUTOFF / STEP) + 1)
"""In the band of the gap [Hz], (F,)."""
DRIVES = {
    "torque": "N m per N m",
    "velocity": "N m s/rad",
    "acceleration": "N m s²/rad",
}
"""The joint's own signals that a gap may follow, the nominal torque first, and the unit of gap over signal."""


def densities(x: np.ndarray, y: np.ndarray, rows: MotionRows) -> np.ndarray:
    """Cross power densities S_xy at ``FREQUENCIES``, complex, (F, K); of x and itself the power density.

    Args:
        x, y: series at the rows, (M, K), or one of both (M, 1).
        rows: the rows; a segment weighs as many samples as it has.
    """
    shape = np.broadcast_shapes(x[0].shape, y[0].shape)
    out = np.zeros((len(FREQUENCIES), *shape), dtype=complex)
    for segment, rate in enumerate(rows.rates):
        mine = rows.segment == segment
        whole = round(rate / STEP)
        size = min(int(mine.sum()), whole)
        if size > 1:
            # a segment shorter than a stretch is padded to the same grid
            _, density = csd(x[mine], y[mine], rate, nperseg=size, nfft=whole, axis=0)
            # a slow log ends below the band
            known = density[: len(out)]
            out[: len(known)] += mine.mean() * known
    return out


@dataclass(frozen=True)
class Spectra:
    """Spectra of one joint's gap e and of K signals x, averaged over stretches of all recordings.

    Attributes:
        gap: power density S_ee [(N m)^2/Hz], (F,).
        signals: S_xx, in the squared unit of the signal per Hz, (K, F).
        cross: S_xe, complex, (K, F).
        averages: number of stretches [1].
    """

    gap: np.ndarray
    signals: np.ndarray
    cross: np.ndarray
    averages: float

    @property
    def coherence(self) -> np.ndarray:
        """gamma^2 = |S_xe|^2 / (S_xx S_ee), the share of the gap's power that follows each signal, (K, F)."""
        return np.abs(self.cross) ** 2 / np.maximum(self.signals * self.gap, SMALLEST)

    def share(self, mask: np.ndarray) -> float:
        """Share of the gap's power in some of the frequencies [1]."""
        return float(self.gap[mask].sum() / max(self.gap.sum(), SMALLEST))

    def coverage(self, mask: np.ndarray) -> float:
        """Share that white noise has there, or that the nominal torque has, if that is more [1]."""
        # the nominal torque is the first of the signals
        torque = self.signals[0]
        power = float(torque[mask].sum() / max(torque.sum(), SMALLEST))
        return max(power, float(mask.mean()))


def spectra(
    error: np.ndarray, rows: MotionRows, load: np.ndarray, joint: int
) -> Spectra:
    """Spectra of one joint's gap [N m], (M,), and of ``DRIVES``; load is the nominal torque [N m], (M, n)."""
    j, gap = joint - 1, error[:, None]
    signals = np.column_stack([load[:, j], rows.dq[:, j], rows.ddq[:, j]])
    seconds = float((np.bincount(rows.segment) / np.array(rows.rates)).sum())
    return Spectra(
        densities(gap, gap, rows)[:, 0].real,
        densities(signals, signals, rows).real.T,
        densities(signals, gap, rows).T,
        # stretches overlap by half; only those side by side are independent
        max(seconds * STEP, 1.0),
    )


def _bands() -> Iterator[tuple[float, float, np.ndarray]]:
    """Ends of ``BANDS`` [Hz], and the mask over the frequencies, (F,)."""
    for low, high in itertools.pairwise(BANDS):
        yield low, high, (low <= FREQUENCIES) & (high > FREQUENCIES)


def line(found: Spectra, joint: int) -> Region | None:
    """A narrow line that holds most of the power of the gap, and that white noise and the torque do not have.

    The window of the stretches (Hann's) makes any line two steps wide to either side; what lies within twice that from
    zero is no vibration but slow.
    """
    width = 2 * STEP
    peak = FREQUENCIES[int((found.gap * (2 * width <= FREQUENCIES)).argmax())]
    near = np.abs(FREQUENCIES - peak) <= width
    share = found.share(near)
    if peak == 0.0 or 2 * share < 1:
        return None
    # between the steps of the grid: the centre of its power
    power = found.gap[near]
    centre = float((FREQUENCIES[near] * power).sum() / power.sum())
    words = f"line at {significant(centre, 2)} Hz"
    detail = {"frequency": centre}
    region = Region(joint, "line", words, share, found.coverage(near), detail)
    return region if region.stands_out else None


def coherent(found: Spectra, joint: int) -> list[Region]:
    """Bands in which most of the gap follows the joint's own torque, velocity or acceleration; the largest share first.

    Of N independent averages the coherence of signals without relation exceeds c with probability (1 - c)^(N - 1), and
    that of others has the standard error sqrt(2 / N) (1 - c) sqrt(c) [bendat2010]. Of the signals that the gap follows
    as well as any within two of these, the one is named that it is most in step with: in a narrow band velocity and
    acceleration are the same but for a quarter of a period.
    """
    out = []
    for low, high, mask in _bands():
        share, cross = found.share(mask), found.cross[:, mask].sum(axis=1)
        signals, gap = found.signals[:, mask].sum(axis=1), found.gap[mask].sum()
        # over the band as a whole: a phase that turns within it is no relation
        coherence = np.abs(cross) ** 2 / np.maximum(signals * gap, SMALLEST)
        # the window joins two lines of the grid
        averages = max(found.averages * float(mask.sum()) / 2, 2.0)
        by_chance = 1 - FALSE_ALARM_RATE ** (1 / (averages - 1))
        best = float(coherence.max())
        # beyond chance, and more of the band's gap than does not follow it
        if share < REGION_SHARE or best < max(by_chance, 1 - best):
            continue
        error = np.sqrt(2 * best / averages) * (1 - best)
        in_step = np.abs(np.cos(np.angle(cross)))
        k = int(np.where(coherence >= best - 2 * error, in_step, -1.0).argmax())
        name, unit = list(DRIVES.items())[k]
        transfer = cross[k] / signals[k]
        gain, phase = float(np.abs(transfer)), float(np.angle(transfer))
        words = (
            f"{low:g} to {high:g} Hz, follows the joint's {name} {_phase(phase)}: {significant(gain, 2)} {unit}, "
            f"coherence {coherence[k]:.2f}"
        )
        detail = {
            "band": [low, high],
            "signal": name,
            "coherence": float(coherence[k]),
            "gain": gain,
            "unit": unit,
            "phase": phase,
        }
        coverage = found.coverage(mask)
        out.append(Region(joint, "coherence", words, share, coverage, detail))
    return sorted(out, key=lambda region: -region.share)


def _phase(phase: float) -> str:
    """A phase [rad] in words, to the nearest third of a half-turn; positive if the gap is ahead."""
    if abs(phase) < np.pi / 6:
        return "in step"
    if abs(phase) > 5 * np.pi / 6:
        return "with the sign reversed"
    degrees = f"{abs(np.rad2deg(phase)):.0f}°"
    return f"{degrees} {'ahead' if phase > 0 else 'behind'}"


# When a gap starts and stops: change points of its level over time.


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
    def stretches(self) -> list[slice]:
        """The windows of each stretch."""
        return [slice(a, b) for a, b in itertools.pairwise(self.edges)]

    @property
    def steps(self) -> np.ndarray:
        """RMS over the stretch that each window belongs to [N m], (W,)."""
        means = [np.sqrt(np.mean(self.rms[own] ** 2)) for own in self.stretches]
        return np.repeat(means, np.diff(self.edges))


def levels(error: np.ndarray, rows: MotionRows, floor: float) -> list[GapLevels]:
    """Level of one joint's gap [N m], (M,), over each recording; ``floor`` is what a healthy arm leaves [N m].

    The log of the mean square of noise in a band B over a window T deviates by 1 / sqrt(B T).
    """
    names = np.array([rows.recording(k) for k in range(len(rows.rates))])
    # rows of slow motions hold less than the band of the gap
    band = min(TORQUE_CUTOFF, min(rows.rates) / PER_CUTOFF)
    deviation = (band * LEVEL_WINDOW) ** -0.5
    out = []
    for name in dict.fromkeys(names.tolist()):
        inside = (names == name)[rows.segment]
        t, square = rows.clock[inside], error[inside] ** 2
        if not len(t):
            continue
        window = ((t - t[0]) // LEVEL_WINDOW).astype(int)
        count = np.bincount(window)
        # windows cut short by a gap in the recording are left out
        used = 2 * count >= np.median(count[count > 0])
        mean = np.bincount(window, square)[used] / count[used]
        middle = t[0] + LEVEL_WINDOW * (np.flatnonzero(used) + 1 / 2)
        # the floor keeps a gap that comes near zero from large steps of its logarithm
        level = np.log(mean + floor**2 + SMALLEST)
        stds = np.full(len(level), deviation)
        changes = change_points(level, stds, FALSE_ALARM_RATE)
        edges = (0, *(change.position for change in changes), len(level))
        out.append(GapLevels(name, middle, np.sqrt(mean), edges))
    return out


def intervals(found: list[GapLevels], joint: int) -> list[Region]:
    """The stretches in which a joint's gap is far above that in the rest of all recordings; the largest first.

    The hottest stretch is tried, then the hottest two: a contact may come twice.
    """
    every = [(level, own) for level in found for own in level.stretches]
    every.sort(key=lambda one: -float((one[0].rms[one[1]] ** 2).mean()))
    whole = max(sum(float((level.rms**2).sum()) for level in found), SMALLEST)
    windows = sum(len(level.rms) for level in found)
    for count in range(1, MAX_INTERVALS + 1):
        regions = []
        for level, own in every[:count]:
            share = float((level.rms[own] ** 2).sum()) / whole
            coverage = (own.stop - own.start) / windows
            # what begins or ends with the recording has no start or end of its own
            start = end = None
            if own.start > 0:
                start = float(level.t[own.start] - LEVEL_WINDOW / 2)
            if own.stop < len(level.t):
                end = float(level.t[own.stop - 1] + LEVEL_WINDOW / 2)
            detail = {"recording": level.recording, "start": start, "end": end}
            words = _interval_words(level.recording, start, end)
            regions.append(Region(joint, "interval", words, share, coverage, detail))
        share, coverage = (
            sum(getattr(region, name) for region in regions)
            for name in ("share", "coverage")
        )
        together = Region(joint, "interval", "", share, coverage)
        if together.stands_out and _far_above(every[:count], every[count:]):
            return sorted(regions, key=lambda region: -region.share)
    return []


def _far_above(
    chosen: list[tuple[GapLevels, slice]], others: list[tuple[GapLevels, slice]]
) -> bool:
    """Whether the squared level in each stretch is far above that of any other piece of the same length."""
    if not others:
        return False
    # the rest in one row: a piece may reach across two stretches
    outside = np.concatenate([level.rms[own] ** 2 for level, own in others])
    for level, own in chosen:
        length = min(own.stop - own.start, len(outside))
        box = np.full(length, 1 / length)
        elsewhere = np.convolve(outside, box, mode="valid").max()
        if (level.rms[own] ** 2).mean() <= INTERVAL_RATIO * elsewhere:
            return False
    return True


def _interval_words(recording: str, start: float | None, end: float | None) -> str:
    if start is None and end is None:
        return f"all of {recording}"
    if start is None:
        return f"{recording}, until it stops at {end:.1f} s"
    if end is None:
        return f"{recording}, from {start:.1f} s, where it starts, to the end"
    return f"{recording}, starts at {start:.1f} s and stops at {end:.1f} s"


# Localisation in depth of the gap of some joints.


@dataclass(frozen=True)
class Profile:
    """RMS of a gap over bins of one quantity.

    Attributes:
        condition: of the rule, on the quantity.
        x: middle of the bins, (B,).
        rms: RMS of the gap in each [N m], (B,).
        words: the whole rule.
    """

    condition: Mapping[str, Any]
    x: np.ndarray
    rms: np.ndarray
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
    gap: np.ndarray, rows: MotionRows, load: np.ndarray, floor: float, joint: int
) -> JointLocalisation:
    """Rules, intervals, lines and bands of the gap of a joint.

    Args:
        gap: that of the joint, which is not zero everywhere [N m], (M,).
        rows: motion of the same rows.
        load: torque that the nominal arm predicts [N m], (M, n).
        floor: RMS that a healthy arm leaves on the joint [N m].
        joint: from 1.
    """
    over_time = levels(gap, rows, floor)
    own_rule = rule(gap, rows, load, floor, joint)
    in_frequency = spectra(gap, rows, load, joint)
    found = [
        own_rule,
        *intervals(over_time, joint),
        line(in_frequency, joint),
        *coherent(in_frequency, joint)[:REGIONS_PER_JOINT],
    ]
    return JointLocalisation(
        joint,
        floor,
        tuple(region for region in found if region is not None),
        None if own_rule is None else _profile(own_rule, gap, rows, load),
        tuple(over_time),
        in_frequency,
    )


def _profile(
    own_rule: Region, error: np.ndarray, rows: MotionRows, load: np.ndarray
) -> Profile | None:
    """RMS over bins of equal width of the rule's first quantity with a scale."""
    # a direction has no scale to draw the gap over
    conditions = [c for c in own_rule.detail["conditions"] if c["unit"]]
    if not conditions:
        return None
    place = list(QUANTITIES).index(conditions[0]["quantity"])
    values = rule_quantities(rows, load, own_rule.joint - 1)[:, place]
    count, edges = np.histogram(values, SPLITS)
    square, _ = np.histogram(values, SPLITS, weights=error**2)

    used = count > 0
    middle = (edges[:-1] + edges[1:]) / 2
    # bins that the motion does not visit are left out
    level = np.sqrt(square[used] / count[used])
    return Profile(conditions[0], middle[used], level, own_rule.regime)


# Where a gap lies by regime of motion, by position, in time and by frequency, cut in advance, and as was learnt.


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
    out = []
    for place, joint in enumerate(joints):
        out += regions(error, rows, load, [joint])
        gap, least = error[:, joint - 1], float(floor[joint - 1])
        if place < JOINTS_IN_DEPTH and gap.any():
            out += locate(gap, rows, load, least, joint).regions
    return out


def regions(
    error: np.ndarray,
    rows: MotionRows,
    load: np.ndarray,
    joints: list[int],
    most: int = REGIONS_PER_JOINT,
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
        gap = error[:, joint - 1]
        if not gap.any():
            continue
        square, own = gap**2, spectra(gap, rows, load, joint)
        candidates = []
        for kind, words, mask in _parts(rows, load[:, joint - 1], joint - 1):
            share = float(square[mask].sum() / square.sum())
            candidates.append(Region(joint, kind, words, share, float(mask.mean())))
        for low, high, mask in _bands():
            words, share = f"{low:g} to {high:g} Hz", own.share(mask)
            coverage = own.coverage(mask)
            candidates.append(Region(joint, "frequency", words, share, coverage))
        named = [region for region in candidates if region.stands_out]
        found += sorted(named, key=lambda region: -region.worth)[:most]
    return found


def _parts(
    rows: MotionRows, load: np.ndarray, j: int
) -> Iterator[tuple[str, str, np.ndarray]]:
    """Parts of the motion of joint j (from 0), in fifths: kind, words, mask over the rows, (M,).

    Args:
        rows: the motion.
        load: torque that the nominal arm predicts on the joint [N m], (M,).
        j: the joint.
    """
    fifths = np.linspace(0, 1, 6)
    velocity, q, clock = rows.dq[:, j], rows.q[:, j], rows.clock
    speed, acceleration, torque = (np.abs(x) for x in (velocity, rows.ddq[:, j], load))
    slow, fast = np.quantile(speed, fifths[[1, -2]])
    strong, heavy = (np.quantile(x, fifths[-2]) for x in (acceleration, torque))
    for words, mask in (
        (f"near velocity reversal, |dq| below {slow:.2g} rad/s", speed <= slow),
        (f"high speed, |dq| above {fast:.2g} rad/s", speed >= fast),
        (f"high acceleration, |ddq| above {strong:.2g} rad/s²", acceleration >= strong),
        (f"high load, nominal torque above {heavy:.2g} N m", torque >= heavy),
        # beyond the slowest fifth: near zero the sign of the velocity is noise
        ("moving forward", velocity > slow),
        ("moving backward", velocity < -slow),
    ):
        yield "regime", words, mask
    for low, high in itertools.pairwise(q.min() + fifths * np.ptp(q)):
        yield (
            "position",
            f"position {low:.2f} to {high:.2f} rad",
            (q >= low) & (q <= high),
        )
    # segment by segment: a recording with a hole in it has several
    for segment in np.unique(rows.segment):
        inside, name = rows.segment == segment, rows.recording(segment)
        t = clock[inside]
        for low, high in itertools.pairwise(t[0] + fifths * (t[-1] - t[0])):
            yield (
                "time",
                f"{name}, {low:.1f} to {high:.1f} s",
                inside & (clock >= low) & (clock <= high),
            )
