"""From an arm and a plan to the best trajectory found, checked at every sample."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.motions.motion import Motion
from gapscope.arm.motions.sampled import Sampled
from gapscope.arm.motions.trajectory import Limits, ReferenceMotion
from gapscope.arm.nominal import NominalArm
from gapscope.ident.excitation.binding_limit import check_condition
from gapscope.ident.excitation.candidate_model import ExcitationModel
from gapscope.ident.excitation.criteria import CRITERIA, condition_number
from gapscope.ident.excitation.excitation_plan import (
    OPTIMISERS,
    ExcitationPlan,
    LimitPlan,
)
from gapscope.ident.excitation.limits import Checker, Margin
from gapscope.ident.excitation.separation import Separated, Separator, Signatures
from gapscope.ident.excitation.trajectory_parametrisation import Parametrisation
from gapscope.ident.excitation.trajectory_search import SAMPLES, TrajectorySearch
from gapscope.ident.excitation.written_check import CHECKED_RATE

SLOW = 0.2
"""Speed of the version of a trajectory that is run first, as a share of its own [1]."""
TIGHTER = {"torque": 0.01, "singular": 0.1, "clearance": 0.01}
"""By how much the limits are tighter in the search: share, share, m."""
TRIES = 20
"""Candidates that are checked at every sample, the best first, before giving up."""
JUDGED = 2000
"""Most samples on which condition number and separation are stated."""
SEPARATING_RATE = 50.0
"""Samples per second of a candidate that is scored by predictions over time [Hz]."""
POSTURES = 300
"""Random postures on which it is checked that limits allow any at all."""


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


def design(
    arm: NominalArm,
    plan: ExcitationPlan,
    limits: LimitPlan,
    rng: np.random.Generator,
    progress: Callable[[float, float], None] = lambda share, best: None,
    separator: Separator | None = None,
    body: RigidBody | None = None,
) -> Excitation:
    """Look for the trajectory that excites an arm best.

    Args:
        arm: the nominal arm.
        plan: what to look for, and how.
        limits: what to keep.
        rng: source of candidates; with a budget of evaluations alone the same seed gives the same trajectory.
        progress: called with the share of the budget spent [1] and the best value so far, or infinity.
        separator: separates what criterion ``separation`` is about; by default effects of typical size.
        body: the arm's rigid bodies if they are not the nominal ones, as with a known payload.

    Raises:
        InputError: the limits allow no trajectory, none was found within the budget, or the best shows no parameter.

    Warns:
        ModelWarning: the condition number exceeds 1000; not if effects are to be separated.
    """
    prepared = prepare(arm, plan, limits, progress, separator, body)
    begun = time.monotonic()
    OPTIMISERS[plan.method]().run(prepared.search, rng)
    seconds = time.monotonic() - begun
    accepted = accept(prepared.search, prepared.final, plan)
    found = _result(arm, plan, prepared, accepted, seconds)
    if plan.criterion != "separation":
        check_condition(prepared.search, accepted.x, found.condition)
    return found


class Prepared(NamedTuple):
    """A search that has not begun, with the limits that its result has to keep at every sample."""

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
    """Set up the search of ``design``, with the same arguments.

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
    elif len(plan.effects) > 1:
        separator = Signatures(arm, body, plan.effects)
    # tighter than the final limits, for what lies between the samples of the search
    tight = allowed.tightened(**TIGHTER)
    near = None if collision is None else collision.nearby(tight.clearance)
    separating = plan.criterion == "separation"
    search = TrajectorySearch(
        parametrisation=Parametrisation(plan.family(arm.n_joints), allowed.motion),
        model=ExcitationModel(arm, body, () if separating else plan.columns),
        criterion=CRITERIA["condition" if separating else plan.criterion],
        checker=Checker(arm, body, tight, near),
        budget=plan.budget,
        signatures=separator if separating else None,
        progress=progress,
        samples=samples,
    )
    return Prepared(
        search=search,
        final=final,
        separator=separator,
        body=body,
    )


class Accepted(NamedTuple):
    """A candidate that keeps all limits at every sample: its numbers, its trajectory, and its margins."""

    x: np.ndarray
    reference: ReferenceMotion
    margins: tuple[Margin, ...]


def accept(search: TrajectorySearch, final: Checker, plan: ExcitationPlan) -> Accepted:
    """The best candidate of a search that keeps the final limits at every sample.

    Raises:
        InputError: there is none.
    """
    # limits hold between the samples of the plan, too
    parts = int(np.ceil(CHECKED_RATE / plan.rate))
    broken = search.hardest
    # the search samples coarsely: the best few are checked finely, best first
    for found in search.found[: -TRIES - 1 : -1]:
        reference = search.parametrisation.reference(found.x)
        # what a controller makes of the samples that are written
        written = Sampled(sampled(reference, plan.length, plan.rate))
        motion = sampled(written, written.duration, plan.rate * parts)
        margins = final.margins(motion, final.torque(motion))
        slow = final.margin_when_slow(motion, SLOW)
        broken_here = tuple(m.name for m in (*margins, slow) if not m.spares)
        if not broken_here:
            return Accepted(found.x, reference, margins)
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
    t = np.arange(last + 1) / rate
    return Motion(
        t, reference.position(t), reference.velocity(t), reference.acceleration(t)
    )


def _result(
    arm: NominalArm,
    plan: ExcitationPlan,
    prepared: Prepared,
    accepted: Accepted,
    seconds: float,
) -> Excitation:
    """The trajectory with its margins and criteria, at the rate of the plan."""
    search, final, separator, body = prepared
    motion = sampled(accepted.reference, plan.length, plan.rate)
    # criteria of long motions are computed from fewer samples
    step = -(-len(motion.t) // JUDGED)
    few = Motion(
        motion.t[::step], motion.q[::step], motion.dq[::step], motion.ddq[::step]
    )
    model = ExcitationModel(arm, body, plan.columns)
    inertial = ExcitationModel(arm, body, ()).matrix(few)
    return Excitation(
        reference=accepted.reference,
        motion=motion,
        torque=search.model.torque(motion),
        margins=accepted.margins,
        condition=condition_number(model.matrix(few)),
        inertial_condition=condition_number(inertial),
        names=model.names,
        separated=None if separator is None else separator.separate(few, inertial),
        evaluations=search.evaluations,
        feasible=search.feasible,
        seconds=seconds,
        left_out=() if final.collision is None else final.collision.left_out,
        checker=final,
    )


def _postures(limits: Limits) -> np.ndarray:
    """Random postures within the limits of position, shape (POSTURES, n)."""
    shape = (POSTURES, len(limits.lower))
    return np.random.default_rng(0).uniform(limits.lower, limits.upper, shape)
