"""An arm as it was identified on a reference: all that a comparison needs, without the reference's recordings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from gapscope.arm.case import Case
from gapscope.effects.applied import AppliedEffect
from gapscope.ident.model.friction_law import FrictionLaw

URDF = "identified.urdf"
"""File of the identified bodies."""


@dataclass(frozen=True, eq=False)
class IdentifiedReference:
    """An arm identified on a reference, n joints, p parameters x of the model tau = W x.

    Attributes:
        name: of the reference case.
        recordings: names of its recordings with a torque.
        joints: names of the joints, in the order of the reference.
        gravity: in the base frame [m/s^2], (3,).
        urdf: text of the URDF of the identified bodies.
        armature: reflected rotor inertia identified [kg m^2], (n,).
        coulomb: Coulomb friction identified [N m], (n,).
        viscous: viscous friction identified [N m s/rad], (n,).
        parameters: names of x, (p,).
        law: form of the friction in W.
        base_parameters: number of base parameters that the recordings excite.
        value: x, (p,).
        precision: inverse covariance of x, what the recordings and the vendor's URDF say together, (p, p).
        rest: RMS left on stretches of the reference predicted from the others [N m], (n,).
        samples: independent samples of it, (n,).
        scale: normalisation of the torque gap on the reference [N m], (n,).
        skew: by which torque is ahead of the motion [s].
        torque_ratio: torque of the identified bodies over that of the vendor's [1].
        effects: what the arm shows on the reference beyond bodies, rotors, Coulomb and viscous friction.
        faults: name and variant of the setup faults that show on the reference.
        warnings: what makes the identification doubtful.
        made_from: hashes of the reference's files and of the program, see ``gapscope.provenance.made_from``.
        file: the document that it was read from; ``None`` if it was identified in this run.
    """

    name: str
    recordings: tuple[str, ...]
    joints: tuple[str, ...]
    gravity: np.ndarray
    urdf: str
    armature: np.ndarray
    coulomb: np.ndarray
    viscous: np.ndarray
    parameters: tuple[str, ...]
    law: FrictionLaw
    base_parameters: int
    value: np.ndarray
    precision: np.ndarray
    rest: np.ndarray
    samples: np.ndarray
    scale: np.ndarray
    skew: float
    torque_ratio: float
    effects: tuple[AppliedEffect, ...] = ()
    faults: frozenset[tuple[str, str]] = frozenset()
    warnings: tuple[str, ...] = ()
    made_from: Mapping[str, str] = field(default_factory=dict)
    file: Path | None = None

    def on(self, case: Case, folder: Path) -> Case:
        """A case with the identified arm as its nominal one; nothing is replayed, see ``docs/reference_case.md``.

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

    @property
    def coupled_motors(self) -> tuple[int, ...]:
        """Numbers from 1 of the motors that turn several joints."""
        rotors = (x for x in self.parameters if x.startswith("I") and x.endswith("m"))
        return tuple(int(name[1:-1]) for name in rotors)

    def places(self, symbols: Sequence[str]) -> np.ndarray:
        """Places in x of the joints' own parameters of these symbols, joint by joint, (len(symbols), n)."""
        names = list(self.parameters)
        joints = range(1, len(self.joints) + 1)
        known = [symbol for symbol in symbols if f"{symbol}1" in names]
        found = [[names.index(f"{symbol}{j}") for j in joints] for symbol in known]
        return np.array(found, dtype=int)
