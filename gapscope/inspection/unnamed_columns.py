"""Columns whose names tell nothing, told apart by what they hold: time, and blocks of one number for each joint.

A block is the derivative of another if, over ten rows, what the one gains is the mean of the other times the same
factor on all joints. What has a derivative in the log and is none itself is a position; of two positions that are
alike the measured one comes later than its reference. Without a derivative in the log, positions are the smoothest
columns that stay within the limits of the robot. What is left may be a torque; a nominal arm says which explains best.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.io.table import Table
from gapscope.arm.nominal import NominalArm
from gapscope.inspection.columns import (
    ALIKE,
    ANGLES,
    BY_NAME,
    LARGEST,
    NOT_OF_JOINTS,
    UNITS,
    ColumnGroup,
    TableColumns,
    counts_rows,
    meaning_of,
    numbers_of,
    runs_forward,
    sorted_columns,
    words_of,
)

SPAN = 10
"""Rows over which a block is compared with the sum of another [1]: noise of single rows is averaged."""
FOLLOWS = 0.9
"""Cosine between both from which a column is the derivative of another [1]."""
PROPORTIONAL = 0.999
"""Correlation from which a column that rises counts the same time as another [1]: rows may be lost."""
UNEVEN = 0.2
"""Steps of a column of time leave their median by less, in the mean [1]."""
LOST = 1.5
"""Steps of time longer than this many usual ones have lost rows in them [1]."""
ROWS = 50_000
"""Rows that are looked at."""
BEYOND = 0.1
"""Share of a joint's range by which a position may leave it [1]."""
SAME = 0.9
"""Correlation, median over the joints, from which two blocks of one size hold the same quantity [1]."""
HELD = 0.3
"""Share of rows by which a reference stands still more often than the position [1]."""
SMOOTHER = 2.0
"""Factor between fourth differences of a position and its reference from which they tell which is which [1]."""
WARM = (10.0, 120.0)
"""Range of temperatures of all joints [degC]."""


@dataclass(frozen=True)
class _Block:
    """Columns of one quantity: what they hold, in words of ``words.py``, their places from 0, and what tells."""

    holds: str
    places: tuple[int, ...]
    why: str

    def group(self, columns: Sequence[tuple[str, np.ndarray]]) -> ColumnGroup:
        """The columns under a pattern that says what they hold."""
        names = tuple(columns[place][0] for place in self.places)
        said = ", ".join(names)
        # in the order of the file
        if len(names) > 2 and self.places[-1] - self.places[0] == len(names) - 1:
            said = f"{names[0]} to {names[-1]}"
        counted = f"column{'s' if len(names) > 1 else ''} {said}"
        labels = tuple(str(j + 1) for j in range(len(names)))
        values = np.column_stack([columns[place][1] for place in self.places])
        pattern = ", ".join(filter(None, (self.holds, counted)))
        return ColumnGroup(pattern, labels, names, values, self.why, self.holds)


def columns_by_values(
    table: Table, arm: NominalArm | None, context: str
) -> TableColumns:
    """Columns of a table whose names tell no positions: those that names do tell, all others by their values.

    A name without a number counts here, too: the only joint of an arm has none.

    Args:
        table: as a reader gave it.
        arm: the nominal arm, if it is known.
        context: name of the file and the topic, which say what a block that is alone holds.
    """
    named = sorted_columns(table, () if arm is None else arm.joints)
    groups = [group for group in named.groups if meaning_of(group.pattern).quantity]
    taken = {name for group in groups for name in group.names}
    singles = {}
    for name, x in named.singles.items():
        quantity = meaning_of(name).quantity
        if quantity == "time":
            singles[name] = x
        elif quantity and (arm is None or arm.n_joints == 1):
            groups.append(ColumnGroup(name, ("1",), (name,), x[:, None], BY_NAME))
            taken.add(name)
    silent = {
        name: cells
        for name, cells in table.columns.items()
        if name not in taken | set(singles) and not words_of(name) & NOT_OF_JOINTS
    }
    if any(meaning_of(group.pattern).quantity == "position" for group in groups):
        silent = {}
    rest = unnamed_columns(replace(table, columns=silent), arm, context)
    return TableColumns(
        (*groups, *rest.groups), {**singles, **rest.singles}, named.texts
    )


