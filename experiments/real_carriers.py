"""Recordings of real arms as carriers of known effects: read, put right, cut, identified; see ``26_real_benchmark.py``.

A carrier is a healthy arm whose recordings are as nature made them. What its case states wrongly is put right here, so
that the unchanged recording is a healthy case; references (``q_ref``) are left out, since injected effects would change
them in a way that nobody knows. In the folders of pieces coupled motors stay declared, with recordings on the motors'
side. The motion of a recording comes from filters of its own, not from the conditioning of the diagnosis.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple
from zlib import crc32

import numpy as np
import yaml
from common import CASES, DATA
from scipy.signal import butter, sosfiltfilt

import gapscope
from gapscope.arm.case import Case, load_case
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import GapscopeError
from gapscope.arm.io.atomic_write import atomic_write
from gapscope.arm.io.json_file import read_json
from gapscope.arm.io.write_case import nominal_section, write_case
from gapscope.arm.nominal import smooth_sign
from gapscope.arm.recording import Recording
from gapscope.arm.robots import load_nominal_arm
from gapscope.blind_check.generator.recorded import at_samples, smooth_motion
from gapscope.effects.corrected import CorrectedArm
from gapscope.ident.identification import IdentificationSettings
from gapscope.ident.identification_json import effects, identified_bodies, with_sheet
from gapscope.ident.model.physical_parameters import urdf_text
from gapscope.model.conditioning import (
    TORQUE_CUTOFF,
    condition,
    low_pass,
    position_cutoff,
    torque_scale,
)
from gapscope.model.torque_gap import torque_gap


def write_piece(case: Case, folder: Path) -> None:
    """Write a case; if motors turn several joints, as seen from the motors and with the transmission declared."""
    matrix = case.importing.transmission if case.importing else None
    if matrix is None:
        write_case(case, folder, overwrite=True)
        return
    recordings = tuple(on_motor_side(r, matrix) for r in case.recordings)
    file = write_case(replace(case, recordings=recordings), folder, overwrite=True)
    content = yaml.safe_load(file.read_text(encoding="utf-8"))
    content["import"] = {"transmission": {"matrix": matrix.tolist()}}
    with atomic_write(file) as aside:
        text = yaml.safe_dump(content, sort_keys=False, default_flow_style=None)
        aside.write_text(text, encoding="utf-8")


def on_motor_side(recording: Recording, matrix: np.ndarray) -> Recording:
    """q_motor = R q_joint and tau_motor = R^-T tau_joint, with R (n, n) of the case format."""
    dq = None if recording.dq is None else recording.dq @ matrix.T
    torque = recording.tau @ np.linalg.inv(matrix)
    return replace(recording, q=recording.q @ matrix.T, dq=dq, tau=torque)


# The arm that is identified, and what its model leaves

SMALLEST_DIRECTION = 3e-3
"""Singular values below this share of the largest are directions that a motion does not show [1]."""
BLOCKS = 10
"""Blocks of time, every other one of which belongs to the same half, for what a full model leaves."""


def identified(case: Case, other: Case, folder: Path) -> None:
    """Identify the arm of a case, and write another case of the same arm with it as the nominal one.

    What a data sheet cannot state, constant offsets and Stribeck friction, is taken off the torque of the other case,
    so that it is healthy as far as the identified arm is right.

    Args:
        case: recordings to identify from.
        other: recordings that the new case gets.
        folder: of the new case.
    """
    # judged by its last recording, but fitted to all
    case = replace(case, judged=case.recordings[-1:])
    result = gapscope.identify(case, IdentificationSettings(plain=True)).identification
    urdf = folder.parent / f".{folder.name}.urdf"
    with atomic_write(urdf) as aside:
        aside.write_text(
            urdf_text(result.case.arm, identified_bodies(result)), encoding="utf-8"
        )
    stated = nominal_section(with_sheet(result))
    # the other case declares the same coupled motors
    stated.pop("coupling", None)
    given = {k: np.array(v) for k, v in stated.items() if isinstance(v, list)}
    arm = replace(other.arm, urdf=urdf, **given)
    plain, full = CorrectedArm(arm), CorrectedArm(arm, effects(result))
    body = RigidBody(arm)
    recordings = []
    for recording in other.recordings:
        motion = smooth_motion(recording)
        extra = full.predict(body, motion) - plain.predict(body, motion)
        torque = recording.tau - at_samples(extra, motion, recording.t)
        recordings.append(replace(recording, tau=torque))
    healthy = replace(other, arm=arm, recordings=tuple(recordings))
    write_piece(healthy, folder)
    urdf.unlink()


def model_residual(case: Case) -> np.ndarray:
    """RMS that a full least-squares model leaves on the half that it was not fitted to [N m], (n,).

    All inertial parameters, rotor, viscous and Coulomb friction and offset of each joint, as a change from the nominal
    bodies; joints weighted by their torque's deviation; the longest recording in two halves of alternate blocks of
    time, each half judged once.
    """
    longest = max(case.recordings, key=lambda r: r.duration)
    segments = condition(longest, position_cutoff((longest,)))
    body = RigidBody(case.arm)
    matrices, targets = [], []
    for segment in segments:
        m, inner = segment.motion, segment.inner
        own = [m.ddq, m.dq, smooth_sign(m.dq), np.ones_like(m.q)]
        joints = [x[:, :, None] * np.eye(case.arm.n_joints) for x in own]
        links = body.regressor(m.q, m.dq, m.ddq)
        matrix = np.concatenate([links, *joints], axis=2)
        gap = segment.torque - links @ body.inertial_parameters()
        matrices.append(low_pass(matrix, m.rate, TORQUE_CUTOFF)[inner])
        targets.append(low_pass(gap, m.rate, TORQUE_CUTOFF)[inner])
    matrix, target = np.concatenate(matrices), np.concatenate(targets)
    scale = torque_scale(target)
    odd = np.arange(len(target)) * BLOCKS // len(target) % 2 == 1
    squares = np.zeros(case.arm.n_joints)
    for fit, judge in ((odd, ~odd), (~odd, odd)):
        value = _least_squares(matrix[fit], target[fit], scale)
        squares += ((target[judge] - matrix[judge] @ value) ** 2).sum(axis=0)
    return np.sqrt(squares / len(target))


def left(case: Case) -> np.ndarray:
    """RMS of the torque gap of a case's nominal arm on its first recording [N m], (n,)."""
    segments = condition(case.recordings[0], position_cutoff(case.recordings))
    return torque_gap(CorrectedArm(case.arm), RigidBody(case.arm), segments).rmse


