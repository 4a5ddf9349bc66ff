"""Faults of the set-up put into recordings: found or not, told apart or not, and false alarms.

    GAPSCOPE_DATA=.../data .venv/bin/python experiments/36_setup_faults.py PART [--out out/PART]

Faults are made by the formulas with which they are put right: finding them is a recovery check. What is measured is
whether they are told apart, from each other, from the effects of an arm, and from nothing. An interrupted run
of ``torque_column`` goes on.

``torque_column [--only real|generated]``: faults of the torque column. Real recordings are carriers as in
``26_real_benchmark.py``: healthy as they are, and with a fault put in. The generator's arms are simulated by MuJoCo
with other laws than the diagnosis has, nominal inertials off by a tenth; healthy ones with little and much noise, and
some with a strong ordinary effect. The gravity that a vendor's driver leaves out is that of a model whose links are
each off by a fifth. Each answer is a file; the tables are ``tables.md``.

``drawn``: faults of each kind that the torque tells, two drawn for each of the real carriers, put into it. Printed: for
each carrier and fault what was found, and how many are named, and named alone with the right joints.

``references [--part references|zeros]``: faults of references, velocities and gains in simulated arms (the
project's simulator, with and without feedforward and ordinary effects; arms of the blind check's generator, another
simulator, each with two effects of its own) and in real recordings with references, all as they are and with noise
added, with the torque and by the commands alone; and each joint of simulated and real arms counted from another zero.

``controllers``: a KUKA iiwa of PyBullet follows three motions under each control law with gains of the same bandwidth
(4 Hz), healthy and with one effect. The torque column is dropped, so that the diagnosis works with the torque that the
law must have commanded. Printed for each law: what was found with its value.
"""

from __future__ import annotations

import itertools
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from zlib import crc32

import numpy as np
import pandas as pd
import yaml
from common import CASES, DATA, command_line, kept, markdown, run_part
from generator_arms import ARMS, GeneratorArm, make_generated
from real_carriers import load_carrier

import gapscope
from gapscope.arm.case import Case, load_case
from gapscope.arm.control import LAWS
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.motions.named_motions import workspace
from gapscope.arm.recording import Recording
from gapscope.blind_check.generator.simulate import CaseSpec, Conditions
from gapscope.diagnosis.setup_faults.detection import find_setup_faults
from gapscope.diagnosis.setup_faults.references import find_reference_faults
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.setup_faults import (
    CoarseReference,
    Fault,
    GainMismatch,
    GravityCompensatedTorque,
    IgnoredVelocityReference,
    JointSwap,
    LateTorque,
    ShiftedInertials,
    SignFlip,
    SpeedScaling,
    TorqueUnit,
    UnitMismatch,
    UnmeasuredTorque,
    VelocityOfReference,
    ZeroOffset,
)
from gapscope.envs.mystery_arm import iiwa
from gapscope.envs.position_controller import position_controller
from gapscope.envs.recorder import Plan, record_case

# Faults of the torque column

REAL = ("ur10", "panda", "tx40", "kinova", "kuka")
"""Carriers; the torque of a sixth, the Z1, is computed from gains and so no measurement."""
ROBOTS = ("kuka_iiwa", "ur5_like", "franka_panda")
"""Arms of the generator."""
NOISE_FACTORS = (1.0, 3.0)
"""Factors on the noise of their encoders."""
ORDINARY_LAWS = (
    "payload",
    "torque_scale",
    "coulomb_friction",
    "base_tilt",
    "actuator_delay",
)
"""Effects that are no faults."""
SEVERITY, INERTIALS_OFF = (10.0, 20.0), 0.1
"""Gap of an ordinary effect over that of a healthy arm, and relative error of the nominal inertials [1]."""
VENDOR_OFF = 0.2
"""Relative error of each link's mass and first moments in the vendor's gravity [1]."""
NOTHING, RIGHT, OTHER, BESIDE = "nothing", "found", "other", "found beside another"
"""Kinds of answers."""


def without_gravity(case: Case, rng: np.random.Generator) -> Case:
    """Gravity left out, that of a vendor's model whose links differ from the nominal arm's."""
    body = RigidBody(case.arm)
    own = body.inertial_parameters().reshape(-1, 10)
    errors = np.zeros_like(own)
    errors[:, :4] = own[:, :4] * (VENDOR_OFF * rng.standard_normal((len(own), 1)))
    vendor = body.changed(errors)

    def spoilt(recording: Recording) -> Recording:
        still = np.zeros_like(recording.q)
        pull = vendor.inverse_dynamics(recording.q, still, still)
        return replace(recording, tau=recording.tau - pull)

    return replace(case, recordings=tuple(spoilt(r) for r in case.recordings))


