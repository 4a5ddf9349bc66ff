"""A reference, identified and kept, and a diagnosis against it: what the same arm has now that it had not then."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, ClassVar

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
from gapscope.arm.root_mean_square import SMALLEST
from gapscope.diagnosis.document.content import Document
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
from gapscope.diagnosis.prepare import Prepared, Progress, prepare, silent
from gapscope.diagnosis.result import Diagnosis
from gapscope.diagnosis.setup_faults.clocks import find_quantization
from gapscope.diagnosis.setup_faults.detection import find_setup_faults
from gapscope.diagnosis.setup_faults.fault_search import looks_late
from gapscope.diagnosis.setup_faults.found_fault import repaired
from gapscope.diagnosis.thresholds import (
    FRICTION_DAY_TO_DAY,
    SAME_GRAVITY,
    SAME_JOINT_PLACE,
    SIGNIFICANT_RESIDUAL_RATIO,
)
from gapscope.effects.applied import AppliedEffect, State
from gapscope.effects.catalogue import known_effect
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.effect import LinkChange
from gapscope.ident.model.physical_parameters import nearest_possible, urdf_text
from gapscope.ident.model.regressor import Regressor
from gapscope.model.design import BODIES, FreeArm, design, fitted_arm, moved, untaken
from gapscope.model.difference import Search, takeable
from gapscope.model.equations import Equations, learn
from gapscope.model.expected import expected_entries
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
    # squares of the torque in units of the noise: what a change of bodies costs
    by_noise = squares / (noise2 * rows.scale**2)[:, None, None]
    # where the data say nothing, bodies stay at their nominal values
    normal = np.diag((BODIES * scale) ** -2.0) + by_noise.sum(axis=0)
    nominal = free.body.inertial_parameters()
    # so that the free bodies are the optimum that possible ones come near to
    right = normal @ free.increments.ravel()
    names = Regressor(sheet, free.body, ()).names
    value = nearest_possible(normal, right, nominal, names)
    change = (value - nominal).reshape(n, 10)
    body: RigidBody = free.body.changed(change)
    terms, theta = Terms(n, {}, sheet.coupled_motors), free.theta.copy()
    drives: dict[str, Any] = {}
    # what a data sheet can say goes there, and out of the effects beside it
    for effect in terms.definitions:
        name = effect.fitted.data_sheet
        if name is not None:
            own = terms.block(effect.name)[0]
            # a possible arm has no negative rotor or friction
            drives[name] = np.maximum(theta[own], 0.0)
            theta[own] = 0.0
    arm = replace(sheet, **drives, friction_source="the reference, identified")
    remainder = free.increments - change
    count = np.count_nonzero(rows.of(0))
    # r^T S_j r: sum of squares of the torque that the remainder makes on joint j
    lacking = np.einsum("jpq,p,q->j", squares, remainder.ravel(), remainder.ravel())
    of_all = squares.sum(axis=0) @ nominal
    return PossibleArm(
        arm,
        urdf_text(arm, body),
        theta,
        remainder,
        np.sqrt(np.maximum(lacking, 0.0) / count),
        # nominal torque times a factor, fitted to the free one: n^T S f / n^T S n
        float(
            (nominal + free.increments.ravel())
            @ of_all
            / max(nominal @ of_all, SMALLEST)
        ),
    )


def _squares(body: RigidBody, rows: Rows) -> np.ndarray:
    """Sums over the rows of the first group of the products of the inertial columns, per joint, (n, 10 n, 10 n)."""
    n = body.n_joints
    out = np.zeros((n, 10 * n, 10 * n))
    for k, segment in enumerate(rows.segments):
        # the case tells nothing of the arm of the reference
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
SHEET = ("armature", "coulomb", "viscous")
"""What is kept of the data sheet, a number for each joint."""
SINGLE = (
    "one recording does not show how differently the model misses other motions, which then looks like a change: "
    "record the healthy arm in two other motions at least, or take what is found as a suspicion"
)
"""Warning of a reference of one recording."""
CHANNELS = ("t", "q", "tau")
"""What is kept of a recording."""


def identified_folder(path: Path) -> Path | None:
    """The folder of a kept reference: the path itself, or ``identified`` in it; ``None`` if it is a case."""
    # a case stays a case, even with a reference kept inside it
    if not is_folder(path) or is_file(path / "case.yaml"):
        return None
    for folder in (path, path / FOLDER):
        # one of the two is enough: reading says which is missing
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
    # by channel and number of the recording, from 1: t1, q1, tau1, t2, ...
    arrays = {
        f"{channel}{k + 1}": getattr(recording, channel)
        for k, recording in enumerate(reference.recordings)
        for channel in CHANNELS
    }
    recordings = []
    for recording in reference.recordings:
        load = recording.payload
        carried = None if load is None else {"mass": load.mass, "com": list(load.com)}
        own = {"name": recording.name, "samples": len(recording.t), "payload": carried}
        recordings.append(own)
    with atomic_write(folder / ARRAYS) as aside, aside.open("wb") as stream:
        np.savez_compressed(stream, **arrays)
    with atomic_write(folder / URDF) as aside:
        aside.write_bytes(reference.urdf.encode())
    hashes = {name: _sha256((folder / name).read_bytes()) for name in (URDF, ARRAYS)}
    content = {
        "schema": SCHEMA,
        "reference": reference.name,
        "recordings": recordings,
        "made_from": reference.made_from,
        "joints": reference.joints,
        "coupled_motors": reference.coupled_motors,
        "gravity": reference.gravity,
        "armature": reference.armature,
        "coulomb": reference.coulomb,
        "viscous": reference.viscous,
        "faults": sorted(reference.faults),
        "warnings": reference.warnings,
        "files": hashes,
    }
    write_json(content, document)
    return document


def read_reference(folder: Path) -> KeptReference:
    """Read a reference.

    Args:
        folder: that ``write_reference`` wrote.

    Raises:
        InputError: a file is missing, changed or not of this format; names the file and the field.
    """
    path = folder / DOCUMENT
    if not is_file(path):
        raise _unfit("is missing: the reference was not written to its end", path)
    content = read_json(path, REMEDY)
    # the version first: another one would fail at some field without saying why
    schema = content.get("schema") if isinstance(content, dict) else None
    if schema is not None and schema != SCHEMA:
        raise _unfit(
            f"is of schema {schema!r}, this version of Gapscope reads {SCHEMA}: "
            "it compares with the recordings of a reference",
            path,
            "field schema",
        )
    error = schema_fault(content, "reference")
    if error is not None:
        field = ".".join(str(step) for step in error.absolute_path)
        raise _unfit(error.message, path, f"field {field}" if field else "")
    # the files beside it have the hashes that stand there
    for name in (URDF, ARRAYS):
        found = read_bytes(folder / name, REMEDY, LARGEST_IN_MEMORY)
        if _sha256(found) != content["files"][name]:
            raise _unfit(
                f"is not the file that {DOCUMENT} was written with",
                folder / name,
                f"field files.{name} of {DOCUMENT}",
            )
    sheet, n = {}, len(content["joints"])
    for name in SHEET:
        sheet[name] = np.array(content[name], dtype=float)
        # a schema cannot tie lengths to the number of joints
        if sheet[name].shape != (n,):
            problem = f"has {sheet[name].size} numbers, the arm has {n} joints"
            raise _unfit(problem, path, f"field {name}")
    return KeptReference(
        name=content["reference"],
        joints=tuple(content["joints"]),
        coupled_motors=tuple(content["coupled_motors"]),
        gravity=np.array(content["gravity"], dtype=float),
        urdf=read_text(folder / URDF, REMEDY),
        recordings=_read_recordings(folder / ARRAYS, content),
        faults=frozenset((name, variant) for name, variant in content["faults"]),
        warnings=tuple(content["warnings"]),
        made_from=content["made_from"],
        file=path,
        **sheet,
    )


def _unfit(problem: str, path: Path, where: str = "") -> InputError:
    """The error of a file of a reference that cannot be read."""
    return InputError(problem, REMEDY, file=path, where=where)


def _read_recordings(path: Path, content: Mapping[str, Any]) -> tuple[Recording, ...]:
    """The recordings of ``reference.npz``, finite and of the shapes that the document states."""
    arrays, n = read_arrays(path, REMEDY), len(content["joints"])
    recordings = []
    for k, entry in enumerate(content["recordings"], 1):
        samples, carried = entry["samples"], entry["payload"]
        series = []
        for name in CHANNELS:
            shape = (samples,) if name == "t" else (samples, n)
            # a missing array gets a shape that no channel has
            found = arrays.get(f"{name}{k}", np.array(np.nan))
            numeric = found.dtype.kind in "fiu" and np.isfinite(found).all()
            if found.shape != shape or not numeric:
                problem = f"expected finite numbers of shape {shape}"
                raise _unfit(problem, path, f"{name}{k}")
            series.append(found)
        t, q, tau = series
        load = carried and KnownLoad(carried["mass"], tuple(carried["com"]))
        recordings.append(Recording(entry["name"], t, q, tau, payload=load))
    return tuple(recordings)


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
        # faults show against an arm that predicts: first of the torque as read
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
            # after the repair: a wrong unit scales the step of an encoder
            faults = (*faults, *find_quantization(right))
            late = looks_late(nominal)
        if faults:
            # of what is put right here, the case shows the same against the arm that is right
            kept = _kept(replace(right, arm=reference.arm))
    names = {(fault.name, fault.variant) for fault in faults}
    # not put right here, and no news if the case is as late
    if late:
        names.add(("late_torque", "delay"))
    recordings = tuple(r for r in right.recordings if r.tau is not None)
    warnings = (*still_note(reference), *short_note(reference))
    if len(recordings) == 1:
        warnings = (*warnings, SINGLE)
    return replace(
        kept, recordings=recordings, faults=frozenset(names), warnings=warnings
    )


def _kept(reference: Case) -> KeptReference:
    """The reference as it was recorded, with the possible arm that predicts it best."""
    rows = Rows.recorded([reference.recordings])
    free = fitted_arm(rows, reference.arm, {0})
    # without anything of its own: noise is what is left of motions held out
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


# A diagnosis against a reference: what the same arm has now that it had not then, as a document.


# Whether a case and a reference are of the same arm.


def place_of(reference: Case | KeptReference) -> str:
    """How messages call a reference: by its file, or by its name."""
    return f"--against {reference.file or reference.name}"


def check_same_joints(case: Case, reference: Case | KeptReference) -> None:
    """Check that number, names and order of the joints, coupled motors, and gravity, agree.

    Raises:
        InputError: they do not.
    """
    theirs = reference.arm if isinstance(reference, Case) else reference
    ours, same_arm = case.arm, "give a reference of the same arm"
    named, also = list(ours.joints), list(theirs.joints)
    how = "in another order" if sorted(named) == sorted(also) else "with other names"
    # each holds, or what is said and what to do
    for holds, problem, remedy in (
        (
            len(named) == len(also),
            f"has {len(also)} joints, {case.name} has {len(named)}: another robot",
            same_arm,
        ),
        (
            named == also,
            f"has its joints {how}: {', '.join(also)}; {case.name} has {', '.join(named)}",
            f"{same_arm}, with joints: in the order of the case",
        ),
        (
            ours.coupled_motors == theirs.coupled_motors,
            f"has coupled motors {list(theirs.coupled_motors)}, {case.name} has {list(ours.coupled_motors)}",
            "declare the same coupling in both cases, and identify the reference again",
        ),
        (
            np.allclose(ours.gravity, theirs.gravity, atol=SAME_GRAVITY),
            f"has gravity {theirs.gravity.tolist()}, {case.name} has {ours.gravity.tolist()}",
            "give a reference that was recorded in the same mounting, or correct gravity:",
        ),
    ):
        if not holds:
            raise InputError(problem, remedy, where=place_of(reference))


def check_same_places(case: Case, arm: NominalArm, place: str) -> None:
    """Check that the joints of two arms lie in the same places.

    Args:
        case: the case.
        arm: arm of the reference, vendor's or identified; both have the same kinematics.
        place: how messages call the reference.

    Raises:
        InputError: they do not.
    """
    one, other = RigidBody(case.arm).model, RigidBody(arm).model
    # largest difference in any coordinate [m] or entry of the rotation [1]
    apart = [
        max(
            float(np.abs(a.translation - b.translation).max()),
            float(np.abs(a.rotation - b.rotation).max()),
        )
        for a, b in zip(one.jointPlacements, other.jointPlacements, strict=True)
    ]
    if max(apart) > SAME_JOINT_PLACE:
        raise InputError(
            "has joints of the same names in other places: another robot, or another version of its URDF",
            "give a reference of the same arm, and both cases the same kinematics",
            where=place,
        )


def check_same_arm(case: Case, reference: Case) -> None:
    """Check that two cases are of the same arm, joint by joint.

    Raises:
        InputError: another number of joints, other names, another order, another gravity, or joints in other places.
    """
    check_same_joints(case, reference)
    check_same_places(case, reference.arm, place_of(reference))


# What changed between a reference and a case, and the arm that predicts the case.


FAULTY = 0.01
"""Probability that the set-up of a case has a fault that the reference does not have [1]."""
REFERENCE, CASE = 0, 1
"""Numbers of the groups."""
SCALED = (
    "masses are measured with the torque of the reference: were its torque constants wrong by a factor on all joints, "
    "the identified masses and the load found would be wrong by the same factor"
)
"""Warning given with each load found."""


@dataclass(frozen=True)
class ReferenceComparison(Document):
    """The contrast of a case and a reference, n joints.

    The nominal arm of the case is the one that was identified on the reference.

    Attributes:
        reference: the reference.
        vendor: nominal arm of the case as it was declared.
    """

    floor_from: ClassVar[str] = (
        "noise and form error on motions of the reference that are predicted from others"
    )
    fitted_to: ClassVar[str] = "the reference and to "
    reference: KeptReference
    vendor: NominalArm

    @property
    def faults_log_probability(self) -> float:
        """Log probability of the faults that were put right [nats]; a torque in another unit has another density."""
        error = self.fit.contrast.error
        # rows that count
        count = self.rows.of(CASE).sum() * error.white2 / error.noise2
        total = len(self.prepared.faults) * float(np.log(FAULTY))
        for found in self.prepared.setup_faults:
            # the density of a torque times k holds a factor |k| for each row that counts
            factor = np.abs(found.reading(len(count)).torque.factor)
            total += float(count @ np.log(factor))
        return total

    @cached_property
    def free(self) -> FreeArm:
        """The arm that predicts the reference, and the case but for its changes and what differs from day to day."""
        arm, contrast = self.difference.arm, self.fit.contrast
        made = contrast.design
        # beside what the case has of its own, and what both have as an effect
        left = contrast.gap - self.fit.own.torque(self.values)
        # an arm has no unknown functions: what they would do is shared out among the others
        held = np.where(untaken(made), 0.0, np.nan)
        value = takeable(contrast.for_gap(left), arm, (REFERENCE, CASE), held)
        return moved(arm, made, value)

    @cached_property
    def possible_arm(self) -> PossibleArm:
        """The possible arm nearest to it."""
        noise2 = self.fit.contrast.error.noise2
        return possible_arm(self.free, self.prepared.case.arm, self.rows, noise2)

    def effects(self, names: Sequence[str] = ()) -> tuple[AppliedEffect, ...]:
        """Effects of the arm of the reference beside its data sheet, with some findings on top."""
        # on top of what the identified arm has beside its own data sheet
        theta = self._theta(self.of(names), self.possible_arm.theta)
        return self.terms.effects(self.terms.clipped(theta))

    @property
    def states(self) -> tuple[State, ...]:
        """Effects beside the data sheet in each recording and span; none if all share a state."""
        # what remains where a change is too small to be named
        without = self._theta(self.of(()), self.possible_arm.theta)
        theta = self._theta(self.of(self.named), self.possible_arm.theta)
        return self.prepared.states.effects(self.terms, theta, without)

    @property
    def declared(self) -> NominalArm:
        """The nominal arm as it was declared."""
        return self.vendor

    @property
    def compared_with(self) -> NominalArm:
        """The possible arm that was identified."""
        return self.possible_arm.arm

    def sheet(self, day: int | None = None) -> dict[str, np.ndarray]:
        """Armature, Coulomb and viscous friction that were identified, or on the day of a group, (n,) each."""
        design = self.fit.contrast.design
        _, days = self.fit.own.nuisances(self.values)
        out: dict[str, np.ndarray] = {}
        for term in design.places:
            name = term.parametrisation.data_sheet
            if name is None:
                continue
            # one column each: rotor inertia and friction are linear
            (place,) = design.places[term]
            value = self.free.theta[term.columns[0]]
            if day is not None:
                # days are in units of torque: back to those of the sheet
                value += days[day, place] / design.units[term][0]
            out.setdefault(name, np.zeros(self.vendor.n_joints))[term.joint - 1] = value
        return out

    # What its document says in its own way.

    @property
    def unknown_joints(self) -> list[int]:
        """Joints whose form error is larger than on the reference, and what they leave far above the floor, from 1."""
        far = self.times_floor >= SIGNIFICANT_RESIDUAL_RATIO
        return sorted({j + 1 for j, *_ in self.fit.grown if far[j]})

    def warnings(self, reached: str) -> list[str]:
        """What makes the reference doubtful, and what the size of a load rests on."""
        out = [f"reference: {text}" for text in self.reference.warnings]
        changed = [known_effect(self.change(name).name) for name in self.named]
        if any(isinstance(effect, LinkChange) for effect in changed):
            out.append(SCALED)
        return out

    def further(self) -> dict[str, Any]:
        """What was identified on the reference, per joint, and what was allowed for on the day of the case."""
        contrast, rows, reference = self.fit.contrast, self.rows, self.reference
        # friction that was allowed to differ on the day is no change
        _, days = self.fit.own.nuisances(self.values)
        day = contrast.design.shared_torque(days[CASE])[self.explained.rows]
        held_out = np.sqrt(contrast.error.missed2) * rows.scale
        possible = self.possible_arm
        against = {
            "reference": reference.name,
            "recordings": [recording.name for recording in reference.recordings],
            "made_from": dict(reference.made_from),
            "identified": self.sheet(),
            "identified_std": self._sheet_deviations(),
            "friction_law": "Coulomb and viscous friction, and what the effects below add",
            "base_parameters": round(contrast.determined),
            "torque_ratio_to_nominal": possible.torque_ratio,
            # what readers of the format expect: torque and motion are compared as they were recorded
            "sampling_skew": 0.0,
            "held_out": {
                "rmse": held_out,
                "torque_nrmse": held_out / rows.scale,
            },
            "inherent": [
                {
                    "effect": effect.name,
                    "joints": effect.joints,
                    "parameters": {
                        name: effect.parameters[name] for name in effect.given
                    },
                }
                for effect in self.effects()
            ],
            # how large further effects would have to be for these recordings to show them
            "expected": expected_entries(self.difference, CASE),
            "remainder": {"torque_nrmse": possible.lacking / rows.scale},
            "today": {
                **self.sheet(CASE),
                "torque_nrmse": np.sqrt((day**2).mean(axis=0)),
                "friction_allowed": FRICTION_DAY_TO_DAY,
            },
        }
        return {"against": against}

    def _sheet_deviations(self) -> dict[str, np.ndarray]:
        """Standard deviations of what was identified of the data sheet, (n,) each."""
        contrast = self.fit.contrast
        out: dict[str, np.ndarray] = {}
        variance = np.diag(contrast.covariance())
        for term, places in contrast.design.places.items():
            name = term.parametrisation.data_sheet
            if name is not None:
                std = np.sqrt(variance[places[0]]) / contrast.design.units[term][0]
                whole = out.setdefault(name, np.zeros(self.vendor.n_joints))
                whole[term.joint - 1] = std
        return out


@dataclass(frozen=True)
class Change:
    """What changed between a reference and a case.

    Attributes:
        reference: the reference.
        case: the case, its nominal arm the possible one nearest to what predicts.
        effects: that, with this arm and ``remainder``, predict the torque recorded in the case.
        remainder: of the inertial parameters of each link, which a possible arm lacks to predict best, (n, 10).
        diagnosis: its findings.
    """

    reference: KeptReference
    case: Case
    effects: tuple[AppliedEffect, ...]
    remainder: np.ndarray
    diagnosis: Diagnosis

    @property
    def corrected(self) -> CorrectedArm:
        """The arm that predicts the torque recorded in the case."""
        states = self.diagnosis.states
        # as the arm was at the end
        last = states[-1].effects if states else self.effects
        remainder = self.remainder
        return CorrectedArm(self.case.arm, last, remainder=remainder, states=states)


# What changed: the contrast of a case and a reference of the same arm; ``docs/contrast.md`` derives it.


def diagnose_change(
    case: Case,
    reference: KeptReference,
    folder: Path,
    progress: Progress = silent,
) -> Change:
    """Find what a case has that a reference does not have.

    Args:
        case: the case.
        reference: the same arm, when it was known to be healthy and without load.
        folder: where the URDF of the identified arm is written, ``identified.urdf``.
        progress: called with a few words at each step.

    Raises:
        InputError: the reference is another robot, or in another mounting.
        GapscopeError: the case cannot be diagnosed.
    """
    check_same_joints(case, reference)
    # the controller computes with the vendor's arm: its torque before the arm changes
    nominal = reference.on(with_commanded_torque(case), folder)
    check_same_places(case, nominal.arm, place_of(reference))
    with threadpool_limits(1):
        prepared = prepare(nominal, progress, case.arm, reference.faults)
        comparison = _compared(prepared, case, reference, progress)
        given = prepared.as_given(progress)
        if given is not None:
            # a fault that is news has to explain more than no fault and no change do
            unchanged = _search(given, case, reference).unchanged()
            found = comparison.fit.total + comparison.faults_log_probability
            if unchanged > found:
                progress("takes the recordings as they are: no fault explains more")
                prepared = given
                comparison = _compared(given, case, reference, progress)
        # a computed torque may be explained better by another rule of the controller: then once more by that one
        changes = tuple(map(comparison.change, comparison.named))
        likelier = prepared.by_likelier_rule(changes, progress)
        if likelier is not None:
            comparison = _compared(likelier, case, reference, progress)
        progress("writes the findings")
        possible = comparison.possible_arm
        (folder / URDF).write_bytes(possible.urdf.encode())
        return Change(
            reference=reference,
            case=replace(comparison.prepared.case, arm=possible.arm),
            effects=comparison.effects(comparison.named),
            remainder=possible.remainder,
            diagnosis=comparison.diagnosis(),
        )


def _compared(
    prepared: Prepared,
    case: Case,
    reference: KeptReference,
    progress: Progress,
) -> ReferenceComparison:
    """The search for what the case has of its own."""
    progress("compares with the reference")
    found = _search(prepared, case, reference).run()
    return ReferenceComparison(prepared, found, CASE, reference, case.arm)


def _search(prepared: Prepared, case: Case, reference: KeptReference) -> Search:
    known = prepared.case
    rows = Rows.recorded([reference.recordings, known.recordings], known.judged)
    # what both share is free: the vendor's arm is as good a start as any
    arm = fitted_arm(rows, case.arm, {0})
    return Search(rows, arm, [(CASE,)], {0}, FRICTION_DAY_TO_DAY)
