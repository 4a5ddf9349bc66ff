"""Set-up faults of references, gains, zeros and gravity put into recordings: found or not, and false alarms.

    GAPSCOPE_DATA=.../data .venv/bin/python experiments/37_reference_faults.py [--part references] [--out out/faults]

``references``: faults of references, velocities and gains in simulated arms (the project's simulator, with and without
feedforward and ordinary effects; arms of the blind check's generator, another simulator, each with two effects of its
own) and in real recordings with references, all as they are and with noise added, with the torque and by the commands
alone. ``zeros``: each joint of simulated and real arms counted from another zero. ``gravity``: the case states a
gravity turned against the true one, and the whole diagnosis has to name the turn.

Faults are made by the formulas with which they are put right: finding them is a recovery check. What is measured is
whether they are told apart, from each other, from the effects of an arm, and from nothing.
"""

from __future__ import annotations

import argparse
import csv
import os
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import yaml
from generator_arms import ARMS, GeneratorArm

from gapscope.arm.case import Case, load_case
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.motions.named_motions import workspace
from gapscope.arm.recording import Recording
from gapscope.diagnosis.diagnose import diagnose
from gapscope.diagnosis.setup_faults.detection import find_setup_faults
from gapscope.diagnosis.setup_faults.references.detection import find_reference_faults
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.catalogue import CATALOGUE
from gapscope.effects.environment import tilt
from gapscope.effects.setup_faults.channel_faults import ZeroOffset
from gapscope.effects.setup_faults.controller_faults import (
    GainMismatch,
    UnmeasuredTorque,
)
from gapscope.effects.setup_faults.fault import Fault
from gapscope.effects.setup_faults.reference_faults import (
    CoarseReference,
    IgnoredVelocityReference,
    SpeedScaling,
    VelocityOfReference,
)
from gapscope.envs.mystery_arm import iiwa
from gapscope.envs.position_controller import position_controller
from gapscope.envs.recorder import Plan, record_case

CASES = Path(__file__).parent / "cases"
FAULTS: dict[str, Fault] = {
    "velocity_of_reference": VelocityOfReference(),
    "ignored_velocity_reference": IgnoredVelocityReference(),
    "speed_scaling 0.5": SpeedScaling(0.5),
    "speed_scaling 0.9": SpeedScaling(0.9),
    "coarse_reference held 0.04": CoarseReference("held", 0.04),
    "coarse_reference held 0.1": CoarseReference("held", 0.1),
    "coarse_reference interpolated 0.1": CoarseReference("interpolated", 0.1),
    "gain_mismatch 3, 0.4": GainMismatch((3.0,), (0.4,)),
    "gain_mismatch 1, 2": GainMismatch((1.0,), (2.0,)),
    "unmeasured_torque 80, 2.5": UnmeasuredTorque((80.0,), (2.5,)),
}
NOISE = {"as it is": (0.0, 0.0), "noise": (0.05, 2e-4)}
"""Added to the torque, over its deviation [1], and to positions [rad]."""
ANGLES = (-90.0, 60.0, 180.0)
"""Zeros are off by so much [deg]."""
TURNS = ((180.0, 0.0), (135.0, 0.0), (-50.0, 35.0))
"""Roll and pitch of the gravity that a case states [deg]."""
ORDINARY = (
    AppliedEffect("coulomb_friction", (2, 4), {"torque": [6.0, 4.0]}),
    AppliedEffect("payload", (), {"mass": 2.0, "com": [0.0, 0.0, 0.1]}),
    AppliedEffect("actuator_delay", tuple(range(1, 8)), {"delay": [0.01] * 7}),
)


def simulated(feedforward: str, effects: tuple[AppliedEffect, ...], name: str) -> Case:
    """A kuka_iiwa in the project's simulator."""
    arm = iiwa()
    posture = workspace(RigidBody(arm)).posture
    controller = position_controller(arm, posture, bandwidth=3.0)
    controller = replace(controller, feedforward=feedforward)
    plan = Plan(recordings=3, duration=6.0, encoder_noise=2e-5)
    rng = np.random.default_rng(37)
    return record_case(name, arm, effects, plan, rng, controller=controller)


