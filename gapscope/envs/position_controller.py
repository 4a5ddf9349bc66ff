"""Position loops as a computer closes them, and a position controller that fits an arm.

A loop is sampled, with a filtered velocity, held and perhaps late torque; a controller has PD gains of one bandwidth
that are stable along a whole motion.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq

from gapscope.arm.control import PD
from gapscope.arm.controller import Controller
from gapscope.arm.dynamics.plain_urdf import check_inertia
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.nominal import NominalArm
from gapscope.arm.velocity_filter import FilterGains, filter_gains
from gapscope.envs.actions import DAMPING, Gains, pd_gains


class SampledLoop(NamedTuple):
    """The loop of a controller and n joints, sampled with a period of dt.

    The error is that from a posture at rest. With the feedback u[k] = P(q[k], v[k]) + z[k] of the law, times the
    nominal arm's mass matrix if it goes through the model, and the slope S(q, v) of its integrator,

        (M + dt B) dq[k+1] = M dq[k] - dt u[k - late],   q[k+1] = q[k] + dt dq[k+1],   z[k+1] = z[k] + dt S(q[k], v[k]),
        v[k] = b0 q[k] + b1 q[k-1] + b2 q[k-2] + a1 v[k-1] + a2 v[k-2].

    Attributes:
        controller: its law P and S; its rate and its velocity filter are not used.
        dt: period [s].
        estimate: gains of the velocity estimate.
        late: periods by which the torque is late, the same for all joints.
    """

    controller: Controller
    dt: float
    estimate: FilterGains
    late: int = 0

    def times(self, share: float) -> SampledLoop:
        """The same loop with a bandwidth ``share`` times as large and the same damping."""
        return self._replace(controller=self.controller.times(share))

    def stable_share(
        self,
        masses: Sequence[np.ndarray],
        viscous: np.ndarray,
        believed: Sequence[np.ndarray] | None = None,
    ) -> float:
        """Largest share of the bandwidth that is stable with every mass matrix [1]: 1 if the loop is, 0 if none is."""
        pairs = list(zip(masses, believed or masses, strict=True))

        def works(share: float) -> bool:
            loop = self.times(share)
            # gains for a stretched arm may be too large for a folded one
            return all(loop.stable(mass, viscous, nominal) for mass, nominal in pairs)

        return 1.0 if works(1.0) else largest_stable(works, 1.0)

    def stable(
        self, mass: np.ndarray, viscous: np.ndarray, believed: np.ndarray | None = None
    ) -> bool:
        """Whether all modes die away: the spectral radius is below 1."""
        return self.spectral_radius(mass, viscous, believed) < 1.0

    def spectral_radius(
        self, mass: np.ndarray, viscous: np.ndarray, believed: np.ndarray | None = None
    ) -> float:
        """Largest modulus of the loop's eigenvalues [1].

        Args:
            mass: M with rotors [kg m^2], shape (n, n).
            viscous: diagonal of B [N m s/rad], shape (n,).
            believed: what the nominal arm has for M; M itself by default.
        """
        n, law = len(mass), self.controller
        count = (6 if law.integrator is None else 7) + self.late
        # one row for each unit state; q[k], dq[k], q[k-1], q[k-2], v[k-1], v[k-2], then what was commanded, the latest
        # first, and the integrator
        states = np.eye(count * n).reshape(-1, count, n)
        q, dq, q1, q2, v1, v2, *others = states.transpose(1, 0, 2)
        b0, b1, b2, a1, a2 = self.estimate
        v = b0 * q + b1 * q1 + b2 * q2 + a1 * v1 + a2 * v2
        torque = law.proportional(q, v)
        integral = []
        if law.through_model:
            torque = torque @ (mass if believed is None else believed)
        if law.integrator is not None:
            z = others.pop()
            torque = torque + z
            integral = [z + self.dt * law.integration(q, v)]
        commanded = [torque, *others]
        # rows are states and M is symmetric: dq @ M is M dq
        pushed = dq @ mass - self.dt * commanded[-1]
        damped = mass + self.dt * np.diag(viscous)
        faster = np.linalg.solve(damped, pushed.T).T
        # in the order of the unit states: what was the latest moves one place on
        following = (q + self.dt * faster, faster, q, q1, v, v1)
        after = np.hstack([*following, *commanded[:-1], *integral])
        return float(np.abs(np.linalg.eigvals(after)).max())


SAFE = 0.7
"""Share of the largest stable bandwidth that is advised [1]: half of kp."""
SMALLEST = 1e-3
"""A share of the step or of the bandwidth below this is no remedy [1]."""


def largest_stable(works: Callable[[float], bool], fails: float) -> float:
    """The largest number that works, below one that fails, by bisection; 0 if ``SMALLEST`` of that fails too."""
    low, high = SMALLEST * fails, fails
    if not works(low):
        return 0.0
    for _ in range(20):
        # the geometric mean: the answer may lie orders of magnitude below
        middle = float(np.sqrt(low * high))
        low, high = (middle, high) if works(middle) else (low, middle)
    return low


RATE = 1000.0
"""Of the controller [Hz]."""
VELOCITY_CUTOFF = 80.0
"""Cut-off of the velocity estimate [Hz]; at most ``WIDEST`` of the rate at which the encoders are read."""
WIDEST = 0.4
"""Largest cut-off over that rate [1]."""
VELOCITY_DAMPING = 0.9
"""Damping ratio of the velocity estimate [1]."""


def cutoff(rate: float) -> float:
    """Cut-off [Hz] for encoders that are read at a rate [Hz]."""
    return min(VELOCITY_CUTOFF, WIDEST * rate)


def pd_loop(gains: Gains, dt: float) -> SampledLoop:
    """The loop of PD gains with the velocity estimate, a period of dt [s], and torque that is not late."""
    rate = 1.0 / dt
    law = PD(rate=rate, kp=gains.kp, kd=gains.kd)
    return SampledLoop(law, dt, filter_gains(rate, cutoff(rate), VELOCITY_DAMPING))


GAIN_MARGIN = 2.0
"""Factor on all gains at which the loop must still be stable [1]: 6 dB, the usual gain margin."""
LATE = 1
"""Periods by which the torque may be late at that: a controller's own computing time."""


