"""An environment of its own for FIGAROH, whose packages the project does not need."""

from __future__ import annotations

import subprocess
import venv
from pathlib import Path

FIGAROH = "figaroh==1.0.2"


def install(folder: Path) -> Path | None:
    """Python of an environment with FIGAROH, made where it is missing; ``None``, and why, where it cannot be had."""
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
