"""Bias, deviation and coverage of the estimators by Monte Carlo over arms simulated in PyBullet.

Three joints of the KUKA iiwa (1, 2 and 4, the others locked) with rotors and viscous friction follow random
Fourier motions of 10 s, four to fit and two to judge. Positions are filtered at 20 Hz and differentiated, columns and
torque at 12 Hz, one sample of five is kept. Noise is drawn anew in each run, on encoders and torque.

Tables: (1) per estimator and noise level the bias and the standard deviation of the base parameters, both as the
torque that they make, and the RMSE of the torque predicted on the motions to judge; (2) the same with dry friction in
arm and model; (3) coverage of 95 % intervals of the parameters and of the predicted torque, without and with dry
friction, and with one effect in the arm that the model lacks.

Run with ``--runs 100 --consistent 20``, and with ``--runs 0 --consistent 0 --simulating 10`` for the estimators that
simulate, whose draws are their own; ``--arms`` chooses. ``--out FILE.md`` holds the tables so far after each arm.

``--forms 3`` makes another table alone, with three draws of each arm: coverage over arms that pinocchio moves, whose
friction has another form than the law that `gapscope identify` chooses, with and without form error in the intervals.
Bodies are scattered by 20 %. The truth of a friction parameter is what comes closest to the arm's friction on forty
other motions, by least squares in the law that was chosen; of sharp Coulomb friction it is the arm's own.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np
from common import DATA, command_line, markdown
from rich.console import Console
from rich.progress import track

from gapscope.arm.case import Case
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.io.atomic_write import atomic_write
from gapscope.arm.motions.motion import Motion
from gapscope.arm.motions.named_motions import workspace
from gapscope.arm.motions.trajectory import Fourier, motion_of, urdf_limits
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording
from gapscope.arm.robots import load_nominal_arm
from gapscope.arm.root_mean_square import rms
from gapscope.effects.applied import AppliedEffect
from gapscope.envs.position_controller import position_controller
from gapscope.envs.recorder import Plan, record_case
from gapscope.ident.estimators.by_name import method
from gapscope.ident.estimators.linear import (
    Estimator,
    huber,
    maximum_likelihood,
    ordinary_least_squares,
    partial_update,
    ridge,
    total_least_squares,
    truncated_svd,
    weighted_least_squares,
)
from gapscope.ident.estimators.physical import (
    Bodies,
    log_cholesky,
    possible_arm,
    semidefinite,
)
from gapscope.ident.estimators.simulating import (
    Experiment,
    direct_inverse,
    instrumental_variables,
    output_error,
)
from gapscope.ident.identification import (
    FittedParameters,
    IdentificationSettings,
    fit_parameters,
)
from gapscope.ident.intervals import (
    Uncertainty,
    block_jackknife,
    torque_interval,
)
from gapscope.ident.model.base_parameters import BaseParameters, base_parameters
from gapscope.ident.model.regressor import Regressor
from gapscope.ident.samples import Problem
from gapscope.model.conditioning import condition, low_pass

# Arms, noise and problems

RATE, FASTEST, LONG = 250.0, 1.0, 10.0
"""Of recordings [Hz], speed of the joints [rad/s], and length of a motion [s]."""
ENCODER = 1e-3
"""Noise of encoders over that of the torque, which is given as a share of its deviation [rad]."""


def noised(recording: Recording, level: float, rng: np.random.Generator) -> Recording:
    """A recording with the noise of one run."""
    q = recording.q + ENCODER * level * rng.standard_normal(recording.q.shape)
    spread = level * recording.tau.std(axis=0)
    return replace(
        recording,
        q=q,
        tau=recording.tau + spread * rng.standard_normal(recording.tau.shape),
        dq=None,
    )


JOINTS = ("lbr_iiwa_joint_1", "lbr_iiwa_joint_2", "lbr_iiwa_joint_4")
SHEET = {"armature": [0.3, 0.3, 0.2], "viscous": [4.0, 4.0, 2.0]}
COULOMB = {"coulomb": [3.0, 3.5, 2.5]}
"""Dry friction of the arm that has it [N m]."""
LEVELS = (0.01, 0.03, 0.1)
"""Noise: white torque noise over the joint's standard deviation; encoders have ``ENCODER`` times as much [rad]."""
POSITION_CUTOFF, CUTOFF, EVERY = 20.0, 12.0, 5
FIT, JUDGE = 4, 2
TICKS = 4000.0
"""Rate of the controller, and so of the simulation [Hz]: its steps bias rotor inertias by viscous friction times half
a step."""


