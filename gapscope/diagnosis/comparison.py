"""What a contrast says of a case: findings with values, what they close, what may be in their place."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from gapscope.arm.recording import Recording
from gapscope.arm.root_mean_square import rms
from gapscope.diagnosis.prepare import Prepared
from gapscope.diagnosis.thresholds import EFFECT_FORM, NAMED_PROBABILITY
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.catalogue import effect as by_name
from gapscope.effects.parameter import Parameter
from gapscope.envs.effect_ranges import Z95
from gapscope.model.contrast import Answer
from gapscope.model.design import MIN_TORQUE
from gapscope.model.difference import Difference, Fit
from gapscope.model.explained import Explained, explained
from gapscope.model.rows import Rows
from gapscope.model.terms import Candidate, Term, Terms

NONE = "none"
"""Name of the alternative that nothing takes the effect's place."""
UNKNOWN_CAUSE = "unknown"
"""Name of what is not among the alternatives."""
LONGER_RECORDING = "a longer recording with more of the motion on which the effect acts"
"""What separates an effect from none."""
IN_TEN = 0.9
"""A finding's names together hold the true one in nine of ten cases. (definition)"""
DRAWS = 400
"""Draws of the values. (budget)"""
GROWTHS = tuple(4.0**k for k in range(1, 7))
"""Growths of form error [1] that are tried in place of a finding: of its torque 2 to 64 times. (budget)"""
SAMPLING_SKEW = 2.5e-4
"""Standard deviation of a skew that sampling leaves between torque and motion [s]: a torque that is held from one tick
of a controller to the next acts half a tick late, which at 1 kHz is twice that. (physical)"""


@dataclass(frozen=True)
class Alternative:
    """An effect in the place of another.

    Attributes:
        effect: its name; ``none`` if nothing takes the place.
        joints: its joints.
        probability: probability that it, and not the effect named, is the cause.
        evidence: log odds against the effect named [nats].
        equivalent: whether it is the same cause by another name: that body, or that torque in all of the motions.
    """

    effect: str
    joints: tuple[int, ...]
    probability: float
    evidence: float
    equivalent: bool = False


