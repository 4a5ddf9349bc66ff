"""Values of nonlinear parameters that a contrast looks at first: those by which a group's own effect explains most.

Each value of the grid of a law has columns, that may be a group's own or everybody's; the information on them beside
all that is shared gives its evidence. A term is charged what it takes to say which value it is:
the log of the number of values over those that do about as well.
"""

from __future__ import annotations

import itertools
from collections.abc import Collection, Mapping, Sequence
from functools import cache
from typing import NamedTuple

import numpy as np

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.effect import (
    Drift,
    Effect,
    External,
    Path,
    Signals,
    TorqueLaw,
    Transmission,
)
from gapscope.effects.parametrisation import JointSeries
from gapscope.model.conditioning import low_pass
from gapscope.model.contrast import SIZES, OwnTerms, of_widths
from gapscope.model.design import MIN_TORQUE, FreeArm
from gapscope.model.jacobian import MAX_NUMBERS
from gapscope.model.rows import DecimatedSegments, Rows
from gapscope.model.terms import Candidate, Term, Terms

WINDOW_EDGES = 40
"""Edges between which windows of a force are tried. (budget)"""
UNKNOWN = 0.01
"""Odds of something that the catalogue does not have, over none [1]."""
FINER = 8
"""Steps by which their distance is divided about the edges of the best window. (budget)"""
MIN_WINDOW = 0.05
"""Bins of a window are no shorter [s]."""


class JointSignals(NamedTuple):
    """What the laws on one joint may depend on, on one segment, (N, 1) each.

    Attributes:
        t: time since the start of the recording [s].
        position, velocity: [rad], [rad/s].
        recorded: torque [N m].
        load: torque that the arm predicts [N m].
        friction: its friction as if it did not drift [N m].
    """

    t: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    recorded: np.ndarray
    load: np.ndarray
    friction: np.ndarray


