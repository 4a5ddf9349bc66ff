"""The file ``corrected.yaml``: effects with their values, read and written."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import yaml

from arm.errors import InputError
from arm.whole import written_whole
from effects.applied import AppliedEffect

_KEYS = {"schema", "case", "effects", "residual"}


def write_corrected(case: str, effects: tuple[AppliedEffect, ...], path: Path) -> None:
    """Write effects as ``corrected.yaml``; ``path`` never holds half of one.

    Raises:
        GapscopeError: the file cannot be written.
    """
    content = {
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
    with written_whole(path) as aside:
        aside.write_text(yaml.safe_dump(content, sort_keys=False, default_flow_style=None), encoding="utf-8")


def read_corrected(path: Path | str) -> tuple[AppliedEffect, ...]:
    """Effects from a file of the form of ``corrected.yaml``.

    Raises:
        InputError: the file is missing, not YAML, or an entry is not an effect of the catalogue; names the entry.
    """
    path = Path(path)
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror})", "check the path", file=path) from None
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise InputError(f"is not valid YAML ({error})", file=path) from None
    if not isinstance(content, dict) or content.get("schema") != 1 or not isinstance(content.get("effects"), list):
        raise InputError(
            "expected the keys schema: 1 and effects: [...]", "see corrected.yaml of a diagnosis", file=path
        )
    if unknown := set(content) - _KEYS:
        raise InputError(f"unknown key {sorted(unknown)[0]!r}", f"known are {', '.join(sorted(_KEYS))}", file=path)
    if content.get("residual"):
        raise InputError("residual networks cannot be used yet", "remove the line", file=path, where="residual")
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
