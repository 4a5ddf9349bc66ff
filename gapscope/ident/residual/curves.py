"""What a network learnt, as curves: mean residual and mean output over position, velocity and load of a joint."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gapscope.ident.residual.learnt import LearntResidual
from gapscope.model.conditioning import TORQUE_CUTOFF, low_pass

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
    signals = _signals(found, joint)
    forward, backward = signals["velocity"] > SLOW, signals["velocity"] < -SLOW
    every = np.ones(len(forward), dtype=bool)
    wanted = [
        ("position", "forward", forward),
        ("position", "backward", backward),
        ("velocity", "both", every),
        ("load", "forward", forward),
        ("load", "backward", backward),
    ]
    curves = [_curve(over, name, signals, rows) for over, name, rows in wanted]
    return [curve for curve in curves if len(curve.x)]


def _signals(found: LearntResidual, joint: int) -> dict[str, np.ndarray]:
    """Signals of a joint at the rows of the recordings set aside, each (M,)."""
    parts: dict[str, list[np.ndarray]] = {}
    for x in found.judged:
        said = found.residual.torque(x.motion, x.load)
        network = low_pass(said, x.motion.rate, TORQUE_CUTOFF)
        series = {
            "position": x.motion.q,
            "velocity": x.motion.dq,
            "load": x.load,
            "residual": x.residual,
            "network": network,
        }
        for name, values in series.items():
            parts.setdefault(name, []).append(values[x.rows, joint])
    return {name: np.concatenate(values) for name, values in parts.items()}


def _curve(
    over: str, direction: str, signals: dict[str, np.ndarray], rows: np.ndarray
) -> LearntCurve:
    """One curve; with few samples of fewer bins."""
    x = signals[over][rows]
    order = np.argsort(x)
    count = min(BINS, len(x) // FEWEST)
    bins = np.array_split(order, count) if count else []

    def means(values: np.ndarray) -> np.ndarray:
        return np.array([values[one].mean() for one in bins])

    residual, network = signals["residual"][rows], signals["network"][rows]
    return LearntCurve(over, direction, means(x), means(residual), means(network))
