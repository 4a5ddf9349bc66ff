"""Mended cases: every fault of the set-up made in recordings, diagnosed, mended, measured, and diagnosed once more.

    .venv/bin/python experiments/39_mended_cases.py --out out/mended

A KUKA iiwa without an effect is recorded by PyBullet with 1 % of noise on the torque. Each fault of the catalogue, in
each of its variants, is made in the recordings, the case is written, diagnosed, and its mended case measured and looked
through for faults. Printed: what the diagnosis finds, the largest torque NRMSE before, of the mended case and of the
sound one, and the faults that the mended case still has. Faults and their repair share their definitions: a recovery
check. A run that was interrupted goes on.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np

import gapscope
from gapscope.arm.case import Case, load_case
from gapscope.arm.errors import GapscopeError
from gapscope.arm.io.json_file import read_json, write_json
from gapscope.arm.io.write_case import write_case
from gapscope.diagnosis.setup_faults.detection import find_setup_faults
from gapscope.effects.setup_faults.channel_faults import (
    JointSwap,
    SignFlip,
    UnitMismatch,
    ZeroOffset,
)
from gapscope.effects.setup_faults.fault import Fault
from gapscope.effects.setup_faults.fault_catalogue import FAULTS
from gapscope.effects.setup_faults.inertial_fault import ShiftedInertials
from gapscope.effects.setup_faults.time_stamp_fault import TimeStamps
from gapscope.effects.setup_faults.torque_faults import (
    GravityCompensatedTorque,
    LateTorque,
    TorqueUnit,
)
from gapscope.envs.mystery_arm import iiwa
from gapscope.envs.recorder import Plan, record_case

MADE: dict[str, Fault] = {
    "torque turned": SignFlip((4,)),
    "position turned": SignFlip((4,), "position"),
    "joint turned": SignFlip((2,), "joint"),
    "torques exchanged": JointSwap((3, 4)),
    "joints exchanged": JointSwap((2, 3), "joint"),
    "degrees": UnitMismatch("degrees"),
    "milliseconds": UnitMismatch("milliseconds"),
    "motor side": UnitMismatch("motor_side", ratio=100.0),
    "inertials shifted": ShiftedInertials(1),
    "zero off": ZeroOffset((2,), np.pi / 2),
    "gravity left out": GravityCompensatedTorque(),
    "currents": TorqueUnit("current", factor=(12.0,) * 4 + (8.0,) * 3),
    "command scaled": TorqueUnit("command_scale", (1, 2), (0.25,)),
    "torque late": LateTorque("delay", 0.06),
    "torque filtered": LateTorque("filter", 0.06),
    "wrong rate": TimeStamps("wrong_rate", 2.0),
    "jitter": TimeStamps("jitter", 0.2),
    "repeats": TimeStamps("repeats", 0.05),
    "gaps": TimeStamps("gaps", 0.05),
}
"""Each fault of the catalogue in each of its variants, with values as real set-ups have them."""


def sound(file: Path) -> Case:
    """The case without a fault, recorded once."""
    if not file.exists():
        case = record_case("sound", iiwa(), (), Plan(), np.random.default_rng(39))
        write_case(case, file.parent)
    return load_case(file)


def spoilt(case: Case, fault: Fault) -> Case:
    """The case as a set-up with the fault would have written it."""
    return fault.in_case(case, np.random.default_rng(0), case.arm)


def largest_gap(case: Case | Path) -> float | None:
    """Largest torque NRMSE of a joint in a recording [1]; ``None`` if it cannot be measured."""
    try:
        return float(gapscope.gap(case).to_frame()["torque_nrmse"].max())
    except GapscopeError:
        return None


def found(document: Any) -> tuple[list[str], list[str]]:
    """The faults and the effects that a diagnosis found, in words."""
    words: tuple[list[str], list[str]] = ([], [])
    for effect in document["effects"]:
        variant = f" ({effect['variant']})" if effect.get("variant") else ""
        joints = "".join(f" J{j}" for j in effect["joints"])
        words[effect["effect"] not in FAULTS].append(
            effect["effect"] + variant + joints
        )
    return words


def tried(label: str, folder: Path, case: Case) -> None:
    """Make, diagnose, mend and diagnose one fault, unless that was done."""
    file = folder / f"{label.replace(' ', '_')}.json"
    if file.exists():
        return
    place = folder / label.replace(" ", "_")
    bad = write_case(spoilt(case, MADE[label]), place, overwrite=True)
    first = gapscope.diagnose(bad)
    first.save(place / "results")
    mended = place / "results" / "mended_case.yaml"
    content: dict[str, Any] = {"fault": label, "first": found(first.document)}
    content["before"] = largest_gap(bad)
    if mended.exists():
        content["after"] = largest_gap(mended)
        content["second"] = [str(f) for f in find_setup_faults(load_case(mended))]
    write_json(content, file)
    print(line(content), flush=True)


def line(content: dict[str, Any]) -> str:
    """One row of the table."""

    def number(key: str) -> str:
        value = content.get(key)
        return "-" if value is None else f"{value:.3g}"

    faults, effects = content["first"]
    first = "; ".join([*faults, *effects]) or "nothing"
    second = "no mended case"
    if "second" in content:
        second = "; ".join(content["second"]) or "nothing"
    gaps = f"{number('before')} | {number('after')}"
    return f"| {content['fault']} | {first} | {gaps} | {second} |"


def main() -> None:
    """Try all faults and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("out/mended"))
    parser.add_argument("--only", nargs="*", choices=list(MADE), default=list(MADE))
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    case = sound(args.out / "sound" / "case.yaml")
    for label in args.only:
        tried(label, args.out, case)
    print(f"largest NRMSE of the sound case: {largest_gap(case):.3g}")
    print("| fault | found | NRMSE before | mended | faults left |")
    print("|---|---|---|---|---|")
    for file in sorted(args.out.glob("*.json")):
        print(line(read_json(file, "remove it")))


if __name__ == "__main__":
    main()
