"""Values of nonlinear parameters that a contrast looks at first: those by which a group's own effect explains most.

Each value of the grid of a law has columns, that may be a group's own or everybody's; the information on them beside
all that is shared gives its evidence. A term is charged what it takes to say which value it is:
the log of the number of values over those that do about as well.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.effect import External
from gapscope.effects.parametrisation import JointSeries
from gapscope.model.candidate_columns import JointSignals, unit_columns
from gapscope.model.contrast import SIZES, Contrast, OwnTerms
from gapscope.model.design import FreeArm
from gapscope.model.equations import forward, lower
from gapscope.model.prediction import Prediction
from gapscope.model.rows import Rows
from gapscope.model.terms import Candidate, Term, Terms

WINDOW_EDGES = 40
"""Edges between which windows of a force are tried. (budget)"""
UNKNOWN = 0.01
"""Odds of something that the catalogue does not have, over none [1]."""
MIN_WINDOW = 0.05
"""Bins of a window are no shorter [s]."""


class Found(NamedTuple):
    """The best nonlinear parameters of a term, their deviations, and what it takes to say which [nats]."""

    values: tuple[float, ...]
    deviations: tuple[float, ...]
    charge: float


class Scanner:
    """Tries values of nonlinear parameters on a group.

    Args:
        rows: the rows.
        arm: what all groups share.
        group: whose own effects are looked for; ``None``: those that everybody has.
    """

    def __init__(self, rows: Rows, arm: FreeArm, group: int | None) -> None:
        self.rows, self.arm, self.group = rows, arm, group
        self._columns: dict[Term, np.ndarray] = {}
        # torque and friction that the shared arm predicts on every segment
        self._load, self._friction = [], []
        terms = Terms(self.arm.arm.n_joints, {}, self.arm.arm.coupled_motors)
        corrected = self.arm.corrected(terms)
        friction = tuple(e for e in corrected.effects if e.effect.family == "friction")
        for segment in self.rows.segments:
            body = segment.bodies(self.arm.bodies)
            self._load.append(Prediction.of(corrected, body, segment.motion).torque)
            none = np.zeros_like(segment.motion.q)
            rubbing = CorrectedArm(self.arm.arm, friction)
            self._friction.append(rubbing.needed_torque(none, segment.motion))

    def scan(
        self,
        contrast: Contrast,
        own: OwnTerms,
        chosen: Sequence[Candidate],
        shapes: Mapping[Term, tuple[float, ...]],
        given: Collection[Term] = (),
    ) -> dict[Term, Found]:
        """The best values of every term that has nonlinear parameters.

        Args:
            contrast: of all groups.
            own: of the group.
            chosen: terms that the group has; each is looked at beside the others.
            shapes: values of these.
            given: terms whose values are given.
        """
        found: dict[Term, Found] = {}
        for term in contrast.design.terms.all:
            fitted = term.parametrisation
            if not fitted.nonlinear or term in given:
                continue
            others = [one for one in chosen if one.term != term and own.has(one.term)]
            if isinstance(term.definition, External):
                window = self._window(term, contrast, own, others)
                if window is not None:
                    found[term] = window
                continue
            in_use = any(one.term == term for one in chosen)
            known = shapes[term][0] if in_use and term in shapes else None
            best = self._on_joint(term, contrast, own, others, known)
            if best is not None:
                found[term] = best
        return found

    @property
    def _mine(self) -> np.ndarray:
        """Rows on which effects are looked for."""
        group = self.rows.group
        return np.flatnonzero((group == self.group) | (self.group is None))

    def _series(self, j: int) -> JointSeries:
        segments = self.rows.segments
        return JointSeries(
            [s.motion.t for s in segments],
            [s.motion.q[:, j] for s in segments],
            [s.motion.dq[:, j] for s in segments],
            [s.torque[:, j] for s in segments if s.torque is not None],
            float(self.arm.arm.per_radian[j]),
        )

    def _on_joint(
        self,
        term: Term,
        contrast: Contrast,
        own: OwnTerms,
        others: Sequence[Candidate],
        known: float | None,
    ) -> Found | None:
        """The best value of a term's parameter on a joint."""
        fitted, j = term.parametrisation, term.joint - 1
        series = self._series(j)
        assert fitted.grid is not None
        values = fitted.grid(series, known)
        if fitted.possible is not None and len(values):
            needed = np.concatenate([load[:, j] for load in self._load])
            recorded = np.concatenate(series.recorded)
            values = values[fitted.possible(values, recorded, needed)]
        if not len(values):
            return None
        x = self._columns_of(term, values, known)
        noise = None
        if term.definition.limits:
            # the noise of the torque that is beyond a limit is in the gap as well
            noise = contrast.error.white2[j] * (np.abs(self._recorded(j)) > values)
        gain = _gains(contrast, own, others, j, x, term, self.group, noise)
        best = int(np.argmax(gain))
        value = _peak(values, gain, best)
        charge = float(gain.max() - np.logaddexp.reduce(gain) + np.log(len(gain)))
        return Found((value,), (_spread(values, value, gain),), charge)

    def _recorded(self, j: int) -> np.ndarray:
        """Recorded torque of a joint on the rows [N m], (M, 1)."""
        return self.rows.torque[:, j, None]

    def _columns_of(
        self, term: Term, values: np.ndarray, known: float | None
    ) -> np.ndarray:
        """Columns of each value, side by side, over the joint's scale, (M, K c); those of first values are kept."""
        j, rows = term.joint - 1, self.rows
        weight = rows.trust[:, j, None] / rows.scale[j]
        first = known is None and not term.definition.limits
        # what follows from the recordings alone is the same about every arm
        kept = rows.candidates(self.arm.arm.per_radian).of(term) if first else None
        if kept is not None:
            return kept.columns * weight
        if first and term in self._columns:
            return self._columns[term]
        x = self._about_arm(term, values) * weight
        if first:
            self._columns[term] = x
        return x

    def _about_arm(self, term: Term, values: np.ndarray) -> np.ndarray:
        """Columns of each value, side by side [N m], (M, K c)."""
        j, parts = term.joint - 1, []
        for k, segment in enumerate(self.rows.segments):
            motion = segment.motion
            assert segment.torque is not None
            series = (
                motion.q,
                motion.dq,
                segment.torque,
                self._load[k],
                self._friction[k],
            )
            signals = JointSignals(motion.t[:, None], *(x[:, j, None] for x in series))
            parts.append(
                self.rows.thin(unit_columns(term.definition, values, signals), segment)
            )
        return np.concatenate(parts)

    def _window(
        self, term: Term, contrast: Contrast, own: OwnTerms, others: Sequence[Candidate]
    ) -> Found | None:
        """The window in which a force explains most.

        What a window needs is a sum over its bins, whose products with all else are computed once.
        """
        rows, mine = self.rows, self._mine
        begin, end = rows.t[mine].min(), rows.t[mine].max()
        width = max((end - begin) / WINDOW_EDGES, MIN_WINDOW)
        bins = int(np.ceil((end - begin) / width + 1e-9))
        if bins < 4:
            return None
        force = np.concatenate(
            [
                rows.thin(-rows.bodies[k].force, segment)
                for k, segment in enumerate(rows.segments)
            ]
        )
        force = force / rows.scale[:, None] * rows.trust[:, :, None]
        place = np.clip(((rows.t - begin) / width).astype(int), 0, bins - 1)
        size = np.sqrt((force[mine] ** 2).mean(axis=0)).max(axis=0) + 1e-12
        columns = []
        for joint in range(rows.torque.shape[1]):
            x = np.zeros((len(rows.t), bins, 3))
            x[mine, place[mine]] = force[mine, joint]
            columns.append(x.reshape(len(x), -1))
        further = contrast.beside(columns)
        gram, right = further.gram, further.right
        places = own.joined(others)
        if len(places):
            factor = lower(own.products(places, places))
            known = own.back(places).T @ further.back
            shared = own.products_beside(places, further.cross)
            inner = forward(factor, shared - known)
            gram = gram - inner.T @ inner
            right = right - inner.T @ forward(factor, own.right[places])
        spans = _spans(bins)
        gain = _of_spans(gram, right, spans, 1.0 / size)
        k = int(np.argmax(gain))
        charge = float(gain.max() - np.logaddexp.reduce(gain) + np.log(len(gain)))
        # something unknown on one joint for a while is no push
        alone = self._on_one_joint(contrast, place, bins, spans)
        charge += max(alone + float(np.log(UNKNOWN)), 0.0)
        first, last = spans
        ends = [begin + edges * width for edges in (first, last)]
        return Found(
            tuple(float(edges[k]) for edges in ends),
            tuple(_spread(edges, edges[k], gain) for edges in ends),
            charge,
        )

    def _on_one_joint(
        self,
        contrast: Contrast,
        place: np.ndarray,
        bins: int,
        spans: tuple[np.ndarray, np.ndarray],
    ) -> float:
        """Log evidence of a constant torque on some joint in some window, each as likely [nats]."""
        rows, mine, gains = self.rows, self._mine, []
        column = np.zeros((len(rows.t), bins))
        column[mine, place[mine]] = 1.0
        none = np.zeros_like(column)
        for j in range(rows.torque.shape[1]):
            own = column * rows.trust[:, j, None]
            columns = [own if k == j else none for k in range(rows.torque.shape[1])]
            found = contrast.beside(columns)
            gains.append(_of_spans(found.gram, found.right, spans, np.ones(1)))
        every = np.concatenate(gains)
        return float(np.logaddexp.reduce(every) - np.log(len(every)))


