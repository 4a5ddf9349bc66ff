"""The search of a case by the contrast of ``model/difference.py``: what an arm has that its data sheet does not say.

All recordings are one group, and what is shared is the data sheet with errors as healthy arms have them. Of what size
these are is not known: each hypothesis is summed over those of ``ERRORS`` that are likely. Noise and form error are
what the most flexible model leaves that still predicts motions held out, beside what was found: the search is repeated
with what it found until it finds nothing else.

What bends or rattles shows in no column about a stiff joint: it is simulated, and fitted from where that explains most.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Hashable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy.optimize import minimize

from gapscope.arm.dynamics.inertials import inertial_errors, inertial_scale
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording
from gapscope.arm.root_mean_square import SMALLEST
from gapscope.diagnosis.thresholds import (
    FRICTION_FORM,
    HEALTHY_TORQUE,
    INERTIAL_ERROR,
    VISIBLE_EFFECT,
    VISIBLE_TERM,
)
from gapscope.effects.effect import DryLaw, External, LinkChange, Transmission
from gapscope.model.contrast import SIZES, Contrast, Nuisance, OwnTerms
from gapscope.model.design import (
    LIKELY,
    MIN_TORQUE,
    WIDE,
    Design,
    FreeArm,
    bends,
    design,
    fitted_arm,
    is_link_change,
    shared_basis,
)
from gapscope.model.difference import (
    REFITTED,
    Belief,
    Difference,
    Fit,
    Place,
    Promise,
    Search,
)
from gapscope.model.equations import Equations, learn
from gapscope.model.expected import expected_entries
from gapscope.model.explained import beyond
from gapscope.model.nonlinear_values import CompliantBodies, Scanner
from gapscope.model.readings import as_mounted
from gapscope.model.rows import Rows
from gapscope.model.terms import Candidate, Term, Terms

EVERYONE = (0,)
"""The group of all recordings."""
ERRORS = (0.003, 0.01, INERTIAL_ERROR, 0.1, 0.3)
"""Errors of the nominal inertials, over their own size [1]: a tenth to ten times what is usual."""
WORSE = 2.0
"""Factor by which they may be larger than a good data sheet's [1]. (hand)"""
HEALTHY_SHARE = 0.05
"""What a healthy arm has of an effect over the size that is usual where it is an effect, at most [1]. (hand)"""
LOAD_RADIUS = 0.1
"""Radius within which the mass of a load or of a changed link may lie about its centre [m]. (physical)"""
LOAD_SIZE = 3.0
"""Largest prior deviation of an effect, in RMS torque over the joint's scale [1]. (physical)"""
FORM_OF_FOUND = 0.1
"""Share of its torque by which a law that is found differs from the catalogue's form [1]. (hand)"""
ROUNDS = 4
"""Searches, each with noise and form error beside what the last one found. (budget)"""
STARTS_FITTED, STARTS_TRIED = 2, 60
"""Compliant joints that are fitted, and values that are simulated of each. (budget)"""

Values = Mapping[Candidate, np.ndarray]
Sets = dict[frozenset[Candidate], float]
Progress = Callable[[str], None]


def search_of(
    arm: NominalArm, recordings: Sequence[Recording], unsure: np.ndarray | None = None
) -> SheetSearch:
    """The search of recordings for what an arm has beside its data sheet; of one that is mounted turned, as it is.

    Args:
        arm: the nominal arm.
        recordings: with a torque; others are left out.
        unsure: share by which all torques of each joint may be off [1], (n,); ``None`` if they were measured.

    Raises:
        InputError: a recording has no stretch without gaps that is long enough.
    """
    rows = Rows.recorded([recordings])
    mounted = as_mounted(arm, rows.segments)
    # rows are trusted less where the arm's dry friction may hold a joint
    fitted_arm(rows, mounted, EVERYONE)
    about = FreeArm.nominal(mounted)
    return SheetSearch(rows, about, [EVERYONE], EVERYONE, 0.0, unsure=unsure)


def _scales(made: Design) -> dict[Term, int]:
    """The place of the scale of each joint's torque."""
    return {
        term: int(places[0])
        for term, places in made.places.items()
        if "scale" in term.definition.quantities.values()
    }


def could_show(
    arm: NominalArm, recordings: Sequence[Recording]
) -> list[dict[str, Any]]:
    """Sizes at which effects would be named of recordings that nobody has searched, or that are only planned.

    Args:
        arm: the nominal arm.
        recordings: with a torque, if only that of the nominal arm; others are left out.

    Raises:
        InputError: a recording has no stretch without gaps that is long enough.
    """
    return nameable(search_of(arm, recordings).unsearched())


def nameable(found: Difference) -> list[dict[str, Any]]:
    """Sizes of further terms at which a search would name them, as ``expected`` of a document has them."""
    return expected_entries(found, *EVERYONE, VISIBLE_EFFECT, proportional=True)


