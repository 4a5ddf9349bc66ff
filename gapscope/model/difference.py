"""What groups of recordings have of their own: the search over sets of terms, about an arm that predicts the others.

A hypothesis is a set of terms that groups have, others that everybody has, and where form error is larger in a group
than where it was learnt: something unknown. Its evidence and its prior odds add up. Each is fitted about its own
values, what is shared and form error stay linear about the arm that predicts. Terms join one by one; when none joins,
each is asked again whether the others do without it, or with another in its place.
"""

from __future__ import annotations

import heapq
import itertools
import math
from collections.abc import (
    Callable,
    Collection,
    Hashable,
    Iterator,
    Mapping,
    Sequence,
)
from dataclasses import dataclass, field, replace
from typing import NamedTuple, TypeVar

import numpy as np
from scipy.special import log_ndtr

from gapscope.arm.dynamics.inertials import inertial_scale
from gapscope.model.contrast import SIZES, Answer, Contrast, Nuisance, OwnTerms
from gapscope.model.design import (
    MAX_KEPT,
    MIN_TORQUE,
    ROUNDS,
    Design,
    FreeArm,
    about,
    design,
    is_day_friction,
    is_link_change,
    lasts,
    moved,
    moving,
    possible,
)
from gapscope.model.equations import (
    SETTLED,
    Equations,
    FormError,
    carried_over,
    learn,
)
from gapscope.model.nonlinear_values import UNKNOWN, Found, Scanner
from gapscope.model.rows import Rows
from gapscope.model.terms import Candidate, Term

K = TypeVar("K", bound=Hashable)
ANY = 0.1
"""Probability that an effect of some name changed, and that one that did acts on one more joint [1]."""
UNUSUAL = 0.1
"""Odds of what belongs to how an arm was built, and does not change by itself, and of a law with a further parameter,
over those of plain effects [1]."""
LESS_COMMON = 0.5
"""Odds of an effect that equals a more common one to first order, over those of that one [1]."""
GROWTHS = (4.0, 16.0, 64.0)
"""By how much its variance grows then [1]: twice the torque, four times and so on."""
REFITTED = 2
"""Candidates of those that promise most that are fitted about their own values. (budget)"""
MAX_TERMS = 18
"""Terms of a set. (budget)"""
LOOKED_AT = 14
"""Candidates that count among the hypotheses that compete. (budget)"""
FAR = 10.0
"""What promises to be worse by more, and not half as good as what it replaces, is not fitted, and values that are that
unlikely cannot be [nats]. (budget)"""
LEAST = 700.0
"""Log odds of what nobody has asked for: as good as none, and yet a number [nats]. (numerical)"""
BEYOND_SATURATION = 1.4
"""Share of what a limit cuts off that was lost, at most [1]: all of it is 1."""

Place = tuple[int, int, int | None]
"""A joint from 0; a group; and one motion of it, or ``None`` for all of them."""


@dataclass(frozen=True)
class Belief:
    """What a question makes likely.

    Attributes:
        any: probability that there is an effect of some name, and that one that is acts on one more joint [1].
        sets: number of sets of groups that may have some of their own [1].
        exchanged: whether a load for another is one of the differences there may be, and not bodies alone.
        least_load: least mass of a load [kg], if an arm can do with it.
        built: odds of what belongs to how an arm was built over those of all else [1].
        least_link: least change of a link, over its own mass or lever [1]: healthy arms differ by less.
    """

    any: float = ANY
    sets: float = 1.0
    exchanged: bool = False
    least_load: float = -np.inf
    built: float = UNUSUAL
    least_link: float = 0.0


@dataclass(frozen=True)
class Fit:
    """One hypothesis, fitted about its own values: what a group has, what everybody has, where form error is larger.

    Attributes:
        chosen: candidates.
        grown: where in a group form error has more variance, and by how much [1].
        answer: evidence and values.
        total: log probability of the data and of the hypothesis [nats], but for a constant, with unknown functions of
            the sizes that suit it.
        sharp: the same with those of the sizes that were learnt.
        levels: the same at each size of what all share, if several are believed.
        contrast: of all groups, about the values of those that have some of their own.
        own: what follows for these groups.
    """

    chosen: tuple[Candidate, ...]
    grown: Mapping[Place, float]
    answer: Answer
    total: float
    contrast: Contrast
    own: OwnTerms
    sharp: float
    better: Fit | None = None
    levels: Mapping[float, Fit] = field(default_factory=dict)

    @property
    def suited(self) -> Fit:
        """The hypothesis with unknown functions of the sizes that suit it."""
        return self.better or self

    @property
    def mine(self) -> list[Candidate]:
        """What groups have of their own."""
        return [one for one in self.chosen if not one.everybody]

    @property
    def values(self) -> dict[Candidate, np.ndarray]:
        """The coordinates of that, (linear,) each."""
        return {one: self.answer.values[one] for one in self.mine}

    @property
    def torque(self) -> np.ndarray:
        """What that does to the torque, over the joints' scale [1], (M, n)."""
        return self.own.torque(self.values)

    @property
    def left(self) -> np.ndarray:
        """What it leaves of the torque, over the joints' scale [1], (M, n): form error and noise."""
        values, made = self.answer.values, self.contrast.design
        shared, _ = self.own.nuisances(values)
        out = self.contrast.gap - self.own.torque(values)
        for j, active in enumerate(made.active):
            out[:, j] -= made.columns[j] @ shared[active]
        return out


