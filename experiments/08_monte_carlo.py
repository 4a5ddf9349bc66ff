"""Bias, deviation and coverage of the estimators by Monte Carlo over arms simulated in PyBullet and MuJoCo.

Three joints of the KUKA iiwa (1, 2 and 4 by default; the others locked) with rotors and viscous friction follow random
Fourier motions of 10 s, four to fit and two to judge, in each engine; noise is drawn anew in each run, on encoders and
torque. Positions are filtered at 20 Hz and differentiated, columns and torque at 12 Hz, one sample of five is kept.

Tables: (1) per estimator and noise level the bias and the standard deviation of the base parameters, both as the
torque that they make, and the RMSE of the torque predicted on the motions to judge; (2) coverage of 95 % intervals of
the parameters; (3) the same and of the predicted torque with one effect in the arm that the model lacks.

Run with ``--runs 100 --simulating 10``; ``--out FILE.md`` writes the tables.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import Progress

from arm.dynamics import RigidBody
from arm.motions import workspace
from arm.recording import Recording
from arm.robots import load_nominal_arm
from arm.whole import written_whole
from effects.applied import AppliedEffect
from envs.mystery import position_controller
from envs.session import Plan, record_case
from ident.base_parameters import BaseParameters, base_parameters
from ident.conditioning import condition, low_pass
from ident.estimate import Estimate, Estimator
from ident.estimators.consistent_sdp import ConsistentSdp
from ident.estimators.didim import DirectInverse
from ident.estimators.instrumental_variables import InstrumentalVariables
from ident.estimators.irls import HuberLeastSquares
from ident.estimators.log_cholesky import LogCholesky
from ident.estimators.maximum_likelihood import MaximumLikelihood
from ident.estimators.ols import OrdinaryLeastSquares
from ident.estimators.output_error import OutputError
from ident.estimators.partial_update import PartialUpdate
from ident.estimators.ridge import Ridge
from ident.estimators.total_least_squares import TotalLeastSquares
from ident.estimators.truncated_svd import TruncatedSvd
from ident.estimators.wls import WeightedLeastSquares
from ident.experiment import Experiment
from ident.problem import Problem
from ident.regressor import Regressor
from ident.torque_interval import torque_interval
from ident.uncertainty import Uncertainty, block_jackknife, plain, sandwich

JOINTS = (1, 2, 4)
"""Joints of the iiwa that move, by default."""
ARMATURE = (0.3, 0.3, 0.2, 0.2, 0.1, 0.1, 0.05)
VISCOUS = (4.0, 4.0, 2.0, 2.0, 1.0, 1.0, 0.5)
LEVELS = (0.01, 0.03, 0.1)
"""Noise: white torque noise over the joint's standard deviation; encoders have ``ENCODER`` times as much [rad]."""
ENCODER = 1e-3
POSITION_CUTOFF, CUTOFF, RATE, EVERY = 20.0, 12.0, 250.0, 5
FIT, JUDGE = 4, 2
TICKS = 4000.0
"""Rate of the controller, and so of the simulation [Hz]: its steps bias rotor inertias by viscous friction times half
a step."""
ENGINES = ("pybullet", "mujoco")


