"""The friction family: torque laws that oppose the motion of one joint, and their drift.

Dry friction builds up over a small distance after each reversal (presliding), as bristles that bend. Dahl's state
s = z / z_s, the bend of the bristles over the distance z_s at which they slip, follows the joint by

    ds/dt = dq/dt / z_s (1 - s sgn(dq/dt))

and takes the place of sgn(dq/dt) in the laws of dry friction (dahl1976). At rest it keeps its value, where the sign of
the velocity says nothing.
"""

from __future__ import annotations

import numpy as np

from gapscope.arm.nominal import smooth_sign
from gapscope.effects.effect import Drift, DryLaw, Signals, TorqueLaw
from gapscope.effects.parameter import Parameter
from gapscope.effects.parametrisation import (
    Grid,
    amplitude_and_searched,
    linear_in,
)
from gapscope.effects.signals import Drawn, drawn


def friction_direction(
    position: np.ndarray, velocity: np.ndarray, distance: np.ndarray
) -> np.ndarray:
    """What stands for sgn v in dry friction [1], between -1 and 1, shape (N, n).

    Args:
        position: q [rad], a series in time, shape (N, n).
        velocity: dq [rad/s], (N, n).
        distance: z_s [rad], (n,); where it is 0 friction follows the smoothed sign of the velocity at once, which is
            also where the state begins elsewhere.
    """
    direction = smooth_sign(velocity)
    bends = np.flatnonzero(distance)
    if bends.size:
        # a step dq without reversal takes s to sgn dq + (s - sgn dq) exp(-|dq| / z_s), exactly: an affine map, so that
        # the state is the running composition of maps, which takes log2 N passes over the series instead of N steps
        step = np.diff(position[:, bends], axis=0, prepend=position[:1, bends])
        # what is left of the bend before: none after a way of several distances
        factor = np.exp(-np.abs(step) / distance[bends])
        state = np.sign(step) * (1.0 - factor)
        # before the first sample nothing is known but the velocity
        state[0] = direction[0, bends]
        reach = 1
        while reach < len(position):
            # the map of the last `reach` steps after that of the `reach` steps before them
            state[reach:] += factor[reach:] * state[:-reach].copy()
            factor[reach:] *= factor[:-reach].copy()
            reach *= 2
        direction[:, bends] = state
    return direction


def stribeck_amplitude(
    velocity: np.ndarray, load: np.ndarray, torque: np.ndarray, speed: np.ndarray
) -> np.ndarray:
    """d exp(-(v / vs)^2) [N m]; d in N m, v and vs in rad/s. If vs is 0 the effect is off."""
    relative = velocity / np.where(speed > 0, speed, 1.0)
    return torque * np.exp(-relative * relative)


def saturating_amplitude(
    velocity: np.ndarray, load: np.ndarray, torque: np.ndarray, speed: np.ndarray
) -> np.ndarray:
    r"""d tanh(\|v\| / vs) [N m]; d in N m, v and vs in rad/s. If vs is 0 the effect is off.

    Concave in the speed: b v with b = d / vs at low speed, d from about 2 vs on; none at rest. It is the symmetric part
    of the sigmoid phi1 / (1 + exp(-phi2 (v + phi3))) of gaz2019, with d = phi1 / 2 and vs = 2 / phi2.
    """
    present = speed > 0
    relative = np.abs(velocity) / np.where(present, speed, 1.0)
    return np.where(present, torque, 0.0) * np.tanh(relative)


def load_dependent(signals: Signals, coefficient: np.ndarray) -> np.ndarray:
    r"""mu \|tau_load\| sgn v [N m], with tau_load the motor torque that itself overcomes this friction.

    With ``load`` the torque before load friction, tau = load + mu \|tau\| sgn v has the closed solution
    tau = load / (1 - mu sgn(v) sgn(load)), so that the law is tau - load. Needs \|mu\| < 1.
    """
    directed = coefficient * signals.direction * np.sign(signals.load)
    return signals.load * directed / (1.0 - directed)


