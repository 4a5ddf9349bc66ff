"""One step of all joints between command and rigid body: drive, friction, transmission; compiled by numba.

The laws are not those of the project's catalogue:

- dry friction is LuGre, dz = v - s0 |v| z / g(v), with g = (c + mu |load|) (1 + s exp(-(v/vs)^2)) + d exp(-(|v|/w)^p)
  [canudas1995, armstrong1994]; viscous friction is b |v|^a sgn v, friction
  that saturates d v / (|v|^p + w^p)^(1 / p);
- a cold joint, x = 1, warms by its own losses: x' = -x / T (1 + r (P / P0 - 1)), friction times
  1 + a x (0.85 + 0.15 x) [bittencourt2012];
- the motor: current clamp that falls with speed, voltage that back-EMF uses up, dead time, current loop of first or
  second order, torque constant that falls with current and heat, cogging with a second harmonic;
- the transmission: two masses, a hardening spring, a damper, free play [deluca2016];
- outside the catalogue: Bouc-Wen hysteresis [wen1976], friction over position, torque that leaks from the joint before,
  a periodic disturbance, quadratic friction in one direction.
"""

from __future__ import annotations

import numpy as np

try:
    from numba import njit
except ImportError:  # ``simulate`` raises when it is called

    def njit(**options):  # type: ignore[no-untyped-def, no-redef]
        """Leave a function as it is."""
        return lambda function: function


MAX_JOINTS = 8
"""Largest number of joints."""
HISTORY = 1024
"""Steps for which a command is kept, so that it can be delayed."""

FIELDS = (
    # controller
    "kp",
    "kd",
    "limit",
    # rotor and friction
    "armature",
    "coulomb",
    "viscous",
    "bend",  # exponent of viscous friction
    "load",
    "stribeck",
    "knee",  # Stribeck speed of a healthy joint
    "fall",  # Stribeck friction: rise at rest, its speed, its exponent
    "fall_speed",
    "fall_power",
    "level",  # friction that saturates: its level, its speed, its exponent
    "level_speed",
    "level_power",
    "bristle",  # LuGre: stiffness and damping of the bristles
    "bristle_damping",
    "drift",  # a cold joint: rise, time constant, share and reference of the losses
    "drift_time",
    "drift_share",
    "drift_power",
    # motor
    "scale",
    "iron",  # loss of the torque constant at the peak torque
    "peak",
    "fade",  # loss of the torque constant by heat: share, time, torque
    "fade_time",
    "fade_load",
    "offset",
    "ripple",
    "cycles",
    "phase",
    "harmonic",
    "clamp",
    "clamp_slope",
    "stall",  # torque that the voltage drives at rest, and the speed at which it drives none; 0: never short
    "no_load",
    "lag",
    "second",  # above 0: a current loop of second order
    "delay",
    # encoder
    "encoder",
    "eccentric",
    "step",
    # transmission
    "stiffness",  # 0: a rigid joint
    "hardening",
    "damping",
    "play",
    # parallel spring
    "spring",
    "rest",
    "cubic",
    # outside the catalogue
    "hysteresis",
    "reach",
    "uneven",
    "uneven_cycles",
    "uneven_phase",
    "leak",
    "shake",
    "shake_frequency",
    "shake_phase",
    "one_sided",
)
"""Values of a joint, all in SI units on the joint's side; ``TrueArm`` fills them."""
JOINT = np.dtype(
    [(name, "f8", (MAX_JOINTS,)) for name in FIELDS] + [("h", "f8"), ("n", "i8")]
)
"""Parameters of the joints, the step h [s] and the number of joints n."""

_STATES = (
    "z",  # deflection of the bristles [rad]
    "theta",  # position of the rotor, on the joint's side [rad]
    "dtheta",
    "first",  # outputs of the current loop [N m]
    "second",
    "cold",  # 1: cold, 0: warm
    "heat",
    "bend",  # state of the hysteresis [1]
    "drive",  # torque of the motor [N m]
)
STATE = np.dtype([(name, "f8", (MAX_JOINTS,)) for name in _STATES])
"""State of the joints."""