@dataclass(frozen=True)
class World:
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

    def problem(self, recordings: tuple[Recording, ...], level: float, rng: np.random.Generator) -> Problem:
        """Noise added, signals conditioned, all p columns and the torque through one filter."""
        parts = []
        for recording in recordings:
            assert recording.tau is not None
            q = recording.q + ENCODER * level * rng.standard_normal(recording.q.shape)
            spread = level * recording.tau.std(axis=0)
            tau = recording.tau + spread * rng.standard_normal(recording.tau.shape)
            (segment,) = condition(replace(recording, q=q, tau=tau, dq=None), POSITION_CUTOFF)
            matrix = self.regressor.matrix(segment.motion)
            assert segment.torque is not None
            both = np.concatenate([matrix, segment.torque[..., None]], axis=2)
            filtered = low_pass(both.reshape(len(both), -1), RATE, CUTOFF)[segment.inner][::EVERY]
            parts.append(filtered.reshape(-1, *both.shape[1:]))
        group = np.repeat(np.arange(len(parts)), [len(part) for part in parts])
        stacked = np.concatenate(parts)
        return Problem(stacked[..., :-1], stacked[..., -1], self.regressor.names, group, EVERY / RATE)

    def errors(self, level: float) -> tuple[np.ndarray, float]:
        """Standard deviation of the errors of each base column, shape (b,), and of the torque [N m], by one draw."""
        noisy, clean = (self.reduced(self.problem(self.fit, own, np.random.default_rng(0))) for own in (level, 0.0))
        columns = (noisy.matrix - clean.matrix).std(axis=(0, 1))
        return np.where(columns > 1e-9, columns, 0.0), float((noisy.torque - clean.torque).std())

    def reduced(self, problem: Problem) -> Problem:
        """The base columns of a problem."""
        kept = self.base.kept
        names = tuple(np.asarray(problem.names)[kept])
        return Problem(problem.matrix[..., kept], problem.torque, names, problem.group, problem.interval)


Made = Callable[[World, float], Estimator]
BASE: dict[str, Made] = {
    "OLS": lambda world, level: OrdinaryLeastSquares(),
    "WLS": lambda world, level: WeightedLeastSquares(),
    "IRLS, Huber": lambda world, level: HuberLeastSquares(),
    "ridge, GCV": lambda world, level: Ridge("gcv"),
    "ridge, L-curve": lambda world, level: Ridge("l_curve"),
    "truncated SVD, GCV": lambda world, level: TruncatedSvd(),
    "total least squares": lambda world, level: TotalLeastSquares(),
    "TLS, column noise given": lambda world, level: TotalLeastSquares(*world.errors(level)),
    "maximum likelihood": lambda world, level: MaximumLikelihood(),
    "partial update": lambda world, level: PartialUpdate(world.base.of(world.prior)),
}
"""Estimators of base parameters, ``--runs`` runs each."""
STANDARD: dict[str, Made] = {
    "SDP": lambda world, level: ConsistentSdp(),
    "SDP, Euclidean pull": lambda world, level: ConsistentSdp(world.prior),
    "SDP, entropic pull": lambda world, level: ConsistentSdp(world.prior, "entropic"),
    "log-Cholesky": lambda world, level: LogCholesky(world.prior),
}
"""Estimators of all standard parameters, ``--consistent`` runs each."""


def repeated(world: World, recordings: tuple[Recording, ...]) -> Experiment:
    """Noisy recordings, how the simulator repeats them, and how both become a problem."""
    nominal, still = world.regressor.arm, np.random.default_rng(0)
    posture = workspace(world.regressor.body).posture
    controller = replace(position_controller(nominal, posture), rate=TICKS)
    build = lambda given: world.reduced(world.problem(tuple(given), 0.0, still))  # noqa: E731
    return Experiment(world.regressor, world.base, controller, recordings, build, world.prior)


def by_simulation(kind: Callable[[Experiment], Estimator]) -> Callable[[World, tuple[Recording, ...]], Estimate]:
    """An estimator that simulates, as a function of world and noisy recordings; it starts from the prior."""

    def estimate(world: World, recordings: tuple[Recording, ...]) -> Estimate:
        experiment = repeated(world, recordings)
        return kind(experiment).estimate(experiment.build(recordings))

    return estimate


SIMULATING: dict[str, Callable[[World, tuple[Recording, ...]], Estimate]] = {
    "IDIM-IV": by_simulation(InstrumentalVariables),
    "DIDIM": by_simulation(DirectInverse),
    "output error": by_simulation(OutputError),
}
"""Estimators that simulate, ``--simulating`` runs each: world and noisy recordings to base parameters."""


def unmodelled(joints: tuple[int, ...]) -> dict[str, tuple[AppliedEffect, ...]]:
    """What the arm has and the model lacks; effects count joints among those that move."""
    two, four = joints.index(2) + 1, joints.index(4) + 1
    every = tuple(range(1, len(joints) + 1))
    return {
        "load friction 0.15, joints 2 and 4": (
            AppliedEffect("load_friction", (two, four), {"coefficient": [0.15, 0.15]}),
        ),
        "Stribeck friction 2 N m, all joints": (
            AppliedEffect("stribeck_friction", every, {"torque": 2.0, "velocity": 0.2}),
        ),
        "elasticity 1500 N m/rad, joint 2": (
            AppliedEffect("joint_elasticity", (two,), {"stiffness": [1500.0], "damping": [5.0]}),
        ),
    }


