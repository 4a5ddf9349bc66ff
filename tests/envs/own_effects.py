"""Effects that the catalogue does not have, one of each kind that the simulator takes as it is."""

from __future__ import annotations

from typing import Any

import numpy as np

from gapscope.arm.known_load import point_mass_parameters
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.effect import (
    Drift,
    DryLaw,
    Effect,
    External,
    Law,
    LinkChange,
    Path,
    Sensing,
    TorqueLaw,
)
from gapscope.effects.parameter import Parameter


def _record(
    kind: type[Effect], name: str, *parameters: str, scope: str = "joint", **laws: Any
) -> Any:
    """A record with laws, and parameters in any unit and of any size."""
    named = [
        Parameter(
            x,
            x,
            "1",
            (-1e3, 1e3),
            (0.1, 1.0),
            size=3 if x in ("force", "com") else 1,
            severity=0 if x in ("velocity", "start", "end") else 1,
        )
        for x in parameters
    ]
    common = {"family": "friction", "equation": "", "looks_like": "", "reference": ""}
    return kind(name, scope=scope, parameters=tuple(named), **common, **laws)


def _dry(amplitude: Law) -> dict[str, Law]:
    """The laws of dry friction with an amplitude."""

    def law(signals: Any, *values: np.ndarray) -> np.ndarray:
        return signals.direction * amplitude(signals.velocity, signals.load, *values)

    return {"law": law, "amplitude": amplitude}


def _kinked(velocity: np.ndarray, load: np.ndarray, torque: np.ndarray) -> np.ndarray:
    """Asks which joints are fast, so that it cannot be noted and repeated."""
    slow = np.abs(velocity) < 0.3
    return torque * np.where(slow, 1.0, 0.5 + 0.15 / np.maximum(np.abs(velocity), 0.3))


def _loaded(velocity: np.ndarray, load: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Varies with velocity and load."""
    return share * np.abs(load) / (1.0 + velocity * velocity)


def _under_load(signals: Any, share: np.ndarray) -> np.ndarray:
    """The same, with the motor torque that itself overcomes it as load."""
    directed = signals.direction * np.sign(signals.load)
    part = _loaded(signals.velocity, directed, share) * directed
    return signals.load * part / (1.0 - part)


OWN = (
    (
        _record(
            TorqueLaw, "cubic", "k", law=lambda s, k: k * s.velocity**3 + k * s.position
        ),
        {"k": [2.0, 3.0]},
    ),
    (
        _record(
            DryLaw,
            "hyperbolic",
            "c",
            "velocity",
            **_dry(
                lambda v, load, c, speed: (
                    c / (1.0 + np.abs(v) / np.maximum(speed, 1e-3))
                )
            ),
        ),
        {"c": [4.0, 3.0], "velocity": 0.2},
    ),
    (_record(DryLaw, "kinked", "c", **_dry(_kinked)), {"c": [4.0, 3.0]}),
    (
        _record(DryLaw, "loaded", "share", law=_under_load, amplitude=_loaded),
        {"share": [0.1, 0.2]},
    ),
    (
        _record(
            DryLaw,
            "steady",
            "c",
            varies_with="nothing",
            **_dry(lambda v, load, c: c**2 + 0.0 * v),
        ),
        {"c": [2.0, 1.5]},
    ),
    (
        _record(Drift, "warming", "share", change=lambda t, share: share / (9.0 + t)),
        {"share": [4.0, -2.0]},
    ),
    (
        _record(
            LinkChange,
            "tool",
            "mass",
            "com",
            scope="arm",
            change=lambda own, mass, com: (
                point_mass_parameters(float(mass), com)
                + point_mass_parameters(float(mass), -com)
            ),
        ),
        {"mass": 0.7, "com": [0.05, 0.0, 0.1]},
    ),
    (
        _record(
            Path,
            "eccentric",
            "share",
            place=6,
            applied=lambda u, series, a: u * (1.0 + a * np.sin(series.position)),
            inverse=lambda u, series, a: u / (1.0 + a * np.sin(series.position)),
        ),
        {"share": [0.2, 0.3]},
    ),
    (
        _record(
            Path,
            "early_offset",
            "torque",
            place=0,
            varies_with="nothing",
            applied=lambda u, series, torque: u - torque,
            inverse=lambda u, series, torque: u + torque,
        ),
        {"torque": [2.0, -3.0]},
    ),
    (
        _record(
            Sensing,
            "stretched",
            "share",
            recorded=lambda q, share: q * (1.0 + share),
            true=lambda q, share: q / (1.0 + share),
        ),
        {"share": [0.04, 0.06]},
    ),
    (
        _record(
            External,
            "knocks",
            "force",
            "start",
            "end",
            scope="arm",
            active=lambda t, start, end: (t >= start) & (t < end) & (t * 20 % 2 < 1),
        ),
        {"force": [20.0, 5.0, -9.0], "start": 0.1, "end": 0.4},
    ),
)
"""Each with values on joints 2 and 4 of a KUKA iiwa."""
RECORDS = {effect.name: effect for effect, _ in OWN}


def on_arm(name: str) -> AppliedEffect:
    """One of them, once it is registered, with its values."""
    effect, values = next(item for item in OWN if item[0].name == name)
    joints = (2, 4) if effect.scope == "joint" else ()
    return AppliedEffect(name, joints, values)