def unnamed_columns(table: Table, arm: NominalArm | None, context: str) -> TableColumns:
    """Columns of a table by their values alone.

    Args:
        table: as a reader gave it.
        arm: the nominal arm, if it is known.
        context: name of the file and the topic, which say what a block that is alone holds.
    """
    found = {name: numbers_of(cells) for name, cells in table.columns.items()}
    texts = tuple(name for name, values in found.items() if values is None)
    numbers = {name: x for name, x in found.items() if x is not None and x.ndim == 1}
    singles = _times(numbers)
    columns = [(name, x) for name, x in numbers.items() if name not in singles]
    if not columns:
        return TableColumns((), singles, texts)
    values = np.column_stack([x[:ROWS] for _, x in columns])
    sound = (np.abs(values) < LARGEST).all(axis=1)
    rows = np.asarray(table.row_numbers[:ROWS])
    if singles:
        # the time tells where rows are missing in the file itself
        step = np.diff(next(iter(singles.values()))[:ROWS])
        rows = np.cumsum(np.r_[0, np.where(step > LOST * np.median(step), 2, 1)])
    values, rows = values[sound], rows[sound]
    few = len(values) <= 2 * SPAN
    blocks = [] if few else _Blocks(values, rows, arm).told(context)
    groups = tuple(block.group(columns) for block in blocks)
    taken = {name for group in groups for name in group.names}
    singles |= {name: x for name, x in columns if name not in taken}
    return TableColumns(groups, singles, texts)


