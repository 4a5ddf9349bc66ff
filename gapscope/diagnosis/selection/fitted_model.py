"""The model of the search: a set of terms fitted around its own values. Moves return a new one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.nominal import NominalArm
from gapscope.diagnosis.model.fit_data import FitData
from gapscope.diagnosis.model.linearisation import Linearisation
from gapscope.diagnosis.selection.evidence import Evidence, Fit, evidences
from gapscope.diagnosis.thresholds import LINEAR_ENOUGH, RELINEARISATIONS
from gapscope.model.conditioning import Segment
from gapscope.model.terms import Term, Terms


@dataclass(frozen=True)
class Model:
    """A set of terms, fitted around its own values.

    Attributes:
        linear: the linearisation around the values.
        evidences: the evidence on it at each level of the nuisances' prior, best first.
        fit: the terms and their values.
    """

    linear: Linearisation
    evidences: tuple[Evidence, ...]
    fit: Fit

    @property
    def data(self) -> FitData:
        """The data that it is fitted to."""
        return self.linear.data

    @property
    def terms(self) -> Terms:
        """All terms that could be chosen, with their shapes."""
        return self.linear.terms

    @property
    def evidence(self) -> Evidence:
        """The evidence under the error of the nominal inertials that explains the data best."""
        return self.evidences[0]

    def best(self, terms: frozenset[Term]) -> Fit:
        """Fit of a set of terms under the error of the nominal inertials that suits it best.

        An effect that wide errors replaced until now needs narrow ones beside it.
        """
        (fit,) = self.best_of([terms])
        return fit

    def best_of(self, sets: Sequence[frozenset[Term]]) -> list[Fit]:
        """The same for each of many sets of terms."""
        by_level = [evidence.fits(sets) for evidence in self.evidences]
        each = zip(*by_level, strict=True)
        return [max(fits, key=lambda fit: fit.score) for fits in each]

    def gain_of(self, other: Model) -> float:
        """Evidence of another model less that of this one [nats], each around its own values.

        Samples, which differ between linearisations, count with their mean; of what is expected to be left the less:
        a healthy arm is no worse than the better model shows.
        """
        mine, its = self.evidence.scored, other.evidence.scored
        samples = 0.5 * (mine.independent + its.independent)
        expected2 = np.minimum(mine.expected2, its.expected2)
        my_misfit, its_misfit = (
            float((samples * np.log1p(model.fit.scored_mse / expected2)).sum())
            for model in (self, other)
        )
        closed = (my_misfit - its_misfit) / 2
        return closed - other.fit.cost + self.fit.cost


def nominal_model(
    arm: NominalArm,
    body: RigidBody,
    folds: list[list[Segment]],
    cutoff: float,
) -> Model:
    """The model without any term.

    Args:
        arm, body: the nominal arm and its dynamics.
        folds: segments per fold.
        cutoff: cut-off of the fit's filter [Hz].
    """
    data = FitData(arm, body, folds, cutoff)
    terms = Terms(arm.n_joints, motors=arm.coupled_motors)
    linear = Linearisation(data, np.zeros(terms.size), terms)
    mean_squares = [
        fold.total[:, -2, -2] / np.maximum(fold.count, 1e-9)
        for fold in (half.scored for half in linear.folds)
    ]
    ranked = evidences(linear, np.array(mean_squares), frozenset())
    return Model(linear, ranked, ranked[0].fit(frozenset()))


def fit_terms(
    model: Model,
    terms: frozenset[Term],
    starts: Mapping[Term, np.ndarray] | None = None,
    least_gain: float = -np.inf,
) -> Model:
    """A model with a set of terms, less those whose values turn out impossible.

    Linearises around the values until the torque there is what the linearisation says, and weighs the data anew.

    Args:
        model: the model to begin from.
        terms: the set.
        starts: linear coordinates of some of them to linearise around at first, instead of those fitted.
        least_gain: evidence over the model to begin from [nats] below which it is not linearised once more.
    """
    beginning = model
    for _ in range(RELINEARISATIONS):
        fit = _fit_from(model, terms, starts or {})
        if not starts and _nearly_linear(model.linear, fit):
            return _weighed_anew(model.linear, fit)
        model = _linearised_around(model, fit)
        terms, starts = model.fit.terms, None
        if beginning.gain_of(model) < least_gain:
            break
    return model


def relinearise(model: Model) -> Model:
    """The same terms, linearised around their values, so that what could be added is looked for in what is left.

    A model whose torque is at its values what its own linearisation says of the same terms stays as it is.
    """
    linear, fit = model.linear, model.fit
    if _in_use(linear) == fit.terms and _nearly_linear(linear, fit):
        return model
    return _linearised_around(model, fit)


def _in_use(linear: Linearisation) -> frozenset[Term]:
    """The terms around whose values a linearisation is."""
    theta = linear.theta
    return frozenset(t for t in linear.terms.all if theta[list(t.columns)].any())


def _nearly_linear(linear: Linearisation, fit: Fit) -> bool:
    """Whether the torque at the values of a fit is what its linearisation says, so that no new one is needed."""
    for term in fit.terms:
        effect, shaped = term.definition, bool(term.parametrisation.nonlinear)
        # a shape is refined only once its term is in use
        begins = not linear.theta[list(term.columns)].any()
        if effect.limits or (begins and not effect.locally_linear):
            return False
        if shaped and term not in linear.refined:
            return False
    return bool(linear.departure(fit.theta).max() < LINEAR_ENOUGH)


def _linearised_around(model: Model, fit: Fit) -> Model:
    """The terms of a fit, fitted on a linearisation around its values."""
    refined = {t: shape.values for t, shape in model.linear.refined.items()}
    shapes = {**model.terms.shapes, **refined}
    terms = replace(model.terms, shapes=shapes)
    linear = Linearisation(model.data, _expansion_point(fit), terms)
    return _weighed_anew(linear, fit)


def _weighed_anew(linear: Linearisation, fit: Fit) -> Model:
    """The terms of a fit, fitted on a linearisation with rows weighed by what the fit leaves."""
    ranked = evidences(linear, fit.scored_mse, fit.terms)
    return Model(linear, ranked, ranked[0].fit_possible(fit.terms))


def _fit_from(
    model: Model, terms: frozenset[Term], starts: Mapping[Term, np.ndarray]
) -> Fit:
    """Fit of a set of terms without those that start at given values, then set to these."""
    fit = model.evidence.fit_possible(terms - frozenset(starts))
    if not starts:
        return fit
    theta = fit.theta.copy()
    for term, values in starts.items():
        theta[list(term.columns)] = values
    return replace(fit, terms=fit.terms | frozenset(starts), theta=theta)


def _expansion_point(fit: Fit) -> np.ndarray:
    """Values around which to linearise: saturation is there or not, how much of it is in its shape."""
    theta = fit.theta.copy()
    limiting = [t.columns[0] for t in fit.terms if t.definition.limits]
    theta[limiting] = 1.0
    return theta