class World(NamedTuple):
    """A simulated truth.

    Attributes:
        regressor: of the nominal arm, which is the truth but for what ``unmodelled`` adds.
        base: its base parameters.
        fit, judge: recordings without noise.
    """

    regressor: Regressor
    base: BaseParameters
    fit: tuple[Recording, ...]
    judge: tuple[Recording, ...]

    @property
    def truth(self) -> np.ndarray:
        """True base parameters, shape (b,)."""
        return self.base.of(self.regressor.nominal())

    @property
    def prior(self) -> np.ndarray:
        """What a simulated arm would give: bodies 10 % too light, friction and rotors 30 % too large, shape (p,)."""
        count = 10 * self.regressor.arm.n_joints
        nominal = self.regressor.nominal()
        return np.concatenate([nominal[:count] / 1.1, 1.3 * nominal[count:]])

    def noisy(self, level: float, rng: np.random.Generator) -> tuple[Recording, ...]:
        """The recordings to fit with the noise of one run."""
        return tuple(noised(recording, level, rng) for recording in self.fit)

    def problem(self, recordings: tuple[Recording, ...]) -> Problem:
        """Signals conditioned, all p columns and the torque through one filter."""
        parts = []
        for recording in recordings:
            (segment,) = condition(recording, POSITION_CUTOFF)
            matrix = self.regressor.matrix(segment.motion)
            both = np.concatenate([matrix, segment.torque[..., None]], axis=2)
            filtered = low_pass(both.reshape(len(both), -1), RATE, CUTOFF)[
                segment.inner
            ][::EVERY]
            parts.append(filtered.reshape(-1, *both.shape[1:]))
        group = np.repeat(np.arange(len(parts)), [len(part) for part in parts])
        stacked = np.concatenate(parts)
        return Problem(
            stacked[..., :-1],
            stacked[..., -1],
            self.regressor.names,
            group,
            np.full(len(group), EVERY / RATE),
        )

    def reduced(self, problem: Problem) -> Problem:
        """The base columns of a problem."""
        kept = self.base.kept
        names = tuple(np.asarray(problem.names)[kept])
        return Problem(
            problem.matrix[..., kept],
            problem.torque,
            names,
            problem.group,
            problem.interval,
        )

    def experiment(self, recordings: tuple[Recording, ...]) -> Experiment:
        """Noisy recordings and how the simulator repeats them; it starts from weighted least squares."""
        problem = self.reduced(self.problem(recordings))
        start = self.base.nearest(weighted_least_squares(problem).value, self.prior)
        arm = self.regressor.arm
        controller = replace(
            position_controller(arm, workspace(self.regressor.body).posture), rate=TICKS
        )
        build = lambda given: self.reduced(self.problem(tuple(given)))  # noqa: E731
        return Experiment(
            self.regressor, self.base, controller, recordings, build, start
        )


UNMODELLED = {
    "load friction 0.15, joints 2 and 4": AppliedEffect(
        "load_friction", (2, 3), {"coefficient": [0.15, 0.15]}
    ),
    "Stribeck friction 2 N m, all joints": AppliedEffect(
        "stribeck_friction", (1, 2, 3), {"torque": 2.0, "velocity": 0.2}
    ),
    "elasticity 1500 N m/rad, joint 2": AppliedEffect(
        "joint_elasticity", (2,), {"stiffness": [1500.0], "damping": [5.0]}
    ),
}
"""What the arm has and the model lacks; effects count joints among those that move."""


