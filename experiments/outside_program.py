"""A diagnosis by an outside program, so that other ideas can be compared on the same cases.

    python PROGRAM CASE [--against REFERENCE]

prints a line for each effect that it names, ``effect joint anything [values] number``, joints from 1 and 0 for the arm
or, for ``link_inertia``, the link; and as its last line the processor time, ``1.2 s of processor time``. It may read
CSV recordings in the columns of the case format and a URDF of the arm alone, which is what ``write_plain`` writes.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tempfile
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

from gapscope.arm.case import Case, load_case
from gapscope.arm.dynamics.plain_urdf import moving_links, plain_urdf
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.io.write_case import write_case

FINDING = re.compile(r"(\w+) (\d+) .*?(\[.*\]) ")
"""Effect, joint and values of a line."""
SIZES = {
    "actuator_delay": ("delay", "s"),
    "armature": ("inertia", "kg m^2"),
    "coulomb_friction": ("torque", "N m"),
    "load_friction": ("coefficient", "1"),
    "payload": ("mass", "kg"),
    "torque_offset": ("torque", "N m"),
    "torque_scale": ("scale", "1"),
    "viscous_friction": ("coefficient", "N m s/rad"),
}
"""First parameter and unit of effects of which the first value of a line is just that."""


def write_plain(case: Case, folder: Path) -> None:
    """Write a case on the joints' side; its URDF has the arm's joints alone, in the order of the columns."""
    write_case(case, folder, overwrite=True)
    links = moving_links(RigidBody(case.arm), movable=False)
    root = ET.fromstring(plain_urdf(links))
    for link, element in zip(links, root.findall("link")[1:], strict=True):
        inertia = element.find("inertial/inertia")
        assert inertia is not None
        for key, moment in zip(("ixx", "iyy", "izz"), link.moments, strict=True):
            inertia.set(key, repr(float(moment)))
    (folder / "robot.urdf").write_text(ET.tostring(root, encoding="unicode"))


def answer(
    program: Path, case: Path, reference: Path | None
) -> tuple[dict[str, Any], float]:
    """What a program says of a case, as ``verdict`` and ``effects`` of a diagnosis, and its processor time [s].

    Raises:
        RuntimeError: it ended with an error, or said nothing of its time.
    """
    with tempfile.TemporaryDirectory() as name:
        folders = {"case": case}
        if reference is not None:
            folders["reference"] = reference
        command = [sys.executable, str(program), str(Path(name) / "case")]
        for role, folder in folders.items():
            write_plain(load_case(folder, any_unit=True), Path(name) / role)
        if reference is not None:
            command += ["--against", str(Path(name) / "reference")]
        environment = {**os.environ, "OMP_NUM_THREADS": "1"}
        ended = subprocess.run(command, capture_output=True, text=True, env=environment)
    lines = ended.stdout.splitlines()
    time = re.match(r"([\d.]+) s of processor time", lines[-1] if lines else "")
    if ended.returncode or time is None:
        raise RuntimeError(
            "".join(ended.stderr.strip().splitlines()[-1:]) or "no answer"
        )
    effects: dict[tuple[str, int], dict[str, Any]] = {}
    for line in lines[:-1]:
        found = FINDING.match(line)
        if found is None:
            raise RuntimeError(f"no finding: {line}")
        _add(effects, found[1], int(found[2]), json.loads(found[3]))
    verdict = "effects_found" if effects else "no_gap"
    return {"verdict": verdict, "effects": list(effects.values())}, float(time[1])


def _add(
    effects: dict[tuple[str, int], dict[str, Any]],
    name: str,
    joint: int,
    values: list[float],
) -> None:
    """Add a line to the effects: one entry for all joints of an effect, of several lines on one joint the first."""
    link = joint if name == "link_inertia" else 0
    entry = effects.setdefault(
        (name, link),
        {
            "effect": name,
            "joints": [],
            "parameters": {"link": {"unit": "", "value": link}} if link else {},
            "probability": None,
            "share": None,
            "alternatives": [],
        },
    )
    if joint and joint in entry["joints"]:
        return
    if joint and not link:
        entry["joints"].append(joint)
    if name in SIZES:
        key, unit = SIZES[name]
        size = entry["parameters"].setdefault(key, {"unit": unit, "value": []})
        size["value"].append(values[0])
    elif name == "base_tilt":
        for key, value in zip(("roll", "pitch"), values, strict=True):
            entry["parameters"][key] = {"unit": "rad", "value": value}
    elif name == "external_force":
        entry["parameters"]["force"] = {"unit": "N", "value": values}
