"""The state of a watch as one NPZ file, so that a later run goes on where this one ended."""

from __future__ import annotations

import json
import zipfile
from dataclasses import dataclass, fields
from hashlib import blake2b
from pathlib import Path
from typing import Any

import numpy as np

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.io.atomic_write import atomic_write
from gapscope.arm.recording import Recording
from gapscope.effects.corrected import CorrectedArm
from gapscope.ident.kalman.online.block import Block
from gapscope.ident.kalman.online.estimate import ParameterState
from gapscope.watching.detection.detector import Detector
from gapscope.watching.detection.learning import Moment, Normal
from gapscope.watching.detection.monitor import Monitor, MonitorState
from gapscope.watching.detection.noise_rise import NoiseRise
from gapscope.watching.detection.scales import Scales
from gapscope.watching.detection.slow_drift import SlowDrift
from gapscope.watching.detection.usual import UsualSize
from gapscope.watching.segments import SegmentStream

STATE = "watch_state.npz"
"""Name of the file in the folder of the results."""
SCHEMA = 1
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
    stream: SegmentStream,
    resumed: Resumed,
    arm: str,
) -> None:
    """Write a state whole or not at all.

    While normal behaviour is still being learnt, the position is that of the start: the next run learns anew.

    Raises:
        GapscopeError: the file cannot be written.
    """
    content: dict[str, Any] = {"arm": arm, "schema": SCHEMA, "count": resumed.count}
    arrays: dict[str, Any] = {}
    if detector.monitor is not None:
        content["position"] = resumed.position
        content["cutoff"] = stream.cutoff
        content["last"] = None if detector.last is None else vars(detector.last)
        if stream.held is not None:
            held = stream.held
            content["held"] = held.name
            arrays |= {"held_t": held.t, "held_q": held.q}
            arrays["held_tau"] = np.asarray(held.tau)
        _pack(detector.monitor.state, content, arrays)
    with atomic_write(file) as aside:
        np.savez(aside, **{"content": np.array(json.dumps(content)), **arrays})


def load_state(
    file: Path, detector: Detector, stream: SegmentStream, arm: str
) -> Resumed | None:
    """Put detector and stream into the state of a file; ``None`` if it is of another arm or other settings.

    Raises:
        InputError: the file is no state of a watch.
    """
    try:
        with np.load(file, allow_pickle=False) as stored:
            arrays = dict(stored)
        content = json.loads(str(arrays.pop("content")))
        if content["schema"] != SCHEMA or content["arm"] != arm:
            return None
        if "position" not in content:
            return Resumed({}, int(content["count"]))
        stream.cutoff = content["cutoff"]
        if "held" in content:
            stream.held = Recording(
                content["held"],
                arrays["held_t"],
                arrays["held_q"],
                tau=arrays["held_tau"],
            )
        if content["last"] is not None:
            detector.last = Moment(**content["last"])
        state = _unpacked(content, arrays)
        detector.monitor = Monitor(detector.arm, state, detector.false_alarms)
        return Resumed(content["position"], int(content["count"]))
    except (KeyError, ValueError, OSError, EOFError, zipfile.BadZipFile) as error:
        raise InputError(
            f"is no state of a watch ({error})",
            "delete it: the watch then learns anew",
            file=file,
        ) from None


def _pack(
    state: MonitorState, content: dict[str, Any], arrays: dict[str, np.ndarray]
) -> None:
    """Numbers of a monitor as arrays, and what is left as data for JSON."""
    normal = state.normal
    arrays |= {
        f"scale_{f.name}": getattr(normal.scales, f.name) for f in fields(Scales)
    }
    arrays |= {
        "noise": normal.noise,
        "inflation": normal.inflation,
        "fluctuation": normal.fluctuation,
        "base_value": state.base.value,
        "base_covariance": state.base.covariance,
        "rise_sums": state.rise.sums,
        "rise_blocks": state.rise.blocks,
        "rise_powers": state.rise.powers,
        "drift_places": state.drift.places,
        "drift_reference": state.drift.reference,
        "drift_noted": state.drift.noted,
    }
    if state.ring:
        arrays["ring_information"] = np.array([b.information for b in state.ring])
        arrays["ring_score"] = np.array([b.score for b in state.ring])
    content["ring"] = [(b.recording, b.start, b.end, b.duration) for b in state.ring]
    content["since"], content["beyond"] = state.since, state.beyond
    content["suspected"] = state.suspected
    content["usual"] = {key: list(size.values) for key, size in state.usual.items()}
    content["pending"] = [dict(entry) for entry in state.pending]


def _unpacked(content: dict[str, Any], arrays: dict[str, np.ndarray]) -> MonitorState:
    """The opposite of ``_pack``."""
    scales = Scales(**{f.name: arrays[f"scale_{f.name}"] for f in fields(Scales)})
    normal = Normal(scales, arrays["noise"], arrays["inflation"], arrays["fluctuation"])
    ring = []
    for k, (name, start, end, duration) in enumerate(content["ring"]):
        A, s = arrays["ring_information"][k], arrays["ring_score"][k]
        ring.append(Block(name, start, end, duration, A, s))
    state = MonitorState(
        normal=normal,
        base=ParameterState(arrays["base_value"], arrays["base_covariance"]),
        rise=NoiseRise(
            arrays["rise_sums"], arrays["rise_blocks"], arrays["rise_powers"]
        ),
        drift=SlowDrift(
            arrays["drift_places"], arrays["drift_reference"], arrays["drift_noted"]
        ),
        ring=ring,
        since=content["since"],
        beyond=content["beyond"],
        suspected=content["suspected"],
        usual={key: UsualSize(values) for key, values in content["usual"].items()},
    )
    state.pending.extend(content["pending"])
    return state
