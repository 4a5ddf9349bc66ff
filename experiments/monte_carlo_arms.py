"""The arms of ``08_monte_carlo.py``: simulated truths, the noise of a run, and the problem that noisy recordings make.

Three joints of the KUKA iiwa (1, 2 and 4 by default; the others locked) with rotors and viscous friction follow random
Fourier motions of 10 s, four to fit and two to judge. Positions are filtered at 20 Hz and differentiated, columns and
torque at 12 Hz, one sample of five is kept.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.motions.named_motions import workspace
from gapscope.arm.recording import Recording
from gapscope.arm.robots import load_nominal_arm
from gapscope.effects.applied import AppliedEffect
from gapscope.envs.position_controller import position_controller
from gapscope.envs.recorder import Plan, record_case
from gapscope.ident.estimators.experiment import Experiment
from gapscope.ident.estimators.wls import WeightedLeastSquares
from gapscope.ident.model.base_parameters import BaseParameters, base_parameters
from gapscope.ident.model.linear_problem import Problem
from gapscope.ident.model.regressor import Regressor
from gapscope.model.conditioning import condition, low_pass

JOINTS = (1, 2, 4)
"""Joints of the iiwa that move, by default."""
ARMATURE = (0.3, 0.3, 0.2, 0.2, 0.1, 0.1, 0.05)
VISCOUS = (4.0, 4.0, 2.0, 2.0, 1.0, 1.0, 0.5)
COULOMB = (3.0, 3.5, 2.0, 2.5, 1.2, 0.8, 0.5)
"""Dry friction of the arm that has it [N m]."""
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

    def noisy(self, level: float, rng: np.random.Generator) -> tuple[Recording, ...]:
        """The recordings to fit with the noise of one run."""
        return tuple(noised(recording, level, rng) for recording in self.fit)

    def problem(self, recordings: tuple[Recording, ...]) -> Problem:
        """Signals conditioned, all p columns and the torque through one filter."""
        parts = []
        for recording in recordings:
            (segment,) = condition(recording, POSITION_CUTOFF)
            matrix = self.regressor.matrix(segment.motion)
            assert segment.torque is not None
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
            EVERY / RATE,
        )

    def errors(self, level: float) -> tuple[np.ndarray, float]:
        """Standard deviation of the errors of each base column, shape (b,), and of the torque [N m], by one draw."""
        noisy = self.reduced(self.problem(self.noisy(level, np.random.default_rng(0))))
        clean = self.reduced(self.problem(self.fit))
        columns = (noisy.matrix - clean.matrix).std(axis=(0, 1))
        return np.where(columns > 1e-9, columns, 0.0), float(
            (noisy.torque - clean.torque).std()
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
        start = self.base.nearest(
            WeightedLeastSquares().estimate(problem).value, self.prior
        )
        arm = self.regressor.arm
        controller = replace(
            position_controller(arm, workspace(self.regressor.body).posture), rate=TICKS
        )
        build = lambda given: self.reduced(self.problem(tuple(given)))  # noqa: E731
        return Experiment(
            self.regressor, self.base, controller, recordings, build, start
        )


def noised(recording: Recording, level: float, rng: np.random.Generator) -> Recording:
    """A recording with the noise of one run."""
    assert recording.tau is not None
    q = recording.q + ENCODER * level * rng.standard_normal(recording.q.shape)
    spread = level * recording.tau.std(axis=0)
    return replace(
        recording,
        q=q,
        tau=recording.tau + spread * rng.standard_normal(recording.tau.shape),
        dq=None,
    )


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
            AppliedEffect(
                "joint_elasticity", (two,), {"stiffness": [1500.0], "damping": [5.0]}
            ),
        ),
    }


def simulated(
    engine: str,
    joints: tuple[int, ...],
    effects: tuple[AppliedEffect, ...] = (),
    dry: bool = False,
    seed: int = 5,
) -> World:
    """Record the true arm, without noise; ``dry`` gives arm and model the friction ``COULOMB``."""
    at = np.array(joints) - 1
    sheet = {
        "armature": np.array(ARMATURE)[at].tolist(),
        "viscous": np.array(VISCOUS)[at].tolist(),
    }
    if dry:
        sheet["coulomb"] = np.array(COULOMB)[at].tolist()
    nominal = load_nominal_arm(
        "kuka_iiwa", joints=[f"lbr_iiwa_joint_{joint}" for joint in joints], sheet=sheet
    )
    rng = np.random.default_rng(seed)
    controller = replace(
        position_controller(nominal, workspace(RigidBody(nominal)).posture), rate=TICKS
    )
    plan = Plan(recordings=1, noise=0.0, rate=RATE, engine=engine)
    recordings = [
        replace(
            record_case(
                "truth", nominal, effects, plan, rng, controller=controller
            ).recordings[0],
            name=f"{i + 1}",
        )
        for i in range(FIT + JUDGE)
    ]
    regressor = Regressor(nominal)
    (segment,) = condition(recordings[0], POSITION_CUTOFF)
    matrix = regressor.matrix(segment.motion)
    base = base_parameters(matrix.reshape(-1, matrix.shape[2]), regressor.names)
    return World(regressor, base, tuple(recordings[:FIT]), tuple(recordings[FIT:]))
