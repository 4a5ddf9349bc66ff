"""Friction of all joints at one moment, and dry friction in one time step, with sticking.

Coulomb's law is set-valued: f = c sgn v if a joint moves, and any f within +-c if it rests. Injected as a torque
of the present velocity it chatters about v = 0; here the velocity *after* the step is found together with the friction.

Motors that turn several joints have rotor, viscous and dry friction of their own speed w = D_m dq. What a motor takes,
I dw/dt + b w + f with f in c(w) Sgn w, acts on its joints along D_m^T. Explicit rotors would make an algebraic loop, so
w after the step is solved together with the joints' own friction: the motors are joints more, tied to the others by a
damper that is all but rigid.
"""

from __future__ import annotations

from functools import reduce

import numpy as np
from numpy import add, multiply
from scipy.linalg.lapack import dgesv

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.dynamics.rollout import ForwardDynamics
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.effect import Drift, DryLaw
from gapscope.effects.passivity import total
from gapscope.envs.drive.rows import Laws, Rows, repeated

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


DRIFT_PERIOD = 0.016
"""Drift, whose time constant is seconds and more, is brought up to date this often [s]."""


class Friction(Rows):
    """Limit of dry friction, and b F, with the nominal values included.

    With A_l(v, applied) the ``amplitude`` of each law l of dry friction and D_m(t) the ``change`` of each drift m, the
    limit is (c + sum_l A_l) F, F = prod_m (1 + D_m). Laws that vary with nothing are summed once, those that vary with
    the load when a torque is taken over.

    Args:
        arm: an arm with effects.
        order: the arm's joints in the order of the result.
        dt: time step [s].

    Attributes:
        viscous: b F [N m s/rad], shape (n,).
        present: whether there is any friction.
        drifting: whether it drifts; it is to be brought up to date every ``every`` steps.
        dry: mask of the joints with dry friction, shape (n,).

    Raises:
        InputError: friction that is negative in total.
    """

    ROWS = (
        *("_constant", "_loaded", "_moving", "dry"),
        *("_base_viscous", "viscous", "_drifts", "_factor"),
    )

    def __init__(self, arm: CorrectedArm, order: np.ndarray, dt: float) -> None:
        # coupled motors have dry friction of their own
        laws = [item for item in arm.of_kind(DryLaw) if item[0].reach != "motor"]
        constant = arm.arm.coulomb
        for law, values in laws:
            if law.varies_with == "nothing":
                constant = constant + law.amplitude(0.0, 0.0, *values)
        self._constant = total(constant, "nominal.coulomb", "N m")[order]
        self._loaded, self._moving = (
            Laws([item for item in laws if item[0].varies_with == what], order)
            for what in ("load", "velocity")
        )
        self.dry = (self._constant > 0) | self._loaded.joints | self._moving.joints
        viscous = total(arm.quantity("damping"), "nominal.viscous", "N m s/rad")
        self._base_viscous, self.viscous = viscous[order], viscous[order]
        self._drifts = Laws(arm.of_kind(Drift), order)
        self._factor: np.ndarray = np.ones(len(order))
        self.every = max(1, round(DRIFT_PERIOD / dt))
        self.note()

    def note(self) -> None:
        """Note what is absent, so that a step leaves it out; a torque is still to be taken over."""
        self.drifting = bool(self._drifts.acting)
        self.present = bool(self.dry.any() or self._base_viscous.any())
        size = len(self._constant)
        self._at_rest, self._applied = self._constant, np.zeros(size)
        self._under_load = repeated(self._sum_at_rest, 2, size)
        self._in_motion = repeated(self._sum_in_motion, 4, size)
        self._drifted = repeated(self._product, 1, size)

    def drift(self, t: float | np.ndarray, where: np.ndarray | None = None) -> None:
        """Bring the drift up to date at a time t [s], of all joints or of those of a mask, shape (n,)."""
        now = True if where is None else where
        np.copyto(self._factor, self._drifted(t), where=now)
        self.viscous = self._factor * self._base_viscous

    def _product(self, t: np.ndarray) -> np.ndarray:
        """The drift's factor F [1] at times t [s], if there is any."""
        drifts = self._drifts.acting
        factors = [1.0 + effect.change(t, *values) for effect, values in drifts]
        return reduce(multiply, factors)

    def _sum_at_rest(self, applied: np.ndarray, factor: np.ndarray) -> np.ndarray:
        """Limit without what varies with the velocity [N m]."""
        limit = self._constant
        if self._loaded.acting:
            limit = _sum(self._loaded, 0.0, applied) + limit
        return limit * factor if self.drifting else limit

    def _sum_in_motion(
        self,
        velocity: np.ndarray,
        applied: np.ndarray,
        factor: np.ndarray,
        at_rest: np.ndarray,
    ) -> np.ndarray:
        """Limit with what varies with the velocity [N m]."""
        if not self._moving.acting:
            return at_rest
        more = _sum(self._moving, velocity, applied)
        return (more * factor if self.drifting else more) + at_rest

    def load(self, applied: np.ndarray, where: np.ndarray | None = None) -> None:
        """Take over the applied motor torque [N m], shape (n,), of all joints or of those of a mask."""
        at_rest = self._under_load(applied, self._factor)
        if where is not None:
            at_rest = np.where(where, at_rest, self._at_rest)
            applied = np.where(where, applied, self._applied)
        self._at_rest, self._applied = at_rest, applied

    def limit(self, velocity: np.ndarray) -> np.ndarray:
        """Limit of dry friction [N m] at velocities [rad/s], shape (n,)."""
        return self._in_motion(velocity, self._applied, self._factor, self._at_rest)


