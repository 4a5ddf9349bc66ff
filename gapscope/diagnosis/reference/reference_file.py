"""A reference as a folder: ``reference.json``, ``reference.npz`` and ``identified.urdf``.

The JSON file is removed first and written last, and holds the hashes of the other two: a folder that was not written
to its end, or whose files belong to two references, is refused.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from gapscope.arm.errors import GapscopeError, InputError
from gapscope.arm.input_file import (
    LARGEST_IN_MEMORY,
    is_file,
    is_folder,
    read_bytes,
    read_text,
)
from gapscope.arm.io.atomic_write import atomic_write
from gapscope.arm.io.json_file import read_json, write_json
from gapscope.arm.known_load import KnownLoad
from gapscope.arm.npz_file import read_arrays
from gapscope.arm.recording import Recording
from gapscope.diagnosis.reference.kept_reference import URDF, KeptReference

SCHEMA = 2
DOCUMENT, ARRAYS = "reference.json", "reference.npz"
FOLDER = "identified"
"""Folder in which a diagnosis keeps its reference, beside its results."""
REMEDY = "keep the reference again: gapscope diagnose CASE --against REFERENCE --out DIR writes DIR/identified"
CHANNELS = ("t", "q", "tau")
"""What is kept of a recording."""


def identified_folder(path: Path) -> Path | None:
    """The folder of a kept reference: the path itself, or ``identified`` in it; ``None`` if it is a case."""
    if not is_folder(path) or is_file(path / "case.yaml"):
        return None
    for folder in (path, path / FOLDER):
        if any(is_file(folder / name) for name in (DOCUMENT, ARRAYS)):
            return folder
    return None


def write_reference(reference: KeptReference, folder: Path) -> Path:
    """Write a reference; ``reference.json`` comes last.

    Returns:
        The path of ``reference.json``.

    Raises:
        GapscopeError: a file cannot be written.
    """
    document = folder / DOCUMENT
    try:
        document.unlink(missing_ok=True)
    except OSError as error:
        raise GapscopeError(
            f"{document}: cannot be replaced ({error.strerror})", "remove it"
        ) from None
    arrays = {
        f"{channel}{k + 1}": getattr(recording, channel)
        for k, recording in enumerate(reference.recordings)
        for channel in CHANNELS
    }
    with atomic_write(folder / ARRAYS) as aside, aside.open("wb") as stream:
        np.savez_compressed(stream, allow_pickle=False, **arrays)
    with atomic_write(folder / URDF) as aside:
        aside.write_bytes(reference.urdf.encode())
    hashes = {name: _sha256((folder / name).read_bytes()) for name in (URDF, ARRAYS)}
    write_json({**_content(reference), "files": hashes}, document)
    return document


def _content(reference: KeptReference) -> dict[str, Any]:
    """What ``reference.json`` says of the reference."""
    return {
        "schema": SCHEMA,
        "reference": reference.name,
        "recordings": [_entry(recording) for recording in reference.recordings],
        "made_from": reference.made_from,
        "joints": reference.joints,
        "coupled_motors": reference.coupled_motors,
        "gravity": reference.gravity,
        "armature": reference.armature,
        "coulomb": reference.coulomb,
        "viscous": reference.viscous,
        "faults": sorted(reference.faults),
        "warnings": reference.warnings,
    }


def _entry(recording: Recording) -> dict[str, Any]:
    """What ``reference.json`` says of a recording: its name, its length, and the body that it carried."""
    load = recording.payload
    carried = None if load is None else {"mass": load.mass, "com": list(load.com)}
    return {"name": recording.name, "samples": len(recording.t), "payload": carried}


def read_reference(folder: Path) -> KeptReference:
    """Read a reference.

    Args:
        folder: that ``write_reference`` wrote.

    Raises:
        InputError: a file is missing, changed or not of this format; names the file and the field.
    """
    path = folder / DOCUMENT
    if not is_file(path):
        raise InputError(
            "is missing: the reference was not written to its end",
            REMEDY,
            file=path,
        )
    content = read_json(path, REMEDY)
    _check(content, path)
    for name in (URDF, ARRAYS):
        _check_unchanged(folder / name, content)
    return KeptReference(
        name=content["reference"],
        joints=tuple(content["joints"]),
        coupled_motors=tuple(content["coupled_motors"]),
        gravity=np.array(content["gravity"], dtype=float),
        urdf=read_text(folder / URDF, REMEDY),
        armature=_per_joint("armature", content, path),
        coulomb=_per_joint("coulomb", content, path),
        viscous=_per_joint("viscous", content, path),
        recordings=_read_recordings(folder / ARRAYS, content),
        faults=frozenset((name, variant) for name, variant in content["faults"]),
        warnings=tuple(content["warnings"]),
        made_from=content["made_from"],
        file=path,
    )


def _check_unchanged(path: Path, content: Mapping[str, Any]) -> None:
    """Check that a file beside ``reference.json`` has the hash that stands there."""
    found = read_bytes(path, REMEDY, LARGEST_IN_MEMORY)
    if _sha256(found) != content["files"][path.name]:
        raise InputError(
            f"is not the file that {DOCUMENT} was written with",
            REMEDY,
            file=path,
            where=f"field files.{path.name} of {DOCUMENT}",
        )


def _per_joint(name: str, content: Mapping[str, Any], path: Path) -> np.ndarray:
    """A field with one number for each joint, (n,)."""
    value, n = np.array(content[name], dtype=float), len(content["joints"])
    if value.shape != (n,):
        raise InputError(
            f"has {value.size} numbers, the arm has {n} joints",
            REMEDY,
            file=path,
            where=f"field {name}",
        )
    return value


def _read_recordings(path: Path, content: Mapping[str, Any]) -> tuple[Recording, ...]:
    """The recordings of ``reference.npz``, finite and of the shapes that the document states."""
    arrays, n = read_arrays(path, REMEDY), len(content["joints"])
    recordings = []
    for k, entry in enumerate(content["recordings"], 1):
        samples, carried = entry["samples"], entry["payload"]
        shapes = {"t": (samples,), "q": (samples, n), "tau": (samples, n)}
        t, q, tau = (
            _finite(f"{name}{k}", arrays, shape, path) for name, shape in shapes.items()
        )
        load = carried and KnownLoad(carried["mass"], tuple(carried["com"]))
        recordings.append(Recording(entry["name"], t, q, tau, payload=load))
    return tuple(recordings)


def _finite(
    name: str, arrays: Mapping[str, np.ndarray], shape: tuple[int, ...], path: Path
) -> np.ndarray:
    """An array of finite numbers of a shape."""
    found = arrays.get(name, np.array(np.nan))
    numeric = found.dtype.kind in "fiu"
    if found.shape != shape or not numeric or not np.isfinite(found).all():
        raise InputError(
            f"expected finite numbers of shape {shape}",
            REMEDY,
            file=path,
            where=name,
        )
    return found


def _check(content: Any, path: Path) -> None:
    """Check the content of ``reference.json`` against its schema."""
    from jsonschema.exceptions import best_match

    schema = content.get("schema") if isinstance(content, dict) else None
    if schema is not None and schema != SCHEMA:
        raise InputError(
            f"is of schema {schema!r}, this version of Gapscope reads {SCHEMA}: "
            "it compares with the recordings of a reference",
            REMEDY,
            file=path,
            where="field schema",
        )
    error = best_match(_validator().iter_errors(content))
    if error is not None:
        field = ".".join(str(step) for step in error.absolute_path)
        where = f"field {field}" if field else ""
        raise InputError(error.message, REMEDY, file=path, where=where)


@cache
def _validator() -> Any:
    from jsonschema import Draft202012Validator

    folder = resources.files("gapscope.diagnosis.reference")
    text = folder.joinpath("reference.schema.json").read_text(encoding="utf-8")
    return Draft202012Validator(json.loads(text))


def _sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()
