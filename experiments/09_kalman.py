"""Following a change: payloads picked up in mid-recording, recordings without change, and friction that warms up.

A simulated KUKA iiwa with rotors, friction, noise on encoders and torque, and in every second recording Stribeck and
load friction that the model lacks, follows another random Fourier motion of 10 s in each recording, in PyBullet and
MuJoCo by turns. Base parameters are unknown to the search throughout.

Tables: (1) per recording the moment and the mass of the pick-up, as the contrast finds them (what changed before and
after, ``gapscope.model.changes``), and when the sequential alarm sounds; (2) what either says of recordings without
change; (3) recursive against batch
estimates; (4) the time constant of friction that warms up; (5) with ``--unscented N``, when the alarm sounds on the
innovations of the unscented filter, over the first N recordings of each kind. ``--out FILE.md`` writes the tables.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import track as progress

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.io.atomic_write import atomic_write
from gapscope.arm.motions.trajectory import Fourier, urdf_limits
from gapscope.arm.recording import Recording
from gapscope.effects.applied import AppliedEffect
from gapscope.envs.engines import installed
from gapscope.envs.mystery_arm import POSTURE, iiwa
from gapscope.envs.position_controller import position_controller
from gapscope.envs.recorder import record
from gapscope.ident.estimators.wls import WeightedLeastSquares
from gapscope.ident.kalman.alarm import alarm
from gapscope.ident.kalman.change_hypothesis import (
    ChangeHypothesis,
    payload_hypothesis,
)
from gapscope.ident.kalman.drift import fit_warming
from gapscope.ident.kalman.recursive import Recursive
from gapscope.ident.kalman.unscented import Unscented
from gapscope.ident.model.assembly import Assembly
from gapscope.ident.model.base_parameters import structural_base
from gapscope.ident.model.regressor import Regressor
from gapscope.model.changes import Change, changes_of

ENGINES = tuple(name for name in ("pybullet", "mujoco") if installed(name))
DURATION = 10.0
WARMING = 40.0
"""Length of a recording while friction warms up [s]."""
LEARNT = 2.0
"""Length of the stretch from which the alarm's filter knows the noise [s]."""
LACKED = (
    AppliedEffect(
        "stribeck_friction",
        (1, 2, 3, 4),
        {"torque": [0.8, 0.8, 0.5, 0.5], "velocity": [0.1] * 4},
    ),
    AppliedEffect("load_friction", (2, 4), {"coefficient": [0.05, 0.05]}),
)
"""What the arm has in every second recording, and the model lacks."""


@dataclass(frozen=True)
class Run:
    """One recording: what was done, and what was found."""

    label: str
    moment: float | None
    mass: float
    changes: tuple[Change, ...]
    heard: float | None
    nearest: float
    agreement: float