def _least_squares(
    matrix: np.ndarray, target: np.ndarray, scale: np.ndarray
) -> np.ndarray:
    """Weighted least squares of minimum norm in columns of equal length: matrix (N, n, p), target (N, n)."""
    weighted = (matrix / scale[:, None]).reshape(-1, matrix.shape[2])
    norms = np.linalg.norm(weighted, axis=0)
    norms[norms < 1e-9 * norms.max()] = np.inf
    value = np.linalg.lstsq(
        weighted / norms, (target / scale).ravel(), rcond=SMALLEST_DIRECTION
    )[0]
    return value / norms


# Carriers and their cuts

ARMS = {
    "tx40": "staubli_tx40",
    "ur10": "ur10",
    "kinova": "kinova_gen3_current",
    "panda": "panda",
    "kuka": "kuka_med7",
    "z1": "unitree_z1",
    "emps": "emps",
}
"""Carriers by their short names, each with its file in ``experiments/cases``."""
FASTEST = 1000.0
"""Recordings sampled faster are decimated towards this rate [Hz]; a diagnosis needs no more than 250 Hz."""
PIECES = (0.45, 0.3, 0.5)
"""Share of the recording that carries the effect: in the first two cuts, and the range in all others [1]."""
SHORTEST_PIECE = 1.55
"""A piece of a recording is no shorter than this [s]; the diagnosis needs 1.5 s."""
HEALTHY = 2.5
"""The arm identified on the reference leaves at most so many times what a model of the whole motion does [1]."""
CANDIDATES = 5
"""Cuts that are tried for a healthy one; if none is, the best is taken."""
MOVED, REST = 0.02, 1.0
"""An arm rests that moved by less than this [rad]; so much of its rests before and after the motion is kept [s]."""
UNIDENTIFIED = 1e6
"""RMS that stands for a reference from which nothing can be identified [N m]."""
WINDOW_FILE = "window.json"
"""Says which piece was cut out."""
CUT_FILES = ("reference", "identified")
"""Folders of a cut: the reference as a case, and the other piece with the identified arm as its nominal one."""


