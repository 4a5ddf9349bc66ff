"""Whether a case can be diagnosed: recordings, motion, torque and nominal arm, with remarks and a document."""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from gapscope.arm.case import Case, case_files, load_case
from gapscope.arm.display import effect_name
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import GapscopeError, InputError, ModelWarning
from gapscope.arm.io.import_section import Import
from gapscope.arm.io.json_file import plain
from gapscope.arm.io.log import READERS, open_log
from gapscope.arm.motions.motion import Motion
from gapscope.arm.recording import CHANNELS, resting
from gapscope.arm.root_mean_square import rms
from gapscope.diagnosis.document.wording import in_text, with_slide_units
from gapscope.diagnosis.gap.plausible_data import select_windows
from gapscope.diagnosis.prepare import Progress, silent, with_torque
from gapscope.diagnosis.selection.search import could_show
from gapscope.diagnosis.set_up import Remark, SetUp, look_at_set_up, numbers
from gapscope.diagnosis.setup_faults.found_fault import FoundFault, repaired
from gapscope.ident.model.base_parameters import random_states, structural_base
from gapscope.ident.model.regressor import Regressor
from gapscope.ident.samples import FrictionLaw, ModelColumns
from gapscope.inspection.inspection import inspect_logs, span_of
from gapscope.inspection.recordings import (
    check_rest,
    joints_of,
    remark,
    remarks_on,
)
from gapscope.model.conditioning import Segment, condition, position_cutoff, thinned
from gapscope.model_audit.audit import odd_kinds

# All thresholds of the check of a case, each with its meaning, its unit in brackets and its origin in parentheses.
#
# ``physical`` follows from what arms, drives and logs are; ``hand`` was set by hand, and only decides about a remark.


# fmt: off

# --- recordings
SHORT_DURATION = 10.0  # Seconds of motion in all, below which little can be told apart [s]. (hand)

# --- motion; of sliding joints in what counts as a radian
SLIDING = 0.02  # Below this speed dry friction is not fully developed [rad/s]. (physical)
# Cosine between speed and its sign, of sliding samples: at one speed it is 1, evenly spread speeds have 0.87 [1].
ONE_SPEED = 0.97  # (hand)
FEW_REVERSALS = 4  # Reversals of a joint in all recordings [1]. (hand)
ONE_WAY = 0.05  # Share of sliding samples that each direction has at least [1]. (hand)
# Gravity torque of the nominal arm over the recordings, as share of what random postures give [1]. (hand)
GRAVITY_SHARE = 0.1
MIN_GRAVITY = 0.1  # Gravity torque below this is none [N m]. (physical)
LEFT_OVER = 0.03  # Share of its torque that a healthy joint leaves, mostly the form of friction [1]. (physical)
INDEPENDENT = 0.1  # Share of the samples that are independent: a motion of 3 Hz at 60 samples a second [1]. (physical)
MIN_LOAD = 0.01  # Joints with less than this share of the largest nominal torque count as loaded so [1]. (hand)
KNOWN = 0.5  # A base parameter is excited if its standard deviation is below this share of its size [1]. (hand)
FEW_EXCITED = 0.75  # Share of base parameters that should be excited [1]. (hand)

# --- torque
AT_LIMIT = 0.01  # Share of samples at the torque limit from which it is said [1]. (hand)

# --- amount of data
SECONDS = 30.0  # Of each recording is looked at for excitation and torque [s]. (budget)
RATE = 60.0  # Samples of these per second [Hz]. (budget)
# fmt: on


# Recordings of a case: how many, how long, which channels, time stamps, copies.


def check_recordings(case: Case) -> Iterator[Remark]:
    """Number, length, channels, time stamps and copies of the recordings."""
    every = [*case.recordings, *case.judged]
    seconds = sum(recording.duration for recording in case.recordings)
    said = f"{len(case.recordings)} to fit, {seconds:.0f} s in all; {len(case.judged)} held out"
    remedy = ""
    if seconds < SHORT_DURATION:
        remedy = "record at least a minute in which all joints move, slowly and fast"
    elif len(every) == 1:
        said += ": parts of the one recording are predicted from the others"
        remedy = "add a recording of another motion, or name one in judge:, so that effects are confirmed on other data"
    yield remark("recordings", "", said, remedy)
    # channels that some of them have
    counts = Counter(name for recording in every for name in recording.channels)
    parts = [
        name
        if counts[name] == len(every)
        else f"{name} (in {counts[name]} of {len(every)})"
        for name in CHANNELS
        if counts[name]
    ]
    said, remedy = f"read: t, {', '.join(parts)}", ""
    with_torque = sum(recording.tau is not None for recording in case.recordings)
    if not with_torque:
        said += (
            "; no torque: it is worked out as what the controller must have commanded"
        )
        remedy = "record torque or motor current if you can: noise and wrong gains pass into what is worked out"
    elif with_torque < len(case.recordings):
        said += "; recordings without torque are not fitted"
        remedy = "name their torque columns in import: {tau: ...}"
    if with_torque or (case.controller is not None and counts["q_ref"]):
        yield remark("channels", "", said, remedy)
    yield from remarks_on(every)


