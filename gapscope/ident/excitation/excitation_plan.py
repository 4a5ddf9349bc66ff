"""What kind of exciting trajectory is wanted."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from gapscope.arm.dynamics.collision import CollisionModel
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.motions.sample_count import check_sample_count
from gapscope.arm.motions.trajectory import urdf_limits
from gapscope.arm.nearest_name import check_known
from gapscope.arm.nominal import NominalArm
from gapscope.ident.excitation.criteria import CRITERIA
from gapscope.ident.excitation.evolution import Evolution
from gapscope.ident.excitation.families import KINDS, Family, family
from gapscope.ident.excitation.gradient import GradientRefinement
from gapscope.ident.excitation.limits import (
    REMEDIES,
    SURFACE,
    Allowed,
    check_motion_limits,
)
from gapscope.ident.excitation.optimiser import Optimiser
from gapscope.ident.excitation.random_search import RandomSearch
from gapscope.ident.excitation.sampling import check_sampling
from gapscope.ident.excitation.swarm import ParticleSwarm
from gapscope.ident.excitation.trajectory_search import Budget
from gapscope.ident.excitation.written_check import CHECKED_RATE
from gapscope.ident.model.regressor import JOINT_COLUMNS

SHORTEST = 10.0
"""Duration if none is asked for, or one period if that is longer [s]."""
RAMP = 1.0
"""Length of the flanks in which a motion rises from rest and falls back [s]."""

OPTIMISERS: dict[str, Callable[[], Optimiser]] = {
    "random": RandomSearch,
    "swarm": ParticleSwarm,
    "cma": Evolution,
    "gradient": GradientRefinement,
}
"""Optimisers by name."""


@dataclass(frozen=True)
class ExcitationPlan:
    """What to look for, and how.

    Attributes:
        kind: ``fourier``, ``quintic`` or ``multisine``.
        order: number of harmonics; half the number of way points of a quintic.
        frequency: of the first harmonic [Hz].
        duration: [s]; 10 s or one period, whichever is longer, if ``None``.
        rate: samples per second that are written [Hz].
        criterion: ``condition``, ``d`` or ``e``; or ``separation`` of effects.
        effects: names of effects to separate, for ``separation``; with another criterion they are only reported on.
        columns: quantities with columns of the regressor, beside the inertial ones.
        optimiser: one of ``OPTIMISERS``; by default ``gradient``, and ``cma`` for ``separation``.
        budget: when the search ends.

    Raises:
        InputError: an unknown name, or numbers that do not fit together.
    """

    kind: str = "fourier"
    order: int = 5
    frequency: float = 0.1
    duration: float | None = None
    rate: float = 250.0
    criterion: str = "condition"
    effects: tuple[str, ...] = ()
    columns: tuple[str, ...] = JOINT_COLUMNS
    optimiser: str | None = None
    budget: Budget = field(default_factory=Budget)

    def __post_init__(self) -> None:
        """Check the names and numbers, and that the rate fits the frequencies."""
        self._check_names()
        self._check_numbers()
        check_sampling(self.rate, self.family(1).highest_frequency)

    def _check_names(self) -> None:
        check_known("kind of trajectory", self.kind, KINDS, where="kind")
        check_known(
            "criterion", self.criterion, [*CRITERIA, "separation"], where="criterion"
        )
        if self.optimiser is not None:
            check_known("optimiser", self.optimiser, OPTIMISERS, where="optimiser")
        if self.criterion == "separation" and len(self.effects) < 2:
            raise InputError(
                "separation needs two or more effects",
                "name them, such as coulomb_friction and load_friction",
                where="effects",
            )
        if self.criterion == "separation" and self.optimiser == "gradient":
            raise InputError(
                "separation has no analytic gradient",
                "use cma, swarm or random",
                where="optimiser",
            )

    def _check_numbers(self) -> None:
        if not (self.order >= 1 and self.order == int(self.order)):
            raise InputError(
                f"{self.order:g} is no number of harmonics",
                "give 1 or more",
                where="order",
            )
        for name, value in (("frequency", self.frequency), ("rate", self.rate)):
            if not (np.isfinite(value) and value > 0):
                raise InputError(f"{value:g} Hz is not above zero", where=name)
        length = self.length
        if not (np.isfinite(length) and length >= 3 * RAMP):
            raise InputError(
                f"{length:g} s leave no time between rising and falling",
                f"give {3 * RAMP:g} s or more",
                where="duration",
            )
        if self.kind != "quintic" and length * self.frequency < 1 - 1e-9:
            raise InputError(
                f"{length:g} s are shorter than a period of the base frequency {self.frequency:g} Hz",
                f"give {1 / self.frequency:g} s or more, or a higher base frequency",
                where="duration",
            )
        check_sample_count(length, max(self.rate, CHECKED_RATE))

    @property
    def length(self) -> float:
        """Duration [s]."""
        return (
            max(SHORTEST, 1 / self.frequency)
            if self.duration is None
            else float(self.duration)
        )

    @property
    def method(self) -> str:
        """Name of the optimiser."""
        return self.optimiser or (
            "cma" if self.criterion == "separation" else "gradient"
        )

    def family(self, n_joints: int) -> Family:
        """The family of trajectories for an arm of n joints."""
        return family(
            self.kind, n_joints, self.length, self.order, self.frequency, RAMP
        )


@dataclass(frozen=True)
class LimitPlan:
    """How limits follow from an arm.

    Attributes:
        velocity: no joint moves faster, whatever the URDF allows [rad/s].
        acceleration: limit of all joints, which a URDF does not give [rad/s^2].
        torque: share of the torque limits of data sheet or URDF that may be used [1].
        margin: distance kept from the position limits [rad].
        singular: least singular value of the tool's Jacobian; 0 for any.
        clearance: least distance between bodies, and to the surface [m].
        surface: height of the surface on which the base stands in the base frame [m], ``None`` if there is none.
        collisions: whether collisions are checked at all.
    """

    velocity: float = 1.5
    acceleration: float = 5.0
    torque: float = 0.8
    margin: float = 0.1
    singular: float = 0.02
    clearance: float = 0.01
    surface: float | None = 0.0
    collisions: bool = True

    def allowed(self, arm: NominalArm, body: RigidBody) -> Allowed:
        """The limits of an arm.

        Raises:
            InputError: they leave no room, or a number makes no sense.
        """
        for name, least in (
            ("torque", 0.0),
            ("margin", 0.0),
            ("singular", 0.0),
            ("clearance", 0.0),
        ):
            value = getattr(self, name)
            if not (np.isfinite(value) and value >= least) or (
                name == "torque" and value == 0
            ):
                raise InputError(
                    f"{value:g} makes no sense", "give a number above zero", where=name
                )
        motion = urdf_limits(body, self.acceleration, margin=self.margin)
        motion = motion._replace(velocity=np.minimum(motion.velocity, self.velocity))
        check_motion_limits(motion)
        effort = body.effort_limits() if arm.torque_limit is None else arm.torque_limit
        torque = self.torque * np.where(effort > 0, effort, np.inf)
        return Allowed(
            motion=motion,
            torque=torque,
            singular=self.singular,
            clearance=self.clearance,
        )

    def collision(self, arm: NominalArm, body: RigidBody) -> CollisionModel | None:
        """The collision shapes of an arm, or ``None`` if collisions are not checked.

        Raises:
            InputError: there are none, or every body lies below the surface in nearly every posture.
        """
        if not self.collisions:
            return None
        collision = CollisionModel(arm, body, self.surface)
        if self.surface is not None and not any(
            SURFACE in pair for pair in collision.pairs
        ):
            raise InputError(
                f"the whole arm lies below a surface at {self.surface:g} m in nearly every posture",
                f"{REMEDIES[SURFACE]}; it is measured in the base frame",
                where="surface",
            )
        return collision
