"""Models of an arm, evaluated by how well the arm is tracked with them."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from math import isfinite, nan
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import binomtest, spearmanr, trim_mean

from gapscope.agents.models import AgentModel, ArmModel, Candidate, Gravity
from gapscope.agents.tracking import (
    AgentController,
    ComputedTorque,
    Feedforward,
    SampledReference,
    TrackingMetrics,
    Tuning,
    largest_factor,
    settles,
    track,
)
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.motions.named_motions import (
    Workspace,
    check_motion_name,
    draw_motion,
    workspace,
)
from gapscope.arm.motions.trajectory import ReferenceMotion
from gapscope.arm.nearest_name import check_known
from gapscope.arm.nominal import NominalArm
from gapscope.arm.root_mean_square import rms
from gapscope.diagnosis.prepare import Progress, silent
from gapscope.effects.applied import AppliedEffect, push
from gapscope.effects.arm_scale import ArmScale
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.effect import External
from gapscope.envs.arguments import check_values
from gapscope.envs.engines import check_engine, default_engine
from gapscope.envs.environment import TIME_STEP
from gapscope.envs.position_controller import loop_inertia
from gapscope.envs.simulated_arm import SimulatedArm
from gapscope.model.conditioning import torque_scale

DISTURBANCES = ("none", "push", "noise")
"""``push``: a force on the tool; ``noise``: white noise on the encoders."""
FORCE = 0.3
"""Force of a push, as a share of the weight that the arm may carry [1]."""
START, LENGTH = 0.4, 0.2
"""A push begins at this share of a motion [1], and lasts so long [s]."""
NOISE = 1e-4
"""Standard deviation of the encoders' noise [rad]."""


def disturbance(
    name: str, rng: np.random.Generator, scale: ArmScale, duration: float
) -> tuple[tuple[AppliedEffect, ...], float]:
    """Effects and encoders' noise [rad] of a motion of ``duration`` [s]; a push comes from any direction."""
    if name != "push":
        return (), NOISE * (name == "noise")
    # three normal numbers prefer no direction in space
    direction = rng.standard_normal(3)
    start = START * duration
    force = FORCE * 9.81 * scale.lift * direction / np.linalg.norm(direction)
    return (push(force, start, start + LENGTH),), 0.0


LAWS = ("feedforward", "computed")
"""``gapscope.agents.tracking.Feedforward`` and ``gapscope.agents.tracking.ComputedTorque``."""
MOTIONS = ("fourier", "pick", "place", "weld_seam")
"""Motions by default."""


@dataclass(frozen=True)
class EvaluationPlan:
    """How models are evaluated.

    Attributes:
        motions, disturbances: names; each model does each of them.
        seeds: of the motions.
        engines: that simulate the arm.
        duration: of a motion [s].
        tuning: bandwidth and damping of the loop, on the nominal arm's inertia.
        law: one of ``LAWS``.

    Raises:
        InputError: a name that is not known, or nothing to do.
    """

    motions: tuple[str, ...] = MOTIONS
    disturbances: tuple[str, ...] = ("none", "push")
    seeds: tuple[int, ...] = (0, 1, 2)
    engines: tuple[str, ...] = field(default_factory=lambda: (default_engine(),))
    duration: float = 4.0
    tuning: Tuning = Tuning()  # noqa: RUF009 (it is frozen)
    law: str = "feedforward"

    def __post_init__(self) -> None:
        """Check names and numbers."""
        check_known("law", self.law, LAWS, where="law")
        check_values(vars(self), "environment", "evaluation")
        for engine in self.engines:
            check_engine(engine)
        for name in self.disturbances:
            check_known("disturbance", name, DISTURBANCES, where="disturbances")


Episode = Mapping[str, Any]
"""One model on one motion: ``model``, ``engine``, ``motion``, ``disturbance``, ``seed``, the measures of
``gapscope.agents.tracking.TrackingMetrics``, and ``torque_error``, the NRMSE of the model's feedforward against the
torque that the motion needs, mean over joints [1]."""
Cell = Callable[[tuple[str, ...], Candidate, Callable[[], Any]], Any]
"""What a cell of an evaluation holds, by its key and its model: what is kept of it, or what is computed now."""


HELD_OUT = 0x6A95
"""Motions come from seeds behind this number, so that no recording has the same."""


