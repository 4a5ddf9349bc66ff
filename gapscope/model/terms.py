"""The terms that a diagnosis may add to the nominal arm, as one parameter vector."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from gapscope.effects.applied import AppliedEffect
from gapscope.effects.catalogue import effect as by_name
from gapscope.effects.catalogue import explained
from gapscope.effects.effect import Effect, External, LinkChange
from gapscope.effects.parametrisation import Parametrisation


@dataclass(frozen=True)
class Term:
    """One effect on one joint, on one link, or on the arm.

    Attributes:
        effect: name of the effect.
        joint: joint, coupled motor, or the joint that moves the link, from 1; 0 for the arm.
        columns: its places in the parameter vector.
    """

    effect: str
    joint: int
    columns: tuple[int, ...]

    @cached_property
    def definition(self) -> Effect:
        """The catalogue's record of its effect."""
        return by_name(self.effect)

    @cached_property
    def parametrisation(self) -> Parametrisation:
        """How its effect is fitted."""
        return self.definition.fitted

    def __hash__(self) -> int:
        """By its place, once: searches look terms up a hundred thousand times."""
        return self._hash

    @cached_property
    def _hash(self) -> int:
        # of numbers alone, since that of a text differs in the next process
        return hash((self.joint, self.columns))

    @property
    def is_load(self) -> bool:
        """Whether it is a body that the last link carries."""
        return isinstance(self.definition, LinkChange) and not self.joint

    def changes_link(self, joint: int) -> bool:
        """Whether it is a change of the link that a joint moves, from 1."""
        return isinstance(self.definition, LinkChange) and self.joint == joint

    @property
    def finding(self) -> str:
        """What it is named with: all joints of an effect together, each link on its own."""
        return (
            f"{self.effect} {self.joint}"
            if self.definition.scope == "link"
            else self.effect
        )


@dataclass(frozen=True)
class Candidate:
    """A term that groups have of their own, with one value, or one with a searched form that everybody has.

    Attributes:
        term: the term.
        groups: numbers of the groups; ``None`` for everybody.
    """

    term: Term
    groups: tuple[int, ...] | None

    def __hash__(self) -> int:
        """Made once, as that of its term."""
        return self._hash

    @cached_property
    def _hash(self) -> int:
        return hash((self.term, self.groups or ()))

    @property
    def everybody(self) -> bool:
        """Whether everybody has it."""
        return self.groups is None

    def has(self, group: int) -> bool:
        """Whether a group has it."""
        return self.groups is None or group in self.groups

    @property
    def effect(self) -> str:
        """Name of its effect."""
        return self.term.effect


class Terms:
    """All terms for an arm with n joints, the vector theta of their linear coordinates, and their shapes.

    Theta is laid out effect by effect, coordinate by coordinate, joint by joint.

    Args:
        n_joints: n.
        shapes: per term with a shape its values; a term without one in the table cannot be chosen.
        motors: numbers of the motors that turn several joints.

    Attributes:
        all: all terms, effect by effect.
        size: length of theta.
    """

    def __init__(
        self,
        n_joints: int,
        shapes: Mapping[Term, tuple[float, ...]] | None = None,
        motors: tuple[int, ...] = (),
    ) -> None:
        self.n_joints, self.motors = n_joints, motors
        self.shapes, self.size = shapes or {}, 0
        self._by_effect: dict[str, tuple[Term, ...]] = {}
        self._blocks: dict[str, np.ndarray] = {}
        for effect in self.definitions:
            joints: Sequence[int] = range(1, n_joints + 1)
            # one for the arm, one for each coupled motor; links go by their joints
            if effect.scope == "arm":
                joints = (0,)
            elif effect.reach == "motor":
                joints = motors
            count = effect.fitted.linear * len(joints)
            # one row for each coordinate, one column for each joint, link or motor
            block = self.size + np.arange(count).reshape(-1, len(joints))
            self._by_effect[effect.name] = tuple(
                Term(effect.name, joint, tuple(places))
                for joint, places in zip(joints, block.T.tolist(), strict=True)
            )
            self._blocks[effect.name] = block
            self.size += count
        self.all = tuple(itertools.chain.from_iterable(self._by_effect.values()))

    @property
    def definitions(self) -> list[Effect]:
        """The effects that the terms are of, in their order."""
        return explained(coupled=bool(self.motors))

    def can_choose(self, term: Term) -> bool:
        """Whether a term needs no nonlinear parameters, or has them."""
        return not term.parametrisation.nonlinear or term in self.shapes

    @property
    def forces(self) -> dict[Term, tuple[float, ...]]:
        """Forces from outside, with the times between which they act at the bounds: all the time."""
        out = {}
        for term in self.all:
            if isinstance(term.definition, External):
                times = term.parametrisation.nonlinear
                bounds = {p.name: p.bounds for p in term.definition.parameters}
                # the widest times that are allowed: a force that acts all along
                out[term] = tuple(bounds[name][k] for k, name in enumerate(times))
        return out

    def of(self, effect: str) -> tuple[Term, ...]:
        """The terms of an effect, in joint order."""
        return self._by_effect.get(effect, ())

    def choosable(self, effect: str) -> list[Term]:
        """Those of them that need no nonlinear parameters, or have them."""
        return [term for term in self.of(effect) if self.can_choose(term)]

    def block(self, effect: str) -> np.ndarray:
        """Places of an effect's linear coordinates in theta, shape (linear, joints, links, motors or 1)."""
        return self._blocks[effect]

    def effects(
        self, theta: np.ndarray, terms: Iterable[Term] | None = None
    ) -> tuple[AppliedEffect, ...]:
        """Effects with the values of theta, those of ``terms`` or else those that are not zero.

        Raises:
            InputError: a value lies outside the bounds of its parameter.
        """
        # a value of zero is no effect; one that was asked for is told whatever it is
        if terms is None:
            chosen = [t for t in self.all if theta[list(t.columns)].any()]
        else:
            wanted = frozenset(terms)
            chosen = [t for t in self.all if t in wanted]
        # joints of one effect are one applied effect, changed links one each
        found: dict[str, list[Term]] = {}
        for term in chosen:
            found.setdefault(term.finding, []).append(term)
        return tuple(self._applied(group, theta) for group in found.values())

    def _applied(self, group: list[Term], theta: np.ndarray) -> AppliedEffect:
        """One finding's terms as an effect, its values moved into their bounds."""
        effect = group[0].definition
        linear = np.array([theta[list(t.columns)] for t in group]).T
        shape = None
        if effect.fitted.nonlinear:
            shape = np.array([self.shapes[t] for t in group]).T
        values = dict(effect.values_at(linear, shape))
        # of the arm or a link there is one value, and no axis of joints
        if effect.scope != "joint":
            values = {
                name: np.squeeze(value, axis=-1) for name, value in values.items()
            }
        # in files the link is a parameter like others
        if effect.scope == "link":
            values = {"link": np.array(float(group[0].joint)), **values}
        return AppliedEffect(
            effect.name,
            tuple(t.joint for t in group) if effect.scope == "joint" else (),
            values,
        )

    def clipped(self, theta: np.ndarray) -> np.ndarray:
        """Theta with the coordinates of every effect that has bounds moved into them."""
        out = theta.copy()
        for effect in self.definitions:
            clip = effect.fitted.clip
            if clip is not None:
                block = self.block(effect.name)
                out[block] = clip(out[block])
        return out
