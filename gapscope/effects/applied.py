"""Effects applied to an arm: the states they keep, and the torque they add."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from numbers import Integral
from typing import NamedTuple

import numpy as np

from gapscope.arm.errors import InputError
from gapscope.arm.nearest_name import nearest
from gapscope.effects.catalogue import effect as by_name
from gapscope.effects.catalogue import of_quantity
from gapscope.effects.effect import Effect
from gapscope.effects.environment import EXTERNAL_FORCE
from gapscope.effects.parameter import Parameter
from gapscope.effects.rigid_body import PAYLOAD

# An effect with values: what is injected into a simulator, or found by a diagnosis.


@dataclass(frozen=True)
class AppliedEffect:
    """An effect of the catalogue with its joints and parameter values.

    Attributes:
        name: name in the catalogue.
        joints: joints it acts on, counted from 1 in the case's order; empty for effects on the arm or a link.
        parameters: per parameter an array with one entry per joint, or a number or 3-vector for the arm or a link.

    Raises:
        InputError: unknown effect, missing or unknown parameter, wrong number of values, or a value out of bounds.
    """

    name: str
    joints: tuple[int, ...]
    parameters: Mapping[str, np.ndarray]

    def __post_init__(self) -> None:
        """Check names, sizes and bounds."""
        effect, joints = by_name(self.name), list(self.joints)
        known, given = effect.names, [str(name) for name in self.parameters]
        # what is absent by default may be left out, nothing else
        if not set(effect.needed) <= set(given) <= set(known):
            units = ", ".join(f"{p.name} in {p.unit}" for p in effect.parameters)
            remedy = f"give {units}"
            if unknown := [name for name in given if name not in known]:
                near = nearest(unknown[0], known)
                remedy = f"{unknown[0]!r} is unknown: {near}{remedy}"
            raise InputError(
                f"expected the parameters {', '.join(effect.needed)}; got "
                f"{', '.join(given) or 'none'}",
                remedy,
                where=self.name,
            )
        # joints are needed by effects of joints, and mean nothing to others
        if (effect.scope == "joint") != bool(joints):
            raise InputError(
                f"an effect of scope {effect.scope}, but joints are {joints}",
                "leave joints: out"
                if joints
                else "say on which joints, joints: [1, ...]",
                where=self.name,
            )
        whole = all(isinstance(joint, Integral) and joint >= 1 for joint in joints)
        if not whole or len(set(joints)) != len(joints):
            raise InputError(
                f"joints count from 1 and occur once, got {joints}", where=self.name
            )
        values = {p.name: self._checked(p, effect.scope) for p in effect.parameters}
        # a number in a file is a float: 2.0 is a link, 2.5 is none
        if effect.scope == "link" and values["link"] % 1:
            raise InputError(
                f"a link is a whole number, got {float(values['link'])}",
                where=f"{self.name}.link",
            )
        object.__setattr__(self, "parameters", values)

    def _checked(self, parameter: Parameter, scope: str) -> np.ndarray:
        """A parameter's values, as a read-only array of the right shape and within its bounds."""
        where = f"{self.name}.{parameter.name}"
        try:
            value = np.array(
                self.parameters.get(parameter.name, parameter.absent), dtype=float
            )
        except (TypeError, ValueError, OverflowError):
            raise InputError(
                f"holds a value that is not a number, {self.parameters[parameter.name]!r}",
                f"give numbers in {parameter.unit}",
                where=where,
            ) from None
        if scope == "joint":
            expected: tuple[int, ...] = (len(self.joints),)
            value = np.full(expected, float(value)) if value.ndim == 0 else value
        else:
            expected = () if parameter.size == 1 else (parameter.size,)
        if value.shape != expected:
            per = (
                "one value for each of the joints, or one number for all"
                if scope == "joint"
                else "x, y and z"
            )
            remedy = f"give {per}" if expected else "give one number"
            raise InputError(
                f"expected {int(np.prod(expected))} values, got {value.size}",
                remedy,
                where=where,
            )
        # bounds are what is possible, not what is usual: those are in the remedy
        low, high = parameter.bounds
        if not (
            np.isfinite(value).all() and (value >= low).all() and (value <= high).all()
        ):
            raise InputError(
                f"value {value.tolist()} outside {low:g} .. {high:g} {parameter.unit}",
                f"give {parameter.name} in {parameter.unit}; on real arms it lies near {parameter.typical[0]:g} .. "
                f"{parameter.typical[1]:g}",
                where=where,
            )
        # records are shared: nobody may change values in place
        value.setflags(write=False)
        return value

    @property
    def effect(self) -> Effect:
        """The effect's definition in the catalogue."""
        return by_name(self.name)

    @property
    def given(self) -> tuple[str, ...]:
        """Names of its parameters but for those that are absent on all joints."""
        return tuple(
            p.name
            for p in self.effect.parameters
            if p.absent is None or (self.parameters[p.name] != p.absent).any()
        )

    @property
    def key(self) -> tuple[str, int]:
        """Name of the effect, and the link that it changes, 0 without one."""
        return self.name, int(self.parameters.get("link", 0))

    def per_joint(self, parameter: str, n_joints: int) -> np.ndarray:
        """Values of a parameter over all joints, zero if the effect does not act; shape (n,).

        Raises:
            InputError: the effect names a joint that an arm with n joints does not have.
        """
        self.check(n_joints)
        out = np.zeros(n_joints)
        # joints count from 1, arrays from 0
        out[np.array(self.joints, dtype=int) - 1] = self.parameters[parameter]
        return out

    def check(self, n_joints: int) -> None:
        """Check that the joints, or the link, exist.

        Raises:
            InputError: they do not on an arm with n joints.
        """
        named = (
            [*self.joints, int(self.parameters["link"])]
            if self.effect.scope == "link"
            else [*self.joints]
        )
        if max(named, default=0) > n_joints:
            raise InputError(
                f"joint {max(named)} of an arm with {n_joints} joints",
                f"joints count from 1 to {n_joints} in the case's order; a link has the number of the joint that "
                "moves it",
                where=self.name,
            )


