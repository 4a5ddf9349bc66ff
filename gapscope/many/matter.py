"""What matters for a task: each effect on alone and off alone in the simulator, under a controller or policy."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from math import inf, nan
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import norm

from gapscope.agents.evaluation import EvaluationPlan, TrackingBench
from gapscope.agents.models import AgentModel, ArmModel
from gapscope.agents.tracking import Tuning
from gapscope.arm.case import Case
from gapscope.arm.controller import Controller
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import GapscopeError, InputError, extra
from gapscope.arm.input_file import is_folder
from gapscope.arm.io.json_file import plain
from gapscope.arm.io.load_recording import load_recording
from gapscope.arm.io.log import open_log
from gapscope.arm.motions.named_motions import workspace
from gapscope.arm.motions.trajectory import read_sampled
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording
from gapscope.diagnosis.compare_units import read_ranges
from gapscope.diagnosis.prepare import Progress, silent
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected import CorrectedArm
from gapscope.envs.actions import control
from gapscope.envs.effect_ranges import Z95, EffectRange
from gapscope.envs.engines import check_engine
from gapscope.envs.environment import LOOK_AHEAD, SUB_STEPS, TIME_STEP
from gapscope.envs.position_controller import position_controller
from gapscope.envs.replay import replay
from gapscope.interface.models import Model, case_of, corrected_arm
from gapscope.interface.result import DocumentResult
from gapscope.many.workers import LOCAL, in_order
from gapscope.reports.matter import sentence, summary, write_page

Effects = tuple[AppliedEffect, ...]
Task = tuple[Recording, Controller] | tuple[Path, tuple[str, Sequence[str]]]
"""A reference with its controller; or a policy's file or folder, with the kind of its actions and its motions."""
MEASURES = ("error", "reward", "success")
"""RMS tracking error over time and joints [rad], mean reward of an action [1], whether the arm did not diverge [1]."""
INTERVAL = norm.cdf([-Z95, 0.0, Z95])
"""Quantiles over seeds and values drawn: 95 % and the middle."""


