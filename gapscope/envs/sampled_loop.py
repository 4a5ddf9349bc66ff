"""A position loop as a computer closes it: sampled, with a filtered velocity, held and perhaps late torque."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gapscope.arm.controller import Controller
from gapscope.arm.velocity_filter import FilterGains


@dataclass(frozen=True)
class SampledLoop:
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
        return replace(self, controller=self.controller.times(share))

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
        pushed = dq @ mass - self.dt * commanded[-1]
        damped = mass + self.dt * np.diag(viscous)
        faster = np.linalg.solve(damped, pushed.T).T
        following = (q + self.dt * faster, faster, q, q1, v, v1)
        after = np.hstack([*following, *commanded[:-1], *integral])
        return float(np.abs(np.linalg.eigvals(after)).max())
