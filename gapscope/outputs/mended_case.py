"""``mended_case.yaml``: the case with the set-up faults that a diagnosis found put right, and why, line by line."""

from __future__ import annotations

import os
import xml.etree.ElementTree as ET
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import yaml

from gapscope.arm.case import Case
from gapscope.arm.io.atomic_write import atomic_write
from gapscope.arm.io.case_file import read_case_file
from gapscope.arm.io.case_paths import moved
from gapscope.arm.nominal import NominalArm
from gapscope.diagnosis.setup_faults.found_fault import FoundFault
from gapscope.diagnosis.setup_faults.mended_import import Mending, mending
from gapscope.effects.setup_faults.inertial_fault import ShiftedInertials

CASE, URDF = "mended_case.yaml", "mended.urdf"


def write_mended_case(
    faults: Sequence[FoundFault],
    case: Case,
    case_file: Callable[[], Path],
    folder: Path,
) -> tuple[Path, ...]:
    """Write the case, and the URDF whose inertials were on other links, if there is anything to put right.

    What an earlier run has left there is removed.

    Args:
        faults: as a diagnosis of the case found them.
        case: the case.
        case_file: gives the case file; asked only if there is anything to put right.
        folder: to write to; the recordings stay where they are.

    Returns:
        The files that were written.

    Raises:
        GapscopeError: a file cannot be written.
    """
    for name in (CASE, URDF):
        (folder / name).unlink(missing_ok=True)
    mended = mending(faults, case)
    if not mended:
        return ()
    source = case_file()
    content = moved(read_case_file(source), source.parent, folder)
    content["name"] = f"{content['name']} mended"
    written = [folder / CASE]
    if mended.reason("robot"):
        _write_urdf(case.arm, mended, folder / URDF)
        content["robot"] = URDF
        written.append(folder / URDF)
    if mended.reason("controller"):
        at_work = mended.controller(case.controller)
        assert at_work is not None
        gains = {g.name: getattr(at_work, g.name).tolist() for g in at_work.gains}
        content["controller"] = {**content["controller"], **gains}
    with atomic_write(folder / CASE) as aside:
        aside.write_text(_text(content, mended, source), encoding="utf-8")
    return tuple(written)


def _text(content: dict[str, Any], mended: Mending, source: Path) -> str:
    """The case file, with a comment on each line that was changed."""
    lines = [f"# {source.name}, with what gapscope diagnose found wrong put right"]
    lines += [f"# left to every diagnosis: {fault}" for fault in mended.others]
    section = dict(content.pop("import", None) or {})
    mend = mended.after(section.pop("mend", None) or {})
    section |= dict.fromkeys(mended.unread)
    for key, value in content.items():
        lines += _entry(key, value, mended.reason(key))
    if section or mend:
        lines.append("import:")
    for key, value in section.items():
        why = mended.reason(key) if key in mended.unread else ""
        lines += [f"  {line}" for line in _entry(key, value, why)]
    if mend:
        lines.append("  mend:  # after all other keys of this section")
    for key, value in mend.items():
        lines += [f"    {key}: {_flow(value)}{_comment(mended.reason(key))}"]
    return "\n".join(lines) + "\n"


def _entry(key: str, value: Any, why: str) -> list[str]:
    """Lines of a key with its value, a mapping over several, and why it was changed."""
    if not isinstance(value, dict) or not value:
        return [f"{key}: {_flow(value)}{_comment(why)}"]
    inner = [f"  {name}: {_flow(part)}" for name, part in value.items()]
    return [f"{key}:{_comment(why)}", *inner]


def _comment(why: str) -> str:
    return f"  # {why}" if why else ""


def _flow(value: Any) -> str:
    """A value as YAML on one line."""
    text = yaml.safe_dump(
        [value], sort_keys=False, default_flow_style=True, width=float("inf")
    )
    return text.strip()[1:-1]


def _write_urdf(arm: NominalArm, mended: Mending, path: Path) -> None:
    """The arm's URDF with its inertials moved, and its meshes found from the new place."""
    fault = ShiftedInertials(*mended.shift)
    root = ET.fromstring(fault.urdf(arm.urdf.read_text(encoding="utf-8")))
    for mesh in root.iter("mesh"):
        name = mesh.get("filename", "")
        if name and "://" not in name and not Path(name).is_absolute():
            there = arm.urdf.resolve().parent / name
            mesh.set("filename", os.path.relpath(there, path.resolve().parent))
    with atomic_write(path) as aside:
        aside.write_text(ET.tostring(root, encoding="unicode"), encoding="utf-8")