# How the joints move, and what cannot be told from that.


SEED = 0
"""Of the random postures."""
MAX_NAMED = 8
"""Most parameters that are named."""


Motions = dict[str, np.ndarray]
"""How n joints move in all recordings that are fitted, (n,) each.

``range`` of the positions [rad or m]; ``slow``, ``fast``: 10 and 90 % quantile of the speed of sliding samples [rad/s
or m/s], 0 if it never slides; ``reversals``: changes of direction; ``gravity``: range of the nominal arm's gravity
torque [N m], ``possible_gravity`` over random postures within the limits.
"""


def check_motion(
    motions: Motions, still: np.ndarray, speeds: Sequence[np.ndarray]
) -> Iterator[Remark]:
    """What cannot be told from the motion, joint by joint.

    Args:
        motions: how the joints move.
        still: joints that rest in every recording, mask (n,).
        speeds: velocities of the sliding samples of each joint.
    """
    moving = ~still
    # cosine between the velocity and its sign, and the share of each direction; nan of a joint that never slides
    sizes = [np.abs(v) if len(v) else np.array([np.nan]) for v in speeds]
    cosine = np.array([v.mean() / np.sqrt((v**2).mean()) for v in sizes])
    forward = np.array([(v > 0).mean() if len(v) else np.nan for v in speeds])
    one_speed = moving & ~(cosine < ONE_SPEED)
    one_way = moving & ~one_speed & ~(np.minimum(forward, 1 - forward) > ONE_WAY)
    possible = motions["possible_gravity"]
    flat = moving & (possible > MIN_GRAVITY)
    flat &= motions["gravity"] < GRAVITY_SHARE * np.maximum(possible, MIN_GRAVITY)
    found = (
        (
            one_speed,
            "hardly more than one speed: Coulomb and viscous friction cannot be told apart",
            "repeat the motion ten times slower, and faster",
        ),
        (
            one_way,
            "one direction only: friction cannot be told from a constant torque",
            "move it to and fro",
        ),
        (
            moving & (motions["reversals"] < FEW_REVERSALS) & ~one_way,
            f"fewer than {FEW_REVERSALS} reversals: backlash and dry friction show at reversals",
            "move it to and fro several times",
        ),
        (
            flat,
            "hardly any change of gravity torque: torque scale, offset and joint zero cannot be told apart",
            "record in postures that differ more, arm stretched and folded",
        ),
    )
    remarks = list(check_rest(still))
    for mask, said, remedy in found:
        if mask.any():
            remarks.append(remark("excitation", joints_of(mask), said, remedy))
    well = remark("excitation", "", "all joints move to and fro, slowly and fast")
    yield from remarks or [well]


def _silent(
    columns: ModelColumns, segments: Sequence[Segment]
) -> tuple[tuple[str, ...], int]:
    """Base parameters of the bodies that would not be known to half of their size, and how many there are in all.

    X are the columns of the base parameters times 100 % of each, rows over the RMS of the joint's nominal torque. If a
    healthy arm leaves a share s of the torque, column k has the standard deviation s sqrt([(X^T X)^-1]_kk / r), r the
    share of independent samples.
    """
    regressor = Regressor(columns.arm, columns.body, ())
    base = structural_base(regressor, np.random.default_rng(SEED))
    scale = columns.scale(FrictionLaw())[: columns.links][base.kept]
    inner = (
        Motion(
            *(x[s.inner] for x in (s.motion.t, s.motion.q, s.motion.dq, s.motion.ddq))
        )
        for s in segments
    )
    rows = np.vstack([regressor.matrix(motion) for motion in inner])
    torque = rms(rows @ columns.body.inertial_parameters())
    # a joint that nothing loads has no torque to compare with
    least = MIN_LOAD * torque.max()
    rows = rows[:, :, base.kept] * scale / np.maximum(torque, least)[:, None]
    scaled = rows.reshape(-1, len(base.kept))
    normal = scaled.T @ scaled
    # so that what is not excited at all has a large deviation
    normal += 1e-12 * np.trace(normal) * np.eye(len(normal))
    deviation = LEFT_OVER * np.sqrt(np.diag(np.linalg.inv(normal)) / INDEPENDENT)
    names = [base.names[k] for k in base.kept]
    silent = tuple(
        name for name, std in zip(names, deviation, strict=True) if std > KNOWN
    )
    return silent, len(names)


