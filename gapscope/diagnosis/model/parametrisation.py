"""The coordinates of an effect: numbers in which the torque is linear, or nearly so, and those in which it is not.

A parameter like a ripple's phase or a resonant joint's stiffness enters the torque in an awkward way, a combination of
parameters in a simple one. Linear coordinates are fitted by least squares; the others, the *shape*, are searched.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from gapscope.effects.catalogue import CATALOGUE
from gapscope.effects.effect import Effect

Values = Mapping[str, np.ndarray]


@dataclass(frozen=True)
class Parametrisation:
    """How one effect is written, on one joint, one link or the whole arm.

    Attributes:
        effect: its definition.
        linear: number of linear coordinates.
        shape: names of the parameters that are searched.
        values: parameters from linear coordinates, shape (linear, m), and shape coordinates, shape (s, m); m joints.
        step: step of the linear coordinates for finite differences.
        lowest: least value of the first linear coordinate; of friction and armature, where the data sheet's share is
            added, that is minus the share.
    """

    effect: Effect
    linear: int
    shape: tuple[str, ...]
    values: Callable[[np.ndarray, np.ndarray], Values]
    step: float = 1.0
    lowest: float = -np.inf

    @property
    def cost(self) -> int:
        """Number of parameters that it spends."""
        return self.linear + len(self.shape)


def _safe(divisor: np.ndarray) -> np.ndarray:
    """A divisor kept away from zero, its sign kept."""
    return np.where(np.abs(divisor) < 1e-9, 1e-9, divisor)


def _first(name: str) -> Callable[[np.ndarray, np.ndarray], Values]:
    return lambda x, shape: {name: x[0]}


def _stribeck(x: np.ndarray, shape: np.ndarray) -> Values:
    return {"torque": x[0], "velocity": shape[0]}


def _drift(x: np.ndarray, shape: np.ndarray) -> Values:
    return {"amplitude": x[0], "time_constant": shape[0]}


def _ripple(x: np.ndarray, shape: np.ndarray) -> Values:
    """A sin(n q + phi) = x0 sin n q + x1 cos n q."""
    return {
        "amplitude": np.hypot(x[0], x[1]),
        "cycles": shape[0],
        "phase": np.arctan2(x[1], x[0]),
    }


def _spring(x: np.ndarray, shape: np.ndarray) -> Values:
    """K (q - q0) = x0 q - x1."""
    return {"stiffness": x[0], "rest": x[1] / _safe(x[0])}


def _elasticity(x: np.ndarray, shape: np.ndarray) -> Values:
    """Deflection = x0 tau - x1 dtau/dt, with x0 = 1 / k and x1 = d / k^2."""
    compliance = np.maximum(x[0], 1e-12)
    return {
        "stiffness": 1.0 / compliance,
        "damping": np.maximum(x[1], 0.0) / compliance**2,
    }


def _saturation(x: np.ndarray, shape: np.ndarray) -> Values:
    return {"limit": shape[0]}


def _payload(x: np.ndarray, shape: np.ndarray) -> Values:
    """Mass m and first moment h = m c."""
    return {"mass": x[0], "com": x[1:] / _safe(x[0])}


def _link(x: np.ndarray, shape: np.ndarray) -> Values:
    return {"mass": x[0], "com": x[1:]}


def _tilt(x: np.ndarray, shape: np.ndarray) -> Values:
    return {"roll": x[0], "pitch": x[1]}


def _force(x: np.ndarray, shape: np.ndarray) -> Values:
    return {"force": x, "start": shape[0], "end": shape[1]}


def _of(
    name: str,
    linear: int = 1,
    shape: tuple[str, ...] = (),
    *,
    step: float = 1.0,
    lowest: float = -np.inf,
    values: Callable[[np.ndarray, np.ndarray], Values] | None = None,
) -> Parametrisation:
    effect = CATALOGUE[name]
    return Parametrisation(
        effect, linear, shape, values or _first(effect.names[0]), step, lowest
    )


PARAMETRISATIONS: dict[str, Parametrisation] = {
    c.effect.name: c
    for c in (
        _of("coulomb_friction"),
        _of("viscous_friction"),
        _of("load_friction", step=1e-3, lowest=0.0),
        _of("stribeck_friction", shape=("velocity",), values=_stribeck),
        _of(
            "friction_drift",
            shape=("time_constant",),
            values=_drift,
            step=1e-3,
            lowest=-1.0,
        ),
        _of("payload", 4, values=_payload),
        _of("link_inertia", 4, values=_link),
        _of("armature"),
        _of("base_tilt", 2, values=_tilt),
        _of("joint_elasticity", 2, values=_elasticity, lowest=0.0),
        _of("backlash", lowest=0.0),
        _of("torque_ripple", 2, ("cycles",), values=_ripple),
        _of("parallel_spring", 2, values=_spring),
        _of("torque_scale", step=1e-3),
        _of("torque_offset"),
        _of("torque_saturation", shape=("limit",), values=_saturation, lowest=0.6),
        _of("actuator_lag", step=1e-4, lowest=0.0),
        _of("actuator_delay", step=1e-4, lowest=0.0),
        _of("encoder_offset"),
        _of("external_force", 3, ("start", "end"), values=_force),
    )
}
"""Every effect that a torque gap can show; quantisation shows in the positions themselves."""
