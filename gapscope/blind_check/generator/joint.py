"""One step of all joints between command and rigid body: drive, friction, transmission; compiled by numba.

The laws are not those of the project's catalogue:

- dry friction is LuGre, dz = v - s0 |v| z / g(v), with g = (c + mu |load|) (1 + s exp(-(v/vs)^2)) + d exp(-(|v|/w)^p)
  [canudas1995, armstrong1994]; viscous friction is b |v|^a sgn v;
- a cold joint, x = 1, warms by its own losses: x' = -x / T (1 + r (P / P0 - 1)), friction times
  1 + a x (0.85 + 0.15 x) [bittencourt2012];
- the motor: current clamp that falls with speed, dead time, current loop of first or second order, torque constant
  that falls with current and heat, cogging with a second harmonic;
- the transmission: two masses, a hardening spring, a damper, free play [deluca2016];
- outside the catalogue: Bouc-Wen hysteresis [wen1976], friction over position, torque that leaks from the joint before,
  a periodic disturbance, quadratic friction in one direction.
"""

from __future__ import annotations

import numpy as np

try:
    from numba import njit

    COMPILED = True
except ImportError:  # told when a simulation starts
    COMPILED = False

    def njit(**options):  # type: ignore[no-untyped-def, no-redef]
        """Leave a function as it is."""
        return lambda function: function


MOST = 8
"""Most joints."""
RING = 1024
"""Steps that a command is kept."""

FIELDS = (
    "kp",
    "kd",
    "limit",
    "armature",
    "coulomb",
    "viscous",
    "bend",
    "load",
    "stribeck",
    "knee",
    "fall",
    "fall_speed",
    "fall_power",
    "bristle",
    "bristle_damping",
    "drift",
    "drift_time",
    "drift_share",
    "drift_power",
    "scale",
    "iron",
    "peak",
    "fade",
    "fade_time",
    "fade_load",
    "offset",
    "ripple",
    "cycles",
    "phase",
    "harmonic",
    "clamp",
    "clamp_slope",
    "lag",
    "second",
    "delay",
    "encoder",
    "eccentric",
    "step",
    "stiffness",
    "hardening",
    "damping",
    "play",
    "spring",
    "rest",
    "cubic",
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
    [(name, "f8", (MOST,)) for name in FIELDS] + [("h", "f8"), ("n", "i8")]
)
STATE = np.dtype(
    [
        (name, "f8", (MOST,))
        for name in (
            "z",
            "theta",
            "dtheta",
            "first",
            "second",
            "cold",
            "heat",
            "bend",
            "drive",
        )
    ]
)


@njit(cache=True)
def dry(p, s, i, v, q, load):  # type: ignore[no-untyped-def]
    """LuGre friction [N m] of joint i at speed v [rad/s]; moves the bristle state z."""
    g = (
        p.coulomb[i]
        * (1.0 + p.uneven[i] * np.sin(p.uneven_cycles[i] * q + p.uneven_phase[i]))
        + p.load[i] * load
    ) * (1.0 + p.stribeck[i] * np.exp(-((v / p.knee[i]) ** 2)))
    if p.fall[i] != 0.0:
        g += p.fall[i] * np.exp(-((abs(v) / p.fall_speed[i]) ** p.fall_power[i]))
    g = max(g, 1e-6)
    before, s0, speed = s.z[i], p.bristle[i], abs(v)
    if speed < 1e-9:
        z = before + v * p.h
    else:
        end = g / s0 * (1.0 if v > 0 else -1.0)
        z = end + (before - end) * np.exp(-speed * s0 / g * p.h)
    s.z[i] = z
    return s0 * z + p.bristle_damping[i] * (z - before) / p.h