def _gravity(body: RigidBody, q: np.ndarray) -> np.ndarray:
    """Range of the gravity torque over positions, (n,)."""
    return np.ptp(body.gravity_torque(q), axis=0)


def _reversals(segments: Sequence[Segment], per_radian: np.ndarray) -> np.ndarray:
    """Changes of direction between sliding samples of each joint, shape (n,)."""
    counts = np.zeros(len(per_radian), dtype=int)
    for segment in segments:
        for j, velocity in enumerate((segment.motion.dq / per_radian).T):
            direction = np.sign(velocity[np.abs(velocity) > SLIDING])
            counts[j] += np.count_nonzero(np.diff(direction))
    return counts


# The data sheet, the controller and the model of a case.


def check_nominal(case: Case, body: RigidBody) -> Iterator[Remark]:
    """Friction and where it comes from, rotors, limits, gravity, and what is odd about the model."""
    arm, sheet = case.arm, "data sheet"
    yield remark(sheet, "", f"joints in this order: {', '.join(arm.joints)}")
    give = "give nominal: {coulomb: [...], viscous: [...]}"
    coulomb, viscous = (
        ", ".join(f"{value:.3g}" for value in values)
        for values in (arm.coulomb, arm.viscous)
    )
    said = f"coulomb {coulomb} N m, viscous {viscous} N m s/rad, from {arm.friction_source}"
    remedy = ""
    alike = np.ptp(arm.coulomb) == 0 and np.ptp(arm.viscous) == 0
    if not arm.friction_source:
        said = "no friction is stated: all of it will be found as an effect"
        remedy = f"{give}, or identify the arm (gapscope identify)"
    elif alike and "data sheet" not in arm.friction_source:
        said += ": the same on all joints"
        remedy = f"a placeholder, as it seems: {give}"
    yield remark(sheet, "", said, remedy)
    if not arm.armature.any():
        said = "no rotor inertia is stated: it will be found as an effect"
        remedy = "give nominal: {armature: [...]}: inertia of the rotor times the gear ratio squared [kg m^2]"
        yield remark(sheet, "", said, remedy)
    if arm.torque_limit is None and not body.effort_limits().any():
        said = "no torque limits: saturation can only be inferred from torque"
        yield remark(sheet, "", said, "give nominal: {torque_limit: [...]}")
    # what the audit says of the robot file, in one line
    odd = odd_kinds(arm.urdf)
    said = odd or "nothing implausible in the robot file"
    yield remark("model", "", said, f"gapscope audit {arm.urdf}" if odd else "")


def check_controller(case: Case) -> Iterator[Remark]:
    """Whether the closed loop can be simulated."""
    every = [*case.recordings, *case.judged]
    referred = sum(recording.q_ref is not None for recording in every)
    said = "no controller: there is no replay gap"
    remedy = "give controller: if you know it; the torque gap does not need it"
    if case.controller is not None:
        said = f"{case.controller.kind} at {case.controller.rate:g} Hz"
        if referred:
            said += f"; reference in {referred} of {len(every)} recordings"
            remedy = ""
        else:
            said += ", but no recording has its reference"
            remedy = "record q_ref1.., or name the columns in import: {q_ref: ...}"
    yield remark("controller", "", said, remedy)


def check_ranges(case: Case, body: RigidBody) -> Iterator[Remark]:
    """Positions within the limits of the model; what leaves them was noted as the recording was read."""
    lower, upper = body.position_limits()
    q = np.vstack([recording.q for recording in (*case.recordings, *case.judged)])
    outside = (q.min(axis=0) < lower - 0.1) | (q.max(axis=0) > upper + 0.1)
    if outside.any():
        remedy = "check unit, zero and order of the joints in import:"
        said, where = "beyond the limits of the model", joints_of(outside)
        yield remark("positions", where, said, remedy)
    else:
        yield remark("positions", "", "within the limits of the model")