def simulated(effects: tuple[AppliedEffect, ...] = (), dry: bool = False) -> World:
    """Record the true arm, without noise; ``dry`` gives arm and model the friction ``COULOMB``."""
    sheet = {**SHEET, **(COULOMB if dry else {})}
    nominal = load_nominal_arm("kuka_iiwa", joints=JOINTS, sheet=sheet)
    rng = np.random.default_rng(5)
    controller = replace(
        position_controller(nominal, workspace(RigidBody(nominal)).posture), rate=TICKS
    )
    plan = Plan(recordings=1, noise=0.0, rate=RATE, engine="pybullet")

    def recorded() -> Recording:
        case = record_case("truth", nominal, effects, plan, rng, controller=controller)
        return case.recordings[0]

    recordings = [replace(recorded(), name=f"{i + 1}") for i in range(FIT + JUDGE)]
    regressor = Regressor(nominal)
    (segment,) = condition(recordings[0], POSITION_CUTOFF)
    matrix = regressor.matrix(segment.motion)
    base = base_parameters(matrix.reshape(-1, matrix.shape[2]), regressor.names)
    return World(regressor, base, tuple(recordings[:FIT]), tuple(recordings[FIT:]))


# Arms that pinocchio alone moves: bodies off the model's, friction of another form than any law of the model.


FORM_ARMS = {
    "kuka_iiwa": "kuka_iiwa",
    "franka_panda": "franka_panda",
    "xarm6": "xarm6",
    "ur10": DATA / "ur10/ur10.urdf",
    "kinova_gen3": DATA / "kinova_gen3/gen3.urdf",
    "kuka_med7": DATA / "kuka_med7/med7dock.urdf",
}
Form = Callable[[np.ndarray, np.ndarray, np.ndarray, np.ndarray], np.ndarray]
FORMS = {
    "sharp Coulomb": lambda v, q, c, b: c * np.sign(v) + b * v,
    "Stribeck": lambda v, q, c, b: (
        c * (1 + 0.5 * np.exp(-((v / 0.08) ** 2))) * np.sign(v) + b * v
    ),
    "arctan": lambda v, q, c, b: 2 / np.pi * c * np.arctan(v / 0.1) + b * v,
    "square root": lambda v, q, c, b: (c + b * np.sqrt(np.abs(v))) * np.sign(v),
    "over position": lambda v, q, c, b: (
        c * (1 + 0.3 * np.sin(2 * q)) * np.sign(v) + b * v
    ),
    "quadratic": lambda v, q, c, b: c * np.sign(v) + b * v * (1 + 0.5 * np.abs(v)),
}
"""Friction of a joint by speed, position, Coulomb c and viscous b."""


class FormArm(NamedTuple):
    """An arm of n joints: its model, bodies, rotors, Coulomb and viscous friction."""

    model: NominalArm
    bodies: np.ndarray
    rotors: np.ndarray
    coulomb: np.ndarray
    viscous: np.ndarray

    @classmethod
    def drawn(cls, robot: str | Path, rng: np.random.Generator) -> FormArm:
        """Bodies 20 % off the nominal ones, friction 30 % of the weight that a joint carries, within a third."""
        model = load_nominal_arm(robot)
        body, n = RigidBody(model), model.n_joints
        factor = rng.uniform(0.8, 1.25, (n, 1))
        bodies = (body.inertial_parameters().reshape(n, 10) * factor).ravel()
        q = workspace(body).posture + rng.uniform(-1, 1, (50, n))
        weight = np.abs(body.regressor(q, 0 * q, 0 * q) @ bodies).max(axis=0)
        weight = np.maximum(weight, 0.1 * weight.max())
        parts = weight * rng.uniform(0.7, 1.3, (3, n))
        return cls(
            model, bodies, 0.02 + 0.02 * parts[0], 0.3 * parts[1], 0.3 * parts[2]
        )

    def motions(self, rng: np.random.Generator, count: int) -> list[Motion]:
        """Random Fourier motions."""
        body = RigidBody(self.model)
        limits = urdf_limits(body, 6.0)
        limits = limits._replace(velocity=np.minimum(limits.velocity, FASTEST))
        centre, t = workspace(body).posture, np.arange(0, LONG, 1 / RATE)
        how = {"duration": LONG, "centre": centre, "frequency": 1 / LONG}
        return [motion_of(Fourier.random(rng, limits, **how), t) for _ in range(count)]

    def recorded(
        self, form: Form, level: float, motions: list[Motion]
    ) -> tuple[Recording, ...]:
        """Recordings of motions with noise; the torque is pinocchio's."""
        body, rng, out = RigidBody(self.model), np.random.default_rng(0), []
        for k, m in enumerate(motions):
            friction = form(m.dq, m.q, self.coulomb, self.viscous)
            rigid = body.regressor(m.q, m.dq, m.ddq) @ self.bodies
            tau = rigid + self.rotors * m.ddq + friction
            out.append(noised(Recording(f"{k}", m.t, m.q, tau), level, rng))
        return tuple(out)


