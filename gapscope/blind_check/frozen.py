"""Whether a run was frozen: the hash of what leads to a diagnosis, its thresholds, and the versions."""

from __future__ import annotations

import ast
import platform
from typing import Any

from gapscope.provenance import PACKAGE, library_versions, source_files, source_hash


def thresholds() -> dict[str, Any]:
    """Constants of the modules of ``diagnosis``: ``module.NAME`` to its literal value."""
    found: dict[str, Any] = {}
    for path in source_files():
        place = path.relative_to(PACKAGE)
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
                    module = ".".join(place.with_suffix("").parts[1:])
                    found[f"{module}.{target.id}"] = value
    return found


def frozen() -> dict[str, Any]:
    """What a run is fixed by."""
    return {
        "source_sha256": source_hash(),
        "thresholds": thresholds(),
        "python": platform.python_version(),
        "libraries": library_versions(),
    }