@dataclass(frozen=True)
class Comparison:
    """The contrast of a case, n joints.

    Attributes:
        prepared: the case as it is compared.
        difference: what the case has of its own.
        group: its number among the groups of the contrast.
    """

    prepared: Prepared
    difference: Difference
    group: int

    @property
    def fit(self) -> Fit:
        """The best hypothesis."""
        return self.difference.fit

    @property
    def fitted(self) -> Fit:
        """The hypothesis with which values are fitted."""
        return self.fit

    @property
    def rows(self) -> Rows:
        """All rows."""
        return self.fit.contrast.design.rows

    @property
    def set_aside(self) -> list[Recording]:
        """Recordings that are judged and not fitted."""
        return [r for r in self.prepared.case.judged if r.tau is not None]

    @property
    def judged_on(self) -> Rows:
        """The rows on which gaps are measured."""
        return self.rows

    @property
    def terms(self) -> Terms:
        """All terms, with the nonlinear parameters of those that have some."""
        return self.fit.contrast.design.terms

    @cached_property
    def findings(self) -> dict[str, list[Candidate]]:
        """What the case has of its own: the candidates of each finding."""
        found: dict[str, list[Candidate]] = {}
        # in the order in which effects list their joints
        for one in sorted(self.fit.mine, key=lambda one: one.term.joint):
            found.setdefault(one.term.finding, []).append(one)
        return found

    @cached_property
    def probabilities(self) -> dict[str, float]:
        """Probability of each finding, on whatever joints and by whatever name, summed over the sets that compete."""
        found = self.difference.probabilities_of(lambda one: one.term.finding)
        for name in self.findings:
            same = [o for o in self.alternatives(name) if o.equivalent]
            found[name] = min(found[name] + sum(o.probability for o in same), 1.0)
        return found

    @property
    def likely(self) -> tuple[str, ...]:
        """Findings that are more likely than not."""
        return tuple(
            f for f in self.findings if self.probabilities[f] >= NAMED_PROBABILITY
        )

    @cached_property
    def named(self) -> tuple[str, ...]:
        """Findings that are named."""
        return self.likely

    @property
    def possible(self) -> tuple[str, ...]:
        """Findings of the best hypothesis that are not more likely than not."""
        return tuple(f for f in self.findings if f not in self.likely)

    def of(self, names: Collection[str]) -> list[Candidate]:
        """The candidates of some findings, and those that everybody has."""
        # what everybody has is no finding, and is never left out
        return [
            one for one in self.fit.chosen if one.everybody or one.term.finding in names
        ]

    @cached_property
    def explained(self) -> Explained:
        """What the findings that are named explain of the case, each part predicted from all others."""
        return explained(self.fit, self.group, self.of(self.named))

    @cached_property
    def values(self) -> Mapping[Candidate, np.ndarray]:
        """Values of what is named, and of what everybody has."""
        return self.values_of(self.named)

    def values_of(self, names: Collection[str]) -> Mapping[Candidate, np.ndarray]:
        """Values of some findings, fitted without the others, and of what everybody has."""
        fit, some = self.fitted, self.of(names)
        # at the sizes that were likeliest for all: no search again for a part
        sizes = dict(zip(fit.chosen, fit.answer.sizes, strict=True))
        return fit.own.answer(some, [sizes[one] for one in some]).values

    def torque_of(self, one: Candidate) -> np.ndarray:
        """What a candidate does to the torque, as it was fitted to all [N m], (M, n)."""
        torque = self.fit.own.torque({one: self.fit.answer.values[one]})
        return self.rows.in_newton_metres(torque)[self.explained.rows]

    @property
    def own_theta(self) -> np.ndarray:
        """Coordinates of what is named, on top of what the arm was, (P,)."""
        named = [one for name in self.named for one in self.findings[name]]
        return self._theta(named, np.zeros(self.terms.size))

    def change(self, name: str) -> AppliedEffect:
        """A finding as an effect on top of what the arm was."""
        # values of what is named replace those fitted beside what is only possible
        return self.with_values(name, {**self.fitted.answer.values, **self.values})

    def with_values(
        self, name: str, values: Mapping[Candidate, np.ndarray]
    ) -> AppliedEffect:
        """A finding as an effect with some values of its coordinates."""
        theta, mine = np.zeros(self.terms.size), self.findings[name]
        for one in mine:
            theta[list(one.term.columns)] = values[one]
            if one.term.parametrisation.data_sheet is not None:
                # what the arm has may be gone altogether, and no more
                place = one.term.columns[0]
                stated = self.difference.arm.theta[place]
                theta[place] = max(theta[place], -stated)
        terms = [one.term for one in mine]
        # a finding is one effect on all its joints
        (applied,) = self.terms.effects(self.terms.clipped(theta), terms)
        return applied

    def _theta(self, some: Sequence[Candidate], theta: np.ndarray) -> np.ndarray:
        """Coordinates of effects with the values of some candidates added, (P,)."""
        theta = theta.copy()
        values = {**self.fitted.answer.values, **self.values}
        for one in some:
            theta[list(one.term.columns)] += values[one]
        return theta

    # How sure a finding is.

    def log_odds(self, name: str) -> float:
        """Log probability of the sets with a finding over that of those without [nats]."""
        return self.difference.log_odds(lambda one: one.term.finding == name)

    def support(self, name: str) -> dict[str, float]:
        """What it takes to overturn a finding: log odds [nats], and how much larger form error would explain it."""
        out = {"log_odds": self.log_odds(name)}
        values = {
            one: value
            for one, value in self.fit.answer.values.items()
            if one.term.finding != name
        }
        # the gap with the finding taken out and nothing put in its place
        left = self.fit.contrast.gap - self.fit.own.torque(values)
        gains = self.fit.contrast.for_gap(left).growth_gains(self.group, GROWTHS)
        # the least growth that is worth as much; a joint that loses by it does not grow
        for growth in GROWTHS:
            by_joint: dict[int, float] = {}
            for (j, _, tried), gain in gains.items():
                if tried == growth:
                    by_joint[j] = by_joint.get(j, 0.0) + gain
            if sum(max(gain, 0.0) for gain in by_joint.values()) >= out["log_odds"]:
                out["form_error_instead"] = float(np.sqrt(growth))
                break
        return out

    def alternatives(self, name: str) -> list[Alternative]:
        """Other causes in the place of a finding, the likeliest first."""
        mine = frozenset(one.term for one in self.findings[name])
        evidence = self._in_its_place(mine)
        # even odds at most: the search would have taken a likelier set
        odds = {other: float(np.exp(min(e, 0.0))) for other, e in evidence.items()}
        joints = tuple(sorted({term.joint for term in mine} - {0}))
        last = self.difference.arm.body.last_link + 1
        is_last = any(t.is_load or t.changes_link(last) for t in mine)
        # together they are no likelier than that it is not the finding
        total = sum(odds.values())
        # 1 / (1 + exp(log odds)) is the probability of all sets without it
        least = float(np.exp(-np.logaddexp(0.0, self.log_odds(name))))
        share = min(1.0 / (1.0 + total), least / total) if total else 0.0
        found = []
        for other, value in evidence.items():
            on_joints = other != NONE and by_name(other).scope == "joint"
            # what the last link carries and that link are one body
            same_body = is_last and any(
                t.is_load or t.changes_link(last) for t in self.terms.of(other)
            )
            found.append(
                Alternative(
                    effect=other,
                    joints=joints if on_joints else (),
                    probability=odds[other] * share,
                    evidence=value,
                    equivalent=same_body or self._does_the_same(mine, other),
                )
            )
        return sorted(found, key=lambda other: -other.probability)

    def _in_its_place(self, mine: frozenset[Term]) -> dict[str, float]:
        """Log odds of the sets with other terms in the place of a finding's, by their effect [nats].

        A search exchanges the terms of a finding one by one: what its joints lose by that adds up.
        """
        sets: dict[frozenset[Term], float] = {}
        # by terms alone, whichever groups have them
        for candidates, total in self.difference.sets.items():
            sets[frozenset(one.term for one in candidates)] = total
        found = frozenset(one.term for one in self.fit.mine)
        here, named = sets.get(found, 0.0), {t.effect for t in found}
        out: dict[str, float] = {}
        one_by_one: dict[str, dict[Term, float]] = {NONE: {}}
        for some, value in sets.items():
            lost, put = found - some, some - found
            names = {t.effect for t in put} or {NONE}
            # part of this finding is gone, with one other effect at most in its place
            if not lost or not lost <= mine or len(names) > 1:
                continue
            (name,) = names
            if not all(self._stands_for(t, lost, named) for t in put):
                continue
            # all joints exchanged at once; else one of them, for the sum below
            if lost == mine:
                out[name] = max(value - here, out.get(name, -np.inf))
            elif len(lost) == 1:
                (term,) = lost
                by_term = one_by_one.setdefault(name, {})
                by_term[term] = max(value - here, by_term.get(term, -np.inf))
        # a joint that this name does not suit loses what it does with nothing there
        without = one_by_one[NONE]
        for name, by_term in one_by_one.items():
            each = [by_term.get(t, without.get(t, -np.inf)) for t in mine]
            if by_term and name not in out and np.isfinite(each).all():
                out[name] = float(sum(each))
        return out

    def _does_the_same(self, mine: frozenset[Term], other: str) -> bool:
        """Whether a finding and another effect make the same torques: what nearly do, a faster motion tells apart."""
        own = self.fit.own

        def torques(some: Iterable[Candidate]) -> np.ndarray:
            """Torque of a unit of each coordinate, (M n, c)."""
            columns = [
                own.torque({one: unit}).ravel()
                for one in some
                for unit in np.eye(len(own.design.places[one.term]))
            ]
            return np.array(columns).reshape(-1, own.design.gap.size).T

        there = [one for one in own.candidates if one.effect == other]
        pair = (
            torques(one for one in self.fit.mine if one.term in mine),
            torques(one for one in there if self._stands_for(one.term, mine, ())),
        )
        # each by the other; of what shows nowhere nothing is the same
        return all(x.any() for x in pair) and all(
            rms(y - x @ np.linalg.lstsq(x, y)[0], None) < MIN_TORQUE
            for x, y in (pair, pair[::-1])
        )

    def _form_of_law(self, applied: AppliedEffect) -> np.ndarray:
        """Factor of the values of each draw, (D,): laws whose form in nature differs are off by half of that."""
        spread = EFFECT_FORM / 2 if applied.effect.simplified else 0.0
        # a seed of its own: the same deviations each time, and not those of the draws
        return np.random.default_rng(1).normal(1.0, spread, len(self.draws))

    def _stands_for(
        self, term: Term, lost: frozenset[Term], named: Collection[str]
    ) -> bool:
        """Whether a term may take the place of others: it acts on a joint of theirs or on all, and has no name yet."""
        # an effect that is named already explains its part
        if term.effect in named:
            return False
        # the joints do not say which link, but for that which the load would be
        if term.definition.scope == "link":
            last = self.difference.arm.body.last_link + 1
            return term.changes_link(last) and any(t.is_load for t in lost)
        joints = {t.joint for t in lost} - {0}
        return not (term.joint and joints) or term.joint in joints

    # How well its values are known.

    @cached_property
    def draws(self) -> list[dict[Term, np.ndarray]]:
        """Coordinates of the terms of the case as likely as the data make them, (linear,) each.

        Where errors of several sizes are believed of what is shared, each size has its part of the draws.
        """
        levels = list(self.fit.levels.values()) or [self.fit]
        mine = set(self.fit.mine)
        # what is found at another size of error has values that do not compare
        levels = [level for level in levels if set(level.mine) == mine]
        # a size counts by its posterior probability
        weight = np.exp([level.total - self.fit.total for level in levels])
        rng = np.random.default_rng(0)
        counts = rng.multinomial(DRAWS, weight / weight.sum())
        out: list[dict[Term, np.ndarray]] = []
        for level, count in zip(levels, counts, strict=True):
            out += _drawn(level.answer, rng, count)
        return out

    def parameters(self, name: str) -> dict[str, dict[str, object]]:
        """Values of a finding with their standard deviations, by the names of the parameters."""
        applied = self.change(name)
        terms = [one.term for one in self.findings[name]]
        found = [self.difference.found.get(term) for term in terms]
        fitted = terms[0].parametrisation
        shape = np.array([f.values for f in found if f]).T
        # beside fewer effects values are others, and as uncertain
        values = {**self.fitted.answer.values, **self.values}
        moved = [
            values[one] - self.fit.answer.values[one] for one in self.findings[name]
        ]
        samples = []
        form = self._form_of_law(applied)
        for draw, factor in zip(self.draws, form, strict=True):
            each = [(draw[t] + by) * factor for t, by in zip(terms, moved, strict=True)]
            samples.append(dict(fitted.values(np.stack(each, axis=1), shape)))
        out: dict[str, dict[str, object]] = {}
        for parameter in map(applied.effect.parameter, applied.given):
            value = applied.parameters[parameter.name]
            if parameter.name in fitted.nonlinear:
                # no coordinate: its deviation comes from the search for it
                place = fitted.nonlinear.index(parameter.name)
                std = np.array([f.deviations[place] for f in found if f])
            elif parameter.name == "link":
                # the number of a link is right or wrong, not off
                std = np.zeros(1)
            else:
                std = std_of_draws(parameter, value, samples)
            # no delay is known better than what sampling adds to it
            if applied.effect.delays:
                std = np.hypot(std, SAMPLING_SKEW)
            out[parameter.name] = {
                "unit": parameter.unit,
                "value": value,
                "std": std.reshape(value.shape),
            }
        return out


