"""The terms that a diagnosis may add to the nominal arm, as one parameter vector."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np

from gapscope.diagnosis.model.parametrisation import PARAMETRISATIONS, Parametrisation
from gapscope.effects.applied import AppliedEffect

EXPLAINED = tuple(PARAMETRISATIONS)
"""Effects that a diagnosis can find by the torque gap."""


@dataclass(frozen=True)
class Term:
    """One effect on one joint, on one link, or on the arm.

    Attributes:
        effect: name of the effect.
        joint: joint, or the joint that moves the link, from 1; 0 for the arm.
        columns: its places in the parameter vector.
    """

    effect: str
    joint: int
    columns: tuple[int, ...]

    @property
    def coordinates(self) -> Parametrisation:
        """The coordinates of its effect."""
        return PARAMETRISATIONS[self.effect]

    @property
    def finding(self) -> str:
        """What it is named with: all joints of an effect together, each link on its own."""
        return (
            f"{self.effect} {self.joint}"
            if self.coordinates.effect.scope == "link"
            else self.effect
        )


@dataclass(frozen=True)
class Terms:
    """All terms for an arm with n joints, the vector theta of their linear coordinates, and their shapes.

    Attributes:
        n_joints: n.
        shapes: per term with a shape its values; a term without one in the table cannot be chosen.
    """

    n_joints: int
    shapes: Mapping[Term, tuple[float, ...]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Lay out theta: effect by effect, coordinate by coordinate, joint by joint."""
        terms, start = [], 0
        for name, c in PARAMETRISATIONS.items():
            places = 1 if c.effect.scope == "arm" else self.n_joints
            for k in range(places):
                columns = tuple(start + i * places + k for i in range(c.linear))
                terms.append(
                    Term(name, 0 if c.effect.scope == "arm" else k + 1, columns)
                )
            start += places * c.linear
        object.__setattr__(self, "all", tuple(terms))
        object.__setattr__(self, "size", start)

    all: tuple[Term, ...] = field(init=False, compare=False)
    size: int = field(init=False, compare=False)

    def of(self, effect: str) -> tuple[Term, ...]:
        """The terms of an effect, in joint order."""
        return tuple(t for t in self.all if t.effect == effect)

    def block(self, effect: str) -> np.ndarray:
        """Places of an effect's linear coordinates in theta, shape (linear, joints, links or 1)."""
        return np.array([t.columns for t in self.of(effect)]).T

    @property
    def open(self) -> tuple[Term, ...]:
        """The terms that can be chosen."""
        return tuple(t for t in self.all if not t.coordinates.shape or t in self.shapes)

    def effects(
        self, theta: np.ndarray, terms: Iterable[Term] | None = None
    ) -> tuple[AppliedEffect, ...]:
        """Effects with the values of theta, those of ``terms`` or else those that are not zero.

        Raises:
            InputError: a value lies outside the bounds of its parameter.
        """
        chosen = [
            t
            for t in self.all
            if (
                theta[list(t.columns)].any() if terms is None else t in frozenset(terms)
            )
        ]
        found: dict[str, list[Term]] = {}
        for term in chosen:
            found.setdefault(term.finding, []).append(term)
        return tuple(self._applied(group, theta) for group in found.values())

    def _applied(self, group: list[Term], theta: np.ndarray) -> AppliedEffect:
        """One finding's terms as an effect, its values moved into their bounds."""
        c = group[0].coordinates
        linear = np.array([theta[list(t.columns)] for t in group]).T
        shape = (
            np.array([self.shapes[t] for t in group]).T
            if c.shape
            else np.zeros((0, len(group)))
        )
        values = dict(c.values(linear, shape))
        if c.effect.scope != "joint":
            values = {
                name: np.squeeze(value, axis=-1) for name, value in values.items()
            }
        if c.effect.scope == "link":
            values = {"link": np.array(float(group[0].joint)), **values}
        bounded = {
            p.name: np.clip(values[p.name], *p.bounds) for p in c.effect.parameters
        }
        return AppliedEffect(
            c.effect.name,
            tuple(t.joint for t in group) if c.effect.scope == "joint" else (),
            bounded,
        )

    def clipped(self, theta: np.ndarray) -> np.ndarray:
        """Theta with values of springs, bodies and effects that have a single parameter moved into their bounds."""
        out = theta.copy()
        for name, c in PARAMETRISATIONS.items():
            if c.linear == 1 and not c.shape:
                block = self.block(name)
                out[block] = np.clip(out[block], *c.effect.parameters[0].bounds)
        stiffness, moment = self.block("parallel_spring")
        farthest = PARAMETRISATIONS["parallel_spring"].effect.parameter("rest").bounds[
            1
        ] * np.abs(out[stiffness])
        out[moment] = np.clip(out[moment], -farthest, farthest)
        for row, parameter in zip(
            self.block("link_inertia"), ("mass", "com", "com", "com"), strict=True
        ):
            out[row] = np.clip(
                out[row],
                *PARAMETRISATIONS["link_inertia"].effect.parameter(parameter).bounds,
            )
        mass, com = (p.bounds for p in PARAMETRISATIONS["payload"].effect.parameters)
        places = self.block("payload")[:, 0]
        m = np.clip(out[places[0]], *mass)
        out[places[0]] = m
        out[places[1:]] = np.clip(out[places[1:]], -abs(m) * com[1], abs(m) * com[1])
        return out

    def impossible(
        self, theta: np.ndarray, terms: frozenset[Term], lowest: np.ndarray
    ) -> frozenset[Term]:
        """Those of the terms whose values cannot be: outside their bounds, or below ``lowest``."""
        inside = self.clipped(theta)
        return frozenset(
            t
            for t in terms
            for places in [list(t.columns)]
            if (theta[places] < lowest[places]).any()
            or not np.allclose(theta[places], inside[places], rtol=1e-9)
        )


def count_findings(terms: Iterable[Term]) -> int:
    """Number of different findings among terms."""
    return len({term.finding for term in terms})


def cost(terms: Iterable[Term]) -> int:
    """Number of parameters that terms spend."""
    return sum(term.coordinates.cost for term in terms)
