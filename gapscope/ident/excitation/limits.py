"""Limits of an excitation and the times at which they are kept."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gapscope.arm.control import feedforward
from gapscope.arm.dynamics.kinematics import Kinematics, smallest_singular_value
from gapscope.arm.dynamics.link_shapes import CollisionModel
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.joint_units import common_unit, joint_unit
from gapscope.arm.motions.motion import Motion
from gapscope.arm.motions.trajectory import Limits, Sampled
from gapscope.arm.nominal import NominalArm

# Whether a sampling rate is high enough for a trajectory.


MIN_RATIO = 10.0
"""Samples per period of the highest frequency, at least [1]."""


def check_sampling(rate: float, highest: float) -> None:
    """Check that there are at least ten samples per period of the highest frequency.

    Args:
        rate: sampling rate [Hz].
        highest: highest frequency of the trajectory [Hz].

    Raises:
        InputError: the rate is too low.
    """
    if not rate >= MIN_RATIO * highest * (1 - 1e-9):
        raise InputError(
            f"{rate:g} samples per second are fewer than {MIN_RATIO:g} times the highest frequency, {highest:g} Hz",
            f"sample at {MIN_RATIO * highest:g} Hz or more, or lower the base frequency or the order",
            where="rate",
        )


# What a trajectory has to keep, and by how much it keeps it.


JERK_TIME = 0.02
"""Shortest time in which the acceleration may rise from nothing to its limit [s]: jerk is bounded by their ratio."""
SPARE = 1e-4
"""What is kept of a limit for rounding and interpolation of the files: a share [1], or a distance [m]."""
SURFACE = "surface"
"""Name of the surface among the bodies of a ``CollisionModel``."""
REMEDIES = {
    "torque": "raise --torque, or lower --acceleration and --velocity",
    "torque when slow": "raise --torque: the posture alone needs it",
    "jerk": "lower --frequency, --order or --acceleration",
    "singular value": "lower --singular",
    "distance": "lower --clearance",
    SURFACE: "lower --surface, the height under the arm",
}
"""What to change if candidates break a limit."""


@dataclass(frozen=True)
class Allowed:
    """All limits of an exciting trajectory.

    Attributes:
        motion: of position [rad], velocity [rad/s] and acceleration [rad/s^2].
        torque: largest nominal torque [N m], shape (n,).
        singular: least singular value of the tool's Jacobian, as ``gapscope.arm.dynamics.kinematics`` has it; 0
        if it may be any. clearance: least distance between bodies, and to the surface [m].
    """

    motion: Limits
    torque: np.ndarray
    singular: float
    clearance: float

    @property
    def jerk(self) -> np.ndarray:
        """Largest jerk [rad/s^3], shape (n,)."""
        return self.motion.acceleration / JERK_TIME

    def tightened(self, torque: float, singular: float, clearance: float) -> Allowed:
        """With a share less torque, a share more distance from singular poses, and more clearance [m]."""
        return replace(
            self,
            torque=self.torque * (1 - torque),
            singular=self.singular * (1 + singular),
            clearance=self.clearance + clearance,
        )


@dataclass(frozen=True)
class Margin:
    """How far a trajectory stays from one limit.

    Attributes:
        name: ``position``, ``velocity``, ``acceleration``, ``jerk``, ``torque``, ``singular value`` or ``distance``.
        unit: of limit and margin.
        limit: the limit; for ``position`` half the range about its middle; shape (n,) or ().
        margin: least distance from the limit over all samples, negative if it is broken; shape (n,) or ().
        at: time at which the margin is least [s].
    """

    name: str
    unit: str
    limit: np.ndarray
    margin: np.ndarray
    at: float

    @property
    def kept(self) -> bool:
        """Whether the limit holds at every sample, but for rounding."""
        return bool((self.margin >= -1e-9).all())

    @property
    def spares(self) -> bool:
        """Whether ``SPARE`` of the limit is left at every sample; of a distance that many metres."""
        share = 1.0 if self.name == "distance" else self.limit
        return bool((self.margin >= SPARE * share).all())


class Checker:
    """Checks motions against limits, sample by sample.

    Args:
        arm: the nominal arm.
        body: its rigid bodies.
        allowed: the limits.
        collision: its collision shapes; ``None`` if collisions are not checked.

    Attributes:
        allowed, collision: as given.
    """

    def __init__(
        self,
        arm: NominalArm,
        body: RigidBody,
        allowed: Allowed,
        collision: CollisionModel | None,
    ) -> None:
        self.allowed, self.collision = allowed, collision
        self._arm, self._body, self._kinematics = arm, body, Kinematics(body)

    def torque(self, motion: Motion) -> np.ndarray:
        """Nominal torque with armature and data sheet friction [N m], shape (N, n)."""
        state = motion.q, motion.dq, motion.ddq
        return feedforward(self._arm, self._body, "nominal", *state)

    def singular_value(self, q: np.ndarray) -> np.ndarray:
        """Smallest singular value of the tool's Jacobian at q [rad], (N, n); shape (N,)."""
        return smallest_singular_value(self._kinematics, q)

    def distance(self, q: np.ndarray) -> np.ndarray:
        """Least distance between bodies at q [rad], (N, n), infinite if it is not checked [m]; shape (N,)."""
        return (
            np.full(len(q), np.inf)
            if self.collision is None
            else self.collision.distance(q)[0]
        )

    def margins(self, motion: Motion, torque: np.ndarray) -> tuple[Margin, ...]:
        """Margins of a motion of N samples with its nominal torque [N m], (N, n), to all limits that are checked."""
        allowed, t, sliding = self.allowed, motion.t, self._arm.sliding
        limits = allowed.motion
        middle, half = limits.upper + limits.lower, limits.upper - limits.lower
        wanted = [
            ("position", "rad", half / 2, motion.q - middle / 2),
            ("velocity", "rad/s", limits.velocity, motion.dq),
            ("acceleration", "rad/s^2", limits.acceleration, motion.ddq),
            ("torque", "N m", allowed.torque, torque),
        ]
        if len(t) > 1:
            # over each step, counted at its end
            change = np.diff(motion.ddq, axis=0) * motion.rate
            wanted.append(("jerk", "rad/s^3", allowed.jerk, change))
        out = [
            _margin(name, common_unit(unit, sliding), limit, limit - np.abs(values), t)
            for name, unit, limit, values in wanted
        ]
        least = [("singular value", "1", allowed.singular, self.singular_value)]
        if allowed.singular <= 0:
            least = []
        if self.collision is not None:
            least.append(("distance", "m", allowed.clearance, self.distance))
        for name, unit, bound, measure in least:
            slack = measure(motion.q) - bound
            out.append(_margin(name, unit, np.array(bound), slack, t))
        return tuple(out)

    def margin_when_slow(self, motion: Motion, speed: float) -> Margin:
        """Margin to the torque limits of the same path at ``speed`` times the speed [1]; gravity may need more then."""
        slow = Sampled(motion).slower(speed).motion
        slack = self.allowed.torque - np.abs(self.torque(slow))
        unit = common_unit("N m", self._arm.sliding)
        return _margin("torque when slow", unit, self.allowed.torque, slack, motion.t)

    def check_static(self, postures: np.ndarray) -> None:
        """Check that some posture can be held at all, given many within the position limits, shape (N, n).

        Raises:
            InputError: torque, singular poses or collisions forbid all of them; says which.
        """
        still = np.zeros_like(postures)
        torque = (
            np.abs(self._body.inverse_dynamics(postures, still, still))
            <= self.allowed.torque
        )
        if not torque.all(axis=1).any():
            joint = int(torque.mean(axis=0).argmin())
            force = joint_unit("N m", self._arm.sliding[joint])
            raise InputError(
                f"the limits allow no trajectory: gravity alone needs more than "
                f"{self.allowed.torque[joint]:.4g} {force} on joint {joint + 1} in nearly every posture",
                "raise the share of the torque limits that is used",
                where="torque",
            )
        values = self.singular_value(postures)
        if values.max() < self.allowed.singular:
            raise InputError(
                f"the limits allow no trajectory: no posture has a singular value of {self.allowed.singular:.4g}; the "
                f"largest met is {values.max():.3g}",
                "choose a smaller least singular value, or 0",
                where="singular",
            )
        distances = self.distance(postures)
        if distances.max() < self.allowed.clearance:
            raise InputError(
                f"the limits allow no trajectory: no posture keeps {self.allowed.clearance:.4g} m between bodies and "
                f"to the surface; the best keeps {distances.max():.3g} m",
                self.remedy("distance", postures),
                where="clearance",
            )

    def remedy(self, name: str, postures: np.ndarray) -> str:
        """What to change if candidates break one limit, named as in ``Margin``.

        Args:
            name: of the limit.
            postures: random ones within the position limits, shape (N, n), for what mostly comes too near.
        """
        if name != "distance" or self.collision is None:
            return REMEDIES.get(name, "slow the motion down")
        distance, nearest = self.collision.distance(postures)
        too_near = nearest[distance < self.allowed.clearance]
        to_surface = [SURFACE in self.collision.pairs[i] for i in too_near]
        mostly_surface = sum(to_surface) > len(to_surface) / 2
        return REMEDIES[SURFACE if mostly_surface else name]


def _margin(
    name: str, unit: str, limit: np.ndarray, slack: np.ndarray, t: np.ndarray
) -> Margin:
    relative = slack / limit if limit.ndim else slack
    worst = relative.min(axis=1) if limit.ndim else relative
    at = t[len(t) - len(slack) + int(worst.argmin())]
    return Margin(name, unit, limit, slack.min(axis=0), float(at))


def check_motion_limits(limits: Limits) -> None:
    """Check that the limits leave room to move.

    Raises:
        InputError: an empty range of positions, or a velocity or acceleration of zero.
    """
    rooms = {
        "position": limits.upper - limits.lower,
        "velocity": limits.velocity,
        "acceleration": limits.acceleration,
    }
    for name, room in rooms.items():
        if (room > 0).all() and np.isfinite(room).all():
            continue
        joint = int(np.argmin(np.where(np.isfinite(room), room, -1.0)))
        raise InputError(
            f"the limits allow no trajectory: joint {joint + 1} has no room of {name} ({room[joint]:.4g})",
            "give a positive limit, or a smaller distance from the position limits",
            where=name,
        )