def _drawn(
    answer: Answer, rng: np.random.Generator, count: int
) -> list[dict[Term, np.ndarray]]:
    """Draws of coordinates from their posterior."""
    if not answer.values:
        return []
    mean = np.concatenate(list(answer.values.values()))
    # a root by eigenvalues: the matrix may be singular, and rounding below zero is none
    power, axes = np.linalg.eigh(answer.covariance)
    root = axes * np.sqrt(np.maximum(power, 0.0))
    draws = mean + rng.standard_normal((count, len(mean))) @ root.T
    ends = np.cumsum([len(value) for value in answer.values.values()])[:-1]
    out = []
    for draw in draws:
        parts = zip(answer.values, np.split(draw, ends), strict=True)
        out.append({one.term: x for one, x in parts if not one.everybody})
    return out


def std_of_draws(
    parameter: Parameter, value: np.ndarray, samples: Sequence[Mapping[str, np.ndarray]]
) -> np.ndarray:
    """The deviation whose 1.96-fold holds 95 % of the draws to either side of a value.

    Not that of the draws: they are no Gaussian, a quotient of coordinates has some without bound, and what is likely
    under other errors of the nominal arm may lie to one side of the value.
    """
    drawn = np.array([sample[parameter.name] for sample in samples])
    low, high = parameter.bounds
    # the value itself is clipped to the bounds, too
    inside = np.clip(drawn.reshape(len(drawn), *value.shape), low, high)
    off = np.abs(inside - value)
    if parameter.unit == "rad" and high - low >= 2 * np.pi:
        # an angle that goes all the way round
        off = np.minimum(off, 2 * np.pi - off)
    return np.asarray(np.quantile(off, 0.95, axis=0) / Z95)


def separated_by(effect: str, alternative: Alternative) -> str:
    """What separates an effect found from an alternative, in words."""
    other = alternative.effect
    if alternative.equivalent:
        return (
            "no motion, as both are the same body: by looking at what the arm carries"
        )
    if other == NONE:
        return LONGER_RECORDING
    # either of the two may name the other in the catalogue
    for one, another in ((effect, other), (other, effect)):
        for name, recording in by_name(one).confused_with:
            if name == another:
                return recording
    return "the same path at half and at double speed, and with a known payload"


def names_of(
    effect: str, probability: float, others: Sequence[Alternative]
) -> list[str]:
    """Names that hold the true one in nine of ten cases, in falling order; ``unknown`` takes the rest."""
    # the probability is that of all names that no motion tells apart
    same = sum(other.probability for other in others if other.equivalent)
    names, total = [effect], probability - same
    for other in others:
        if total >= IN_TEN:
            break
        names.append(other.effect)
        total += other.probability
    if total < IN_TEN:
        names.append(UNKNOWN_CAUSE)
    return names
