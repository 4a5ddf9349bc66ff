"""Provenance: what a result was made from, as hashes of its files, the source and the libraries."""

from __future__ import annotations

import hashlib
import platform
from collections.abc import Iterable, Mapping
from dataclasses import fields, is_dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from gapscope.arm.case import Case, case_files
from gapscope.arm.input_file import digest_of, read_bytes
from gapscope.effects.catalogue import own_sources
from gapscope.installation import installed_version

KEY = "made_from"
"""Key of ``diagnosis.json`` and of an evaluation's finished cells."""
PACKAGE = Path(__file__).resolve().parent
SOURCES = ("arm", "effects", "envs", "ident", "model", "diagnosis")
"""Folders on the way to a diagnosis."""
ENDINGS = (".py", ".json", ".yaml", ".npz", ".csv")
LIBRARIES = (
    "gapscope",
    "numpy",
    "scipy",
    "pin",
    "pybullet",
    "mujoco",
    "pandas",
    "joblib",
)


def source_files() -> list[Path]:
    """The files that a diagnosis is made from, in order."""
    # sorted: the order of a folder differs from machine to machine
    files = [path for name in SOURCES for path in sorted((PACKAGE / name).rglob("*"))]
    return [path for path in files if path.suffix in ENDINGS]


def source_hash() -> str:
    """SHA-256 over names and contents of those files, and of the files that effects of users were read from."""
    own = own_sources()
    if not own:
        return _package_hash()
    # apart by a zero byte, which no name or text has
    parts = [_package_hash(), *(part for source in own for part in source)]
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()


@cache
def _package_hash() -> str:
    """SHA-256 over names and contents of the package's files."""
    digest = hashlib.sha256()
    for path in source_files():
        digest.update(_place(path).encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()


def library_versions(
    libraries: Iterable[str] = LIBRARIES,
) -> dict[str, str | None]:
    """Installed version of each library; ``None`` if it is not installed."""
    return {name: installed_version(name) for name in libraries}


def program() -> str:
    """SHA-256 of what leads to a diagnosis: its source, Python and the libraries."""
    versions = [
        f"{name} {found or 'none'}" for name, found in library_versions().items()
    ]
    parts = [source_hash(), platform.python_version(), *versions]
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()


def made_from(case: Case | Path) -> dict[str, str]:
    """What a diagnosis is made from: a hash of the case, and one of the program.

    ``case_sha256``: SHA-256 over names and contents of the case's files; of a case in memory over its arrays.
    ``program_sha256``: over the source, Python and the libraries.

    Raises:
        GapscopeError: the case file, the robot or a recording cannot be read.
    """
    return {"case_sha256": _case_hash(case), "program_sha256": program()}


def _case_hash(case: Case | Path) -> str:
    # a case made in memory has no files: its numbers say all
    if isinstance(case, Case) and case.file is None:
        recordings = *case.recordings, *case.judged
        parts = [case.name, case.arm, recordings, case.controller]
        return hashlib.sha256(fingerprint(parts).encode()).hexdigest()
    path = case.file if isinstance(case, Case) else case
    assert path is not None
    digest = hashlib.sha256()
    for file in case_files(path):
        content = digest_of(file, "check the path")
        digest.update(file.name.encode() + b"\0" + content)
    return digest.hexdigest()


def sha256(path: Path) -> str:
    """SHA-256 of a file, in hexadecimal digits; raises ``OSError`` if it cannot be read."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def fingerprint(value: Any) -> str:
    """Hash of plain data, arrays and records, with the contents of files instead of their paths.

    Raises:
        GapscopeError: a file cannot be read.
    """
    import joblib  # here, because diagnoses of files need no fingerprint

    return str(joblib.hash(_contents(value), hash_name="sha1"))


def _contents(value: Any) -> Any:
    """A value as lists, dicts, arrays and bytes; what else it holds as Python shows it."""
    if is_dataclass(value) and not isinstance(value, type):
        record = {field.name: getattr(value, field.name) for field in fields(value)}
        # two kinds of record with the same fields are not the same
        return {"": type(value).__name__, **_contents(record)}
    if isinstance(value, Mapping):
        return {str(key): _contents(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [_contents(entry) for entry in value]
    if isinstance(value, Path):
        return read_bytes(value, "check the path", None)
    if isinstance(value, np.ndarray):
        # the same numbers, however they lie in memory
        return np.ascontiguousarray(value)
    return repr(value)


def _place(path: Path) -> str:
    return path.relative_to(PACKAGE).as_posix()
