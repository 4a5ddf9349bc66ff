"""Control laws: PD, PID, cascade, computed torque; the loop that runs them, and how a recording begins."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import CubicHermiteSpline, make_interp_spline

from gapscope.arm.controller import Controller, Gain, Integrator
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.nearest_name import check_known
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording

# The feedforward torque that a controller adds to its PD law.


FEEDFORWARDS = ("none", "gravity", "nominal")
"""What ``Controller.feedforward`` may be."""


def feedforward(
    arm: NominalArm,
    body: RigidBody,
    kind: str,
    q: np.ndarray,
    dq: np.ndarray,
    ddq: np.ndarray,
) -> np.ndarray:
    """Feedforward torque of a reference motion [N m], shape (N, n).

    ``none``: 0. ``gravity``: g(q). ``nominal``: M(q) ddq + C(q, dq) dq + g(q) + I ddq + c tanh(dq / v0) + b dq, the
    nominal arm's inverse dynamics with the data sheet's armature I, Coulomb c and viscous b friction; v0 is
    ``gapscope.arm.nominal.FRICTION_SMOOTHING``.

    Args:
        arm: the nominal arm.
        body: its rigid-body model.
        kind: one of ``FEEDFORWARDS``.
        q, dq, ddq: reference position [rad], velocity [rad/s], acceleration [rad/s^2], each (N, n).

    Raises:
        InputError: unknown kind.
    """
    check_known("feedforward", kind, FEEDFORWARDS, where="controller.feedforward")
    if kind == "none":
        return np.zeros_like(q)
    if kind == "gravity":
        return body.gravity_torque(q)
    torque = body.inverse_dynamics(q, dq, ddq) + arm.armature * ddq
    return torque + arm.friction(dq)


# PD control of the position, beside a feedforward.


@dataclass(frozen=True, kw_only=True)
class _KpKd(Controller):
    """A law whose feedback is kp (q_ref - q) + kd (dq_ref - dq): torque, or acceleration if it goes through the model.

    Attributes:
        kp, kd: gains, shape (n,).
    """

    kp: np.ndarray
    kd: np.ndarray

    def proportional(self, error: np.ndarray, rate: np.ndarray) -> np.ndarray:
        """kp e + kd de [N m or rad/s^2]."""
        return self.kp * error + self.kd * rate

    @property
    def velocity_gain(self) -> np.ndarray | None:
        """kd [N m s/rad], (n,), of a torque."""
        return None if self.through_model else self.kd


@dataclass(frozen=True, kw_only=True)
class PD(_KpKd):
    """tau = feedforward + kp (q_ref - q) + kd (dq_ref - dq).

    Attributes:
        kp, kd: gains [N m/rad], [N m s/rad], shape (n,).
    """

    kind = "pd"
    gains = (
        Gain("kp", "N m/rad", "torque over the position's error", 2),
        Gain("kd", "N m s/rad", "torque over the velocity's error", 1),
    )


# PID control of the position, beside a feedforward.


@dataclass(frozen=True, kw_only=True)
class _Integrating(Controller):
    """A law with an integrator.

    Attributes:
        ki: its gain, shape (n,).
    """

    integrates = True
    ki: np.ndarray
    integrator: Integrator = field(default_factory=Integrator)


@dataclass(frozen=True, kw_only=True)
class PID(_Integrating, _KpKd):
    """tau = feedforward + kp e + z + kd de, dz/dt = ki e, with e = q_ref - q.

    Attributes:
        kp, ki, kd: gains [N m/rad], [N m/(rad s)], [N m s/rad], shape (n,).
        integrator: bounds of z.
    """

    kind = "pid"
    gains = (
        PD.gains[0],
        Gain("ki", "N m/(rad s)", "torque over the integral of that error", 3),
        PD.gains[1],
    )

    def integration(self, error: np.ndarray, rate: np.ndarray) -> np.ndarray:
        """ki e [N m/s]."""
        return self.ki * error


# A cascade: the position's error sets a velocity, whose PI controller gives the torque.


@dataclass(frozen=True, kw_only=True)
class Cascade(_Integrating):
    """tau = feedforward + kv (w - dq) + z, dz/dt = ki (w - dq), w = kp (q_ref - q) + dq_ref.

    Without ki it is PD with the gains kv kp and kv.

    Attributes:
        kp: of the outer loop [1/s], shape (n,).
        kv, ki: of the inner loop [N m s/rad], [N m/rad], shape (n,).
        integrator: bounds of z.
    """

    kind = "cascade"
    gains = (
        Gain("kp", "1/s", "velocity set over the position's error", 1),
        Gain("kv", "N m s/rad", "torque over the velocity's error", 1),
        Gain("ki", "N m/rad", "torque over the integral of the velocity's error", 2),
    )
    kp: np.ndarray
    kv: np.ndarray

    def proportional(self, error: np.ndarray, rate: np.ndarray) -> np.ndarray:
        """kv (kp e + de) [N m]."""
        return self.kv * (self.kp * error + rate)

    def integration(self, error: np.ndarray, rate: np.ndarray) -> np.ndarray:
        """ki (kp e + de) [N m/s]."""
        return self.ki * (self.kp * error + rate)

    @property
    def velocity_gain(self) -> np.ndarray:
        """kv [N m s/rad], (n,)."""
        return self.kv


# Computed torque: the feedback is an acceleration, which the nominal arm's inverse dynamics turns into torque.


@dataclass(frozen=True, kw_only=True)
class ComputedTorque(_KpKd):
    """tau = (M(q) + I) a + C(q, dq) dq + g(q) + f(dq_ref), a = ddq_ref + kp (q_ref - q) + kd (dq_ref - dq).

    All of the nominal arm, rotors I and friction f of the data sheet included. Friction is taken at the reference's
    velocity, as in the feedforward: at the measured one dry friction would chatter. Source: siciliano2009.

    Attributes:
        kp, kd: gains [1/s^2], [1/s], shape (n,).
    """

    kind = "computed_torque"
    gains = (
        Gain("kp", "1/s^2", "acceleration over the position's error", 2),
        Gain("kd", "1/s", "acceleration over the velocity's error", 1),
    )
    through_model = True


# The control laws by name: what ``controller.kind`` of a case may be.


LAWS: dict[str, type[Controller]] = {
    law.kind: law for law in (PD, PID, Cascade, ComputedTorque)
}
"""The control laws by name, the first by default."""

INTEGRATOR_SHARE = 0.1
"""Corner of an integrator over the bandwidth of the loop [1]: slow enough to cost little of the phase margin."""


def like_pd(pd: PD, kind: str, damping: float) -> Controller:
    """A controller of another law with about the bandwidth and damping of a PD controller.

    With w = 2 damping kp / kd: ``pid`` adds ki = 0.1 w kp; ``cascade`` has the gains kp / kd and kd, and ki = 0.1 w kd;
    ``computed_torque`` has w^2 and 2 damping w, and no feedforward beside it.

    Args:
        pd: the PD controller.
        kind: a key of ``LAWS``.
        damping: of the loop [1].

    Raises:
        InputError: there is no such law.
    """
    check_known("control law", kind, LAWS, where="controller.kind")
    common: dict[str, Any] = {
        name: getattr(pd, name)
        for name in ("rate", "feedforward", "velocity_cutoff", "velocity_damping")
    }
    # kp / kd is w / (2 zeta) in a PD loop
    w = 2 * damping * pd.kp / pd.kd
    slow = INTEGRATOR_SHARE * w
    if kind == PID.kind:
        return PID(kp=pd.kp, ki=slow * pd.kp, kd=pd.kd, **common)
    if kind == Cascade.kind:
        return Cascade(kp=pd.kp / pd.kd, kv=pd.kd, ki=slow * pd.kd, **common)
    if kind == ComputedTorque.kind:
        # its law holds the whole torque of the nominal arm
        common["feedforward"] = "none"
        return ComputedTorque(kp=w**2, kd=2 * damping * w, **common)
    return pd


# A controller at work: from reference, position and velocity to torque, tick by tick.


SETTLE = 0.5
"""Time for which a reference that starts at rest is held before a recording [s], and from whose recorded torque the
start of an integrator is taken."""


class Targets(NamedTuple):
    """What a controller is to follow, at one tick (n,) or at K of them (K, n).

    Attributes:
        q, dq, ddq: reference [rad], [rad/s], [rad/s^2].
        torque: feedforward [N m].
    """

    q: np.ndarray
    dq: np.ndarray
    ddq: np.ndarray
    torque: np.ndarray

    @classmethod
    def of(
        cls,
        arm: NominalArm,
        controller: Controller,
        q: np.ndarray,
        dq: np.ndarray,
        ddq: np.ndarray,
    ) -> Targets:
        """A reference of K ticks with the feedforward that the controller takes of it."""
        torque = feedforward(arm, RigidBody(arm), controller.feedforward, q, dq, ddq)
        return cls(q, dq, ddq, torque)

    @classmethod
    def recorded(
        cls,
        arm: NominalArm,
        controller: Controller,
        recording: Recording,
        times: np.ndarray,
    ) -> Targets:
        """What the controller of a recording without gaps followed at K times [s], held before it and after it.

        Args:
            arm: the nominal arm, which the feedforward believes.
            controller: the controller.
            recording: with ``q_ref``; ``dq_ref`` is the slope of its spline where it is not recorded.
            times: on the recording's clock, (K,).
        """
        t, q_ref, dq_ref = recording.t, recording.q_ref, recording.dq_ref
        assert q_ref is not None
        if dq_ref is None:
            dq_ref = make_interp_spline(t, q_ref, k=3)(t, 1)
        velocity = make_interp_spline(t, dq_ref, k=3)
        held = np.clip(times, t[0], t[-1])
        # position and velocity agree: the cubic through both
        q = CubicHermiteSpline(t, q_ref, dq_ref)(held)
        return cls.of(arm, controller, q, velocity(held), velocity(held, 1))

    def at(self, tick: int | slice | np.ndarray) -> Targets:
        """The commands of one tick, or of some of them."""
        return Targets(*(series[tick] for series in self))


class ControlLoop:
    """A controller of an arm with n joints, which is called once in each of its periods.

    Args:
        controller: the law and its gains.
        arm: the nominal arm, which feedforward and computed torque believe; its torque limit clips.

    Attributes:
        integral: torque of the integrator [N m], shape (n,); 0 at first.
    """

    def __init__(self, controller: Controller, arm: NominalArm) -> None:
        self.controller, self._arm = controller, arm
        self._body = RigidBody(arm)
        self._period = 1.0 / controller.rate
        self._limit = np.inf if arm.torque_limit is None else arm.torque_limit
        self.integral = np.zeros(arm.n_joints)

    def __call__(self, commands: Targets, q: np.ndarray, dq: np.ndarray) -> np.ndarray:
        """Torque of this tick within the limit [N m].

        Args:
            commands: of this tick; of a law without an integrator also of K ticks at once.
            q, dq: position of the encoders [rad], the controller's velocity [rad/s], of the shape of the reference.
        """
        error, rate = commands.q - q, commands.dq - dq
        feedback = self.controller.proportional(error, rate)
        wanted = commands.torque + feedback + self.integral
        if self.controller.through_model:
            # one state or a series: the single one without building arrays
            inverse = self._body.torque if q.ndim == 1 else self._body.inverse_dynamics
            ddq = commands.ddq + feedback
            wanted = inverse(q, dq, ddq) + self._arm.armature * ddq
            # friction at the reference's velocity: at the measured one it would chatter
            wanted = wanted + self._arm.friction(commands.dq)
        applied = np.minimum(np.maximum(wanted, -self._limit), self._limit)
        # after the torque: forward Euler, with the integrator from before this tick
        if self.controller.integrator is not None:
            slope = self.controller.integration(error, rate)
            self.integral = self.controller.integrator.after(
                self.integral, slope, wanted, applied, self._period
            )
        return applied

    def start_with(
        self, torque: np.ndarray, commands: Targets, q: np.ndarray, dq: np.ndarray
    ) -> None:
        """Set an integrator so that this tick commands a torque [N m], shape (n,), as far as its limit allows."""
        integrator = self.controller.integrator
        if integrator is None:
            return
        feedback = self.controller.proportional(commands.q - q, commands.dq - dq)
        self.integral = integrator.bounded(torque - commands.torque - feedback)


# What the integrator of a controller held when a recording with its torque began.


def integral_at_start(
    recording: Recording, controller: Controller, targets: Targets
) -> np.ndarray:
    """Torque of the integrator at the first row [N m], (n,).

    The mean over the first ``SETTLE`` of what the law leaves of the recorded torque, less what the integrator has
    gained by then: the noise of one row would push light joints away.

    Args:
        recording: without gaps, with its torque.
        controller: a law with an integrator.
        targets: at its ticks from the first row on.
    """
    t = recording.t - recording.t[0]
    part = recording.part(t <= SETTLE)
    assert part.tau is not None
    # the command at each row is that of the last tick before it
    target = targets.at((t[t <= SETTLE] * controller.rate + 1e-6).astype(int))
    dq = np.gradient(part.q, part.t, axis=0) if part.dq is None else part.dq
    error, rate = target.q - part.q, target.dq - dq
    slope = controller.integration(error, rate)
    # what the integrator has gained since the first row
    gained = cumulative_trapezoid(slope, part.t, axis=0, initial=0)
    left = part.tau - target.torque - controller.proportional(error, rate) - gained
    mean: np.ndarray = left.mean(axis=0)
    return mean
