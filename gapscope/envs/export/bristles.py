"""Dry friction of a joint as bristles of the LuGre model, which MuJoCo's ``dcmotor`` has.

A bristle bends by z and slips at g(v),

    dz/dt = v - sigma0 |v| z / g(v),   friction = sigma0 z + sigma1 dz/dt,   g(v) = Fc + (Fs - Fc) exp(-(v / vs)^2),

so that at a constant speed the friction is g(v) sgn v (canudas1995). With Fs = Fc and sigma1 = 0 it is Dahl's model of
``gapscope.effects.friction``, whose distance is Fc / sigma0.
"""

from __future__ import annotations

from typing import NamedTuple

from gapscope.envs.export.joint_drive import JointDrive

STIFFEST = 1.0
"""Phase that a bristle's resonance may cover in a step, w dt [rad]: MuJoCo's step of the bristle is explicit."""
LEAST_SHARE = 0.01
"""Share of the Stribeck peak that its bristle keeps in fast motion [1], since MuJoCo divides by g(v)."""
TANH_SHARES = (0.3683, 0.1010, 0.5307)
"""Shares w_i of the bristles that together are tanh(x), sum_i w_i (1 - exp(-(x / s_i)^2)); see ``TANH_SPEEDS``."""
TANH_SPEEDS = (0.4220, 0.0713, 1.1432)
"""Their s_i [1]: the minimax fit for all x, wrong by at most ``TANH_ERROR``."""
TANH_ERROR = 0.012
"""Largest error of the three bristles for tanh(x) [1]."""


class Bristle(NamedTuple):
    """sigma0 [N m/rad], sigma1 [N m s/rad], Fc and Fs [N m], vs [rad/s], in MuJoCo's order."""

    stiffness: float
    damping: float
    coulomb: float
    static: float
    velocity: float


def dry_bristle(drive: JointDrive, step: float) -> Bristle | None:
    """The bristle of dry friction; ``None`` if Coulomb friction, set-valued at rest, says it all.

    With a presliding distance it carries Coulomb and Stribeck friction, and its damper makes good the step by which
    the explicit spring is late. Otherwise it carries the Stribeck peak beside Coulomb friction, which holds the joint
    at rest: as stiff as the step allows, and without a damper, whose torque would peak where g falls.

    Args:
        drive: of the joint.
        step: of the simulator [s].
    """
    peak, speed = drive.breakaway, drive.breakaway_speed
    stiffest = drive.inertia * (STIFFEST / step) ** 2
    if builds_up(drive):
        stiffness = min(drive.friction / drive.presliding, stiffest)
        static = drive.friction + peak
        velocity = speed if peak else 1.0
        return Bristle(stiffness, stiffness * step, drive.friction, static, velocity)
    if peak:
        return Bristle(stiffest, 0.0, LEAST_SHARE * peak, peak, speed)
    return None


def builds_up(drive: JointDrive) -> bool:
    """Whether Coulomb friction builds up over a distance."""
    return drive.presliding > 0 and drive.friction > 0


def presliding_distance(bristle: Bristle) -> float:
    """Distance over which a bristle's Coulomb friction builds up [rad]."""
    return bristle.coulomb / bristle.stiffness


def saturating_bristles(drive: JointDrive, step: float) -> tuple[Bristle, ...]:
    """Saturating friction d tanh(v / vt) as bristles that carry nothing at rest, to ``TANH_ERROR`` of d.

    They need no damping, as they do not stick.

    Args:
        drive: of the joint.
        step: of the simulator [s].
    """
    if drive.saturating == 0:
        return ()
    stiffness = drive.inertia * (STIFFEST / step) ** 2
    return tuple(
        Bristle(
            stiffness,
            0.0,
            share * drive.saturating,
            0.0,
            relative * drive.saturating_speed,
        )
        for share, relative in zip(TANH_SHARES, TANH_SPEEDS, strict=True)
    )
