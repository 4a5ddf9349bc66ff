"""The state of a watch as one NPZ file, so that a later run goes on where this one ended."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from hashlib import blake2b
from pathlib import Path
from typing import Any

import numpy as np

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.io.atomic_write import atomic_write
from gapscope.arm.known_load import KnownLoad
from gapscope.arm.motions.motion import Motion
from gapscope.arm.recording import Recording
from gapscope.effects.corrected import CorrectedArm
from gapscope.model.conditioning import Segment
from gapscope.model.terms import Term, Terms
from gapscope.watching.detector import Block, Detector, State

STATE = "watch_state.npz"
"""Name of the file in the folder of the results."""
SCHEMA = 2
"""Version of its form."""


@dataclass(frozen=True)
class Resumed:
    """What a state file holds beside the detector and the stream.

    Attributes:
        position: of the source.
        count: events that were written.
    """

    position: dict[str, Any]
    count: int


def fingerprint(corrected: CorrectedArm, learning: float) -> str:
    """A short text that changes with the arm, its effects and the settings that a state depends on."""
    arm = corrected.arm
    body = RigidBody(arm)
    effects = [
        (e.name, e.joints, {k: np.asarray(v).tolist() for k, v in e.parameters.items()})
        for e in corrected.effects
    ]
    sheet = [arm.gravity, arm.armature, arm.coulomb, arm.viscous, arm.presliding]
    parts = [body.inertial_parameters(), *sheet]
    digest = blake2b(digest_size=16)
    for part in parts:
        digest.update(np.ascontiguousarray(part).data)
    digest.update(repr((arm.joints, effects, learning)).encode())
    return digest.hexdigest()


def save_state(
    file: Path,
    detector: Detector,
    resumed: Resumed,
    arm: str,
) -> None:
    """Write a state whole or not at all.

    Raises:
        GapscopeError: the file cannot be written.
    """
    stream, state = detector.stream, detector.state
    content: dict[str, Any] = {
        "arm": arm,
        "schema": SCHEMA,
        "count": resumed.count,
        "position": resumed.position,
        "cutoff": stream.cutoff,
        "slipped": np.asarray(stream.slipped).tolist(),
    }
    arrays: dict[str, Any] = {}
    if stream.held is not None:
        held = stream.held
        content["held"] = held.name
        arrays |= {"held_t": held.t, "held_q": held.q}
        arrays["held_tau"] = np.asarray(held.tau)
    _pack(state, content, arrays)
    with atomic_write(file) as aside:
        np.savez(aside, **{"content": np.array(json.dumps(content)), **arrays})


def load_state(file: Path, detector: Detector, arm: str) -> Resumed | None:
    """Put a detector into the state of a file; ``None`` if it is of another arm or other settings.

    Raises:
        InputError: the file is no state of a watch.
    """
    try:
        with np.load(file, allow_pickle=False) as stored:
            arrays = dict(stored)
        content = json.loads(str(arrays.pop("content")))
        if content["schema"] != SCHEMA or content["arm"] != arm:
            return None
        stream = detector.stream
        stream.cutoff, stream.slipped = content["cutoff"], np.array(content["slipped"])
        if "held" in content:
            held = (arrays[f"held_{name}"] for name in ("t", "q", "tau"))
            t, q, tau = held
            stream.held = Recording(content["held"], t, q, tau=tau)
        arm_of = detector.corrected.arm
        terms = Terms(arm_of.n_joints, {}, arm_of.coupled_motors)
        by_name = {(term.effect, term.joint): term for term in terms.all}
        detector.state = _unpacked(content, arrays, by_name)
        if detector.state.band:
            detector.prepare()
        return Resumed(content["position"], int(content["count"]))
    except (KeyError, ValueError, OSError, EOFError, zipfile.BadZipFile) as error:
        raise InputError(
            f"is no state of a watch ({error})",
            "delete it: the watch then learns anew",
            file=file,
        ) from None


SERIES = ("t", "q", "dq", "ddq")
"""Of a motion."""


def _pack(state: State, content: dict[str, Any], arrays: dict[str, np.ndarray]) -> None:
    """Samples as arrays, and what is left as data for JSON."""
    segments = [block.segment for block in state.blocks]
    content["blocks"] = [
        {
            "recording": segment.recording,
            "offset": block.offset,
            "count": len(segment.motion.t),
            "mounted": None if segment.payload is None else asdict(segment.payload),
            "step": None
            if segment.torque_step is None
            else segment.torque_step.tolist(),
            "unknown": segment.unknown is not None,
        }
        for block, segment in zip(state.blocks, segments, strict=True)
    ]
    content["seen"] = len(state.seen)
    if segments:
        for name in SERIES:
            arrays[name] = np.concatenate([getattr(s.motion, name) for s in segments])
        arrays["torque"] = np.concatenate([np.asarray(s.torque) for s in segments])
        arrays["unknown"] = np.concatenate([~s.measured for s in segments])
    content |= {key: getattr(state, key) for key in ("band", "looked", "pace")}
    content |= {"drift": state.drift.tolist(), "said": state.said.tolist()}
    content["unknown"] = list(state.unknown.items())
    content["known"] = [
        (term.effect, term.joint, since, value.tolist())
        for (term, since), value in state.known.items()
    ]
    content["free"] = [
        (term.effect, term.joint, value.tolist()) for term, value in state.free.items()
    ]


def _unpacked(
    content: dict[str, Any],
    arrays: dict[str, np.ndarray],
    terms: Mapping[tuple[str, int], Term],
) -> State:
    """The opposite of ``_pack``."""
    blocks, first = [], 0
    for entry in content["blocks"]:
        own = slice(first, first + entry["count"])
        first = own.stop
        motion = Motion(*(arrays[name][own] for name in SERIES))
        payload, step = entry["mounted"], entry["step"]
        segment = Segment(
            recording=entry["recording"],
            motion=motion,
            torque=arrays["torque"][own],
            payload=None if payload is None else KnownLoad(**payload),
            unknown=arrays["unknown"][own] if entry["unknown"] else None,
            torque_step=None if step is None else np.array(step),
        )
        blocks.append(Block(segment, entry["offset"]))
    return State(
        drift=np.array(content["drift"], dtype=int),
        said=np.array(content["said"]),
        seen=blocks[: content["seen"]],
        now=blocks[content["seen"] :],
        band=content["band"],
        known={
            (terms[effect, joint], since): np.array(value)
            for effect, joint, since, value in content["known"]
        },
        free={
            terms[effect, joint]: np.array(value)
            for effect, joint, value in content["free"]
        },
        looked=content["looked"],
        pace=content["pace"],
        unknown=dict(content["unknown"]),
    )
