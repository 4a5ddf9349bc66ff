"""How often faults of the torque column are found, on real recordings and on arms of the blind check's generator.

    .venv/bin/python experiments/36_torque_column.py --out out/torque_column [--only real|generated]

Real recordings are carriers as in ``26_real_benchmark.py``: healthy as they are, and with a fault put in; they need
``${GAPSCOPE_DATA}``. The generator's arms are simulated by MuJoCo with other laws than the diagnosis has, nominal
inertials off by a tenth; healthy ones with little and much noise, and some with a strong ordinary effect. The gravity
that a vendor's driver leaves out is that of a model whose links are each off by a fifth.

Each answer is appended to ``answers.jsonl``, so that a run which was interrupted goes on; the tables are ``tables.md``.
"""

from __future__ import annotations

import argparse
import itertools
import json
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np
from real_carriers import load_carrier

from gapscope.arm.case import Case, load_case
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.recording import Recording
from gapscope.blind_check.generator.case import make_case, write_case
from gapscope.blind_check.generator.conditions import CaseSpec, Conditions
from gapscope.diagnosis.setup_faults.detection import find_setup_faults
from gapscope.effects.setup_faults.fault import Fault
from gapscope.effects.setup_faults.torque_faults import LateTorque, TorqueUnit

REAL = ("ur10", "panda", "tx40", "kinova", "kuka")
"""Carriers; the torque of a sixth, the Z1, is computed from gains and so no measurement."""
ROBOTS = ("kuka_iiwa", "ur5_like", "franka_panda")
"""Arms of the generator."""
NOISE = (1.0, 3.0)
"""Factors on the noise of their encoders."""
ORDINARY = (
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

Spoil = Callable[[Case, np.random.Generator], Case]


def _of(fault: Callable[[int], Fault]) -> Spoil:
    """All recordings of a case with a fault, given the number of joints."""

    def spoil(case: Case, rng: np.random.Generator) -> Case:
        return fault(case.arm.n_joints).in_case(case, rng, case.arm)

    return spoil


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
        return replace(recording, tau=np.asarray(recording.tau) - pull)

    return replace(case, recordings=tuple(spoilt(r) for r in case.recordings))


def _two_sizes(n: int) -> tuple[float, ...]:
    """Constants of large motors in the arm and small ones in the wrist, at the joint [N m/A]."""
    return tuple(13.0 if 2 * j < n else 8.0 for j in range(n))


FAULTS: dict[str, tuple[Spoil, str, str, float]] = {
    "gravity left out": (without_gravity, "gravity_compensated_torque", "", 0.0),
    "amperes, one constant": (
        _of(lambda n: TorqueUnit("current", factor=(10.0,))),
        "torque_unit",
        "current",
        10.0,
    ),
    "amperes, two sizes": (
        _of(lambda n: TorqueUnit("current", factor=_two_sizes(n))),
        "torque_unit",
        "current",
        0.0,
    ),
    "milliamperes": (
        _of(lambda n: TorqueUnit("current", factor=(0.01,))),
        "torque_unit",
        "current",
        0.01,
    ),
    "three commands times four": (
        _of(lambda n: TorqueUnit("command_scale", (1, 2, 3), (0.25,))),
        "torque_unit",
        "command_scale",
        0.25,
    ),
    "late by 20 ms": (_of(lambda n: LateTorque("delay", 0.02)), "late_torque", "delay", 0.02),
    "late by 50 ms": (_of(lambda n: LateTorque("delay", 0.05)), "late_torque", "delay", 0.05),
    "late by 100 ms": (_of(lambda n: LateTorque("delay", 0.1)), "late_torque", "delay", 0.1),
    "filtered, 50 ms": (_of(lambda n: LateTorque("filter", 0.05)), "late_torque", "delay", 0.05),
}  # fmt: skip
"""Faults put in: how, the name and variant to be found, and its value where one stands for all."""
BESIDE_ORDINARY = ("gravity left out", "amperes, one constant")
"""Faults that are put in beside ordinary effects."""
AS_IT_IS = "as it is"


def real_cases(out: Path) -> Iterator[tuple[str, str, Case]]:
    """Group, name and case of the carriers."""
    for arm in REAL:
        yield "real", arm, load_carrier(arm, out / "carriers" / arm)


def generated_cases(out: Path) -> Iterator[tuple[str, str, Case]]:
    """Group, name and case of the generator's arms, written on the first run."""
    for robot in ROBOTS:
        for noise in NOISE:
            folder = out / "cases" / f"{robot}_{noise:g}"
            group = f"simulated, noise x{noise:g}"
            yield group, folder.name, _made(folder, robot, (), noise)
        for law in ORDINARY:
            folder = out / "cases" / f"{robot}_{law}"
            yield "ordinary effect", folder.name, _made(folder, robot, (law,), 1.0)


def _made(folder: Path, robot: str, laws: tuple[str, ...], noise: float) -> Case:
    """A case of the generator."""
    if not folder.is_dir():
        conditions = Conditions(robot, INERTIALS_OFF, noise, rate=250)
        spec = CaseSpec(
            "single" if laws else "healthy",
            laws,
            SEVERITY if laws else None,
            conditions,
        )
        made = make_case(spec, (36, crc32(folder.name.encode())))
        write_case(
            made, folder.name, True, folder, folder.parent / f"{folder.name}.csv"
        )
    return load_case(folder)


def answer(case: Case, label: str) -> dict[str, Any]:
    """What is found in a case with a fault put in."""
    spoil = FAULTS[label][0] if label in FAULTS else None
    rng = np.random.default_rng(crc32(f"{case.name} {label}".encode()))
    spoilt = case if spoil is None else spoil(case, rng)
    start = time.process_time()
    found = find_setup_faults(spoilt)
    return {
        "seconds": round(time.process_time() - start, 2),
        "found": [
            {
                "name": fault.name,
                "variant": fault.variant,
                "joints": list(fault.joints),
                "probability": round(fault.probability, 3),
                "values": {k: list(p.value) for k, p in fault.parameters.items()},
            }
            for fault in found
        ],
    }


def kind(label: str, found: list[dict[str, Any]]) -> str:
    """Kind of an answer."""
    names = [(fault["name"], fault["variant"]) for fault in found]
    # what a carrier's stamps show is no matter of the torque
    names = [name for name in names if name[0] != "time_stamps"]
    wanted = FAULTS[label][1:3] if label in FAULTS else None
    if not names:
        return NOTHING
    if wanted not in names:
        return OTHER
    return RIGHT if len(names) == 1 else BESIDE


def tables(answers: list[dict[str, Any]]) -> str:
    """The tables: kinds of answers by fault and group, and values found."""
    groups = list(dict.fromkeys(one["group"] for one in answers))
    labels = [AS_IT_IS, *FAULTS]
    lines = [
        "found, found beside another fault, other name, nothing; of so many cases",
        "",
        f"| fault | {' | '.join(groups)} | value found over value put in |",
        "|---" * (len(groups) + 2) + "|",
    ]
    for label in labels:
        of_label = [one for one in answers if one["label"] == label]
        cells = [
            _counted(label, [x for x in of_label if x["group"] == g]) for g in groups
        ]
        lines.append(f"| {label} | {' | '.join(cells)} | {_ratio(label, of_label)} |")
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
    if label not in FAULTS or not FAULTS[label][3]:
        return "-"
    _, name, _, value = FAULTS[label]
    ratios = [
        float(np.median(next(iter(fault["values"].values())))) / value
        for one in answers
        for fault in one["found"]
        if fault["name"] == name
    ]
    if not ratios:
        return "-"
    low, middle, high = np.percentile(ratios, (25, 50, 75))
    return f"{middle:.2f} ({low:.2f} .. {high:.2f})"


def main() -> None:
    """Ask each question that has no answer yet, and write the tables."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--out", type=Path, default=Path("out/torque_column"))
    parser.add_argument("--only", choices=("real", "generated"))
    options = parser.parse_args()
    out = options.out
    out.mkdir(parents=True, exist_ok=True)
    file = out / "answers.jsonl"
    known = (
        [json.loads(x) for x in file.read_text().splitlines()] if file.is_file() else []
    )
    asked = {(one["case"], one["label"]) for one in known}
    sources = {"real": real_cases, "generated": generated_cases}
    chosen = [x for name, x in sources.items() if options.only in (None, name)]
    # false alarms first: they are asked of the most cases
    for as_it_is, source in itertools.product((True, False), chosen):
        for group, case_name, case in source(out):
            faults = BESIDE_ORDINARY if group == "ordinary effect" else tuple(FAULTS)
            for label in (AS_IT_IS,) if as_it_is else faults:
                if (case_name, label) in asked:
                    continue
                one = {"group": group, "case": case_name, "label": label}
                one |= answer(case, label)
                said = kind(label, one["found"])
                print(f"{case_name}, {label}: {said} ({one['seconds']} s)", flush=True)
                known.append(one)
                with file.open("a") as stream:
                    stream.write(json.dumps(one) + "\n")
    (out / "tables.md").write_text(tables(known))
    print(tables(known))


if __name__ == "__main__":
    main()
