"""Records as one NPZ file: their arrays as they are, all else as JSON."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gapscope.arm.input_file import complete_file, read_arrays
from gapscope.arm.io.atomic_write import atomic_write


def write_records(value: Any, path: Path) -> None:
    """Write a dataclass of arrays, numbers, texts, dataclasses, and containers of these.

    Raises:
        GapscopeError: the file cannot be written.
    """
    arrays: list[np.ndarray] = []
    content = json.dumps(_packed(value, arrays))
    named: dict[str, Any] = {f"array{k}": array for k, array in enumerate(arrays)}
    named["content"] = np.array(content)
    with atomic_write(path) as aside:
        np.savez(aside, **named)


def read_records(path: Path, types: Iterable[type]) -> Any:
    """What ``write_records`` wrote.

    Args:
        path: the file.
        types: of the dataclasses that may be in it.

    Raises:
        InputError: the file holds no such records.
    """
    arrays = read_arrays(path, "learn the state again")
    with complete_file(path, "records"):
        content = json.loads(str(arrays.pop("content")))
        return _unpacked(content, arrays, {made.__name__: made for made in types})


def _packed(value: Any, arrays: list[np.ndarray]) -> Any:
    if isinstance(value, np.ndarray):
        # arrays go beside the text, which names them by their place
        arrays.append(value)
        return {"array": f"array{len(arrays) - 1}"}
    if is_dataclass(value):
        names = [field.name for field in fields(value)]
        parts = {name: _packed(getattr(value, name), arrays) for name in names}
        return {"record": type(value).__name__, "parts": parts}
    if isinstance(value, Mapping):
        # pairs, since keys may be other things than texts
        return {"items": [_packed(pair, arrays) for pair in value.items()]}
    if isinstance(value, tuple):
        return {"tuple": [_packed(one, arrays) for one in value]}
    if isinstance(value, list):
        return [_packed(one, arrays) for one in value]
    return value


def _unpacked(
    value: Any, arrays: Mapping[str, np.ndarray], types: Mapping[str, type]
) -> Any:
    if isinstance(value, list):
        return [_unpacked(one, arrays, types) for one in value]
    if not isinstance(value, dict):
        return value
    if "array" in value:
        return arrays[value["array"]]
    if "record" in value:
        parts = value["parts"].items()
        made = {name: _unpacked(part, arrays, types) for name, part in parts}
        # by name, out of those that the caller allows
        return types[value["record"]](**made)
    (kind, parts) = next(iter(value.items()))
    every = [_unpacked(one, arrays, types) for one in parts]
    return dict(every) if kind == "items" else tuple(every)
