"""A weld seam: the tool follows a straight line at constant speed and keeps its orientation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline

from gapscope.arm.dynamics.inverse_kinematics import inverse_kinematics
from gapscope.arm.dynamics.kinematics import Kinematics, Pose
from gapscope.arm.errors import GapscopeError, InputError
from gapscope.arm.motions.trajectory import Limits

RAMP = 0.2
"""Share of the duration in which the tool speeds up, and again slows down [1]."""
KNOTS = 41
"""Points of the line at which the inverse kinematics is solved."""
CHECKS = 401
"""Points at which the limits are checked."""
_RISE = np.polynomial.Polynomial([0, 0, 0, 10, -15, 6]).integ()
_RISE_RATE, _RISE_CURVE = _RISE.deriv(), _RISE.deriv(2)


@dataclass(frozen=True)
class WeldSeam:
    """Joint motion q(t) = path(s(t / T)) along a straight line of the tool, at rest at both ends.

    s'(x) rises as 10 x^3 - 15 x^4 + 6 x^5 within ``RAMP`` of the time, stays constant and falls back; path is a quintic
    spline through solutions of the inverse kinematics. Outside [0, T] the arm rests.

    Attributes:
        path: joint positions [rad] over the share s of the line, 0 to 1.
        duration: T [s].
        length: of the line [m].
    """

    path: BSpline
    duration: float
    length: float

    @classmethod
    def along(
        cls,
        kinematics: Kinematics,
        start: np.ndarray,
        way: np.ndarray,
        limits: Limits,
        speed: float = np.inf,
    ) -> WeldSeam:
        """The fastest seam within limits, from where the tool is at joint positions ``start`` [rad], shape (n,).

        Args:
            kinematics: of the arm; with fewer than six joints the orientation of the tool is left free.
            start: joint positions at the start [rad], shape (n,).
            way: from the start of the line to its end, base frame [m], shape (3,).
            limits: position, velocity and acceleration limits of the joints.
            speed: the tool is no faster than this [m/s].

        Raises:
            InputError: fewer than three joints, or a line without length.
            GapscopeError: the tool cannot follow the line within the position limits.
        """
        length = float(np.linalg.norm(way))
        if kinematics.n_joints < 3 or not length > 0:
            raise InputError(
                f"a straight line of {length:.3g} m with {kinematics.n_joints} joints",
                "a weld seam needs at least three joints, and a length",
                where="weld_seam",
            )
        path = _joint_path(kinematics, start, np.asarray(way, dtype=float))
        s = np.linspace(0.0, 1.0, CHECKS)
        q = path(s)
        outside = ((q < limits.lower - 1e-9) | (q > limits.upper + 1e-9)).any(axis=0)
        if outside.any():
            raise GapscopeError(
                f"joint {int(outside.argmax()) + 1} would leave its limits along the seam",
                "choose a shorter seam, or another posture to start from",
            )
        by_tool_speed = length / speed / (1 - RAMP)
        duration = max(_shortest(path, limits), by_tool_speed, 0.1)
        return cls(path, duration, length)

    def position(self, t: np.ndarray) -> np.ndarray:
        """Position [rad] at times t [s] of shape (N,); shape (N, n)."""
        return self.path(_progress(t / self.duration, 0))

    def velocity(self, t: np.ndarray) -> np.ndarray:
        """Velocity [rad/s] at times t [s] of shape (N,); shape (N, n)."""
        x = t / self.duration
        rate = _progress(x, 1) / self.duration
        return self.path(_progress(x, 0), 1) * rate[:, None]

    def acceleration(self, t: np.ndarray) -> np.ndarray:
        """Acceleration [rad/s^2] at times t [s] of shape (N,); shape (N, n)."""
        x = t / self.duration
        return _second_derivative(self.path, x) / self.duration**2


def _joint_path(kinematics: Kinematics, start: np.ndarray, way: np.ndarray) -> BSpline:
    """Spline through the joint positions along the line, over the share s of it."""
    at_start = kinematics.tool(start)
    shares = np.linspace(0.0, 1.0, KNOTS)
    knots = [np.asarray(start, dtype=float)]
    for share in shares[1:]:
        target = Pose(at_start.position + share * way, at_start.rotation)
        knots.append(
            inverse_kinematics(
                kinematics,
                target,
                knots[-1],
                turns=kinematics.n_joints >= 6,
                iterations=30,
            )
        )
    return make_interp_spline(shares, np.array(knots), k=5)


def _flank(x: np.ndarray) -> np.ndarray:
    """Place on the rising or falling flank of the speed at the share x of the time, 1 in between; shape (N,)."""
    to_end = np.minimum(x, 1 - x)
    return np.minimum(to_end / RAMP, 1.0)


def _progress(x: np.ndarray, derivative: int) -> np.ndarray:
    """Share s of the line at the share x of the time, or its first derivative; shape (N,)."""
    x = np.clip(np.asarray(x, dtype=float), 0.0, 1.0)
    flank = _flank(x)
    if derivative == 1:
        return _RISE_RATE(flank) / (1 - RAMP)
    at_constant_speed = np.maximum(np.minimum(x, 1 - x) - RAMP, 0.0)
    half = (RAMP * _RISE(flank) + at_constant_speed) / (1 - RAMP)
    return np.where(x <= 0.5, half, 1.0 - half)


def _second_derivative(path: BSpline, x: np.ndarray) -> np.ndarray:
    """d2 q / d x2 of path(s(x)) [rad], shape (N, n)."""
    x = np.asarray(x, dtype=float)
    inside = (x > 0) & (x < 1)
    curve = _RISE_CURVE(_flank(x)) * np.sign(0.5 - x) / (RAMP * (1 - RAMP))
    dds = np.where(inside, curve, 0.0)
    s, ds = _progress(x, 0), _progress(x, 1)
    return path(s, 2) * (ds**2)[:, None] + path(s, 1) * dds[:, None]


def _shortest(path: BSpline, limits: Limits) -> float:
    """Shortest duration [s] within the limits of velocity and acceleration; both only fall as it grows."""
    x = np.linspace(0.0, 1.0, CHECKS)
    velocity = path(_progress(x, 0), 1) * _progress(x, 1)[:, None]
    speed = np.abs(velocity).max(axis=0)
    acceleration = np.abs(_second_derivative(path, x)).max(axis=0)
    by_speed = speed / limits.velocity
    by_acceleration = np.sqrt(acceleration / limits.acceleration)
    # a little longer, for what happens between the points
    return 1.001 * float(np.maximum(by_speed, by_acceleration).max())
