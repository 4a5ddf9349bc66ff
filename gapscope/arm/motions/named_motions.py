"""Motions by name: between postures, through points of space, along a weld seam."""

from __future__ import annotations

from itertools import cycle
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from scipy.interpolate import BPoly, BSpline, make_interp_spline

from gapscope.arm.dynamics.kinematics import (
    LEAST_JOINTS,
    POSTURES,
    Kinematics,
    inverse_kinematics,
)
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import GapscopeError, InputError
from gapscope.arm.motions.trajectory import (
    SHORTEST,
    Curve,
    Fourier,
    Limits,
    ReferenceMotion,
    Timed,
    backwards,
    chain,
    fastest,
    point_to_point,
    shortest,
    urdf_limits,
)
from gapscope.arm.nearest_name import check_known

# The posture about which an arm moves when nobody names one.


SPREAD = 0.4
"""They lie within this share of the joints' ranges about the middle [1]."""


def working_posture(kinematics: Kinematics, limits: Limits) -> np.ndarray:
    """Joint positions [rad], shape (n,), with the tool in front of the base, pointing down, free to move.

    The best of fixed candidates about the middle of the limits; an arm of fewer than three joints works in the middle.
    """
    middle = (limits.lower + limits.upper) / 2
    span = limits.upper - limits.lower
    if kinematics.n_joints < LEAST_JOINTS:
        return middle
    size = (POSTURES, kinematics.n_joints)
    # fixed seeds: an arm works about the same posture in every run
    shifts = np.random.default_rng(0).uniform(-SPREAD, SPREAD, size)
    # about half of the joints stay in the middle
    shifts[np.random.default_rng(1).random(size) < 0.5] = 0.0
    scores = []
    for shift in shifts:
        distance_from_middle = np.mean(shift**2) / SPREAD**2
        scores.append(_score(kinematics, middle + shift * span) - distance_from_middle)
    best = shifts[int(np.argmax(scores))]
    # two digits, as a person would give a posture
    return np.round(middle + best * span, 2)


def _score(kinematics: Kinematics, q: np.ndarray) -> float:
    """Tool in front (x over distance), pointing down, neither low nor high, and away from singular postures [1]."""
    tool = kinematics.tool(q)
    position = tool.translation
    distance = max(float(np.linalg.norm(position)), np.finfo(float).eps)
    in_front = position[0] / distance
    upwards = tool.rotation[2, 2]
    height_error = abs(position[2] / distance - 0.5)
    singular = np.linalg.svd(kinematics.tool_jacobian(q), compute_uv=False)
    # the worst direction over the best: 0 in a singular posture
    dexterity = singular[-1] / max(singular[0], np.finfo(float).eps)
    return float(in_front - upwards - height_error + 2 * dexterity)


# A weld seam: the tool follows a straight line at constant speed and keeps its orientation.


RAMP = 0.2
"""Share of the duration in which the tool speeds up, and again slows down [1]."""
KNOTS = 41
"""Points of the line at which the inverse kinematics is solved."""
CHECKS = 401
"""Points at which the limits are checked."""
TOP = 1 / (1 - RAMP)
"""Speed in the middle over the mean one [1]."""
_PROGRESS = BPoly.from_derivatives(
    [0, RAMP, 1 - RAMP, 1], [[0, 0, 0], [TOP, 0, 0], [TOP, 0, 0], [0, 0, 0]]
).antiderivative()
"""Share of the line over the share of the time: its rate rises and falls as 10 x^3 - 15 x^4 + 6 x^5."""