def real(name: str, data: Path, **columns: str) -> Case:
    """A case of ``experiments/cases``, with further columns of its logs."""
    if not columns:
        return load_case(CASES / f"{name}.yaml", data_root=data)
    content = yaml.safe_load((CASES / f"{name}.yaml").read_text(encoding="utf-8"))
    content["import"] |= columns
    # the other recording holds commands of 1e38
    content["recordings"] = content["recordings"][1:]
    with TemporaryDirectory() as folder:
        file = Path(folder) / "case.yaml"
        file.write_text(yaml.safe_dump(content), encoding="utf-8")
        return load_case(file, data_root=data)


def with_references(data: Path | None, folder: Path) -> Iterator[Case]:
    """All cases that have references."""
    yield simulated("nominal", (), "iiwa, feedforward")
    yield simulated("none", (), "iiwa, PD alone")
    yield simulated("nominal", ORDINARY, "iiwa, feedforward, effects")
    yield simulated("none", ORDINARY, "iiwa, PD alone, effects")
    for number, (robot, _) in enumerate(ARMS):
        target = folder / f"generator_{number}"
        GeneratorArm(number).write(target)
        yield replace(load_case(target / "case"), name=f"generator, {robot}")
    if data is not None:
        yield real("unitree_z1", data)
        yield real("so101", data)
        commands = {"q_ref": "PositionCmptd{j}", "dq_ref": "VelocityCmptd{j}"}
        yield replace(real("kinova_gen3_current", data, **commands), name="kinova_gen3")


def noisy(case: Case, torque: float, position: float, rng: np.random.Generator) -> Case:
    """The case with more noise on torque and positions."""

    def changed(r: Recording) -> Recording:
        q = r.q + position * rng.standard_normal(r.q.shape)
        if r.tau is None:
            return replace(r, q=q)
        deviation = torque * r.tau.std(axis=0)
        return replace(r, q=q, tau=r.tau + deviation * rng.standard_normal(q.shape))

    return replace(case, recordings=tuple(map(changed, case.recordings)))


def with_fault(case: Case, fault: Fault) -> Case | None:
    """The case with a fault; ``None`` if it cannot have it."""
    try:
        return fault.in_case(case, np.random.default_rng(0), case.arm)
    except InputError:
        return None


def references_part(
    data: Path | None, folder: Path
) -> Iterator[tuple[str, str, str, str]]:
    """Case, how it was given, fault, and what was found."""
    for case in with_references(data, folder):
        for noise, sizes in NOISE.items():
            changed = noisy(case, *sizes, np.random.default_rng(1))
            bare = tuple(replace(r, tau=None) for r in case.recordings)
            given = {f"torque, {noise}": changed}
            if noise == "as it is" and case.controller is not None:
                given["commands alone"] = replace(case, recordings=bare)
            for how, one in given.items():
                yield case.name, how, "none", _names(one)
                for label, fault in FAULTS.items():
                    no_torque = "torque" not in how or one.recordings[0].tau is None
                    if no_torque and isinstance(fault, UnmeasuredTorque):
                        continue
                    spoilt = with_fault(one, fault)
                    if spoilt is not None:
                        yield case.name, how, label, _names(spoilt)


def _names(case: Case) -> str:
    """Faults found, with their first parameter."""
    _, faults = find_reference_faults(case)
    words = []
    for fault in faults:
        values = [v for p in fault.parameters.values() for v in p.value[:1]]
        numbers = ", ".join(f"{v:.3g}" for v in values)
        words.append(f"{fault.name} {fault.variant} {numbers}".strip())
    return "; ".join(words) or "none"


