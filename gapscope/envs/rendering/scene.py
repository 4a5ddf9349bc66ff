"""What a picture shows: the course of an episode so far."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np


@dataclass
class Scene:
    """One episode, n joints; grows with every action.

    Attributes:
        title: robot and effects.
        period: time between actions [s].
        q_ref: reference at every action [rad], shape (K + 1, n).
        q: true positions so far [rad], each (n,).
        error: reference minus encoders so far [rad], each (n,).
        load: commanded over rated torque at last [1], shape (n,).
        ending: why the episode ended early, or nothing.
    """

    title: str
    period: float
    q_ref: np.ndarray
    q: list[np.ndarray] = field(default_factory=list)
    error: list[np.ndarray] = field(default_factory=list)
    load: np.ndarray = field(default_factory=lambda: np.zeros(0))
    ending: str = ""

    @property
    def now(self) -> int:
        """Number of actions done."""
        return len(self.q) - 1
