"""What each effect adds to the torque, by finite differences of the corrected arm's prediction."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gapscope.arm.case import load_case
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.nominal import NominalArm
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected import CorrectedArm
from gapscope.ident.signals.conditioning import (
    TORQUE_CUTOFF,
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
        terms: what the columns stand for.
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
    arm, body = case.arm, RigidBody(case.arm)
    recordings = [
        recording for recording in case.recordings if recording.tau is not None
    ]
    segments = [
        s for r in recordings for s in condition(r, position_cutoff(case.recordings))
    ]

    def predicted(*effects: AppliedEffect) -> np.ndarray:
        corrected = CorrectedArm(arm, effects)
        series = (
            low_pass(
                corrected.predict(s.bodies(body), s.motion),
                s.motion.rate,
                TORQUE_CUTOFF,
            )[s.inner]
            for s in segments
        )
        return np.vstack([rows[::THIN] for rows in series])

    torques = (
        low_pass(s.torque, s.motion.rate, TORQUE_CUTOFF)[s.inner]
        for s in segments
        if s.torque is not None
    )
    torque = np.vstack([rows[::THIN] for rows in torques])
    nominal = predicted()
    deviation = torque.std(axis=0)
    scale = np.maximum(deviation, 0.05 * deviation.max())
    terms, columns = [], []
    for term, column in _columns(arm, predicted, nominal):
        scaled = (column / scale).ravel()
        length = np.linalg.norm(scaled)
        if np.isfinite(length) and length > 1e-9:
            terms.append(term)
            columns.append(scaled / length)
    gap = (torque - nominal) / scale
    return Design(
        gap.ravel(),
        tuple(terms),
        np.stack(columns, axis=1),
        np.sqrt((gap**2).mean(axis=0)),
        arm.n_joints,
    )


def _columns(
    arm: NominalArm, predicted: Any, nominal: np.ndarray
) -> list[tuple[DesignColumn, np.ndarray]]:
    n = arm.n_joints
    joints = tuple(range(1, n + 1))
    out: list[tuple[DesignColumn, np.ndarray]] = []
    for effect, step in STEPS.items():
        values = {name: np.full(n, value) for name, value in step.items()}
        change = predicted(AppliedEffect(effect, joints, values)) - nominal
        out += [
            (DesignColumn(effect, j), np.where(np.arange(n) == j - 1, change, 0.0))
            for j in joints
        ]
    for j in joints:
        offset = AppliedEffect("encoder_offset", (j,), {"offset": np.array([1e-4])})
        out.append((DesignColumn("encoder_offset", j), predicted(offset) - nominal))
    zero = np.zeros(3)
    weight = predicted(_payload(zero)) - nominal
    out.append((DesignColumn("payload", 0), weight))
    out += [
        (DesignColumn("payload", 0), predicted(_payload(axis)) - nominal - weight)
        for axis in 0.1 * np.eye(3)
    ]
    for name in ("roll", "pitch"):
        tilt = {"roll": np.array(0.0), "pitch": np.array(0.0), name: np.array(1e-4)}
        out.append(
            (
                DesignColumn("base_tilt", 0),
                predicted(AppliedEffect("base_tilt", (), tilt)) - nominal,
            )
        )
    for j in joints[:-1]:
        link = {"link": np.array(float(j)), "mass": np.array(1e-3), "com": zero}
        out.append(
            (
                DesignColumn("link_inertia", j),
                predicted(AppliedEffect("link_inertia", (), link)) - nominal,
            )
        )
    return out


def _payload(com: np.ndarray) -> AppliedEffect:
    return AppliedEffect("payload", (), {"mass": np.array(1e-2), "com": com})
