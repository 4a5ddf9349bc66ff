"""A reference: identified once from recordings, made a possible arm, and kept in a file."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from gapscope.arm.case import Case
from gapscope.arm.dynamics.inertials import inertial_scale
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import GapscopeError, InputError
from gapscope.arm.input_file import (
    LARGEST_IN_MEMORY,
    is_file,
    is_folder,
    read_arrays,
    read_bytes,
    read_text,
)
from gapscope.arm.io.atomic_write import atomic_write
from gapscope.arm.io.json_file import read_json, schema_fault, write_json
from gapscope.arm.known_load import KnownLoad
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording
from gapscope.diagnosis.gap.commanded_torque import with_commanded_torque
from gapscope.diagnosis.gap.plausible_data import (
    check_moving,
    check_rates,
    check_stamps,
    check_torque,
    select_windows,
    short_note,
    still_note,
)
from gapscope.diagnosis.setup_faults.clocks import find_quantization
from gapscope.diagnosis.setup_faults.detection import find_setup_faults
from gapscope.diagnosis.setup_faults.fault_search import looks_late
from gapscope.diagnosis.setup_faults.found_fault import repaired
from gapscope.ident.model.physical_parameters import nearest_possible, urdf_text
from gapscope.model.design import BODIES, FreeArm, design, fitted_arm
from gapscope.model.equations import Equations, learn
from gapscope.model.rows import Rows
from gapscope.model.terms import Terms

# An arm that predicts as files have it: possible bodies, a data sheet, effects, and what is left of its bodies.


@dataclass(frozen=True)
class PossibleArm:
    """An arm whose bodies can be, the nearest to those that predict best.

    Attributes:
        arm: the nominal arm with the data sheet that was found; its bodies are in ``urdf``.
        urdf: text of a URDF of its bodies.
        theta: coordinates of the effects that it has beside its data sheet, (P,).
        remainder: of the inertial parameters of each link, which the bodies lack to predict best, (n, 10).
        lacking: RMS torque of it on the first group [N m], (n,).
        torque_ratio: torque of the bodies that predict best over that of the nominal ones, by least squares [1].
    """

    arm: NominalArm
    urdf: str
    theta: np.ndarray
    remainder: np.ndarray
    lacking: np.ndarray
    torque_ratio: float


def possible_arm(
    free: FreeArm, sheet: NominalArm, rows: Rows, noise2: np.ndarray
) -> PossibleArm:
    """The possible arm nearest to one that predicts, by the torque of the first group.

    Args:
        free: the arm that predicts.
        sheet: the nominal arm with its data sheet.
        rows: of all groups.
        noise2: variance of the noise of each joint, over the square of its scale [1], (n,).

    Raises:
        GapscopeError: the solver finds no possible bodies.
    """
    n, scale = sheet.n_joints, inertial_scale(free.body)
    squares = _squares(free.body, rows)
    by_noise = squares / (noise2 * rows.scale**2)[:, None, None]
    normal = np.diag((BODIES * scale) ** -2.0) + by_noise.sum(axis=0)
    nominal = free.body.inertial_parameters()
    right = normal @ free.increments.ravel()
    value = nearest_possible(normal, right, nominal, n)
    change = (value - nominal).reshape(n, 10)
    body: RigidBody = free.body.changed(change)
    terms, theta = Terms(n, {}, sheet.coupled_motors), free.theta.copy()
    drives: dict[str, Any] = {}
    for effect in terms.definitions:
        name = effect.fitted.data_sheet
        if name is not None:
            own = terms.block(effect.name)[0]
            drives[name] = np.maximum(theta[own], 0.0)
            theta[own] = 0.0
    arm = replace(sheet, **drives, friction_source="the reference, identified")
    remainder = free.increments - change
    count = np.count_nonzero(rows.of(0))
    lacking = np.einsum("jpq,p,q->j", squares, remainder.ravel(), remainder.ravel())
    of_all = squares.sum(axis=0) @ nominal
    return PossibleArm(
        arm,
        urdf_text(arm, body),
        theta,
        remainder,
        np.sqrt(np.maximum(lacking, 0.0) / count),
        float(
            (nominal + free.increments.ravel())
            @ of_all
            / max(nominal @ of_all, np.finfo(float).tiny)
        ),
    )


def _squares(body: RigidBody, rows: Rows) -> np.ndarray:
    """Sums over the rows of the first group of the products of the inertial columns, per joint, (n, 10 n, 10 n)."""
    n = body.n_joints
    out = np.zeros((n, 10 * n, 10 * n))
    for k, segment in enumerate(rows.segments):
        if rows.group_of[k]:
            continue
        motion = segment.motion
        regressor = body.regressor(motion.q, motion.dq, motion.ddq)
        x = rows.thin(regressor, segment)
        for j in range(n):
            out[j] += x[:, j].T @ x[:, j]
    return out


# The reference of a comparison: recordings of a healthy arm, and the possible arm nearest to what they show.


URDF = "identified.urdf"
"""File of the identified bodies."""


@dataclass(frozen=True, eq=False)
class KeptReference:
    """All that a comparison needs of a reference, an arm with n joints.

    Attributes:
        name: of the reference case.
        joints: names of the joints, in the order of the reference.
        coupled_motors: numbers from 1 of the motors that turn several joints.
        gravity: in the base frame [m/s^2], (3,).
        urdf: text of a URDF of possible bodies that predict the reference best.
        armature: reflected rotor inertia that was found with them [kg m^2], (n,).
        coulomb: Coulomb friction [N m], (n,).
        viscous: viscous friction [N m s/rad], (n,).
        recordings: with a torque, faults of the set-up repaired; of long ones the windows that are looked at.
        faults: name and variant of the faults of the set-up that show on the reference.
        warnings: what makes it doubtful as a reference.
        made_from: hashes of the reference's files and of the program, see ``gapscope.provenance.made_from``.
        file: the document that it was read from; ``None`` if it was made in this run.
    """

    name: str
    joints: tuple[str, ...]
    coupled_motors: tuple[int, ...]
    gravity: np.ndarray
    urdf: str
    armature: np.ndarray
    coulomb: np.ndarray
    viscous: np.ndarray
    recordings: tuple[Recording, ...]
    faults: frozenset[tuple[str, str]] = frozenset()
    warnings: tuple[str, ...] = ()
    made_from: Mapping[str, str] = field(default_factory=dict)
    file: Path | None = None

    def on(self, case: Case, folder: Path) -> Case:
        """A case with the identified arm as its nominal one, by which faults of the set-up are looked for.

        Args:
            case: of the same arm.
            folder: where its URDF is written, ``identified.urdf``.
        """
        urdf = folder / URDF
        urdf.write_bytes(self.urdf.encode())
        arm = replace(
            case.arm,
            urdf=urdf,
            armature=self.armature,
            coulomb=self.coulomb,
            viscous=self.viscous,
            friction_source="the reference, identified",
        )
        return replace(case, arm=arm)


# A reference as a folder: ``reference.json``, ``reference.npz`` and ``identified.urdf``.
#
# The JSON file is removed first and written last, and holds the hashes of the other two: a folder that was not written
# to its end, or whose files belong to two references, is refused.


SCHEMA = 2
DOCUMENT, ARRAYS = "reference.json", "reference.npz"
FOLDER = "identified"
"""Folder in which a diagnosis keeps its reference, beside its results."""
REMEDY = "keep the reference again: gapscope diagnose CASE --against REFERENCE --out DIR writes DIR/identified"
CHANNELS = ("t", "q", "tau")
"""What is kept of a recording."""


def identified_folder(path: Path) -> Path | None:
    """The folder of a kept reference: the path itself, or ``identified`` in it; ``None`` if it is a case."""
    if not is_folder(path) or is_file(path / "case.yaml"):
        return None
    for folder in (path, path / FOLDER):
        if any(is_file(folder / name) for name in (DOCUMENT, ARRAYS)):
            return folder
    return None


def write_reference(reference: KeptReference, folder: Path) -> Path:
    """Write a reference; ``reference.json`` comes last.

    Returns:
        The path of ``reference.json``.

    Raises:
        GapscopeError: a file cannot be written.
    """
    document = folder / DOCUMENT
    try:
        document.unlink(missing_ok=True)
    except OSError as error:
        raise GapscopeError(
            f"{document}: cannot be replaced ({error.strerror})", "remove it"
        ) from None
    arrays = {
        f"{channel}{k + 1}": getattr(recording, channel)
        for k, recording in enumerate(reference.recordings)
        for channel in CHANNELS
    }
    with atomic_write(folder / ARRAYS) as aside, aside.open("wb") as stream:
        np.savez_compressed(stream, allow_pickle=False, **arrays)
    with atomic_write(folder / URDF) as aside:
        aside.write_bytes(reference.urdf.encode())
    hashes = {name: _sha256((folder / name).read_bytes()) for name in (URDF, ARRAYS)}
    write_json({**_content(reference), "files": hashes}, document)
    return document


def _content(reference: KeptReference) -> dict[str, Any]:
    """What ``reference.json`` says of the reference."""
    return {
        "schema": SCHEMA,
        "reference": reference.name,
        "recordings": [_entry(recording) for recording in reference.recordings],
        "made_from": reference.made_from,
        "joints": reference.joints,
        "coupled_motors": reference.coupled_motors,
        "gravity": reference.gravity,
        "armature": reference.armature,
        "coulomb": reference.coulomb,
        "viscous": reference.viscous,
        "faults": sorted(reference.faults),
        "warnings": reference.warnings,
    }


def _entry(recording: Recording) -> dict[str, Any]:
    """What ``reference.json`` says of a recording: its name, its length, and the body that it carried."""
    load = recording.payload
    carried = None if load is None else {"mass": load.mass, "com": list(load.com)}
    return {"name": recording.name, "samples": len(recording.t), "payload": carried}


def read_reference(folder: Path) -> KeptReference:
    """Read a reference.

    Args:
        folder: that ``write_reference`` wrote.

    Raises:
        InputError: a file is missing, changed or not of this format; names the file and the field.
    """
    path = folder / DOCUMENT
    if not is_file(path):
        raise InputError(
            "is missing: the reference was not written to its end",
            REMEDY,
            file=path,
        )
    content = read_json(path, REMEDY)
    _check(content, path)
    for name in (URDF, ARRAYS):
        _check_unchanged(folder / name, content)
    return KeptReference(
        name=content["reference"],
        joints=tuple(content["joints"]),
        coupled_motors=tuple(content["coupled_motors"]),
        gravity=np.array(content["gravity"], dtype=float),
        urdf=read_text(folder / URDF, REMEDY),
        armature=_per_joint("armature", content, path),
        coulomb=_per_joint("coulomb", content, path),
        viscous=_per_joint("viscous", content, path),
        recordings=_read_recordings(folder / ARRAYS, content),
        faults=frozenset((name, variant) for name, variant in content["faults"]),
        warnings=tuple(content["warnings"]),
        made_from=content["made_from"],
        file=path,
    )


def _check_unchanged(path: Path, content: Mapping[str, Any]) -> None:
    """Check that a file beside ``reference.json`` has the hash that stands there."""
    found = read_bytes(path, REMEDY, LARGEST_IN_MEMORY)
    if _sha256(found) != content["files"][path.name]:
        raise InputError(
            f"is not the file that {DOCUMENT} was written with",
            REMEDY,
            file=path,
            where=f"field files.{path.name} of {DOCUMENT}",
        )


def _per_joint(name: str, content: Mapping[str, Any], path: Path) -> np.ndarray:
    """A field with one number for each joint, (n,)."""
    value, n = np.array(content[name], dtype=float), len(content["joints"])
    if value.shape != (n,):
        raise InputError(
            f"has {value.size} numbers, the arm has {n} joints",
            REMEDY,
            file=path,
            where=f"field {name}",
        )
    return value


def _read_recordings(path: Path, content: Mapping[str, Any]) -> tuple[Recording, ...]:
    """The recordings of ``reference.npz``, finite and of the shapes that the document states."""
    arrays, n = read_arrays(path, REMEDY), len(content["joints"])
    recordings = []
    for k, entry in enumerate(content["recordings"], 1):
        samples, carried = entry["samples"], entry["payload"]
        shapes = {"t": (samples,), "q": (samples, n), "tau": (samples, n)}
        t, q, tau = (
            _finite(f"{name}{k}", arrays, shape, path) for name, shape in shapes.items()
        )
        load = carried and KnownLoad(carried["mass"], tuple(carried["com"]))
        recordings.append(Recording(entry["name"], t, q, tau, payload=load))
    return tuple(recordings)


def _finite(
    name: str, arrays: Mapping[str, np.ndarray], shape: tuple[int, ...], path: Path
) -> np.ndarray:
    """An array of finite numbers of a shape."""
    found = arrays.get(name, np.array(np.nan))
    numeric = found.dtype.kind in "fiu"
    if found.shape != shape or not numeric or not np.isfinite(found).all():
        raise InputError(
            f"expected finite numbers of shape {shape}",
            REMEDY,
            file=path,
            where=name,
        )
    return found


def _check(content: Any, path: Path) -> None:
    """Check the content of ``reference.json`` against its schema."""
    schema = content.get("schema") if isinstance(content, dict) else None
    if schema is not None and schema != SCHEMA:
        raise InputError(
            f"is of schema {schema!r}, this version of Gapscope reads {SCHEMA}: "
            "it compares with the recordings of a reference",
            REMEDY,
            file=path,
            where="field schema",
        )
    error = schema_fault(content, "reference")
    if error is not None:
        field = ".".join(str(step) for step in error.absolute_path)
        where = f"field {field}" if field else ""
        raise InputError(error.message, REMEDY, file=path, where=where)


def _sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


# A reference made ready: recordings of a healthy arm, faults of the set-up put right, and its nearest possible arm.


def identify_reference(
    reference: Case, progress: Callable[[str], None] = lambda message: None
) -> KeptReference:
    """Make a reference ready: whatever shows on it is no change.

    Args:
        reference: the arm, known healthy and without load.
        progress: called with a few words at each step.

    Raises:
        InputError: no torque, no motion, too short, torque in another unit; says what to do.
        GapscopeError: no physically consistent bodies were found.
    """
    reference = with_commanded_torque(reference)
    check_stamps(reference)
    check_torque(reference)
    check_moving(reference)
    check_rates(reference)
    with threadpool_limits(1):
        progress("identifies the arm")
        kept = _kept(select_windows(reference))
        progress("tests the set-up")
        with TemporaryDirectory(prefix="gapscope-") as folder:
            nominal = kept.on(reference, Path(folder))
            # the gravity of an arm that was identified on a torque is in that torque
            faults = tuple(
                fault
                for fault in find_setup_faults(nominal)
                if not fault.reading(reference.arm.n_joints).differs("gravity")
            )
            right = select_windows(repaired(nominal, faults))
            faults = (*faults, *find_quantization(right))
            late = looks_late(nominal)
        if faults:
            # of what is put right here, the case shows the same against the arm that is right
            kept = _kept(replace(right, arm=reference.arm))
    names = {(fault.name, fault.variant) for fault in faults}
    if late:
        names.add(("late_torque", "delay"))
    return replace(
        kept,
        recordings=tuple(r for r in right.recordings if r.tau is not None),
        faults=frozenset(names),
        warnings=(
            *still_note(reference),
            *short_note(reference),
            *_single_note(right.recordings),
        ),
    )


def _single_note(recordings: Sequence[Recording]) -> tuple[str, ...]:
    """A sentence on a reference of one recording."""
    if len([r for r in recordings if r.tau is not None]) > 1:
        return ()
    return (
        "one recording does not show how differently the model misses other motions, which then looks like a change: "
        "record the healthy arm in two other motions at least, or take what is found as a suspicion",
    )


def _kept(reference: Case) -> KeptReference:
    """The reference as it was recorded, with the possible arm that predicts it best."""
    rows = Rows.recorded([reference.recordings])
    free = fitted_arm(rows, reference.arm, {0})
    noise2 = learn(Equations.of(design(rows, free, {})), {0}).noise2
    found = possible_arm(free, reference.arm, rows, noise2)
    return KeptReference(
        name=reference.name,
        joints=reference.arm.joints,
        coupled_motors=reference.arm.coupled_motors,
        gravity=reference.arm.gravity,
        urdf=found.urdf,
        armature=found.arm.armature,
        coulomb=found.arm.coulomb,
        viscous=found.arm.viscous,
        recordings=reference.recordings,
    )