@dataclass
class SheetSearch(Search):
    """What all recordings show beside the data sheet."""

    progress: Progress = lambda message: None
    # share by which all torques of each joint may be off, (n,); ``None`` if they were measured
    unsure: np.ndarray | None = None
    # columns with searched forms as wide as friction, of which noise is learnt
    _wide: Equations | None = None
    # RMS torque of what the last round found, whose form is not quite the law's
    _sized: dict[Term, float] = field(default_factory=dict)
    # numbers of ``ERRORS``: that which is asked first, and the largest that is asked
    _likeliest: int = ERRORS.index(INERTIAL_ERROR)
    _most: int = len(ERRORS) - 1
    # sets beside which compliance has been looked for
    _stiff: set[frozenset[Candidate]] = field(default_factory=set)

    @property
    def may_be_exchanged(self) -> bool:
        """Never: the arm of the data sheet carries nothing."""
        return False

    @property
    def belief(self) -> Belief:
        """An arm is diagnosed as it is thought to have something, or to have nothing: as likely.

        A lighter last link is no load, but where the recordings are said to have one. Bodies and rotors are as often
        off as anything else: what is asked is not whether they changed.
        """
        laden = any(segment.payload is not None for segment in self.rows.segments)
        return Belief(
            any=0.5,
            least_load=-np.inf if laden else 0.0,
            built=1.0,
            least_link=LIKELY * INERTIAL_ERROR,
        )

    @property
    def sizes(self) -> tuple[float, ...]:
        """As of all differences; and a load may need several times what the arm itself needs."""
        return (*SIZES, LOAD_SIZE)

    def run(
        self, known: Values | None = None, torque: np.ndarray | float = 0.0
    ) -> Difference:
        """Search, and search again beside what was found until nothing else is.

        Args:
            known: what the arm has in all likelihood, with about its values.
            torque: what that does, over the joints' scale, (M, n).
        """
        known = known or {}
        seen: set[frozenset[Candidate]] = set()
        # a round: the search beside noise and form error that leave out what is known
        for number in range(2 * ROUNDS):
            fit = self._beside(known, torque)
            if set(fit.mine) - set(known):
                self.progress(f"finds {_described(fit)}")
            # simulations are costly: compliance is asked once of each set
            stiff, self._stiff = self._stiff, self._stiff | {frozenset(fit.mine)}
            bent = None if frozenset(fit.mine) in stiff else self._compliant(fit)
            if bent is None and set(fit.mine) == set(known):
                break
            # what bends is known from now on: the next round looks beside it
            fit = bent or fit
            # of sets that take turns, each beside the noise of the other, the one that was likelier beforehand stays
            likely, enough = self._weigher(fit.own).odds, number + 1 >= ROUNDS
            if frozenset(fit.mine) in seen:
                enough = likely(fit.mine) >= likely(list(known))
            seen.add(frozenset(fit.mine))
            known, torque = fit.values, self._torque(self.least_squares(fit))
            # nature's form of a law differs a little: so much torque may be that
            self._sized = {one.term: self._size(fit, one) for one in fit.mine}
            if enough:
                break
        fit = self.with_some(list(known), known)
        # the empty set has to be among those that compete
        self._fit((), {}, {})
        best = self._with_growth(fit)
        least = self._totals[frozenset()]
        sets = {
            some: total - least
            for some, total in self._totals.items()
            # values that cannot be have no probability
            if np.isfinite(total)
        }
        # last, by what tells them apart: evidence beside form error does not
        for name, other in self._equivalents:
            best, sets = self._told_apart(best, sets, name, other)
        odds = {one: self._weigher(best.own).odds([one]) for one in best.mine}
        return Difference(best, sets, dict(self._found), self.arm, odds, self.belief)

    def _size(self, fit: Fit, one: Candidate) -> float:
        """RMS torque of a law of a joint that nature may have in another form, over its scale [1]; 0 of all others."""
        effect = one.term.definition
        if not one.term.joint or not (effect.simplified or isinstance(effect, DryLaw)):
            return 0.0
        torque = fit.own.torque({one: fit.values[one]})[:, one.term.joint - 1]
        return float(np.sqrt((torque**2).mean()))

    def unsearched(self) -> Difference:
        """The arm as its data sheet says, with what could be left of it."""
        self._prepared(0.0)
        self._look(self._fit((), {}, {}))
        fit = self._fit((), {}, {})
        sets = {frozenset[Candidate](): fit.total}
        return Difference(fit, sets, self._found, self.arm, {}, self.belief)

    def least_squares(self, fit: Fit) -> Fit:
        """A hypothesis as an arm of the catalogue is fitted: beside errors of the bodies, rows by what it leaves.

        Unknown functions and form error are told apart from what the effects leave, and say how sure values are.
        """
        left2 = self.torque_nrmse(fit.contrast.gap - fit.torque) ** 2
        return self._least_squares(fit, left2)

    def _least_squares(self, fit: Fit, left2: np.ndarray) -> Fit:
        """The same, each joint's rows by the mean square that is left there, (n,)."""
        contrast, error = fit.contrast, fit.contrast.error
        prior = contrast.design.prior.copy()
        # bodies alone may be off: all else that is shared would take part of effects
        prior[10 * self.arm.arm.n_joints :] = 0.0
        if self.unsure is not None:
            every = list(_scales(contrast.design).values())
            prior[every] = contrast.design.prior[every]
        # neighbours resemble each other as those of the noise do
        asked = contrast.without_form(left2 * error.noise2 / error.white2, prior)
        own = fit.own.within(asked)
        answer = own.answer(fit.chosen, fit.answer.sizes)
        total = asked.evidence + answer.evidence + self._weigher(own).odds(fit.chosen)
        return replace(fit, contrast=asked, own=own, answer=answer, total=total)

    def scales(self, fit: Fit) -> tuple[np.ndarray, np.ndarray]:
        """Share by which all torques of each joint are too small beside a hypothesis, and its deviation [1], (n,)."""
        made, n = fit.contrast.design, self.arm.arm.n_joints
        shared, _ = fit.own.nuisances(fit.answer.values)
        deviation = np.sqrt(np.diag(fit.contrast.covariance()))
        out = np.zeros((2, n))
        for term, place in _scales(made).items():
            unit = made.units[term][0]
            out[:, term.joint - 1] = shared[place] / unit, deviation[place] / unit
        return out[0], out[1]

    @property
    def _equivalents(self) -> set[tuple[str, str]]:
        """Pairs of effects that are equal to first order, and have no further parameters."""
        effects = {term.effect: term for term in self._equations.design.places}
        return {
            (name, other)
            for name, term in effects.items()
            if (other := term.definition.near_equivalent) in effects
            and not term.parametrisation.nonlinear
        }

    def _told_apart(
        self, fit: Fit, sets: Sets, name: str, other: str
    ) -> tuple[Fit, Sets]:
        """A hypothesis with one of two effects, as least squares tell them, and the sets that compete with it.

        Both are equal to first order, and form error hides what they differ by.
        """
        if not any(one.effect in (name, other) for one in fit.mine):
            return fit, sets
        by_name = {(one.effect, one.term.joint): one for one in fit.own.candidates}

        # terms keep their joint when their effect is told by the other name
        def renamed(one: Candidate, to: str) -> Candidate:
            twin = by_name.get((to, one.term.joint), one)
            return twin if one.effect in (name, other) else one

        left2 = self.torque_nrmse(fit.contrast.gap - fit.torque) ** 2
        found = {frozenset(fit.mine): fit}
        for to in (name, other):
            values = {renamed(one, to): x for one, x in fit.values.items()}
            # the hypothesis itself is fitted already
            if frozenset(values) not in found:
                found[frozenset(values)] = self._fit(list(values), values, fit.grown)
        # values that cannot be are no answer, however well they fit
        likely = {
            some: self._least_squares(one, left2).total
            for some, one in found.items()
            if np.isfinite(one.total)
        }
        best = max(likely, key=lambda some: likely[some])
        if best == frozenset(fit.mine):
            return fit, sets
        # the old name loses what least squares say, the sets with it as well
        lost = likely[best] - likely[frozenset(fit.mine)]
        to = next(one.effect for one in best if one.effect in (name, other))
        out: Sets = {}
        for some, total in sets.items():
            same = frozenset(renamed(one, to) for one in some)
            out[same] = max(total, out.get(same, -np.inf))
            if same != some:
                out[some] = max(total - lost, out.get(some, -np.inf))
        return found[best], out

    def with_also(self, found: Difference, some: Sequence[Candidate]) -> Difference:
        """The same with candidates that are known to be there."""
        further = [one for one in some if one not in found.fit.chosen]
        fit = found.fit
        if further:
            fit = self._fit([*fit.chosen, *further], fit.values, fit.grown)
        sets: dict[frozenset[Candidate], float] = {}
        for others, total in found.sets.items():
            both = others | frozenset(some)
            sets[both] = max(total, sets.get(both, -np.inf))
        return replace(found, fit=fit, sets=sets)

    def design_on(self, rows: Rows, only: Collection[str] | None = None) -> Design:
        """The same columns of other motions, or those of some effects."""
        units = self._first.design.units
        return self._believed(design(rows, self.arm, self._shapes, units, only))

    def rivals(self, sets: Sequence[Collection[tuple[str, int]]]) -> list[Fit]:
        """Hypotheses of effects on joints, beside the noise and form error that the first one leaves."""
        self.unsearched()
        first = self._with_effects(sets[0])
        self._prepared(self._torque(first))
        self._look(first)
        return [self._with_effects(some) for some in sets]

    def _with_effects(self, some: Collection[tuple[str, int]]) -> Fit:
        """The hypothesis of effects on joints, compliant ones from where they explain most."""
        terms = [
            term
            for term in self._equations.design.places
            if (term.effect, term.joint) in some
        ]
        compliant = [t for t in terms if isinstance(t.definition, Transmission)]
        rigid = [Candidate(term, EVERYONE) for term in terms if term not in compliant]
        fit = self._fit(rigid, {}, {})
        for term in compliant:
            one, scan = Candidate(term, EVERYONE), Scan(self, fit, {term.joint})
            values = dict(fit.values)
            for other, start in scan.starts():
                if other == term:
                    values[one] = scan.refined(term, start)[0]
            fit = self._fit([*fit.chosen, one], values, {})
        return fit

    def with_motors(self, coupling: np.ndarray) -> SheetSearch:
        """The same search of an arm with coupled motors, (n, n)."""
        bare = replace(self.arm.arm, coupling=coupling)
        # the terms of motors come last
        theta = np.zeros(Terms(bare.n_joints, {}, bare.coupled_motors).size)
        theta[: len(self.arm.theta)] = self.arm.theta
        arm = replace(self.arm, arm=bare, theta=theta)
        other = SheetSearch(self.rows, arm, self.sets, self.taught_by, self.days)
        # forms of laws on joints were searched already: motors change none of them
        other._found = dict(self._found)
        return other

    def beside_known(self, fit: Fit) -> Fit:
        """What another search found, with noise and form error of this one beside it."""
        self._prepared(fit.torque)
        return self._fit(fit.mine, fit.values, {})

    def _prepared(self, torque: np.ndarray | float) -> None:
        """Noise, form error and columns beside what is known."""
        first = self._wide is None
        self._linearise(1, torque)
        self._prepare()
        if first:
            # once: what the arm of the data sheet predicts does not change
            self._scanner = Scanner(self.rows, self.arm, None)

    def _beside(self, known: Values, torque: np.ndarray | float) -> Fit:
        """The best hypothesis, with noise and form error beside what is known."""
        first = self._wide is None
        self._prepared(torque)
        self._look(self._fit(list(known), known, {}))
        if first and self._found and (self._taught.white2 > VISIBLE_EFFECT**2).any():
            # what a law with a searched form does is no noise
            self._wide = None
            self._linearise(1, torque)
            self._prepare()
        fit = self._searched_about(known)
        likeliest = max(fit.levels, key=lambda error: fit.levels[error].total)
        if known or likeliest <= WORSE * INERTIAL_ERROR:
            return fit
        # as long as nothing is named, effects may pass for errors of all bodies
        kept = dict(self.__dict__)
        self._most = self._likeliest = ERRORS.index(INERTIAL_ERROR)
        # what was fitted beside larger errors does not count
        self._fits, self._totals = {}, {}
        good = self._searched_about(known)
        # the second look leaves no trace but what it found
        self.__dict__.update(kept)
        if not good.mine:
            return fit
        # with all errors to choose from, less what nobody could see
        again = self._pruned(self.with_some(list(good.values), good.values))
        other = self._searched_about(again.values)
        return max(fit, again, other, key=lambda one: one.total)

    def _searched_about(self, known: Values) -> Fit:
        """The best hypothesis, from what is known on."""
        fit = self._asked_again(self._fit(list(known), known, {}))
        return self._pruned(self._searched(fit))

    def _torque(self, fit: Fit) -> np.ndarray:
        """What a hypothesis explains, over the joints' scale, (M, n): all that is known then is no form error."""
        assert self._wide is not None
        return np.asarray(self._wide.design.gap - _left(fit))

    def _linearise(
        self, times: int, known: np.ndarray | float = 0.0, *, alike: bool = False
    ) -> None:
        """Columns about the data sheet, noise and form error beside what is known."""
        if self._wide is None:
            made = design(self.rows, self.arm, self._shapes)
            self._wide = Equations.of(replace(made, prior=_with_forms(made)))
        # a row that says nothing has no gap, and none is to be added
        made, beside = self._wide.design, self._wide
        if np.any(known):
            gap = made.gap - known * (self.rows.measured > 0)
            beside = Equations.of(replace(made, gap=gap))
        self._about = self.arm
        # what delays or bends on every joint at once, or has any form, predicts no other motion
        rigid, plain = made.prior.copy(), made.prior.copy()
        for term, places in made.places.items():
            if isinstance(term.definition, Transmission) or term.definition.delays:
                rigid[places] = 0.0
            if term.parametrisation.nonlinear:
                rigid[places] = plain[places] = 0.0
        # bodies of every quality, rigid: that which predicts best shows what is noise
        sheets = [np.minimum(rigid, self._of_sheet(made, error)) for error in ERRORS]
        priors = [made.prior, plain, rigid, *sheets]
        if len(np.unique(self.rows.recording)) > 1:
            good = sheets[ERRORS.index(INERTIAL_ERROR)]
            priors += _by_family(made, good)
        self._taught = learn(beside, self.taught_by, priors=priors)
        # columns hold the whole gap: what is known is left out of the noise alone
        self._first = replace(self._wide, design=self._taught.primed(made))

    def _believed(self, made: Design) -> Design:
        """The columns with what a healthy arm of the data sheet may have, bodies in units of their errors."""
        n = self.arm.arm.n_joints
        columns, active, noisy = [], [], {}
        for j, (x, every) in enumerate(zip(made.columns, made.active, strict=True)):
            # bodies, then all else: of a joint those of links that move it
            of_bodies = every < 10 * n
            bodies = np.zeros((len(x), 10 * n))
            bodies[:, every[of_bodies]] = x[:, of_bodies]
            bodies = bodies @ self._of_errors
            # an error that moves no torque of the joint is no column of it
            shown = np.flatnonzero((bodies**2).mean(axis=0) > MIN_TORQUE**2)
            own = np.concatenate([shown, every[~of_bodies]])
            columns.append(np.hstack([bodies[:, shown], x[:, ~of_bodies]]))
            active.append(own)
            # columns made of the recorded torque have moved to other places
            for (joint, at), passed in made.noisy.items():
                if joint == j:
                    noisy[j, int(np.searchsorted(own, every[at]))] = passed
        prior = self._of_sheet(made, INERTIAL_ERROR)
        return replace(made, columns=columns, active=active, noisy=noisy, prior=prior)

    def _of_sheet(self, made: Design, error: float) -> np.ndarray:
        """Prior of what is shared with a data sheet whose bodies have errors of some size, (P,)."""
        prior = made.prior.copy()
        prior[: 10 * self.arm.arm.n_joints] = error
        for term, places in made.places.items():
            prior[places] = self._healthy(term, made)
        return prior

    @cached_property
    def _of_errors(self) -> np.ndarray:
        """Inertial parameters, over their size, by errors of masses, centres and shapes, (10 n, 10 n)."""
        body = self.arm.body
        return inertial_errors(body.inertial_parameters().ravel(), inertial_scale(body))

    def _healthy(self, term: Term, made: Design) -> np.ndarray:
        """What a healthy arm has of a term, in units of its columns, (linear,)."""
        fitted, unit = term.parametrisation, made.units[term]
        if self.unsure is not None and "scale" in term.definition.quantities.values():
            return np.minimum(self.unsure[term.joint - 1] * unit, WIDE)
        if fitted.nonlinear:
            # a searched form is there or not, but for what is like it
            return np.full(len(unit), MIN_TORQUE)
        # the bodies have errors already, and so has what equals another effect
        if is_link_change(term) or term.definition.near_equivalent:
            return np.zeros(len(unit))
        if fitted.data_sheet is not None:
            stated = np.abs(self.arm.theta[list(term.columns)])
            healthy = FRICTION_FORM * stated * unit + MIN_TORQUE
            # wrong gains look like damping and inertia
            if self.unsure is None or isinstance(term.definition, DryLaw):
                return healthy
            return healthy + self.unsure[term.joint - 1]
        return np.minimum(HEALTHY_TORQUE, HEALTHY_SHARE * made.usual[term] * unit)

    def _forms(self, made: Design, known: Mapping[Term, float]) -> np.ndarray:
        """What the form of known effects leaves of the columns of their joints, (P,): it differs from the catalogue's.

        Something smaller than an effect may be that; what is larger is no part of it.

        Args:
            made: the columns.
            known: effects of joints, with their RMS torque over the joint's scale [1].
        """
        out = np.zeros(made.size)
        for joint in {term.joint for term in known}:
            on_joint = [
                term
                for term in made.places
                if term.joint == joint and not is_link_change(term)
            ]
            sizes = np.array([known.get(term, 0.0) for term in on_joint])
            # all of them together are no more than that
            share = FORM_OF_FOUND / np.sqrt(len(on_joint))
            for term, size in zip(on_joint, sizes, strict=True):
                # what is smaller may be the form of what is larger
                larger = np.linalg.norm(sizes[sizes > size])
                out[made.places[term]] = share * float(larger)
        return out

    def _may_differ(self, one: Candidate) -> bool:
        return True

    def _is_said(self, one: Candidate, fit: Fit) -> bool:
        """As of all differences; and what bends is not said to rattle as well."""
        compliant = isinstance(one.term.definition, Transmission)
        return super()._is_said(one, fit) or any(
            compliant
            and isinstance(other.term.definition, Transmission)
            and other.term.joint == one.term.joint
            for other in fit.chosen
        )

    def _extents(self, values: Values) -> list[Nuisance]:
        """Moments of inertia of loads and changed links about their centres, between -m r^2 and m r^2."""
        sizes = np.diag(self._of_errors) * inertial_scale(self.arm.body)
        out: list[Nuisance] = []
        for one, value in values.items():
            if not isinstance(one.term.definition, LinkChange):
                continue
            last = self.arm.body.last_link
            link = last if one.term.is_load else one.term.joint - 1
            # the six moments of inertia behind mass and first moment
            own = slice(10 * link + 4, 10 * link + 10)
            moments = np.zeros(self._equations.design.size)
            bound = abs(float(value[0])) * LOAD_RADIUS**2
            # of a body without extent no moment has a column
            shown = sizes[own] > 0
            # even between both bounds: a third of the square
            moments[own][shown] = (bound / sizes[own][shown]) ** 2 / 3.0
            if moments.any():
                out.append((EVERYONE, moments))
        return out

    def _suited(self, fit: Fit) -> Fit:
        # errors of the bodies are summed over: functions keep their learnt sizes
        return fit

    def _within(
        self, contrast: Contrast, error: float, known: Collection[Term]
    ) -> Contrast:
        """The contrast with errors of some size, and the form of what a hypothesis has of what was known before."""
        sized = {term: self._sized[term] for term in known if term in self._sized}
        # of a contrast that has such a form already, that is another hypothesis's
        made = self._equations.design
        prior = made.prior.copy()
        prior[: 10 * self.arm.arm.n_joints] = error
        # what is not shared stays so
        prior += self._forms(made, sized) * (prior > 0)
        return contrast.with_prior(prior)

    def _weighed(
        self,
        contrast: Contrast,
        own: OwnTerms,
        chosen: Sequence[Candidate],
        grown: Mapping[Place, float],
    ) -> Fit:
        levels: dict[float, Fit] = {}

        def total(number: int) -> float:
            """Log probability with errors of a size."""
            error = ERRORS[number]
            # each size is asked once, and only if need be
            if error not in levels:
                asked = self._within(contrast, error, [one.term for one in chosen])
                fit = super(SheetSearch, self)._weighed(
                    asked, own.within(asked), chosen, grown
                )
                both = fit.total + _log_prior(error)
                levels[error] = replace(fit, total=both, sharp=both)
            return levels[error].total

        numbers = range(self._most + 1)
        # from the likeliest size of the last hypothesis and its neighbours uphill
        near = [k for k in numbers if abs(k - self._likeliest) < 2]
        while True:
            # beside nothing the errors have to explain all: every size is asked
            best = max(near if chosen else numbers, key=total)
            near = [k for k in numbers if abs(k - best) < 2]
            if max(near, key=total) == best:
                break
        self._likeliest = best
        # sizes that were not asked count for nothing beside those that were
        every = float(np.logaddexp.reduce([fit.total for fit in levels.values()]))
        fit = levels[ERRORS[best]]
        return replace(fit, levels=levels, total=every, sharp=every)

    def _with_everybody(self, fit: Fit) -> Fit:
        # with one group everybody's is the group's own
        return fit

    def _worth_fitting(
        self, fit: Fit, proposed: Sequence[Promise]
    ) -> Sequence[Promise]:
        """Those that promise to help, or the best one if it is far from what its columns promise."""
        better = super()._worth_fitting(fit, proposed)
        return better or [p for p in proposed[:1] if bends(p.one.term)]

    # What no person could see is no finding.

    def torque_nrmse(self, left: np.ndarray) -> np.ndarray:
        """``torque_nrmse`` of what is left, over the joint's scale on rows by trust, (M, n): (n,)."""
        # ``torque_nrmse`` counts all rows alike: trust is taken out again
        rows = left / np.maximum(self.rows.trust, MIN_TORQUE)
        return np.asarray(np.sqrt((rows**2).mean(axis=0)))

    def _visible(self, left: np.ndarray) -> np.ndarray:
        """The same where the joints surely move, (n,): where they may stick, static friction hides what is there."""
        known = beyond(left, self.rows.hides * self.rows.trust)
        return np.asarray(
            np.sqrt((known**2).sum(axis=0) / (self.rows.trust**2).sum(axis=0))
        )

    def _closed(self, few: Fit, many: Fit) -> float:
        """How much of the gap of some joint more terms close, with errors of the data sheet taken out or not."""
        plain = float((self._visible(_left(few)) - self._visible(_left(many))).max())
        beside = float((self._visible(few.left) - self._visible(many.left)).max())
        # what closes nothing by itself is no finding, whatever errors do beside it
        return max(plain, beside) if plain > 0 else plain

    def _pruned(self, fit: Fit) -> Fit:
        """The hypothesis without findings, then without terms, that close too little to be seen, one by one."""

        def finding(one: Candidate) -> Hashable:
            return one.term.finding

        def term(one: Candidate) -> Hashable:
            return one.term

        # whole findings first: one joint of several may be faint
        for least, part in ((VISIBLE_EFFECT, finding), (VISIBLE_TERM, term)):
            while fit.mine:
                without = {
                    name: [one for one in fit.chosen if part(one) != name]
                    for name in map(part, fit.mine)
                }
                # to first order most of them are seen to be needed
                names = sorted(
                    without, key=lambda name: self._closed_by(fit, without[name])
                )
                fewer = []
                for name in names[:REFITTED]:
                    values = {one: fit.values[one] for one in without[name]}
                    fewer.append(self._fit(without[name], values, fit.grown))
                closed, faintest = min(
                    (self._closed(few, fit), k) for k, few in enumerate(fewer)
                )
                # the faintest goes, and the rest is asked again without it
                if closed >= least:
                    break
                fit = fewer[faintest]
        return fit

    def _closed_by(self, fit: Fit, rest: Sequence[Candidate]) -> float:
        """How much of the gap of some joint a hypothesis closes that some of its terms do not, to first order."""
        sizes = dict(zip(fit.chosen, fit.answer.sizes, strict=True))
        answer = fit.own.answer(rest, [sizes[one] for one in rest])
        return self._closed(replace(fit, chosen=tuple(rest), answer=answer), fit)

    # Compliant joints.

    def _may_bend(self, fit: Fit) -> set[int]:
        """Joints whose torque looks, to first order, more likely as that of a compliant joint than not."""
        # an encoder at the joint sees no deflection: the bodies move as recorded
        if self.arm.arm.encoder != "motor":
            return set()
        # where less is left than a person can see, nothing closes so much
        left = np.maximum(self._visible(_left(fit)), self._visible(fit.left))
        compliant = [
            one
            for one in fit.own.candidates
            if isinstance(one.term.definition, Transmission)
            and left[one.term.joint - 1] >= VISIBLE_EFFECT
        ]
        # a joint bends or rattles, but not both
        taken = {one.term.joint for one in compliant if one in fit.chosen}
        further = [one for one in compliant if one.term.joint not in taken]
        every = fit.own.additions(fit.chosen, fit.answer.sizes, further).evidence
        known = fit.answer.evidence
        return {
            one.term.joint
            for one, evidence in zip(further, every, strict=True)
            if evidence > known
        }

    def _compliant(self, fit: Fit) -> Fit | None:
        """The hypothesis with the compliant joint that explains most, noise and form error beside it, if one does."""
        joints = self._may_bend(fit)
        if not joints:
            return None
        # trials move noise, columns and caches of this search: they are put back
        gap, kept, best = Scan(self, fit, joints), dict(self.__dict__), None
        odds = self._weigher(fit.own).odds
        for term, start in gap.starts():
            one = Candidate(term, EVERYONE)
            values, gain = gap.refined(term, start)
            gain += odds((*fit.chosen, one)) - odds(fit.chosen)
            # what is not worth its odds asks for no other noise and columns
            if gain <= 0:
                continue
            known = {**fit.values, one: values}
            torque = self._torque(fit) + gap.added(term, values)
            # noise beside the values, values beside that noise, and once more
            for _ in range(2):
                self._linearise(1, torque)
                self._prepare()
                larger = self.with_some(list(known), known)
                known, torque = larger.values, self._torque(larger)
            # values that cannot be are never seen, nor what has left beside that noise
            there = one in larger.chosen and np.isfinite(larger.total)
            shown = there and self._closed(fit, larger)
            better = best is None or gain > best[0]
            if shown >= VISIBLE_EFFECT and better:
                # its noise and columns belong to it: the search goes on with them
                best = gain, larger, dict(self.__dict__)
        self.__dict__.update(kept if best is None else best[2])
        return None if best is None else best[1]


