"""Families of trajectories, each q(t) = q0 + B(t) C: a basis over time, and coefficients C from free numbers."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, Protocol

import numpy as np
from scipy.interpolate import BSpline

from gapscope.arm.motions.trajectory import Fourier, ReferenceMotion
from gapscope.arm.motions.way_points import WayPoints, clamped_quintic
from gapscope.arm.nearest_name import check_known


class Basis(NamedTuple):
    """B(t) and its first two derivatives, each of shape (N, m); 1, 1/s, 1/s^2."""

    position: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray


class Family(Protocol):
    """A family of trajectories of n joints, at rest at both ends."""

    @property
    def n_joints(self) -> int:
        """Number n of joints."""

    @property
    def duration(self) -> float:
        """Length [s]."""

    @property
    def size(self) -> int:
        """Count of free numbers that the coefficients are made of."""

    @property
    def highest_frequency(self) -> float:
        """Highest frequency in the motion [Hz]."""

    def basis(self, t: np.ndarray) -> Basis:
        """B at times t [s] of shape (N,)."""

    def coefficients(self, free: np.ndarray) -> np.ndarray:
        """C before scaling to the limits, shape (m, n), of free numbers of shape (size,)."""

    def pullback(self, free: np.ndarray, gradient: np.ndarray) -> np.ndarray:
        """Gradient by the free numbers, shape (size,), from that by C, shape (m, n)."""

    def reference(
        self, centre: np.ndarray, coefficients: np.ndarray
    ) -> ReferenceMotion:
        """The trajectory about q0 [rad], shape (n,), with C [rad], shape (m, n)."""


@dataclass(frozen=True)
class FourierFamily:
    """``gapscope.arm.motions.trajectory.Fourier`` with free a_k and b_k, weighed by 1/k [swevers2007].

    Attributes:
        n_joints: n.
        duration: [s].
        order: number of harmonics.
        frequency: of the first harmonic [Hz].
        ramp: length of the window's flanks [s].
    """

    n_joints: int
    duration: float
    order: int
    frequency: float
    ramp: float = 1.0

    @property
    def size(self) -> int:
        """Count of free numbers, 2 order n."""
        return 2 * self.order * self.n_joints

    @property
    def highest_frequency(self) -> float:
        """That of the last harmonic, or of the window if its flanks are steeper [Hz]."""
        return max(self.order * self.frequency, 0.5 / self.ramp)

    def basis(self, t: np.ndarray) -> Basis:
        """Windowed sines, then windowed cosines; m = 2 order."""
        sine, cosine = (np.eye(self.order, 2 * self.order, k) for k in (0, self.order))
        series = Fourier(
            centre=np.zeros(2 * self.order),
            sine=sine,
            cosine=cosine,
            frequency=self.frequency,
            duration=self.duration,
            ramp=self.ramp,
        )
        return Basis(series.position(t), series.velocity(t), series.acceleration(t))

    def coefficients(self, free: np.ndarray) -> np.ndarray:
        """The free numbers over k."""
        return free.reshape(2 * self.order, self.n_joints) / self._harmonics

    def pullback(self, free: np.ndarray, gradient: np.ndarray) -> np.ndarray:
        """The gradient over k."""
        return (gradient / self._harmonics).ravel()

    def reference(self, centre: np.ndarray, coefficients: np.ndarray) -> Fourier:
        """A Fourier series."""
        sine, cosine = coefficients[: self.order], coefficients[self.order :]
        return Fourier(
            centre=centre,
            sine=sine,
            cosine=cosine,
            frequency=self.frequency,
            duration=self.duration,
            ramp=self.ramp,
        )

    @property
    def _harmonics(self) -> np.ndarray:
        return np.tile(np.arange(1.0, self.order + 1), 2)[:, None]


@dataclass(frozen=True)
class MultisineFamily(FourierFamily):
    """Random phase multisine: the Fourier series with amplitudes 1/k, the same velocity at all harmonics, free phases.

    [pintelon2012].
    """

    @property
    def size(self) -> int:
        """Count of phases, order n."""
        return self.order * self.n_joints

    def coefficients(self, free: np.ndarray) -> np.ndarray:
        """Sine and cosine shares of 1/k at a phase of pi times the free number."""
        phase = np.pi * free.reshape(self.order, self.n_joints)
        return np.concatenate([np.cos(phase), np.sin(phase)]) / self._harmonics

    def pullback(self, free: np.ndarray, gradient: np.ndarray) -> np.ndarray:
        """Chain rule over sine and cosine."""
        phase = np.pi * free.reshape(self.order, self.n_joints)
        sine, cosine = np.split(gradient / self._harmonics, 2)
        return np.pi * (-np.sin(phase) * sine + np.cos(phase) * cosine).ravel()


@dataclass(frozen=True)
class QuinticFamily:
    """``gapscope.arm.motions.way_points.WayPoints`` with free way points at equal times; it starts and ends at q0.

    Attributes:
        n_joints: n.
        duration: [s].
        points: number of way points between start and end.
    """

    n_joints: int
    duration: float
    points: int

    @property
    def size(self) -> int:
        """Count of free numbers, points n."""
        return self.points * self.n_joints

    @property
    def highest_frequency(self) -> float:
        """Frequency of a motion that turns at every way point [Hz]."""
        return (self.points + 1) / (2 * self.duration)

    def basis(self, t: np.ndarray) -> Basis:
        """Splines that are 1 at one way point and 0 at the others; m = points."""
        t = np.clip(t, 0.0, self.duration)
        return Basis(*(self._splines(t, derivative) for derivative in (0, 1, 2)))

    def coefficients(self, free: np.ndarray) -> np.ndarray:
        """The free numbers."""
        return free.reshape(self.points, self.n_joints)

    def pullback(self, free: np.ndarray, gradient: np.ndarray) -> np.ndarray:
        """The gradient itself."""
        return gradient.ravel()

    def reference(self, centre: np.ndarray, coefficients: np.ndarray) -> WayPoints:
        """A spline."""
        rest = np.zeros((1, self.n_joints))
        return WayPoints(
            self._times, centre + np.concatenate([rest, coefficients, rest])
        )

    @cached_property
    def _splines(self) -> BSpline:
        return clamped_quintic(self._times, np.eye(self.points + 2)[:, 1:-1])

    @property
    def _times(self) -> np.ndarray:
        return np.linspace(0.0, self.duration, self.points + 2)


KINDS = ("fourier", "quintic", "multisine")
"""Names of the families."""


def family(
    kind: str,
    n_joints: int,
    duration: float,
    order: int,
    frequency: float,
    ramp: float = 1.0,
) -> Family:
    """A family by its name; a quintic has 2 order way points, as many free numbers as the Fourier series.

    Raises:
        InputError: unknown name.
    """
    check_known("kind of trajectory", kind, KINDS, where="kind")
    if kind == "quintic":
        return QuinticFamily(n_joints, duration, 2 * order)
    made = FourierFamily if kind == "fourier" else MultisineFamily
    return made(n_joints, duration, order, frequency, ramp)
