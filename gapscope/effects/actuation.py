"""The actuation family: effects between the recorded torque and the joint.

Convention: applied = (1 + s) u + offset + ripple, where u is the recorded torque clipped at the limit, delayed, and
lagged; and applied is what the rigid body with its friction needs.
"""

from __future__ import annotations

import numpy as np

from gapscope.effects.arm_scale import ArmScale
from gapscope.effects.effect import Path, Series
from gapscope.effects.parameter import Parameter
from gapscope.effects.parametrisation import (
    JointSeries,
    Parametrisation,
    Values,
    linear_in,
)
from gapscope.effects.signals import Drawn, drawn


def saturate(
    torque: np.ndarray,
    series: Series,
    limit: np.ndarray,
    corner_speed: np.ndarray | float = 0.0,
    no_load_speed: np.ndarray | float = 0.0,
) -> np.ndarray:
    """clip(tau, -L, L) [N m], of a torque along the velocity L (w0 - |v|) / (w0 - wc) at most; a limit of 0 means none.

    The voltage that is left beside the back-EMF drives the current: above the corner speed wc torque falls in a line to
    none at the no-load speed w0 [rad/s]; w0 of 0 means that the limit is the same at all speeds. Torque that brakes is
    limited by the current alone.

    It is its own inverse as far as there is one: what was recorded beyond the limit is lost, and a needed torque beyond
    it cannot have been applied.
    """
    bound = np.where(limit > 0, limit, np.inf)
    falls = np.asarray(no_load_speed) > 0
    if not falls.any():
        return np.minimum(np.maximum(torque, -bound), bound)
    slope = limit / np.maximum(no_load_speed - corner_speed, MIN_FALL)
    # a line that is far above all torque where there is none
    slope, beyond = np.where(falls, slope, 0.0), np.where(falls, 0.0, np.inf)
    # ahead bounds positive torque by v, back negative torque by -v
    ahead, back = (
        np.minimum(bound, np.maximum(slope * (no_load_speed - v), 0.0) + beyond)
        for v in (series.velocity, -series.velocity)
    )
    return np.minimum(np.maximum(torque, -back), ahead)


def faded(
    series: Series,
    torque: np.ndarray,
    fading: np.ndarray | float,
    rated: np.ndarray | float,
    warming_time: np.ndarray | float,
) -> np.ndarray | float:
    """1 - a Q, the share of the torque constant that is left [1], with T dQ/dt + Q = (u / u_r)^2, Q = 0 at the start.

    Copper losses warm windings and magnets, whose remanence falls with temperature; a [1] is lost where the rated
    torque u_r [N m] is held for much longer than T [s].
    """
    if not np.any(fading):
        return 1.0
    over = torque / np.where(np.asarray(rated) > 0, rated, 1.0)
    return 1.0 - fading * series.warmed(over * over, np.asarray(warming_time))


def scaled(
    recorded: np.ndarray, series: Series, scale: np.ndarray, *heat: np.ndarray
) -> np.ndarray:
    """(1 + s) (1 - a Q) u [N m]."""
    return recorded * (1.0 + scale) * faded(series, recorded, *(heat or NO_HEAT))


def scaled_inverse(
    needed: np.ndarray, series: Series, scale: np.ndarray, *heat: np.ndarray
) -> np.ndarray:
    """The torque u of which that is left, by steps u = needed / (1 + s) / (1 - a Q(u)): what heat takes comes later."""
    # without heat: the first guess, and the answer of a motor that stays cold
    cold = needed / (1.0 + scale)
    recorded = cold
    for _ in range(HEAT_STEPS if np.any((heat or NO_HEAT)[0]) else 0):
        before = recorded
        # a motor that would lose all is kept from a division by nothing
        recorded = cold / np.maximum(faded(series, before, *heat), MIN_LEFT)
        if np.allclose(recorded, before, rtol=1e-6):
            break
    return recorded


def lag_inverse(
    needed: np.ndarray, series: Series, time_constant: np.ndarray
) -> np.ndarray:
    """Recorded = needed + T d needed / dt [N m]; T in s."""
    if not np.any(time_constant):
        return needed
    return needed + time_constant * series.rate(needed)


def ripple_torque(
    position: np.ndarray, amplitude: np.ndarray, cycles: np.ndarray, phase: np.ndarray
) -> np.ndarray:
    """A sin(n q + phi) [N m]; A in N m, n periods per revolution, phi and q in rad."""
    return amplitude * np.sin(cycles * position + phase)