def held_out_motion(
    name: str, seed: int, space: Workspace, duration: float
) -> ReferenceMotion:
    """A motion of ``duration`` [s] that no training and no recording has."""
    # each usual motion draws from numbers of its own, whatever else is planned
    number = MOTIONS.index(name) if name in MOTIONS else 99
    rng = np.random.default_rng((HELD_OUT, number, seed))
    return draw_motion(name, rng, space, duration)


MARGIN_TIME = 1.5
"""Length of the motion on which gains are raised [s]."""
POSTURE_TICKS = 50
"""Ticks between the postures of a motion at which gains are checked."""


class TrackingBench:
    """An arm with hidden effects, on which models are tried.

    Args:
        arm: the nominal arm, whose inertia the gains are computed with.
        effects: what the arm that is tracked has beyond it.
        plan: how to evaluate.

    Raises:
        InputError: a motion that this arm cannot follow, or a disturbance or effect that it cannot have.
    """

    def __init__(
        self, arm: NominalArm, effects: tuple[AppliedEffect, ...], plan: EvaluationPlan
    ) -> None:
        self.arm, self.effects, self.plan = arm, effects, plan
        for name in plan.motions:
            check_motion_name(name, arm.n_joints)
        forced = any(isinstance(e.effect, External) for e in effects)
        if "push" in plan.disturbances and forced:
            raise InputError(
                "the arm has an external force already",
                "leave out push",
                where="disturbances",
            )
        body = RigidBody(arm)
        self.space = workspace(body)
        self._metrics = TrackingMetrics(arm, body, self.space)
        self._scale = ArmScale.of(arm)
        # the arm as it is: what a perfect model would command
        self._truth = ArmModel(CorrectedArm(arm, effects))
        self._courses: dict[tuple[str, int], tuple[SampledReference, np.ndarray]] = {}
        self._margins: dict[str, float] = {}
        every = itertools.product(plan.motions, plan.seeds)
        # all motions are drawn here: one that cannot be followed stops the plan at once
        courses = [self.course(motion, seed)[0] for motion, seed in every]
        along = np.vstack([course.motion.q[::POSTURE_TICKS] for course in courses])
        posture, tuning = self.space.posture, plan.tuning
        # stable along all motions of the plan
        self._inertia = loop_inertia(
            arm, posture, tuning.bandwidth, along, tuning.damping
        )

    def controller(
        self,
        model: Candidate,
        tuning: Tuning | None = None,
        limited: bool = True,
    ) -> Feedforward:
        """The controller of the plan's law with a model, or that of an agent.

        Args:
            model: the model, an agent, or ``None``.
            tuning: by default that of the plan.
            limited: whether the torque is clipped at the arm's limit.

        Raises:
            InputError: computed torque with an agent, or without a model that has inertia.
        """
        tuning = tuning or self.plan.tuning
        limit = self._metrics.limit
        if not limited:
            limit = np.full(self.arm.n_joints, np.inf)
        outside = self.plan.law == "feedforward"
        # on the inertia of the nominal arm: the same loop for every model
        loop = tuning.gains(self._inertia)
        if isinstance(model, AgentModel):
            if not outside:
                raise InputError(
                    "an agent acts beside feedforward", "leave it out", where="law"
                )
            return AgentController(loop, limit, model)
        if outside:
            return Feedforward(loop, limit, model)
        if model is None or isinstance(model, Gravity):
            raise InputError(
                "computed torque needs a model with inertia",
                "leave out pd and gravity",
                where="law",
            )
        return ComputedTorque(tuning, limit, model)

    def course(self, motion: str, seed: int) -> tuple[SampledReference, np.ndarray]:
        """A held-out motion, and the torque that must be commanded for it [N m], (N, n)."""
        key = (motion, seed)
        if key not in self._courses:
            how = self.space, self.plan.duration
            reference = held_out_motion(motion, seed, *how)
            course = SampledReference.of(reference, self.plan.duration, TIME_STEP)
            self._courses[key] = course, self._truth.series(course.motion)
        return self._courses[key]

    def torque_error(self, model: Candidate, motion: str, seed: int) -> float:
        """NRMSE of a model's feedforward [1]: RMS over the torque's spread per joint, as for the gap; mean of them.

        Of an agent it is that of the model that it acts on.
        """
        if isinstance(model, AgentModel):
            model = model.model
        course, needed = self.course(motion, seed)
        # what is tracked: neither the settling before nor the look-ahead beyond it
        rows = slice(course.first, course.ticks)
        # PD alone plans nothing: its error is all that the motion needs
        planned = np.zeros_like(needed)
        if model is not None:
            planned = model.series(course.motion)
        error = rms((planned - needed)[rows])
        return float(np.mean(error / torque_scale(needed[rows])))

    def episodes(
        self, name: str, model: Candidate, engine: str, seed: int
    ) -> list[Episode]:
        """All motions and disturbances of the plan with one model, engine and seed."""
        plan = self.plan
        rows: list[Episode] = []
        controller = self.controller(model)
        for motion in plan.motions:
            course, _ = self.course(motion, seed)
            # planned once: no model knows a disturbance beforehand
            course = course.planned(controller)
            error = self.torque_error(model, motion, seed)
            for number, kind in enumerate(plan.disturbances):
                # every model meets the same disturbance
                rng = np.random.default_rng((HELD_OUT, seed, number))
                extra = disturbance(kind, rng, self._scale, plan.duration)
                with self._simulated(engine, *extra, rng) as simulated:
                    run = track(simulated, controller, course)
                row = {
                    "model": name,
                    "engine": engine,
                    "motion": motion,
                    "disturbance": kind,
                    "seed": seed,
                    "torque_error": error,
                }
                rows.append(row | self._metrics(run, TIME_STEP, plan.duration))
        return rows

    def margin(self, model: Candidate, engine: str) -> float:
        """Largest bandwidth at which the loop stays stable on a held-out motion [Hz].

        See ``gapscope.agents.tracking``. Without torque limits, so that what is unstable grows. A model that feeds
        torque forward is outside the loop: all of them share one search, with the torque that the arm needs.
        """
        if self.plan.law == "feedforward" and not isinstance(model, AgentModel):
            if engine not in self._margins:
                self._margins[engine] = self._largest_bandwidth(self._truth, engine)
            return self._margins[engine]
        return self._largest_bandwidth(model, engine)

    def _largest_bandwidth(self, model: Candidate, engine: str) -> float:
        rng = np.random.default_rng(HELD_OUT)
        reference = draw_motion("fourier", rng, self.space, MARGIN_TIME)
        # no settling: a kick would be forgotten before the arm moves
        course = SampledReference.of(reference, MARGIN_TIME, TIME_STEP, settle=0.0)
        needed = self._truth.series(course.motion)
        # what is planned does not depend on the gains: one plan for all of them
        course = course.planned(self.controller(model))
        tuning = self.plan.tuning
        with self._simulated(engine) as simulated:

            def stable(factor: float) -> bool:
                controller = self.controller(model, tuning.times(factor), limited=False)
                return settles(simulated, controller, course, needed)

            return tuning.bandwidth * largest_factor(stable)

    def _simulated(
        self,
        engine: str,
        extra: tuple[AppliedEffect, ...] = (),
        noise: float = 0.0,
        rng: np.random.Generator | None = None,
    ) -> SimulatedArm:
        effects, step = (*self.effects, *extra), self.arm.encoder_step or 0.0
        return SimulatedArm(
            self.arm,
            effects,
            TIME_STEP,
            engine=engine,
            encoder_step=step,
            encoder_noise=noise,
            rng=rng,
        )


