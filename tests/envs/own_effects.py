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

RECORDS: dict[str, Any] = {}
VALUES: dict[str, dict[str, Any]] = {}
"""Of each on joints 2 and 4 of a KUKA iiwa."""


def _own(
    kind: type[Effect], name: str, values: dict[str, Any], *scope: str, **laws: Any
) -> None:
    """Enter a record with laws, and parameters in any unit and of any size."""
    parameters = tuple(
        Parameter(
            *(x, x, "1", (-1e3, 1e3), (0.1, 1.0)),
            size=3 if x in ("force", "com") else 1,
            severity=0 if x in ("velocity", "start", "end") else 1,
        )
        for x in values
    )
    texts = {"family": "friction", "equation": "", "looks_like": "", "reference": ""}
    laws |= {"scope": scope[0] if scope else "joint", "parameters": parameters}
    RECORDS[name], VALUES[name] = kind(name, **texts, **laws), values


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


_own(
    *(TorqueLaw, "cubic", {"k": [2.0, 3.0]}),
    law=lambda s, k: k * s.velocity**3 + k * s.position,
)
_own(
    *(DryLaw, "hyperbolic", {"c": [4.0, 3.0], "velocity": 0.2}),
    **_dry(lambda v, load, c, speed: c / (1.0 + np.abs(v) / np.maximum(speed, 1e-3))),
)
_own(DryLaw, "kinked", {"c": [4.0, 3.0]}, **_dry(_kinked))
_own(DryLaw, "loaded", {"share": [0.1, 0.2]}, law=_under_load, amplitude=_loaded)
_own(
    *(DryLaw, "steady", {"c": [2.0, 1.5]}),
    **_dry(lambda v, load, c: c**2 + 0.0 * v),
    varies_with="nothing",
)
_own(
    *(Drift, "warming", {"share": [4.0, -2.0]}),
    change=lambda t, share: share / (9.0 + t),
)
_own(
    *(LinkChange, "tool", {"mass": 0.7, "com": [0.05, 0.0, 0.1]}, "arm"),
    change=lambda own, mass, com: (
        point_mass_parameters(float(mass), com)
        + point_mass_parameters(float(mass), -com)
    ),
)
_own(
    *(Path, "eccentric", {"share": [0.2, 0.3]}),
    place=6,
    applied=lambda u, series, a: u * (1.0 + a * np.sin(series.position)),
    inverse=lambda u, series, a: u / (1.0 + a * np.sin(series.position)),
)
_own(
    *(Path, "early_offset", {"torque": [2.0, -3.0]}),
    place=0,
    varies_with="nothing",
    applied=lambda u, series, torque: u - torque,
    inverse=lambda u, series, torque: u + torque,
)
_own(
    *(Sensing, "stretched", {"share": [0.04, 0.06]}),
    recorded=lambda q, share: q * (1.0 + share),
    true=lambda q, share: q / (1.0 + share),
)
_own(
    *(External, "knocks", {"force": [20.0, 5.0, -9.0], "start": 0.1, "end": 0.4}, "arm"),
    active=lambda t, start, end: (t >= start) & (t < end) & (t * 20 % 2 < 1),
)  # fmt: skip


def on_arm(name: str) -> AppliedEffect:
    """One of them, once it is registered, with its values."""
    joints = (2, 4) if RECORDS[name].scope == "joint" else ()
    return AppliedEffect(name, joints, VALUES[name])
