"""Validation on other motions: an arm identified on Fourier motions, judged on others, in PyBullet and MuJoCo.

    .venv/bin/python experiments/22_other_motions.py

A KUKA iiwa with a payload and with more friction than its data sheet says is recorded on four Fourier motions of 0.1 to
0.25 Hz, and identified without being told of either. It is judged on a Fourier motion of 0.37 Hz, on picking, on
placing and on welding a seam. Printed for each motion: RMS residual over RMS torque of the nominal and of the
identified arm and the largest error, over every sample and over those at which the joint is faster than 0.05 rad/s;
then RMSE and relative error per joint. ``--out FILE.md`` writes the tables.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from gapscope.arm.case import Case
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.io.atomic_write import atomic_write
from gapscope.arm.motions.named_motions import Workspace, draw_motion, workspace
from gapscope.arm.motions.trajectory import Fourier, ReferenceMotion
from gapscope.arm.recording import Recording
from gapscope.effects.applied import AppliedEffect
from gapscope.envs.mystery_arm import iiwa
from gapscope.envs.position_controller import position_controller
from gapscope.envs.recorder import record
from gapscope.ident.identification import (
    Identification,
    IdentificationSettings,
    identify,
)
from gapscope.ident.signals.samples import Band
from gapscope.ident.uncertainty.validation import Errors, Validation, validate

ENGINES = ("pybullet", "mujoco")
FREQUENCIES = (0.1, 0.15, 0.2, 0.25)
"""Base frequencies of the motions that are fitted [Hz]; each has harmonics up to the fifth."""
OTHER = 0.37
"""That of the Fourier motion to judge [Hz]."""
MOTIONS = ("pick", "place", "weld_seam")
DURATION, CUTOFF = 10.0, 20.0
EFFECTS = (
    AppliedEffect("payload", (), {"mass": 2.0, "com": [0.02, 0.01, 0.08]}),
    AppliedEffect("viscous_friction", (1, 2, 4), {"coefficient": [2.0, -1.5, 1.0]}),
    AppliedEffect("coulomb_friction", (2, 4, 6), {"torque": [2.0, 1.5, 0.5]}),
)
"""What the arm has and its data sheet does not."""


def references(
    space: Workspace, rng: np.random.Generator
) -> dict[str, ReferenceMotion]:
    """The motions by name, those to fit first."""
    fourier = {
        f"fourier {frequency:g} Hz": Fourier.random(
            rng,
            space.limits,
            duration=DURATION,
            centre=space.posture,
            frequency=frequency,
            ramp=1.0,
        )
        for frequency in (*FREQUENCIES, OTHER)
    }
    return fourier | {name: draw_motion(name, rng, space, DURATION) for name in MOTIONS}


def recorded(engine: str, seed: int) -> Case:
    """A case with all motions, those that are not fitted named as such."""
    arm, rng = iiwa(), np.random.default_rng(seed)
    space = workspace(RigidBody(arm))
    controller = position_controller(arm, space.posture)
    recordings = [
        record(
            arm,
            EFFECTS,
            motion,
            controller,
            duration=DURATION,
            rng=rng,
            torque_noise=0.05,
            name=name,
            engine=engine,
        )
        for name, motion in references(space, rng).items()
    ]
    return Case(engine, Path(), arm, tuple(recordings), controller=controller)


def judged(result: Identification, recording: Recording) -> Validation:
    """The identified and the nominal arm on one recording."""
    band, law, columns = Band(CUTOFF), result.choice.law, result.columns
    nominal = columns.nominal(law)
    return validate(
        "judge",
        band.segments([recording]),
        band,
        lambda segment: result.predict(segment.motion),
        lambda segment: columns.matrix(segment.motion, law) @ nominal,
    )


def largest(errors: Errors) -> str:
    """The largest error and its joint."""
    joint = int(errors.largest.argmax())
    return f"{errors.largest[joint]:.2f} (joint {joint + 1})"


def summary(engine: str, motion: str, found: Validation) -> list[str]:
    """A row about one motion."""
    return [
        engine,
        motion,
        f"{found.nominal.overall:.1%}",
        f"{found.every.overall:.1%}",
        f"{found.moving.overall:.1%}",
        largest(found.every),
        largest(found.moving),
    ]


def joints(engine: str, motion: str, found: Validation) -> list[str]:
    """RMSE [N m] and relative error of each joint, over every sample / where it moves."""
    pairs = zip(
        found.every.rmse,
        found.every.relative,
        found.moving.rmse,
        found.moving.relative,
        strict=True,
    )
    return [
        engine,
        motion,
        *(f"{a:.2f}, {b:.1%} / {c:.2f}, {d:.1%}" for a, b, c, d in pairs),
    ]


def table(head: list[str], rows: list[list[str]]) -> str:
    """A table in Markdown."""
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    return "\n".join(lines + ["| " + " | ".join(cells) + " |" for cells in rows])


def main() -> None:
    """Record, identify, judge."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=None)
    options = parser.parse_args()
    found: list[tuple[str, str, Validation]] = []
    for engine in ENGINES:
        case = recorded(engine, options.seed)
        others = case.recordings[len(FREQUENCIES) :]
        result = identify(
            case,
            IdentificationSettings(
                cutoff=CUTOFF, judge=tuple(recording.name for recording in others)
            ),
        )
        found += [
            (engine, recording.name, judged(result, recording)) for recording in others
        ]
        found.append((engine, "those fitted", result.validation[0]))
    head = [
        "engine",
        "motion",
        "nominal",
        "every",
        "moving",
        "largest error [N m]",
        "moving [N m]",
    ]
    columns = [
        "engine",
        "motion",
        *(f"joint {j + 1}" for j in range(found[0][2].torque.shape[1])),
    ]
    text = "\n\n".join(
        [
            table(head, [summary(*x) for x in found]),
            table(columns, [joints(*x) for x in found]),
        ]
    )
    print(text)
    if options.out:
        with atomic_write(options.out) as aside:
            aside.write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
