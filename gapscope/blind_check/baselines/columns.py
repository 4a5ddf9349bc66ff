"""What each effect adds to the torque, by finite differences of the corrected arm's prediction."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gapscope.arm.case import load_case
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected import CorrectedArm
from gapscope.model.conditioning import (
    TORQUE_CUTOFF,
    Segment,
    condition,
    low_pass,
    position_cutoff,
)

STEPS = {
    "coulomb_friction": {"torque": 1e-3},
    "viscous_friction": {"coefficient": 1e-3},
    "load_friction": {"coefficient": 1e-4},
    "armature": {"inertia": 1e-3},
    "torque_scale": {"scale": 1e-4},
    "torque_offset": {"torque": 1e-3},
    "parallel_spring": {"stiffness": 1e-3, "rest": 0.0},
    "actuator_delay": {"delay": 1e-4},
    "actuator_lag": {"time_constant": 1e-4},
}
"""Effects that act on the torque of their own joint: small values; the springs' rest is fitted by the offset."""
EFFECTS = (*STEPS, "encoder_offset", "payload", "base_tilt", "link_inertia")
"""Effects that have columns."""
THIN = 5
"""Rows of the conditioned signals per row that is fitted."""


@dataclass(frozen=True)
class DesignColumn:
    """One column: its effect, its joint (from 1; 0 for the arm)."""

    effect: str
    joint: int


@dataclass(frozen=True)
class Design:
    """A case as linear regression; every torque over the joint's scale, M rows, n joints.

    Attributes:
        gap: recorded minus nominal torque, flattened, (M n,).
        terms: the effects that the columns represent.
        columns: (M n, K), each of unit length.
        nrmse: torque gap per joint, (n,).
        n_joints: n.
    """

    gap: np.ndarray
    terms: tuple[DesignColumn, ...]
    columns: np.ndarray
    nrmse: np.ndarray
    n_joints: int

    def places(self, effect: str) -> list[int]:
        """Columns of an effect."""
        return [k for k, term in enumerate(self.terms) if term.effect == effect]


def design(folder: Path) -> Design:
    """The regression of the case in a folder."""
    case = load_case(folder)
    arm = case.arm
    cutoff = position_cutoff(case.recordings)
    segments: list[Segment] = []
    for recording in case.recordings:
        if recording.tau is not None:
            segments += condition(recording, cutoff)
    torque = _stacked([(s, s.torque) for s in segments if s.torque is not None])
    body = RigidBody(arm)

    def predicted(*effects: AppliedEffect) -> np.ndarray:
        corrected = CorrectedArm(arm, effects)
        return _stacked(
            [(s, corrected.predict(s.bodies(body), s.motion)) for s in segments]
        )

    nominal = predicted()
    deviation = torque.std(axis=0)
    scale = np.maximum(deviation, 0.05 * deviation.max())
    terms, columns = [], []
    for term, column in _columns(arm.n_joints, predicted, nominal):
        scaled = (column / scale).ravel()
        length = np.linalg.norm(scaled)
        # an effect that moves no torque on these motions has no column
        if np.isfinite(length) and length > 1e-9:
            terms.append(term)
            columns.append(scaled / length)
    gap = (torque - nominal) / scale
    return Design(
        gap=gap.ravel(),
        terms=tuple(terms),
        columns=np.stack(columns, axis=1),
        nrmse=np.sqrt((gap**2).mean(axis=0)),
        n_joints=arm.n_joints,
    )


def _stacked(series: list[tuple[Segment, np.ndarray]]) -> np.ndarray:
    """Torque over segments, filtered, trimmed and thinned [N m], (M, n)."""
    rows = []
    for segment, torque in series:
        filtered = low_pass(torque, segment.motion.rate, TORQUE_CUTOFF)
        rows.append(filtered[segment.inner][::THIN])
    return np.vstack(rows)


Predict = Callable[..., np.ndarray]
"""Torque of the arm with some effects [N m], (M, n)."""
Columns = list[tuple[DesignColumn, np.ndarray]]
"""The effect that a column represents, and the change of the torque [N m], (M, n)."""


def _columns(n: int, predicted: Predict, nominal: np.ndarray) -> Columns:
    """All columns of an arm with n joints, before scaling."""
    return [
        *_joint_columns(n, predicted, nominal),
        *_offset_columns(n, predicted, nominal),
        *_payload_columns(predicted, nominal),
        *_tilt_columns(predicted, nominal),
        *_link_columns(n, predicted, nominal),
    ]


def _joint_columns(n: int, predicted: Predict, nominal: np.ndarray) -> Columns:
    """Effects on the torque of their own joint: one prediction gives the columns of all joints."""
    joints = tuple(range(1, n + 1))
    out: Columns = []
    for effect, step in STEPS.items():
        values = {name: np.full(n, value) for name, value in step.items()}
        change = predicted(AppliedEffect(effect, joints, values)) - nominal
        for j in joints:
            own = np.where(np.arange(n) == j - 1, change, 0.0)
            out.append((DesignColumn(effect, j), own))
    return out


def _offset_columns(n: int, predicted: Predict, nominal: np.ndarray) -> Columns:
    """Offsets of the encoders, which change the torque of all joints."""
    out: Columns = []
    for j in range(1, n + 1):
        offset = AppliedEffect("encoder_offset", (j,), {"offset": np.array([1e-4])})
        change = predicted(offset) - nominal
        out.append((DesignColumn("encoder_offset", j), change))
    return out


def _payload_columns(predicted: Predict, nominal: np.ndarray) -> Columns:
    """A mass at the origin of the last link, and its shifts along three axes."""
    term = DesignColumn("payload", 0)
    weight = predicted(_payload(np.zeros(3))) - nominal
    out: Columns = [(term, weight)]
    for shift in 0.1 * np.eye(3):
        out.append((term, predicted(_payload(shift)) - nominal - weight))
    return out


def _tilt_columns(predicted: Predict, nominal: np.ndarray) -> Columns:
    """Roll and pitch of the base."""
    out: Columns = []
    for name in ("roll", "pitch"):
        tilt = {"roll": np.array(0.0), "pitch": np.array(0.0), name: np.array(1e-4)}
        change = predicted(AppliedEffect("base_tilt", (), tilt)) - nominal
        out.append((DesignColumn("base_tilt", 0), change))
    return out


def _link_columns(n: int, predicted: Predict, nominal: np.ndarray) -> Columns:
    """Mass of each link but the last, whose mass is the payload's."""
    out: Columns = []
    for j in range(1, n):
        link = {
            "link": np.array(float(j)),
            "mass": np.array(1e-3),
            "com": np.zeros(3),
        }
        change = predicted(AppliedEffect("link_inertia", (), link)) - nominal
        out.append((DesignColumn("link_inertia", j), change))
    return out


def _payload(com: np.ndarray) -> AppliedEffect:
    return AppliedEffect("payload", (), {"mass": np.array(1e-2), "com": com})
