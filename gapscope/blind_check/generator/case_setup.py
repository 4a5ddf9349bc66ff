"""The setup of a case: its arm, controller, motions and healthy twin, on which causes are tried and sized."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from gapscope.blind_check.generator.arms import Arm, draw_arm
from gapscope.blind_check.generator.conditions import Conditions
from gapscope.blind_check.generator.law import Cause, LawContext
from gapscope.blind_check.generator.loop import Loop
from gapscope.blind_check.generator.measure import KNEE, nominal_torque, residual, rms
from gapscope.blind_check.generator.motions import Motion, draw_motion
from gapscope.blind_check.generator.rigid import (
    inertia_diagonal,
    inverse_dynamics,
    model_of,
    tip_path,
)
from gapscope.blind_check.generator.simulate import simulate
from gapscope.blind_check.generator.true_arm import Columns, HealthyArm, TrueArm
from gapscope.blind_check.generator.urdf import copied, perturb_inertials

STEP = 5e-4
"""Simulation step [s]."""
RESTLESS = 0.35
"""Mean change of the command from tick to tick, over its deviation, above which the loop is not a healthy one."""


@dataclass(frozen=True)
class CaseSetup:
    """What stays the same while causes are tried; the last motion is the held-out one.

    Attributes:
        arm, loop, healthy: the arm, its controller, its small imperfections.
        model: MuJoCo model of the nominal arm.
        believed: URDF root with the true inertials of the healthy twin (a little off the nominal ones).
        motions, kinds, ahead, noise: per recording reference, its kind, feedforward [N m], encoder noise [rad].
        thin: rows of the controller per row of the recording.
        context: what laws may use.
        floor: RMS of the healthy twin's gap on the held-out motion [N m], (n,).
        twin: that gap itself [N m], (M, n).
    """

    arm: Arm
    loop: Loop
    healthy: HealthyArm
    model: Any
    believed: Any
    motions: list[Motion]
    kinds: list[str]
    ahead: list[np.ndarray]
    noise: list[np.ndarray]
    thin: int
    context: LawContext
    floor: np.ndarray
    twin: np.ndarray

    def plant(self, causes: Sequence[Cause]) -> TrueArm:
        """The true arm with some causes."""
        plant = TrueArm(self.arm, self.healthy, self.loop, copied(self.believed))
        for cause in causes:
            cause.act(plant)
        return plant

    def run(
        self, plant: TrueArm, which: int, later: tuple[float, TrueArm] | None = None
    ) -> Columns | None:
        """One recording, thinned to its rate, before any fault of the set-up; ``None`` if it cannot be used.

        Args:
            plant: the true arm.
            which: number of the motion.
            later: a time [s], and the arm that takes the place of the other from then on.
        """
        rows = simulate(
            plant,
            self.motions[which],
            self.ahead[which],
            self.noise[which],
            later=later,
        )
        if rows is None:
            return None
        settled = rows["tau"][int(0.4 * self.loop.rate) :]
        change = np.abs(np.diff(settled, axis=0)).mean(axis=0)
        # a chattering command is no healthy loop, even if the arm stays near its reference
        if (change / self.context.deviation).max() > RESTLESS:
            return None
        return {name: series[:: self.thin] for name, series in rows.items()}

    def gap(self, rows: Columns) -> tuple[np.ndarray, np.ndarray]:
        """Gap of a recording of the held-out motion [N m], (M, n), and the scale it is measured by, (n,)."""
        predicted = nominal_torque(self.model, sheet_of(self.arm), rows["t"], rows["q"])
        return residual(rows["tau"], predicted, self.loop.rate / self.thin)

    def signature(self, causes: Sequence[Cause]) -> np.ndarray | None:
        """RMS of what causes add to the gap on the held-out motion, over the healthy twin's floor, (n,)."""
        rows = self.run(self.plant(causes), -1)
        if rows is None:
            return None
        gap, _ = self.gap(rows)
        return rms(gap - self.twin) / self.floor


def draw_setup(conditions: Conditions, rng: np.random.Generator) -> CaseSetup | None:
    """The setup of a case; ``None`` if its healthy twin does not run well.

    The order of the draws is part of what a seed means.
    """
    arm = draw_arm(conditions.robot, rng)
    model = model_of(arm.urdf)
    motions, kinds = _motions(arm, conditions, rng)
    postures = arm.home + rng.uniform(-1, 1, (20, arm.n)) * arm.half
    inertia = inertia_diagonal(model, postures).mean(axis=0)
    torques = [_nominal_torque(arm, model, motion) for motion in motions]
    loop = _draw_loop(arm, inertia, torques, conditions, rng)
    healthy = _draw_healthy(arm.n, conditions.noise, rng)
    ahead = [
        _feedforward(loop.feedforward, model, motion, torque)
        for motion, torque in zip(motions, torques, strict=True)
    ]
    noise = [healthy.noise * rng.standard_normal(motion.q.shape) for motion in motions]
    believed = arm.root
    if conditions.inertials_off:
        perturb_inertials(believed, conditions.inertials_off, rng)
    setup = CaseSetup(
        arm=arm,
        loop=loop,
        healthy=healthy,
        model=model,
        believed=believed,
        motions=motions,
        kinds=kinds,
        ahead=ahead,
        noise=noise,
        thin=conditions.loop_rate // conditions.rate,
        context=_context(
            arm,
            model,
            motions,
            torques[-1],
            inertia,
            conditions,
            healthy.encoder_step,
        ),
        # measured below, on the setup itself
        floor=np.zeros(arm.n),
        twin=np.zeros(arm.n),
    )
    rows = setup.run(setup.plant(()), -1)
    if rows is None:
        return None
    twin, _ = setup.gap(rows)
    return replace(setup, twin=twin, floor=rms(twin))