FORM_LEVELS, OTHERS = (0.001, 0.01, 0.1), 40
"""Noise as above, and motions on which the truth of friction is taken."""


def form_truth(
    arm: FormArm, fitted: FittedParameters, form: str, others: list[Motion]
) -> np.ndarray:
    """True base parameters of what was fitted, (b,)."""
    law = replace(fitted.choice.law, presliding=None)
    names = fitted.columns.names(law)
    q, v = (np.concatenate([getattr(m, x) for m in others]) for x in ("q", "dq"))
    friction = FORMS[form](v, q, arm.coulomb, arm.viscous)
    value = dict(zip(names, arm.bodies, strict=False))
    for j, columns in enumerate(
        np.stack([*law.columns(q, v), v], axis=2).swapaxes(0, 1)
    ):
        shapes = (*law.shapes, "b")
        found = np.linalg.lstsq(
            np.column_stack([columns, np.ones(len(v))]), friction[:, j], rcond=None
        )[0]
        own = dict.fromkeys(shapes, 0.0) | {"c": arm.coulomb[j], "b": arm.viscous[j]}
        if form != "sharp Coulomb":
            own = dict(zip(shapes, found, strict=False))
        value |= {f"{shape}{j + 1}": x for shape, x in own.items()}
        value[f"I{j + 1}"] = arm.rotors[j]
    return fitted.base.of(np.array([value.get(name, 0.0) for name in names]))


def form_coverage(draws: int, path: Path | None) -> None:
    """Print shares of parameters within their 95 % intervals, per form and noise, bodies and friction apart."""
    hits = {}
    drawn = [(name, k) for name in FORM_ARMS for k in range(draws)]
    for name, seed in track(drawn, "arms", console=Console(stderr=True)):
        rng = np.random.default_rng(seed)
        arm = FormArm.drawn(FORM_ARMS[name], rng)
        motions, others = arm.motions(rng, 3), arm.motions(rng, OTHERS)
        for form, level in product(FORMS, FORM_LEVELS):
            made = arm.recorded(FORMS[form], level, motions)
            case = Case(name, Path(), arm.model, made[:-1], made[-1:])
            fitted = fit_parameters(
                case, IdentificationSettings(), lambda message: None
            )
            truth = form_truth(arm, fitted, form, others)
            bare, value = replace(fitted.problem, forms=()), fitted.estimate.value
            interval = method("consistent").interval
            before = interval(bare, fitted.estimator, fitted.estimate)
            kept = [fitted.base.names[k] for k in fitted.base.kept]
            dry = np.array([key[0] in "bcds" for key in kept])
            # offsets take part of friction that is not odd
            counted = np.array([key[0] != "o" for key in kept])
            inside = []
            for uncertainty in (before, fitted.uncertainty):
                lower, upper = uncertainty.interval(value)
                inside.append((lower <= truth) & (truth <= upper))
            half = (fitted.uncertainty.deviation / before.deviation)[counted]
            row = np.array([dry[counted], *(each[counted] for each in inside), half])
            hits.setdefault((form, level), []).append(row)
    rows = [_form_row(*key, np.hstack(found)) for key, found in hits.items()]
    everything = np.hstack([row for found in hits.values() for row in found])
    rows.append(_form_row("all", None, everything))
    head = ["friction", "noise", "bodies", "friction", "all", "wider by"]
    text = f"coverage without form error, with it\n\n{markdown(head, rows)}"
    print(text)
    if path is not None:
        path.write_text(text + "\n", encoding="utf-8")


