"""The data of a diagnosis: segments by fold, with what does not depend on the parameters."""

from __future__ import annotations

from copy import copy

import numpy as np

from gapscope.arm.dynamics.inertial_scale import inertial_scale
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.nominal import NominalArm
from gapscope.diagnosis.model.compliant_bodies import CompliantCandidates
from gapscope.diagnosis.model.inertial_errors import inertial_errors
from gapscope.diagnosis.model.nuisance_prior import (
    data_sheet_prior,
)
from gapscope.model.body_point import Bodies
from gapscope.model.candidate_columns import CandidateColumns
from gapscope.model.conditioning import Segment
from gapscope.model.decimated_segments import DecimatedSegments
from gapscope.model.torque_gap import filtered_torque, torque_scale


class FitData(DecimatedSegments):
    """Folds of segments with what does not depend on the parameters.

    Args:
        arm, body: the nominal arm and its dynamics.
        folds: segments per fold.
        cutoff: cut-off of the fit's filter, on both sides [Hz].

    Attributes:
        torque_deviation: normalisation of the torque gap over all folds [N m], (n,).
        sensed: whether some segment carries a joint torque sensor.
        units: what a relative error of each inertial parameter would change it by, (10 n,).
        nuisance: the filtered inertial regressor of each segment, per unit.
        sensor_errors: number of the nuisances of joint torque sensors, beside those of the inertials.
        prior: of the nuisances.
        bodies: what the columns need of each segment's bodies.
        candidates: columns of what a search for nonlinear parameters tries.
        compliance: what a search for compliant joints simulates.
    """

    def __init__(
        self,
        arm: NominalArm,
        body: RigidBody,
        folds: list[list[Segment]],
        cutoff: float,
    ) -> None:
        super().__init__([s for fold in folds for s in fold], cutoff)
        self.arm, self.body, self.folds = arm, body, folds
        self.sensed = any(s.torque_sensor is not None for s in self.segments)
        self.torque_deviation = torque_scale(
            np.vstack([filtered_torque(s) for s in self.segments])
        )
        self.units = inertial_scale(body)
        errors = inertial_errors(body.inertial_parameters(), self.units)
        self.sensor_errors = 3 * arm.n_joints if self.sensed else 0
        self.prior = data_sheet_prior(errors, self.sensor_errors)
        self.nuisance, self.bodies = [], []
        for s in self.segments:
            regressor = body.regressor(s.motion.q, s.motion.dq, s.motion.ddq)
            self.bodies.append(Bodies(s.bodies(body), s.motion, regressor))
            self.nuisance.append(self.thin(regressor * self.units, s))
        self.candidates = CandidateColumns(self, arm.per_radian)
        self.compliance = CompliantCandidates(self, body)

    def on(self, arm: NominalArm) -> FitData:
        """The same data of an arm of the same bodies."""
        other = copy(self)
        other.arm = arm
        return other