def position_controller(
    arm: NominalArm,
    posture: np.ndarray,
    bandwidth: float = 4.0,
    along: np.ndarray | None = None,
) -> PD:
    """PD with nominal feedforward, kp = max(w^2 D, w b / (2 zeta)), kd = 2 zeta w D; w = 2 pi bandwidth, zeta = 0.7.

    D is ``loop_inertia``: the joints' own inertia at the posture, less if the loop would come near instability. b is
    the viscous friction of the data sheet: where it damps more than kd, a stiffness of w^2 D would let the joint follow
    at w^2 D / b only, far below w, and might not hold its weight.

    Args:
        arm: the nominal arm.
        posture: [rad], shape (n,).
        bandwidth: [Hz].
        along: further postures that the motions pass [rad], shape (K, n); none by default.

    Raises:
        InputError: the mass matrix of the arm is not positive definite, or the bandwidth is too high.
    """
    inertia = loop_inertia(arm, posture, bandwidth, along)
    gains = pd_gains(inertia, bandwidth)
    against_friction = np.pi * bandwidth * arm.viscous / DAMPING
    stiffness = np.maximum(gains.kp, against_friction)
    # three digits, as a person would write them into a case
    kp, kd = (
        np.array([float(f"{x:.3g}") for x in gain]) for gain in (stiffness, gains.kd)
    )
    return PD(
        rate=RATE,
        kp=kp,
        kd=kd,
        feedforward="nominal",
        velocity_cutoff=VELOCITY_CUTOFF,
        velocity_damping=VELOCITY_DAMPING,
    )