def unit_columns(
    effect: Effect, values: np.ndarray, signals: JointSignals
) -> np.ndarray:
    """Torque of an effect of unit coordinates for each value of (K,) of its nonlinear parameter [N m], (N, K c).

    Raises:
        KeyError: no law of its kind has a nonlinear parameter on a joint.
    """
    columns = []
    for unit in np.eye(effect.fitted.linear):
        x = np.repeat(unit[:, None], len(values), axis=1)
        by_name = effect.fitted.values(x, values[None])
        parameters = [by_name.get(p.name, p.absent) for p in effect.parameters]
        if isinstance(effect, Path):
            u = signals.recorded
            torque = effect.applied(u, signals, *parameters) - u
        elif isinstance(effect, Drift):
            torque = signals.friction * effect.change(signals.t, *parameters)
        elif isinstance(effect, TorqueLaw):
            state = signals.t, signals.position, signals.velocity, signals.load
            torque = effect.law(Signals(*state), *parameters)
        else:
            raise KeyError(f"{effect.name} has no nonlinear parameter on a joint")
        # a law need not depend on every signal: all have the same shape here
        columns.append(np.broadcast_to(torque, (len(signals.t), len(values))))
    return np.stack(columns, axis=2).reshape(len(signals.t), -1)


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
        corrected = arm.corrected(Terms(arm.arm.n_joints, {}, arm.arm.coupled_motors))
        friction = tuple(e for e in corrected.effects if e.effect.family == "friction")
        rubbing = CorrectedArm(arm.arm, friction)
        for segment in rows.segments:
            motion, body = segment.motion, segment.bodies(arm.bodies)
            # a limit does not change what is needed
            self._load.append(corrected.unlimited.predict(body, motion))
            none = np.zeros_like(motion.q)
            # friction by itself, on bodies that need nothing
            self._friction.append(rubbing.needed_torque(none, motion))

    def scan(
        self,
        own: OwnTerms,
        chosen: Sequence[Candidate],
        shapes: Mapping[Term, tuple[float, ...]],
        given: Collection[Term] = (),
    ) -> dict[Term, Found]:
        """The best values of every term that has nonlinear parameters.

        Args:
            own: of the group.
            chosen: terms that the group has; each is looked at beside the others.
            shapes: values of these.
            given: terms whose values are given.
        """
        found: dict[Term, Found] = {}
        without_form = cache(_without_form)
        for term in own.design.terms.all:
            if not term.parametrisation.nonlinear or term in given:
                continue
            others = [one for one in chosen if one.term != term and own.has(one.term)]
            if isinstance(term.definition, External):
                best = self._window(own, others)
            else:
                # about its value if it is in use, else on the whole grid
                in_use = any(one.term == term for one in chosen)
                known = shapes[term][0] if in_use and term in shapes else None
                # what a limit takes comes with the motion: as long as it is unknown, it passes for form error
                limits = term.definition.limits
                asked = without_form(own) if limits else own
                best = self._on_joint(term, asked, others, known)
            if best is not None:
                found[term] = best
        return found

    @property
    def _mine(self) -> np.ndarray:
        """Rows on which effects are looked for."""
        group = self.rows.group
        return np.flatnonzero((group == self.group) | (self.group is None))

    def _on_joint(
        self,
        term: Term,
        own: OwnTerms,
        others: Sequence[Candidate],
        known: float | None,
    ) -> Found | None:
        """The best value of a term's parameter on a joint."""
        fitted, j, segments = term.parametrisation, term.joint - 1, self.rows.segments
        series = JointSeries(
            [s.motion.t for s in segments],
            [s.motion.q[:, j] for s in segments],
            [s.motion.dq[:, j] for s in segments],
            [s.recorded_torque[:, j] for s in segments],
            float(self.arm.arm.per_radian[j]),
        )
        grid = fitted.grid
        assert grid is not None

        def asked(about: float | None) -> tuple[np.ndarray, np.ndarray]:
            """Values, of the whole range or about one, and their evidence."""
            values = grid(series, about)
            if fitted.possible is not None and len(values):
                # of limits: else to call most of a torque lost would explain any gap
                needed = np.concatenate([load[:, j] for load in self._load])
                recorded = np.concatenate(series.recorded)
                values = values[fitted.possible(values, recorded, needed)]
            if not len(values):
                return values, values
            x = self._columns_of(term, values, known)
            return values, self._gains(term, own, others, x, values)

        about, most = known, -np.inf
        while True:
            values, gain = asked(about)
            if not len(values):
                return None
            best = int(np.argmax(gain))
            at_end = about is not None and best in (0, len(values) - 1)
            # what is best at the end of the values about a known one may be better beyond
            if not at_end or gain[best] <= most:
                break
            about, most = float(values[best]), float(gain[best])
        # what all beyond a limit would make worse at any value was not lost
        if term.definition.limits and gain[best] <= 0:
            return None
        value = _peak(values, gain, best)
        return Found((value,), (_spread(values, value, gain),), _charge(gain))

    def _columns_of(
        self, term: Term, values: np.ndarray, known: float | None
    ) -> np.ndarray:
        """Columns of each value, side by side, over the joint's scale, (M, K c); those of first values are kept."""
        j, rows = term.joint - 1, self.rows
        weight = rows.trust[:, j, None] / rows.scale[j]
        if known is not None or term.definition.limits:
            return self._by_law(term, values) * weight
        # what follows from the recordings alone is the same about every arm
        if term not in rows.first_columns:
            alone = self._by_law(term, values, alone=True)
            # what is not a number shows in the torque of a law that depends on the arm
            known_alone = bool(np.isfinite(alone).all())
            rows.first_columns[term] = alone if known_alone else None
        kept = rows.first_columns[term]
        if kept is not None:
            return kept * weight
        if term not in self._columns:
            self._columns[term] = self._by_law(term, values) * weight
        return self._columns[term]

    def _by_law(
        self, term: Term, values: np.ndarray, *, alone: bool = False
    ) -> np.ndarray:
        """Columns of each value, side by side [N m], (M, K c).

        Args:
            term: the term.
            values: of its parameter, (K,).
            alone: without what an arm's effects change, which is not a number: torque, friction and, as a zero that is
                off shifts the phase of what acts on the way to the joint and more of other laws, the position of those.
        """
        effect, j, rows = term.definition, term.joint - 1, self.rows
        parts: list[list[np.ndarray]] = [[] for _ in rows.segments]
        # what acts on the way to the joint shows on all rows
        sparse = alone and isinstance(effect, Path) and not effect.limits
        for k, segment in enumerate(rows.segments):
            step, rate, motion = rows.step(segment), segment.motion.rate, segment.motion
            # many columns are computed on a divisor of all steps that leaves four times the band
            most = max(1, int(rate // (4 * rows.cutoff))) if sparse else 1
            stride = max(k for k in range(1, most + 1) if step % k == 0)
            at = np.s_[::stride, j, None]
            series = (motion.q, motion.dq, segment.recorded_torque)
            signals = JointSignals(
                motion.t[::stride, None],
                *(x[at] for x in (*series, self._load[k], self._friction[k])),
            )
            # what depends on the arm comes out as no number, and says so by that
            if alone:
                unknown = np.full_like(signals.load, np.nan)
                signals = signals._replace(load=unknown, friction=unknown)
                if not isinstance(effect, Path):
                    signals = signals._replace(position=unknown)
            # as many at once as memory allows
            count = len(signals.t) * len(values) * len(term.columns)
            for some in np.array_split(values, -(-count // MAX_NUMBERS)):
                own = unit_columns(effect, some, signals)
                if alone and not np.isfinite(own).all():
                    return np.full((1, 1), np.nan)
                if sparse:
                    kept = low_pass(own, rate / stride, rows.cutoff)
                    taken = np.arange(len(motion.t))[rows.taken(segment)] / stride
                    places = np.minimum(np.round(taken).astype(int), len(kept) - 1)
                    # single precision halves the memory of many columns
                    parts[k].append(kept[places].astype(np.float32))
                else:
                    parts[k].append(rows.thin(own, segment))
        return np.concatenate([np.hstack(own) for own in parts])

    def _gains(
        self,
        term: Term,
        own: OwnTerms,
        others: Sequence[Candidate],
        x: np.ndarray,
        values: np.ndarray,
    ) -> np.ndarray:
        """Log evidence of values of a term, a group's own or everybody's, by columns (M, K c), beside other terms."""
        contrast, design, j = own.contrast, own.design, term.joint - 1
        error, count = contrast.error, term.parametrisation.linear
        noise2, active, k = error.noise2[j], design.active[j], x.shape[1] // count

        def split(matrix: np.ndarray) -> np.ndarray:
            return matrix.reshape(len(matrix), k, count)

        # of everybody, and of the group
        gram = np.zeros((2, k, count, count))
        right = np.zeros((2, x.shape[1]))
        cross = np.zeros((contrast.groups, design.size, x.shape[1]))
        for one in contrast.motions[j]:
            rows = one.cell.rows
            own_rows = x[rows]
            products = design.columns[j][rows].T @ own_rows / noise2
            inner = one.inner(products)
            pull = own_rows.T @ contrast.gap[rows, j] / noise2 - inner.T @ one.right
            if term.definition.limits:
                # the noise of the torque that is beyond a limit is in the gap as well
                beyond = np.abs(self.rows.torque[rows, j, None]) > values
                pull -= error.white2[j] * beyond.sum(axis=0) / noise2
            # every motion says something of everybody, one of the group of both
            who = slice(None) if one.cell.group == self.group else slice(1)
            gram[who] += _squares(split(own_rows)) / noise2 - _squares(split(inner))
            right[who] += pull
            cross[one.cell.group, active] += products - one.cross.T @ inner
        sides = [(gram[0], right[0], cross)]
        if self.group is not None:
            cross_group = np.zeros_like(cross)
            cross_group[self.group] = cross[self.group]
            sides.append((gram[1], right[1], cross_group))
        size = np.sqrt((x**2).mean(axis=0)).reshape(k, count)
        # a value whose columns vanish explains nothing
        shown = size.min(axis=1) > MIN_TORQUE
        unit, gains = 1.0 / np.maximum(size, MIN_TORQUE), []
        for squares, pull, products in sides:
            back = contrast.nuisance_rows(products)
            inner, solved = own.of_others(others, products, back)
            squares = squares - _squares(split(back)) - _squares(split(inner))
            pull = pull - back.T @ contrast.solved - inner.T @ solved
            if term.definition.limits:
                # a limit has no size of its own: all that is beyond it is missing from what is needed
                gains.append(-pull - squares[:, 0, 0] / 2)
            else:
                gains.append(_evidence(squares, pull.reshape(k, count), unit))
        # what both have is no difference: the value may be that of either
        return np.where(shown, np.nan_to_num(np.max(gains, axis=0)), 0.0)

    def _window(self, own: OwnTerms, others: Sequence[Candidate]) -> Found | None:
        """The window in which a force explains most, its edges looked for once more by finer steps."""
        rows, mine, contrast = self.rows, self._mine, own.contrast
        begin, end = rows.t[mine].min(), rows.t[mine].max()
        width = max((end - begin) / WINDOW_EDGES, MIN_WINDOW)
        bins = int(np.ceil((end - begin) / width + 1e-9))
        edges, spans = begin + width * np.arange(bins + 1), _spans(bins)
        if not len(spans[0]):
            return None
        gain = self._of_forces(own, others, edges, spans)
        # something unknown on one joint for a while is no push
        column, alone = self._in_bins(np.ones((len(rows.t), 1)), edges), []
        none, joints = np.zeros_like(column), range(rows.trust.shape[1])
        for j in joints:
            trusted = column * rows.trust[:, j, None]
            columns = [trusted if i == j else none for i in joints]
            torque = contrast.beside(columns)
            alone.append(_of_spans(torque.gram, torque.right, spans, np.ones(1)))
        every = np.concatenate(alone)
        evidence = float(np.logaddexp.reduce(every) - np.log(len(every)))
        # a push is charged what something unknown on one joint is worth by its odds
        unknown, charge = max(evidence + float(np.log(UNKNOWN)), 0.0), _charge(gain)
        if gain.max() > charge + unknown:
            finer = width * np.linspace(-1.0, 1.0, 2 * FINER + 1)
            near = [edges[some[gain.argmax()]] + finer for some in spans]
            every_edge = np.concatenate([*near, edges[[0, -1]]])
            edges = np.unique(every_edge.clip(edges[0], edges[-1]))
            both = [np.searchsorted(edges, x.clip(edges[0], edges[-1])) for x in near]
            # each edge may lie within two steps: so many of all windows are looked at once more
            share = 2.0**2 / len(gain)
            spans = _ordered(*both)
            gain = self._of_forces(own, others, edges, spans)
            charge = _charge(gain) - float(np.log(share))
        ends = [edges[some] for some in spans]
        return Found(
            tuple(float(times[gain.argmax()]) for times in ends),
            tuple(_spread(times, times[gain.argmax()], gain) for times in ends),
            charge + unknown,
        )

    def _of_forces(
        self,
        own: OwnTerms,
        others: Sequence[Candidate],
        edges: np.ndarray,
        spans: tuple[np.ndarray, np.ndarray],
    ) -> np.ndarray:
        """Log evidence of a force in each window between edges [s], (K,).

        What a window needs is a sum over its bins, whose products with all else are computed once.
        """
        rows, mine, contrast = self.rows, self._mine, own.contrast
        # what a force from outside does the motors need not
        force = -rows.rows([bodies.force for bodies in own.design.bodies])
        force = force / rows.scale[:, None] * rows.trust[:, :, None]
        size = np.sqrt((force[mine] ** 2).mean(axis=0)).max(axis=0) + MIN_TORQUE**2
        columns = [self._in_bins(x, edges) for x in np.moveaxis(force, 1, 0)]
        further = contrast.beside(columns)
        inner, solved = own.of_others(others, further.cross, further.back)
        gram = further.gram - inner.T @ inner
        return _of_spans(gram, further.right - inner.T @ solved, spans, 1.0 / size)

    def _in_bins(self, series: np.ndarray, edges: np.ndarray) -> np.ndarray:
        """A series, (M, c), with each row of the group in the columns of its own bin, (M, bins c)."""
        bins, mine = len(edges) - 1, self._mine
        place = np.searchsorted(edges, self.rows.t[mine], side="right") - 1
        out = np.zeros((len(series), bins, series.shape[1]))
        out[mine, place.clip(0, bins - 1)] = series[mine]
        return out.reshape(len(series), -1)


def _spans(bins: int) -> tuple[np.ndarray, np.ndarray]:
    """First bin of each window, and the one after its last: all windows of two bins or more but the whole."""
    first, last = _ordered(np.arange(bins), np.arange(bins + 1))
    apart = (last - first >= 2) & (last - first < bins)
    return first[apart], last[apart]


def _ordered(first: np.ndarray, last: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """All pairs of which the second is larger."""
    both = np.array(np.meshgrid(first, last)).reshape(2, -1)
    one, other = both[:, both[0] < both[1]]
    return one, other


def _of_spans(
    gram: np.ndarray,
    right: np.ndarray,
    spans: tuple[np.ndarray, np.ndarray],
    unit: np.ndarray,
) -> np.ndarray:
    """Log evidence of each window, whose columns are sums of those of its bins, c in each: (K,)."""
    count = len(unit)
    bins = len(right) // count
    # sums up to the edge before each bin: those of a window are differences
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
    """Log evidence of K candidates of c coordinates, each of its likeliest size, (K,).

    Args:
        gram, right: information, (K, c, c) and (K, c).
        unit: of the coordinates, (c,) or (K, c).
    """
    sizes = np.array(SIZES)[:, None, None]
    evidence, *_ = of_widths(
        gram, right, np.broadcast_to(sizes * unit, (len(SIZES), *right.shape))
    )
    return np.asarray(evidence.max(axis=0))


def _charge(gain: np.ndarray) -> float:
    """What it takes to say which of some values it is, by their evidence [nats]."""
    return float(gain.max() - np.logaddexp.reduce(gain) + np.log(len(gain)))


def _squares(columns: np.ndarray) -> np.ndarray:
    """Sums over rows of the products of each candidate's columns, (M, K, c): (K, c, c)."""
    parts = np.moveaxis(columns, 2, 0)
    of_pairs = [[(a * b).sum(axis=0) for a in parts] for b in parts]
    return np.array(of_pairs).T


def _spread(values: np.ndarray, best: float, gain: np.ndarray) -> float:
    """Deviation of a value from the best one of those tried, each as likely as its evidence says.

    No less than what the distance between those tried leaves open: that of a uniform distribution.
    """
    weight = np.exp(gain - np.logaddexp.reduce(gain))
    step = np.diff(np.unique(values))
    least = float(step.min()) / np.sqrt(12.0) if len(step) else 0.0
    return float(np.hypot(np.sqrt(weight @ (values - best) ** 2), least))


def _without_form(own: OwnTerms) -> OwnTerms:
    """The same beside what is shared and noise alone, without functions and form error."""
    contrast = own.contrast
    prior = contrast.design.prior.copy()
    for place in itertools.chain.from_iterable(contrast.design.waves):
        prior[place] = 0.0
    return own.within(contrast.without_form(contrast.error.noise2, prior))


def _peak(values: np.ndarray, gain: np.ndarray, best: int) -> float:
    """The best value, moved to the peak of the parabola through its neighbours."""
    value = float(values[best])
    # where nothing is explained there is no peak
    if not 0 < best < len(values) - 1 or gain[best] < 1.0:
        return value
    below, above = values[best - 1] - value, values[best + 1] - value
    if not (below and above):
        return value
    # chords from the best value to its neighbours
    to_below = (gain[best - 1] - gain[best]) / below
    to_above = (gain[best + 1] - gain[best]) / above
    # half the second derivative of the parabola
    curve = (to_above - to_below) / (above - below)
    if curve >= 0:
        return value
    slope = to_above - curve * above
    return value + float(np.clip(-slope / (2 * curve), below, above))


# What compliance of a joint would do to the torque of the bodies, simulated once for all that is asked of it.


class CompliantBodies:
    """The bodies of an arm, and what compliance of one joint would do to their torque.

    A search asks for the same resonances and widths of free play again and again; each is simulated once.

    Args:
        data: the segments.
        body: dynamics of the nominal arm.
        arm: the arm; of its effects only those on the bodies count.

    Attributes:
        torque: torque that the bodies need on each segment [N m], (N, n).
        mass: inertia that each joint moves, mean over the recordings [kg m^2 or kg], (n,).
    """

    def __init__(
        self, data: DecimatedSegments, body: RigidBody, arm: CorrectedArm
    ) -> None:
        self._data, self._unit = data, np.eye(arm.arm.n_joints)
        self.torque, self._matrices = [], []
        for segment in data.segments:
            m, laden = segment.motion, segment.bodies(body)
            self.torque.append(arm.rigid_torque(laden, m))
            self._matrices.append(arm.body(laden).sensitivities(m.q, m.dq, m.ddq))
        inertias = [
            np.diagonal(mass, axis1=1, axis2=2).mean(axis=0)
            for _, _, mass in self._matrices
        ]
        self.mass = np.mean(inertias, axis=0)
        self._known: dict[tuple[str | float, ...], np.ndarray] = {}

    def added(self, effect: Transmission, j: int, x: np.ndarray) -> np.ndarray:
        """What a transmission of one joint, from 0, adds to the torque on the rows of all segments [N m], (M, n).

        Args:
            effect: elasticity, free play or the like.
            j: the joint.
            x: linear coordinates of the effect, (linear,).
        """
        key = (effect.name, j, *x.tolist())
        if key not in self._known:
            values = effect.values_at(x[:, None]).values()
            own = [value * self._unit[j] for value in values]
            every = zip(self._matrices, self._data.segments, self.torque, strict=True)
            added = [
                effect.behind(matrices, s.motion, torque, *own) - torque
                for matrices, s, torque in every
            ]
            self._known[key] = self._data.rows(added).astype(np.float32)
        return self._known[key]
