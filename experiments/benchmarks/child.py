"""Scripts of ``children/``: measurements in a process of their own, with the code of any checkout."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

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
