"""JSON files, read with an error that says what to do."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from gapscope.arm.errors import InputError


def read_json(path: Path, remedy: str) -> Any:
    """Content of a JSON file.

    Args:
        path: the file.
        remedy: what to do where it cannot be read.

    Raises:
        InputError: there is no such file, or it is not JSON.
    """
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(
            f"cannot be read ({error.strerror})", remedy, file=path
        ) from None
    except ValueError as error:
        raise InputError(f"is not valid JSON ({error})", remedy, file=path) from None
