"""Checks of what a user hands to the environment."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol, TypeVar

import numpy as np

from gapscope.arm.control import FEEDFORWARDS
from gapscope.arm.errors import InputError, ModelWarning
from gapscope.arm.io.json_file import plain, schema_fault
from gapscope.arm.motions.motion import Motion
from gapscope.arm.motions.named_motions import check_motion_name
from gapscope.arm.motions.trajectory import Limits, ReferenceMotion
from gapscope.arm.nearest_name import check_known
from gapscope.arm.nominal import NominalArm
from gapscope.arm.robots import KNOWN_ROBOTS, load_nominal_arm
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.corrected_file import NO_REMAINDER

READ = "read one with gapscope.effects.corrected_file.read_corrected_arm(arm, path)"
"""How to come by an arm to simulate."""


class FeedforwardModel(Protocol):
    """A model whose torque is fed forward."""

    def series(self, motion: Motion) -> np.ndarray:
        """Torque to command over a motion known beforehand [N m], shape (N, n)."""


def check_values(
    values: Mapping[str, Any], document: str, section: str, where: str = ""
) -> None:
    """Check values by a section of a schema; those that are ``None`` are left open.

    Args:
        values: by name.
        document: name of the schema, a file of ``gapscope/schemas``.
        section: of the schema.
        where: what the names belong to, for messages.

    Raises:
        InputError: one is not what is expected; says what is.
    """
    given = {name: value for name, value in values.items() if value is not None}
    # what is not finite has no place in a schema: as null it is refused there
    content = plain(given, null_if_not_finite=True)
    fault = schema_fault(content, document, section)
    if fault is not None:
        name = str(fault.absolute_path[0])
        # the schema says in words what it wants
        expected = fault.schema["description"]
        raise InputError(
            f"expected {expected}, got {values[name]!r}", where=where + name
        )


def noise(name: str, value: float | Sequence[float], n_joints: int) -> np.ndarray:
    """Standard deviations of n joints, shape (n,), from one number or one per joint, each finite and from zero on.

    Raises:
        InputError: they are not.
    """
    array = numbers_of(name, value)
    if array.shape not in ((), (n_joints,)) or not (
        np.isfinite(array).all() and (array >= 0).all()
    ):
        raise InputError(
            f"expected one number from zero on, or {n_joints}, one per joint; got {value!r}",
            where=name,
        )
    return np.broadcast_to(array, (n_joints,))


def numbers_of(name: str, value: object) -> np.ndarray:
    """The value as an array of numbers, of any shape.

    Raises:
        InputError: it holds what is not a number.
    """
    try:
        return np.array(value, dtype=float)
    except (TypeError, ValueError):
        raise InputError(f"holds what is not a number, {value!r}", where=name) from None


Record = TypeVar("Record")


def record_of(name: str, value: object, kind: type[Record], remedy: str) -> Record:
    """The value, if it is of a class.

    Raises:
        InputError: it is not.
    """
    if not isinstance(value, kind):
        raise InputError(f"expected {kind.__name__}, got {value!r}", remedy, where=name)
    return value


def checked_limits(limits: Limits | None, n_joints: int) -> Limits | None:
    """Limits of the motions drawn, as arrays.

    Raises:
        InputError: they are no limits, are not of n joints, or leave no room.
    """
    if limits is None:
        return None
    remedy = (
        "give gapscope.arm.motions.trajectory.Limits(lower, upper, velocity, "
        "acceleration) in rad, rad/s and rad/s^2"
    )
    arrays = [
        numbers_of("limits", value)
        for value in record_of("limits", limits, Limits, remedy)
    ]
    for name, array in zip(Limits._fields, arrays, strict=True):
        if array.shape != (n_joints,) or not np.isfinite(array).all():
            raise InputError(
                f"expected {n_joints} numbers, one per joint, got {array.tolist()}",
                where=f"limits.{name}",
            )
    found = Limits(*arrays)
    if not (
        (found.lower < found.upper).all()
        and (found.velocity > 0).all()
        and (found.acceleration > 0).all()
    ):
        raise InputError(
            "lower has to be below upper, velocity and acceleration above zero",
            where="limits",
        )
    return found


def checked_actions(actions: object, shape: tuple[int, ...]) -> np.ndarray:
    """An action, shape (size,), or those of N environments, shape (N, size).

    Raises:
        InputError: they have another shape, or hold what is not a finite number.
    """
    array = numbers_of("action", actions)
    if array.shape != shape:
        wanted = f"{shape[0]} numbers" if len(shape) == 1 else f"shape {shape}"
        raise InputError(
            f"expected {wanted} in -1 .. 1, got shape {array.shape}", where="action"
        )
    if (
        not np.vdot(array, array) < np.inf and not np.isfinite(array).all()
    ):  # the first is fast
        raise InputError(
            f"holds a number that is not finite, {array.tolist()}",
            "has the agent diverged?",
            where="action",
        )
    return array


def chosen_robot(
    robot: str | Path | NominalArm, sheet: Mapping[str, Any] | None
) -> NominalArm:
    """The nominal arm; that of a known name with its rotors, unless the data sheet states some.

    Raises:
        InputError: no such robot, a data sheet that does not fit it, or one beside a nominal arm, which has its own.
    """
    if isinstance(robot, (str, Path)):
        known, arm = KNOWN_ROBOTS.get(str(robot)), load_nominal_arm(robot, sheet=sheet)
        # a robot by name is to be controllable: bodies alone may be too light for that
        if known is not None and known.rotors and not arm.armature.any():
            arm = replace(arm, armature=np.array(known.rotors))
        return arm
    record_of(
        "robot",
        robot,
        NominalArm,
        f"give {', '.join(KNOWN_ROBOTS)}, the path of a URDF, or a nominal arm",
    )
    if sheet is not None:
        raise InputError(
            "a nominal arm has its own data sheet",
            "leave sheet out, or give a URDF",
            where="sheet",
        )
    return robot


def checked_motion(
    motion: str | ReferenceMotion, n_joints: int
) -> str | ReferenceMotion:
    """The motion, if an arm of n joints can follow it.

    Raises:
        InputError: unknown name, a straight line with fewer than three joints, or a reference of other joints.
    """
    if isinstance(motion, str):
        check_motion_name(motion, n_joints)
    elif not all(
        callable(getattr(motion, name, None))
        for name in ("position", "velocity", "acceleration")
    ):
        raise InputError(
            f"{motion!r} is no motion",
            "give a name, or position, velocity and acceleration",
            where="motion",
        )
    # asked of one sample: what a motion returns says how many joints it is of
    elif (shape := motion.position(np.zeros(1)).shape) != (1, n_joints):
        raise InputError(
            f"one sample of the motion has shape {shape}, the arm has {n_joints} joints",
            f"let it return shape (N, {n_joints})",
            where="motion",
        )
    return motion


def chosen_feedforward(feedforward: str | FeedforwardModel) -> str | FeedforwardModel:
    """What is fed forward: a name of ``gapscope.arm.control.FEEDFORWARDS``, or a model.

    Raises:
        InputError: an unknown name, or an object without ``series``.
    """
    if isinstance(feedforward, str):
        return check_known(
            "feedforward", feedforward, FEEDFORWARDS, where="feedforward"
        )
    if not callable(getattr(feedforward, "series", None)):
        raise InputError(
            f"{feedforward!r} is no feedforward",
            f"give {', '.join(FEEDFORWARDS)}, or a model with series(motion) in N m",
            where="feedforward",
        )
    return feedforward


def chosen_base(
    simulated: CorrectedArm | None, arm: NominalArm, effects: object
) -> CorrectedArm:
    """The arm that is simulated: the one given, or the nominal arm.

    Raises:
        InputError: it has other joints, or effects are given beside it.
    """
    if simulated is None:
        return CorrectedArm(arm)
    record_of("simulated", simulated, CorrectedArm, READ)
    if effects is not None:
        raise InputError(
            "are given beside simulated, which has its own",
            "leave them out",
            where="effects",
        )
    # observations and actions are by the joints of the robot
    if simulated.arm.joints != arm.joints:
        raise InputError(
            f"has the joints {', '.join(simulated.arm.joints)}, the robot has {', '.join(arm.joints)}",
            "identify or diagnose the arm that is the robot",
            where="simulated",
        )
    simulated.check()
    if simulated.remainder is not None:
        warnings.warn(f"simulated: {NO_REMAINDER}", ModelWarning, stacklevel=3)
    return simulated