def zeros_part(data: Path | None, folder: Path) -> Iterator[tuple[str, str, str, str]]:
    """Each joint of each arm counted from another zero."""
    cases = [simulated("nominal", ORDINARY, "iiwa, effects")]
    if data is not None:
        names = ("ur10", "panda", "kinova_gen3_current")
        cases += [real(name, data) for name in names]
    for case in cases:
        yield case.name, "", "none", _zeros(case)
        for joint in range(1, case.arm.n_joints + 1):
            for angle in ANGLES:
                fault = ZeroOffset((joint,), float(np.deg2rad(angle)))
                spoilt = with_fault(case, fault)
                assert spoilt is not None
                label = f"zero_offset {joint} {angle:g}"
                yield case.name, f"joint {joint}", label, _zeros(spoilt)


def _zeros(case: Case) -> str:
    words = []
    for fault in find_setup_faults(case):
        offset = fault.parameters.get("offset")
        joints = ", ".join(map(str, fault.joints))
        angle = "" if offset is None else f" {np.rad2deg(offset.value[0]):.1f}"
        words.append(f"{fault.name} {joints}{angle}")
    return "; ".join(words) or "none"


def gravity_part(
    data: Path | None, folder: Path
) -> Iterator[tuple[str, str, str, str]]:
    """Gravity that the case states turned against the true one."""
    cases = [simulated("nominal", ORDINARY, "iiwa, effects")]
    if data is not None:
        cases += [real(name, data) for name in ("ur10", "panda")]
    for case in cases:
        for roll, pitch in TURNS:
            turn = tilt(np.deg2rad(roll), np.deg2rad(pitch))
            arm = replace(case.arm, gravity=turn @ case.arm.gravity)
            document = diagnose(replace(case, arm=arm)).document
            found = {e["effect"]: e["parameters"] for e in document["effects"]}
            words = [name for name in found if name != "base_tilt"]
            if "base_tilt" in found:
                angles = (found["base_tilt"][k]["value"] for k in ("roll", "pitch"))
                degrees = " ".join(f"{np.rad2deg(a):.1f}" for a in angles)
                words.insert(0, f"base_tilt {degrees}")
            label = f"base_tilt {roll:g} {pitch:g}"
            yield case.name, "", label, "; ".join(words) or "none"


PARTS: dict[str, Callable[..., Iterator[tuple[str, str, str, str]]]] = {
    "references": references_part,
    "zeros": zeros_part,
    "gravity": gravity_part,
}


def outcome(fault: str, found: str) -> str:
    """``found`` (alone, or ``found with another``), ``not found``, ``wrong name``; ``healthy``, ``false alarm``."""
    if fault == "none":
        return "healthy" if found == "none" else "false alarm"
    names = {words.split()[0] for words in found.split("; ")}
    others = names - {fault.split()[0]} - set(CATALOGUE)
    if fault.split()[0] in names:
        return "found with another" if others else "found"
    return "not found" if found == "none" else "wrong name"


def main() -> None:
    """Print each result and the counts by fault; write them as a table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--part", choices=PARTS, action="append")
    parser.add_argument("--out", type=Path, default=Path("out/reference_faults"))
    options = parser.parse_args()
    data = Path(os.environ["GAPSCOPE_DATA"]) if "GAPSCOPE_DATA" in os.environ else None
    options.out.mkdir(parents=True, exist_ok=True)
    for part in options.part or PARTS:
        counts: Counter[tuple[str, str, str]] = Counter()
        with (
            TemporaryDirectory() as folder,
            (options.out / f"{part}.csv").open(
                "w", newline="", encoding="utf-8"
            ) as file,
        ):
            table = csv.writer(file)
            table.writerow(["case", "given", "fault", "found", "outcome"])
            for case, given, fault, found in PARTS[part](data, Path(folder)):
                result = outcome(fault, found)
                table.writerow([case, given, fault, found, result])
                print(
                    f"{case:28} {given:20} {fault:34} {result:12} {found}", flush=True
                )
                counts[given, fault, result] += 1
        print()
        for (given, fault, result), count in sorted(counts.items()):
            print(f"| {given} | {fault} | {result} | {count} |")


if __name__ == "__main__":
    main()
