"""A case with what was put right: its file as a person can go on with it."""

from __future__ import annotations

import os
import xml.etree.ElementTree as ET
from collections.abc import Callable, Sequence
from pathlib import Path

from gapscope.arm.case import Case
from gapscope.arm.dynamics.description import read_description
from gapscope.arm.io.atomic_write import write_text
from gapscope.arm.io.case_file import moved, read_case_file
from gapscope.arm.nominal import NominalArm
from gapscope.arm.reading import Reading
from gapscope.arm.robots import shifted_root
from gapscope.diagnosis.setup_faults.found_fault import FoundFault
from gapscope.inspection.inspection import filled

CASE, URDF = "mended_case.yaml", "mended.urdf"

CHANGES = {
    "time": ("time_factor",),
    "motion": ("motion",),
    "torque": ("torque", "torque_delay", "gravity"),
    "sensor": ("sensor",),
    "reference": ("lead", "pace"),
    "dq": ("own_velocity",),
    "tau": ("law",),
    "robot": ("link_shift",),
    "controller": ("kp_factor", "kd_factor"),
}
"""What of a reading a case file says: in entries of ``mend:``, channels that are not read, and keys of the case."""
UNREAD = ("dq", "tau")


def _asks(fault: FoundFault, case: Case) -> set[str]:
    """What a fault asks to change: keys of ``CHANGES``; nothing if every diagnosis puts it right, or no file can."""
    reading = fault.reading(case.arm.n_joints)
    asked = {key for key, names in CHANGES.items() if reading.differs(*names)}
    if case.controller is None:
        # else the controller gives a torque that was not measured
        asked.discard("tau")
    names = {r.name for r in (*case.recordings, *case.judged)}
    # all but the time is said of all files
    partial = fault.recordings and names - set(fault.recordings)
    return asked & {"time"} if partial else asked


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
    # a case without faults must not lie beside one that was mended
    for name in (CASE, URDF):
        (folder / name).unlink(missing_ok=True)
    asked = [(fault, _asks(fault, case)) for fault in faults]
    if not any(keys for _, keys in asked):
        return ()

    def reason(key: str) -> str:
        """The faults for which something is changed; empty if it is not."""
        return "; ".join(str(fault) for fault, keys in asked if key in keys)

    def after(reading: Reading) -> Reading:
        """How the case must be read of which the file says to read it in a way already."""
        for fault, keys in asked:
            if keys:
                reading = reading.then(fault.reading(case.arm.n_joints))
        return reading

    reading = after(Reading.identity(case.arm.n_joints))
    source = case_file()
    # paths count from the folder of the new file
    content = moved(read_case_file(source), source.parent, folder)
    content["name"] = f"{content['name']} mended"
    written = [folder / CASE]
    if reason("robot"):
        _write_urdf(case.arm, reading, folder / URDF)
        content["robot"] = URDF
        written.append(folder / URDF)
    if reason("controller"):
        at_work = reading.controller(case.controller)
        assert at_work is not None
        # all gains: those of joints without a fault are the declared ones
        gains = {g.name: getattr(at_work, g.name).tolist() for g in at_work.gains}
        content["controller"] = {**content["controller"], **gains}
    section = dict(content.pop("import", None) or {})
    # what the file mends already comes first, then what was found
    before = Reading.from_mend(section.pop("mend", None) or {}, case.arm.n_joints)
    # null: the channel is not read
    section |= {name: None for name in UNREAD if reason(name)}
    text = filled(
        Path(__file__).with_name("mended_case.yaml.j2"),
        source=source.name,
        left=[str(fault) for fault, keys in asked if not keys],
        content=content,
        section=section,
        mend=after(before).to_mend(),
        reason=reason,
        unread=UNREAD,
    )
    write_text(folder / CASE, text)
    return tuple(written)


def _write_urdf(arm: NominalArm, reading: Reading, path: Path) -> None:
    """The arm's URDF with its inertials moved, and its meshes found from the new place."""
    tree = read_description(arm.urdf, shapes=False)
    root = shifted_root(tree, reading.link_shift, reading.moved_only)
    for mesh in root.iter("mesh"):
        name = mesh.get("filename", "")
        # packages and absolute paths are found from anywhere
        if name and "://" not in name and not Path(name).is_absolute():
            there = arm.urdf.resolve().parent / name
            mesh.set("filename", os.path.relpath(there, path.resolve().parent))
    write_text(path, ET.tostring(root, encoding="unicode"))