def _with_forms(made: Design) -> np.ndarray:
    """Prior of what is shared with laws of a searched form as wide as friction, (P,), to learn noise beside them."""
    prior = made.prior.copy()
    for term, places in made.places.items():
        effect = term.definition
        # a limit is made of the torque that it would predict, a push comes but once
        predicts = not (effect.limits or isinstance(effect, External))
        if term.parametrisation.nonlinear and predicts:
            prior[places] = WIDE
    return prior


def _by_family(made: Design, sheet: np.ndarray) -> list[np.ndarray]:
    """Priors of what is shared, (P,) each, of a data sheet and of any effects of one family.

    Few arms have more than that on a joint. Another recording has to bear it out: motions of a single one resemble each
    other in much else.
    """
    families: dict[str, np.ndarray] = {}
    for term, places in made.places.items():
        own = families.setdefault(term.definition.family, sheet.copy())
        own[places] = made.prior[places]
    return list(families.values())


def _described(fit: Fit) -> str:
    """Effects with their joints."""
    joints: dict[str, list[int]] = {}
    for one in fit.mine:
        joints.setdefault(one.effect, []).append(one.term.joint)
    return "; ".join(f"{name} {sorted(set(j) - {0})}" for name, j in joints.items())


def _left(fit: Fit) -> np.ndarray:
    """Gap beside what a hypothesis says that the arm has, over the joints' scale, (M, n)."""
    return np.asarray(fit.contrast.gap - fit.torque)