def ripple_values(x: np.ndarray, nonlinear: np.ndarray) -> Values:
    """A sin(n q + phi) = x0 sin n q + x1 cos n q."""
    return {
        "amplitude": np.hypot(x[0], x[1]),
        "cycles": nonlinear[0],
        "phase": np.arctan2(x[1], x[0]),
    }


def torque_limits(series: JointSeries, known: float | None) -> np.ndarray:
    """Limits to try [N m], (K,): from the least up to the largest torque in even steps and ratios; none without any."""
    recorded = np.abs(np.concatenate(series.recorded))
    largest = float(recorded.max())
    if largest == 0:
        return np.zeros(0)
    seldom = float(np.quantile(recorded, 1.0 - LIMITED_TIME_HELD))
    # one that torque exceeds for longer than this is no limit
    least = max(MIN_LIMIT * largest, seldom)
    if known is not None:
        # a known limit is refined, by a tenth to both sides
        return np.clip(known * np.linspace(0.9, 1.1, 21), least, 0.999 * largest)
    # at the largest torque a limit cuts nothing off
    steps = np.linspace(least, 0.98 * largest, LIMIT_GRID)
    ratios = np.geomspace(least, 0.97 * largest, LIMIT_GRID)[1:]
    return np.sort([*steps, *ratios])


def possible_limits(
    limits: np.ndarray, recorded: np.ndarray, needed: np.ndarray
) -> np.ndarray:
    """Which limits the motion allows, (K,): what torque seldom exceeds, while about the limit is needed.

    Without the second, to call most of a torque lost would explain any gap.

    Args:
        limits: [N m], (K,).
        recorded, needed: torque of the joint [N m], (M,) each.
    """
    # needed torque in the direction of the recorded one, while that exceeds the limit: mean and mean square
    along, size = np.sign(recorded) * needed, np.abs(recorded)
    order = np.argsort(size)
    # how many samples stay within each limit: the others are cut off
    within = np.searchsorted(size[order], limits, side="right")
    count = len(size) - within
    powers = np.stack([along, along**2])[:, order]
    up_to = np.pad(np.cumsum(powers, axis=1), ((0, 0), (1, 0)))
    # all less those up to a limit: one sum for each of many limits
    sums = up_to[:, -1:] - up_to[:, within]
    mean, mean_square = sums / np.maximum(count, 1)
    # mean square of what is needed less the limit
    apart2 = mean_square - 2 * mean * limits + limits**2
    apart = np.sqrt(np.maximum(apart2, 0.0))
    seldom = count / len(size) < LIMITED_TIME_TRACKING
    held = apart < HELD_NEAR_LIMIT * limits
    return (mean > MIN_NEED_AT_LIMIT * limits) & (seldom | held)


def ripple_cycles(series: JointSeries, known: float | None) -> np.ndarray:
    """Cycles per revolution to look for, (K,), as far as slow motion keeps them within the band of a fit."""
    # of a slide, periods per 2 pi of what counts as a radian
    size = series.radian
    travel = max(float(np.ptp(q)) for q in series.position) / size
    # cycles that the recordings can separate
    step = 0.8 / max(travel, 0.3)
    if known is not None:
        near = known + step / size * np.linspace(-0.6, 0.6, 9)
        return np.maximum(near, MIN_CYCLES / size)
    speed = float(np.quantile(np.abs(np.concatenate(series.velocity)), 0.3)) / size
    # a joint that stands still shows no ripple; its columns are constant then, whatever the cycles
    least = max(MIN_CYCLES, MIN_PERIODS * 2 * np.pi / max(travel, MIN_TRAVEL))
    # 75 rad/s: ripples up to 12 Hz at the speed of slow motion
    band = max(min(MAX_CYCLES, 75.0 / max(speed, 1e-3)), 30.0)
    return np.arange(least, least + band, step) / size


def draw_ripple(rng: np.random.Generator, scale: ArmScale, j: np.ndarray) -> Values:
    """2 to 10 % of the torque of each joint, a whole number of times per revolution."""
    return {
        "amplitude": Drawn(0.02, 0.1, of="torque")(rng, scale, j),
        # poles and teeth: whole numbers
        "cycles": np.round(Drawn(2.0, 100.0, log=True)(rng, scale, j)),
        "phase": Drawn(0.0, 2 * np.pi)(rng, scale, j),
    }


