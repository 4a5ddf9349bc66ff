"""Cases of the blind check's generator that are diagnosed with their twins."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any, NamedTuple

from gapscope.blind_check.generator.case import make_case, write_case
from gapscope.blind_check.generator.conditions import STRONG, CaseSpec, Conditions


class Wanted(NamedTuple):
    """Robot, laws and conditions of a case."""

    robot: str
    laws: tuple[str, ...]
    rate: int = 250
    recordings: int = 2
    bare: bool = False
    inertials_off: float = 0.0
    kind: str = "single"


CASES = (
    Wanted("small", (), kind="healthy"),
    Wanted("franka_panda", (), bare=True, inertials_off=0.05, kind="healthy"),
    Wanted("ur5_like", (), rate=100, recordings=3, kind="healthy"),
    Wanted("small", ("coulomb_friction",)),
    Wanted("xarm6", ("payload",), recordings=3, inertials_off=0.03),
    Wanted("small", ("joint_elasticity",)),
    Wanted("franka_panda", ("actuator_delay",)),
    Wanted("kuka_iiwa", ("torque_scale",), rate=100, bare=True),
    Wanted("ur5_like", ("backlash",)),
    Wanted("drawn", ("torque_ripple",), recordings=3),
    Wanted("xarm6", ("encoder_offset",), rate=100, inertials_off=0.02),
    Wanted("drawn", ("external_force",), bare=True),
    Wanted("ur10_like", ("base_tilt",), recordings=3),
    Wanted("small", ("parallel_spring", "actuator_lag"), kind="pair"),
    Wanted("drawn", ("torque_offset", "viscous_friction"), bare=True, kind="pair"),
    Wanted("xarm6", ("armature", "load_friction"), kind="pair"),
    Wanted("franka_panda", ("sign_flip",), rate=100),
    Wanted("small", ("joint_swap",)),
    Wanted("small", ("hysteresis",), kind="outside"),
    Wanted("ur5_like", ("link_inertia",), inertials_off=0.02),
    Wanted("small", ("friction_drift",), rate=500),
    Wanted("small", ("actuator_lag",), rate=1000),
)
"""Robots, effects and conditions dealt out by hand, so that each occurs; sizes and joints are drawn."""
DURATION = (8.0, 10.0)
"""Shortest and longest recording [s]."""
SEED = 53


def make(number: int, folder: Path) -> Path:
    """One of ``CASES`` in a folder of its own, made unless it is there; its truth lies beside it."""
    name = f"case{number:02d}"
    place, truth = folder / name, folder / f"{name}.json"
    if truth.is_file():
        return place
    shutil.rmtree(place, ignore_errors=True)
    made = make_case(_spec(CASES[number]), (SEED, number))
    write_case(made, name, CASES[number].bare, place, folder / f"{name}.csv")
    truth.write_text(json.dumps(made.label, indent=1), "utf-8")
    return place


def applies(relation: str, number: int) -> bool:
    """Whether a relation makes a twin of a case: a joint whose columns were exchanged has no sense of its own."""
    return not (relation == "mirrored" and "joint_swap" in CASES[number].laws)


def _spec(wanted: Wanted) -> CaseSpec:
    conditions: dict[str, Any] = {
        "robot": wanted.robot,
        "inertials_off": wanted.inertials_off,
        "bare": wanted.bare,
        "rate": wanted.rate,
        "recordings": wanted.recordings,
        "duration": DURATION,
    }
    severity = None if wanted.kind == "healthy" else STRONG[1]
    return CaseSpec(wanted.kind, wanted.laws, severity, Conditions(**conditions))
