"""Which unit is this? The corrected arm of each unit predicts the torque recorded on every other."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gapscope.arm.case import Case, load_case
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import GapscopeError
from gapscope.arm.nominal import NominalArm
from gapscope.diagnosis.thresholds import ALIKE_NRMSE
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.corrected_file import read_corrected
from gapscope.model.conditioning import Segment, condition
from gapscope.model.torque_gap import torque_gap

NOMINAL = "nominal"
"""Row of the arm without effects."""


@dataclass(frozen=True)
class FleetUnit:
    """One unit: its case, and what its diagnosis found.

    Attributes:
        name: name of the unit.
        case: folder of the case, or its case file.
        corrected: its ``corrected.yaml``.
    """

    name: str
    case: Path
    corrected: Path


@dataclass(frozen=True)
class ConfusionColumn:
    """How well each arm predicts the recordings of one unit, R arms with n joints.

    Attributes:
        unit: whose recordings.
        torque_nrmse: of each arm, (n,) [1]; ``None`` for an arm that cannot predict them.
        problem: why there is no value at all, else empty.
    """

    unit: str
    torque_nrmse: Mapping[str, np.ndarray | None]
    problem: str = ""

    def mean(self, row: str) -> float | None:
        """Mean over the joints of one arm's torque NRMSE [1]."""
        values = self.torque_nrmse.get(row)
        return None if values is None else float(values.mean())

    @property
    def best(self) -> str | None:
        """The unit whose arm leaves least; the unit itself among equals."""
        means = {row: self.mean(row) for row in self.torque_nrmse if row != NOMINAL}
        known = {row: mean for row, mean in means.items() if mean is not None}
        if not known:
            return None
        return min(known, key=lambda row: (known[row], row != self.unit))

    @property
    def confused_with(self) -> tuple[str, ...]:
        """Other units whose arm predicts this one as well: no larger mean, or no joint worse by ``ALIKE_NRMSE``."""
        own = self.torque_nrmse.get(self.unit)
        if own is None:
            return ()
        alike = []
        for row, nrmse in self.torque_nrmse.items():
            if row in (NOMINAL, self.unit) or nrmse is None:
                continue
            if nrmse.mean() <= own.mean() or (nrmse - own).max() < ALIKE_NRMSE:
                alike.append(row)
        return tuple(alike)


def confusion_column(unit: FleetUnit, units: Sequence[FleetUnit]) -> ConfusionColumn:
    """Predict the recordings of a unit with the nominal arm and with the corrected arm of every unit.

    An arm is the URDF and data sheet of its own case with the effects found there; gravity is that of the unit that was
    recorded, which may hang from another wall. Nothing is read but cases and ``corrected.yaml``. The unit's own arm was
    fitted to these recordings, or to most of them, and has the advantage of that.
    """
    try:
        case = load_case(unit.case)
        segments = _segments(case)
        nrmse = {
            row: _nrmse(segments, arm, effects)
            for row, (arm, effects) in _arms(case, unit, units).items()
        }
    except GapscopeError as error:
        return ConfusionColumn(unit.name, {}, str(error))
    return ConfusionColumn(unit.name, nrmse)


def _arms(
    case: Case, unit: FleetUnit, units: Sequence[FleetUnit]
) -> dict[str, tuple[NominalArm, tuple[AppliedEffect, ...]]]:
    """Nominal arm and effects of each row."""
    arms: dict[str, tuple[NominalArm, tuple[AppliedEffect, ...]]] = {
        NOMINAL: (case.arm, ())
    }
    for other in units:
        arm = case.arm
        if other.name != unit.name:
            arm = load_case(other.case, read_recordings=False).arm
        # the other arm, hung where the recorded unit hangs
        mounted = replace(arm, gravity=case.arm.gravity)
        arms[other.name] = (mounted, read_corrected(other.corrected))
    return arms


def _segments(case: Case) -> list[Segment]:
    """What was recorded in a case, conditioned; raises ``GapscopeError`` if no recording carries a torque."""
    recordings = tuple(r for r in (*case.recordings, *case.judged) if r.tau is not None)
    if not recordings:
        raise GapscopeError(
            f"{case.name}: no recording carries a torque", "; ".join(case.warnings)
        )
    return [segment for recording in recordings for segment in condition(recording)]


def _nrmse(
    segments: list[Segment], arm: NominalArm, effects: tuple[AppliedEffect, ...]
) -> np.ndarray | None:
    """Torque NRMSE of an arm over all segments, (n,) [1]; ``None`` if it is not finite."""
    found = torque_gap(CorrectedArm(arm, effects), RigidBody(arm), segments).nrmse
    return found if np.isfinite(found).all() else None