def _form_row(form: str, level: float | None, found: np.ndarray) -> list[str]:
    dry, before, after, wider = found
    kinds = (dry == 0, dry == 1, dry >= 0)
    shares = [f"{before[k].mean():.0%}, {after[k].mean():.0%}" for k in kinds]
    noise = "" if level is None else f"{level:.1%}"
    return [form, noise, *shares, f"{np.median(wider):.1f}"]


PLAIN, DRY, LACKING = "plain", "dry", "lacking"
ARMS = (PLAIN, DRY, LACKING)
"""What ``--arms`` chooses from: one without dry friction, one with it, and those that the model lacks an effect of."""
HEAD = ["estimator", "runs", *(f"noise {level:.0%}" for level in LEVELS)]

Made = Callable[[World], Estimator]
BASE = {
    "OLS": lambda world: ordinary_least_squares,
    "WLS": lambda world: weighted_least_squares,
    "IRLS, Huber": lambda world: huber,
    "ridge": lambda world: partial(ridge, prior=world.base.of(world.prior)),
    "ridge, L-curve": lambda world: partial(
        ridge, prior=world.base.of(world.prior), choice="l_curve"
    ),
    "truncated SVD": lambda world: partial(
        truncated_svd, prior=world.base.of(world.prior)
    ),
    "total least squares": lambda world: total_least_squares,
    "maximum likelihood": lambda world: maximum_likelihood,
    "partial update": lambda world: partial(
        partial_update, prior=world.base.of(world.prior)
    ),
}
"""Estimators of base parameters, ``--runs`` runs each."""


def possible(world: World, bodies: Bodies) -> Estimator:
    """An estimator of bodies that can exist, near the world's prior."""
    return partial(possible_arm, prior=world.prior, base=world.base, bodies=bodies)


STANDARD = {
    "SDP, Euclidean pull": lambda world: possible(world, semidefinite),
    "SDP, entropic pull": lambda world: possible(
        world, partial(semidefinite, entropic=True)
    ),
    "log-Cholesky": lambda world: possible(world, log_cholesky),
}
"""Estimators of bodies that can exist, ``--consistent`` runs each."""


SIMULATING = {
    "WLS, same draws": lambda experiment: weighted_least_squares,
    "IDIM-IV": lambda experiment: partial(
        instrumental_variables, experiment=experiment
    ),
    "DIDIM": lambda experiment: partial(direct_inverse, experiment=experiment),
    "output error": lambda experiment: partial(output_error, experiment=experiment),
}
"""Estimators that simulate, and the one that they start from, ``--simulating`` runs each."""


class Counts(NamedTuple):
    """Runs of the estimators of base parameters, of those of standard parameters, and of those that simulate."""

    runs: int
    consistent: int
    simulating: int


def comparison(
    label: str, world: World, counts: Counts, rng: np.random.Generator, seed: list[int]
) -> str:
    """What the estimators make of one world, a column per noise level; ``seed`` is that of those that simulate."""
    found = {}

    def estimated(
        level: float, estimators: Mapping[str, Estimator], problem: Problem
    ) -> None:
        for name, estimator in estimators.items():
            value = estimator(problem).value
            found.setdefault((name, level), []).append(value)

    for level in track(LEVELS, label, console=Console(stderr=True)):
        base = {name: made(world) for name, made in BASE.items()}
        for run in range(max(counts.runs, counts.consistent)):
            reduced = world.reduced(world.problem(world.noisy(level, rng)))
            if run < counts.runs:
                estimated(level, base, reduced)
            if run < counts.consistent:
                made = {name: make(world) for name, make in STANDARD.items()}
                estimated(level, made, reduced)
    for run, place in product(range(counts.simulating), range(len(LEVELS))):
        own = np.random.default_rng([*seed, place, run])
        recordings = world.noisy(LEVELS[place], own)
        experiment = world.experiment(recordings)
        simulating = {name: make(experiment) for name, make in SIMULATING.items()}
        estimated(LEVELS[place], simulating, experiment.build(recordings))
    judged = world.reduced(world.problem(world.judge))
    fitted = world.reduced(world.problem(world.fit))
    size = rms(fitted.matrix, (0, 1))

    def cell(values: list[np.ndarray]) -> str:
        """Bias, standard deviation and torque RMSE [mN m]; empty before the second run."""
        if len(values) < 2:
            return ""
        bias = (np.mean(values, axis=0) - world.truth) * size
        spread = np.std(values, axis=0, ddof=1) * size
        errors = [rms(judged.residual(value), None) for value in values]
        figures = rms(bias), rms(spread), np.mean(errors)
        return " / ".join(f"{1e3 * figure:.1f}" for figure in figures)

    rows = []
    for name in dict.fromkeys(name for name, _ in found):
        levels = [found.get((name, level), []) for level in LEVELS]
        runs = "/".join(str(len(values)) for values in levels)
        rows.append([name, runs, *map(cell, levels)])
    title = "bias / standard deviation / RMSE of judged torque [mN m]"
    return f"{label}: {title}\n\n{markdown(HEAD, rows)}"