def _spans(bins: int) -> tuple[np.ndarray, np.ndarray]:
    """First bin of each window, and the one after its last: all windows of two bins or more but the whole."""
    first, last = (x.ravel() for x in np.meshgrid(np.arange(bins), np.arange(bins + 1)))
    apart = (last - first >= 2) & (last - first < bins)
    return first[apart], last[apart]


def _of_spans(
    gram: np.ndarray,
    right: np.ndarray,
    spans: tuple[np.ndarray, np.ndarray],
    unit: np.ndarray,
) -> np.ndarray:
    """Log evidence of each window, whose columns are sums of those of its bins, c in each: (K,)."""
    count = len(unit)
    bins = len(right) // count
    up_to = np.zeros((bins + 1, count, bins + 1, count))
    of_bins = gram.reshape(bins, count, bins, count)
    up_to[1:, :, 1:] = of_bins.cumsum(axis=0).cumsum(axis=2)
    pulls = np.zeros((bins + 1, count))
    pulls[1:] = right.reshape(bins, count).cumsum(axis=0)
    first, last = spans
    inside = (
        up_to[last, :, last]
        - up_to[first, :, last]
        - up_to[last, :, first]
        + up_to[first, :, first]
    )
    return _evidence(inside, pulls[last] - pulls[first], unit)


