"""The terms that a diagnosis may add to the nominal arm: effects on joints, as one parameter vector."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from effects.applied import AppliedEffect
from effects.catalogue import CATALOGUE
from effects.effect import Effect

EXPLAINED = (
    "coulomb_friction",
    "viscous_friction",
    "load_friction",
    "payload",
    "armature",
    "torque_scale",
    "torque_offset",
    "actuator_delay",
    "encoder_offset",
)
"""Effects that a diagnosis can find; each joint effect among them has one parameter."""


@dataclass(frozen=True)
class Term:
    """One effect on one joint, or on the arm.

    Attributes:
        effect: name of the effect.
        joint: joint from 1, or 0 for the arm.
        columns: its places in the parameter vector.
    """

    effect: str
    joint: int
    columns: tuple[int, ...]


class Terms:
    """All terms for an arm with n joints, and the parameter vector theta that holds their values.

    Each joint effect has n parameters; ``payload`` has four: mass m [kg] and first moment h = m c [kg m].
    """

    def __init__(self, n_joints: int) -> None:
        self.n_joints = n_joints
        self.joint_effects = [CATALOGUE[name] for name in EXPLAINED if CATALOGUE[name].scope == "joint"]
        terms = [
            Term(effect.name, joint + 1, (k * n_joints + joint,))
            for k, effect in enumerate(self.joint_effects)
            for joint in range(n_joints)
        ]
        start = len(self.joint_effects) * n_joints
        self.payload = np.arange(start, start + 4)
        terms.append(Term("payload", 0, tuple(self.payload.tolist())))
        self.all = tuple(terms)
        self.size = start + 4

    def block(self, effect: Effect) -> slice:
        """Places of a joint effect's values in theta."""
        k = self.joint_effects.index(effect)
        return slice(k * self.n_joints, (k + 1) * self.n_joints)

    def effects(self, theta: np.ndarray, terms: frozenset[Term] | None = None) -> tuple[AppliedEffect, ...]:
        """Effects with the values of theta, those of ``terms`` or else those that are not zero.

        Raises:
            InputError: a value lies outside the bounds of its parameter.
        """
        chosen = [t for t in self.all if (t in terms if terms is not None else theta[list(t.columns)].any())]
        found = []
        for effect in self.joint_effects:
            columns = [(t.joint, t.columns[0]) for t in chosen if t.effect == effect.name]
            if columns:
                joints, places = zip(*columns, strict=True)
                found.append(AppliedEffect(effect.name, tuple(joints), {effect.names[0]: theta[list(places)]}))
        if any(t.effect == "payload" for t in chosen):
            mass, moment = theta[self.payload[0]], theta[self.payload[1:]]
            com = moment / mass if abs(mass) > 1e-9 else np.zeros(3)
            found.append(AppliedEffect("payload", (), {"mass": mass, "com": com}))
        return tuple(found)

    def clipped(self, theta: np.ndarray) -> np.ndarray:
        """Theta with every value moved into the bounds of its parameter."""
        out = theta.copy()
        for effect in self.joint_effects:
            out[self.block(effect)] = np.clip(out[self.block(effect)], *effect.parameters[0].bounds)
        mass, com = (parameter.bounds for parameter in CATALOGUE["payload"].parameters)
        m = np.clip(out[self.payload[0]], *mass)
        out[self.payload[0]] = m
        out[self.payload[1:]] = np.clip(out[self.payload[1:]], -abs(m) * com[1], abs(m) * com[1])
        return out

    def impossible(self, theta: np.ndarray, terms: frozenset[Term], lowest: np.ndarray) -> frozenset[Term]:
        """Those of the terms whose values cannot be: outside their bounds, or below ``lowest``."""
        inside = self.clipped(theta)
        return frozenset(
            t
            for t in terms
            for places in [list(t.columns)]
            if (theta[places] < lowest[places]).any() or not np.allclose(theta[places], inside[places], rtol=1e-9)
        )


def count_effects(terms: frozenset[Term]) -> int:
    """Number of different effects among terms."""
    return len({term.effect for term in terms})
