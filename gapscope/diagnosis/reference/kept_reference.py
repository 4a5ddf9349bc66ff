"""The reference of a comparison: recordings of a healthy arm, and the possible arm nearest to what they show."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from gapscope.arm.case import Case
from gapscope.arm.recording import Recording

URDF = "identified.urdf"
"""File of the identified bodies."""


@dataclass(frozen=True, eq=False)
class KeptReference:
    """All that a comparison needs of a reference, an arm with n joints.

    Attributes:
        name: of the reference case.
        joints: names of the joints, in the order of the reference.
        coupled_motors: numbers from 1 of the motors that turn several joints.
        gravity: in the base frame [m/s^2], (3,).
        urdf: text of a URDF of possible bodies that predict the reference best.
        armature: reflected rotor inertia that was found with them [kg m^2], (n,).
        coulomb: Coulomb friction [N m], (n,).
        viscous: viscous friction [N m s/rad], (n,).
        recordings: with a torque, faults of the set-up repaired; of long ones the windows that are looked at.
        faults: name and variant of the faults of the set-up that show on the reference.
        warnings: what makes it doubtful as a reference.
        made_from: hashes of the reference's files and of the program, see ``gapscope.provenance.made_from``.
        file: the document that it was read from; ``None`` if it was made in this run.
    """

    name: str
    joints: tuple[str, ...]
    coupled_motors: tuple[int, ...]
    gravity: np.ndarray
    urdf: str
    armature: np.ndarray
    coulomb: np.ndarray
    viscous: np.ndarray
    recordings: tuple[Recording, ...]
    faults: frozenset[tuple[str, str]] = frozenset()
    warnings: tuple[str, ...] = ()
    made_from: Mapping[str, str] = field(default_factory=dict)
    file: Path | None = None

    def on(self, case: Case, folder: Path) -> Case:
        """A case with the identified arm as its nominal one, by which faults of the set-up are looked for.

        Args:
            case: of the same arm.
            folder: where its URDF is written, ``identified.urdf``.
        """
        urdf = folder / URDF
        urdf.write_bytes(self.urdf.encode())
        arm = replace(
            case.arm,
            urdf=urdf,
            armature=self.armature,
            coulomb=self.coulomb,
            viscous=self.viscous,
            friction_source="the reference, identified",
        )
        return replace(case, arm=arm)
