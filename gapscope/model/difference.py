"""What one group of recordings has of its own: the search over sets of terms, about an arm that predicts the others.

A hypothesis is a set of terms that the group has, others that everybody has, and where form error is larger in the
group than where it was learnt: something unknown. Its evidence and its prior odds add up. Each is fitted about its own
values, what is shared and form error stay linear about the arm that predicts. Terms join one by one; when one has
joined, each is asked again whether the others do without it, or with another in its place.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from gapscope.model.contrast import Answer, Candidate, Contrast, OwnTerms
from gapscope.model.design import (
    FreeArm,
    about,
    design,
    is_link_change,
    moved,
    moves_columns,
)
from gapscope.model.equations import Equations
from gapscope.model.form_error import carried_over, learn
from gapscope.model.nonlinear_values import UNKNOWN, Scanner
from gapscope.model.rows import Rows
from gapscope.model.terms import Term

ANY = 0.1
"""Probability that an effect of some name changed, and that one that did acts on one more joint [1]."""
UNUSUAL = 0.1
"""Odds of what belongs to how an arm was built, and does not change by itself, and of a law with a further parameter,
over those of plain effects [1]."""
LESS_COMMON = 0.5
"""Odds of an effect that equals a more common one to first order, over those of that one [1]."""
GROWTHS = (4.0, 16.0, 64.0)
"""By how much its variance grows then [1]: twice, four and eight times the torque."""
LINEARISATIONS = 3
"""Linearisations of what all share. (budget)"""
REFITS = 3
"""Linearisations of a hypothesis. (budget)"""
REFITTED = 2
"""Candidates of those that promise most that are fitted about their own values. (budget)"""
MOST_TERMS = 12
"""Terms of a set. (budget)"""
LOOKED_AT = 14
"""Candidates that count among the hypotheses that compete. (budget)"""
SETTLED = 0.02
"""Values that change by less from one linearisation to the next stay [1]."""
BEYOND_SATURATION = 1.4
"""Share of what a limit cuts off that was lost, at most [1]: all of it is 1."""

Place = tuple[int, int | None]
"""A joint from 0, and one motion of the group, or ``None`` for all of them."""


@dataclass(frozen=True)
class Fit:
    """One hypothesis, fitted about its own values: what a group has, what everybody has, where form error is larger.

    Attributes:
        chosen: candidates.
        grown: of joints from 0, and of all motions of the group or one, by how much more variance form error has [1].
        answer: evidence and values.
        total: log probability of the data and of the hypothesis [nats], but for a constant.
        contrast: of all groups, about the values of the group.
        own: what follows for the group.
    """

    chosen: tuple[Candidate, ...]
    grown: Mapping[Place, float]
    answer: Answer
    total: float
    contrast: Contrast
    own: OwnTerms

    @property
    def terms(self) -> list[Term]:
        """The terms that the group has of its own."""
        return [one.term for one in self.chosen if not one.everybody]

    @property
    def values(self) -> dict[Term, np.ndarray]:
        """Their coordinates, (linear,) each."""
        return {
            one.term: self.answer.values[one]
            for one in self.chosen
            if not one.everybody
        }


@dataclass(frozen=True)
class Difference:
    """What a group has of its own.

    Attributes:
        group: the group.
        fit: the best hypothesis.
        probabilities: of each term, summed over the hypotheses that compete.
        sets: log probability of the best hypothesis with each set of terms of the group, over that with none [nats].
        shapes: nonlinear parameters of the terms found.
        arm: what all groups share.
    """

    group: int
    fit: Fit
    probabilities: Mapping[Term, float]
    sets: Mapping[frozenset[Term], float]
    shapes: Mapping[Term, tuple[float, ...]]
    arm: FreeArm

    @property
    def terms(self) -> list[Term]:
        """The terms that the group has of its own."""
        return self.fit.terms

    def value(self, term: Term) -> np.ndarray:
        """Coordinates of one of them, (linear,)."""
        return self.fit.answer.values[Candidate(term)]

    def share(self, term: Term) -> np.ndarray:
        """RMS torque that a term moves in its group, over the joint's scale [1], (n,)."""
        torque = self.fit.own.torque({Candidate(term): self.value(term)})
        mine = self.fit.contrast.design.rows.of(self.group)
        return np.asarray(np.sqrt((torque[mine] ** 2).mean(axis=0)))