def evaluate(
    models: Mapping[str, Candidate],
    bench: TrackingBench,
    progress: Progress = silent,
    cell: Cell = lambda key, model, compute: compute(),
) -> tuple[list[Episode], dict[tuple[str, str], float]]:
    """Track with every model of ``models`` and raise its gains.

    Returns an episode per model, engine, motion, disturbance and seed, and by model and engine the largest stable
    bandwidth [Hz].

    Args:
        models: models and agents by name; ``None`` is PD alone.
        bench: the arm and the plan.
        progress: called with a short message before each piece of work.
        cell: gives back what is kept of a piece of work, or computes it.
    """
    episodes = []
    margins = {}
    for model in models.values():
        bench.controller(model)  # raises before any work is done
    for engine in bench.plan.engines:
        for number, (name, model) in enumerate(models.items(), 1):
            which = f"{engine}, {name} ({number} of {len(models)})"
            for seed in bench.plan.seeds:
                progress(f"{which}: tracks, seed {seed}")
                compute = partial(bench.episodes, name, model, engine, seed)
                # kept by seed: an evaluation that was stopped goes on where it was
                key = ("episodes", name, engine, str(seed))
                episodes += cell(key, model, compute)
            progress(f"{which}: raises the gains")
            find = partial(bench.margin, model, engine)
            margins[name, engine] = cell(("margin", name, engine), model, find)
    return episodes, margins