def _evidence(gram: np.ndarray, right: np.ndarray, unit: np.ndarray) -> np.ndarray:
    """Log evidence of K candidates of c coordinates, in the likeliest size, (K,).

    Args:
        gram, right: information, (K, c, c) and (K, c).
        unit: of the coordinates, (c,) or (K, c).
    """
    every = []
    for size in SIZES:
        u = np.broadcast_to(size * unit, right.shape)
        every.append(_log_evidence(gram * u[:, :, None] * u[:, None, :], right * u))
    return np.asarray(np.max(every, axis=0))


def _log_evidence(gram: np.ndarray, right: np.ndarray) -> np.ndarray:
    """The same of coordinates in units of their prior deviations."""
    normal = gram + np.eye(gram.shape[1])
    solved = np.linalg.solve(normal, right[:, :, None])[:, :, 0]
    return (right * solved).sum(axis=1) / 2 - np.linalg.slogdet(normal)[1] / 2


def _squares(columns: np.ndarray) -> np.ndarray:
    """Sums over rows of the products of each candidate's columns, (M, K, c): (K, c, c)."""
    parts = np.moveaxis(columns, 2, 0)
    of_pairs = [[(a * b).sum(axis=0) for a in parts] for b in parts]
    return np.array(of_pairs).T


def _gains(
    contrast: Contrast,
    own: OwnTerms,
    others: Sequence[Candidate],
    j: int,
    x: np.ndarray,
    term: Term,
    group: int | None,
    noise: np.ndarray | None,
) -> np.ndarray:
    """Log evidence of candidates on a joint, a group's own or everybody's, by columns (M, K c), beside other terms."""
    design, noise2 = contrast.design, contrast.error.noise2[j]
    count = term.parametrisation.linear
    active, k = design.active[j], x.shape[1] // count

    def split(matrix: np.ndarray) -> np.ndarray:
        return matrix.reshape(len(matrix), k, count)

    of_all, of_group = np.zeros((k, count, count)), np.zeros((k, count, count))
    right_all, right_group = np.zeros(x.shape[1]), np.zeros(x.shape[1])
    cross = np.zeros((contrast.groups, design.size, x.shape[1]))
    for one in contrast.motions[j]:
        rows, mine = one.cell.rows, one.cell.group == group
        own_rows = x[rows]
        products = design.columns[j][rows].T @ own_rows / noise2
        inner = one.inner(products)
        pull = own_rows.T @ contrast.gap[rows, j] / noise2 - inner.T @ one.right
        if noise is not None:
            pull -= noise[rows].sum(axis=0) / noise2
        gram = _squares(split(own_rows)) / noise2 - _squares(split(inner))
        of_all += gram
        right_all += pull
        if mine:
            of_group += gram
            right_group += pull
        cross[one.cell.group, active] += products - one.cross.T @ inner
    places = own.joined(others)
    factor = lower(own.products(places, places))
    solved = forward(factor, own.right[places])
    sides = [(of_all, right_all, cross)]
    if group is not None:
        cross_group = np.zeros_like(cross)
        cross_group[group] = cross[group]
        sides.append((of_group, right_group, cross_group))
    gains = []
    for gram, right, products in sides:
        back = contrast.nuisance_rows(products)
        known = own.back(places).T @ back
        shared = own.products_beside(places, products)
        inner = forward(factor, shared - known)
        gram = gram - _squares(split(back)) - _squares(split(inner))
        right = right - back.T @ contrast.solved - inner.T @ solved
        gains.append((gram, right.reshape(k, count)))
    size = np.sqrt((x**2).mean(axis=0)).reshape(k, count)
    shown = size.min(axis=1) > 1e-6
    unit = 1.0 / np.maximum(size, 1e-6)
    # what both have is no difference: the value may be that of either
    best = np.max([_evidence(gram, right, unit) for gram, right in gains], axis=0)
    return np.where(shown, np.nan_to_num(best), 0.0)


def _spread(values: np.ndarray, best: float, gain: np.ndarray) -> float:
    """Deviation of a value from the best one of those tried, each as likely as its evidence says.

    No less than what the distance between those tried leaves open: that of a uniform distribution.
    """
    weight = np.exp(gain - np.logaddexp.reduce(gain))
    step = np.diff(np.unique(values))
    least = float(step.min()) / np.sqrt(12.0) if len(step) else 0.0
    return float(np.hypot(np.sqrt(weight @ (values - best) ** 2), least))


def _peak(values: np.ndarray, gain: np.ndarray, best: int) -> float:
    """The best value, moved to the peak of the parabola through its neighbours."""
    value = float(values[best])
    if not 0 < best < len(values) - 1 or gain[best] < 1.0:
        return value
    below, above = values[best - 1] - value, values[best + 1] - value
    if not (below and above):
        return value
    # chords from the best value to its neighbours
    to_below = (gain[best - 1] - gain[best]) / below
    to_above = (gain[best + 1] - gain[best]) / above
    curve = (to_above - to_below) / (above - below)
    if curve >= 0:
        return value
    slope = to_above - curve * above
    return value + float(np.clip(-slope / (2 * curve), below, above))
