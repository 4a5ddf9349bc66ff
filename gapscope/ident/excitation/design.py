"""The design of an excitation from its plan to files that a controller reads."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import yaml

from gapscope.arm.dynamics.link_shapes import CollisionModel
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import GapscopeError, InputError, ModelWarning
from gapscope.arm.io.atomic_write import atomic_write
from gapscope.arm.io.table import numbered
from gapscope.arm.io.write_case import write_columns
from gapscope.arm.motions.motion import Motion
from gapscope.arm.motions.trajectory import (
    Limits,
    ReferenceMotion,
    Sampled,
    check_sample_count,
    motion_of,
    urdf_limits,
)
from gapscope.arm.nearest_name import check_known
from gapscope.arm.nominal import NominalArm
from gapscope.ident.excitation.trajectory_search import (
    CRITERIA,
    KINDS,
    RAMP,
    REMEDIES,
    SAMPLES,
    SPARE,
    SURFACE,
    TIGHTER,
    Allowed,
    Budget,
    Checker,
    ExcitationModel,
    Family,
    Margin,
    Optimiser,
    Parametrisation,
    Separated,
    Separator,
    TrajectorySearch,
    check_motion_limits,
    evolution,
    random_search,
    refinement,
    separator_of,
    swarm,
)
from gapscope.ident.model.base_parameters import (
    CONDITION_LIMIT,
    ROUNDING,
    STATES,
    condition_number,
)
from gapscope.ident.model.regressor import JOINT_COLUMNS
from gapscope.ident.samples import MOST
from gapscope.model.conditioning import TORQUE_CUTOFF
from gapscope.model.rows import PER_CUTOFF

# An exciting trajectory into files: CSV in the columns of the case format, and a ROS ``JointTrajectory``.


ROS_RATE = 100.0
"""Points per second of a ``JointTrajectory``, about [Hz]; controllers interpolate between them."""
POINTS_PER_PERIOD = 25.0
"""Points per period of the highest frequency at least, if there are as many samples [1]."""


def write_csv(motion: Motion, path: Path) -> None:
    """Write ``t``, ``q_ref1..``, ``dq_ref1..`` and ``ddq_ref1..``, without loss.

    Raises:
        GapscopeError: the file cannot be written.
    """
    series = {"q_ref": motion.q, "dq_ref": motion.dq, "ddq_ref": motion.ddq}
    write_columns(numbered({"t": motion.t, **series}), path)


def write_joint_trajectory(
    motion: Motion, joints: Sequence[str], path: Path, rate: float = ROS_RATE
) -> None:
    """Write a ``trajectory_msgs/JointTrajectory`` as YAML, as ``ros2 topic pub`` and controllers take it.

    Positions, velocities and accelerations at about ``rate`` points per second, first and last sample included.

    Raises:
        GapscopeError: the file cannot be written.
    """
    last = len(motion.t) - 1
    step = max(1, round(motion.rate / rate))
    series = {
        "positions": motion.q,
        "velocities": motion.dq,
        "accelerations": motion.ddq,
    }
    points = []
    for i in np.unique([*range(0, last + 1, step), last]):
        sec, nanosec = divmod(round(float(motion.t[i]) * 10**9), 10**9)
        # no negative zeros
        point = {name: (x[i].round(9) + 0.0).tolist() for name, x in series.items()}
        stamp = {"sec": sec, "nanosec": nanosec}
        points.append({**point, "effort": [], "time_from_start": stamp})
    message = {
        "header": {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""},
        "joint_names": list(joints),
        "points": points,
    }
    dumper = getattr(yaml, "CSafeDumper", yaml.SafeDumper)
    text = yaml.dump(message, Dumper=dumper, sort_keys=False, default_flow_style=None)
    with atomic_write(path) as aside:
        aside.write_text(text, encoding="utf-8")


def read_joint_trajectory(path: Path) -> Sampled:
    """The reference motion of a file that ``write_joint_trajectory`` wrote."""
    loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
    points = yaml.load(path.read_text(encoding="utf-8"), loader)["points"]
    stamps = [point["time_from_start"] for point in points]
    t = np.array([stamp["sec"] + 1e-9 * stamp["nanosec"] for stamp in stamps])
    series = (
        np.array([point[key] for point in points])
        for key in ("positions", "velocities", "accelerations")
    )
    return Sampled(Motion(t, *series))


# What was written is read back and checked at finer steps than it holds, as a controller would carry it out.


CHECKED_RATE = 1000.0
"""Samples per second at which a file is checked, at full speed [Hz]; as many along the path of a slow one."""


def check_written(
    written: Sampled, checker: Checker, path: Path, speed: float = 1.0
) -> None:
    """Check a trajectory read back from a file, quintic between its samples, against all limits.

    Position, velocity, acceleration, jerk, nominal torque, singular poses and distances at 1 kHz, and rest at both
    ends.

    Args:
        written: the trajectory.
        checker: of the limits.
        path: of the file, for the message.
        speed: of a slower version, as a share of the full speed [1].

    Raises:
        GapscopeError: a limit does not hold; names limit, joint, time and by how much.
    """
    count = int(np.ceil(written.duration * CHECKED_RATE * speed)) + 1
    t = np.linspace(0.0, written.duration, count)
    motion = motion_of(written, t)
    limits, ends = checker.allowed.motion, [0, -1]
    for name, values, limit in (
        ("velocity", motion.dq, limits.velocity),
        ("acceleration", motion.ddq, limits.acceleration),
    ):
        share = np.abs(values[ends]) / limit
        if (share > SPARE).any():
            end, j = np.unravel_index(int(share.argmax()), share.shape)
            raise GapscopeError(
                f"{path}: not written: joint {j + 1} does not rest at {motion.t[ends[end]]:.3f} s, its {name} is "
                f"{100 * share[end, j]:.3g} % of its limit",
                "report this: what is designed starts and ends at rest",
            )
    for margin in checker.margins(motion, checker.torque(motion)):
        if not margin.kept:
            place, excess = "the arm", -float(np.min(margin.margin))
            if margin.limit.ndim:
                joint = int((margin.margin / margin.limit).argmin())
                place, excess = f"joint {joint + 1}", -float(margin.margin[joint])
            unit = "" if margin.unit == "1" else f" {margin.unit}"
            raise GapscopeError(
                f"{path}: not written: {place} breaks its limit of {margin.name} by {excess:.3g}{unit} at "
                f"{margin.at:.3f} s",
                "raise --rate, or design it with lower limits",
            )


# What kind of exciting trajectory is wanted.


MIN_RATIO = 10.0
"""Samples per period of the highest frequency, at least [1]."""
SHORTEST = 10.0
"""Duration if none is asked for, or one period if that is longer [s]."""

OPTIMISERS: dict[str, Optimiser] = {
    "random": random_search,
    "swarm": swarm,
    "cma": evolution,
    "gradient": refinement,
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
    optimiser: str | None = None
    budget: Budget = field(default_factory=Budget)

    def __post_init__(self) -> None:
        """Check the names and numbers, and that the rate fits the frequencies."""
        check_known("kind of trajectory", self.kind, KINDS, where="kind")
        criteria = [*CRITERIA, "separation"]
        check_known("criterion", self.criterion, criteria, where="criterion")
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
        needed = MIN_RATIO * self.family(1).highest_frequency
        if not self.rate >= needed * (1 - 1e-9):
            raise InputError(
                f"{self.rate:g} samples per second are fewer than {MIN_RATIO:g} times the highest frequency, "
                f"{needed / MIN_RATIO:g} Hz",
                f"sample at {needed:g} Hz or more, or lower the base frequency or the order",
                where="rate",
            )

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
        made = KINDS[self.kind]
        return made(n_joints, self.length, self.order, self.frequency)


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
        for name in ("torque", "margin", "singular", "clearance"):
            value = getattr(self, name)
            none = value < 0 or (name == "torque" and value == 0)
            if none or not np.isfinite(value):
                raise InputError(
                    f"{value:g} makes no sense", "give a number above zero", where=name
                )
        # no body would lie below it: the arm could be driven into its table
        if self.surface is not None and not np.isfinite(self.surface):
            raise InputError(
                f"{self.surface:g} is no height", "give a number", where="surface"
            )
        motion = urdf_limits(body, self.acceleration, margin=self.margin)
        motion = motion._replace(velocity=np.minimum(motion.velocity, self.velocity))
        check_motion_limits(motion)
        effort = body.effort_limits() if arm.torque_limit is None else arm.torque_limit
        torque = self.torque * np.where(effort > 0, effort, np.inf)
        return Allowed(motion, torque, self.singular, self.clearance)

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


# Which limit keeps a motion too small to determine an arm's parameters.


USELESS = 1 / ROUNDING
"""Condition number above which a trajectory is refused: rounding would drown a parameter [1]."""
WIDER = 10.0
"""Factor by which a limit is widened to see what it costs [1]."""
WORTH = 2.0
"""Factor in the condition number that a wider limit must be worth to be named [1]."""
OPTIONS = {
    "acceleration": "raise --acceleration",
    "velocity": "raise --velocity",
    "position": "lower --margin",
}
"""Limits of the motion, and what widens each."""


def binding_limit(
    search: TrajectorySearch, x: np.ndarray, condition: float
) -> tuple[str, float] | None:
    """The limit of the motion that costs a candidate most of its condition number; ``None`` if none costs much.

    With wider limits the same numbers x are a larger motion, so each limit can be widened alone.

    Args:
        search: what the candidate comes from.
        x: its numbers, shape (d,).
        condition: its condition number [1].

    Returns:
        The limit, and the condition number were it ``WIDER`` [1].
    """
    family, limits = search.parametrisation.family, search.parametrisation.limits
    t, found = np.linspace(0.0, family.duration, SAMPLES), {}
    middle = (limits.upper + limits.lower) / 2
    half = WIDER * (limits.upper - limits.lower) / 2
    for name, wider in {
        "acceleration": {"acceleration": WIDER * limits.acceleration},
        "velocity": {"velocity": WIDER * limits.velocity},
        "position": {"lower": middle - half, "upper": middle + half},
    }.items():
        space = Parametrisation(family, limits._replace(**wider))
        motion = space.motion(x, t, family.basis(t))
        found[name] = condition_number(search.model.matrix(motion))
    best = min(found, key=found.__getitem__)
    return (best, found[best]) if WORTH * found[best] <= condition else None


def check_condition(search: TrajectorySearch, x: np.ndarray, condition: float) -> None:
    """Warn if the condition number of a candidate exceeds ``CONDITION_LIMIT``, and name what would lower it.

    Raises:
        InputError: it exceeds ``USELESS``.
    """
    if condition <= CONDITION_LIMIT:
        return
    problem = f"the motion hardly determines the parameters, its condition number is {condition:.2g}"
    remedy, where = (
        "allow more evaluations, more harmonics or a longer motion",
        "limits",
    )
    binding = binding_limit(search, x, condition)
    if binding is not None:
        where, least = binding
        problem += f": the limit of {where} keeps it small"
        remedy = (
            f"{OPTIONS[where]}; {WIDER:g} times as wide, it would leave {least:.2g}"
        )
    if condition > USELESS:
        raise InputError(problem, remedy, where=where)
    warnings.warn(f"{problem}; {remedy}", ModelWarning, stacklevel=3)


# From an arm and a plan to the best trajectory found, checked at every sample.


SLOW = 0.2
"""Speed of the version of a trajectory that is run first, as a share of its own [1]."""
SEPARATING_RATE = 2 * PER_CUTOFF * TORQUE_CUTOFF
"""Samples per second of a candidate that is scored by predictions over time [Hz]: every other one is a row."""


@dataclass(frozen=True)
class Excitation:
    """An exciting trajectory that keeps all limits.

    Attributes:
        reference: the trajectory.
        motion: its samples at the rate of the plan, N of n joints; at rest at both ends.
        torque: nominal torque at these samples [N m], (N, n).
        margins: to every limit that was checked, over samples of 1 ms or less.
        condition: condition number of the base regressor, columns scaled to unit norm [1].
        inertial_condition: the same for the inertial columns alone.
        names: of the base columns, shape (b,).
        separated: how far the effects of the plan are apart, or ``None`` if it names fewer than two.
        evaluations: spent; a candidate with its gradient counts as ``search.GRADIENT_COST``.
        feasible: those that kept all limits.
        seconds: time of the search [s].
        left_out: pairs of bodies that touch by construction and are not checked.
        checker: of the limits, for what is written.
    """

    reference: ReferenceMotion
    motion: Motion
    torque: np.ndarray
    margins: tuple[Margin, ...]
    condition: float
    inertial_condition: float
    names: tuple[str, ...]
    separated: Separated | None
    evaluations: int
    feasible: int
    seconds: float
    left_out: tuple[tuple[str, str], ...]
    checker: Checker


def design(prepared: Prepared, rng: np.random.Generator) -> Excitation:
    """Look for the trajectory that excites an arm best.

    Args:
        prepared: the search, see ``prepare``.
        rng: source of candidates; with a budget of evaluations alone the same seed gives the same trajectory.

    Raises:
        InputError: none was found within the budget, or the best shows no parameter.

    Warns:
        ModelWarning: the condition number exceeds 1000; not if effects are to be separated.
    """
    arm, plan, search, final, separator, body = prepared
    begun = time.monotonic()
    OPTIMISERS[plan.method](search, rng)
    seconds = time.monotonic() - begun
    x, reference, margins = accept(search, final, plan)
    motion = sampled(reference, plan.length, plan.rate)
    # criteria of long motions are computed from fewer samples
    step = -(-len(motion.t) // MOST)
    few = motion.part(slice(None, None, step))
    model = ExcitationModel(arm, body, JOINT_COLUMNS)
    inertial = ExcitationModel(arm, body, ()).matrix(few)
    condition = condition_number(model.matrix(few))
    if plan.criterion != "separation":
        check_condition(search, x, condition)
    return Excitation(
        reference=reference,
        motion=motion,
        torque=final.torque(motion),
        margins=margins,
        condition=condition,
        inertial_condition=condition_number(inertial),
        names=model.names,
        separated=None if separator is None else separator(few, inertial),
        evaluations=search.evaluations,
        feasible=search.feasible,
        seconds=seconds,
        left_out=() if final.collision is None else final.collision.left_out,
        checker=final,
    )


class Prepared(NamedTuple):
    """A search that has not begun, with the limits that its result has to keep at every sample."""

    arm: NominalArm
    plan: ExcitationPlan
    search: TrajectorySearch
    final: Checker
    separator: Separator | None
    body: RigidBody


def prepare(
    arm: NominalArm,
    plan: ExcitationPlan,
    limits: LimitPlan,
    progress: Callable[[float, float], None] = lambda share, best: None,
    separator: Separator | None = None,
    body: RigidBody | None = None,
) -> Prepared:
    """Set up the search of ``design``.

    Args:
        arm: the nominal arm.
        plan: what to look for, and how.
        limits: what to keep.
        progress: called with the share of the budget spent [1] and the best value so far, or infinity.
        separator: separates what criterion ``separation`` is about; by default effects of typical size.
        body: the arm's rigid bodies if they are not the nominal ones, as with a known payload.

    Raises:
        InputError: the limits allow no trajectory.
    """
    body = RigidBody(arm) if body is None else body
    allowed, collision = limits.allowed(arm, body), limits.collision(arm, body)
    final = Checker(arm, body, allowed, collision)
    final.check_static(_postures(allowed.motion))
    samples = SAMPLES
    if separator is not None:
        # a given separator predicts over time, which takes a rate of its own
        samples = int(np.ceil(plan.length * SEPARATING_RATE)) + 1
    elif plan.effects:
        separator = separator_of(arm, body, plan.effects)
    # tighter than the final limits, for what lies between the samples of the search
    tight = replace(
        allowed,
        torque=allowed.torque * (1 - TIGHTER["torque"]),
        singular=allowed.singular * (1 + TIGHTER["singular"]),
        clearance=allowed.clearance + TIGHTER["clearance"],
    )
    near = None if collision is None else collision.nearby(tight.clearance)
    separating = plan.criterion == "separation"
    search = TrajectorySearch(
        parametrisation=Parametrisation(plan.family(arm.n_joints), allowed.motion),
        model=ExcitationModel(arm, body, () if separating else JOINT_COLUMNS),
        criterion=CRITERIA["condition" if separating else plan.criterion],
        checker=Checker(arm, body, tight, near),
        budget=plan.budget,
        separator=separator if separating else None,
        progress=progress,
        samples=samples,
    )
    return Prepared(arm, plan, search, final, separator, body)


def accept(
    search: TrajectorySearch, final: Checker, plan: ExcitationPlan
) -> tuple[np.ndarray, ReferenceMotion, tuple[Margin, ...]]:
    """The best candidate of a search that keeps the final limits at every sample: numbers, trajectory and margins.

    Raises:
        InputError: there is none.
    """
    # limits hold between the samples of the plan, too
    parts = int(np.ceil(CHECKED_RATE / plan.rate))
    broken = search.hardest
    # the search samples coarsely: those that it kept are checked finely, best first
    for found in search.found[::-1]:
        reference = search.parametrisation.reference(found.x)
        # what a controller makes of the samples that are written
        written = Sampled(sampled(reference, plan.length, plan.rate))
        motion = sampled(written, written.duration, plan.rate * parts)
        margins = final.margins(motion, final.torque(motion))
        slow = final.margin_when_slow(motion, SLOW)
        broken_here = tuple(m.name for m in (*margins, slow) if not m.spares)
        if not broken_here:
            return found.x, reference, margins
        broken = broken_here
    problem = f"none of {search.judged} candidates keeps all limits; broken most: {', '.join(broken)}"
    if search.found:
        problem = f"the best candidates break {', '.join(broken)} between the samples of the search"
    postures = _postures(final.allowed.motion)
    remedies = [final.remedy(name, postures) for name in broken]
    raise InputError(
        f"no trajectory within the limits was found: {problem}",
        "; ".join([*remedies, "or allow more evaluations"]),
        where="limits",
    )


def sampled(reference: ReferenceMotion, duration: float, rate: float) -> Motion:
    """Samples of a reference at a rate [Hz], from its start to the first sample at or after its end [s]."""
    # the small number keeps rounding from adding a sample
    last = int(np.ceil(duration * rate - 1e-9))
    return motion_of(reference, np.arange(last + 1) / rate)


def _postures(limits: Limits) -> np.ndarray:
    """Random postures within the limits of position, shape (STATES, n)."""
    shape = (STATES, len(limits.lower))
    return np.random.default_rng(0).uniform(limits.lower, limits.upper, shape)