def weld_seam(
    kinematics: Kinematics,
    start: np.ndarray,
    way: np.ndarray,
    limits: Limits,
    speed: float,
) -> Curve:
    """The fastest motion q(t) = path(s(t / T)) along a straight line of the tool, at rest at both ends, within limits.

    s'(x) rises as 10 x^3 - 15 x^4 + 6 x^5 within ``RAMP`` of the time, stays constant and falls back; path is a quintic
    spline through solutions of the inverse kinematics.

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
    if kinematics.n_joints < LEAST_JOINTS or not length > 0:
        raise InputError(
            f"a straight line of {length:.3g} m with {kinematics.n_joints} joints",
            "a weld seam needs at least three joints, and a length",
            where="weld_seam",
        )
    path = _joint_path(kinematics, start, np.asarray(way, dtype=float))

    def lasting(duration: float) -> Curve:
        def along(t: np.ndarray, order: int) -> np.ndarray:
            """By the chain rule: q'' = path'' s'^2 + path' s''."""
            s, ds, dds = (_PROGRESS(t / duration, k)[:, None] for k in range(3))
            found = path(s[:, 0], order) * ds**order
            if order == 2:
                found = found + path(s[:, 0], 1) * dds
            return found / duration**order

        return Curve(along, duration)

    # the path does not depend on the duration: its limits are checked first
    s = np.linspace(0.0, 1.0, CHECKS)
    q = path(s)
    outside = ((q < limits.lower - 1e-9) | (q > limits.upper + 1e-9)).any(axis=0)
    if outside.any():
        raise GapscopeError(
            f"joint {int(outside.argmax()) + 1} would leave its limits along the seam",
            "choose a shorter seam, or another posture to start from",
        )
    # scaled in time: peaks of a motion of one second say how long it has to take
    once = lasting(1.0)
    fast, bend = np.abs([once.velocity(s), once.acceleration(s)]).max(axis=1)
    # a little longer, for what happens between the points
    by_joints = 1.001 * shortest(fast, bend, limits)
    by_tool_speed = TOP * length / speed
    return lasting(max(by_joints, by_tool_speed, SHORTEST))


def _joint_path(kinematics: Kinematics, start: np.ndarray, way: np.ndarray) -> BSpline:
    """Spline through the joint positions along the line, over the share s of it."""
    at_start = kinematics.tool(start)
    shares = np.linspace(0.0, 1.0, KNOTS)
    knots = [np.asarray(start, dtype=float)]
    for share in shares[1:]:
        shifted = at_start.translation + share * way
        target = pin.SE3(at_start.rotation, shifted)
        # from the knot before: of several solutions the near one, without leaps
        knots.append(inverse_kinematics(kinematics, target, knots[-1]))
    return make_interp_spline(shares, np.array(knots), k=5)


# Named motions, drawn at random within limits: what a tracked arm is asked to do.


ACCELERATION = 5.0
"""Limit of the joints' acceleration, which a URDF does not give [rad/s^2]."""
SPEED = 1.5
"""Joints move no faster than this, whatever the URDF allows [rad/s]."""
MARGIN = 0.1
"""Distance kept from the position limits, more than an encoder is usually off [rad]..."""
NARROW = 0.25
"""...but no more than this share of a joint's range, of which else nothing might be left [1]."""
POSTURE_SPREAD = 0.35
"""Share of the room about the working posture in which postures are drawn [1]."""
DWELL = 0.3
"""Rest between motions [s]."""
DRAWS = 200
"""Draws of a straight line before giving up."""


class Workspace(NamedTuple):
    """Where an arm moves: its kinematics, limits, and the posture [rad], shape (n,), about which it works."""

    kinematics: Kinematics
    limits: Limits
    posture: np.ndarray


def workspace(
    body: RigidBody, limits: Limits | None = None, posture: np.ndarray | None = None
) -> Workspace:
    """The workspace of an arm.

    Args:
        body: rigid-body model of the arm.
        limits: by default those of the URDF, with at most ``SPEED`` [rad/s] and ``ACCELERATION`` [rad/s^2].
        posture: [rad], shape (n,); by default in front of the base, with the tool down.

    Raises:
        InputError: the posture has another number of joints, or lies outside the limits.
    """
    if limits is None:
        # with the margin, but for half of a narrow range at least
        widest = urdf_limits(body, ACCELERATION, margin=0.0)
        own = urdf_limits(body, ACCELERATION, margin=MARGIN)
        narrow = NARROW * (widest.upper - widest.lower)
        limits = own._replace(
            lower=np.minimum(own.lower, widest.lower + narrow),
            upper=np.maximum(own.upper, widest.upper - narrow),
            velocity=np.minimum(own.velocity, SPEED),
        )
    kinematics = Kinematics(body)
    if posture is None:
        posture = working_posture(kinematics, limits)
    posture = np.asarray(posture, dtype=float)
    if posture.shape != (body.n_joints,):
        raise InputError(
            f"expected {body.n_joints} numbers, one per joint, got {posture.size}",
            where="posture",
        )
    outside = ~((posture > limits.lower) & (posture < limits.upper))
    if outside.any():
        joint = int(outside.argmax())
        raise InputError(
            f"joint {joint + 1} at {posture[joint]:.4g} rad lies outside its limits",
            f"choose one between {limits.lower[joint]:.4g} and {limits.upper[joint]:.4g} rad",
            where="posture",
        )
    return Workspace(kinematics, limits, posture)


def draw_motion(
    name: str, rng: np.random.Generator, space: Workspace, duration: float
) -> ReferenceMotion:
    """A random motion of a kind, at rest at its start, that lasts for at least ``duration`` [s].

    Args:
        name: one of ``MOTIONS``, or ``random`` for one of those that this arm can follow.
        rng: source of the motion.
        space: where the arm moves.
        duration: [s], positive.

    Raises:
        InputError: unknown name, or a straight line asked of an arm with fewer than three joints.
        GapscopeError: no straight line was found that keeps the limits.
    """
    check_motion_name(name, space.kinematics.n_joints)
    if name == "random":
        name = str(rng.choice(motions_for(space.kinematics.n_joints)))
    limits, q = space.limits, space.posture
    if name == "fourier":
        frequency = float(rng.uniform(0.1, 0.3))
        # about the posture as far as there is room
        shift = rng.uniform(-0.2, 0.2, len(q)) * _room_to_limits(space)
        return Fourier.random(
            rng,
            limits,
            duration=duration,
            centre=q + shift,
            frequency=frequency,
            ramp=min(1.0, duration / 3),
        )
    # legs in turn, from the working posture on, until the duration is filled
    parts: list[Timed] = []
    for leg in cycle(LEGS[name]):
        if sum(part.duration for part in parts) >= duration:
            break
        found = _leg(leg, rng, space, q)
        parts += found
        q = _end(found[-1]) if found else q
    return chain(parts)


