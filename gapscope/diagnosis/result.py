"""What a diagnosis returns: the findings as a document, and the curves that a report draws."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gapscope.arm.nominal import NominalArm
from gapscope.diagnosis.assessment.replay_gap import ReplayedMotion
from gapscope.diagnosis.locate import JointLocalisation
from gapscope.diagnosis.setup_faults.found_fault import FoundFault
from gapscope.effects.applied import AppliedEffect, State


@dataclass(frozen=True)
class Trace:
    """Torque of one recording over time, on the rows of the gap; n joints.

    Attributes:
        recording: name of the recording.
        t: time [s], shape (M,).
        q: recorded position [rad or m], (M, n).
        measured: recorded torque [N m], (M, n).
        nominal: torque that the nominal arm predicts [N m], (M, n).
        corrected: torque that the arm predicts with the effects found [N m], (M, n).
    """

    recording: str
    t: np.ndarray
    q: np.ndarray
    measured: np.ndarray
    nominal: np.ndarray
    corrected: np.ndarray


@dataclass(frozen=True)
class Signature:
    """The gap's shape that gave an effect away, on one joint.

    Attributes:
        effect: name of the effect.
        joint: joint, from 1.
        axis: name of the quantity on the x axis, e.g. ``velocity``.
        unit: its unit.
        x: that quantity, shape (M,).
        gap: torque gap with all other effects found taken out [N m], (M,).
        explained: what the effect explains of it [N m], (M,).
    """

    effect: str
    joint: int
    axis: str
    unit: str
    x: np.ndarray
    gap: np.ndarray
    explained: np.ndarray


@dataclass(frozen=True)
class Spectrum:
    """Amplitude spectrum of the gap per joint: frequency [Hz] (F,), before and after [N m/sqrt(Hz)] (F, n)."""

    frequency: np.ndarray
    before: np.ndarray
    after: np.ndarray


@dataclass(frozen=True)
class Located:
    """Where the gap of the worst joint lies: ``stage`` is ``before`` or ``after`` the effects found."""

    stage: str
    place: JointLocalisation


@dataclass(frozen=True)
class Diagnosis:
    """All findings on one case.

    Attributes:
        document: content of ``diagnosis.json``; follows ``gapscope/schemas/diagnosis.schema.json``.
        effects: the effects named, with values, ordered by share.
        traces: measured, nominal and corrected torque, one per recording.
        signatures: the shapes that gave the effects away.
        spectrum: where in frequency the gap lies.
        located: where the gap of the worst joint lies, before and, if it stays above the floor, after.
        possible: the effects that are possible and not confirmed, with values beside all others, ordered by share.
        presliding: distance over which the dry friction of each joint builds up after a reversal [rad], (n,).
        faults: faults of the set-up, in the order in which they must be put right.
        arm: the nominal arm, as its set-up was put right; ``None`` if it is not known any more.
        replayed: the motion that was replayed, or ``None``.
        states: all effects in each recording, or span of one; none if all share a state.
        case_file: of the case; ``None`` if it was made in memory, or is not known any more.
    """

    document: Mapping[str, Any]
    effects: tuple[AppliedEffect, ...]
    traces: tuple[Trace, ...]
    signatures: tuple[Signature, ...]
    spectrum: Spectrum
    located: tuple[Located, ...] = ()
    possible: tuple[AppliedEffect, ...] = ()
    presliding: tuple[float, ...] = ()
    faults: tuple[FoundFault, ...] = ()
    arm: NominalArm | None = None
    replayed: ReplayedMotion | None = None
    states: tuple[State, ...] = ()
    case_file: Path | None = None