@njit(cache=True)
def resistance(p, s, i, v, q, load):  # type: ignore[no-untyped-def]
    """All friction of joint i [N m], and the part of it that grows with speed [N m s/rad]."""
    warm = 1.0
    if p.drift[i] != 0.0:
        warm += p.drift[i] * s.cold[i] * (0.85 + 0.15 * s.cold[i])
    smooth = p.viscous[i] * warm
    out = warm * dry(p, s, i, v, q, load)
    if p.drift[i] != 0.0:
        lost = abs((out + smooth * v) * v) / p.drift_power[i]
        s.cold[i] -= (
            p.h
            * s.cold[i]
            / p.drift_time[i]
            * (1.0 + p.drift_share[i] * (min(lost, 4.0) - 1.0))
        )
    out += smooth * v * max(abs(v), 1e-3) ** (p.bend[i] - 1.0)
    if v > 0:
        out += p.one_sided[i] * v * v
    if p.hysteresis[i] != 0.0:
        x = s.bend[i]
        x += (
            p.h
            * v
            / p.reach[i]
            * (1.0 - (0.6 * (1.0 if v * x > 0 else -1.0) + 0.4) * abs(x))
        )
        s.bend[i] = x
        out += p.hysteresis[i] * x
    return out, smooth


@njit(cache=True)
def motor(p, s, i, u, v, q, t):  # type: ignore[no-untyped-def]
    """Torque of motor i [N m] after its electronics, u being the delayed command [N m]."""
    top = p.clamp[i] * (1.0 - p.clamp_slope[i] * abs(v))
    u = min(max(u, -top), top)
    if p.lag[i] > 0.0:
        if p.second[i] > 0.0:  # two equal poles of half the time
            a = 1.0 - np.exp(-2.0 * p.h / p.lag[i])
            s.first[i] += a * (u - s.first[i])
            s.second[i] += a * (s.first[i] - s.second[i])
            u = s.second[i]
        else:
            s.first[i] += (1.0 - np.exp(-p.h / p.lag[i])) * (u - s.first[i])
            u = s.first[i]
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
    return (
        gain * u
        + p.offset[i]
        + cog
        + p.shake[i] * np.sin(2 * np.pi * p.shake_frequency[i] * t + p.shake_phase[i])
    )


@njit(cache=True)
def advance(par, state, ring, command, count, q, dq, damping, force):  # type: ignore[no-untyped-def]
    """Torques on the links for the next step of the rigid bodies.

    Args:
        par, state: one record each of ``JOINT`` and ``STATE``, as arrays of length 1.
        ring: commands of the last steps [N m], (RING, n).
        command: command held now [N m], (n,).
        count: number of the step.
        q, dq: of the links [rad, rad/s], (n,).
        damping, force: MuJoCo's ``dof_damping`` and ``qfrc_applied``, written to.
    """
    p, s = par[0], state[0]
    t = count * p.h
    for i in range(p.n):
        ring[count % RING, i] = command[i]
        u = ring[max(count - int(p.delay[i]), 0) % RING, i]
        soft = p.stiffness[i] > 0.0
        s.drive[i] = motor(
            p, s, i, u, s.dtheta[i] if soft else dq[i], s.theta[i] if soft else q[i], t
        )
    for i in range(p.n):
        push = s.drive[i]
        if p.leak[i] != 0.0:
            push += p.leak[i] * s.drive[i - 1 if i > 0 else p.n - 1]
        way = q[i] - p.rest[i]
        pull = p.spring[i] * way * (1.0 + p.cubic[i] * way * way)
        if p.stiffness[i] <= 0.0:
            drag, smooth = resistance(p, s, i, dq[i], q[i], abs(push))
            damping[i] = smooth
            force[i] = push - drag + smooth * dq[i] - pull
            continue
        drag, smooth = resistance(p, s, i, s.dtheta[i], s.theta[i], abs(push))
        twist = s.theta[i] - q[i]
        free = min(max(twist, -p.play[i]), p.play[i])
        beyond = twist - free
        torque = p.stiffness[i] * beyond * (1.0 + p.hardening[i] * beyond * beyond)
        if p.play[i] == 0.0 or beyond != 0.0:
            held = torque + p.damping[i] * (s.dtheta[i] - dq[i])
            torque = 0.0 if p.play[i] > 0.0 and held * beyond < 0.0 else held
        s.dtheta[i] += p.h * (push - drag - torque) / p.armature[i]
        s.theta[i] += p.h * s.dtheta[i]
        damping[i] = 0.0
        force[i] = torque - pull
