"""JSON files: read with an error that says what to do, checked against schemas, written whole or not at all."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import is_dataclass
from functools import cache
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gapscope.arm.errors import GapscopeError, InputError
from gapscope.arm.input_file import read_text
from gapscope.arm.io.atomic_write import atomic_write

if TYPE_CHECKING:
    from jsonschema import ValidationError

LARGEST_WHOLE = np.iinfo(np.int64).max
"""Size of the largest whole number in a JSON or YAML file [1]."""


def read_json(path: Path, remedy: str) -> Any:
    """Content of a JSON file.

    Args:
        path: the file.
        remedy: what to do if it cannot be read.

    Raises:
        InputError: there is no such file, it is no file, or it is not JSON.
    """
    text = read_text(path, remedy)
    try:
        return json.loads(text, parse_int=_whole_number)
    except ValueError as error:
        raise InputError(f"is not valid JSON ({error})", remedy, file=path) from None
    except RecursionError:
        raise InputError("is nested too deeply", remedy, file=path) from None


def _whole_number(text: str) -> int:
    """A whole number that a computer counts with; longer ones are no number of an arm, and no float can hold them."""
    number = int(text)
    # drawn seeds have 64 bits and no sign
    if not -LARGEST_WHOLE <= number <= np.iinfo(np.uint64).max:
        raise ValueError(f"a whole number of {len(text)} digits")
    return number


@cache
def schema(name: str) -> dict[str, Any]:
    """The schema of a document, a file of ``gapscope/schemas``, by its name."""
    file = resources.files("gapscope") / "schemas" / f"{name}.schema.json"
    content: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
    return content


def schema_fault(
    content: Any, name: str, section: str | None = None, **definitions: Any
) -> ValidationError | None:
    """What is most wrong with a plain document by its schema, or that of one of its sections; ``None`` if nothing.

    ``definitions`` take the place of those that the schema has.
    """
    from jsonschema import Draft202012Validator
    from jsonschema.exceptions import best_match

    form = schema(name)
    if section:
        # one section by itself still refers to the definitions of the whole
        form = {"$defs": form["$defs"] | definitions, **form["properties"][section]}
    return best_match(Draft202012Validator(form).iter_errors(content))


def field(path: Iterable[str | int], first: int = 0) -> str:
    """A path in a document as in Python, ``effects[0].share``; entries of lists count from ``first``."""
    steps = (f"[{s + first}]" if isinstance(s, int) else f".{s}" for s in path)
    return "".join(steps).lstrip(".")


def plain(value: Any, *, null_if_not_finite: bool = False) -> Any:
    """The same value with dict, list, int and float instead of mappings, tuples and numpy types.

    Args:
        value: data of any depth; a record stands for its fields.
        null_if_not_finite: replace NaN and infinity, which JSON does not have, by ``None``.
    """

    def convert(entry: Any) -> Any:
        return plain(entry, null_if_not_finite=null_if_not_finite)

    # NumPy's own numbers are no numbers of JSON
    if isinstance(value, (np.generic, np.ndarray)):
        value = value.tolist()
    if is_dataclass(value):
        value = vars(value)
    if isinstance(value, Mapping):
        return {key: convert(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [convert(entry) for entry in value]
    if null_if_not_finite and isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def to_json(content: Any, *, allow_nan: bool = False) -> str:
    """Content as indented JSON text that ends with a new line.

    Args:
        content: data that ``plain`` can convert.
        allow_nan: write NaN and infinity as Python's own reader takes them.

    Raises:
        ValueError: a number is not finite and ``allow_nan`` is false.
    """
    text = json.dumps(plain(content), indent=2, ensure_ascii=False, allow_nan=allow_nan)
    return text + "\n"


def write_json(content: Any, path: Path | str, *, private: bool = False) -> None:
    """Write JSON whole or not at all.

    Args:
        content: data that ``plain`` can convert, with finite numbers.
        path: the file.
        private: make it readable by its owner alone.

    Raises:
        GapscopeError: ``path`` cannot be written.
        ValueError: a number is not finite.
    """
    text = to_json(content)
    with atomic_write(path) as aside:
        # before anything is in it, so that nobody else reads half of it
        aside.touch(mode=0o600 if private else 0o644)
        aside.write_text(text, encoding="utf-8")


def check_document(content: Any, name: str) -> None:
    """Check a plain document, ``NAME.json``, against its schema.

    Raises:
        GapscopeError: a field is missing or has a wrong value; the message names the field.
    """
    fault = schema_fault(content, name)
    if fault is not None:
        raise GapscopeError(
            f"{name}.json, field {field(fault.absolute_path) or 'at the top'}: {fault.message}",
            f"gapscope/schemas/{name}.schema.json describes the format",
        )


def write_document(content: Mapping[str, Any], path: Path | str, name: str) -> None:
    """Write a document, plain or not, by its schema; ``path`` never holds half of one; what is not finite is null.

    Raises:
        GapscopeError: the document is not valid, or ``path`` cannot be written.
    """
    # the schema has finite numbers or null
    found = plain(content, null_if_not_finite=True)
    check_document(found, name)
    write_json(found, path)
