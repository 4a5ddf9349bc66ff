"""Paths in a case file: relative to its folder, or to the folder with the data sets."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gapscope.arm.errors import InputError
from gapscope.arm.input_file import is_file, is_folder, real_path
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
        if "\0" in text:
            raise InputError(
                f"{text!r} has a null byte, which no path has",
                "correct the path",
                file=self.file,
                where=f"field {field}",
            )
        mark = "${" + DATA_ROOT + "}"
        if mark not in text:
            return Path(text)
        beside = self.file.resolve().parent.parent.parent.parent / "shared" / "data"
        root = Path(self.data_root or os.environ.get(DATA_ROOT) or beside)
        if not is_folder(root):
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


def moved(content: Mapping[str, Any], old: Path, new: Path) -> dict[str, Any]:
    """The content of a case file in a folder, with the paths in it as seen from another folder.

    Those that begin with ``${`` stay as they are, and so does a robot that is a name and no file.
    """
    out = dict(content)
    if is_file(old / content["robot"]):
        out["robot"] = _moved(content["robot"], old, new)
    for key in ("recordings", "judge"):
        if key in content:
            out[key] = [_moved(entry, old, new) for entry in content[key]]
    if content.get("payloads"):
        loads = content["payloads"].items()
        out["payloads"] = {_moved(name, old, new): load for name, load in loads}
    if "calibration" in (content.get("import") or {}):
        section = content["import"]
        calibration = _moved(section["calibration"], old, new)
        out["import"] = {**section, "calibration": calibration}
    return out


def _moved(entry: Any, old: Path, new: Path) -> Any:
    """A path, or several by label, as seen from another folder."""
    if isinstance(entry, Mapping):
        return {label: _moved(text, old, new) for label, text in entry.items()}
    if entry.startswith("${") or Path(entry).is_absolute():
        return entry
    return os.path.relpath(old / entry, new)


def files_of(place: Path) -> list[Path]:
    """A file, or every file of a bag's folder; of a dataset those with numbers."""
    if not is_folder(place):
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
    return {real_path(files[text]): load for text, load in loads.items()}
