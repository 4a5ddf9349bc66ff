"""Logs of each format, written by other programs, read by the cases of docs/logs.md and diagnosed.

    .venv/bin/python experiments/33_formats.py --out out/formats [--lerobot PYTHON] [--mcap PYTHON]

A simulated arm carries a payload. Its recording is written in each format by the format's own program
(`experiments/foreign_writers.py`); what `docs/logs.md` shows under the format's heading reads it, with the robot, the
recording and the constants of this arm put in. Printed are the largest difference of the positions read from those
written, the torque gap of the nominal arm, the verdict and the payload found. LeRobot and mcap-ros2-support are not
among Gapscope's dependencies; PYTHON is that of an environment with them, and without it their rows are left out.
"""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import foreign_writers as writers
import numpy as np
import yaml
from common import command_line
from rich.console import Console
from rich.progress import track
from rich.table import Table

import gapscope
from gapscope.arm.reading import interpolated

PAGE = Path(__file__).parents[1] / "docs" / "logs.md"
EFFECTS = {
    "schema": 1,
    "effects": [
        {
            "effect": "payload",
            "parameters": {"mass": 1.5, "com": [0.0, 0.0, 0.06]},
        }
    ],
}


class Format(NamedTuple):
    """One format.

    Attributes:
        name: in words.
        program: that writes it.
        heading: of the section of the page.
        file: that is written.
        write: writes it; the name of a writer of ``foreign_writers.py`` that runs elsewhere.
        block: number of the case in the section.
        environment: option with the Python of the program, if it is none of Gapscope's dependencies.
    """

    name: str
    program: str
    heading: str
    file: str
    write: Callable[[writers.Motion, Path], None] | str
    block: int = 0
    environment: str = ""


ROS, RTDE = "ROS 2: joint states", "Universal Robots: RTDE"
STATE = "ROS 2: state of a joint trajectory controller"
FORMATS = (
    Format("ROS 2, SQLite without definitions", "rosbags", ROS, "bag_db3", partial(writers.rosbag, mcap=False)),
    Format("ROS 2, MCAP", "rosbags", ROS, "bag_mcap", partial(writers.rosbag, mcap=True)),
    Format("ROS 2, controller state alone", "mcap-ros2-support", STATE, "state.mcap", "mcap_ros2", 0, "mcap"),
    Format("UR RTDE, currents", "csv", RTDE, "robot_data.csv", writers.rtde),
    Format("UR5 of NIST, currents", "csv", "UR5 degradation measurements of NIST", "ur5testresult.csv", writers.nist),
    Format("libfranka", "csv", "Franka: libfranka", "log.csv", writers.libfranka),
    Format("Kinova Kortex", "csv", "Kinova Gen3: Kortex", "feedback.csv", writers.kortex),
    Format("LeRobot 3.0, degrees", "LeRobotDataset", "LeRobot datasets", "dataset_3", "lerobot", 1, "lerobot"),
    Format("LeRobot 2.1, normalised", "PyArrow", "LeRobot datasets", "dataset_21", writers.lerobot_normalised),
    Format("HDF5", "h5py", "HDF5", "motion.h5", writers.hdf5),
    Format("MATLAB", "SciPy", "MATLAB", "motion.mat", writers.matlab),
)  # fmt: skip


def case_for(form: Format, base: dict[str, Any]) -> dict[str, Any]:
    """The case that the page shows for a format, with robot, data sheet and constants of the simulated arm."""
    text = PAGE.read_text(encoding="utf-8")
    shown = text.split(f"## {form.heading}\n")[1].split("\n## ")[0]
    blocks = re.findall(r"```yaml\n(.*?)```", shown, re.S)
    case = dict(yaml.safe_load(blocks[form.block]))
    case |= {key: base[key] for key in ("joints", "nominal", "controller")}
    case |= {"robot": "robot.urdf", "recordings": [form.file]}
    section = case.get("import", {})
    tau = section.get("tau")
    if isinstance(tau, dict) and "motor_constant" in tau:
        tau |= {"motor_constant": writers.CONSTANT, "gear_ratio": writers.GEAR}
    if form.name.startswith("LeRobot 2.1"):
        # this arm has one episode, and records its effort
        section.pop("episodes")
        section["tau"] = "observation.effort[{joint}]"
    return case