@dataclass
class Search:
    """The search for what a group has of its own.

    Args:
        rows: of all groups.
        arm: that predicts the first one.
        group: whose own terms are looked for.
        taught_by: groups in which nothing changes, which teach noise and form error.
        days: share by which friction differs from day to day [1].
    """

    rows: Rows
    arm: FreeArm
    group: int
    taught_by: Collection[int]
    days: float
    _shapes: dict[Term, tuple[float, ...]] = field(default_factory=dict)
    _charges: dict[Term, float] = field(default_factory=dict)
    _totals: dict[frozenset[Term], float] = field(default_factory=dict)

    def run(self) -> Difference:
        """Terms join one by one, each fitted about its own values; then each is asked again."""
        for step in range(LINEARISATIONS):
            self._first = Equations.of(design(self.rows, self.arm, {}))
            self._taught = learn(self._first, self.taught_by)
            if step < LINEARISATIONS - 1:
                shared = Contrast(self._first, self._taught, {}, {})
                value = shared.values_of(self.taught_by)
                self.arm = moved(self.arm, self._first.design, value)
        self._scanner = Scanner(self.rows, self.arm, self.group)
        self._prepare()
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
        unknown = self._with_growth(none)
        best = max(found, unknown, key=lambda fit: fit.total)
        if best.grown:
            best = self._searched(self._asked_again(best))
        shapes = {t: self._shapes[t] for t in best.terms if t in self._shapes}
        least = self._totals[frozenset()]
        sets = {terms: total - least for terms, total in self._totals.items()}
        return Difference(
            self.group, best, _probabilities(sets), sets, shapes, self.arm
        )

    def _searched(self, fit: Fit) -> Fit:
        """Terms join as long as that makes the hypothesis better; each is asked again when another has joined."""
        while len(fit.terms) < MOST_TERMS:
            larger = self._larger(fit)
            if larger is None:
                break
            fit = self._asked_again(self._with_everybody(larger))
        return fit

    def _look(self, fit: Fit) -> None:
        """Look for nonlinear parameters beside what was found, and take the columns anew."""
        own = OwnTerms(fit.contrast, self.group)
        found = self._scanner.scan(fit.contrast, own, fit.chosen, self._shapes)
        for term, best in found.items():
            self._shapes[term] = best.values
            if all(one.term != term for one in fit.chosen):
                self._charges[term] = best.charge
        self._prepare()

    def _prepare(self) -> None:
        """Columns about what all share, and what follows for the group, with and without more form error."""
        units = self._first.design.units
        made = design(self.rows, self.arm, self._shapes, units)
        self._equations = Equations.of(made, self._taught.white2)
        self._error = carried_over(self._taught, self._first, self._equations)
        self._contrasts: dict[frozenset[tuple[Place, float]], Contrast] = {}
        self._fits: dict[
            tuple[frozenset[Candidate], frozenset[tuple[Place, float]]], Fit
        ] = {}
        self._totals = {}
        self._motions = np.unique(self.rows.motion[self.rows.of(self.group)]).tolist()

    def _contrast(self, grown: Mapping[Place, float]) -> Contrast:
        """The contrast with more form error on some joints."""
        key = frozenset(grown.items())
        if key not in self._contrasts:
            made, day = self._equations.design, np.zeros(self._equations.design.size)
            for term, places in made.places.items():
                if (
                    term.parametrisation.data_sheet is not None
                    and not term.definition.built_in
                ):
                    value = self.arm.theta[term.columns[0]] * made.units[term][0]
                    day[places] = (self.days * value) ** 2 / 3.0
            larger: dict[tuple[int, int], float] = {}
            for (j, motion), growth in grown.items():
                for own in self._motions if motion is None else [motion]:
                    larger[j, own] = max(growth, larger.get((j, own), 1.0))
            self._contrasts[key] = Contrast(
                self._equations, self._error, {self.group: day}, larger
            )
        return self._contrasts[key]

    def _fit(
        self,
        chosen: Sequence[Candidate],
        values: Mapping[Term, np.ndarray],
        grown: Mapping[Place, float],
    ) -> Fit:
        """Fit a hypothesis, linearised about its own values."""
        contrast = self._contrast(grown)
        made = contrast.design
        chosen = [one for one in chosen if one.term in made.places]
        key = frozenset(chosen), frozenset(grown.items())
        if key in self._fits:
            return self._fits[key]
        for _ in range(REFITS):
            own_terms = [one.term for one in chosen if not one.everybody]
            start = {t: values.get(t, np.zeros(len(made.places[t]))) for t in own_terms}
            if any(map(moves_columns, start)):
                there = about(made, self.arm, self.group, start)
                asked = contrast.for_gap(there.gap)
                own = OwnTerms(asked, self.group, there.columns)
            else:
                asked, own = contrast, OwnTerms(contrast, self.group)
            fit = self._weighed(asked, own, chosen, grown)
            before, values = start, fit.values
            if _settled(values, before):
                break
        self._fits[key] = fit
        return fit

    def _weighed(
        self,
        contrast: Contrast,
        own: OwnTerms,
        chosen: Sequence[Candidate],
        grown: Mapping[Place, float],
    ) -> Fit:
        weigh = Weigher(own, self.arm, self._charges)
        weight, answer = weigh(chosen)
        while not np.isfinite(weight):
            # what everybody has is there to help: without what cannot be beside the others
            kept = [
                one for one in chosen if not one.everybody or weigh.can_be(one, answer)
            ]
            if len(kept) == len(chosen):
                break
            chosen = kept
            weight, answer = weigh(chosen)
        total = contrast.evidence + weight + len(grown) * float(np.log(UNKNOWN))
        fit = Fit(tuple(chosen), dict(grown), answer, total, contrast, own)
        terms = frozenset(fit.terms)
        self._totals[terms] = max(total, self._totals.get(terms, -np.inf))
        return fit

    def _with_everybody(self, fit: Fit) -> Fit:
        """The hypothesis with what everybody has: it moves no linearisation."""
        while True:
            proposed = [p for p in self._proposals(fit) if p[1].everybody]
            value, one = max(proposed, key=lambda p: p[0], default=(-np.inf, None))
            if one is None or value <= fit.total:
                return fit
            larger = self._weighed(fit.contrast, fit.own, (*fit.chosen, one), fit.grown)
            if larger.total <= fit.total:
                return fit
            fit = larger

    def _proposals(self, fit: Fit) -> list[tuple[float, Candidate]]:
        """Each further candidate whose values can be, with about the total of the hypothesis with it."""
        weigh = Weigher(fit.own, self.arm, self._charges)
        others = [one for one in fit.own.places if one not in fit.chosen]
        fixed = fit.contrast.evidence + len(fit.grown) * float(np.log(UNKNOWN))
        return [
            (fixed + evidence + weigh.odds([*fit.chosen, one]), one)
            for one, evidence, value, std in fit.own.additions(
                fit.chosen, fit.answer.sizes, others
            )
            if weigh.within(one.term, value, std)
        ]

    def _larger(self, fit: Fit) -> Fit | None:
        """The best hypothesis with one more term of the group; ``None`` if none is better."""
        proposed = [p for p in self._proposals(fit) if not p[1].everybody]
        proposed.sort(key=lambda p: -p[0])
        better = [p for p in proposed[:REFITTED] if p[0] > fit.total]
        fitted = [
            self._fit((*fit.chosen, one), fit.values, fit.grown) for _, one in better
        ]
        best = max(fitted, key=lambda f: f.total, default=None)
        # what is not fitted promises as much less than the best one as it does here
        promised = (
            proposed[0][0] - max(best.total, fit.total) if best and proposed else 0.0
        )
        for value, one in proposed[len(better) : LOOKED_AT]:
            terms = frozenset([*fit.terms, one.term])
            least = self._totals.get(terms, -np.inf)
            self._totals[terms] = max(value - max(promised, 0.0), least)
        return best if best is not None and best.total > fit.total else None

    def _asked_again(self, fit: Fit) -> Fit:
        """The hypothesis without terms that it does not need, or with better ones in their place."""
        settled = False
        while not settled:
            settled = True
            for term in fit.terms:
                rest = [one for one in fit.chosen if one.term != term]
                values = {t: x for t, x in fit.values.items() if t != term}
                without = self._with_everybody(self._fit(rest, values, fit.grown))
                other = self._larger(without)
                better = max((f for f in (without, other) if f), key=lambda f: f.total)
                if better.total > fit.total + 1e-3:
                    fit, settled = better, False
                    break
        return fit

    def _with_growth(self, fit: Fit) -> Fit:
        """The hypothesis with more form error, on a joint or in a motion, where that explains more than it costs."""
        while True:
            promised = self._promised(fit)
            places = sorted(promised, key=lambda place: -promised[place])[:REFITTED]
            tried = [
                self._fit(fit.chosen, fit.values, {**fit.grown, (j, motion): growth})
                for j, motion, growth in places
                if promised[j, motion, growth] > -np.log(UNKNOWN)
            ]
            best = max(tried, key=lambda f: f.total, default=fit)
            if best.total <= fit.total:
                return fit
            fit = best

    def _promised(self, fit: Fit) -> dict[tuple[int, int | None, float], float]:
        """About what more form error would explain beside the terms found [nats]."""
        left = fit.contrast.gap - fit.own.torque(fit.answer.values)
        gains = fit.contrast.for_gap(left).growth_gains(self.group, GROWTHS)
        out: dict[tuple[int, int | None, float], float] = {}
        for (j, motion, growth), gain in gains.items():
            out[j, motion, growth] = gain
            out[j, None, growth] = out.get((j, None, growth), 0.0) + gain
        return {
            (j, motion, growth): gain
            for (j, motion, growth), gain in out.items()
            if (j, motion) not in fit.grown
        }


