"""Cases of the blind check's generator as a set has them, and its arms as plants to track under any PD loop."""

from __future__ import annotations

import copy
import shutil
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from common import CASES
from scipy.signal import butter, sosfiltfilt

from gapscope.agents.models import AgentModel, TorqueModel
from gapscope.agents.tracking import (
    AgentController,
    TrackingMetrics,
    TrackingRun,
    Tuning,
)
from gapscope.arm.case import load_case
from gapscope.arm.control import Targets
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.io.json_file import read_json, write_json
from gapscope.arm.motions.motion import Motion
from gapscope.arm.motions.named_motions import workspace
from gapscope.arm.root_mean_square import rms
from gapscope.arm.velocity_filter import VelocityFilter
from gapscope.blind_check.generator.case import (
    CaseSetup,
    MadeCase,
    make_case,
    write_case,
)
from gapscope.blind_check.generator.simulate import (
    STRONG,
    CaseSpec,
    Conditions,
    draw_motion,
    simulate,
)
from gapscope.blind_check.generator.true_arm import Columns, TrueArm
from gapscope.envs.actions import Gains
from gapscope.envs.position_controller import (
    RATE,
    VELOCITY_CUTOFF,
    VELOCITY_DAMPING,
    loop_inertia,
)

ARMS = (
    ("franka_panda", ("payload", "actuator_delay")),
    ("ur10_like", ("load_friction", "joint_elasticity")),
    ("kuka_iiwa", ("torque_scale", "coulomb_friction")),
    ("ur5_like", ("link_inertia", "actuator_lag")),
)
"""Robots in the generator and their laws: bodies, friction and drives; sizes and joints are drawn."""
SEVERITY, INERTIALS_OFF = STRONG[1], 0.1
"""Severity class of the laws (gap of each over that of a healthy arm), and relative error of the nominal inertials."""
MOTIONS = ("middle", "point_to_point")
"""Kinds of motions that are tracked, of seeds that no recording has."""
DURATION, EXTENSION = 4.0, 0.25
"""Of a motion that is tracked, and how far beyond its end models look [s]."""
LIMIT = 10.0
"""Factor on the torque limits in the search for stable gains, so that what is unstable grows [1]."""
PULSE, PULSE_TICKS = 5e-3, slice(1000, 1020)
"""Error of all encoders in one of two runs [rad], and when."""
FASTEST_REST = 0.05
"""RMS speed of the difference of both runs in the last third, above which a loop does not settle [rad/s]."""
LEARNT, LEARNT_BAND = 8, 60.0
"""Runs from which the true torque is learnt, and the band in which it is [Hz]."""


def make_generated(
    spec: CaseSpec, seed: tuple[int, ...], folder: Path, label: Path | None = None
) -> dict[str, Any]:
    """A case of the generator in a folder and its label in a file, made unless both are there; the label.

    The file is by default beside the folder.
    """
    truth = label or folder.with_suffix(".json")
    if not (truth.is_file() and folder.is_dir()):
        made = make_case(spec, seed)
        shutil.rmtree(folder, ignore_errors=True)
        aside = folder.with_name(f".{folder.name}")
        shutil.rmtree(aside, ignore_errors=True)
        bare = spec.conditions.bare
        write_case(made, folder.name, bare, aside, truth.with_suffix(".csv"))
        write_json(made.label, truth)
        aside.rename(folder)
    return dict(read_json(truth, "remove it"))


GENERATED = "generated"


def named_case(name: str, spec: CaseSpec, seed: tuple[int, ...], out: Path) -> Path:
    """The case of a name: ``GENERATED`` is made by the generator, others are files of real arms."""
    if name != GENERATED:
        return CASES / f"{name}.yaml"
    folder = out / "cases" / name
    make_generated(spec, seed, folder)
    return folder