def write(
    form: Format, motion: writers.Motion, folder: Path, pythons: dict[str, str]
) -> bool:
    """Write the motion in a format; false if its program is not at hand."""
    target = folder / form.file
    if callable(form.write):
        form.write(motion, target)
        return True
    if not pythons[form.environment]:
        return False
    source, script = folder / "motion.npz", Path(writers.__file__)
    np.savez(source, **motion)
    command = [pythons[form.environment], script, form.write, source, target]
    subprocess.run(list(map(str, command)), check=True, stdout=subprocess.DEVNULL)
    return True


def score(form: Format, folder: Path, motion: writers.Motion) -> list[str]:
    """Row of the table for a written format."""
    case = gapscope.load_case(folder)
    # episodes and topics cut the motion: compared at the same places
    difference = 0.0
    shift = 0.0
    for recording in case.recordings:
        start = motion["t"][0] + shift
        times = recording.t - recording.t[0] + start
        expected = interpolated(times, motion["t"], motion["q"])
        difference = max(difference, float(np.abs(recording.q - expected).max()))
        shift += recording.duration + float(np.median(np.diff(recording.t)))
    channels = [
        name
        for name in ("q", "dq", "tau", "q_ref", "dq_ref", "temperature")
        if getattr(case.recordings[0], name) is not None
    ]
    out = folder / "out"
    gapscope.diagnose(case).save(out)
    document = json.loads((out / "diagnosis.json").read_text())
    before = document["gap"]["before"]["torque_nrmse"]
    found = []
    for effect in document["effects"]:
        mass = effect["parameters"].get("mass", {}).get("value")
        found.append(effect["effect"] + (f" {mass:.3f} kg" if mass else ""))
    return [
        form.name,
        form.program,
        " ".join(channels),
        f"{difference:.1e}",
        f"{np.mean(before):.3f}",
        document["verdict"],
        ", ".join(found),
    ]


def main() -> None:
    """Write, read and diagnose every format."""
    options = command_line(
        __doc__,
        out=Path("out/formats"),
        lerobot=("", "Python with lerobot"),
        mcap=("", "Python with mcap-ros2-support"),
        only=("", "formats whose name holds this text"),
    ).parse_args()
    out = options.out
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    (out / "effects.yaml").write_text(yaml.safe_dump(EFFECTS))
    record = ["gapscope", "record", "kuka_iiwa", "--recordings", "1", "--seed", "3"]
    record += ["--duration", "12", "--effects", str(out / "effects.yaml")]
    record += ["--out", str(out / "case")]
    subprocess.run([sys.executable, "-m", *record], check=True, capture_output=True)
    base = yaml.safe_load((out / "case" / "case.yaml").read_text())
    recording = gapscope.load_case(out / "case").recordings[0]
    names = ("t", "q", "dq", "tau", "q_ref", "dq_ref")
    motion = {name: np.asarray(getattr(recording, name)) for name in names}
    motion["names"] = np.array(base["joints"])
    table = Table("Format", "written by", "channels", "|q - q| [rad]", "gap", "verdict")
    table.add_column("found")
    pythons = {"lerobot": options.lerobot, "mcap": options.mcap}
    chosen = [form for form in FORMATS if options.only in form.name]
    for number, form in enumerate(track(chosen, description="formats")):
        folder = out / f"{number:02d}"
        folder.mkdir()
        shutil.copy(out / "case" / "robot.urdf", folder)
        if not write(form, motion, folder, pythons):
            table.add_row(form.name, form.program, "left out: give its Python")
            continue
        case = case_for(form, base)
        (folder / "case.yaml").write_text(yaml.safe_dump(case, sort_keys=False))
        table.add_row(*score(form, folder, motion))
    Console(width=160).print(table)


if __name__ == "__main__":
    main()