class Promise(NamedTuple):
    """What a further candidate makes of a hypothesis, to first order.

    Attributes:
        total: log probability with it [nats].
        one: the candidate.
        value: its coordinates, (linear,).
    """

    total: float
    one: Candidate
    value: np.ndarray


@dataclass(frozen=True)
class Difference:
    """What groups have of their own.

    Attributes:
        fit: the best hypothesis.
        sets: log probability of the best hypothesis with each set of what groups have, over that with none [nats].
        found: nonlinear parameters of the terms that were searched.
        arm: what all groups share.
        odds: prior odds of each candidate of the best hypothesis, alone [nats].
        belief: what was likely beforehand.
    """

    fit: Fit
    sets: Mapping[frozenset[Candidate], float]
    found: Mapping[Term, Found]
    arm: FreeArm
    odds: Mapping[Candidate, float]
    belief: Belief = Belief()

    @property
    def probabilities(self) -> dict[Candidate, float]:
        """Probability of each candidate, summed over the sets that hold it."""
        return self.probabilities_of(lambda one: one)

    def probabilities_of(self, name: Callable[[Candidate], K]) -> dict[K, float]:
        """Probability of each name, summed over the sets that hold a candidate of it."""
        total = float(np.logaddexp.reduce(list(self.sets.values())))
        out: dict[K, float] = {}
        for some, value in self.sets.items():
            for key in {name(one) for one in some}:
                out[key] = out.get(key, 0.0) + float(np.exp(value - total))
        # the sum of rounded shares may be a little more than one
        return {key: min(p, 1.0) for key, p in out.items()}

    def log_odds(self, holds: Callable[[Candidate], bool]) -> float:
        """Log probability of the sets with a candidate of some kind over that of those without [nats]."""
        sides: dict[bool, list[float]] = {True: [], False: []}
        for some, value in self.sets.items():
            sides[any(holds(one) for one in some)].append(value)
        likeliest = max(self.sets.values())
        # neither side is quite empty: the difference of both stays a number
        there, none = (
            np.logaddexp.reduce([*sides[side], likeliest - LEAST])
            for side in (True, False)
        )
        return float(there - none)

    @property
    def shapes(self) -> dict[Term, tuple[float, ...]]:
        """Nonlinear parameters of the terms that were searched."""
        return {term: found.values for term, found in self.found.items()}

    def share(self, one: Candidate) -> np.ndarray:
        """RMS torque that a candidate moves in its group, over the joint's scale [1], (n,)."""
        torque = self.fit.own.torque({one: self.fit.answer.values[one]})
        rows = self.fit.contrast.design.rows
        mine = slice(None) if one.groups is None else np.isin(rows.group, one.groups)
        return np.asarray(np.sqrt((torque[mine] ** 2).mean(axis=0)))


def takeable(
    contrast: Contrast, arm: FreeArm, groups: Collection[int], held: np.ndarray
) -> np.ndarray:
    """Likeliest values of what is shared that an arm can take, by what some groups say, (P,).

    Beside values at a bound the others differ, so that of two effects that do the same none is left behind by one that
    would be beyond it.

    Args:
        contrast: of the groups.
        arm: about which its columns are.
        groups: the groups.
        held: values that are what they are, (P,); not a number for all others.
    """
    held = held.copy()
    while True:
        value = contrast.values_of(groups, held)
        inside = possible(arm, contrast.design, value)
        # what runs into a bound is held there, and the others are fitted again
        beyond = np.isnan(held) & (np.abs(inside - value) > MIN_TORQUE)
        if not beyond.any():
            return inside
        held[beyond] = inside[beyond]