def load_carrier(arm: str, folder: Path) -> Case:
    """The carrier of a short name, its whole recordings; a copy of its case file is written into a folder."""
    source = CASES / f"{ARMS[arm]}.yaml"
    content = yaml.safe_load(source.read_text(encoding="utf-8"))
    # the whole recording, not only the rows that the case sets aside for fitting and judging
    content.get("import", {}).pop("rows", None)
    if not content["robot"].startswith("$"):
        content["robot"] = str(CASES / content["robot"])
    file = folder / "whole.yaml"
    with atomic_write(file) as aside:
        aside.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
    case = load_case(file)
    recordings = tuple(_prepared(r) for r in case.recordings)
    case = replace(case, name=arm, recordings=recordings, judged=(), controller=None)
    if arm != "kuka":
        return case
    # its torques count the other way than its URDF, whose friction is a placeholder
    none = np.zeros(case.arm.n_joints)
    turned = tuple(replace(r, tau=-r.tau) for r in recordings)
    sheet = replace(case.arm, coulomb=none, viscous=none)
    return replace(case, arm=sheet, recordings=turned)


def _prepared(recording: Recording) -> Recording:
    """A recording without references and long rests at its ends, at no more than ``FASTEST``."""
    recording = replace(recording, q_ref=None, dq_ref=None, notes=())
    first, last = (recording.q[[k]] for k in (0, -1))
    moved = np.abs(recording.q - first).max(axis=1) > MOVED
    to_move = np.abs(recording.q - last).max(axis=1) > MOVED
    begin = recording.t[moved.argmax()] - REST
    end = recording.t[len(to_move) - 1 - to_move[::-1].argmax()] + REST
    moving = (recording.t >= begin) & (recording.t <= end)
    recording = rows(recording, moving, recording.name)
    every = int(recording.rate / FASTEST + 0.5)
    if every < 2:
        return recording
    sos = butter(4, 0.4 / every * 2, output="sos")

    def fewer(series: np.ndarray | None) -> np.ndarray | None:
        return None if series is None else sosfiltfilt(sos, series, axis=0)[::every]

    names = ("q", "dq", "tau", "tau_sensor", "temperature")
    changed = {name: fewer(getattr(recording, name)) for name in names}
    return replace(recording, t=recording.t[::every], **changed)


LEGS = ("FL", "FR", "RL", "RR")


def go2_leg(leg: str, folder: Path) -> Case:
    """A leg of the Go2 in the air, hip, thigh and calf, without torque; its model is written into a folder."""
    tree = ET.parse(DATA / "unitree_go2" / "go2.xml")
    # postures of the free robot, which a reader that fixes its base refuses
    for postures in tree.getroot().findall("keyframe"):
        tree.getroot().remove(postures)
    file = folder / "go2.xml"
    folder.mkdir(parents=True, exist_ok=True)
    tree.write(file)
    joints = [f"{leg}_{joint}_joint" for joint in ("hip", "thigh", "calf")]
    first, recordings = 3 * LEGS.index(leg), []
    for k in range(6):
        with np.load(DATA / "unitree_go2" / f"traj_{k}.npz") as rows:
            names = ("q", "dq", "q_ref", "dq_ref")
            log = {name: rows[name][:, first : first + 3] for name in names}
            t = rows["t"] - rows["t"][0]
        recordings.append(Recording(f"repeat{k}", t, **log))
    arm = load_nominal_arm(file, joints=joints)
    return Case(f"go2_{leg}", Path(), arm, tuple(recordings))


Window = tuple[float, float]
"""Begin and end of a piece, as shares of the recording [1]."""


def windows(case: Case, number: int, seed: int) -> list[Window]:
    """Candidates for a cut of the longest recording: the pieces that may carry the effect.

    Cuts take by turns a piece at the end, at the beginning, and in the middle, so that no two are the same.
    """
    rng = np.random.default_rng([seed, crc32(case.name.encode()), number])
    least = SHORTEST_PIECE / max(r.duration for r in case.recordings)
    out = []
    while len(out) < CANDIDATES:
        drawn = float(rng.uniform(*PIECES[1:]))
        regular = number < 2 and not out
        share = max(PIECES[0] if regular else drawn, least)
        middle = float(rng.uniform(least, max(1.0 - share - least, least)))
        places = ((1.0 - share, 1.0), (0.0, share), (middle, middle + share))
        out.append(places[number % 3])
    return out


