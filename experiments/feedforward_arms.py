"""Arms with hidden effects, recorded, identified and diagnosed, for the experiments on feedforward and agents."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from gapscope.arm.case import load_case
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.io.write_case import write_case
from gapscope.arm.nominal import NominalArm
from gapscope.arm.robots import load_nominal_arm
from gapscope.blind_check.generator.arms import SHEETS
from gapscope.commands.diagnose_path import diagnose_path
from gapscope.effects.arm_scale import ArmScale
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.corrected_file import read_corrected, write_corrected
from gapscope.effects.residual.file import write_residual
from gapscope.envs.mystery_arm import HIDDEN, iiwa
from gapscope.envs.randomisation import Randomisation, draw_effects
from gapscope.envs.recorder import Plan as Session
from gapscope.envs.recorder import record_case
from gapscope.ident.residual.fit import fit_residual
from gapscope.ident.residual.settings import ResidualSettings
from gapscope.ident.residual.trajectory import from_segment
from gapscope.interface.identify import identify
from gapscope.model.conditioning import condition, position_cutoff

LIMITS = [87.0, 87.0, 87.0, 87.0, 12.0, 12.0, 12.0]
"""Torque limits of the Panda, as its maker states them [N m]."""


def panda() -> NominalArm:
    """Franka Panda with rotors and friction of its class, and encoders of 17 bits per turn."""
    sheet = {
        name: getattr(SHEETS["franka_panda"], name)
        for name in ("armature", "coulomb", "viscous")
    }
    return load_nominal_arm(
        "franka_panda",
        sheet={**sheet, "torque_limit": LIMITS, "encoder_step": 2 * np.pi / 2**17},
    )


ROBOTS: dict[str, Callable[[], NominalArm]] = {
    "iiwa": iiwa,
    "panda": panda,
}
MODELS = {
    "pd": "pd",
    "gravity": "gravity",
    "nominal": "nominal",
    "identified": "identified/identification.json",
    "corrected": "diagnosis/corrected.yaml",
    "corrected + network": "diagnosis/with_network.yaml",
    "truth": "truth.yaml",
}
"""Models, in a table's order, with their files; the last one is the bound."""


def prepare(robot: str, seed: int, severity: float, folder: Path) -> None:
    """Draw an arm, record it, identify and diagnose it, and train a network; what is there is left as it is."""
    arm = ROBOTS[robot]()
    if not (folder / "truth.yaml").is_file():
        rng = np.random.default_rng((16, list(ROBOTS).index(robot), seed))
        wanted = Randomisation(HIDDEN, count=(3, 3), severity=(severity, severity))
        effects = draw_effects(rng, arm, wanted, ArmScale.of(arm))
        case = record_case(f"{robot}_{seed}", arm, effects, Session(), rng)
        write_case(case, folder / "case", overwrite=True)
        write_corrected(case.name, effects, folder / "truth.yaml")
    find_models(folder)


def find_models(folder: Path) -> None:
    """Identify and diagnose the case of a folder, and train a network; what is there is left as it is."""
    if not (folder / MODELS["identified"]).is_file():
        identify(folder / "case").save(folder / "identified")
    if not (folder / "diagnosis" / "diagnosis.json").is_file():
        diagnose_path(folder / "case", folder / "diagnosis")
    if not (folder / MODELS["corrected + network"]).is_file():
        learn(folder)


def learn(folder: Path) -> None:
    """Train a network on what the diagnosis of a case leaves, and write the corrected arm with it."""
    case, effects = (
        load_case(folder / "case"),
        read_corrected(folder / MODELS["corrected"]),
    )
    corrected, body, cutoff = (
        CorrectedArm(case.arm, effects),
        RigidBody(case.arm),
        position_cutoff(case.recordings),
    )
    parts = [
        from_segment(corrected, body, s)
        for r in case.recordings
        for s in condition(r, cutoff)
    ]
    write_residual(
        fit_residual(parts, ResidualSettings())[0],
        folder / "diagnosis" / "residual.npz",
    )
    write_corrected(
        case.name, effects, folder / MODELS["corrected + network"], "residual.npz"
    )
