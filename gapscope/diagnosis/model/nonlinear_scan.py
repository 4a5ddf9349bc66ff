"""The search for parameters in which the torque is not linear, scanned over what they can be.

For each candidate the columns of its linear coordinates are projected on the residual of a joint's gap when
everything that acts on that joint is taken out; the gain of a candidate is the sum of squares that its columns explain.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from gapscope.diagnosis.model.fit_data import FitData
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.effect import Drift
from gapscope.model.candidate_columns import (
    JointSignals,
    shows_at_rest,
    unit_columns,
)
from gapscope.model.prediction import Prediction
from gapscope.model.scan import NonlinearParameters, Scan
from gapscope.model.terms import Term


class ScannedArm:
    """The arm whose gap is scanned.

    Args:
        corrected: the arm.
        predictions: what it predicts on each segment.
    """

    def __init__(
        self, corrected: CorrectedArm, predictions: Sequence[Prediction]
    ) -> None:
        self.corrected, self._predictions = corrected, predictions

    def torque(self, j: int) -> list[np.ndarray]:
        """Torque that the arm predicts on a joint [N m], (N,) for each segment."""
        return [at.torque[:, j] for at in self._predictions]

    @cached_property
    def steady_friction(self) -> list[np.ndarray]:
        """Friction of the joints as if it did not drift [N m], (N, n) for each segment."""
        effects = self.corrected.effects
        steady = tuple(e for e in effects if not isinstance(e.effect, Drift))
        arm = replace(self.corrected, effects=steady)
        smooth, out = _without_friction(arm), []
        for at in self._predictions:
            none = np.zeros_like(at.rigid)
            both = (one.needed_torque(none, at.motion) for one in (arm, smooth))
            out.append(np.subtract(*both))
        return out

    def signals(self, j: int, data: FitData) -> list[JointSignals]:
        """What the laws on a joint, from 0, depend on, on each segment."""
        out = []
        for k, segment in enumerate(data.segments):
            assert segment.torque is not None
            position = self.corrected.true_position(segment.motion.q)
            columns = (
                position,
                segment.motion.dq,
                segment.torque,
                self._predictions[k].torque,
                self.steady_friction[k],
            )
            time = segment.motion.t[:, None]
            out.append(JointSignals(time, *(x[:, j, None] for x in columns)))
        return out


def search_nonlinear(
    term: Term, arm: ScannedArm, data: FitData, scan: Scan, known: float | None
) -> NonlinearParameters:
    """The best nonlinear parameters of a joint effect's term; near ``known`` if it has been found before.

    Raises:
        KeyError: the effect has no nonlinear parameter on a joint.
    """
    effect, fitted, j = term.definition, term.parametrisation, term.joint - 1
    series = data.candidates.series(j)
    first = data.candidates.of(term) if known is None else None
    assert fitted.grid is not None
    values = fitted.grid(series, known) if first is None else first.values
    if fitted.possible is not None and len(values):
        needed = np.concatenate(arm.torque(j))
        kept = fitted.possible(values, np.concatenate(series.recorded), needed)
        values = values[kept]
        if first is not None:
            first = first._replace(values=values, columns=first.columns[:, kept])
    found = None
    if len(values):
        if first is None:
            of_segments = [
                unit_columns(effect, values, signals)
                for signals in arm.signals(j, data)
            ]
            columns, known_products = scan.weighted(data.rows(of_segments)), None
        else:
            columns, known_products = first.columns, first.products
            if not shows_at_rest(effect):
                columns = scan.weighted(columns)
        found = scan.best(values, columns, fitted.linear, known_products)
    if fitted.otherwise is None:
        assert found is not None
        return found
    other = fitted.otherwise(series, None if found is None else found.values[0])
    if other is None:
        assert found is not None
        return found
    value, std = other
    return NonlinearParameters((value,), (std,))


def _without_friction(arm: CorrectedArm) -> CorrectedArm:
    """The same arm without any friction."""
    bare = replace(
        arm.arm, coulomb=0.0 * arm.arm.coulomb, viscous=0.0 * arm.arm.viscous
    )
    return CorrectedArm(
        bare, tuple(e for e in arm.effects if e.effect.family != "friction")
    )