TORQUE_FAULTS = {
    "gravity left out": lambda n: GravityCompensatedTorque(),
    "amperes, one constant": lambda n: TorqueUnit("current", factor=(10.0,)),
    "amperes, two sizes": lambda n: TorqueUnit("current", factor=(13.0,) * -(-n // 2) + (8.0,) * (n // 2)),
    "milliamperes": lambda n: TorqueUnit("current", factor=(0.01,)),
    "three commands times four": lambda n: TorqueUnit("command_scale", (1, 2, 3), (0.25,)),
    "late by 20 ms": lambda n: LateTorque("delay", 0.02),
    "late by 50 ms": lambda n: LateTorque("delay", 0.05),
    "late by 100 ms": lambda n: LateTorque("delay", 0.1),
    "filtered, 50 ms": lambda n: LateTorque("filter", 0.05),
}  # fmt: skip
"""Faults put in, on an arm with n joints; large motors have other constants than those of the wrist [N m/A]."""
BESIDE_ORDINARY = ("gravity left out", "amperes, one constant")
"""Faults that are put in beside ordinary effects."""
AS_IT_IS = "as it is"
MOST_JOINTS = 7
"""Joints of the largest arm."""


def real_cases(out: Path) -> Iterator[tuple[str, str, Case]]:
    """Group, name and case of the carriers."""
    for arm in REAL:
        yield "real", arm, load_carrier(arm, out / "carriers" / arm)


def generated_cases(out: Path) -> Iterator[tuple[str, str, Case]]:
    """Group, name and case of the generator's arms, written on the first run."""
    for robot in ROBOTS:
        for noise in NOISE_FACTORS:
            folder = out / "cases" / f"{robot}_{noise:g}"
            group = f"simulated, noise x{noise:g}"
            yield group, folder.name, _made(folder, robot, (), noise)
        for law in ORDINARY_LAWS:
            folder = out / "cases" / f"{robot}_{law}"
            yield "ordinary effect", folder.name, _made(folder, robot, (law,), 1.0)


def _made(folder: Path, robot: str, laws: tuple[str, ...], noise: float) -> Case:
    """A case of the generator."""
    conditions = Conditions(robot, INERTIALS_OFF, noise, bare=True, rate=250)
    kind = "single" if laws else "healthy"
    spec = CaseSpec(kind, laws, SEVERITY if laws else None, conditions)
    seed = (36, crc32(folder.name.encode()))
    make_generated(spec, seed, folder)
    return load_case(folder)


def answer(case: Case, label: str) -> dict[str, Any]:
    """What is found in a case with a fault put in."""
    rng = np.random.default_rng(crc32(f"{case.name} {label}".encode()))
    if label in TORQUE_FAULTS:
        fault = TORQUE_FAULTS[label](case.arm.n_joints)
        if isinstance(fault, GravityCompensatedTorque):
            case = without_gravity(case, rng)
        else:
            case = fault.in_case(case, rng, case.arm)
    start = time.process_time()
    found = find_setup_faults(case)
    return {
        "seconds": round(time.process_time() - start, 2),
        "found": [
            {
                "name": fault.name,
                "variant": fault.variant,
                "joints": list(fault.joints),
                "probability": round(fault.probability, 3),
                "values": {k: list(v) for k, v in fault.fault.values().items()},
            }
            for fault in found
        ],
    }


def kind(label: str, found: list[dict[str, Any]]) -> str:
    """Kind of an answer."""
    names = [(fault["name"], fault["variant"]) for fault in found]
    # what a carrier's stamps show is no matter of the torque
    names = [name for name in names if name[0] != "time_stamps"]
    if not names:
        return NOTHING
    if label not in TORQUE_FAULTS:
        return OTHER
    name, variant, _ = TORQUE_FAULTS[label](MOST_JOINTS).kind
    # a filter is found as the delay that it comes near
    if (name, "delay" if variant == "filter" else variant) not in names:
        return OTHER
    return RIGHT if len(names) == 1 else BESIDE


def tables(answers: list[dict[str, Any]]) -> str:
    """The tables: kinds of answers by fault and group, and values found."""
    groups = list(dict.fromkeys(one["group"] for one in answers))
    labels = [AS_IT_IS, *TORQUE_FAULTS]
    rows = []
    for label in labels:
        of_label = [one for one in answers if one["label"] == label]
        cells = [
            _counted(label, [x for x in of_label if x["group"] == g]) for g in groups
        ]
        rows.append([label, *cells, _ratio(label, of_label)])
    head = ("fault", *groups, "value found over value put in")
    lines = ["found, found beside another fault, other name, nothing; of so many cases"]
    lines += ["", markdown(head, rows)]
    lines += ["", "wrong names:", ""]
    for one in answers:
        what = kind(one["label"], one["found"])
        if what in (OTHER, BESIDE):
            names = [f"{f['name']} {f['variant']} {f['joints']}" for f in one["found"]]
            lines.append(f"- {one['case']}, {one['label']}: {'; '.join(names)}")
    return "\n".join(lines) + "\n"


def _counted(label: str, answers: list[dict[str, Any]]) -> str:
    if not answers:
        return "-"
    kinds = [kind(label, one["found"]) for one in answers]
    if label == AS_IT_IS:
        return f"{len(kinds) - kinds.count(NOTHING)} false of {len(kinds)}"
    counts = [str(kinds.count(x)) for x in (RIGHT, BESIDE, OTHER, NOTHING)]
    return f"{', '.join(counts)}; of {len(kinds)}"


def _ratio(label: str, answers: list[dict[str, Any]]) -> str:
    """Quartiles of the value found over the true one."""
    if label not in TORQUE_FAULTS:
        return "-"
    put_in = TORQUE_FAULTS[label](MOST_JOINTS)
    values = {value for own in put_in.values().values() for value in own}
    if len(values) != 1:
        return "-"
    (value,) = values
    ratios = [
        float(np.median(next(iter(fault["values"].values())))) / value
        for one in answers
        for fault in one["found"]
        if fault["name"] == put_in.name
    ]
    if not ratios:
        return "-"
    low, middle, high = np.percentile(ratios, (25, 50, 75))
    return f"{middle:.2f} ({low:.2f} .. {high:.2f})"


def torque_column() -> None:
    """Ask each question that has no answer yet, and write the tables."""
    options = command_line(
        torque_column.__doc__,
        out=Path("out/torque_column"),
        only={"choices": ("real", "generated")},
    ).parse_args()
    out, answers = options.out, []
    sources = {"real": real_cases, "generated": generated_cases}
    chosen = [x for name, x in sources.items() if options.only in (None, name)]
    # false alarms first: they are asked of the most cases
    for as_it_is, source in itertools.product((True, False), chosen):
        for group, name, case in source(out):
            ordinary = group == "ordinary effect"
            faults = BESIDE_ORDINARY if ordinary else tuple(TORQUE_FAULTS)
            for label in (AS_IT_IS,) if as_it_is else faults:
                file = out / "answers" / f"{name}, {label}.json"
                one = {"group": group, "case": name, "label": label}
                answers.append(one | kept(file, answer, case, label))
    (out / "tables.md").write_text(tables(answers))
    print(tables(answers))


def drawn() -> None:
    """Faults of the catalogue drawn and put into real recordings."""
    command_line(drawn.__doc__).parse_args()
    counts = Counter()
    with TemporaryDirectory() as folder:
        for name in REAL:
            case = load_carrier(name, Path(folder) / name)
            counts["false"] += bool(find_setup_faults(case))
            for fault, seed in itertools.product(DRAWS, range(2)):
                rng = np.random.default_rng([seed, crc32((name + fault).encode())])
                put_in = DRAWS[fault](rng, case.arm.n_joints)
                found = find_setup_faults(put_in.in_case(case, rng, case.arm))
                joints = {one.name: one.joints for one in found}
                counts["faults"] += 1
                counts["named"] += fault in joints
                wanted = put_in.kind[2] or joints.get(fault)
                counts["alone and exact"] += joints == {fault: wanted}
                print(name, put_in, "->", *found, flush=True)
    print(dict(counts))


def drawn_flip(rng: np.random.Generator, n: int) -> Fault:
    """One joint."""
    return SignFlip((int(rng.integers(n)) + 1,), str(rng.choice(SignFlip.variants)))


def drawn_swap(rng: np.random.Generator, n: int) -> Fault:
    """Two joints that follow each other, as cables in the wrong order have it."""
    first = int(rng.integers(1, n))
    return JointSwap((first, first + 1), str(rng.choice(JointSwap.variants)))


def drawn_unit(rng: np.random.Generator, n: int) -> Fault:
    """All joints, with one gear ratio, which is round."""
    variant = str(rng.choice(UnitMismatch.variants))
    ratio = np.round(rng.uniform(*UnitMismatch.parameters[0].typical))
    return UnitMismatch(variant, ratio=float(ratio))


def drawn_zero(rng: np.random.Generator, n: int) -> Fault:
    """One joint, by a quarter of a turn either way or by half a turn."""
    joint = int(rng.integers(n)) + 1
    return ZeroOffset((joint,), float(rng.choice([-1, 1, 2])) * np.pi / 2)


def drawn_torque_unit(rng: np.random.Generator, n: int) -> Fault:
    """Currents of motors of two sizes, or commands of the first joints times a round number."""
    variant = str(rng.choice(TorqueUnit.variants))
    if variant == "command_scale":
        count = int(rng.integers(1, max(n, 2)))
        times = float(rng.choice([4.0, 10.0, 0.25, 0.1]))
        return TorqueUnit(variant, tuple(range(1, count + 1)), (1.0 / times,))
    large = float(np.exp(rng.uniform(np.log(2.5), np.log(20.0))))
    small = large * float(rng.uniform(0.4, 0.9))
    halves = [large if 2 * j < n else small for j in range(n)]
    return TorqueUnit(variant, factor=tuple(halves))


def drawn_late(rng: np.random.Generator, n: int) -> Fault:
    """Either kind, of a usual delay."""
    variant = str(rng.choice(LateTorque.variants))
    return LateTorque(variant, float(rng.uniform(*LateTorque.parameters[0].typical)))


def drawn_shift(rng: np.random.Generator, n: int) -> Fault:
    """One link up or down the chain."""
    return ShiftedInertials(int(rng.choice([-1, 1])), bool(rng.integers(2)))


DRAWS = {
    "sign_flip": drawn_flip,
    "joint_swap": drawn_swap,
    "unit_mismatch": drawn_unit,
    "zero_offset": drawn_zero,
    "gravity_compensated_torque": lambda rng, n: GravityCompensatedTorque(),
    "torque_unit": drawn_torque_unit,
    "late_torque": drawn_late,
    "shifted_inertials": drawn_shift,
}
"""Faults that the torque tells, as real set-ups have them: how each is drawn on an arm of n joints."""

# References, gains, zeros and gravity

REFERENCE_FAULTS = {
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


def real(name: str, **columns: str) -> Case:
    """A case of ``experiments/cases``, with further columns of its logs."""
    if not columns:
        return load_case(CASES / f"{name}.yaml", data_root=DATA)
    content = yaml.safe_load((CASES / f"{name}.yaml").read_text(encoding="utf-8"))
    content["import"] |= columns
    # the other recording holds commands of 1e38
    content["recordings"] = content["recordings"][1:]
    with TemporaryDirectory() as folder:
        file = Path(folder) / "case.yaml"
        file.write_text(yaml.safe_dump(content), encoding="utf-8")
        return load_case(file, data_root=DATA)


def with_references(folder: Path) -> Iterator[Case]:
    """All cases that have references."""
    yield simulated("nominal", (), "iiwa, feedforward")
    yield simulated("none", (), "iiwa, PD alone")
    yield simulated("nominal", ORDINARY, "iiwa, feedforward, effects")
    yield simulated("none", ORDINARY, "iiwa, PD alone, effects")
    for number, (robot, _) in enumerate(ARMS):
        target = folder / f"generator_{number}"
        GeneratorArm(number).write(target)
        yield replace(load_case(target / "case"), name=f"generator, {robot}")
    if DATA.is_dir():
        yield real("unitree_z1")
        yield real("so101")
        commands = {"q_ref": "PositionCmptd{j}", "dq_ref": "VelocityCmptd{j}"}
        yield replace(real("kinova_gen3_current", **commands), name="kinova_gen3")


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


def references_part(folder: Path) -> Iterator[tuple[str, str, str, str]]:
    """Case, how it was given, fault, and what was found."""
    for case in with_references(folder):
        for noise, sizes in NOISE.items():
            changed = noisy(case, *sizes, np.random.default_rng(1))
            bare = tuple(replace(r, tau=None) for r in case.recordings)
            given = {f"torque, {noise}": changed}
            if noise == "as it is" and case.controller is not None:
                given["commands alone"] = replace(case, recordings=bare)
            for how, one in given.items():
                yield case.name, how, "none", _names(one)
                for label, fault in REFERENCE_FAULTS.items():
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
        values = [v for several in fault.fault.values().values() for v in several[:1]]
        numbers = ", ".join(f"{v:.3g}" for v in values)
        words.append(f"{fault.name} {fault.variant} {numbers}".strip())
    return "; ".join(words) or "none"


def zeros_part(folder: Path) -> Iterator[tuple[str, str, str, str]]:
    """Each joint of each arm counted from another zero."""
    cases = [simulated("nominal", ORDINARY, "iiwa, effects")]
    if DATA.is_dir():
        cases += map(real, ("ur10", "panda", "kinova_gen3_current"))
    for case in cases:
        yield case.name, "", "none", _zeros(case)
        for joint in range(1, case.arm.n_joints + 1):
            for angle in ANGLES:
                fault = ZeroOffset((joint,), float(np.deg2rad(angle)))
                spoilt = with_fault(case, fault)
                label = f"zero_offset {joint} {angle:g}"
                yield case.name, f"joint {joint}", label, _zeros(spoilt)


def _zeros(case: Case) -> str:
    words = []
    for fault in find_setup_faults(case):
        offset = fault.fault.values().get("offset")
        joints = ", ".join(map(str, fault.joints))
        angle = "" if offset is None else f" {np.rad2deg(offset[0]):.1f}"
        words.append(f"{fault.name} {joints}{angle}")
    return "; ".join(words) or "none"


REFERENCE_PARTS = {
    "references": references_part,
    "zeros": zeros_part,
}


def outcome(fault: str, found: str) -> str:
    """``found`` (alone, or ``found with another``), ``not found``, ``wrong name``; ``healthy``, ``false alarm``."""
    if fault == "none":
        return "healthy" if found == "none" else "false alarm"
    names = {words.split()[0] for words in found.split("; ")}
    if fault.split()[0] in names:
        return "found" if len(names) == 1 else "found with another"
    return "not found" if found == "none" else "wrong name"


def references() -> None:
    """Print each result and the counts by fault; write them as a table."""
    options = command_line(
        references.__doc__,
        out=Path("out/reference_faults"),
        part={"choices": REFERENCE_PARTS, "action": "append"},
    ).parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    for part in options.part or REFERENCE_PARTS:
        rows = []
        with TemporaryDirectory() as folder:
            for row in REFERENCE_PARTS[part](Path(folder)):
                rows.append((*row, outcome(*row[2:])))
                print(" | ".join(rows[-1]), flush=True)
        head = ["case", "given", "fault", "found", "outcome"]
        table = pd.DataFrame(rows, columns=head)
        table.to_csv(options.out / f"{part}.csv", index=False)
        counts = table.groupby(["given", "fault", "outcome"], as_index=False).size()
        print(f"\n{markdown(counts.columns, counts.to_numpy())}")


# Control laws

LAW_EFFECTS = {
    "healthy": (),
    "payload": (AppliedEffect("payload", (), {"mass": 2.0, "com": [0.0, 0.0, 0.08]}),),
    "coulomb_friction": (AppliedEffect("coulomb_friction", (2,), {"torque": [4.0]}),),
}
"""What the arm has beyond its data sheet."""
LAW_PLAN = Plan(recordings=3, duration=8.0, engine="pybullet")


def diagnosed(kind: str, label: str) -> dict[str, Any]:
    """What is found on one arm under one law, by the commands alone."""
    rng = np.random.default_rng(38)
    case = record_case(
        label, iiwa(), LAW_EFFECTS[label], LAW_PLAN, rng, controller=kind
    )
    bare = tuple(replace(r, tau=None) for r in case.recordings)
    return dict(gapscope.diagnose(replace(case, recordings=bare)).document)


def controllers() -> None:
    """Diagnose all cases and print the table."""
    command_line(controllers.__doc__).parse_args()
    print("| law | arm | found |\n|---|---|---|")
    for kind, label in itertools.product(LAWS, LAW_EFFECTS):
        document = diagnosed(kind, label)
        found = []
        for effect in document["effects"]:
            joints = "".join(f" J{j}" for j in effect["joints"])
            first = next(iter(effect["parameters"].values()))
            value = np.round(np.atleast_1d(first["value"]), 3).tolist()
            found.append(f"{effect['effect']}{joints} {value} {first['unit']}")
        words = "; ".join(found) or document["verdict"]
        print(f"| {kind} | {label} | {words} |", flush=True)


if __name__ == "__main__":
    run_part(__doc__, torque_column, drawn, references, controllers)