def simulated(engine: str, joints: tuple[int, ...], effects: tuple[AppliedEffect, ...], seed: int = 5) -> World:
    """Record the true arm, without noise."""
    at = np.array(joints) - 1
    sheet = {"armature": np.array(ARMATURE)[at].tolist(), "viscous": np.array(VISCOUS)[at].tolist()}
    nominal = load_nominal_arm("kuka_iiwa", joints=[f"lbr_iiwa_joint_{joint}" for joint in joints], sheet=sheet)
    rng = np.random.default_rng(seed)
    controller = replace(position_controller(nominal, workspace(RigidBody(nominal)).posture), rate=TICKS)
    plan = Plan(recordings=1, noise=0.0, rate=RATE, engine=engine)
    recordings = [
        replace(record_case("truth", nominal, effects, plan, rng, controller=controller).recordings[0], name=f"{i + 1}")
        for i in range(FIT + JUDGE)
    ]
    regressor = Regressor(nominal)
    (segment,) = condition(recordings[0], POSITION_CUTOFF)
    matrix = regressor.matrix(segment.motion)
    base = base_parameters(matrix.reshape(-1, matrix.shape[2]), regressor.names)
    return World(regressor, base, tuple(recordings[:FIT]), tuple(recordings[FIT:]))


@dataclass
class Tally:
    """Values and judged torque of one estimator over the runs."""

    values: list[np.ndarray]
    errors: list[float]

    def row(self, truth: np.ndarray, rms: np.ndarray) -> str:
        """Bias, standard deviation and torque RMSE [mN m]."""
        values = np.array(self.values)
        bias, spread = (values.mean(axis=0) - truth) * rms, values.std(axis=0, ddof=1) * rms
        figures = (np.sqrt((bias**2).mean()), np.sqrt((spread**2).mean()), np.mean(self.errors))
        return " / ".join(f"{1e3 * figure:.1f}" for figure in figures)


def compare(
    world: World, level: float, counts: dict[str, int], rng: np.random.Generator, step: Callable[[], None]
) -> dict[str, str]:
    """Figures of every estimator at one noise level."""
    still = np.random.default_rng(0)
    judged = world.reduced(world.problem(world.judge, 0.0, still))
    fitted = world.reduced(world.problem(world.fit, 0.0, still))
    rms = np.sqrt((fitted.matrix**2).mean(axis=(0, 1)))
    base = {name: made(world, level) for name, made in BASE.items()}
    tallies = {name: Tally([], []) for name in (*BASE, *STANDARD, *SIMULATING)}
    for run in range(max(counts.values())):
        found: dict[str, np.ndarray] = {}
        problem = world.problem(world.fit, level, rng)
        if run < counts["runs"]:
            reduced = world.reduced(problem)
            found |= {name: estimator.estimate(reduced).value for name, estimator in base.items()}
        if run < counts["consistent"]:
            standard = {name: made(world, level).estimate(problem).value for name, made in STANDARD.items()}
            found |= {name: world.base.of(value) for name, value in standard.items()}
        if run < counts["simulating"] and SIMULATING:
            noisy = tuple(noised(recording, level, rng) for recording in world.fit)
            found |= {name: estimate(world, noisy).value for name, estimate in SIMULATING.items()}
        for name, value in found.items():
            tallies[name].values.append(value)
            tallies[name].errors.append(float(np.sqrt((judged.residual(value) ** 2).mean())))
        step()
    return {name: tally.row(world.truth, rms) for name, tally in tallies.items() if len(tally.values) > 1}