def drives_with(joints: tuple[int, ...], **quantities: np.ndarray) -> AppliedEffect:
    """The effect by which drives of some joints, or coupled motors, have quantities, keys of ``QUANTITIES``.

    Args:
        joints: numbers from 1, m of them.
        quantities: all of one effect, increments to the nominal arm or the values themselves, each of shape (m,).
    """
    effect, _ = of_quantity(next(iter(quantities)))
    # what is not given is absent
    values = {
        name: quantities[own]
        for name, own in effect.quantities.items()
        if own in quantities
    }
    return AppliedEffect(effect.name, joints, values)


def carried(mass: float, com: Sequence[float]) -> AppliedEffect:
    """A point mass [kg] at ``com`` [m] in the frame of the joint that moves the last link."""
    return AppliedEffect(
        PAYLOAD.name, (), {"mass": np.array(mass), "com": np.array(com)}
    )


def push(force: np.ndarray, start: float, end: float) -> AppliedEffect:
    """A force [N], world frame, shape (3,), on the last link from ``start`` to ``end`` [s]."""
    values = {"force": force, "start": np.array(start), "end": np.array(end)}
    return AppliedEffect(EXTERNAL_FORCE.name, (), values)


# States of an arm: effects that it has in some recordings only, or between two times of one.


class Place(NamedTuple):
    """Where something holds.

    Attributes:
        recordings: names.
        start, end: times between which it holds, by a recording's own clock [s]; infinite if it is all of it.
    """

    recordings: tuple[str, ...]
    start: float = -np.inf
    end: float = np.inf

    def holds(self, recording: str, start: float, end: float) -> bool:
        """Whether it holds in all of a span of a recording."""
        return recording in self.recordings and self.start <= start and end <= self.end


class State(NamedTuple):
    """All effects that an arm has at a place.

    Attributes:
        place: where.
        effects: the effects, those that it has everywhere among them.
    """

    place: Place
    effects: tuple[AppliedEffect, ...]


Entry = tuple[AppliedEffect, Place | None]
"""An effect, and where the arm has it; ``None`` for everywhere."""


def states_of(entries: Sequence[Entry], order: Sequence[str] = ()) -> tuple[State, ...]:
    """The states that entries make, each of a span of a recording, in which all hold or none.

    Args:
        entries: effects and where they hold.
        order: names of recordings in the order in which they were made; those that are not named there come first.
    """
    named = [name for _, place in entries if place for name in place.recordings]
    if not named:
        return ()
    others = (name for name in named if name not in order)
    states = []
    # the last one named stands for recordings that are not known
    for name in dict.fromkeys([*others, *order]):
        places = [place for _, place in entries if place and name in place.recordings]
        # cut wherever something begins or ends: within a part all hold or none
        times = {-np.inf, np.inf, *(t for p in places for t in (p.start, p.end))}
        for start, end in pairwise(sorted(times)):
            held = (e for e, p in entries if p is None or p.holds(name, start, end))
            states.append(State(Place((name,), start, end), tuple(held)))
    return tuple(states)
