"""``diagnosis.json``: checked against its schema, then written whole or not at all."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

from jsonschema import Draft202012Validator
from jsonschema.exceptions import best_match

from gapscope.arm.errors import GapscopeError, InputError
from gapscope.arm.io.json_file import plain, read_json, write_json
from gapscope.diagnosis.document.document_checks import (
    Problem,
    inconsistencies,
    not_finite,
)


def validate(document: Mapping[str, Any]) -> None:
    """Check a document against ``diagnosis.schema.json`` and what a schema cannot say.

    Raises:
        GapscopeError: a field is missing or has a wrong value; the message names the field.
    """
    first = next(_problems(plain(document)), None)
    if first is None:
        return
    field, problem = first
    place = f"field {field}" if field else "top level"
    raise GapscopeError(
        f"diagnosis.json, {place}: {problem}",
        "gapscope/diagnosis/document/diagnosis.schema.json describes the format",
    )


def write_document(document: Mapping[str, Any], path: Path | str) -> None:
    """Write a valid document as JSON; ``path`` never holds half of one.

    Raises:
        GapscopeError: the document is not valid, or ``path`` cannot be written.
    """
    validate(document)
    write_json(document, path)


def read_document(path: Path) -> Mapping[str, Any]:
    """A ``diagnosis.json``.

    Raises:
        InputError: it is missing, or not of its schema.
    """
    remedy = "give the folder that gapscope diagnose wrote"
    content = read_json(path, remedy)
    if not isinstance(content, dict):
        raise InputError("is no diagnosis", remedy, file=path)
    try:
        validate(content)
    except GapscopeError as error:
        raise InputError(error.message, remedy, file=path) from None
    return content


def _problems(content: Any) -> Iterator[Problem]:
    """Fields at fault, each with what is wrong with it."""
    yield from not_finite(content)
    error = best_match(_validator().iter_errors(content))
    if error is None:
        yield from inconsistencies(content)
    else:
        # The checks beyond the schema need the fields that it demands.
        yield _field(error.absolute_path), error.message


@cache
def _validator() -> Draft202012Validator:
    folder = resources.files("gapscope.diagnosis.document")
    text = folder.joinpath("diagnosis.schema.json").read_text(encoding="utf-8")
    return Draft202012Validator(json.loads(text))


def _field(path: Any) -> str:
    """A path in the document as in Python: ``effects[0].share``."""
    steps = [f"[{step}]" if isinstance(step, int) else f".{step}" for step in path]
    return "".join(steps).lstrip(".")