class Bench:
    """The arm, its model and what is looked for."""

    def __init__(self) -> None:
        self.arm = iiwa()
        self.controller = position_controller(self.arm, POSTURE)
        regressor = Regressor(self.arm)
        self.base = structural_base(regressor, np.random.default_rng(0))
        self.assembly = Assembly(regressor, self.base, position_cutoff=20.0, every=10)
        self.payload = payload_hypothesis(self.base, self.arm.n_joints)

    def recorded(
        self,
        rng: np.random.Generator,
        engine: str,
        effects: tuple[AppliedEffect, ...],
        later: tuple[float, tuple[AppliedEffect, ...]] | None,
        duration: float = DURATION,
    ) -> Recording:
        """A recording of another motion."""
        limits = urdf_limits(RigidBody(self.arm), 6.0)._replace(
            velocity=np.full(self.arm.n_joints, 1.3)
        )
        frequency = rng.uniform(0.1, 0.25)
        motion = Fourier.random(
            rng, limits, duration=duration, centre=POSTURE, frequency=frequency
        )
        return record(
            self.arm,
            effects,
            motion,
            self.controller,
            duration=duration,
            rng=rng,
            rate=500.0,
            encoder_noise=2e-5,
            torque_noise=0.1,
            engine=engine,
            later=later,
        )

    def drawn(self, seed: int, pickup: bool) -> tuple[Recording, float, float]:
        """A recording, the moment at which something is picked up [s], and its mass [kg]."""
        rng = np.random.default_rng([seed, int(pickup)])
        engine, lacked = self.kind(seed)
        moment, mass = float(rng.uniform(2.5, 7.5)), float(rng.uniform(0.5, 3.0))
        com = np.append(rng.uniform(-0.05, 0.05, 2), rng.uniform(0.0, 0.1))
        load = AppliedEffect("payload", (), {"mass": np.array(mass), "com": com})
        return (
            self.recorded(
                rng, engine, lacked, (moment, (*lacked, load)) if pickup else None
            ),
            moment,
            mass,
        )

    @staticmethod
    def kind(seed: int) -> tuple[str, tuple[AppliedEffect, ...]]:
        """Engine of a recording, and what its arm has beyond the model."""
        return ENGINES[seed // 2 % len(ENGINES)], LACKED if seed % 2 else ()

    def run(self, seed: int, pickup: bool) -> Run:
        """Record, search, listen; the alarm knows the noise of the first ``LEARNT`` seconds."""
        recording, moment, mass = self.drawn(seed, pickup)
        engine, lacked = self.kind(seed)
        problem, t = self.assembly([recording]), self.assembly.times(recording)
        batch = WeightedLeastSquares().estimate(problem)
        recursive = Recursive(batch.residual).follow(problem, t)
        early = WeightedLeastSquares().estimate(
            problem.rows(slice(0, int(np.searchsorted(t - t[0], LEARNT))))
        )
        heard = alarm(Recursive(early.residual).follow(problem, t), self.payload)
        return Run(
            f"{seed + 1}, {engine}{', lacks effects' if lacked else ''}",
            moment if pickup else None,
            mass,
            changes_of([recording], self.arm).during,
            heard.time,
            float(heard.statistic.max()),
            float((np.abs(recursive.value[-1] - batch.value) / batch.deviation).max()),
        )

    def heard_without_derivatives(
        self, seed: int, pickup: bool
    ) -> tuple[float | None, float | None]:
        """Moment of the pick-up [s], and when the alarm sounds on the innovations of the unscented filter [s]."""
        recording, moment, _ = self.drawn(seed, pickup)
        n = self.arm.n_joints
        names, spread = (
            tuple(f"{kind}{n}" for kind in ("m", "mx", "my", "mz")),
            np.array([0.3, 0.02, 0.02, 0.02]),
        )
        filtered = Unscented(
            Regressor(self.arm), names, spread, 0.1 * spread, 3e-5, np.full(n, 0.5)
        )
        directions = np.concatenate([np.zeros((2 * n, len(names))), np.eye(len(names))])
        track = filtered.follow(recording, every=5)
        return moment if pickup else None, alarm(
            track, ChangeHypothesis("payload", names, directions), window=0.3
        ).time

    def warming(self, seed: int) -> list[str]:
        """A row about friction that warms up."""
        rng = np.random.default_rng([seed, 2])
        joint, amplitude, constant = (
            int(rng.integers(1, 5)),
            rng.uniform(0.4, 1.0),
            rng.uniform(5.0, 20.0),
        )
        drift = AppliedEffect(
            "friction_drift",
            (joint,),
            {"amplitude": [amplitude], "time_constant": [constant]},
        )
        recording = self.recorded(
            rng, ENGINES[seed % len(ENGINES)], (drift,), None, WARMING
        )
        problem, t = self.assembly([recording]), self.assembly.times(recording)
        noise = WeightedLeastSquares().estimate(problem).residual
        walk = {
            f"b{joint}": 0.1 * self.arm.viscous[joint - 1],
            f"c{joint}": 0.1 * self.arm.coulomb[joint - 1],
        }
        value, _ = (
            Recursive(noise, drift=walk).follow(problem, t).smoothed().of(f"b{joint}")
        )
        truth = self.arm.viscous[joint - 1] * (1 + amplitude * np.exp(-t / constant))
        found = fit_warming(problem, t, tuple(walk), noise)
        spread = np.sqrt(np.diag(found.covariance))
        off = np.sqrt(np.mean((value - truth) ** 2)) / truth.mean()
        return [
            str(joint),
            f"{amplitude:.2f}",
            f"{found.amplitude:.2f} ± {spread[0]:.2f}",
            f"{constant:.1f}",
            f"{found.time_constant:.1f} ± {spread[1]:.1f}",
            f"{off:.1%}",
        ]


def row(run: Run) -> list[str]:
    """A recording with a pick-up."""
    assert run.moment is not None
    heard = "none" if run.heard is None else f"{run.heard - run.moment:+.2f}"
    load = load_of(run)
    others = ", ".join(str(c) for c in run.changes if c is not load)
    found = ["none", "", ""]
    if load is not None:
        mass = float(load.value[0])
        off = f"{load.time - run.moment:+.2f}"
        found = [off, f"{mass:.2f}", f"{mass / run.mass - 1:+.1%}"]
    return [run.label, f"{run.moment:.2f}", f"{run.mass:.2f}", *found, others, heard]


def load_of(run: Run) -> Change | None:
    """The load that was found, if any."""
    return next((change for change in run.changes if change.term.is_load), None)


def good(run: Run) -> bool:
    """Whether a pick-up was found within 0.5 s and 10 % of its mass."""
    load = load_of(run)
    if load is None or run.moment is None:
        return False
    near = abs(load.time - run.moment) <= 0.5
    return near and abs(load.value[0] / run.mass - 1) <= 0.1


def unscented(bench: Bench, seeds: range, console: Console) -> str:
    """What the alarm hears from the unscented filter, on arms whose effects the model has, and on others."""
    lines = []
    for label, own in (("has all effects", 0), ("lacks effects", 1)):
        alike = [seed for seed in seeds if seed % 2 == own]
        runs = [
            (
                bench.heard_without_derivatives(seed, True),
                bench.heard_without_derivatives(seed, False),
            )
            for seed in progress(alike, f"unscented, {label}", console=console)
        ]
        delays = [
            when - moment
            for (moment, when), _ in runs
            if when is not None and moment is not None
        ]
        soon, false = (
            sum(-0.1 < delay < 0.5 for delay in delays),
            sum(when is not None for _, (_, when) in runs),
        )
        lines.append(
            f"Alarm on the unscented filter, model {label}: {soon} of {len(alike)} pick-ups within 0.5 s, "
            f"{false} alarms in {len(alike)} recordings without change; delays "
            + ", ".join(f"{delay:.2f}" for delay in delays)
        )
    return "\n".join(lines)


def table(head: list[str], rows: list[list[str]]) -> str:
    """A table in Markdown."""
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    return "\n".join(lines + ["| " + " | ".join(cells) + " |" for cells in rows])


def followed(bench: Bench, seeds: range, console: Console) -> list[str]:
    """Pick-ups and recordings without change."""
    picked = [
        bench.run(seed, True) for seed in progress(seeds, "pick-ups", console=console)
    ]
    still = [
        bench.run(seed, False)
        for seed in progress(seeds, "without change", console=console)
    ]
    delays = [
        run.heard - run.moment
        for run in picked
        if run.heard is not None and run.moment is not None
    ]
    found, early = sum(map(good, picked)), sum(delay < -0.1 for delay in delays)
    return [
        table(
            [
                "recording",
                "moment [s]",
                "mass [kg]",
                "found off by [s]",
                "found [kg]",
                "off by",
                "further changes",
                "alarm after [s]",
            ],
            [row(run) for run in picked],
        ),
        f"{found} of {len(picked)} found within 0.5 s and 10 % of the mass. The sequential alarm sounded in "
        f"{len(delays)}, {early} of them before the pick-up, {sum(delay < 0.5 for delay in delays) - early} within "
        f"0.5 s; median delay {np.median(delays):.2f} s.",
        f"Without change: {sum(len(run.changes) for run in still)} changes found and "
        f"{sum(run.heard is not None for run in still)} alarms in {len(still)} recordings; the alarm's statistic "
        f"reached {max(run.nearest for run in still):.0%} of its threshold.",
        f"Recursive against batch (weighted least squares) without change: parameters differ by at most "
        f"{max(run.agreement for run in still):.2f} standard errors.",
    ]


def main() -> None:
    """Run, print and write the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--recordings", type=int, default=20)
    parser.add_argument(
        "--first", type=int, default=0, help="number of the first recording"
    )
    parser.add_argument("--warming", type=int, default=4)
    parser.add_argument("--unscented", type=int, default=0)
    parser.add_argument("--out", type=Path, default=None)
    options = parser.parse_args()
    bench, console = Bench(), Console()
    seeds = range(options.first, options.first + options.recordings)
    texts = followed(bench, seeds, console) if options.recordings else []
    if options.warming:
        rows = [
            bench.warming(seed)
            for seed in progress(range(options.warming), "warming", console=console)
        ]
        head = [
            "joint",
            "amplitude",
            "found",
            "time constant [s]",
            "found",
            "viscous friction followed, off by",
        ]
        texts.append(table(head, rows))
    if options.unscented:
        texts.append(
            unscented(
                bench, range(options.first, options.first + options.unscented), console
            )
        )
    text = "\n\n".join(texts)
    console.print(text, soft_wrap=True, highlight=False, markup=False)
    if options.out:
        with atomic_write(options.out) as aside:
            aside.write_text(text + "\n", encoding="utf-8")
        console.print(f"wrote {options.out}")


if __name__ == "__main__":
    main()
