"""FIGAROH beside the project, in an environment of its own, whose packages the project does not need."""

from __future__ import annotations

import subprocess
import venv
import xml.etree.ElementTree as ET
from pathlib import Path

FIGAROH = "figaroh==1.0.2"


def install(folder: Path) -> Path | None:
    """Python of an environment with FIGAROH, made if it is missing; ``None``, and says why, if it cannot be had."""
    python = folder / "bin" / "python"
    if not python.exists():
        venv.create(folder, with_pip=True)
    done = subprocess.run(
        [python, "-m", "pip", "--disable-pip-version-check", "install", "-q", FIGAROH],
        capture_output=True,
        text=True,
    )
    if done.returncode == 0:
        return python
    print(f"FIGAROH cannot be installed: {done.stderr.strip().splitlines()[-1]}")
    return None


def without_meshes(urdf: Path, path: Path) -> Path:
    """A copy of a URDF without shapes, whose meshes FIGAROH would look for."""
    tree = ET.parse(urdf)
    for link in tree.getroot().iter("link"):
        for shape in [*link.findall("visual"), *link.findall("collision")]:
            link.remove(shape)
    tree.write(path)
    return path