def _draw_healthy(n: int, noise: float, rng: np.random.Generator) -> HealthyArm:
    """The small imperfections of a healthy arm of n joints; ``noise`` is a factor on that of the encoders [1]."""
    return HealthyArm(
        step=STEP,
        encoder_step=2 * np.pi / 2 ** int(rng.integers(16, 20)),
        noise=rng.uniform(0.5e-5, 2.2e-5) * noise,
        stribeck=rng.uniform(0.03, 0.15, n),
        knee=rng.uniform(0.01, 0.06, n),
        presliding=10 ** rng.uniform(-4.7, -4.0),
        bend=rng.uniform(0.94, 1.0, n),
    )


def sheet_of(arm: Arm) -> dict[str, np.ndarray]:
    """Armature, Coulomb and viscous friction of the data sheet, each (n,)."""
    return {"armature": arm.armature, "coulomb": arm.coulomb, "viscous": arm.viscous}


def _nominal_torque(arm: Arm, model: Any, motion: Motion) -> np.ndarray:
    """Torque that the nominal arm needs for a reference [N m], (N, n)."""
    rigid = _rigid_torque(model, motion)
    rotors = arm.armature * motion.ddq
    dry = arm.coulomb * np.tanh(motion.dq / KNEE)
    return rigid + rotors + dry + arm.viscous * motion.dq


def _rigid_torque(
    model: Any, motion: Motion, *, gravity_only: bool = False
) -> np.ndarray:
    """Torque of the rigid bodies along a reference [N m], (N, n): at 200 Hz, between them by cubic splines."""
    last = len(motion.t) - 1
    every = max(1, round(0.005 / motion.t[1]))
    rows = np.unique(np.append(np.arange(0, last + 1, every), last))
    q, dq, ddq = motion.q[rows], motion.dq[rows], motion.ddq[rows]
    if gravity_only:
        dq, ddq = 0 * dq, 0 * ddq
    torque = inverse_dynamics(model, q, dq, ddq)
    return CubicSpline(motion.t[rows], torque)(motion.t)


def _motions(
    arm: Arm, conditions: Conditions, rng: np.random.Generator
) -> tuple[list[Motion], list[str]]:
    """The recordings' motions: slow, faster, then others; the last, held-out one is no faster than the fastest."""
    others = [str(kind) for kind in rng.permutation(["point_to_point", "crawl"])]
    faster = str(rng.choice(["fast", "middle"]))
    kinds = ["slow", faster, *others][: conditions.recordings]
    kinds.append(kinds[1] if rng.uniform() < 0.6 else "middle")
    lengths = np.round(rng.uniform(*conditions.duration, len(kinds)), 1)
    lengths[-1] = min(lengths[-1], 10.0)
    motions = [
        draw_motion(kind, arm, float(length), conditions.loop_rate, rng)
        for kind, length in zip(kinds, lengths, strict=True)
    ]
    return motions, kinds


def _draw_loop(
    arm: Arm,
    inertia: np.ndarray,
    torques: list[np.ndarray],
    conditions: Conditions,
    rng: np.random.Generator,
) -> Loop:
    """A PD controller of 3 to 4.5 Hz bandwidth whose limit lies well above what the motions need."""
    w = rng.uniform(20, 28)
    damping = rng.uniform(0.8, 1.0)
    kp = (inertia + arm.armature) * w**2 * rng.uniform(0.85, 1.15, arm.n)
    kd = 2 * damping / w * kp
    needed = np.max([np.abs(torque).max(axis=0) for torque in torques], axis=0)
    # room for the damping of an error of 0.5 rad/s
    limit = needed * rng.uniform(2.5, 3.5) + kd * 0.5
    return Loop(
        rate=float(conditions.loop_rate),
        kp=kp,
        kd=kd,
        limit=limit,
        cutoff=float(rng.choice([50.0, 80.0, 120.0])),
        damping=float(rng.choice([0.7, 0.9, 1.0])),
        feedforward=str(rng.choice(["none", "gravity", "nominal"], p=[0.2, 0.3, 0.5])),
    )


def _feedforward(
    kind: str, model: Any, motion: Motion, torque: np.ndarray
) -> np.ndarray:
    """Feedforward of a kind [N m], (N, n); ``torque`` is that of the nominal arm."""
    if kind == "nominal":
        return torque
    if kind == "gravity":
        return _rigid_torque(model, motion, gravity_only=True)
    return np.zeros_like(motion.q)


def _context(
    arm: Arm,
    model: Any,
    motions: list[Motion],
    torque: np.ndarray,
    inertia: np.ndarray,
    conditions: Conditions,
    encoder_step: float,
) -> LawContext:
    held_out = motions[-1]
    deviation = torque.std(axis=0)
    return LawContext(
        arm=arm,
        deviation=np.maximum(deviation, 0.05 * deviation.max()),
        peak=np.abs(torque).max(axis=0),
        speed=rms(held_out.dq),
        inertia=inertia,
        swing=np.ptp(held_out.q, axis=0),
        middle=held_out.q.mean(axis=0),
        tip=tip_path(model, np.vstack([motion.q[::20] for motion in motions])),
        shortest=float(min(motion.t[-1] for motion in motions)),
        loop_rate=float(conditions.loop_rate),
        rate=float(conditions.rate),
        encoder_step=encoder_step,
    )