def _sum(
    laws: Laws[DryLaw], velocity: np.ndarray | float, applied: np.ndarray
) -> np.ndarray:
    """Sum of the amplitudes of laws [N m], of which there is one."""
    return reduce(
        add, [law.amplitude(velocity, applied, *values) for law, values in laws.acting]
    )


TIE = 1e5
"""Inertia that ties a motor to its joints, over the largest of the mass matrix [1]."""


class CoupledMotors:
    """Torque that an arm's k coupled motors take from its n joints, in kinematic order.

    Args:
        arm: an arm with effects.
        body: its loaded rigid bodies.
        dt: time step [s].

    Attributes:
        present: whether a motor takes any.
    """

    def __init__(self, arm: CorrectedArm, body: RigidBody, dt: float) -> None:
        n, order = arm.arm.n_joints, body.order
        drives = np.eye(n) if arm.arm.coupling is None else arm.arm.coupling
        viscous = arm.quantity("motor_damping")
        rotors = arm.quantity("motor_rotor")
        dry = [x for x in arm.of_kind(DryLaw) if x[0].reach == "motor"]
        takes = sum((values[0] for _, values in dry), viscous + rotors)
        motors = np.flatnonzero(takes > 0)
        self.present = bool(len(motors))
        self._drives = drives[np.ix_(motors, order)]
        self._dry = [(law, [x[motors] for x in values]) for law, values in dry]
        self._dt = dt
        self._viscous, self._rotors = viscous[motors], rotors[motors]
        self._tied = np.hstack([self._drives, -np.eye(len(motors))])
        if self.present:
            self._forward = ForwardDynamics(body, np.zeros(n))
            self._friction = DryFriction(n + len(motors))

    def reset(self) -> None:
        """Forget the step before: all rests."""
        self._friction.reset()

    def __call__(
        self,
        q: np.ndarray,
        dq: np.ndarray,
        torque: np.ndarray,
        rotors: np.ndarray,
        viscous: np.ndarray,
        limit: np.ndarray,
    ) -> np.ndarray:
        """Torque taken [N m], (n,).

        Args:
            q, dq: positions [rad] and velocities [rad/s] before the step, (n,).
            torque: on the joints but friction and rotors [N m], (n,).
            rotors: the joints' own [kg m^2], (n,).
            viscous: their viscous friction [N m s/rad], (n,).
            limit: of their dry friction [N m], (n,).
        """
        dt, n = self._dt, len(q)
        self._forward.set_rotors(rotors + dt * viscous)
        inertia = self._forward.mass_matrix(q)
        out = torque - viscous * dq - self._forward.bias(q, dq)
        speed = self._drives @ dq
        own = self._rotors + dt * self._viscous
        together = TIE * inertia.max() * (self._tied.T @ self._tied)
        together[:n, :n] += inertia
        together[n:, n:] += np.diag(own)
        # a tie that holds before the step has no momentum
        momentum = np.concatenate([inertia @ dq + dt * out, self._rotors * speed])
        limits = dt * np.concatenate([limit, self._limit(speed)])
        after, impulse = self._friction.solve(together, momentum, limits)
        change = self._rotors * (after[n:] - speed) + impulse[n:]
        return np.asarray((change / dt + self._viscous * after[n:]) @ self._drives)

    def _limit(self, speed: np.ndarray) -> np.ndarray:
        """Limit of the motors' dry friction [N m], (k,), at their speeds [rad/s]."""
        limit = np.zeros_like(speed)
        for law, values in self._dry:
            limit += law.amplitude(speed, limit, *values)
        return limit
