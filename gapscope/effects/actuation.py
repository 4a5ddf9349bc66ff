"""The actuation family: what stands between the recorded torque and the joint.

Convention: applied = (1 + s) u + offset + ripple, where u is the recorded torque clipped at the limit, delayed, and
lagged; and applied is what the rigid body with its friction needs.
"""

from __future__ import annotations

import numpy as np

from gapscope.effects.effect import Parameter, Path, Series


def saturate(
    torque: np.ndarray, series: Series | None, limit: np.ndarray
) -> np.ndarray:
    """clip(tau, -limit, limit) [N m]; a limit of 0 means none.

    It is its own inverse as far as there is one: what was recorded beyond the limit is lost, and a needed torque beyond
    it cannot have been applied.
    """
    bound = np.where(limit > 0, limit, np.inf)
    return np.clip(torque, -bound, bound)


def delay_inverse(needed: np.ndarray, series: Series, delay: np.ndarray) -> np.ndarray:
    """recorded(t) = needed(t + T) [N m]; T in s."""
    return series.shifted(needed, delay)


def delay(recorded: np.ndarray, series: Series, time: np.ndarray) -> np.ndarray:
    """applied(t) = recorded(t - T) [N m]; T in s."""
    return series.shifted(recorded, -time)


def lag_inverse(
    needed: np.ndarray, series: Series, time_constant: np.ndarray
) -> np.ndarray:
    """Recorded = needed + T d needed / dt [N m]; T in s."""
    if not np.any(time_constant):
        return needed
    return needed + time_constant * series.rate(needed)


def lag(recorded: np.ndarray, series: Series, time_constant: np.ndarray) -> np.ndarray:
    """Applied = recorded behind 1 / (1 + T s) [N m]; T in s."""
    return series.lagged(recorded, time_constant)


def scale_inverse(
    needed: np.ndarray, series: Series | None, scale: np.ndarray
) -> np.ndarray:
    """Recorded = needed / (1 + s) [N m]; s > -1, dimensionless."""
    return needed / (1.0 + scale)


def scale(recorded: np.ndarray, series: Series | None, scale: np.ndarray) -> np.ndarray:
    """Applied = (1 + s) recorded [N m]."""
    return recorded * (1.0 + scale)


def offset_inverse(
    needed: np.ndarray, series: Series | None, torque: np.ndarray
) -> np.ndarray:
    """Recorded = needed - offset [N m]."""
    return needed - torque


def offset(
    recorded: np.ndarray, series: Series | None, torque: np.ndarray
) -> np.ndarray:
    """Applied = recorded + offset [N m]."""
    return recorded + torque


def ripple_torque(
    position: np.ndarray, amplitude: np.ndarray, cycles: np.ndarray, phase: np.ndarray
) -> np.ndarray:
    """A sin(n q + phi) [N m]; A in N m, n periods per revolution, phi and q in rad."""
    return amplitude * np.sin(cycles * position + phase)


def ripple_inverse(
    needed: np.ndarray,
    series: Series,
    amplitude: np.ndarray,
    cycles: np.ndarray,
    phase: np.ndarray,
) -> np.ndarray:
    """Recorded = needed - A sin(n q + phi) [N m]."""
    return needed - ripple_torque(series.position, amplitude, cycles, phase)


def ripple(
    recorded: np.ndarray,
    series: Series,
    amplitude: np.ndarray,
    cycles: np.ndarray,
    phase: np.ndarray,
) -> np.ndarray:
    """Applied = recorded + A sin(n q + phi) [N m]."""
    return recorded + ripple_torque(series.position, amplitude, cycles, phase)


SATURATION = Path(
    name="torque_saturation",
    family="actuation",
    scope="joint",
    equation="applied = clip(recorded, -limit, limit)",
    parameters=(Parameter("limit", "L", "N m", (1e-3, 1e4), (5.0, 300.0)),),
    looks_like="a gap at high torque only, with the sign of the torque",
    reference="hwangbo2019",
    confused_with=(("torque_scale", "the same motion at two amplitudes"),),
    inverse=saturate,
    applied=saturate,
    place=0,
)

DELAY = Path(
    name="actuator_delay",
    family="actuation",
    scope="joint",
    equation="applied(t) = recorded(t - T)",
    parameters=(Parameter("delay", "T", "s", (0.0, 0.2), (0.002, 0.02)),),
    looks_like="a phase lag of the torque that grows linearly with frequency",
    reference="hwangbo2019",
    confused_with=(
        ("actuator_lag", "a chirp above 10 Hz"),
        ("armature", "a chirp above 10 Hz"),
        ("viscous_friction", "a chirp above 10 Hz"),
    ),
    inverse=delay_inverse,
    applied=delay,
    place=1,
)

LAG = Path(
    name="actuator_lag",
    family="actuation",
    scope="joint",
    equation="T d applied / dt + applied = recorded",
    parameters=(Parameter("time_constant", "T", "s", (0.0, 0.5), (0.005, 0.03)),),
    looks_like="a torque that rolls off with frequency",
    reference="hwangbo2019",
    confused_with=(
        ("actuator_delay", "a chirp above 10 Hz"),
        ("armature", "a chirp above 10 Hz"),
    ),
    inverse=lag_inverse,
    applied=lag,
    place=2,
)

SCALE = Path(
    name="torque_scale",
    family="actuation",
    scope="joint",
    equation="applied = (1 + s) recorded",
    parameters=(Parameter("scale", "s", "1", (-0.6, 1.5), (0.1, 0.3)),),
    looks_like="a gap proportional to the whole torque of the joint",
    reference="gautier2014",
    confused_with=(
        ("payload", "the same motion with a known payload"),
        ("load_friction", "slow motion in both directions under load"),
        ("torque_saturation", "the same motion at two amplitudes"),
    ),
    inverse=scale_inverse,
    applied=scale,
    place=3,
)

OFFSET = Path(
    name="torque_offset",
    family="actuation",
    scope="joint",
    equation="applied = recorded + offset",
    parameters=(Parameter("torque", "o", "N m", (-200.0, 200.0), (0.1, 3.5)),),
    looks_like="a constant torque",
    reference="gautier1992",
    confused_with=(
        ("encoder_offset", "static poses over the whole range of the joint"),
        ("coulomb_friction", "slow motion in both directions"),
    ),
    inverse=offset_inverse,
    applied=offset,
    place=4,
)

RIPPLE = Path(
    name="torque_ripple",
    family="actuation",
    scope="joint",
    equation="applied = recorded + A sin(n q + phi)",
    parameters=(
        Parameter("amplitude", "A", "N m", (-100.0, 100.0), (0.05, 5.0)),
        Parameter("cycles", "n", "1", (0.0, 2000.0), (2.0, 200.0)),
        Parameter("phase", "phi", "rad", (-6.3, 6.3), (0.0, 6.283)),
    ),
    looks_like="a line in the gap when it is put in order of position",
    reference="tuttle1996",
    confused_with=(
        ("torque_offset", "a slow sweep over the whole range of the joint"),
    ),
    inverse=ripple_inverse,
    applied=ripple,
    place=5,
)