def drift_change(
    t: np.ndarray | float, amplitude: np.ndarray, time_constant: np.ndarray
) -> np.ndarray:
    """A exp(-t / T) [1], a share of the friction; t and T in s. If T is 0 the effect is off."""
    present = time_constant > 0
    decay = np.exp(-t / np.where(present, time_constant, 1.0))
    return np.where(present, amplitude, 0.0) * decay


SATURATION_SPEEDS = Grid(0.1, 0.7, (0.1, 0.7), unit="largest speed", points=10)
"""Speeds over which friction may saturate."""
STRIBECK_SPEEDS = Grid(0.01, 3.0, (5e-3, 10.0))
"""Speeds over which friction may fall from breakaway."""
PRESLIDING_DISTANCES = tuple(np.geomspace(1e-5, 1e-3, 7).tolist())
"""Distances over which dry friction may build up after a reversal: teeth and grease bend [rad]. (physical)"""
COULOMB_TORQUE = Parameter(
    "torque", "c", "N m", (-5e3, 5e3), (0.1, 14.0), increment=True
)
VISCOUS_COEFFICIENT = Parameter(
    "coefficient", "b", "N m s/rad", (-2e4, 2e4), (0.03, 15.0), increment=True
)
LOAD_COEFFICIENT = Parameter("coefficient", "mu", "1", (0.0, 0.8), (0.03, 0.31))


COULOMB = DryLaw(
    name="coulomb_friction",
    family="friction",
    scope="joint",
    equation="c sgn v",
    parameters=(COULOMB_TORQUE,),
    looks_like="an odd step of the torque at v = 0",
    reference="gaz2019",
    confused_with=(
        ("load_friction", "the same motion with two payloads"),
        ("viscous_friction", "the same path at a tenth of the speed"),
    ),
    law=lambda signals, torque: torque * signals.direction,
    # of the shape of the velocity, as amplitudes of other laws are
    amplitude=lambda velocity, load, torque: torque + 0.0 * velocity,
    parametrisation=linear_in(COULOMB_TORQUE, data_sheet="coulomb"),
    severity=drawn(torque=Drawn(0.05, 0.3, of="torque", each=False)),
    plotted_against="velocity",
    quantities={"torque": "friction"},
    varies_with="nothing",
)

VISCOUS = TorqueLaw(
    name="viscous_friction",
    family="friction",
    scope="joint",
    equation="b v",
    parameters=(VISCOUS_COEFFICIENT,),
    looks_like="a torque linear and odd in velocity",
    reference="swevers2007",
    confused_with=(
        ("coulomb_friction", "the same path at a tenth of the speed"),
        ("armature", "slow and fast runs of the same path"),
    ),
    law=lambda signals, coefficient: coefficient * signals.velocity,
    parametrisation=linear_in(VISCOUS_COEFFICIENT, data_sheet="viscous"),
    # at the usual speed 5 to 30 % of the torque of the joint
    severity=lambda rng, scale, j: {
        "coefficient": scale.torque[j] / scale.speed[j] * rng.uniform(0.05, 0.3)
    },
    simplified=True,
    plotted_against="velocity",
    quantities={"coefficient": "damping"},
)

STRIBECK = DryLaw(
    name="stribeck_friction",
    family="friction",
    scope="joint",
    equation="d exp(-(v / vs)^2) sgn v",
    parameters=(
        Parameter("torque", "d", "N m", (0.0, 5e3), (0.1, 5.0), increment=True),
        Parameter("velocity", "vs", "rad/s", (1e-4, 20.0), (0.02, 2.9), severity=0),
    ),
    looks_like="friction that falls as the joint begins to move",
    reference="armstrong1994",
    # of joints that stay slower than vs
    near_equivalent="coulomb_friction",
    confused_with=(
        ("backlash", "slow ramps in both directions"),
        ("coulomb_friction", "the same path at a tenth of the speed"),
    ),
    law=lambda signals, *values: (
        stribeck_amplitude(signals.velocity, signals.load, *values) * signals.direction
    ),
    amplitude=stribeck_amplitude,
    parametrisation=amplitude_and_searched(
        "torque", "velocity", STRIBECK_SPEEDS, lowest=0.0
    ),
    severity=drawn(
        torque=Drawn(0.05, 0.2, of="torque", each=False),
        velocity=Drawn(0.02, 2.9, log=True),
    ),
    inherent=True,
    simplified=True,
    quantities={"torque": "breakaway", "velocity": "breakaway_speed"},
    without="friction of the file at rest is lower by it",
)