def loop_inertia(
    arm: NominalArm,
    posture: np.ndarray,
    bandwidth: float,
    along: np.ndarray | None = None,
    damping: float = DAMPING,
) -> np.ndarray:
    """Inertia D that gains are computed with [kg m^2], shape (n,).

    Without friction the modes of the loop are those of D x = lambda M(q) x, each a joint of inertia 1 under the gains
    lambda w^2 and lambda 2 zeta w. With D the joints' own inertia M_ii + I_i, lambda may be 100 and more: a light wrist
    that aligns with a heavy joint takes part in its motion, and rotors that a data sheet omits would have kept it from
    that. If lambda exceeds ``stiffest_mode`` at a posture, no D_i is left above c F_i, with F_i the least inertia that
    joint i feels along the motion while the others are free, 1 / (M^-1)_ii, and c the largest number with which all is
    well. Such a number exists, since the eigenvalues of M^-1 D sum up to its trace, at most c n.

    Args:
        arm: the nominal arm.
        posture: at which the joints' own inertia is taken [rad], shape (n,).
        bandwidth: w / 2 pi [Hz].
        along: further postures that the motions pass [rad], shape (K, n).
        damping: zeta [1].

    Raises:
        InputError: the mass matrix of the arm is not positive definite, or the bandwidth is too high.
    """
    body = RigidBody(arm)
    check_inertia(body)
    postures = [posture, *([] if along is None else along)]
    masses = np.array([body.mass_matrix(q) for q in postures]) + np.diag(arm.armature)
    inverses = np.linalg.inv(masses)
    # at the posture itself, which comes first
    own = np.diag(masses[0])

    def stiffest(inertia: np.ndarray) -> float:
        # D^1/2 M^-1 D^1/2 is symmetric and has the eigenvalues of M^-1 D
        root = np.sqrt(inertia)
        return float(np.linalg.eigvalsh(root[:, None] * inverses * root).max())

    allowed = stiffest_mode(bandwidth, damping)
    # the rotors and bodies themselves bear the loop: nothing is taken off
    if stiffest(own) <= allowed:
        return own
    # the least over all postures
    free = 1.0 / np.diagonal(inverses, axis1=1, axis2=2).max(axis=0)

    def excess(log_c: float) -> float:
        return stiffest(np.minimum(own, np.exp(log_c) * free)) - allowed

    # below, the trace c n is within what is allowed; above, all joints have their own
    lowest, highest = allowed / len(own), float((own / free).max())
    # a little beyond both ends, where rounding would decide the sign
    c = np.exp(brentq(excess, np.log(0.99 * lowest), np.log(1.01 * highest)))
    return np.minimum(own, c * free)


def stiffest_mode(bandwidth: float, damping: float = DAMPING) -> float:
    """Largest lambda [1] of a mode that is stable at ``GAIN_MARGIN`` times the gains with torque ``LATE`` periods late.

    Args:
        bandwidth: w / 2 pi [Hz].
        damping: zeta [1].

    Raises:
        InputError: no inertia is stable at this bandwidth.
    """
    # gains over an inertia: a mode of inertia 1 under gains times a factor
    kp, kd = pd_gains(np.ones(1), bandwidth, damping)

    def growth(log_factor: float) -> float:
        factor = np.exp(log_factor)
        sampled = pd_loop(Gains(factor * kp, factor * kd), 1.0 / RATE)
        loop = sampled._replace(late=LATE)
        return loop.spectral_radius(np.eye(1), np.zeros(1)) - 1.0

    # gains over the inertia from next to nothing to far beyond what any loop bears
    low, high = np.log(1e-2), np.log(1e4)
    if growth(low) >= 0:
        raise InputError(
            f"{bandwidth:g} Hz is more than a loop of {RATE:g} Hz with this velocity filter bears",
            "lower it",
            where="bandwidth",
        )
    return float(np.exp(brentq(growth, low, high))) / GAIN_MARGIN
