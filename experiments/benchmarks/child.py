"""Measurements in a process of their own: with the code of any checkout, or by other tools in their own environments.

The scripts are in ``children/``. The project does not need the packages of the other tools.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import venv
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from gapscope.arm.case import Case
from gapscope.model.conditioning import Segment

ROOT = Path(__file__).resolve().parents[2]
"""The checkout that these scripts belong to."""
CHILDREN = Path(__file__).with_name("children")
ONE_THREAD = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"
)


def run_child(
    script: str,
    *words: object,
    checkout: Path = ROOT,
    python: Path | str = sys.executable,
    timeout: float | None = None,
) -> Any:
    """What a script of ``children/`` prints in its last line, as JSON; it runs on one thread.

    Args:
        script: its name.
        words: its arguments.
        checkout: where it imports the project from; the script itself is always this checkout's.
        python: that runs it.
        timeout: after which it is stopped [s].

    Raises:
        RuntimeError: it failed; with the end of what it printed.
        subprocess.TimeoutExpired: it took too long.
    """
    done = subprocess.run(
        [str(python), str(CHILDREN / script), *map(str, words)],
        capture_output=True,
        text=True,
        env={**os.environ, **ONE_THREAD, "PYTHONPATH": str(checkout)},
        timeout=timeout,
    )
    if done.returncode:
        raise RuntimeError(f"{script} failed: {done.stderr.strip()[-3000:]}")
    return json.loads(done.stdout.splitlines()[-1])


# relative, because scripts beside the folder import this as well

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
