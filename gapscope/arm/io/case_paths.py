"""Paths in a case file: relative to its folder, or to the folder with the data sets."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gapscope.arm.errors import InputError
from gapscope.arm.io.formats.lerobot import dataset_files, is_dataset
from gapscope.arm.known_load import KnownLoad, parse_payloads

DATA_ROOT = "GAPSCOPE_DATA"
"""Environment variable with the folder that replaces ``${GAPSCOPE_DATA}`` in a path of a case."""


@dataclass(frozen=True)
class CasePaths:
    """Paths of a case file, from their text."""

    file: Path
    data_root: Path | None

    def expand(self, text: str, field: str) -> Path:
        """A path with ``${GAPSCOPE_DATA}`` filled in; relative ones stay relative to the case's folder."""
        mark = "${" + DATA_ROOT + "}"
        if mark not in text:
            return Path(text)
        beside = self.file.resolve().parent.parent.parent.parent / "shared" / "data"
        root = Path(self.data_root or os.environ.get(DATA_ROOT) or beside)
        if not root.is_dir():
            raise InputError(
                f"{mark} is replaced by {root}, which is not a folder",
                f"set the environment variable {DATA_ROOT} to the folder with the data sets",
                file=self.file,
                where=f"field {field}",
            )
        return Path(text.replace(mark, str(root.resolve())))

    def entry(
        self, entry: str | Mapping[str, str], field: str
    ) -> Path | dict[str, Path]:
        """Path of a recording, or the paths of its files by label."""
        if isinstance(entry, str):
            return self.file.parent / self.expand(entry, field)
        return {
            label: self.file.parent / self.expand(text, field)
            for label, text in entry.items()
        }


def files_of(place: Path) -> list[Path]:
    """A file, or every file of a bag's folder; of a dataset those with numbers."""
    if not place.is_dir():
        return [place]
    if is_dataset(place):
        return dataset_files(place)
    return sorted(path for path in place.rglob("*") if path.is_file())


def known_loads(content: Mapping[str, Any], paths: CasePaths) -> dict[Path, KnownLoad]:
    """Known bodies by the path of a recording's file; of several files side by side any may be named."""
    section = content.get("payloads")
    if not section:
        return {}
    files: dict[str, Path] = {}
    for part in ("recordings", "judge"):
        for entry in content.get(part, []):
            texts = [entry] if isinstance(entry, str) else entry.values()
            for text in texts:
                files[text] = paths.file.parent / paths.expand(text, part)
    loads = parse_payloads(section, files, paths.file)
    return {files[text].resolve(): load for text, load in loads.items()}
