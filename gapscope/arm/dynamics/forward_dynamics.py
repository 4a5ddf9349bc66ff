"""Forward dynamics of one state at a time, for simulators: joints in kinematic order, nothing allocated twice."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
import pinocchio as pin

from gapscope.arm.dynamics.rigid_body import RigidBody


class ForwardDynamics:
    """Accelerations of an arm with rotors; all arrays (n,), in kinematic order (``RigidBody.order``).

    Args:
        body: the rigid bodies.
        rotors: inertia added to the diagonal of the mass matrix [kg m^2], shape (n,).

    Attributes:
        acceleration: of (q, dq, torque), (M + I)^-1 (torque - C dq - g) [rad/s^2]; valid until the next call.
    """

    acceleration: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]

    def __init__(self, body: RigidBody, rotors: np.ndarray) -> None:
        self._model = body.model.copy()
        self._data = self._model.createData()
        self.acceleration = partial(pin.aba, self._model, self._data)
        self.set_rotors(rotors)

    def set_rotors(self, rotors: np.ndarray) -> None:
        """Change the inertia on the diagonal [kg m^2]."""
        self._model.armature = rotors

    def set_link(self, link: int, parameters: np.ndarray) -> None:
        """Change a link's inertial parameters, shape (10,); ``link`` counts from 0 in kinematic order."""
        self._model.inertias[link + 1] = pin.Inertia.FromDynamicParameters(parameters)

    def mass_matrix(self, q: np.ndarray) -> np.ndarray:
        """M(q) + I [kg m^2], shape (n, n); valid until the next call."""
        return pin.crba(self._model, self._data, q)

    def bias(self, q: np.ndarray, dq: np.ndarray) -> np.ndarray:
        """C(q, dq) dq + g(q) [N m]; valid until the next call."""
        return pin.nonLinearEffects(self._model, self._data, q, dq)
