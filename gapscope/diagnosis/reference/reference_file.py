"""An identified reference as a folder: ``reference.json``, ``reference.npz`` and ``identified.urdf``.

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
from gapscope.arm.npz_file import read_arrays
from gapscope.diagnosis.reference.identified_reference import (
    URDF,
    IdentifiedReference,
)
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected_file import error_context, read_entry
from gapscope.ident.model.friction_law import FrictionLaw

SCHEMA = 1
DOCUMENT, ARRAYS = "reference.json", "reference.npz"
FOLDER = "identified"
"""Folder in which a diagnosis keeps the reference that it identified, beside its results."""
REMEDY = "identify the reference again: gapscope diagnose CASE --against REFERENCE --out DIR writes DIR/identified"


def identified_folder(path: Path) -> Path | None:
    """The folder of an identified reference: the path itself, or ``identified`` in it; ``None`` if it is a case."""
    if not is_folder(path) or is_file(path / "case.yaml"):
        return None
    for folder in (path, path / FOLDER):
        if any(is_file(folder / name) for name in (DOCUMENT, ARRAYS)):
            return folder
    return None


def write_reference(reference: IdentifiedReference, folder: Path) -> Path:
    """Write an identified reference; ``reference.json`` comes last.

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
    arrays = {name: getattr(reference, name) for name in _shapes(reference.joints, ())}
    with atomic_write(folder / ARRAYS) as aside, aside.open("wb") as stream:
        np.savez_compressed(stream, allow_pickle=False, **arrays)
    with atomic_write(folder / URDF) as aside:
        aside.write_bytes(reference.urdf.encode())
    hashes = {name: _sha256((folder / name).read_bytes()) for name in (URDF, ARRAYS)}
    write_json({**_content(reference), "files": hashes}, document)
    return document


def _content(reference: IdentifiedReference) -> dict[str, Any]:
    """What ``reference.json`` says of the reference."""
    law = reference.law
    return {
        "schema": SCHEMA,
        "reference": reference.name,
        "recordings": reference.recordings,
        "made_from": reference.made_from,
        "joints": reference.joints,
        "gravity": reference.gravity,
        "armature": reference.armature,
        "coulomb": reference.coulomb,
        "viscous": reference.viscous,
        "friction_law": {
            "stribeck_speed": law.stribeck_speed,
            "saturation_speeds": law.saturation_speeds,
            "presliding": law.presliding,
        },
        "parameters": reference.parameters,
        "base_parameters": reference.base_parameters,
        "torque_ratio_to_nominal": reference.torque_ratio,
        "sampling_skew": reference.skew,
        "effects": [_entry(effect) for effect in reference.effects],
        "faults": sorted(reference.faults),
        "warnings": reference.warnings,
    }


def _entry(applied: AppliedEffect) -> dict[str, Any]:
    """An effect as an entry of ``corrected.yaml``."""
    return {
        "effect": applied.name,
        "joints": applied.joints,
        "parameters": applied.parameters,
    }


def read_reference(folder: Path) -> IdentifiedReference:
    """Read an identified reference.

    Args:
        folder: that ``write_reference`` wrote.

    Raises:
        InputError: a file is missing, changed or not of this format; names the file and the field.
    """
    path = folder / DOCUMENT
    if not is_file(path):
        raise InputError(
            "is missing: the identified reference was not written to its end",
            REMEDY,
            file=path,
        )
    content = read_json(path, REMEDY)
    _check(content, path)
    for name in (URDF, ARRAYS):
        _check_unchanged(folder / name, content)
    joints, parameters = tuple(content["joints"]), tuple(content["parameters"])
    return IdentifiedReference(
        name=content["reference"],
        recordings=tuple(content["recordings"]),
        joints=joints,
        gravity=np.array(content["gravity"], dtype=float),
        urdf=read_text(folder / URDF, REMEDY),
        armature=_per_joint("armature", content, path),
        coulomb=_per_joint("coulomb", content, path),
        viscous=_per_joint("viscous", content, path),
        parameters=parameters,
        law=_law(content["friction_law"]),
        base_parameters=content["base_parameters"],
        **_read_arrays(folder / ARRAYS, _shapes(joints, parameters)),
        skew=float(content["sampling_skew"]),
        torque_ratio=float(content["torque_ratio_to_nominal"]),
        effects=_read_effects(content["effects"], path, len(joints)),
        faults=frozenset((name, variant) for name, variant in content["faults"]),
        warnings=tuple(content["warnings"]),
        made_from=content["made_from"],
        file=path,
    )


def _shapes(
    joints: tuple[str, ...], parameters: tuple[str, ...]
) -> dict[str, tuple[int, ...]]:
    """Arrays of ``reference.npz`` with their shapes."""
    n, p = len(joints), len(parameters)
    return {
        "value": (p,),
        "precision": (p, p),
        "rest": (n,),
        "samples": (n,),
        "scale": (n,),
    }


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


def _law(content: Mapping[str, Any]) -> FrictionLaw:
    """Form of the friction."""
    saturation, presliding = content["saturation_speeds"], content["presliding"]
    return FrictionLaw(
        content["stribeck_speed"],
        None if saturation is None else tuple(saturation),
        None if presliding is None else tuple(presliding),
    )


def _read_arrays(
    path: Path, shapes: Mapping[str, tuple[int, ...]]
) -> dict[str, np.ndarray]:
    """The arrays of ``reference.npz``, finite and of these shapes."""
    arrays = read_arrays(path, REMEDY)
    for name, shape in shapes.items():
        found = arrays.get(name, np.array(np.nan))
        numeric = found.dtype.kind in "fiu"
        if found.shape != shape or not numeric or not np.isfinite(found).all():
            raise InputError(
                f"expected finite numbers of shape {shape}",
                REMEDY,
                file=path,
                where=name,
            )
    return {name: arrays[name] for name in shapes}


def _read_effects(
    entries: list[Any], path: Path, n_joints: int
) -> tuple[AppliedEffect, ...]:
    """The inherent effects, on joints that the arm has."""
    effects = tuple(
        read_entry(entry, f"effects[{i}]", path) for i, entry in enumerate(entries)
    )
    with error_context(path, effects):
        for effect in effects:
            effect.check(n_joints)
    return effects


def _check(content: Any, path: Path) -> None:
    """Check the content of ``reference.json`` against its schema."""
    from jsonschema.exceptions import best_match

    schema = content.get("schema") if isinstance(content, dict) else None
    if schema is not None and schema != SCHEMA:
        raise InputError(
            f"is of schema {schema!r}, this version of Gapscope reads {SCHEMA}",
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
