"""Write the files of ``requirements/``: each package that ``make`` installs, with version and hashes of its files.

    python .ci/lock.py UV

``UV`` is the program of that name, which resolves for all Pythons and platforms at once. Versions are those of
``constraints.txt``. A package is in one file alone: ``dev.txt`` goes on where ``core.txt`` and ``test.txt`` end.
torch and what its build brings are left out: the file that is right depends on the index that pip is told to
use, and so does its hash. They are pinned by version alone.
"""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / "requirements"
HEADER = "# Written by `make lock` from pyproject.toml and constraints.txt; not to be edited.\n"
NOT_HASHED = re.compile(r"^(torch|triton|nvidia-|cuda-)")
"""Packages whose files depend on the index."""


class Set(NamedTuple):
    """What one file holds: the project with extras, or packages, without what other files hold."""

    extras: tuple[str, ...] = ()
    packages: tuple[str, ...] = ()
    after: tuple[str, ...] = ()


SETS = {
    "build": Set(packages=("setuptools",)),
    "core": Set(after=("build",)),
    "test": Set(
        packages=("hypothesis", "pytest", "pytest-xdist"), after=("build", "core")
    ),
    "dev": Set(extras=("dev",), after=("build", "core", "test")),
    "docs": Set(extras=("docs",), after=("build", "core", "test", "dev")),
    "learn": Set(extras=("cluster", "learn"), after=("build", "core", "test", "dev")),
    "tools": Set(packages=("cyclonedx-bom", "pip-audit", "uv")),
}
"""The files; ``tools`` has an environment of its own."""


def compiled(uv: str, wanted: Set) -> str:
    """What uv writes for a set: lines ``name==version ; marker`` followed by their hashes."""
    command = [uv, "pip", "compile", "--universal", "--python-version", "3.10"]
    command += ["--generate-hashes", "--no-annotate", "--no-header", "--quiet"]
    command += ["--constraints", "constraints.txt"]
    if wanted.packages:
        command.append("-")
    else:
        command.append("pyproject.toml")
        command += [f"--extra={extra}" for extra in wanted.extras]
    done = subprocess.run(
        command,
        cwd=ROOT,
        input="\n".join(wanted.packages),
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    return done.stdout


def blocks(text: str) -> dict[str, str]:
    """Hashes of each requirement, by the line that names it."""
    parts = re.split(r"^(?=\S)", text, flags=re.MULTILINE)
    found = (part.split(" \\\n", 1) for part in parts if part.strip())
    return {line: hashes for line, hashes in found}


def pins() -> dict[str, set[str]]:
    """Versions of ``constraints.txt`` by normalised name."""
    found: dict[str, set[str]] = {}
    for line in (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines():
        match = re.match(r"([\w.-]+)==([^\s;]+)", line)
        if match:
            name = re.sub(r"[-_.]+", "-", match[1]).lower()
            found.setdefault(name, set()).add(match[2])
    return found


def unpinned(lines: list[str]) -> list[str]:
    """Requirements whose version ``constraints.txt`` does not hold."""
    known = pins()
    parts = [re.match(r"([\w.-]+)==(\S+)", line) for line in lines]
    return [m[0] for m in parts if m and m[2] not in known.get(m[1], set())]


def main(uv: str) -> None:
    """Write all files; exit with 1 if a version is not pinned."""
    made: dict[str, dict[str, str]] = {}
    for name, wanted in SETS.items():
        earlier = {line for other in wanted.after for line in made[other]}
        made[name] = {
            line: hashes
            for line, hashes in blocks(compiled(uv, wanted)).items()
            if line not in earlier and not NOT_HASHED.match(line)
        }
        body = "".join(f"{line} \\\n{hashes}" for line, hashes in made[name].items())
        (FOLDER / f"{name}.txt").write_text(HEADER + body, encoding="utf-8")
        print(f"requirements/{name}.txt: {len(made[name])} packages")
    missing = unpinned([line for name in made for line in made[name]])
    if missing:
        print("not in constraints.txt, add:", *sorted(set(missing)), sep="\n")
        sys.exit(1)


if __name__ == "__main__":
    main(*sys.argv[1:])