SATURATING = DryLaw(
    name="saturating_friction",
    family="friction",
    scope="joint",
    equation="d tanh(|v| / vs) sgn v",
    parameters=(
        Parameter("torque", "d", "N m", (0.0, 5e3), (0.2, 20.0), increment=True),
        Parameter("velocity", "vs", "rad/s", (1e-3, 20.0), (0.05, 2.0), severity=0),
    ),
    looks_like="friction that grows with speed, less and less",
    reference="gaz2019",
    # of joints that stay faster than vs
    near_equivalent="coulomb_friction",
    confused_with=(
        ("viscous_friction", "the same path at half and at full speed"),
        ("coulomb_friction", "the same path at a tenth of the speed"),
        ("stribeck_friction", "the same path at a tenth of the speed"),
    ),
    law=lambda signals, *values: (
        saturating_amplitude(signals.velocity, signals.load, *values)
        * signals.direction
    ),
    amplitude=saturating_amplitude,
    parametrisation=amplitude_and_searched(
        "torque",
        "velocity",
        # below a tenth of the largest speed it cannot be told from Coulomb friction, far above from viscous friction
        SATURATION_SPEEDS,
        lowest=0.0,
    ),
    severity=drawn(
        torque=Drawn(0.05, 0.3, of="torque", each=False),
        velocity=Drawn(0.05, 0.25, of="speed"),
    ),
    inherent=True,
    simplified=True,
    plotted_against="velocity",
    quantities={"torque": "saturating", "velocity": "saturating_speed"},
    without="friction of the file in motion is lower by it",
)

LOAD = DryLaw(
    name="load_friction",
    family="friction",
    scope="joint",
    equation="mu |tau_load| sgn v",
    parameters=(LOAD_COEFFICIENT,),
    looks_like="a friction loop whose width grows with the load",
    reference="hamon2010",
    confused_with=(
        ("coulomb_friction", "the same motion with two payloads"),
        ("torque_scale", "static poses under load, then slow reversals"),
    ),
    law=load_dependent,
    amplitude=lambda velocity, load, coefficient: coefficient * np.abs(load),
    parametrisation=linear_in(LOAD_COEFFICIENT, step=1e-3, lowest=0.0),
    inherent=True,
    plotted_against="directed load",
    quantities={"coefficient": "load_factor"},
    varies_with="load",
)

DRIFT = Drift(
    name="friction_drift",
    family="friction",
    scope="joint",
    equation="friction (1 + a exp(-t / T))",
    parameters=(
        Parameter("amplitude", "a", "1", (-0.95, 5.0), (0.2, 1.0)),
        Parameter("time_constant", "T", "s", (0.1, 1e5), (5.0, 1800.0), severity=0),
    ),
    looks_like="friction that fades while the joint warms up",
    reference="bittencourt2012",
    confused_with=(
        ("coulomb_friction", "the same motion cold and warm"),
        ("payload", "the same motion cold and warm"),
    ),
    change=drift_change,
    parametrisation=amplitude_and_searched(
        "amplitude",
        "time_constant",
        # no joint warms up within a second; what hardly changes while it is recorded is another friction, and no drift
        Grid(0.05, 3.0, (0.001, 1e3), unit="duration", least=1.0),
        step=1e-3,
        lowest=-0.95,
    ),
    # within minutes, so that a recording shows it
    severity=drawn(
        amplitude=Drawn(0.2, 1.0), time_constant=Drawn(5.0, 300.0, log=True)
    ),
    inherent=True,
    simplified=True,
    quantities={"amplitude": "drift", "time_constant": "drift_time"},
    without="friction of the file is that without drift; at the start of a recording it is 1 + amplitude times as "
    "large",
)
