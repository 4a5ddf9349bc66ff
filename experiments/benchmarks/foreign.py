"""Other tools in environments of their own, whose packages the project does not need."""

from __future__ import annotations

import subprocess
import venv
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from gapscope.arm.case import Case
from gapscope.model.conditioning import Segment

# relative, because scripts beside the folder import this as well
from .child import run_child

FIGAROH = "figaroh==1.0.2"
SYSID = "mujoco[sysid]==3.17.0"


def install(folder: Path, requirement: str = FIGAROH) -> Path | None:
    """Python of an environment with a tool, made if it is missing; ``None``, and says why, if it cannot be had."""
    python = folder / "bin" / "python"
    if not python.exists():
        venv.create(folder, with_pip=True)
    command = [python, "-m", "pip", "--disable-pip-version-check", "install", "-q"]
    done = subprocess.run([*command, requirement], capture_output=True, text=True)
    if done.returncode == 0:
        return python
    reason = done.stderr.strip().splitlines()[-1]
    print(f"{requirement} cannot be installed: {reason}")
    return None


def without_meshes(urdf: Path, path: Path) -> Path:
    """A copy of a URDF without shapes, whose meshes FIGAROH would look for."""
    tree = ET.parse(urdf)
    for link in tree.getroot().iter("link"):
        for shape in [*link.findall("visual"), *link.findall("collision")]:
            link.remove(shape)
    tree.write(path)
    return path


def figaroh_fit(
    python: Path, case: Case, fit: Segment, judged: Segment, cutoff: float, out: Path
) -> Mapping[str, Any]:
    """FIGAROH's fit: torque on both segments [N m], (N, n), number of parameters, wall and processor time [s]."""
    motions = {
        key: np.stack([s.motion.q, s.motion.dq, s.motion.ddq])
        for key, s in (("fit", fit), ("judged", judged))
    }
    out.mkdir(parents=True, exist_ok=True)
    arrays, result = out / "arrays.npz", out / "figaroh.npz"
    urdf = without_meshes(case.arm.urdf, out / "arm.urdf")
    np.savez(
        arrays,
        **motions,
        torque=fit.torque,
        rate=fit.motion.rate,
        cutoff=cutoff,
        urdf=str(urdf.resolve()),
    )
    times = run_child("figaroh_fit.py", arrays, result, python=python)
    return {**np.load(result), **times}
