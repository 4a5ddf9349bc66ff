"""What a residual network learnt: its curves and its document."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from gapscope.arm.io.json_file import plain
from gapscope.ident.residual.fit import LearntResidual, Trajectory
from gapscope.model.conditioning import TORQUE_CUTOFF, low_pass

# What a network learnt, as curves: mean residual and mean output over position, velocity and load of a joint.


BINS = 30
"""Bins of a curve, each with as many samples."""
FEWEST = 8
"""Samples that a bin holds at least."""
SLOW = 0.02
"""A joint moves forward or backward when it is faster than this [rad/s]."""


@dataclass(frozen=True)
class LearntCurve:
    """Means over bins of one signal of a joint, K bins, in N m on recordings set aside.

    Attributes:
        over: ``position`` [rad], ``velocity`` [rad/s] or ``load`` [N m].
        direction: ``forward``, ``backward`` or ``both``.
        x: mean of the signal in each bin, (K,).
        residual: mean of what the corrected arm leaves, (K,).
        network: mean of what the network says, (K,).
    """

    over: str
    direction: str
    x: np.ndarray
    residual: np.ndarray
    network: np.ndarray


def learnt_curves(found: LearntResidual, joint: int) -> list[LearntCurve]:
    """Curves of a joint, from 0: over position and load by direction, over velocity as a whole."""
    parts = []
    for x in found.judged:
        said = found.residual.torque(x.motion, x.load)
        network = low_pass(said, x.motion.rate, TORQUE_CUTOFF)
        series = (x.motion.q, x.motion.dq, x.load, x.residual, network)
        parts.append(np.array([values[x.rows, joint] for values in series]))
    position, velocity, load, residual, network = np.concatenate(parts, axis=1)
    every = np.ones(len(velocity), dtype=bool)
    forward, backward = velocity > SLOW, velocity < -SLOW
    curves = []
    for over, signal, direction, rows in (
        ("position", position, "forward", forward),
        ("position", position, "backward", backward),
        ("velocity", velocity, "both", every),
        ("load", load, "forward", forward),
        ("load", load, "backward", backward),
    ):
        # with few samples fewer bins
        count = min(BINS, int(rows.sum()) // FEWEST)
        if count:
            own = np.stack([signal, residual, network])[:, rows]
            bins = np.array_split(own[:, np.argsort(own[0])], count, axis=1)
            means = np.array([part.mean(axis=1) for part in bins]).T
            curves.append(LearntCurve(over, direction, *means))
    return curves


# A learnt residual network as plain data, and its schema.


SCHEMA = 1


def document(found: LearntResidual, files: Mapping[str, str]) -> dict[str, Any]:
    """What was learnt, as plain data in the form of ``residual.schema.json``.

    Args:
        found: what was learnt.
        files: names of the files beside it, by purpose.
    """
    report, settings = found.report, found.settings
    joints = [_joint(found, joint) for joint in range(found.case.arm.n_joints)]
    physics = {
        "kept_apart_from": report.apart,
        "closed_by_apart": report.closed_apart,
        "share_of_residual": report.in_target,
        "share_of_output_before": report.in_output[0],
        "share_of_output": report.in_output[1],
        "largest_move_before": float(report.moves[0].max(initial=0.0)),
        "largest_move": float(report.moves[1].max(initial=0.0)),
    }
    content = {
        "schema": SCHEMA,
        "case": found.case.name,
        "fitted": _recordings(found.fitted),
        "judged": _recordings(found.judged),
        "settings": {"form": settings.form, "seed": settings.seed},
        "joints": joints,
        "physics": physics,
        "files": dict(files),
    }
    return dict(plain(content))


def _joint(found: LearntResidual, joint: int) -> dict[str, Any]:
    report = found.report
    return {
        "name": found.case.arm.joints[joint],
        "form": report.form[joint] or None,
        "gain": report.gain[joint],
        "closed_in_validation": {
            form: closed[joint] for form, closed in report.by_form.items()
        },
        "rmse": {
            "nothing": found.nothing[joint],
            "network": found.network[joint],
            "trees": found.trees[joint],
        },
        "bound": found.residual.bound[joint],
        "curves": [vars(curve) for curve in learnt_curves(found, joint)],
    }


def _recordings(trajectories: Sequence[Trajectory]) -> list[dict[str, Any]]:
    """Names and lengths; a recording with gaps occurs once per piece."""
    return [
        {"recording": x.name, "seconds": x.motion.t[-1] - x.motion.t[0]}
        for x in trajectories
    ]