@njit(cache=True)
def friction_level(p, i, v, q, load):  # type: ignore[no-untyped-def]
    """Dry friction g(v) [N m] of joint i while it slides at a constant speed v [rad/s]."""
    wave = np.sin(p.uneven_cycles[i] * q + p.uneven_phase[i])
    sliding = p.coulomb[i] * (1.0 + p.uneven[i] * wave) + p.load[i] * load
    g = sliding * (1.0 + p.stribeck[i] * np.exp(-((v / p.knee[i]) ** 2)))
    if p.fall[i] != 0.0:
        g += p.fall[i] * np.exp(-((abs(v) / p.fall_speed[i]) ** p.fall_power[i]))
    return max(g, 1e-6)


@njit(cache=True)
def dry_friction(p, s, i, v, q, load):  # type: ignore[no-untyped-def]
    """LuGre friction [N m] of joint i at speed v [rad/s]; moves the bristle state z."""
    g = friction_level(p, i, v, q, load)
    before = s.z[i]
    s0 = p.bristle[i]
    speed = abs(v)
    if speed < 1e-9:
        z = before + v * p.h
    else:
        # exact solution over a step of constant speed: stable however stiff the bristles
        end = g / s0 * (1.0 if v > 0 else -1.0)
        z = end + (before - end) * np.exp(-speed * s0 / g * p.h)
    s.z[i] = z
    return s0 * z + p.bristle_damping[i] * (z - before) / p.h


@njit(cache=True)
def hysteresis(p, s, i, v):  # type: ignore[no-untyped-def]
    """Bouc-Wen torque [N m] of joint i at speed v [rad/s]; moves its state."""
    x = s.bend[i]
    same_way = 1.0 if v * x > 0 else -1.0
    x += p.h * v / p.reach[i] * (1.0 - (0.6 * same_way + 0.4) * abs(x))
    s.bend[i] = x
    return p.hysteresis[i] * x


@njit(cache=True)
def resistance(p, s, i, v, q, load):  # type: ignore[no-untyped-def]
    """All friction of joint i [N m], and the part of it that grows with speed [N m s/rad]."""
    warm = 1.0
    if p.drift[i] != 0.0:
        warm += p.drift[i] * s.cold[i] * (0.85 + 0.15 * s.cold[i])
    smooth = p.viscous[i] * warm
    out = warm * dry_friction(p, s, i, v, q, load)
    if p.drift[i] != 0.0:
        lost = abs((out + smooth * v) * v) / p.drift_power[i]
        speedup = 1.0 + p.drift_share[i] * (min(lost, 4.0) - 1.0)
        s.cold[i] -= p.h * s.cold[i] / p.drift_time[i] * speedup
    out += smooth * v * max(abs(v), 1e-3) ** (p.bend[i] - 1.0)
    if p.level[i] != 0.0:
        power = p.level_power[i]
        size = abs(v) ** power + p.level_speed[i] ** power
        out += warm * p.level[i] * v / size ** (1.0 / power)
    if v > 0:
        out += p.one_sided[i] * v * v
    if p.hysteresis[i] != 0.0:
        out += hysteresis(p, s, i, v)
    return out, smooth


@njit(cache=True)
def current_loop(p, s, i, u):  # type: ignore[no-untyped-def]
    """Torque command [N m] of motor i after its current loop; moves the loop's state."""
    if p.lag[i] <= 0.0:
        return u
    if p.second[i] > 0.0:  # two equal poles of half the time
        share = 1.0 - np.exp(-2.0 * p.h / p.lag[i])
        s.first[i] += share * (u - s.first[i])
        s.second[i] += share * (s.first[i] - s.second[i])
        return s.second[i]
    s.first[i] += (1.0 - np.exp(-p.h / p.lag[i])) * (u - s.first[i])
    return s.first[i]