# Samples at the torque's limit.


def _limits(case: Case, body: RigidBody) -> Iterator[Remark]:
    """Samples at the torque limit of the data sheet, or beyond that of the robot file."""
    torque = [r.tau for r in case.recordings if r.tau is not None]
    if not torque:
        return
    size = np.abs(np.vstack(torque))
    stated = case.arm.torque_limit
    limit = body.effort_limits() if stated is None else 0.99 * stated
    # a file that is silent says 0
    share = ((size > limit) & (limit > 0)).mean(axis=0)
    over = share > AT_LIMIT
    if not over.any():
        return
    if stated is None:
        said = f"beyond the torque limit of the robot file in up to {share.max():.0%} of the samples"
        remedy = "check robot: and the unit of the torque; limits in robot files are often placeholders"
    else:
        said = f"at the torque limit in up to {share.max():.0%} of the samples"
        remedy = (
            "what is clipped says little of the arm: record a slower motion; if the drive allows more, correct "
            "nominal: {torque_limit: ...}"
        )
    yield Remark("warn", "torque", joints_of(over), said, remedy)


# All checks of a case.


def check_case(path: Path, progress: Progress = silent) -> dict[str, Any]:
    """Check a case; nothing is raised for a case that cannot be read, it is an error among the remarks.

    Args:
        path: folder of the case, or its case file.
        progress: called with a few words at each step.

    Returns:
        The content of ``check.json``; what is not known is null.
    """
    progress("reads the case")
    # what the reading of the model warns of is a remark here
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", ModelWarning)
        case, remarks = _read(path)
    remarks += [
        Remark("warn", "model", "", str(warning.message))
        for warning in caught
        if issubclass(warning.category, ModelWarning)
    ]
    motions: Motions = {}
    excited: float | None = None
    expected: list[dict[str, Any]] = []
    if case is not None:
        remarks += check_recordings(case)
        remarks += _other_arms(case)
        try:
            before = case.warnings
            case, references, told = with_torque(case)
            of_law = told.sentences() if told else []
            for said in (*of_law, *(w for w in case.warnings if w not in before)):
                remarks.append(Remark("warn", "controller", "", said))
            progress("looks at the motion and the torque")
            look = look_at_set_up(case, references)
            motions, excited = _of_signals(case, look, remarks)
            progress("asks what the recordings could show")
            # faults of references come first, and are put right already
            rest = look.faults[len(references) :]
            expected = _could_show(case, rest, remarks)
        except GapscopeError as error:
            remarks.append(_as_remark(error, "torque"))
    slides = case.arm.sliding if case else ()
    # of an arm that only slides every text is about slides
    if slides and all(slides):
        remarks = [
            replace(one, said=in_text(one.said), remedy=in_text(one.remedy))
            for one in remarks
        ]
    groups = () if case is None else ((False, case.recordings), (True, case.judged))
    recordings = [
        {
            "name": recording.name,
            "duration": recording.duration,
            "rate": recording.rate,
            "samples": len(recording.t),
            "channels": list(recording.channels),
            "held_out": held_out,
        }
        for held_out, group in groups
        for recording in group
    ]
    # how each joint moves; only the names if that is not known
    joints = [
        {"name": joint, **{name: values[j] for name, values in motions.items()}}
        for j, joint in enumerate(case.arm.joints if case else ())
    ]
    content = {
        "schema": 1,
        "case": None if case is None else case.name,
        "can_be_diagnosed": all(remark.level != "error" for remark in remarks),
        "remarks": [asdict(remark) for remark in remarks],
        "recordings": recordings,
        "joints": joints,
        "excited": excited,
        "expected": with_slide_units({"sizes": expected}, slides)["sizes"],
    }
    result: dict[str, Any] = plain(content, null_if_not_finite=True)
    return result


def _could_show(
    case: Case, faults: tuple[FoundFault, ...], remarks: list[Remark]
) -> list[dict[str, Any]]:
    """Sizes at which effects would be named, what is misread put right, and a remark on what no size shows."""
    # as a diagnosis would read it
    case = repaired(case, faults)
    try:
        with threadpool_limits(1):
            entries = could_show(case.arm, select_windows(case).recordings)
    except GapscopeError as error:
        remarks.append(_as_remark(error, "excitation"))
        return []
    never: dict[str, list[int]] = {}
    for entry in entries:
        if entry["half"] is None:
            never.setdefault(effect_name(entry["effect"]), []).extend(entry["joints"])
    if never:
        what = "; ".join(
            f"{name} of {numbers(joints)}" if joints else name
            for name, joints in never.items()
        )
        remarks.append(
            Remark("ok", "excitation", "", f"would not be named at any size: {what}")
        )
    return entries


