"""The controller that a case declares, as far as it is known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Controller:
    """PD control with feedforward: tau = ff(q_ref, dq_ref, ddq_ref) + kp (q_ref - q) + kd (dq_ref - dq).

    Attributes:
        rate: control frequency [Hz]; the torque is held until the next tick.
        kp, kd: gains [N m/rad], [N m s/rad], shape (n,).
        feedforward: ``none``, ``gravity`` or ``nominal``.
        velocity_cutoff: cut-off of the second-order velocity filter [Hz], or ``None`` for no filter.
        velocity_damping: its damping ratio [1].
    """

    rate: float
    kp: np.ndarray
    kd: np.ndarray
    feedforward: str = "none"
    velocity_cutoff: float | None = None
    velocity_damping: float = 0.9