def noised(recording: Recording, level: float, rng: np.random.Generator) -> Recording:
    """A recording with the noise of one run."""
    assert recording.tau is not None
    q = recording.q + ENCODER * level * rng.standard_normal(recording.q.shape)
    spread = level * recording.tau.std(axis=0)
    return replace(recording, q=q, tau=recording.tau + spread * rng.standard_normal(recording.tau.shape), dq=None)


def coverage(
    world: World, level: float, runs: int, rng: np.random.Generator, step: Callable[[], None]
) -> dict[str, float]:
    """Share of parameters, and of samples of predicted torque, within their 95 % intervals; share of runs warned."""
    judged = world.reduced(world.problem(world.judge, 0.0, np.random.default_rng(0)))
    hits: dict[str, list[float]] = {}
    for _ in range(runs):
        problem = world.reduced(world.problem(world.fit, level, rng))
        estimator = WeightedLeastSquares()
        estimate = estimator.estimate(problem)
        weight = np.diag(estimate.residual**-2)
        methods = {
            "plain formula": plain(estimate, problem),
            "sandwich": sandwich(problem, estimate.value, weight),
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
        hits.setdefault("torque, worst joint", []).append(float(inside.mean(axis=0).min()))
        hits.setdefault("torque, parameters only", []).append(float(_bare(methods["plain formula"], judged, error)))
        hits.setdefault("warned", []).append(float(bool(interval.warnings)))
        step()
    return {name: float(np.mean(values)) for name, values in hits.items()}


def _bare(uncertainty: Uncertainty, judged: Problem, error: np.ndarray) -> float:
    """Coverage of the torque by the plain formula's parameter covariance alone."""
    own = np.einsum("ijb,bc,ijc->ij", judged.matrix, uncertainty.covariance, judged.matrix)
    return float((error <= 1.96 * np.sqrt(own)).mean())


def table(head: list[str], rows: list[list[str]]) -> str:
    """A table in Markdown."""
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    return "\n".join(lines + ["| " + " | ".join(row) + " |" for row in rows])


def main() -> None:
    """Run, print and write the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=100)
    parser.add_argument("--consistent", type=int, default=20)
    parser.add_argument("--simulating", type=int, default=10)
    parser.add_argument("--joints", type=int, nargs="+", default=JOINTS, help="of the iiwa, 2 and 4 among them")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, default=None)
    options = parser.parse_args()
    joints, rng = tuple(options.joints), np.random.default_rng(options.seed)
    counts = {"runs": options.runs, "consistent": options.consistent, "simulating": options.simulating}
    largest, console = max(counts.values()), Console()
    texts = []
    with Progress(console=console) as progress:
        total = len(ENGINES) * len(LEVELS) * (largest + options.runs) + len(unmodelled(joints)) * options.runs
        task = progress.add_task("runs", total=total)
        step = lambda: progress.advance(task)  # noqa: E731
        shares = []
        for engine in ENGINES:
            world = simulated(engine, joints, ())
            columns = [compare(world, level, counts, rng, step) for level in LEVELS]
            rows = [[name, *(column[name] for column in columns)] for name in columns[0]]
            head = ["estimator", *(f"noise {level:.0%}" for level in LEVELS)]
            texts.append(f"{engine}: bias / standard deviation / RMSE of judged torque [mN m]\n\n{table(head, rows)}")
            shares += [
                [f"{engine}, noise {level:.0%}", coverage(world, level, options.runs, rng, step)] for level in LEVELS
            ]
        for name, effects in unmodelled(joints).items():
            world = simulated(ENGINES[0], joints, effects)
            shares.append([f"lacks {name}, noise {LEVELS[1]:.0%}", coverage(world, LEVELS[1], options.runs, rng, step)])
    kinds = list(shares[0][1])
    rows = [[label, *(f"{share[kind]:.1%}" for kind in kinds)] for label, share in shares]
    texts.append(f"coverage of 95 % intervals, weighted least squares\n\n{table(['arm', *kinds], rows)}")
    text = "\n\n".join(texts)
    console.print(text, soft_wrap=True, highlight=False, markup=False)
    if options.out:
        with written_whole(options.out) as aside:
            aside.write_text(text + "\n", encoding="utf-8")
        console.print(f"wrote {options.out}")


if __name__ == "__main__":
    main()
