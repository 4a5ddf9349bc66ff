"""The curves that a report draws: torque over time, the shape of the gap, its spectrum."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.signal import welch

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.diagnosis.document.wording import worst_joint
from gapscope.diagnosis.gap.torque_gap import TorqueGap, torque_gap
from gapscope.diagnosis.localisation.locate import locate
from gapscope.diagnosis.localisation.stacked_rows import Rows, stack
from gapscope.diagnosis.result import Located, Signature, Spectrum, Trace
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.effect import Quantity, Transmission
from gapscope.ident.signals.conditioning import TORQUE_CUTOFF, Segment

POINTS = 1500
"""Most points of a curve."""


def located(
    document: Mapping[str, Any],
    gaps: Mapping[str, TorqueGap],
    floor: np.ndarray,
    segments: list[Segment],
) -> tuple[Located, ...]:
    """Where the gap of the worst joint lies.

    Args:
        document: of the diagnosis.
        gaps: ``before`` and ``after`` the effects found; after is shown where it stays above the floor.
        floor: RMS that a healthy arm leaves [N m], (n,).
        segments: the rows of the gaps.
    """
    stages = ["before"] if document["effects"] else []
    stages += ["after"] if document["unexplained"]["above_floor"] else []
    rows, load, out = stack(segments), gaps["before"].predicted, []
    for stage in stages:
        worst = worst_joint(document, stage)
        places = (
            []
            if worst is None
            else locate(gaps[stage].error, rows, load, floor, [worst])
        )
        out += [Located(stage, place) for place in places]
    return tuple(out)


def traces(
    corrected: CorrectedArm, body: RigidBody, segments: list[Segment]
) -> tuple[Trace, ...]:
    """Measured, nominal and corrected torque of each segment."""
    nominal = CorrectedArm(corrected.arm)
    out = []
    for segment in segments:
        before, after = (
            torque_gap(arm, body, [segment]) for arm in (nominal, corrected)
        )
        step = max(1, len(before.measured) // POINTS)
        t = segment.motion.t[segment.inner]
        out.append(
            Trace(
                segment.recording,
                t[::step],
                before.measured[::step],
                before.predicted[::step],
                after.predicted[::step],
            )
        )
    return tuple(out)


def spectrum(before: TorqueGap, after: TorqueGap, rates: tuple[float, ...]) -> Spectrum:
    """Amplitude spectrum of the gap up to 12 Hz, mean power over the segments, sampled at ``rates`` [Hz]."""
    frequency = np.arange(0.0, TORQUE_CUTOFF + 0.01, 0.25)
    powers = [np.zeros((len(frequency), before.error.shape[1])) for _ in range(2)]
    for power, error in zip(powers, (before.error, after.error), strict=True):
        for a, b, rate in zip(before.edges, before.edges[1:], rates, strict=False):
            grid, density = welch(
                error[a:b], rate, nperseg=min(b - a, int(4 * rate)), axis=0
            )
            share = (b - a) / before.edges[-1]
            power += share * np.column_stack(
                [np.interp(frequency, grid, column) for column in density.T]
            )
    return Spectrum(frequency, np.sqrt(powers[0]), np.sqrt(powers[1]))


def signatures(
    corrected: CorrectedArm, body: RigidBody, segments: list[Segment]
) -> tuple[Signature, ...]:
    """For each effect, on up to seven joints, the gap without it against the quantity that drives it."""
    full = torque_gap(corrected, body, segments)
    rows = stack(segments)
    step = max(1, len(rows.t) // POINTS)
    out = []
    for applied in corrected.effects:
        rest = CorrectedArm(
            corrected.arm, tuple(e for e in corrected.effects if e is not applied)
        )
        without = torque_gap(rest, body, segments)
        explained = full.predicted - without.predicted
        for joint in _joints(applied, explained, without):
            quantity = applied.effect.plotted_against
            axis, unit, x = _axis(quantity, rows, without, explained, joint - 1)
            gap, part = without.error[::step, joint - 1], explained[::step, joint - 1]
            out.append(Signature(applied.name, joint, axis, unit, x[::step], gap, part))
    return tuple(out)


def _joints(applied: AppliedEffect, explained: np.ndarray, gap: TorqueGap) -> list[int]:
    """Joints to show: those of the effect, or the three on which an effect of many joints weighs most."""
    # a joint that bends shows it most on itself, an encoder's offset where gravity pulls most
    effect = applied.effect
    own = effect.reach == "joint" or isinstance(effect, Transmission)
    if applied.joints and own:
        return list(applied.joints[:7])
    weight = np.sqrt((explained**2).mean(axis=0)) / np.maximum(
        gap.measured.std(axis=0), 1e-9
    )
    return sorted(int(j) + 1 for j in np.argsort(-weight)[:3])


def _axis(
    quantity: Quantity, rows: Rows, gap: TorqueGap, explained: np.ndarray, j: int
) -> tuple[str, str, np.ndarray]:
    """Name, unit and values of the quantity over which an effect on joint j (from 0) is drawn."""
    recorded, velocity = gap.measured[:, j], rows.dq[:, j]
    directed_load = np.abs(recorded) * np.sign(velocity)
    torque_rate = np.gradient(gap.predicted[:, j], np.median(np.diff(rows.t)))
    axes: dict[Quantity, tuple[str, str, np.ndarray]] = {
        "own torque": ("torque that the effect predicts", "N m", explained[:, j]),
        "position": ("position", "rad", rows.q[:, j]),
        "velocity": ("velocity", "rad/s", velocity),
        "acceleration": ("acceleration", "rad/s²", rows.ddq[:, j]),
        "time": ("time", "s", rows.t),
        "recorded torque": ("recorded torque", "N m", recorded),
        "directed load": (
            "load torque in the direction of motion",
            "N m",
            directed_load,
        ),
        "torque rate": ("rate of the torque", "N m/s", torque_rate),
    }
    return axes[quantity]