@dataclass
class Search:
    """The search for what groups have of their own.

    Args:
        rows: of all groups.
        arm: that predicts them, or the first one.
        sets: groups whose own terms are looked for, each set of them with one value; of several sets only terms without
            nonlinear parameters.
        taught_by: groups in each of which nothing changes, which teach noise and form error.
        days: share by which their friction differs from that of the others from day to day [1]; 0 if all are of a day,
            on which nothing changes that lasts.
        basis: groups that the arm predicts.
        asked: number of sets of groups that there might be, if not those of ``sets``; 0: those.
        together: groups that differ from the others by the same, each set of them; ``None``: every group by its own.
        free: what else such groups differ by, standard deviations of its coordinates, (linear,).
        taught: noise and form error that were learnt about this arm, and from what, if they are known.
        passing: sets of groups that something has for a while alone.
        found: nonlinear parameters of terms that are not looked for, which groups may have.
    """

    rows: Rows
    arm: FreeArm
    sets: Sequence[tuple[int, ...]]
    taught_by: Collection[int]
    days: float
    basis: tuple[int, ...] = (0,)
    asked: float = 0.0
    together: Sequence[tuple[int, ...]] | None = None
    free: Mapping[Term, np.ndarray] = field(default_factory=dict)
    taught: tuple[FormError, Equations] | None = None
    passing: Collection[tuple[int, ...]] = ()
    found: Mapping[Term, Found] = field(default_factory=dict)
    _found: dict[Term, Found] = field(init=False)
    _charges: dict[Term, float] = field(default_factory=dict)
    _totals: dict[frozenset[Candidate], float] = field(default_factory=dict)
    _contrasts: dict[frozenset[tuple[Place, float]], Contrast] = field(
        default_factory=dict
    )
    _fits: dict[tuple[frozenset[Candidate], frozenset[tuple[Place, float]]], Fit] = (
        field(default_factory=dict)
    )
    # by how much a candidate in the place of another was better than its columns promised, when it was fitted last
    _beyond: dict[tuple[Candidate | None, Candidate], float] = field(
        default_factory=dict
    )
    # the hypothesis of which each term was asked again last
    _settled: Fit | None = None

    def __post_init__(self) -> None:
        """What is given of nonlinear parameters is known from the start."""
        self._found = dict(self.found)

    @property
    def may_be_exchanged(self) -> bool:
        """Whether no group is known to be without load: then groups may differ by a load for another."""
        return not self.days or self.together is not None

    @property
    def belief(self) -> Belief:
        """What the question makes likely."""
        sets = self.asked or len(self.sets)
        return Belief(sets=sets, exchanged=self.may_be_exchanged)

    @property
    def sizes(self) -> tuple[float, ...]:
        """Prior deviations of an effect, in RMS torque over the joint's scale [1]."""
        return SIZES

    @property
    def groups(self) -> list[int]:
        """All groups that may have some of their own."""
        return sorted({group for some in self.sets for group in some})

    def unchanged(self) -> float:
        """Log probability of the data if no group has anything of its own [nats], but for a constant."""
        self._linearise(ROUNDS)
        self._prepare()
        return self._fit((), {}, {}).total

    def step(
        self, known: Mapping[Candidate, np.ndarray], torque: np.ndarray | float
    ) -> tuple[Fit, Fit | None]:
        """What groups have that is known, fitted, and with the candidate that promises most beside it, if any does.

        Args:
            known: with about its values.
            torque: what it does, over the joints' scale, (M, n): it is no form error.
        """
        # once: from look to look the caller moves the arm
        self._linearise(1, torque)
        self._prepare()
        fit = self.with_some(list(known), known)
        one, gain = self._most_promising(fit)
        # form error that is larger may explain it
        if one is not None and gain <= self._larger_error(fit)[1]:
            without = self._with_larger_error(fit)
            other, _ = self._most_promising(without)
            # larger form error of all joints hides a force: that is looked at as well
            force = one if one.term in self.found else other
            either = dict.fromkeys(x for x in (force, other) if x is not None)
            one, least = None, without.total
            # each side with the form error that it needs itself
            for some in either:
                larger = self._fit((*fit.chosen, some), fit.values, {})
                total = self._with_larger_error(larger).total
                if total > least:
                    one, least = some, total
        if one is None:
            return fit, None
        return fit, self._fit((*fit.chosen, one), fit.values, {})

    def with_some(
        self, chosen: Sequence[Candidate], values: Mapping[Candidate, np.ndarray]
    ) -> Fit:
        """The hypothesis with some candidates, less those whose values cannot be, about known values."""
        while True:
            found = self._fit(chosen, values, {})
            weigh = self._weigher(found.own)
            # what cannot be leaves, and the others are fitted again without it
            kept = [one for one in found.mine if weigh.can_be(one, found.answer)]
            if len(kept) == len(found.mine):
                return found
            chosen = kept

    def needed(self, fit: Fit) -> Fit:
        """The hypothesis without what makes it no better, one after the other."""
        for one in fit.mine:
            rest = [other for other in fit.chosen if other != one]
            without = self._fit(rest, fit.values, fit.grown)
            if without.total >= fit.total:
                fit = without
        return fit

    def _most_promising(self, fit: Fit) -> tuple[Candidate | None, float]:
        """The candidate of groups that promises most beside a hypothesis, if any does, and how much [nats]."""
        best = next(self._proposals(fit), None)
        if best is None:
            return None, -np.inf
        # promises hold functions at their learnt sizes, as does what they are held to
        gain = best.total - fit.sharp
        return (best.one if gain > 0 else None), gain

    def promises(self, fit: Fit, sets: Collection[tuple[int, ...]]) -> bool:
        """Whether a candidate of one of some sets of groups promises to make a hypothesis better."""
        promised = itertools.takewhile(
            lambda p: p.total > fit.sharp, self._proposals(fit)
        )
        return any(promise.one.groups in sets for promise in promised)

    def _with_larger_error(self, fit: Fit) -> Fit:
        """The hypothesis with more form error wherever that promises to explain more than it costs."""
        while True:
            more, _ = self._larger_error(fit)
            grown = {**fit.grown, **more}
            larger = self._fit(fit.chosen, fit.values, grown) if more else fit
            if larger.total <= fit.total:
                return fit
            fit = larger

    def unknown_since(self, fit: Fit) -> tuple[float, int, int]:
        """The likeliest more form error of a joint from some group of the last set on.

        Returns:
            Log odds without those of a change at all [nats]; joint from 0; the group.
        """
        promised, found = self._promised(fit), []
        joints = {place[0] for place, _ in promised}
        charge = float(np.log(UNKNOWN / len(joints) / len(GROWTHS)))
        for j, growth in itertools.product(joints, GROWTHS):
            # gains of motions add up: from each group on to the last one
            later = [promised[(j, group, None), growth] for group in self.groups[::-1]]
            odds = np.cumsum(later) + charge
            found += [(o, j, g) for o, g in zip(odds, self.groups[::-1], strict=True)]
        return max(found)

    def _larger_error(self, fit: Fit) -> tuple[dict[Place, float], float]:
        """Where more form error explains more than it costs, each motion once, and about how much in all [nats]."""
        out: dict[Place, float] = {}
        total, promised = 0.0, self._promised(fit)
        for place, growth in sorted(promised, key=lambda one: -promised[one]):
            gain = promised[place, growth] + float(np.log(UNKNOWN))
            if gain <= 0:
                break
            # of a joint and group as a whole, or of some of its motions, but not both
            j, group, motion = place
            same = [other for other in out if other[:2] == (j, group)]
            if not any(motion is None or other[2] in (None, motion) for other in same):
                out[place] = growth
                total += gain
        return out, total

    def run(
        self,
        known: Mapping[Candidate, np.ndarray] | None = None,
        torque: np.ndarray | float = 0.0,
    ) -> Difference:
        """Terms join one by one, each fitted about its own values; then each is asked again.

        Args:
            known: what some groups have in all likelihood, with about its values: ``arm`` predicts beside it.
            torque: what that does, over the joints' scale, (M, n).
        """
        # beside what is known groups are alike, so that each predicts the others
        if known:
            self._linearise(1, torque, alike=True)
        else:
            self._linearise(ROUNDS)
        found = self._found_about_arm()
        if known or self.together or len(self.sets) == 1:
            return found
        # each recording by itself shows most; what it shows has to stand beside what one leaves of another as well
        before: set[Candidate] = set()
        for _ in range(ROUNDS):
            if not found.fit.mine or set(found.fit.mine) == before:
                break
            before = set(found.fit.mine)
            made = found.fit.contrast.design
            shared, _ = found.fit.own.nuisances(found.fit.answer.values)
            # the arm takes what is possible; the rest stays a part of the gap
            self.arm = moved(self.arm, made, possible(self.arm, made, shared))
            self._linearise(1, found.fit.torque, alike=True)
            found = self._found_about_arm()
        return found

    def _found_about_arm(self) -> Difference:
        """The best hypothesis about the arm, and those that compete."""
        best = self._best()
        # sets that were promised compete as well as those that were fitted
        least = self._totals[frozenset()]
        sets = {terms: total - least for terms, total in self._totals.items()}
        odds = {one: self._weigher(best.own).odds([one]) for one in best.mine}
        return Difference(best, sets, dict(self._found), self.arm, odds)

    def _weigher(self, own: OwnTerms) -> Weigher:
        return Weigher(own, self.arm, self._charges, self.belief)

    def _linearise(
        self, times: int, known: np.ndarray | float = 0.0, *, alike: bool = False
    ) -> None:
        """Columns about what all share, noise and form error; the arm moves while that makes it predict better.

        Args:
            times: linearisations, at most.
            known: torque of what groups have of their own, over the joints' scale, (M, n).
            alike: whether they are alike in all else.
        """
        arm, least = self.arm, np.inf
        for count in range(times):
            first = Equations.of(design(self.rows, arm, {}))
            gap = first.design.gap[np.isin(self.rows.group, self.basis)]
            # a product over joints: to halve what is left counts alike on each
            left = float(np.log((gap**2).mean(axis=0) + MIN_TORQUE**2).sum())
            # what is shared stays linear there: columns that cancel lead astray
            if left >= least:
                break
            self.arm, self._about, self._first, least = arm, arm, first, left
            if self.taught is None:
                # rows that say nothing are zero
                gap = first.design.gap - known * (self.rows.measured > 0)
                left_over = replace(first.design, gap=gap)
                beside = Equations.of(left_over) if np.any(known) else first
                self._taught = learn(beside, self.taught_by, alike=alike)
            else:
                # what was learnt of this arm before goes over to these columns by term
                self._taught = carried_over(*self.taught, first)
            # what is known is left out of noise alone: the equations keep the whole gap
            self._first = replace(first, design=self._taught.primed(first.design))
            if count + 1 < times:
                contrast = Contrast(self._first, self._taught, ())
                free = np.full(first.design.size, np.nan)
                value = takeable(contrast, arm, self.basis, free)
                arm = moved(arm, first.design, value)

    def _best(self) -> Fit:
        """The best hypothesis about the arm."""
        self._prepare()
        alone = self.groups[0] if len(self.sets) == 1 else None
        self._scanner = Scanner(self.rows, self.arm, alone)
        # shapes of laws beside nothing first, then beside the first term
        self._look(self._fit((), {}, {}))
        none = self._with_everybody(self._fit((), {}, {}))
        start = self._larger(none)
        if start is not None:
            # beside the first term others look different
            self._look(start)
            none = self._with_everybody(self._fit((), {}, {}))
            start = self._with_everybody(self._fit(start.chosen, start.values, {}))
            start = self._asked_again(start)
        # form error that is larger may explain what an effect explains better, and the other way round
        found = self._with_growth(self._searched(start or none))
        # the same start with something unknown in the place of all terms
        unknown = self._with_growth(none)
        best = max(found, unknown, key=_total)
        best = self._searched(self._asked_again(best)) if best.grown else best
        return best.suited

    def _suited(self, fit: Fit) -> Fit:
        """The hypothesis with unknown functions of the sizes that make the data likeliest beside it."""
        left = fit.contrast.gap - fit.own.torque(fit.answer.values)
        prior = fit.contrast.for_gap(left).likeliest_functions()
        contrast = fit.contrast.with_prior(prior)
        own = fit.own.within(contrast)
        weight, answer = self._weigher(own)(fit.chosen)
        total = contrast.evidence + weight + len(fit.grown) * np.log(UNKNOWN)
        # the sizes that were learnt stay where no others do better
        if total <= fit.sharp:
            return fit
        best = replace(fit, answer=answer, total=total, contrast=contrast, own=own)
        return replace(fit, total=total, better=best)

    def _searched(self, fit: Fit) -> Fit:
        """Terms join as long as that makes the hypothesis better; then each is asked again, and others may join."""
        while True:
            larger: Fit | None = fit
            while larger is not None:
                fit = larger
                many = len(fit.mine) >= MAX_TERMS
                larger = None if many else self._larger(fit)
                larger = larger and self._with_everybody(larger)
            again = self._asked_again(fit)
            if again.total <= fit.total:
                return fit
            fit = again

    def _look(self, fit: Fit) -> None:
        """Look for nonlinear parameters beside what was found, and take the columns anew."""
        own = OwnTerms(fit.contrast, self.sets, sizes=self.sizes)
        found = self._scanner.scan(own, fit.chosen, self._shapes, self.found)
        for term, best in found.items():
            self._found[term] = best
            # a term that is chosen keeps the charge by which it was chosen
            if all(one.term != term for one in fit.chosen):
                self._charges[term] = best.charge
        self._prepare()

    @property
    def _shapes(self) -> dict[Term, tuple[float, ...]]:
        """Nonlinear parameters, by term."""
        return {term: found.values for term, found in self._found.items()}

    def _prepare(self) -> None:
        """Columns about what all share, and what follows for the group, with and without more form error."""
        first, made = self._first.design, self._first.design
        # about this arm and without shapes the columns are there already
        if self._shapes or self._about is not self.arm:
            made = design(self.rows, self.arm, self._shapes, first.units)
        made = self._believed(self._taught.primed(made))
        self._equations = Equations.of(made, self._taught.white2)
        self._error = carried_over(self._taught, self._first, self._equations)
        day = np.zeros(made.size)
        for term, places in made.places.items():
            if is_day_friction(term):
                value = self.arm.theta[term.columns[0]] * made.units[term][0]
                # even within that share to both sides: a third of its square
                day[places] = (self.days * value) ** 2 / 3.0
            if term in self.free:
                day[places] += (self.free[term] * made.units[term]) ** 2
        together = self.together or [(group,) for group in self.groups]
        days = [(some, day) for some in together if self.days]
        self._plain = Contrast(self._equations, self._error, days)
        # what was fitted about other columns does not count any more
        self._contrasts, self._fits, self._beyond = {}, {}, {}
        self._totals = {}
        # what groups have in common with each other and with what is shared, about
        self._kept = max(2, MAX_KEPT // (8 * self._plain.groups * made.size**2))
        self._motions = {
            group: np.unique(self.rows.motion[self.rows.of(group)]).tolist()
            for group in self.groups
        }

    def _believed(self, made: Design) -> Design:
        """The columns of a hypothesis, with what is believed of what all share."""
        return made

    def _contrast(self, grown: Mapping[Place, float]) -> Contrast:
        """The contrast with more form error on some joints."""
        key = frozenset(grown.items())
        if key not in self._contrasts:
            larger: dict[tuple[int, int], float] = {}
            for (joint, group, motion), growth in grown.items():
                for own in self._motions[group] if motion is None else [motion]:
                    # the whole joint and one of its motions may both have grown
                    larger[joint, own] = max(growth, larger.get((joint, own), 1.0))
            last = dict(list(self._contrasts.items())[-self._kept :])
            self._contrasts = {**last, key: self._plain.grown(larger)}
        return self._contrasts[key]

    def _fit(
        self,
        chosen: Sequence[Candidate],
        values: Mapping[Candidate, np.ndarray],
        grown: Mapping[Place, float],
    ) -> Fit:
        """Fit a hypothesis, linearised about its own values."""
        contrast = self._contrast(grown)
        made = contrast.design
        chosen = [one for one in chosen if one.term in made.places]
        key = frozenset(chosen), frozenset(grown.items())
        if key in self._fits:
            return self._fits[key]
        can_be = True
        # first about the given values, then about those that were just found
        for _ in range(ROUNDS):
            start = {
                one: values.get(one, np.zeros(len(made.places[one.term])))
                for one in chosen
                if not one.everybody
            }
            moves = moving(start)
            # how far the moments of a load may go follows from its mass a round before
            asked, columns_of = contrast.further(self._extents(start)), None
            if moves:
                # two loads may differ by what is no body: that has no centre to be linear about
                bodies = {
                    one: x
                    for one, x in start.items()
                    if not one.term.is_load or is_within(one.term, x, 0.0)
                }
                gap, columns = about(made, self.arm, bodies)
                # a compliant joint can be made to swing beyond all numbers: nothing is linear about that
                with np.errstate(over="ignore"):
                    can_be = bool(np.isfinite(np.square(gap)).all())
                if can_be:
                    asked, columns_of = asked.for_gap(gap), columns
            own = OwnTerms(asked, self.sets, columns_of, self.sizes)
            fit = self._weighed(asked, own, chosen, grown)
            values = fit.values
            # another round would say the same
            if not can_be or _settled(values, moves):
                break
        fit = self._counted(fit)
        if not can_be:
            fit = replace(fit, total=-np.inf, sharp=-np.inf)
        self._fits = {**dict(list(self._fits.items())[-self._kept :]), key: fit}
        return fit

    def _extents(self, values: Mapping[Candidate, np.ndarray]) -> list[Nuisance]:
        """Moments of inertia of loads about their centres.

        A body of mass m within r of its centre has moments between -m r^2 and m r^2, each as likely. Two loads that
        differ by a first moment b about the flange have b / r more mass in all, about, than the difference m.
        """
        out = []
        last = 10 * self.arm.body.last_link
        unit = inertial_scale(self.arm.body)[last + 4]
        for one, value in values.items():
            proportions = one.term.parametrisation.proportions
            if not one.term.is_load or proportions is None:
                continue
            moments = np.zeros(self._equations.design.size)
            r = proportions[1]
            mass = np.abs(value[0])
            if self.may_be_exchanged:
                mass += np.linalg.norm(value[1:]) / r
            # ten parameters a link: mass, three first moments, six moments of inertia
            moments[last + 4 : last + 10] = (mass * r**2 / unit) ** 2 / 3.0
            out.append((one.groups or (), moments))
        return out

    def _weighed(
        self,
        contrast: Contrast,
        own: OwnTerms,
        chosen: Sequence[Candidate],
        grown: Mapping[Place, float],
    ) -> Fit:
        weigh = self._weigher(own)
        while True:
            weight, answer = weigh(chosen)
            # what everybody has is there to help: without what cannot be beside the others
            kept = [
                one for one in chosen if not one.everybody or weigh.can_be(one, answer)
            ]
            if len(kept) == len(chosen):
                break
            chosen = kept
        total = contrast.evidence + weight + len(grown) * np.log(UNKNOWN)
        return Fit(tuple(chosen), dict(grown), answer, total, contrast, own, total)

    def _counted(self, fit: Fit) -> Fit:
        """A hypothesis that counts among those that compete, with unknown functions that suit it."""
        fit = self._suited(fit)
        some = frozenset(fit.mine)
        # met about other values or with more form error: the best of them counts
        self._totals[some] = max(fit.total, self._totals.get(some, -np.inf))
        return fit

    def _with_everybody(self, fit: Fit) -> Fit:
        """The hypothesis with what everybody has: it moves no linearisation."""
        while True:
            best = next(self._proposals(fit, everybody=True), None)
            if best is None or best.total <= fit.sharp:
                return fit
            chosen = *fit.chosen, best.one
            # its columns do not depend on values: no fit, the algebra is enough
            larger = self._weighed(fit.contrast, fit.own, chosen, fit.grown)
            larger = self._counted(larger)
            if larger.total <= fit.total:
                return fit
            fit = larger

    def _proposals(self, fit: Fit, *, everybody: bool = False) -> Iterator[Promise]:
        """About the total of the hypothesis with each further candidate whose values can be, the best one first.

        Args:
            fit: the hypothesis.
            everybody: whether the candidates are of everybody, and not of groups.
        """
        others = [
            one
            for one in fit.own.candidates
            if one.everybody == everybody
            and one not in fit.chosen
            and (everybody or self._may_differ(one))
            and not self._is_said(one, fit)
        ]
        # a term may be told only if the data sheet is better than it looks without it; the likeliest comes last
        levels = sorted(fit.levels.values() or [fit], key=lambda level: level.sharp)
        levels = [level for level in levels if np.isfinite(level.sharp)]
        if not (others and levels):
            return
        weigh = self._weigher(fit.own)
        # what everybody has does not make the same name likelier in a group
        names = {one.effect for one in fit.chosen if one.groups is not None}
        # the same for all groups that may have a term
        each_term = {one.term: one for one in others}
        odds = {t: weigh.further(one, names) for t, one in each_term.items()}
        odds_of = np.array([odds[one.term] for one in others])
        added = [x.own.additions(x.chosen, x.answer.sizes, others) for x in levels]
        # summed over levels, about: values that cannot be make it less
        totals = np.array(
            [
                level.sharp - level.answer.evidence + further.evidence + odds_of
                for level, further in zip(levels, added, strict=True)
            ]
        )
        most = np.logaddexp.reduce(totals)
        found: list[tuple[float, int, Promise]] = []
        for k in np.argsort(-most).tolist():
            # none of those that follow is likelier
            while found and -found[0][0] >= most[k]:
                yield heapq.heappop(found)[2]
            total, value = -np.inf, None
            for further, least in zip(added, totals[:, k], strict=True):
                x = further.values[k]
                least += weigh.chance(others[k].term, x, further.deviations[k])
                if np.isfinite(least):
                    total, value = float(np.logaddexp(total, least)), x
            if value is not None:
                heapq.heappush(found, (-total, k, Promise(total, others[k], value)))
        while found:
            yield heapq.heappop(found)[2]

    def _is_said(self, one: Candidate, fit: Fit) -> bool:
        """Whether a hypothesis has the same body by another name: what the last link carries, or that link."""
        last = self.arm.body.last_link + 1

        def is_last(other: Candidate) -> bool:
            return other.term.is_load or other.term.changes_link(last)

        return is_last(one) and any(
            is_last(other)
            and other.term != one.term
            and set(other.groups or ()) & set(one.groups or ())
            for other in fit.chosen
        )

    def _may_differ(self, one: Candidate) -> bool:
        """Whether a group may have a term of its own."""
        term = one.term
        # a load is put down again, a force ends; how drives and links are changes for good
        if term in self.found or one.groups in self.passing:
            return term in self.found or term.is_load
        searched = bool(term.parametrisation.nonlinear)
        if self.together is not None:
            # nothing is built anew, nor bends otherwise; at work a driver may be late from some moment on
            late = self.taught is not None and term.definition.delays
            return not searched and (late or not lasts(term))
        return bool(self.days) or not (lasts(term) or searched)

    def _larger(
        self, fit: Fit, instead_of: Candidate | None = None, known: Fit | None = None
    ) -> Fit | None:
        """The best hypothesis with one more term of the group; ``None`` if none is better.

        Args:
            fit: the hypothesis.
            instead_of: whose place the term takes.
            known: the hypothesis with that one.
        """
        proposed = list(itertools.islice(self._proposals(fit), LOOKED_AT))
        better = self._worth_fitting(fit, proposed[:REFITTED])
        fitted = []
        for promised, one, value in better:
            # about a body that is promised its moment may lie beyond what the search can come back from
            is_body = one.term.is_load or is_link_change(one.term)
            start = fit.values if is_body else {**fit.values, one: value}
            chosen = *fit.chosen, one
            again = known if known and set(known.chosen) == set(chosen) else None
            found = again or self._fit(chosen, start, fit.grown)
            self._beyond[instead_of, one] = found.total - promised
            fitted.append(found)
        best = max(fitted, key=lambda f: f.total, default=None)
        # what is not fitted would be as much more or less than it promises as the best one is
        shift = 0.0
        if best is not None:
            shift = max(best.total, fit.total) - proposed[0].total
            # a hypothesis whose values are out of bounds has no evidence of either kind
            if np.isfinite(best.sharp):
                shift = min(shift, best.total - best.sharp)
        for promised, one, _ in proposed[len(better) :]:
            some = frozenset([*fit.mine, one])
            least = self._totals.get(some, -np.inf)
            self._totals[some] = max(promised + shift, least)
        return best if best is not None and best.total > fit.total else None

    def _worth_fitting(
        self, fit: Fit, proposed: Sequence[Promise]
    ) -> Sequence[Promise]:
        """Those of the candidates that promise most which are fitted."""
        return [p for p in proposed if p.total > fit.sharp]

    def _asked_again(self, fit: Fit) -> Fit:
        """The hypothesis without terms that it does not need, or with better ones in their place."""
        # one that was asked before answers as it did
        settled = fit is self._settled
        while not settled:
            settled = True
            for one in fit.mine:
                better = self._without(fit, one)
                # by more than rounding: two sets might take turns for ever
                if better is not None and better.total > fit.total + 1e-3:
                    fit, settled = better, False
                    break
        self._settled = fit
        return fit

    def _without(self, fit: Fit, one: Candidate) -> Fit | None:
        """The best hypothesis without a candidate, or with another in its place; ``None`` if none may be as good."""
        twins = one, Candidate(one.term, None)
        rest = [other for other in fit.chosen if other not in twins]
        # with its columns as they are, which costs next to nothing
        without = self._weighed(fit.contrast, fit.own, rest, fit.grown)
        proposed = list(itertools.islice(self._proposals(without), LOOKED_AT))
        # what explains half of it to first order may explain all of it about its own values
        lost = max(FAR, (fit.total - without.total) / 2)
        # if it was tried in this place before, it may gain about as much again
        replaced = any(
            other != one
            and total + self._beyond.get((one, other), lost - FAR) + FAR > fit.total
            for total, other, _ in proposed[:REFITTED]
        )
        # a refit may find so much more than columns promise
        if replaced or without.total + FAR > fit.total:
            values = {other: x for other, x in fit.values.items() if other != one}
            without = self._with_everybody(self._fit(rest, values, fit.grown))
            larger = self._larger(without, one, fit)
            return max((f for f in (without, larger) if f), key=_total)
        # it stays, and what was weighed instead competes with it
        competing = {frozenset(without.mine): without.total}
        for total, other, _ in proposed:
            # as far from what it promises as when it was tried; what nobody fitted is not better than what was
            total = min(total + self._beyond.get((one, other), 0.0), fit.total)
            competing.setdefault(frozenset([*without.mine, other]), total)
        for some, total in competing.items():
            self._totals[some] = max(total, self._totals.get(some, -np.inf))
        return None

    def _with_growth(self, fit: Fit) -> Fit:
        """The hypothesis with more form error, on a joint or in a motion, where that explains more than it costs."""
        while True:
            promised = self._promised(fit)
            places = sorted(promised, key=lambda place: -promised[place])[:1]
            tried = [
                self._fit(fit.chosen, fit.values, {**fit.grown, place: growth})
                for place, growth in places
                # what does not promise to be worth its odds is not fitted
                if promised[place, growth] > -np.log(UNKNOWN)
            ]
            best = max(tried, key=lambda f: f.total, default=fit)
            if best.total <= fit.total:
                return fit
            fit = best

    def _promised(self, fit: Fit) -> dict[tuple[Place, float], float]:
        """About what more form error would explain beside the terms found [nats]."""
        left = fit.contrast.gap - fit.own.torque(fit.answer.values)
        asked = fit.contrast.for_gap(left)
        out: dict[tuple[Place, float], float] = {}
        for group in self.groups:
            for (j, motion, growth), gain in asked.growth_gains(group, GROWTHS).items():
                out[(j, group, motion), growth] = gain
                whole = (j, group, None), growth
                # motions are independent: the group as a whole gains their sum
                out[whole] = out.get(whole, 0.0) + gain
        return {key: gain for key, gain in out.items() if key[0] not in fit.grown}


def _total(fit: Fit) -> float:
    return fit.total


def in_a_row(count: int) -> list[tuple[int, ...]]:
    """Sets of groups that may have one value: those that follow on each other, but not all of them."""
    return [
        tuple(range(first, last))
        for first in range(count)
        for last in range(first + 1, count + 1)
        if last - first < count
    ]


class Weigher:
    """Evidence and prior odds of sets of terms.

    Args:
        own: the information on what the group has of its own.
        arm: what all groups share.
        charges: what it takes to say which nonlinear parameters a term has [nats].
        belief: what is likely beforehand.
    """

    def __init__(
        self,
        own: OwnTerms,
        arm: FreeArm,
        charges: Mapping[Term, float],
        belief: Belief,
    ) -> None:
        self._own, self._arm, self._charges, self._belief = own, arm, charges, belief
        self._places: dict[str, int] = {}
        # on how many joints, links or motors each effect could be
        for term in own.design.places:
            self._places[term.effect] = self._places.get(term.effect, 0) + 1
        self._masses = arm.body.inertial_parameters().reshape(-1, 10)[:, 0]

    def __call__(self, terms: Sequence[Candidate]) -> tuple[float, Answer]:
        """Log evidence and odds of a set over none [nats], and its values; minus infinity for values that cannot be."""
        answer = self._own.answer(terms)
        return answer.evidence + self.odds(terms) + self.chances(answer), answer

    def chances(self, answer: Answer) -> float:
        """Log probability that the values of a set can be, each by itself."""
        deviations = answer.deviations
        return sum(
            self.chance(one.term, value, deviations[one])
            for one, value in answer.values.items()
        )

    def odds(self, terms: Sequence[Candidate]) -> float:
        """Log prior odds of a set over none."""
        total = 0.0
        names: set[str] = set()
        for one in terms:
            total += self.further(one, names)
            # a further joint of an effect that a group has is likelier than a first one
            if one.groups is not None:
                names.add(one.effect)
        return total

    def further(self, one: Candidate, names: Collection[str]) -> float:
        """Log prior odds of one more candidate, beside effects of some names."""
        term, belief = one.term, self._belief
        # as likely by any name, and then on any joint
        odds = belief.any / self._places[term.effect]
        if term.effect not in names:
            odds /= len(self._places)
        if not one.everybody:
            odds /= belief.sets
            if term.definition.built_in:
                odds *= belief.built
        if term.parametrisation.nonlinear:
            odds *= UNUSUAL
        if term.definition.near_equivalent:
            odds *= LESS_COMMON
        return math.log(odds) - self._charges.get(term, 0.0)

    def can_be(self, one: Candidate, answer: Answer) -> bool:
        """Whether the value of a candidate can be, in all likelihood."""
        own = answer.deviations[one]
        return self.chance(one.term, answer.values[one], own) > -FAR

    def chance(self, term: Term, value: np.ndarray, std: np.ndarray) -> float:
        """Log probability that coordinates of a term can be: of those that a form forbids, to a standard deviation.

        That no more friction can go than there is cuts off the part of the posterior beyond: what is gone is as likely
        as not to seem less than nothing.
        """
        if term.is_load and self._belief.exchanged:
            return 0.0
        lowest, gone = self._lowest(term), term.parametrisation.data_sheet is not None
        if term.is_load:
            lowest = max(lowest, self._belief.least_load)
        # an estimate at a bound lies beyond it by a deviation now and then
        beyond = not gone and value[0] < lowest - std[0]
        if beyond or not self._has_form(term, value, std):
            return -np.inf
        return float(log_ndtr((value[0] - lowest) / std[0])) if gone else 0.0

    def _has_form(self, term: Term, value: np.ndarray, std: np.ndarray) -> bool:
        """Whether coordinates of a term are those of its law or of a body, to a standard deviation."""
        if term.definition.limits and value[0] > BEYOND_SATURATION + std[0]:
            return False
        if is_link_change(term):
            # a last link that has become heavier carries something; beside a reference one that is lighter carries less
            last = term.joint - 1 == self._arm.body.last_link
            laden = last and (
                value[0] > std[0] or not np.isfinite(self._belief.least_load)
            )
            changed = self._changed(term.joint - 1, value)
            return not laden and changed >= self._belief.least_link
        return is_within(term, value, std)

    def _changed(self, link: int, value: np.ndarray) -> float:
        """Change of a link's mass [kg] and centre [m], over its mass and the lever of that [1], the larger one."""
        # mass and first moment of the link: their ratio is its lever
        mass, moment = inertial_scale(self._arm.body).reshape(-1, 10)[link, :2]
        if not mass:
            return np.inf
        shift = float(np.linalg.norm(value[1:])) * mass / moment
        return max(abs(float(value[0])) / mass, shift)

    def _lowest(self, term: Term) -> float:
        """Least value of the first coordinate of a term."""
        fitted = term.parametrisation
        if fitted.data_sheet is not None:
            # no more friction can go than there is
            return -float(self._arm.theta[term.columns[0]])
        if not callable(fitted.lowest):
            return fitted.lowest
        every = np.asarray(fitted.lowest(self._masses, self._arm.body.last_link))
        return float(every[term.joint - 1] if every.ndim else every)


def is_within(term: Term, value: np.ndarray, std: np.ndarray | float) -> bool:
    """Whether coordinates of a term are within the bounds of its parameters, to a standard deviation."""
    clip = term.parametrisation.clip
    if clip is None:
        return True
    inside = clip(value[:, None])[:, 0]
    return bool((np.abs(inside - value) <= std + 1e-9 * np.abs(value)).all())


def _settled(
    now: Mapping[Candidate, np.ndarray], before: Mapping[Candidate, np.ndarray]
) -> bool:
    return all(
        np.abs(now[one] - value).max() <= SETTLED * np.abs(now[one]).max()
        for one, value in before.items()
    )
