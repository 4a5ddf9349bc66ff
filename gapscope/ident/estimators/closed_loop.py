"""The closed loop of a case: its fitted recordings, and how an estimator that simulates repeats them."""

from __future__ import annotations

from collections.abc import Sequence

from gapscope.arm.case import Case
from gapscope.arm.control.pd import PD
from gapscope.arm.errors import InputError
from gapscope.arm.recording import Recording
from gapscope.ident.estimators.experiment import Experiment
from gapscope.ident.estimators.wls import WeightedLeastSquares
from gapscope.ident.model.base_parameters import BaseParameters
from gapscope.ident.model.friction_law import FrictionLaw
from gapscope.ident.model.linear_problem import Problem
from gapscope.ident.model.model_columns import SMOOTH
from gapscope.ident.model.regressor import Regressor
from gapscope.ident.signals.samples import Samples


def closed_loop(
    case: Case,
    fit: Sequence[Recording],
    samples: Samples,
    base: BaseParameters,
    problem: Problem,
) -> Experiment:
    """The fitted recordings with their controller, for an estimator that simulates; it starts from least squares.

    Raises:
        InputError: the controller is not known, or a recording cannot be repeated.
    """
    if case.controller is None:
        raise InputError(
            "an estimator that simulates needs the controller that moved the arm",
            "describe it in controller:, or use an estimator that does not simulate",
            file=case.file,
            where="controller",
        )
    if not isinstance(case.controller, PD):
        raise InputError(
            f"an estimator that simulates knows the law pd, not {case.controller.kind}",
            "use an estimator that does not simulate",
            file=case.file,
            where="controller.kind",
        )
    columns, band, law = samples.columns, samples.band, FrictionLaw()
    if columns.coupled:
        raise InputError(
            "an estimator that simulates cannot have motors that turn several joints",
            "use an estimator that does not simulate",
            where="nominal.coupling",
        )

    def build(recordings: Sequence[Recording]) -> Problem:
        own = Samples(columns, band.segments(recordings), band)
        return own.problem(law, base.kept, problem.names)

    # the order of the columns of the model
    quantities = (*SMOOTH, "friction")
    regressor = Regressor(case.arm, columns.body, quantities)
    first = WeightedLeastSquares().estimate(problem).value
    start = base.nearest(first, columns.nominal(law))
    return Experiment(regressor, base, case.controller, fit, build, start)