def coverage(
    world: World, level: float, runs: int, rng: np.random.Generator
) -> dict[str, float]:
    """Share of parameters, and of samples of predicted torque, within their 95 % intervals; share of runs warned."""
    judged = world.reduced(world.problem(world.judge))
    hits = {}
    for _ in range(runs):
        problem = world.reduced(world.problem(world.noisy(level, rng)))
        estimator = weighted_least_squares
        estimate = estimator(problem)
        weight = np.diag(estimate.residual**-2)
        methods = {
            "plain formula": Uncertainty(estimate.covariance, np.inf, 1),
            "block jackknife": block_jackknife(problem, estimate.value, weight),
        }
        for name, uncertainty in methods.items():
            lower, upper = uncertainty.interval(estimate.value)
            inside = (lower <= world.truth) & (world.truth <= upper)
            hits.setdefault(name, []).append(float(inside.mean()))
        interval = torque_interval(problem, estimator, methods["block jackknife"])
        error = np.abs(judged.residual(estimate.value))
        inside = error <= interval.half_width(judged.matrix)
        hits.setdefault("torque", []).append(float(inside.mean()))
        hits.setdefault("torque, worst joint", []).append(
            float(inside.mean(axis=0).min())
        )
        hits.setdefault("warned", []).append(float(bool(interval.warnings())))
    return {name: float(np.mean(values)) for name, values in hits.items()}


Shares = list[tuple[str, dict[str, float]]]
"""Coverage by arm and kind."""


def main() -> None:
    """Run, print and write the tables."""
    options = command_line(
        __doc__,
        runs=100,
        consistent=20,
        simulating=0,
        seed=1,
        arms={"nargs": "+", "choices": ARMS, "default": ARMS},
        forms=(0, "draws of each arm"),
        out=Path,
    ).parse_args()
    if options.forms:
        form_coverage(options.forms, options.out)
        return
    counts = Counts(options.runs, options.consistent, options.simulating)
    texts = []
    shares = []
    for place, arm in enumerate(options.arms):
        rng = np.random.default_rng([options.seed, ARMS.index(arm)])
        if arm == LACKING:
            for name, effect in UNMODELLED.items() if counts.runs else ():
                share = coverage(simulated((effect,)), LEVELS[1], counts.runs, rng)
                shares.append((f"lacks {name}, noise {LEVELS[1]:.0%}", share))
        else:
            world, seed = simulated(dry=arm == DRY), [options.seed, place]
            texts.append(comparison(f"{arm} arm", world, counts, rng, seed))
            for level in LEVELS if counts.runs else ():
                share = coverage(world, level, counts.runs, rng)
                shares.append((f"{arm} arm, noise {level:.0%}", share))
        shown = [*texts]
        if shares:
            kinds = list(shares[0][1])
            rows = [[k, *(f"{one[x]:.1%}" for x in kinds)] for k, one in shares]
            title = "coverage of 95 % intervals, weighted least squares"
            shown.append(f"{title}\n\n{markdown(['arm', *kinds], rows)}")
        if options.out:
            with atomic_write(options.out) as aside:
                aside.write_text("\n\n".join(shown) + "\n", encoding="utf-8")
    print("\n\n".join(shown))


if __name__ == "__main__":
    main()