@njit(cache=True)
def motor(p, s, i, u, v, q, t):  # type: ignore[no-untyped-def]
    """Torque of motor i [N m] after its electronics, u being the delayed command [N m]."""
    top = p.clamp[i] * (1.0 - p.clamp_slope[i] * abs(v))
    u = current_loop(p, s, i, min(max(u, -top), top))
    if p.no_load[i] > 0.0:
        ahead = v if u > 0 else -v
        line = p.stall[i] * max(1.0 - ahead / p.no_load[i], 1e-6)
        # the current is short before the voltage is all used up
        u /= (1.0 + (abs(u) / line) ** 16) ** (1.0 / 16.0)
    gain = 1.0 + p.scale[i]
    if p.iron[i] != 0.0:
        gain *= 1.0 - p.iron[i] * (u / p.peak[i]) ** 2
    if p.fade[i] != 0.0:
        s.heat[i] += p.h / p.fade_time[i] * ((u / p.fade_load[i]) ** 2 - s.heat[i])
        gain *= 1.0 - p.fade[i] * min(s.heat[i], 2.0)
    cog = 0.0
    if p.ripple[i] != 0.0:
        angle = p.cycles[i] * q + p.phase[i]
        cog = p.ripple[i] * (np.sin(angle) + p.harmonic[i] * np.sin(2.0 * angle + 0.7))
    hum = np.sin(2 * np.pi * p.shake_frequency[i] * t + p.shake_phase[i])
    return gain * u + p.offset[i] + cog + p.shake[i] * hum


@njit(cache=True)
def transmitted(p, s, i, q, dq):  # type: ignore[no-untyped-def]
    """Torque [N m] that the gear of compliant joint i passes on to its link."""
    twist = s.theta[i] - q[i]
    free = min(max(twist, -p.play[i]), p.play[i])
    beyond = twist - free
    torque = p.stiffness[i] * beyond * (1.0 + p.hardening[i] * beyond * beyond)
    if p.play[i] == 0.0:
        return torque + p.damping[i] * (s.dtheta[i] - dq[i])
    if beyond == 0.0:
        return torque
    held = torque + p.damping[i] * (s.dtheta[i] - dq[i])
    # teeth push but never pull
    return 0.0 if held * beyond < 0.0 else held


@njit(cache=True)
def advance(par, state, ring, command, count, q, dq, damping, force):  # type: ignore[no-untyped-def]
    """Torques on the links for the next step of the rigid bodies.

    Args:
        par, state: one record each of ``JOINT`` and ``STATE``, as arrays of length 1.
        ring: commands of the last steps [N m], (HISTORY, n).
        command: command held now [N m], (n,).
        count: number of the step.
        q, dq: of the links [rad, rad/s], (n,).
        damping, force: MuJoCo's ``dof_damping`` and ``qfrc_applied``, written to.
    """
    p, s = par[0], state[0]
    t = count * p.h
    for i in range(p.n):
        ring[count % HISTORY, i] = command[i]
        u = ring[max(count - int(p.delay[i]), 0) % HISTORY, i]
        compliant = p.stiffness[i] > 0.0
        speed = s.dtheta[i] if compliant else dq[i]
        angle = s.theta[i] if compliant else q[i]
        s.drive[i] = motor(p, s, i, u, speed, angle, t)
    for i in range(p.n):
        push = s.drive[i]
        if p.leak[i] != 0.0:
            push += p.leak[i] * s.drive[i - 1 if i > 0 else p.n - 1]
        way = q[i] - p.rest[i]
        pull = p.spring[i] * way * (1.0 + p.cubic[i] * way * way)
        if p.stiffness[i] <= 0.0:
            drag, smooth = resistance(p, s, i, dq[i], q[i], abs(push))
            # MuJoCo damps implicitly, so its damping torque is added back here
            damping[i] = smooth
            force[i] = push - drag + smooth * dq[i] - pull
            continue
        drag, smooth = resistance(p, s, i, s.dtheta[i], s.theta[i], abs(push))
        torque = transmitted(p, s, i, q, dq)
        s.dtheta[i] += p.h * (push - drag - torque) / p.armature[i]
        s.theta[i] += p.h * s.dtheta[i]
        damping[i] = 0.0
        force[i] = torque - pull