# An evaluation in figures: means that outliers do not carry away, and how torque and tracking error go together.


LEVEL = 0.95
"""Coverage of the intervals [1]."""
DRAWS = 2000
"""Bootstrap draws."""


def mean_of(
    values: Sequence[float],
    strata: Sequence[Hashable],
    rng: np.random.Generator,
) -> dict[str, float]:
    """Interquartile mean with the percentile interval of a stratified bootstrap.

    A quarter of the values, rounded down, is left out at both ends; infinite ones count as the largest (agarwal2021).
    Runs are drawn with replacement within each stratum, so that every motion keeps its weight (agarwal2021). With
    one run per stratum the interval is the value. All three, ``value``, ``low`` and ``high``, are in the unit of the
    values, infinite if too many runs diverged, and NaN without values.

    Args:
        values: of the runs.
        strata: what they are drawn within, one per value, such as the motion.
        rng: source of the draws.
    """
    if not len(values):
        return dict.fromkeys(("value", "low", "high"), nan)
    array = np.asarray(values, dtype=float)
    places_of: dict[Hashable, list[int]] = {}
    for place, stratum in enumerate(strata):
        places_of.setdefault(stratum, []).append(place)
    # one column for each draw: places of all strata together, (N, draws)
    drawn = []
    for places in places_of.values():
        count = len(places)
        drawn.append(np.array(places)[rng.integers(count, size=(count, DRAWS))])
    resampled = trim_mean(array[np.concatenate(drawn)], 0.25)
    tails = [(1 - LEVEL) / 2, (1 + LEVEL) / 2]
    # a value that was drawn: infinite ones cannot be interpolated
    low, high = np.quantile(resampled, tails, method="nearest")
    value = float(trim_mean(array, 0.25))
    return {"value": value, "low": float(low), "high": float(high)}


SEED = 20
"""Of the bootstrap: the same episodes give the same intervals."""
MEASURES = ("joint_error", "tool_error", "reward", "torque_rate", "torque_error")
"""Measures of an episode that are summarised."""


Line = Mapping[str, Any]
"""Summary of one ``model`` in one ``engine`` under one ``disturbance``: how many ``episodes``, how many of them
``diverged`` (``count``, and its Wilson interval ``low`` to ``high`` [1]), the largest stable bandwidth ``margin`` [Hz]
or ``None`` if it was not sought, and by measure the mean over seeds and motions, see ``mean_of``."""


def summarise(
    episodes: Sequence[Episode], margins: Mapping[tuple[str, str], float]
) -> list[Line]:
    """A line per disturbance, engine and model, the models in the order in which they were tried."""
    rows = pd.DataFrame(episodes)
    lines: list[Line] = []
    for kind in rows["disturbance"].unique():
        own = rows[rows["disturbance"] == kind]
        for (model, engine), group in own.groupby(["model", "engine"], sort=False):
            count = int(group["diverged"].sum())
            # Wilson's interval says something even if none of a few runs diverged
            low, high = binomtest(count, len(group)).proportion_ci(method="wilson")
            line = {
                "model": model,
                "engine": engine,
                "disturbance": kind,
                "episodes": len(group),
                "diverged": {"count": count, "low": low, "high": high},
                "margin": margins.get((model, engine)),
            }
            for name in MEASURES:
                # the same draws for each measure: they differ by values alone
                rng = np.random.default_rng(SEED)
                motions = group["motion"].tolist()
                line[name] = mean_of(group[name].tolist(), motions, rng)
            lines.append(line)
    return lines


def relation(lines: Sequence[Line]) -> float | None:
    """Spearman's correlation over models and engines of torque error and joint error [1].

    Of the first disturbance alone; ``None`` for fewer than three values, or equal ones.
    """
    first = [line for line in lines if line["disturbance"] == lines[0]["disturbance"]]
    # a model that diverged has no error to be ranked by
    known = [line for line in first if isfinite(line["joint_error"]["value"])]
    torque, joint = (
        [line[name]["value"] for line in known]
        for name in ("torque_error", "joint_error")
    )
    # a rank needs values that differ
    if len(known) < 3 or len(set(torque)) == 1 or len(set(joint)) == 1:
        return None
    return float(spearmanr(torque, joint).statistic)