def _times(numbers: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Columns that rise in even steps, the one to read the time from first, and what rises in proportion to it."""
    uneven = {}
    for name, x in numbers.items():
        if np.isfinite(x).all() and runs_forward(x):
            step = np.diff(x)
            usual = float(np.median(step))
            # sums of steps: rows that were lost make a few large ones
            small = np.minimum(np.abs(step - usual), usual)
            uneven[name] = float(small.mean()) / usual if usual > 0 else np.inf
    even = [name for name in uneven if uneven[name] < UNEVEN]
    if not even:
        return {}
    first = numbers[min(even, key=uneven.__getitem__)]
    alike = [x for x in even if np.corrcoef(numbers[x], first)[0, 1] > PROPORTIONAL]
    # the number of a row says less than a stamp
    alike.sort(key=lambda name: counts_rows(numbers[name]))
    return {name: numbers[name] for name in alike}


class _Blocks:
    """Finds the blocks in columns of numbers, (N, m)."""

    def __init__(
        self, values: np.ndarray, rows: np.ndarray, arm: NominalArm | None
    ) -> None:
        self.values, self.arm = values, arm
        self.count = values.shape[1]
        self.still = np.ptp(values, axis=0) == 0
        # no rows are lost between
        self.next = np.diff(rows) == 1
        whole = rows[SPAN:] - rows[:-SPAN] == SPAN
        gain = (values[SPAN:] - values[:-SPAN])[whole]
        middle = 0.5 * (values[1:] + values[:-1])
        total = np.vstack([np.zeros(self.count), np.cumsum(middle, axis=0)])
        total = (total[SPAN:] - total[:-SPAN])[whole]
        power = (total**2).sum(axis=0)
        product = gain.T @ total
        size = np.sqrt(np.outer((gain**2).sum(axis=0), power))
        with np.errstate(divide="ignore", invalid="ignore"):
            self.cosine = np.where(size > 0, product / size, 0.0)
            self.ratio = np.where(power > 0, product / power, 0.0)
        np.fill_diagonal(self.cosine, 0.0)

    def told(self, context: str) -> list[_Block]:
        """The blocks with what they hold; none if nothing tells how many joints there are."""
        n, order = self._arrangement()
        if not n:
            return []
        if n == self.count:
            return self._alone(order, context)
        windows = self._windows(n, order)
        pairs = self._pairs(windows)
        of_pairs, of_windows = self._by_derivatives, self._by_smoothness
        found = of_pairs(pairs) if pairs else of_windows(windows)
        if not found:
            return []
        return [*found, *self._rest(n, order, found)]

    def _arrangement(self) -> tuple[int, tuple[int, ...]]:
        """Number of joints, and the columns in an order in which those of a quantity follow each other."""
        blocks = tuple(range(self.count))
        distance, stride, span = self._offset()
        n = 0 if self.arm is None else self.arm.n_joints
        if n and not distance:
            return self._without_derivatives(n)
        if stride > 1:
            # one joint after the other
            own = self.count // stride
            every = [place for place in blocks if place < own * stride]
            return own, tuple(sorted(every, key=lambda place: place % stride))
        if n and span <= n <= distance:
            return n, blocks
        if not distance:
            return self._smooth_run(), blocks
        # what stands between a column and its derivative are whole blocks
        return next(d for d in range(span, distance + 1) if distance % d == 0), blocks

    def _offset(self) -> tuple[int, int, int]:
        """How far the derivatives stand from their columns, the stride from joint to joint, and columns side by side.

        Zeros if there are none.
        """
        best, members = 0, np.flatnonzero(np.zeros(0))
        for distance in range(1, self.count):
            for k in (distance, -distance):
                own = np.flatnonzero(np.diagonal(self.cosine, k) > FOLLOWS)
                if len(own) > len(members):
                    best, members = distance, own
        if not best:
            return 0, 0, 0
        # the usual distance: a torque may follow a motion by chance
        apart, times = np.unique(np.diff(members), return_counts=True)
        stride = int(apart[times.argmax()]) if len(apart) else 1
        # a joint that stands still is part of its block
        inside = self.still.copy()
        inside[members] = True
        edges = np.flatnonzero(np.diff(np.r_[False, inside, False]))
        span = int((edges[1::2] - edges[::2]).max())
        return best, stride, min(span, best)

    def _without_derivatives(self, n: int) -> tuple[int, tuple[int, ...]]:
        """The arrangement of a log without velocities by the roughness of its columns, for n joints."""
        blocks = tuple(range(self.count))
        if n > self.count:
            return 0, blocks
        stride = self.count // n
        turned = tuple(sorted(range(n * stride), key=lambda place: place % stride))
        if self.count % n or stride == 1:
            return n, blocks
        rough = self._roughness()

        def best(order: tuple[int, ...]) -> float:
            return min(rough[list(w)].max() for w in self._windows(n, order))

        return n, min((blocks, turned), key=best)

    def _smooth_run(self) -> int:
        """Joints of a log without velocities: up to the references, or as many as there are smooth columns in a row."""
        for n in range(1, self.count // 2 + 1):
            if self._like(tuple(range(n)), tuple(range(n, 2 * n))):
                return n
        rough = np.log(np.maximum(self._roughness(), 1e-12))
        ranked = np.sort(rough)
        if self.count < 2:
            return self.count
        leap = int(np.argmax(np.diff(ranked)))
        smooth = np.flatnonzero(rough <= ranked[leap])
        together = smooth[-1] - smooth[0] + 1 == len(smooth)
        return len(smooth) if together and self.count % len(smooth) == 0 else 0

    def _roughness(self) -> np.ndarray:
        """Second over first differences of each column [1], (m,); that of a column that stands still is 0."""
        first = np.diff(self.values, axis=0)[self.next].std(axis=0)
        both = self.next[1:] & self.next[:-1]
        second = np.diff(self.values, n=2, axis=0)[both].std(axis=0)
        return np.where(first > 0, second / np.maximum(first, 1e-300), 0.0)

    def _windows(self, n: int, order: tuple[int, ...]) -> list[tuple[int, ...]]:
        """Every n columns that may be a block."""
        step = 1 if order == tuple(range(self.count)) else n
        return [order[s : s + n] for s in range(0, len(order) - n + 1, step)]

    def _pairs(
        self, windows: Sequence[tuple[int, ...]]
    ) -> list[tuple[tuple[int, ...], tuple[int, ...]]]:
        """Blocks and those that are their derivatives, the surest first; no two overlap."""
        scored = []
        for one in windows:
            for other in windows:
                if set(one) & set(other):
                    continue
                follows = self.cosine[one, other] > FOLLOWS
                if not follows.any():
                    continue
                ratio = self.ratio[one, other][follows]
                alike = np.abs(ratio / np.median(ratio) - 1) < ALIKE
                moving = ~self.still[list(one)]
                # a friction that is viscous follows the velocity, by another factor on each joint
                if 2 * alike.sum() >= moving.sum():
                    cosine = float(np.median(self.cosine[one, other][follows]))
                    strange = int((moving & ~follows).sum())
                    rank = (-int(alike.sum()), strange, -cosine)
                    scored.append((rank, one, other))
        taken: list[tuple[int, ...]] = []
        pairs = []
        for _, one, other in sorted(scored):
            news = [window for window in (one, other) if window not in taken]
            if any(set(window) & set(old) for window in news for old in taken):
                continue
            taken += news
            pairs.append((one, other))
        return pairs

    def _by_derivatives(
        self, pairs: Sequence[tuple[tuple[int, ...], tuple[int, ...]]]
    ) -> list[_Block]:
        """Positions, velocities and accelerations of measured motion and of references."""
        derivatives = {other for _, other in pairs}
        positions = list(
            dict.fromkeys(one for one, _ in pairs if one not in derivatives)
        )
        if not positions:
            return []
        measured, references = self._measured(sorted(positions))
        limits = ", and stays within the limits of the robot"
        why = "its derivative is in the log"
        why += limits if self._within_limits(measured) else ""
        found = [_Block("position", measured, why)]
        found += references
        own = [other for one, other in pairs if one == measured]
        velocity, _ = self._measured(sorted(own))
        for other in own:
            holds = "velocity" if other == velocity else "reference velocity"
            found.append(_Block(holds, other, "follows the derivative of the position"))
        for one, other in pairs:
            if one in positions and other not in own:
                why = "follows the derivative of the reference"
                found.append(_Block("reference velocity", other, why))
                own.append(other)
        known = {block.places for block in found}
        for one, other in pairs:
            if one in known and one not in positions and other not in known:
                why = "follows the derivative of the velocity"
                found.append(_Block("acceleration", other, why))
                known.add(other)
        return found

    def _measured(
        self, windows: Sequence[tuple[int, ...]]
    ) -> tuple[tuple[int, ...], list[_Block]]:
        """Of blocks of one quantity the one that was measured, and the others as references."""
        measured, *others = windows
        references = []
        for other in others:
            turned, why = self._reference_first(measured, other)
            reference, measured = (measured, other) if turned else (other, measured)
            references.append(_Block("reference position", reference, why))
        return measured, references

    def _like(self, one: tuple[int, ...], other: tuple[int, ...]) -> bool:
        """Whether two blocks hold the same quantity: joint by joint of one course and size."""
        x, y = self.values[:, list(one)], self.values[:, list(other)]
        moving = (np.ptp(x, axis=0) > 0) & (np.ptp(y, axis=0) > 0)
        if not moving.any():
            return False
        x, y = x[:, moving], y[:, moving]
        size = y.std(axis=0) / x.std(axis=0)
        x, y = x - x.mean(axis=0), y - y.mean(axis=0)
        cosine = (x * y).mean(axis=0) / (x.std(axis=0) * y.std(axis=0))
        return bool(np.median(cosine) > SAME and np.abs(np.log(size)).max() < np.log(2))

    def _reference_first(
        self, one: tuple[int, ...], other: tuple[int, ...]
    ) -> tuple[bool, str]:
        """Whether the first of two blocks of one quantity is the reference of the other; and what tells."""
        steps = [
            np.diff(self.values[:, list(window)], axis=0) for window in (one, other)
        ]
        held = [float((step == 0).mean()) for step in steps]
        if abs(held[0] - held[1]) > HELD:
            why = "like what was measured, and held between set points"
            return held[0] > held[1], why
        # what is computed is smoother than what encoders measure; the median passes over lost rows
        noise = [float(np.median(np.abs(np.diff(step, n=3, axis=0)))) for step in steps]
        if max(noise) > SMOOTHER * min(noise):
            return noise[0] < noise[1], "like what was measured, and smoother"
        # by how many rows a block comes after another of the same quantity; 0 if it does not follow it
        lags = []
        for a, b in zip(one, other, strict=True):
            slope = np.gradient(self.values[:, a])
            error = self.values[:, b] - self.values[:, a]
            error, slope = error - error.mean(), slope - slope.mean()
            if (slope @ slope) > 0:
                lags.append(-float(error @ slope) / float(slope @ slope))
        ahead = bool(lags) and float(np.median(lags)) > 0
        return ahead, "like what was measured, and ahead of it"

    def _within_limits(self, window: tuple[int, ...]) -> bool:
        """Whether columns stay within the limits of the robot in one of the units of positions."""
        if self.arm is None or len(window) != self.arm.n_joints:
            return False
        lower, upper = RigidBody(self.arm).position_limits()
        wide = BEYOND * np.where(np.isfinite(upper - lower), upper - lower, 0.0)
        x = self.values[:, list(window)]
        low, high = x.min(axis=0), x.max(axis=0)
        return any(
            bool(((low * f >= lower - wide) & (high * f <= upper + wide)).all())
            for f in (UNITS[unit] for unit in ANGLES)
        )

    def _by_smoothness(self, windows: Sequence[tuple[int, ...]]) -> list[_Block]:
        """The positions of a log that holds no velocity: the smoothest columns within the robot's limits."""
        rough = self._roughness()
        moving = [w for w in windows if not self.still[list(w)].all()]
        inside = [w for w in moving if self._within_limits(w)]
        possible = inside or moving
        if not possible:
            return []
        best = min(possible, key=lambda w: float(rough[list(w)].max()))
        why = "the smoothest columns"
        if inside:
            why += " that stay within the limits of the robot"
        alike = [w for w in moving if not set(w) & set(best) and self._like(best, w)]
        # windows of which none overlaps one before it
        kept: list[tuple[int, ...]] = []
        for window in alike:
            if not any(set(window) & set(other) for other in kept):
                kept.append(window)
        measured, references = self._measured(sorted([best, *kept]))
        why += "; no column is their derivative"
        return [_Block("position", measured, why), *references]

    def _alone(self, order: tuple[int, ...], context: str) -> list[_Block]:
        """A log of one quantity: by the name of its file, else positions."""
        if meaning_of("", context).quantity:
            return [_Block("", order, "")]
        return [_Block("position", order, "the only columns, one for each joint")]

    def _rest(
        self, n: int, order: tuple[int, ...], found: Sequence[_Block]
    ) -> list[_Block]:
        """Blocks beside those that are known: references, temperatures, and possible torques, the likeliest first."""
        starts = sorted(order.index(block.places[0]) for block in found)
        edges = [-n, *starts, len(order)]
        windows: list[tuple[int, ...]] = []
        for before, after in pairwise(edges):
            begin, end = before + n, after
            # columns before the first block end with it, all others follow one
            begin = begin + (end - begin) % n if before < 0 else begin
            windows += [order[s : s + n] for s in range(begin, end - n + 1, n)]
        position = found[0].places
        # what has two values is a switch
        values = [len(np.unique(column)) for column in self.values.T]
        moving = [w for w in windows if max(values[place] for place in w) > 2]
        # a torque moves the arm or follows from its motion
        moving.sort(key=lambda window: -self._explained(position, window))
        return [self._other(window, position) for window in moving]

    def _explained(self, position: tuple[int, ...], window: tuple[int, ...]) -> float:
        """Share of the variance of a block that the motion of each column's own joint explains [1]."""
        shares = []
        for p, w in zip(position, window, strict=True):
            q, y = self.values[:, p], self.values[SPAN:-SPAN, w]
            speed = (q[2 * SPAN :] - q[: -2 * SPAN]) / 2
            bend = q[2 * SPAN :] - 2 * q[SPAN:-SPAN] + q[: -2 * SPAN]
            own = (np.ones_like(y), q[SPAN:-SPAN], speed, np.sign(speed), bend)
            columns = np.column_stack(own)
            left = y - columns @ np.linalg.lstsq(columns, y, rcond=None)[0]
            shares.append(1 - left.var() / max(y.var(), 1e-300))
        return float(np.mean(shares))

    def _other(self, window: tuple[int, ...], position: tuple[int, ...]) -> _Block:
        """A block that no derivative tells."""
        x = self.values[:, list(window)]
        if self._like(position, window):
            return _Block("reference position", window, "like what was measured")
        if x.min() > WARM[0] and x.max() < WARM[1]:
            why = f"{x.min():.3g} to {x.max():.3g} on all joints"
            return _Block("temperature", window, why)
        why = "what is left beside the motion"
        why += "; with --robot gravity tells more" if self.arm is None else ""
        return _Block("torque", window, why)