def _other_arms(case: Case) -> Iterator[Remark]:
    """Positions of another arm in the first log, as ``inspect`` sees them."""
    assert case.file is not None
    logs = [path for path in case_files(case.file) if path.suffix.lower() in READERS]
    importing = case.importing or Import()
    channel = importing.channels.get("q")
    if not logs or channel is None:
        return
    taken = channel.names(importing.joints or case.arm.joints)
    # logs of one case have the same columns: the first one tells
    try:
        tables = inspect_logs([open_log(logs[0])], case.arm).tables
    except InputError:
        # nothing tells which columns are positions
        return
    for table in tables:
        said = table.of_another_arm(taken, case.arm.n_joints)
        if said:
            yield Remark(
                "warn",
                "channels",
                logs[0].name,
                f"{said}; read: {span_of(taken)}",
                "for the other arm list its columns in import: {q: ..., tau: ...}",
            )


def _of_signals(
    case: Case, look: SetUp, remarks: list[Remark]
) -> tuple[Motions, float]:
    """Add remarks on motion, torque and nominal arm of a case with torque.

    Returns:
        How the joints move, and the share of the base parameters of the bodies that the motion excites [1].
    """
    columns = ModelColumns(case.arm)
    segments = list(_segments(case, position_cutoff(case.recordings)))
    arm, body = columns.arm, columns.body
    q, dq = (
        np.concatenate([getattr(s.motion, name)[s.inner] for s in segments])
        for name in ("q", "dq")
    )
    sliding = np.abs(dq) / arm.per_radian > SLIDING
    speeds = [dq[sliding[:, j], j] for j in range(arm.n_joints)]
    slow, fast = (
        np.array([np.quantile(np.abs(v), at) if len(v) else 0.0 for v in speeds])
        for at in (0.1, 0.9)
    )
    states = random_states(Regressor(arm, body, ()), np.random.default_rng(SEED), 200)
    silent, count = _silent(columns, segments)
    excited = 1 - len(silent) / count
    motions = {
        "range": np.ptp(q, axis=0),
        "slow": slow,
        "fast": fast,
        "reversals": _reversals(segments, arm.per_radian),
        "gravity": _gravity(body, q),
        "possible_gravity": _gravity(body, states.q),
    }
    remarks += check_ranges(case, body)
    remarks += look.remarks()
    remarks += _limits(case, body)
    remarks += check_motion(motions, resting(case.recordings, arm.per_radian), speeds)
    said = f"the torque determines {excited:.0%} of the base parameters of the bodies"
    if silent:
        rest = len(silent) - MAX_NAMED
        more = f" and {rest} more" if rest > 0 else ""
        said += f", not {', '.join(silent[:MAX_NAMED])}{more}"
    remedy = ""
    if excited < FEW_EXCITED:
        said += ": errors of these stay hidden"
        remedy = "record an exciting trajectory (gapscope excite)"
    remarks.append(remark("excitation", "", said, remedy))
    remarks += check_nominal(case, body)
    remarks += check_controller(case)
    return motions, excited


def _read(path: Path) -> tuple[Case | None, list[Remark]]:
    """The case, as far as a diagnosis reads it, and why it is refused otherwise."""
    try:
        return load_case(path), [
            Remark("ok", "case", "", "case file, robot and recordings can be read")
        ]
    # refused at first: then as a diagnosis reads it, to tell which it is
    except InputError as error:
        strict = error
    try:
        case = load_case(path, any_unit=True)
    except InputError as error:
        return None, [_as_remark(error, "case")]
    remark = _as_remark(strict, "case")
    said = f"{remark.said}; the diagnosis tests for this fault, all other commands refuse the case"
    return case, [replace(remark, level="warn", said=said)]


def _as_remark(error: GapscopeError, topic: str) -> Remark:
    return Remark("error", topic, "", error.message, error.remedy)


def _segments(case: Case, cutoff: float) -> Iterator[Segment]:
    """The first seconds of each recording that is fitted, thinned.

    Raises:
        InputError: a recording has no stretch without gaps that is long enough.
    """
    for recording in case.recordings:
        first = recording.part(recording.t <= recording.t[0] + SECONDS)
        for segment in condition(first):
            yield thinned(segment, max(RATE, 3 * cutoff))