MIN_DELAY = 1e-3
"""Delays and lags shorter than this count as a skew of sampling and are not named [s]. (hand)"""
MIN_LIMIT = 0.01
"""Saturation lets at least this share of the largest recorded torque through [1]. (hand)"""
MIN_NEED_AT_LIMIT = 0.7
"""While it acts this share of the limit is needed on average [1]. (hand)"""
LIMITED_TIME_TRACKING = 0.4
"""It acts for this share of the time at most [1], as a controller whose torque never arrives cannot track... (hand)"""
LIMITED_TIME_HELD = 0.85
"""...or for this one, if the arm hardly holds [1]: what is needed keeps to the limit meanwhile... (hand)"""
HELD_NEAR_LIMIT = 0.15
"""...within this share of it [1]. (hand)"""
LIMIT_GRID = 40
"""Limits that are tried in even steps up to the largest torque, and as many in even ratios. (budget)"""
MIN_CYCLES = 3.5
"""Ripples with fewer periods per revolution are not looked for: a spring that is not straight looks alike. (hand)"""
MAX_CYCLES = 200.0
"""Ripples with more periods per revolution are not looked for. (physical)"""
MIN_PERIODS = 1.5
"""Periods of a ripple that some recording must show; less is a bend that much else explains. (hand)"""
MIN_TRAVEL = 1e-6
"""Travel below which a joint stands still [rad]."""

MIN_FALL = 1e-9
"""Least span of speed over which torque falls [rad/s]: keeps a line from being upright."""
NO_HEAT = (0.0, 0.0, 0.0)
"""Heat that takes nothing off."""
HEAT_STEPS = 60
"""Steps by which the torque is found that heats as it does. (budget)"""
MIN_LEFT = 0.05
"""Share of the torque constant that heat leaves at least [1]. (physical)"""

DELAY_TIME = Parameter("delay", "T", "s", (0.0, 0.2), (0.002, 0.02))
TIME_CONSTANT = Parameter("time_constant", "T", "s", (0.0, 0.5), (0.005, 0.03))
SCALE_ERROR = Parameter("scale", "s", "1", (-0.6, 1.5), (0.1, 0.3))
OFFSET_TORQUE = Parameter("torque", "o", "N m", (-5e3, 5e3), (0.1, 3.5))


SATURATION = Path(
    name="torque_saturation",
    family="actuation",
    scope="joint",
    equation="applied = clip(recorded, -L, L), along the velocity at most L (w0 - |v|) / (w0 - wc)",
    parameters=(
        Parameter("limit", "L", "N m", (1e-3, 1e5), (5.0, 300.0), severity=-1),
        Parameter(
            "corner_speed",
            "wc",
            "rad/s",
            (0.0, 1e3),
            (0.5, 20.0),
            severity=0,
            absent=0.0,
        ),
        Parameter(
            "no_load_speed",
            "w0",
            "rad/s",
            (0.0, 1e3),
            (1.0, 40.0),
            severity=0,
            absent=0.0,
        ),
    ),
    looks_like="a gap at high torque only, with the sign of the torque",
    reference="hwangbo2019",
    confused_with=(("torque_scale", "the same motion at two amplitudes"),),
    inverse=saturate,
    applied=saturate,
    place=0,
    varies_with="nothing",
    parametrisation=Parametrisation(
        # x0 is 1 with saturation and 0 without
        lambda x, limit: {"limit": limit[0]},
        nonlinear=("limit",),
        lowest=0.6,
        grid=torque_limits,
        possible=possible_limits,
    ),
    severity=drawn(limit=Drawn(1.0, 1.6, of="torque", each=False)),
    limits=True,
    quantities={
        "limit": "limit",
        "corner_speed": "corner_speed",
        "no_load_speed": "no_load_speed",
    },
    without="above the corner speed torque along the velocity falls in a line to none at the no-load speed",
)

DELAY = Path(
    name="actuator_delay",
    family="actuation",
    scope="joint",
    equation="applied(t) = recorded(t - T)",
    parameters=(DELAY_TIME,),
    looks_like="a phase lag of the torque that grows linearly with frequency",
    reference="hwangbo2019",
    confused_with=(
        ("actuator_lag", "a chirp above 10 Hz"),
        ("armature", "a chirp above 10 Hz"),
        ("viscous_friction", "a chirp above 10 Hz"),
    ),
    inverse=lambda needed, series, delay: series.shifted(needed, delay),
    applied=lambda recorded, series, delay: series.shifted(recorded, -delay),
    place=1,
    varies_with="time",
    parametrisation=linear_in(DELAY_TIME, step=1e-4, lowest=MIN_DELAY),
    severity=drawn(delay=Drawn(0.002, 0.02, log=True)),
    inherent=True,
    delays=True,
    plotted_against="torque rate",
    quantities={"delay": "delay"},
    without="hold the command back by it",
)