def recorded(
    setup: CaseSetup, plants: TrueArm | Sequence[TrueArm], which: Sequence[int]
) -> list[Columns] | None:
    """The recordings of some motions, of one arm or of one each; ``None`` if one of them does not run well."""
    if isinstance(plants, TrueArm):
        plants = [plants] * len(which)
    rows = [setup.run(plant, k) for plant, k in zip(plants, which, strict=True)]
    found = [r for r in rows if r is not None]
    return found if len(found) == len(rows) else None


def write_side(
    setup: CaseSetup, rows: list[Columns], folder: Path, bare: bool, poor: bool = True
) -> None:
    """Write a case of some recordings; of a poor data sheet, nobody knows the friction."""
    if poor:
        unknown = np.zeros(setup.arm.n)
        arm = setup.arm._replace(coulomb=unknown, viscous=unknown)
        setup = replace(setup, arm=arm)
    made = MadeCase(setup, setup.plant(()), (), [*rows, rows[-1]], {})
    unseen = folder.with_suffix(".csv")
    write_case(made, folder.name, bare, folder, unseen)
    unseen.unlink()


Fed = TorqueModel | AgentModel | np.ndarray | None
"""What is fed forward: a model, an agent on top of one, torques [N m], or nothing."""


class GeneratorArm:
    """A true arm of the generator, tracked under PD with a torque fed forward.

    Args:
        number: of the arm in ``ARMS``; draws, motions and noise follow from it.
    """

    def __init__(self, number: int) -> None:
        robot, laws = ARMS[number]
        conditions = Conditions(robot, inertials_off=INERTIALS_OFF, recordings=4)
        spec = CaseSpec("pair", laws, SEVERITY, conditions)
        self.number, self.laws = number, laws
        self.made = make_case(spec, (29, number))
        self._rng_seed = (29, number, 1)

    def write(self, folder: Path) -> None:
        """Write the case, as the blind check does."""
        write_case(
            self.made,
            f"arm_{self.number}",
            False,
            folder / "case",
            folder / "held_out.csv",
        )

    def open(self, folder: Path) -> None:
        """Read the nominal arm of the case, and draw the motions to track."""
        self.arm = load_case(folder / "case", read_recordings=False).arm
        body = RigidBody(self.arm)
        space = workspace(body)
        self._metrics = TrackingMetrics(self.arm, body, space)
        rng = np.random.default_rng(self._rng_seed)
        length = DURATION + EXTENSION
        self.motions = [
            draw_motion(kind, self.made.setup.arm, length, RATE, rng)
            for kind in MOTIONS
        ]
        noise = self.made.setup.healthy.noise
        self._noise = [
            noise * rng.standard_normal(motion.q.shape) for motion in self.motions
        ]
        self._inertia = loop_inertia(
            self.arm,
            self.made.setup.arm.home,
            Tuning().bandwidth,
            np.vstack([motion.q[::50] for motion in self.motions]),
        )

    def run(
        self,
        fed: Fed,
        which: int,
        bandwidth: float,
        limit: float = 1.0,
        pulse: float = 0.0,
    ) -> TrackingRun:
        """Track a motion with gains of a bandwidth [Hz].

        Args:
            fed: forward.
            which: of the motions.
            bandwidth: [Hz].
            limit: factor on the torque limits [1].
            pulse: that the encoders read for a moment beyond the position [rad].
        """
        motion = self.motions[which]
        ticks = round(DURATION * RATE)
        # the derivative of the tracking error is filtered, not that of the position: both pass the same filter
        filtered = VelocityFilter(
            (RATE, VELOCITY_CUTOFF, VELOCITY_DAMPING),
            motion.q[0],
            np.zeros(self.arm.n_joints),
        )
        rate = np.array([filtered(q) for q in motion.q[:ticks]])
        cut = Motion(motion.t[:ticks], motion.q[:ticks], rate, motion.ddq[:ticks])
        planned, steer = self._feedforward(fed, motion)
        plant = self._plant(bandwidth, limit)
        noise = self._noise[which][:ticks].copy()
        noise[PULSE_TICKS] += pulse
        rows = simulate(plant, cut, planned[:ticks], noise, steer)
        if rows is None:
            empty = np.zeros((0, self.arm.n_joints))
            return TrackingRun(np.zeros(0), empty, empty, empty, True)
        return TrackingRun(rows["t"], rows["q_ref"], rows["q"], rows["tau"], False)

    def measure(self, fed: Fed, which: int, bandwidth: float) -> dict[str, float]:
        """How well a motion is tracked; the arm is lost at 0.7 rad from its reference, or at its torque limit."""
        return self._metrics(self.run(fed, which, bandwidth), 1 / RATE, DURATION)

    def settles(self, fed: Fed, bandwidth: float) -> bool:
        """Whether the arm forgets a pulse on the first motion: two runs, one with it, come together again."""
        runs = [self.run(fed, 0, bandwidth, LIMIT, pulse) for pulse in (0.0, PULSE)]
        if any(run.diverged for run in runs):
            return False
        apart = (runs[1].q - runs[0].q)[2 * len(runs[0].q) // 3 :: 10]
        speed = np.diff(apart, axis=0) * RATE / 10
        return bool(rms(speed).max() < FASTEST_REST)

    def true_torque(self, which: int, first: TorqueModel, bandwidth: float) -> Fed:
        """The torque that this arm needs for a motion, learnt on the arm itself by iteration [N m], (N, n).

        What the loop commanded in one run is fed forward in the next, without phase shift below ``LEARNT_BAND``: no law
        enters. It is the bound of any model, for this motion alone.
        """
        sos = butter(2, LEARNT_BAND, output="sos", fs=RATE)
        fed = first.series(self.motions[which])
        for _ in range(LEARNT):
            run = self.run(fed, which, bandwidth)
            if run.diverged:
                break
            fed = fed.copy()
            fed[: len(run.tau)] = sosfiltfilt(sos, run.tau, axis=0)
        return fed

    def _feedforward(
        self, fed: Fed, motion: Motion
    ) -> tuple[np.ndarray, Callable[[int, np.ndarray], np.ndarray] | None]:
        """Torque fed forward [N m], (N, n), and what an agent makes of it."""
        if isinstance(fed, np.ndarray):
            return fed, None
        model = fed.model if isinstance(fed, AgentModel) else fed
        planned = np.zeros_like(motion.q) if model is None else model.series(motion)
        if not isinstance(fed, AgentModel):
            return planned, None
        return planned, _steered(fed, motion, planned)

    def _plant(self, bandwidth: float, limit: float) -> object:
        """The true arm with a loop of its own gains; what its laws changed stays."""
        plant, loop = copy.copy(self.made.plant), self.made.plant.loop
        own = Tuning(bandwidth).gains(self._inertia)
        plant.loop = loop._replace(
            rate=RATE,
            kp=own.kp,
            kd=own.kd,
            limit=limit * loop.limit,
            cutoff=VELOCITY_CUTOFF,
            damping=VELOCITY_DAMPING,
        )
        changed = {"kp": own.kp, "kd": own.kd, "limit": limit * loop.limit}
        plant.values = {**plant.values, **changed}
        return plant


def _steered(
    agent: AgentModel, motion: Motion, planned: np.ndarray
) -> Callable[[int, np.ndarray], np.ndarray]:
    """Feedforward with an agent's torque; the agent reads the encoders one tick late, and the loop adds its PD."""
    n = motion.q.shape[1]
    none, unlimited = Gains(np.zeros(n), np.zeros(n)), np.full(n, np.inf)
    controller = AgentController(none, unlimited, agent)
    controller.begin(motion)
    rate = VelocityFilter(
        (RATE, VELOCITY_CUTOFF, VELOCITY_DAMPING), np.zeros(n), np.zeros(n)
    )

    def steer(k: int, q: np.ndarray) -> np.ndarray:
        velocity = motion.dq[k] - rate(motion.q[k] - q)
        now = Targets(motion.q[k], motion.dq[k], motion.ddq[k], planned[k])
        return controller(now, q, velocity)

    return steer
