"""What an engine does: it moves rigid bodies under joint torque. Everything else about an arm is the drive's."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np


class Engine(ABC):
    """Rigid bodies of an arm with n joints in kinematic order, fixed base, no friction, no rotors.

    A step is semi-implicit: dq[k+1] = dq[k] + dt ddq(q[k], dq[k], torque[k]), q[k+1] = q[k] + dt dq[k+1]. The central
    difference of q at step k is therefore the acceleration that the torque of step k causes: position and torque of one
    step belong together, without the half step by which a held torque acts late.

    Attributes:
        q: joint positions [rad or m] at the last ``read`` or ``reset``, shape (n,).
        dq: joint velocities [rad/s or m/s], shape (n,).
    """

    q: np.ndarray
    dq: np.ndarray

    @abstractmethod
    def reset(self, q: np.ndarray, dq: np.ndarray) -> None:
        """Put the arm at positions q with velocities dq, each of shape (n,)."""

    @abstractmethod
    def step(self, torque: np.ndarray, count: int = 1) -> None:
        """Hold joint torque [N m or N], shape (n,), for ``count`` time steps; ``q`` and ``dq`` stay as they are."""

    @abstractmethod
    def read(self) -> None:
        """Bring ``q`` and ``dq`` up to date, in place."""

    @abstractmethod
    def close(self) -> None:
        """Free the world; a second call does nothing."""


class RotorEngine(Engine):
    """An engine that supports rotors, and can undo a step.

    Attributes:
        position, velocity: the engine's own state [rad], [rad/s], always up to date, shape (n,).
    """

    position: np.ndarray
    velocity: np.ndarray

    @abstractmethod
    def set_rotors(self, rotors: np.ndarray) -> None:
        """Use this inertia [kg m^2], shape (n,), on the diagonal of the mass matrix."""

    @abstractmethod
    def advance(self, torque: np.ndarray) -> np.ndarray:
        """One step under joint torque [N m]; the acceleration [rad/s^2] of it, valid until the next call."""

    @abstractmethod
    def undo(self) -> None:
        """Take the last ``advance`` back; not twice."""