def _log_prior(error: float) -> float:
    """Logarithm of how likely errors of the nominal inertials have a size [nats], but for a constant.

    A data sheet may be as good as any, and is the less likely the worse.
    """
    over = max(float(np.log(error / INERTIAL_ERROR)), 0.0)
    return -((over / np.log(WORSE)) ** 2) / 2


class Scan:
    """What compliance of a joint would explain of what a hypothesis leaves, all that is shared taken out of both."""

    def __init__(self, search: SheetSearch, fit: Fit, joints: Collection[int]) -> None:
        self._rows, made = search.rows, fit.contrast.design
        arm, theta = search.arm, search.arm.theta.copy()
        # what bends carries the bodies as they were found
        for one, value in fit.values.items():
            theta[list(one.term.columns)] += value
        corrected = arm.corrected(made.terms, made.terms.clipped(theta))
        self._bodies = CompliantBodies(self._rows, arm.body, corrected)
        # a joint that moves no mass has no resonance
        self._terms = [
            term
            for term in made.terms.all
            if isinstance(term.definition, Transmission)
            and term.joint in joints
            and self._bodies.mass[term.joint - 1] > 0
        ]
        error = fit.contrast.error
        self._left = _left(fit)
        count = (self._rows.trust**2).sum(axis=0)
        # rows that count, neighbours in time once
        self._count = count * error.white2 / error.noise2
        self._bases = [
            shared_basis(made, j, float(noise2))
            for j, noise2 in enumerate(error.noise2)
        ]

    def added(self, term: Term, values: np.ndarray) -> np.ndarray:
        """Torque that compliance of a joint adds, over the joints' scale, on rows by trust, (M, n)."""
        effect = term.definition
        assert isinstance(effect, Transmission)
        torque = self._bodies.added(effect, term.joint - 1, values)
        return np.asarray(torque / self._rows.scale * self._rows.trust)

    def gains(self, torques: np.ndarray, *, scaled: bool = False) -> np.ndarray:
        """What each of K torques, (K, M, n), explains of what is left [nats], (K,).

        Scaled, it is the share of each torque that explains most: values nearby explain that, about.
        """
        left, own = map(self._beside_shared, (self._left[None], torques))
        before = self._squares(left)
        if scaled:
            # by joint: what has much left counts less
            weight = self._count / before[0]
            along = np.einsum("kmn,kmn,n->k", left, own, weight, optimize=True)
            share = np.clip(along / (self._squares(own) @ weight), 0.0, 1.0)
            own = share[:, None, None] * own
        # the variance of each joint is as likely as can be, before and after
        return np.asarray(np.log(before / self._squares(left - own)) @ self._count / 2)

    def _beside_shared(self, series: np.ndarray) -> np.ndarray:
        """What is left of K series, (K, M, n), beside all that is shared."""
        out = np.empty(series.shape)
        for j, basis in enumerate(self._bases):
            y = series[:, :, j].T
            out[:, :, j] = (y - basis @ (basis.T @ y)).T
        return out

    def _squares(self, series: np.ndarray) -> np.ndarray:
        """Sum of squares of K series, (K, M, n): (K, n)."""
        return np.asarray((series**2).sum(axis=1)) + MIN_TORQUE

    def starts(self) -> list[tuple[Term, np.ndarray]]:
        """Compliant joints that explain most, with the values of each that explain most of those of its law."""
        found: list[tuple[float, Term, np.ndarray]] = []
        for term in self._terms:
            needed = np.concatenate([x[:, term.joint - 1] for x in self._bodies.torque])
            mass = self._bodies.mass[term.joint - 1]
            assert isinstance(term.definition, Transmission)
            every = list(term.definition.starts(mass, needed))
            if every:
                torques = np.stack([self.added(term, x) for x in every])
                gains = self.gains(torques, scaled=True)
                best = int(np.argmax(gains))
                found.append((float(gains[best]), term, every[best]))
        found.sort(key=lambda start: -start[0])
        # one that explains half as much may explain more once it is fitted
        least = max(found[0][0] / 2, 0.0) if found else 0.0
        return [(t, x) for gain, t, x in found[:STARTS_FITTED] if gain >= least]

    def _lost(self, logs: np.ndarray, term: Term, scaled: bool) -> float:
        torque = self.added(term, np.exp(logs))
        return -float(self.gains(torque[None], scaled=scaled)[0])

    def refined(self, term: Term, start: np.ndarray) -> tuple[np.ndarray, float]:
        """Values that explain most, from a start, and how much, less what their number makes of chance [nats]."""
        # logarithms: stiffness and width are positive, and span decades
        logs, lost = np.log(np.maximum(start, SMALLEST)), 0.0
        # a radian per newton metre is no drive any more, nor is a play of one
        bounds = [(np.log(SMALLEST), 0.0)] * len(logs)
        # a resonance that is not quite right explains little at its full size
        for scaled, step in ((True, 0.3), (False, 0.1)):
            found = minimize(
                self._lost,
                logs,
                args=(term, scaled),
                method="Nelder-Mead",
                bounds=bounds,
                options={
                    "maxfev": STARTS_TRIED,
                    "initial_simplex": logs
                    + step * np.eye(len(logs) + 1, len(logs), -1),
                    "fatol": 0.1,
                    "xatol": 0.01,
                },
            )
            logs, lost = found.x, float(found.fun)
        # each value costs half the logarithm of the count, as by the Bayesian criterion
        chance = len(logs) * float(np.log(self._count.max())) / 2
        return np.exp(logs), -lost - chance
