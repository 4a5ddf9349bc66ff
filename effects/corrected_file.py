"""The file ``corrected.yaml``: effects with their values, and where a residual network lies; read and written."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import yaml

from arm.case_file import read_yaml
from arm.errors import InputError, ModelWarning
from arm.nominal import NominalArm
from arm.whole import written_whole
from effects.applied import AppliedEffect
from effects.corrected import CorrectedArm
from effects.residual.file import read_residual
from effects.residual.model import ResidualNetwork

_KEYS = {"schema", "case", "effects", "residual"}


def write_corrected(case: str, effects: tuple[AppliedEffect, ...], path: Path, residual: str | None = None) -> None:
    """Write effects as ``corrected.yaml``; ``path`` never holds half of one.

    Args:
        case: name of the case.
        effects: the effects.
        path: the file.
        residual: file of a residual network, relative to the folder of ``path``; it is not written here.

    Raises:
        GapscopeError: the file cannot be written.
    """
    content: dict[str, Any] = {
        "schema": 1,
        "case": case,
        "effects": [
            {
                "effect": applied.name,
                "joints": list(applied.joints),
                "parameters": {name: value.tolist() for name, value in applied.parameters.items()},
            }
            for applied in effects
        ],
    }
    if residual is not None:
        content["residual"] = residual
    with written_whole(path) as aside:
        aside.write_text(yaml.safe_dump(content, sort_keys=False, default_flow_style=None), encoding="utf-8")


def read_corrected(path: Path | str) -> tuple[AppliedEffect, ...]:
    """Effects from a file of the form of ``corrected.yaml``, for a simulator: a residual network is left out.

    Raises:
        InputError: the file is missing, not YAML, or an entry is not an effect of the catalogue; names the entry.
    """
    content, path = _content(Path(path)), Path(path)
    if content.get("residual"):
        warnings.warn(f"{path}: the residual network is left out, it only predicts torque", ModelWarning, stacklevel=2)
    return _effects(content, path)


def read_corrected_arm(arm: NominalArm, path: Path | str) -> CorrectedArm:
    """The corrected arm from a nominal one and a file of the form of ``corrected.yaml``, residual network included.

    Raises:
        InputError: as ``read_corrected``; or the network cannot be read, or is of another arm; a joint does not exist.
    """
    content, path = _content(Path(path)), Path(path)
    effects = _effects(content, path)
    corrected = CorrectedArm(arm, effects, _residual(content, path))
    with blaming(path, effects):
        corrected.check()
    return corrected


def _residual(content: dict[str, Any], path: Path) -> ResidualNetwork | None:
    """The residual network that a file names, if any."""
    name = content.get("residual")
    if name is None:
        return None
    if not isinstance(name, str) or not name:
        raise InputError("expected the name of a file", "write residual: residual.npz", file=path, where="residual")
    return read_residual(path.parent / name)


def _content(path: Path) -> dict[str, Any]:
    """Content of the file, its keys checked."""
    content = read_yaml(path, "check the path")
    if not isinstance(content, dict) or content.get("schema") != 1 or not isinstance(content.get("effects"), list):
        raise InputError(
            "expected the keys schema: 1 and effects: [...]", "see corrected.yaml of a diagnosis", file=path
        )
    if unknown := set(content) - _KEYS:
        raise InputError(f"unknown key {sorted(unknown)[0]!r}", f"known are {', '.join(sorted(_KEYS))}", file=path)
    return content


def _effects(content: dict[str, Any], path: Path) -> tuple[AppliedEffect, ...]:
    return tuple(_entry(entry, f"effects[{i}]", path) for i, entry in enumerate(content["effects"]))


@contextmanager
def blaming(path: Path | str | None, effects: Sequence[AppliedEffect]) -> Iterator[None]:
    """Errors about one of the effects name the file that it comes from, and its place there.

    Args:
        path: the file, or ``None`` where there is none.
        effects: its effects, in their order.
    """
    try:
        yield
    except InputError as error:
        if path is not None and error.file is None and error.where == "residual":
            raise error.at(Path(path)) from None
        name = error.where.split(".")[0].split(",")[0]
        place = next((i for i, applied in enumerate(effects) if applied.name == name), None)
        if path is None or error.file is not None or place is None:
            raise
        raise error.at(Path(path), f"effects[{place}]") from None


def _entry(entry: Any, where: str, path: Path) -> AppliedEffect:
    if not isinstance(entry, dict) or not isinstance(entry.get("parameters"), dict) or "effect" not in entry:
        raise InputError(
            "expected effect:, joints: and parameters:",
            "write for instance {effect: coulomb_friction, joints: [2], parameters: {torque: [4.0]}}",
            file=path,
            where=where,
        )
    try:
        return AppliedEffect(str(entry["effect"]), tuple(entry.get("joints") or ()), entry["parameters"])
    except InputError as error:
        raise error.at(path, where) from None
    except (TypeError, ValueError) as error:
        raise InputError(
            f"holds a value that is not a number ({error})", "joints: takes a list of numbers", file=path, where=where
        ) from None
