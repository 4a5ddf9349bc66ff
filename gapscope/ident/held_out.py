"""What an identified arm predicts: on what was fitted and what was not, with intervals."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gapscope.ident.checks.fit_evidence import FitEvidence
from gapscope.ident.model.base_parameters import BaseParameters
from gapscope.ident.model.law_choice import Choice
from gapscope.ident.model.linear_problem import Problem
from gapscope.ident.signals.samples import Band, Samples
from gapscope.ident.uncertainty.examination import Examination
from gapscope.ident.uncertainty.torque_interval import PredictedTorque, predicted_torque
from gapscope.ident.uncertainty.validation import Validation, validate
from gapscope.model.conditioning import Segment


def validated(
    evidence: FitEvidence, value: np.ndarray, held_out: Sequence[Segment], band: Band
) -> tuple[Validation, Validation]:
    """Predictions of x = ``value`` and of the nominal arm, on what was fitted and on what was not."""
    columns, law = evidence.samples.columns, evidence.choice.law
    nominal = columns.nominal(law)

    def predict(segment: Segment, x: np.ndarray) -> np.ndarray:
        load = segment.known_torque(columns.body)
        return np.asarray(columns.matrix(segment.motion, law) @ x + load)

    def identified(segment: Segment) -> np.ndarray:
        return predict(segment, value)

    def of_nominal(segment: Segment) -> np.ndarray:
        return predict(segment, nominal)

    return (
        validate("fit", evidence.samples.segments, band, identified, of_nominal),
        validate("judge", held_out, band, identified, of_nominal),
    )


def predicted(
    evidence: FitEvidence,
    examined: Examination,
    value: np.ndarray,
    held_out: Sequence[Segment],
) -> PredictedTorque | None:
    """Intervals of the torque on segments that were not fitted, about what x = ``value`` predicts."""
    if examined.interval is None:
        return None
    fitted = evidence.samples
    samples = Samples(fitted.columns, held_out, fitted.band.bounded(held_out))
    problem = base_problem(samples, evidence.choice, evidence.base)
    return predicted_torque(examined.interval, problem, evidence.base.of(value))


def base_problem(samples: Samples, choice: Choice, base: BaseParameters) -> Problem:
    """The samples in the base columns."""
    names = [base.names[k] for k in base.kept]
    return samples.problem(choice.law, base.kept, names)