def read_task(
    task: str | Path | Recording, case: Case, action: str, motions: Sequence[str]
) -> Task:
    """What the arm is to do.

    Args:
        task: a reference to follow, as a recording or a file with t, q1.. (of one with q_ref1.. those, as of what
            ``gapscope excite`` writes); a policy as ONNX; or the folder of a trained agent.
        case: whose controller follows the reference; one with gains that fit the arm if it has none.
        action: kind of a policy's actions, ``gapscope.envs.actions.ACTION_KINDS``.
        motions: that a policy tracks.

    Raises:
        InputError: the file cannot be used.
    """
    if not isinstance(task, Recording):
        path = Path(task)
        if is_folder(path) or path.suffix == ".onnx":
            return path, (action, motions)
        # a plan may hold no more than t and q, or, as gapscope excite writes it, references with accelerations
        columns = open_log(path).tables[0].columns
        if "ddq_ref1" in columns and "q1" not in columns:
            plan = read_sampled(path, case.arm.n_joints).motion
            task = Recording(path.name, plan.t, plan.q, q_ref=plan.q, dq_ref=plan.dq)
        else:
            task = load_recording(path, case.arm, case.importing, every_row=True)
    # the plan where there is one: what was recorded holds the errors of its arm
    q, dq = task.q_ref, task.dq_ref
    if q is None:
        q, dq = task.q, task.dq
    known = case.controller or position_controller(case.arm, q[len(q) // 2], along=q)
    return replace(task, q=q, dq=None, tau=None, q_ref=q, dq_ref=dq), known


def read_policy(path: Path, action: str, arm: NominalArm) -> AgentModel:
    """A trained agent, or a policy of the environment's observations as ONNX beside the nominal arm's feedforward.

    Raises:
        InputError: it is no policy for this arm, or a package is missing.
    """
    if is_folder(path):
        # only if it is asked for: this brings torch
        from gapscope.agents.training.policy import read_agent_model

        return read_agent_model(path, arm)
    with extra("learn", "a policy as ONNX"):
        from onnx.reference import ReferenceEvaluator
    try:
        network = ReferenceEvaluator(str(path))
    except Exception as error:
        raise InputError(
            f"is no ONNX model ({error})", "export the policy again", file=path
        ) from None
    # one input: the observation
    (name, *_) = network.input_names

    def policy(observation: np.ndarray) -> np.ndarray:
        # one observation as a batch, in the precision of networks
        rows = np.asarray(observation, dtype=np.float32)[None]
        (found, *_) = network.run(None, {name: rows})
        return np.asarray(found[0], dtype=float)

    body = RigidBody(arm)
    return AgentModel(
        policy=policy,
        model=ArmModel(CorrectedArm(arm)),
        control=control(arm, body, workspace(body), action, None, Tuning().bandwidth),
        look_ahead=LOOK_AHEAD,
        period=TIME_STEP * SUB_STEPS,
        digest="",
    )


def carried_out(
    arm: NominalArm, effects: Effects, task: Task, seed: int, engine: str
) -> tuple[float, float, float]:
    """``MEASURES`` of the task, done by an arm with effects.

    Args:
        arm: the nominal arm, which the controller believes in.
        effects: what is switched on.
        task: see ``read_task``.
        seed: of a policy's motions.
        engine: that simulates.
    """
    goal, means = task
    if isinstance(means, Controller):
        assert isinstance(goal, Recording)
        try:
            rmse = replay(arm, effects, goal, means, engine=engine).rmse
        # a wrong input stops the run; any other error is an arm that diverged
        except InputError:
            raise
        except GapscopeError:
            return inf, nan, 0.0
        return float(np.sqrt(np.mean(rmse**2))), nan, 1.0
    assert isinstance(goal, Path)
    action, motions = means
    # undisturbed: what changes is due to the effects
    plan = EvaluationPlan(tuple(motions), ("none",), (seed,), (engine,))
    policy = read_policy(goal, action, arm)
    rows = TrackingBench(arm, effects, plan).episodes("", policy, engine, seed)
    keys = ("joint_error", "reward", "diverged")
    error, reward, diverged = np.mean([[row[k] for k in keys] for row in rows], axis=0)
    return float(error), float(reward), float(1.0 - diverged)


def matter(
    case: Case | str | Path,
    task: str | Path | Recording,
    *,
    model: Model = None,
    diagnosis: str | Path | None = None,
    seeds: int = 5,
    action: str = "residual",
    motions: Sequence[str] = ("fourier",),
    engine: str | None = None,
    jobs: int = 1,
    progress: Progress = silent,
) -> DocumentResult:
    """Rank the effects found by what they do to a task: each alone on the nominal arm, and all others without it.

    An effect matters by the mean of both changes of the tracking error. A force from outside is left out: it belongs to
    its recording.

    Args:
        case: the case, or its folder.
        task: a reference, which the case's controller follows; a policy as ONNX; or a trained agent's folder.
        model: corrected arm, effects, or ``corrected.yaml``.
        diagnosis: folder of a diagnosis instead: its effects, and values drawn within their 95 % intervals.
        seeds: of a policy's motions, and of the values that are drawn.
        action: kind of an ONNX policy's actions.
        motions: that a policy tracks, as of ``gapscope evaluate``.
        engine: ``pybullet`` or ``mujoco``.
        jobs: simulations at a time.
        progress: called with a few words at each step.

    Raises:
        InputError: case, task or effects cannot be used.

    Examples:
        >>> import gapscope
        >>> gapscope.matter("my_arm", "task.csv", diagnosis="out")  # doctest: +SKIP
    """
    if model is not None and diagnosis is not None:
        raise InputError(
            "--model and --diagnosis both say what was found",
            "give one of them: values of a diagnosis are drawn, those of a model are not",
            where="--model",
        )
    # checked first: simulations may take long
    loaded, engine = case_of(case), check_engine(engine)
    file = None if diagnosis is None else Path(diagnosis) / "corrected.yaml"
    corrected = corrected_arm(loaded.arm, model if file is None else file)
    states, arm = corrected.states, corrected.arm
    # as the arm was at the end
    found = states[-1].effects if states else corrected.effects
    lasting = replace(corrected, effects=found).lasting.effects
    if not lasting:
        raise InputError(
            "no effect was found that could matter",
            "give --model corrected.yaml or --diagnosis DIR with effects",
        )
    # without a diagnosis each value is drawn as it is
    ranges = tuple(EffectRange(e, e) for e in lasting)
    if file is not None:
        ranges = read_ranges(file, replace(corrected, effects=lasting), ()).ranges
    asked = read_task(task, loaded, action, motions)
    # without a policy's motions or intervals all seeds are the same
    count = seeds if file or isinstance(asked[0], Path) else 1
    calls = []
    for seed in range(count):
        rng = np.random.default_rng(seed)
        # the same values on all arms of a seed: changes are due to the switch alone
        drawn = tuple(one.draw(rng) for one in ranges)
        alone = [(one,) for one in drawn]
        without = [tuple(e for e in drawn if e is not one) for one in drawn]
        # in this order results are taken apart again
        switched = [(), drawn, *alone, *without]
        calls += [(arm, effects, asked, seed, engine) for effects in switched]
    results = []
    for result in in_order(carried_out, calls, jobs, LOCAL):
        if isinstance(result, Exception):
            # a missing result would shift all that follow
            raise result
        results.append(result)
        progress(f"{len(results)} of {len(calls)} simulations")
    # seeds, arms (nominal, all, each alone, all but each), measures
    values = np.reshape(results, (count, -1, len(MEASURES)))
    content = {
        "schema": 1,
        "case": loaded.name,
        "task": asked[0].name,
        "engine": engine,
        "seeds": count,
        "nominal": _measured(values[:, 0]),
        "all": _measured(values[:, 1]),
        "rows": sorted(_rows(ranges, values), key=lambda row: -row["matters"]["value"]),
    }
    content["summary"] = sentence(content)
    document = plain(content, null_if_not_finite=True)
    return DocumentResult("matter", document, summary, itemgetter("rows"), write_page)


def _interval(values: np.ndarray) -> dict[str, float]:
    """Median and 95 % of values over seeds; infinite ones cannot be interpolated."""
    low, middle, high = np.quantile(values, INTERVAL, method="nearest")
    return {"value": middle, "low": low, "high": high}


def _measured(values: np.ndarray) -> dict[str, Any]:
    """The measures of an arm over seeds, (S, 3)."""
    return {key: _interval(x) for key, x in zip(MEASURES, values.T, strict=True)}


def _rows(
    ranges: Sequence[EffectRange], values: np.ndarray
) -> Iterator[dict[str, Any]]:
    """A row for each effect."""
    # arms first: nominal, all, each alone, all but each
    nominal, every, *others = np.moveaxis(values, 1, 0)
    alone, without = others[: len(ranges)], others[len(ranges) :]
    for one, on, off in zip(ranges, alone, without, strict=True):
        # two arms that both diverge give inf - inf: that counts as no change
        with np.errstate(invalid="ignore"):
            changes = np.abs([on - nominal, every - off])[..., 0].mean(axis=0)
        yield {
            "effect": one.low.name,
            "joints": one.low.joints,
            "matters": _interval(np.nan_to_num(changes, posinf=inf)),
            "alone": _measured(on),
            "without": _measured(off),
            "range": {
                p.name: {
                    "unit": p.unit,
                    "low": one.low.parameters[p.name],
                    "high": one.high.parameters[p.name],
                }
                for p in map(one.low.effect.parameter, one.high.given)
            },
        }
