"""Whether a run was frozen: the hash of what leads to a diagnosis, its thresholds, and the versions."""

from __future__ import annotations

import ast
import hashlib
import platform
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("arm", "effects", "envs", "ident", "diagnosis")
"""Packages on the way to a diagnosis."""
APART = ("diagnosis/blind/", "diagnosis/report/", "diagnosis/units/")
"""Parts of them that have no say in it."""
ENDINGS = (".py", ".json", ".yaml", ".npz", ".csv")
LIBRARIES = ("gapscope", "numpy", "scipy", "pin", "pybullet", "mujoco", "pandas", "joblib")


def source_files() -> list[Path]:
    """The files that a diagnosis is made from, in order."""
    files = [path for package in PACKAGES for path in sorted((ROOT / package).rglob("*")) if path.suffix in ENDINGS]
    return [path for path in files if not path.relative_to(ROOT).as_posix().startswith(APART)]


def source_hash() -> str:
    """SHA-256 over names and contents of those files."""
    digest = hashlib.sha256()
    for path in source_files():
        digest.update(path.relative_to(ROOT).as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()


def thresholds() -> dict[str, Any]:
    """Constants of the modules of ``diagnosis``: ``module.NAME`` to its literal value."""
    found: dict[str, Any] = {}
    for path in source_files():
        place = path.relative_to(ROOT)
        if place.parts[0] != "diagnosis" or path.suffix != ".py":
            continue
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if not isinstance(node, ast.Assign):
                continue
            target = node.targets[0]
            if isinstance(target, ast.Name) and target.id.isupper():
                try:
                    value = ast.literal_eval(node.value)
                except (ValueError, TypeError):
                    continue
                if isinstance(value, (int, float, tuple, list)):
                    found[f"{'.'.join(place.with_suffix('').parts[1:])}.{target.id}"] = value
    return found


def frozen() -> dict[str, Any]:
    """What a run is fixed by."""
    return {
        "source_sha256": source_hash(),
        "thresholds": thresholds(),
        "python": platform.python_version(),
        "libraries": {name: _version(name) for name in LIBRARIES},
    }


def _version(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None