class Weigher:
    """Evidence and prior odds of sets of terms.

    Args:
        own: the information on what the group has of its own.
        arm: what all groups share.
        charges: what it takes to say which nonlinear parameters a term has [nats].
    """

    def __init__(
        self, own: OwnTerms, arm: FreeArm, charges: Mapping[Term, float]
    ) -> None:
        self._own, self._arm, self._charges = own, arm, charges
        self._places: dict[str, int] = {}
        for term in own.design.places:
            self._places[term.effect] = self._places.get(term.effect, 0) + 1
        self._masses = arm.body.inertial_parameters().reshape(-1, 10)[:, 0]

    def __call__(self, terms: Sequence[Candidate]) -> tuple[float, Answer]:
        """Log evidence and odds of a set over none [nats], and its values; minus infinity for values that cannot be."""
        answer = self._own.answer(terms)
        if not all(self.can_be(one, answer) for one in terms):
            return -np.inf, answer
        return answer.evidence + self.odds(terms), answer

    def odds(self, terms: Sequence[Candidate]) -> float:
        """Log prior odds of a set over none."""
        total, seen = 0.0, set()
        for one in terms:
            term = one.term
            # as likely by any name, and then on any joint
            names = 1 if term.effect in seen else len(self._places)
            total += np.log(ANY / names / self._places[term.effect])
            if term.definition.built_in and not one.everybody:
                total += np.log(UNUSUAL)
            if term.parametrisation.nonlinear:
                total += np.log(UNUSUAL)
            if term.definition.near_equivalent:
                total += np.log(LESS_COMMON)
            total -= self._charges.get(term, 0.0)
            if not one.everybody:
                seen.add(term.effect)
        return float(total)

    def can_be(self, one: Candidate, answer: Answer) -> bool:
        """Whether the value of a candidate can be, to a standard deviation."""
        return self.within(one.term, answer.values[one], answer.deviation(one))

    def within(self, term: Term, value: np.ndarray, std: np.ndarray) -> bool:
        """Whether coordinates of a term can be, to a standard deviation."""
        fitted, lowest = term.parametrisation, self._lowest(term)
        if value[0] < lowest - std[0]:
            return False
        if term.definition.limits and value[0] > BEYOND_SATURATION + std[0]:
            return False
        if fitted.clip is None or is_link_change(term):
            return True
        inside = fitted.clip(value[:, None])[:, 0]
        return bool((np.abs(inside - value) <= std + 1e-9 * np.abs(value)).all())

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


def _settled(now: Mapping[Term, np.ndarray], before: Mapping[Term, np.ndarray]) -> bool:
    return set(now) == set(before) and all(
        np.abs(value - before[term]).max() <= SETTLED * np.abs(value).max()
        for term, value in now.items()
    )


def _probabilities(sets: Mapping[frozenset[Term], float]) -> dict[Term, float]:
    """Probability of each term, summed over the sets that hold it."""
    total = float(np.logaddexp.reduce(list(sets.values())))
    out: dict[Term, float] = {}
    for terms, value in sets.items():
        for term in terms:
            out[term] = out.get(term, 0.0) + float(np.exp(value - total))
    return out
