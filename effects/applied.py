"""An effect with values: what is injected into a simulator, or found by a diagnosis."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from numbers import Integral

import numpy as np

from arm.errors import InputError
from effects.catalogue import effect as by_name
from effects.effect import Effect


@dataclass(frozen=True)
class AppliedEffect:
    """An effect of the catalogue with its joints and parameter values.

    Attributes:
        name: name in the catalogue.
        joints: joints it acts on, counted from 1 in the case's order; empty for effects on the arm or a link.
        parameters: per parameter an array with one entry per joint, or a number or 3-vector for the arm.

    Raises:
        InputError: unknown effect, missing or unknown parameter, wrong number of values, or a value out of bounds.
    """

    name: str
    joints: tuple[int, ...]
    parameters: Mapping[str, np.ndarray]

    def __post_init__(self) -> None:
        """Check names, sizes and bounds."""
        definition = by_name(self.name)
        unknown = set(self.parameters) ^ set(definition.names)
        if unknown:
            raise InputError(
                f"expected the parameters {', '.join(definition.names)}; got {', '.join(self.parameters) or 'none'}",
                where=self.name,
            )
        if (definition.scope == "joint") != bool(self.joints):
            raise InputError(
                f"an effect of scope {definition.scope}, but joints are {list(self.joints)}", where=self.name
            )
        if any(not isinstance(joint, Integral) or joint < 1 for joint in self.joints) or len(set(self.joints)) != len(
            self.joints
        ):
            raise InputError(f"joints count from 1 and occur once, got {list(self.joints)}", where=self.name)
        values = {}
        for parameter in definition.parameters:
            value = np.array(self.parameters[parameter.name], dtype=float)
            expected = (
                (len(self.joints),)
                if definition.scope == "joint"
                else (() if parameter.size == 1 else (parameter.size,))
            )
            if definition.scope == "joint" and value.ndim == 0:
                value = np.full(expected, float(value))
            if value.shape != expected:
                raise InputError(
                    f"expected {int(np.prod(expected))} values, got {value.size}", where=f"{self.name}.{parameter.name}"
                )
            low, high = parameter.bounds
            if not (np.isfinite(value).all() and (value >= low).all() and (value <= high).all()):
                raise InputError(
                    f"value {value.tolist()} outside {low} .. {high} {parameter.unit}",
                    where=f"{self.name}.{parameter.name}",
                )
            value.setflags(write=False)
            values[parameter.name] = value
        object.__setattr__(self, "parameters", values)

    @property
    def effect(self) -> Effect:
        """The effect's definition in the catalogue."""
        return by_name(self.name)

    def per_joint(self, parameter: str, n_joints: int) -> np.ndarray:
        """Values of a parameter over all joints, zero where the effect does not act; shape (n,)."""
        out = np.zeros(n_joints)
        if max(self.joints, default=0) > n_joints:
            raise InputError(f"joint {max(self.joints)} of an arm with {n_joints} joints", where=self.name)
        out[np.array(self.joints, dtype=int) - 1] = self.parameters[parameter]
        return out
