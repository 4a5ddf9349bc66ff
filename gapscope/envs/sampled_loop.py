"""The PD loop as a computer closes it: sampled, with a filtered velocity, held and perhaps late torque."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gapscope.arm.velocity_filter import FilterGains
from gapscope.envs.actions import Gains


@dataclass(frozen=True)
class SampledLoop:
    """A PD loop of n joints, sampled with a period of dt.

    The error is that from a posture at rest. With u[k] = Kp q[k] + Kd v[k],

        (M + dt B) dq[k+1] = M dq[k] - dt u[k - late],   q[k+1] = q[k] + dt dq[k+1],
        v[k] = b0 q[k] + b1 q[k-1] + b2 q[k-2] + a1 v[k-1] + a2 v[k-2].

    Attributes:
        gains: Kp and Kd.
        dt: period [s].
        estimate: gains of the velocity estimate.
        late: periods by which the torque is late, the same for all joints.
    """

    gains: Gains
    dt: float
    estimate: FilterGains
    late: int = 0

    def times(self, share: float) -> SampledLoop:
        """The same loop with a bandwidth ``share`` times as large: kp grows with its square, kd with it."""
        gains = Gains(share**2 * self.gains.kp, share * self.gains.kd)
        return SampledLoop(gains, self.dt, self.estimate, self.late)

    def stable(self, mass: np.ndarray, viscous: np.ndarray) -> bool:
        """Whether all modes die away: the spectral radius is below 1."""
        return self.spectral_radius(mass, viscous) < 1.0

    def spectral_radius(self, mass: np.ndarray, viscous: np.ndarray) -> float:
        """Largest modulus of the loop's eigenvalues [1].

        Args:
            mass: M with rotors [kg m^2], shape (n, n).
            viscous: diagonal of B [N m s/rad], shape (n,).
        """
        n = len(mass)
        states = np.eye((6 + self.late) * n).reshape(6 + self.late, n, -1)
        # q[k], dq[k], q[k-1], q[k-2], v[k-1], v[k-2], then what was commanded, the latest first
        q, dq, q1, q2, v1, v2, *commanded = states
        b0, b1, b2, a1, a2 = self.estimate
        v = b0 * q + b1 * q1 + b2 * q2 + a1 * v1 + a2 * v2
        torque = self.gains.kp[:, None] * q + self.gains.kd[:, None] * v
        commanded = [torque, *commanded]
        pushed = mass @ dq - self.dt * commanded[-1]
        faster = np.linalg.solve(mass + self.dt * np.diag(viscous), pushed)
        following = (q + self.dt * faster, faster, q, q1, v, v1, *commanded[:-1])
        return float(np.abs(np.linalg.eigvals(np.vstack(following))).max())