def check_motion_name(name: str, n_joints: int) -> None:
    """Check that there is such a motion, and that an arm of n joints can follow it.

    Raises:
        InputError: unknown name, or a straight line asked of an arm with fewer than three joints.
    """
    check_known("motion", name, [*MOTIONS, "random"], where="motion")
    possible = motions_for(n_joints)
    if name not in possible and name != "random":
        raise InputError(
            f"{name} needs at least three joints, the arm has {n_joints}",
            f"use {' or '.join(possible)}",
            where="motion",
        )


def motions_for(n_joints: int) -> tuple[str, ...]:
    """Names of the motions that an arm of n joints can follow."""
    return tuple(
        name
        for name in MOTIONS
        if n_joints >= LEAST_JOINTS or name not in STRAIGHT_LINE_MOTIONS
    )


STRAIGHT_LINE_MOTIONS = ("weld_seam", "pick", "place")
"""Those that hold straight lines of the tool."""


def _leg(
    kind: str, rng: np.random.Generator, space: Workspace, now: np.ndarray
) -> tuple[Timed, ...]:
    """The next motions from the joint positions at which the arm rests [rad], shape (n,).

    Args:
        kind: ``posture``, another one, up to half as fast as the limits allow; ``home``, the working posture; ``seam``,
            a horizontal line at 0.05 to 0.2 m/s; ``object``, straight down to it, a rest while the gripper acts, and
            straight up again.
        rng: source of postures and lines.
        space: where the arm moves.
        now: where it rests.
    """
    if kind == "home":
        return _move_and_rest(now, space.posture, space.limits)
    if kind == "posture":
        to, slower = _draw_posture(rng, space), float(rng.uniform(1.0, 2.0))
        return _move_and_rest(now, to, space.limits, slower)
    direction, speed = np.array([0.0, 0.0, -1.0]), 0.25
    if kind == "seam":
        angle, speed = rng.uniform(-np.pi, np.pi), float(rng.uniform(0.05, 0.2))
        direction = np.array([np.cos(angle), np.sin(angle), 0.0])
    start, line = _draw_straight_line(rng, space, direction, speed)
    parts: list[Timed] = [*_move_and_rest(now, start, space.limits)]
    # up again by the way that the tool came down
    for way in (line,) if kind == "seam" else (line, backwards(line)):
        end = _end(way)
        parts += [way, point_to_point(end, end, DWELL)]
    return tuple(parts)


def _end(motion: Timed) -> np.ndarray:
    """Joint positions at the end of a motion [rad], shape (n,)."""
    return motion.position(np.array([motion.duration]))[0]


def _move_and_rest(
    now: np.ndarray, to: np.ndarray, limits: Limits, slower: float = 1.0
) -> tuple[Timed, ...]:
    """A motion from point to point and a rest; none if the arm is there already."""
    if np.array_equal(now, to):
        return ()
    duration = slower * fastest(now, to, limits).duration
    return point_to_point(now, to, duration), point_to_point(to, to, DWELL)


def _draw_straight_line(
    rng: np.random.Generator, space: Workspace, direction: np.ndarray, speed: float
) -> tuple[np.ndarray, Curve]:
    """A posture and a line from it, of 10 to 30 % of the tool's distance from the base, that keeps the limits."""
    reach = float(np.linalg.norm(space.kinematics.tool(space.posture).translation))
    problem = GapscopeError("no line was drawn")
    # many lines leave the limits or the reach: others are drawn
    for _ in range(DRAWS):
        start = _draw_posture(rng, space)
        way = direction * rng.uniform(0.1, 0.3) * reach
        try:
            return start, weld_seam(space.kinematics, start, way, space.limits, speed)
        except GapscopeError as error:
            problem = error
    raise GapscopeError(
        f"no straight line within the limits in {DRAWS} draws; the last: {problem.message}",
        "give another posture, or use fourier or point_to_point",
    )


def _draw_posture(rng: np.random.Generator, space: Workspace) -> np.ndarray:
    """A posture about the working posture [rad], shape (n,)."""
    share = POSTURE_SPREAD * rng.uniform(-1.0, 1.0, len(space.posture))
    return space.posture + share * _room_to_limits(space)


def _room_to_limits(space: Workspace) -> np.ndarray:
    """Way from the posture to the nearer limit, 2 rad at most [rad], shape (n,)."""
    limits, posture = space.limits, space.posture
    return np.minimum(np.minimum(limits.upper - posture, posture - limits.lower), 2.0)


LEGS = {
    "point_to_point": ("posture",),
    "weld_seam": ("seam",),
    "pick": ("object", "home"),
    "place": ("posture", "object", "home"),
}
"""Legs that a motion repeats in turn, by its name."""
MOTIONS = ("fourier", *LEGS)
"""Kinds of motion by name."""
