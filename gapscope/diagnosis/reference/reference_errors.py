"""What a reference leaves open of an arm on another day: errors of what was identified, and of friction."""

from __future__ import annotations

import numpy as np

from gapscope.arm.motions.motion import Motion
from gapscope.arm.nominal import NominalArm
from gapscope.diagnosis.model.nuisance_prior import ReferenceErrors, inverse
from gapscope.diagnosis.reference.identified_reference import IdentifiedReference
from gapscope.diagnosis.thresholds import FRICTION_DAY_TO_DAY
from gapscope.ident.model.model_columns import ModelColumns

FRICTION = ("c", "b", "d", "s")
"""Symbols of friction in x."""


def reference_errors(
    reference: IdentifiedReference, arm: NominalArm
) -> ReferenceErrors:
    """Covariance of the errors of x, what differs on another day than the reference's, and the columns of the joints.

    Friction differs by a share evenly distributed up to ``FRICTION_DAY_TO_DAY``, which has a third of its square as
    variance, beside the error of what was identified.

    Args:
        reference: the identified arm.
        arm: the same with its URDF in a file.
    """
    covariance = inverse(reference.precision)
    friction = [*reference.places(FRICTION).ravel(), *_of_motors(reference)]
    day_to_day = np.zeros(len(covariance))
    day_to_day[friction] = (FRICTION_DAY_TO_DAY * reference.value[friction]) ** 2 / 3.0
    columns, law = ModelColumns(arm), reference.law

    def own(motion: Motion) -> np.ndarray:
        return np.asarray(columns.matrix(motion, law)[:, :, columns.links :])

    return ReferenceErrors(
        covariance, day_to_day, own, reference.rest, reference.samples
    )


def _of_motors(reference: IdentifiedReference) -> list[int]:
    """Places in x of the friction of coupled motors."""
    motors = [f"{s}{m}m" for s in FRICTION for m in reference.coupled_motors]
    return [k for k, name in enumerate(reference.parameters) if name in motors]
