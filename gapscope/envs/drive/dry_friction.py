"""Dry friction of several joints in one time step, with sticking.

Coulomb's law is set-valued: f = c sgn v if a joint moves, and any f within +-c if it rests. Injected as a torque
of the present velocity it chatters about v = 0; here the velocity *after* the step is found together with the friction.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg.lapack import dgesv

TRIALS = 100
"""Changes of the set of sticking joints before the solver gives up."""
BLOCK_TRIALS = 10
"""The first of them change all joints at fault at once, later ones only the first, which cannot cycle."""


class DryFriction:
    r"""Solves W v + p = b with p_i = limit_i sgn v_i if v_i != 0, and \|p_i\| <= limit_i if v_i = 0.

    W [kg m^2] is symmetric positive definite, so that the solution is unique; v [rad/s] is the velocity after the step,
    p [N m s] the friction's impulse. It is found by block principal pivoting on the set of sticking joints,
    starting from the set of the step before.

    Attributes:
        direction: sign of each joint's velocity in the last solution, 0 if it sticks, shape (n,).
        sticks: which joints stuck in it, shape (n,).
    """

    def __init__(self, n_joints: int) -> None:
        self._identity = np.eye(n_joints)
        self.reset()

    def reset(self) -> None:
        """Forget the step before: all joints rest."""
        self.direction: np.ndarray = np.zeros(len(self._identity))
        self.sticks = np.ones(len(self._identity), dtype=bool)

    def solve(
        self, inertia: np.ndarray, momentum: np.ndarray, limit: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Velocity v [rad/s] after the step and friction impulse p [N m s], each of shape (n,).

        Args:
            inertia: W [kg m^2], shape (n, n).
            momentum: b [N m s], shape (n,).
            limit: c dt [N m s], shape (n,), not negative; joints with 0 have no friction.

        Raises:
            ArithmeticError: no solution found, which a positive definite W rules out.
        """
        dry = limit > 0
        direction = self.direction
        for trial in range(TRIALS):
            stuck = dry & (direction == 0)
            known = direction * limit
            # unknowns: the velocity of moving joints, the impulse of stuck ones
            x = dgesv(np.where(stuck, self._identity, inertia), momentum - known)[2]
            wrong = np.where(stuck, np.abs(x) > limit, dry & (x * direction < 0))
            if not wrong.any():
                self.sticks = stuck
                self.direction = np.where(dry, direction, np.sign(x))
                return np.where(stuck, 0.0, x), np.where(stuck, x, known)
            if trial >= BLOCK_TRIALS:
                wrong = wrong & (np.cumsum(wrong) == 1)
            direction = np.where(wrong, np.where(stuck, np.sign(x), 0.0), direction)
        raise ArithmeticError(
            f"dry friction of {len(limit)} joints did not settle in {TRIALS} trials"
        )
