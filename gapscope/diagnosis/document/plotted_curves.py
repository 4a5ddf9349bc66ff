"""The curves that a report draws: torque over time, the shape of the gap, its spectrum."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np

from gapscope.arm.joint_units import joint_unit
from gapscope.diagnosis.document.wording import worst_joint
from gapscope.diagnosis.locate import FREQUENCIES, MotionRows, densities, locate
from gapscope.diagnosis.result import Located, Signature, Spectrum, Trace
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.effect import Effect, Transmission
from gapscope.model.conditioning import MIN_FLOOR
from gapscope.model.torque_gap import TorqueGap

MAX_POINTS = 1500
"""Most points of a curve."""


def located(
    document: Mapping[str, Any],
    gaps: Mapping[str, TorqueGap],
    floor: np.ndarray,
    rows: MotionRows,
) -> tuple[Located, ...]:
    """Where the gap of the worst joint lies.

    Args:
        document: of the diagnosis.
        gaps: ``before`` and ``after`` the effects found; after is shown if it stays above the floor.
        floor: RMS that a healthy arm leaves [N m], (n,).
        rows: motion of the rows of the gaps.
    """
    stages = []
    # without effects the gap before is that after
    if document["effects"]:
        stages.append("before")
    if document["unexplained"]["above_floor"]:
        stages.append("after")
    load = gaps["before"].predicted
    out = []
    for stage in stages:
        worst = worst_joint(document, stage)
        if worst is not None:
            gap, least = gaps[stage].error[:, worst - 1], float(floor[worst - 1])
            out.append(Located(stage, locate(gap, rows, load, least, worst)))
    return tuple(out)


def traces(gaps: Mapping[str, TorqueGap], rows: MotionRows) -> tuple[Trace, ...]:
    """Measured, nominal and corrected torque of each segment."""
    before, after = gaps["before"], gaps["after"]
    out = []
    for name, (start, end) in zip(rows.names, pairwise(rows.edges), strict=True):
        shown = slice(start, end, max(1, (end - start) // MAX_POINTS))
        out.append(
            Trace(
                recording=name,
                t=rows.clock[shown],
                q=rows.q[shown],
                measured=before.measured[shown],
                nominal=before.predicted[shown],
                corrected=after.predicted[shown],
            )
        )
    return tuple(out)


def spectrum(gaps: Mapping[str, TorqueGap], rows: MotionRows) -> Spectrum:
    """Amplitude spectrum of the gap in its band, mean power over the segments."""
    powers = (densities(gap.error, gap.error, rows).real for gap in gaps.values())
    return Spectrum(FREQUENCIES, *map(np.sqrt, powers))


def signatures(
    named: Iterable[tuple[AppliedEffect, np.ndarray]],
    after: TorqueGap,
    rows: MotionRows,
    sliding: Sequence[bool],
) -> tuple[Signature, ...]:
    """For each effect, on up to seven joints, the gap without it over the quantity that drives it.

    Args:
        named: effects, with what each does to the torque [N m], (M, n).
        after: the gap with all of them.
        rows: motion of its rows.
        sliding: which joints slide, (n,).
    """
    step = max(1, len(rows.t) // MAX_POINTS)
    out = []
    for applied, explained in named:
        # with all others in place: what overlaps is theirs
        without = replace(after, predicted=after.predicted - explained)
        for joint in _joints(applied, explained, without):
            j = joint - 1
            axis, unit, x = _axis(applied.effect, rows, without, explained, j)
            out.append(
                Signature(
                    effect=applied.name,
                    joint=joint,
                    axis=axis,
                    unit=joint_unit(unit, sliding[j]),
                    x=x[::step],
                    gap=without.error[::step, j],
                    explained=explained[::step, j],
                )
            )
    return tuple(out)


def _joints(applied: AppliedEffect, explained: np.ndarray, gap: TorqueGap) -> list[int]:
    """Joints to show: those of the effect, or the three on which an effect of many joints has most torque."""
    # A compliant joint shows it most on itself, an encoder offset on the joint with most gravity.
    effect = applied.effect
    on_itself = effect.reach == "joint" or isinstance(effect, Transmission)
    if applied.joints and on_itself:
        return list(applied.joints[:7])
    rms = np.sqrt((explained**2).mean(axis=0))
    # over what each torque varies by, or the strongest joints would always be shown
    relative = rms / np.maximum(gap.measured.std(axis=0), MIN_FLOOR)

    return sorted(int(j) + 1 for j in np.argsort(-relative)[:3])


def _axis(
    effect: Effect, rows: MotionRows, gap: TorqueGap, explained: np.ndarray, j: int
) -> tuple[str, str, np.ndarray]:
    """Name, unit and values of the quantity that drives an effect on joint j (from 0)."""
    match effect.plotted_against:
        case "position":
            return "position", "rad", rows.q[:, j]
        case "velocity":
            return "velocity", "rad/s", rows.dq[:, j]
        case "acceleration":
            return "acceleration", "rad/s²", rows.ddq[:, j]
        case "time":
            return "time", "s", rows.clock
        case "recorded torque":
            return "recorded torque", "N m", gap.measured[:, j]
        case "directed load":
            # friction that grows with the load has its size and the sign of the motion
            load = np.abs(gap.measured[:, j]) * np.sign(rows.dq[:, j])
            return "load torque in the direction of motion", "N m", load
        # time begins anew with each segment: the usual step is the period
        case "torque rate":
            period = np.median(np.diff(rows.t))
            rate = np.gradient(gap.predicted[:, j], period)
            return "rate of the torque", "N m/s", rate
        case "own torque":
            return "torque that the effect predicts", "N m", explained[:, j]
