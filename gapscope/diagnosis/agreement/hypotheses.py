"""What may differ between recordings: each base parameter, the load on the last link, the torque's gain of a joint."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from gapscope.diagnosis.agreement.equations import Equations
from gapscope.ident.estimators.partial_update import RELATIVE
from gapscope.ident.model.recoverability import shortened

WORDS = {
    "c": "Coulomb friction",
    "d": "Stribeck friction",
    "s": "saturating friction",
    "b": "viscous friction",
    "o": "torque offset",
    "I": "rotor inertia",
}
"""Quantities of a joint by the symbol of their column."""
LOAD = "load"
"""Key of the hypothesis that the load on the last link differs."""


@dataclass(frozen=True)
class Hypothesis:
    """One quantity that may have another value in each recording.

    Attributes:
        key: short name, ``c2``, ``load`` or ``gain2``.
        name: in words.
        unit: of its value.
        joint: from 1; ``None`` if it acts on several.
        directions: change of the base parameters per unit, as joint j's torque sees it, (d, n, b); the first of the d
            is the value that is shown.
        replaces: number of the base parameter whose own value it is; ``None``: differences from the first recording.
        centre: value of the first recording then.
        spread: standard deviation of the value before any recording.
    """

    key: str
    name: str
    unit: str
    joint: int | None
    directions: np.ndarray
    replaces: int | None
    centre: float
    spread: float


def hypotheses(of: Equations) -> tuple[Hypothesis, ...]:
    """Friction, rotors and offsets by joint, then the gains, the load, and the inertial base parameters."""
    own = [_parameter(of, k) for k in range(of.base.count)]
    joints = [one for one in own if one.joint is not None]
    bodies = [one for one in own if one.joint is None]
    return (*sorted(joints, key=_by_joint), *_gains(of), *_load(of), *bodies)


def _by_joint(one: Hypothesis) -> int:
    return one.joint or 0


def _parameter(of: Equations, k: int) -> Hypothesis:
    """Base parameter k."""
    n, b = of.power.shape[:2]
    directions = np.zeros((1, n, b))
    directions[0, :, k] = 1.0
    symbol = of.base.names[of.base.kept[k]]
    parts = re.fullmatch(r"([a-zA-Z])(\d+)(m?)", symbol)
    name, joint = f"body: {shortened(of.base.expressions(1e-4)[k])}", None
    if parts is not None and parts[1] in WORDS:
        joint = int(parts[2])
        place = f"motor {joint}" if parts[3] else f"joint {joint}"
        name = f"{WORDS[parts[1]]} of {place}"
    return Hypothesis(
        key=symbol,
        name=name,
        unit=of.units[k],
        joint=joint,
        directions=directions,
        replaces=k,
        centre=0.0,
        spread=float(of.spread[k]),
    )


def _gains(of: Equations) -> list[Hypothesis]:
    """Recorded over true torque of each joint: all that joint's columns by one factor."""
    n, b = of.power.shape[:2]
    found = []
    for joint in range(n):
        directions = np.zeros((1, n, b))
        directions[0, joint] = of.value
        found.append(
            Hypothesis(
                key=f"gain{joint + 1}",
                name=f"torque gain of joint {joint + 1}",
                unit="1",
                joint=joint + 1,
                directions=directions,
                replaces=None,
                centre=1.0,
                spread=RELATIVE,
            )
        )
    return found


def _load(of: Equations) -> list[Hypothesis]:
    """A body on the last link: its mass, first moments and inertia, as far as base parameters show them."""
    link = of.columns.body.last_link
    own = slice(10 * link, 10 * link + 10)
    effect = of.base.combination[:, own]
    n = of.power.shape[0]
    mass = float(of.columns.nominal(of.law)[10 * link])
    if not np.abs(effect[:, 0]).any():
        return []
    return [
        Hypothesis(
            key=LOAD,
            name="load on the last link",
            unit="kg",
            joint=None,
            directions=np.repeat(effect.T[:, None, :], n, axis=1),
            replaces=None,
            centre=0.0,
            spread=max(mass, 1.0),
        )
    ]