LAG = Path(
    name="actuator_lag",
    family="actuation",
    scope="joint",
    equation="T d applied / dt + applied = recorded",
    parameters=(TIME_CONSTANT,),
    looks_like="a torque that rolls off with frequency",
    reference="hwangbo2019",
    confused_with=(
        ("actuator_delay", "a chirp above 10 Hz"),
        ("armature", "a chirp above 10 Hz"),
    ),
    inverse=lag_inverse,
    applied=lambda recorded, series, time: series.lagged(recorded, time),
    place=2,
    varies_with="time",
    parametrisation=linear_in(TIME_CONSTANT, step=1e-4, lowest=MIN_DELAY),
    severity=drawn(time_constant=Drawn(0.005, 0.03, log=True)),
    inherent=True,
    delays=True,
    near_equivalent="actuator_delay",
    quantities={"time_constant": "lag"},
)

SCALE = Path(
    name="torque_scale",
    family="actuation",
    scope="joint",
    equation="applied = (1 + s) (1 - a Q) recorded, T dQ/dt + Q = (recorded / u_r)^2",
    parameters=(
        SCALE_ERROR,
        Parameter("fading", "a", "1", (0.0, 0.9), (0.02, 0.3), absent=0.0),
        Parameter(
            "rated", "u_r", "N m", (0.0, 1e5), (5.0, 300.0), severity=0, absent=0.0
        ),
        Parameter(
            "warming_time", "T", "s", (0.0, 1e5), (20.0, 2e3), severity=0, absent=0.0
        ),
    ),
    looks_like="a gap proportional to the whole torque of the joint",
    reference="gautier2014",
    confused_with=(
        ("payload", "the same motion with a known payload"),
        ("load_friction", "slow motion in both directions under load"),
        ("torque_saturation", "the same motion at two amplitudes"),
    ),
    inverse=scaled_inverse,
    applied=scaled,
    place=3,
    varies_with="nothing",
    parametrisation=linear_in(SCALE_ERROR, step=1e-3),
    severity=drawn(scale=Drawn(0.1, 0.3, signed=True)),
    plotted_against="recorded torque",
    quantities={
        "scale": "scale",
        "fading": "fading",
        "rated": "rated",
        "warming_time": "warming_time",
    },
    without="torque falls as the motor warms up",
)

OFFSET = Path(
    name="torque_offset",
    family="actuation",
    scope="joint",
    equation="applied = recorded + offset",
    parameters=(OFFSET_TORQUE,),
    looks_like="a constant torque",
    reference="gautier1992",
    confused_with=(
        ("encoder_offset", "static poses over the whole range of the joint"),
        ("coulomb_friction", "slow motion in both directions"),
    ),
    inverse=lambda needed, series, offset: needed - offset,
    applied=lambda recorded, series, offset: recorded + offset,
    place=4,
    additive=True,
    varies_with="nothing",
    parametrisation=linear_in(OFFSET_TORQUE),
    severity=drawn(torque=Drawn(0.05, 0.3, of="torque", each=False, signed=True)),
    plotted_against="time",
    quantities={"torque": "offset"},
)

RIPPLE = Path(
    name="torque_ripple",
    family="actuation",
    scope="joint",
    equation="applied = recorded + A sin(n q + phi)",
    parameters=(
        Parameter("amplitude", "A", "N m", (-2e3, 2e3), (0.05, 5.0)),
        Parameter("cycles", "n", "1", (0.0, 2000.0), (2.0, 200.0), severity=0),
        Parameter("phase", "phi", "rad", (-6.3, 6.3), (0.0, 6.283), severity=0),
    ),
    looks_like="a line in the gap when it is put in order of position",
    reference="tuttle1996",
    confused_with=(
        ("torque_offset", "a slow sweep over the whole range of the joint"),
    ),
    inverse=lambda needed, series, *values: (
        needed - ripple_torque(series.position, *values)
    ),
    applied=lambda recorded, series, *values: (
        recorded + ripple_torque(series.position, *values)
    ),
    place=5,
    additive=True,
    parametrisation=Parametrisation(
        ripple_values, linear=2, nonlinear=("cycles",), grid=ripple_cycles
    ),
    severity=draw_ripple,
    inherent=True,
    simplified=True,
    quantities={
        "amplitude": "ripple",
        "cycles": "ripple_cycles",
        "phase": "ripple_phase",
    },
)