def cut(case: Case, window: Window) -> tuple[Case, Case]:
    """Two cases of a carrier: the reference, all but one piece of the longest recording; and that piece."""
    longest = max(case.recordings, key=lambda r: r.duration)
    others = tuple(r for r in case.recordings if r is not longest)
    share = (longest.t - longest.t[0]) / longest.duration
    before, after = share < window[0], share > window[1]
    rest = [
        rows(longest, chosen, name)
        for chosen, name in ((before, "before"), (after, "after"))
        if chosen.any()
    ]
    piece = rows(longest, ~before & ~after, "piece")
    reference = replace(case, recordings=(*rest, *others))
    return reference, replace(case, recordings=(piece,))


def rows(recording: Recording, chosen: np.ndarray, name: str) -> Recording:
    """Some rows of a recording, its time from zero, under another name."""
    part = recording.part(chosen, name=name)
    return replace(part, t=part.t - part.t[0])


class Prepared(NamedTuple):
    """What was prepared of one carrier and one cut of it.

    Attributes:
        carrier: the whole carrier.
        whole: the whole carrier with the arm identified on all of it as the nominal one.
        reference, case: the two pieces with the published arm.
        identified: the second piece with the arm identified on the first, or, if that is far off, on the whole carrier.
        reference_leaves: RMS that the arm identified on the first leaves on the second [N m], (n,).
    """

    carrier: Case
    whole: Case
    reference: Case
    case: Case
    identified: Case
    reference_leaves: np.ndarray


def prepare_arm(arm: str, out: Path) -> None:
    """Identify a carrier on all of its recordings, unless that was done."""
    folder = out / "carriers" / arm
    if not (folder / "whole" / "case.yaml").is_file():
        carrier = load_carrier(arm, folder)
        identified(carrier, carrier, folder / "whole")


def prepare_cut(arm: str, number: int, seed: int, out: Path) -> dict[str, Any]:
    """Write reference and identified arm of one cut, the first healthy candidate; what its ``WINDOW_FILE`` holds."""
    folder = cut_folder(arm, number, out)
    carrier = load_carrier(arm, out / "carriers" / arm)
    least = model_residual(carrier)
    tried = []
    for window in windows(carrier, number, seed):
        rest = _write_cut(carrier, number, window, folder)
        tried.append((float((rest / least).max()), window, rest))
        if tried[-1][0] <= HEALTHY:
            break
    ratio, window, rest = min(tried, key=lambda one: one[0])
    if window != tried[-1][1]:
        _write_cut(carrier, number, window, folder)
    if ratio > HEALTHY:
        # the reference is too poor for a healthy arm: that of all recordings is the nominal one
        identified(carrier, cut(carrier, window)[1], folder / CUT_FILES[1])
    return {"window": window, "ratio": ratio, "reference_leaves": rest}


def _write_cut(carrier: Case, number: int, window: Window, folder: Path) -> np.ndarray:
    """Write the cases of a cut; RMS that the arm identified on the reference leaves on the piece [N m], (n,)."""
    reference, piece = cut(carrier, window)
    named = replace(reference, name=f"{carrier.name}_reference_{number}")
    write_piece(named, folder / CUT_FILES[0])
    try:
        identified(reference, piece, folder / CUT_FILES[1])
    except GapscopeError:
        # nothing can be identified from this reference
        return np.full(carrier.arm.n_joints, UNIDENTIFIED)
    return left(load_case(folder / CUT_FILES[1]))


def cut_folder(arm: str, number: int, out: Path) -> Path:
    """Folder of one cut."""
    return out / "carriers" / arm / f"cut_{number}"


def load_prepared(arm: str, number: int, out: Path) -> Prepared:
    """What ``prepare_arm`` and ``prepare_cut`` wrote."""
    carrier = load_carrier(arm, out / "carriers" / arm)
    chosen = read_json(cut_folder(arm, number, out) / WINDOW_FILE, "--step make")
    reference, case = cut(carrier, tuple(chosen["window"]))
    return Prepared(
        carrier,
        load_case(out / "carriers" / arm / "whole"),
        reference,
        case,
        load_case(cut_folder(arm, number, out) / CUT_FILES[1]),
        np.array(chosen["reference_leaves"]),
    )


def cut_residual(prepared: Prepared, against: bool) -> np.ndarray:
    """RMS that full models leave on the piece that carries the effect [N m], (n,).

    The larger one, joint by joint, of a model of the whole motion, and of the arm that the case is compared with.
    """
    rest = prepared.reference_leaves if against else left(prepared.identified)
    return np.maximum(model_residual(prepared.carrier), rest)
