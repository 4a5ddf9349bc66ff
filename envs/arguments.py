"""Checks of what a user hands to the environment."""

from __future__ import annotations

import math
import numbers
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from arm.errors import InputError
from arm.feedforward import KINDS as FEEDFORWARDS
from arm.motions import check_motion_name
from arm.nearest import check_known
from arm.nominal import NominalArm
from arm.robots import load_nominal_arm
from arm.trajectory import Reference
from effects.applied import AppliedEffect
from effects.corrected import CorrectedArm
from effects.corrected_file import blaming, read_corrected
from envs.course import Feedforward

Effects = Sequence[AppliedEffect] | Path | str | None
"""Effects as records, as a file of the form of ``corrected.yaml``, or none."""


def positive(name: str, value: float, unit: str) -> float:
    """The value, if it is a finite number above zero.

    Raises:
        InputError: it is not.
    """
    if isinstance(value, bool) or not isinstance(value, numbers.Real) or not (math.isfinite(value) and value > 0):
        raise InputError(f"expected a number above zero [{unit}], got {value!r}", where=name)
    return float(value)


def whole(name: str, value: int) -> int:
    """The value, if it is a whole number above zero.

    Raises:
        InputError: it is not.
    """
    if isinstance(value, bool) or not isinstance(value, numbers.Integral) or value < 1:
        raise InputError(f"expected a whole number from 1 on, got {value!r}", where=name)
    return int(value)


def chosen_robot(robot: str | Path | NominalArm, sheet: Mapping[str, Any] | None) -> NominalArm:
    """The nominal arm.

    Raises:
        InputError: no such robot, a data sheet that does not fit it, or one beside a nominal arm, which has its own.
    """
    if not isinstance(robot, NominalArm):
        return load_nominal_arm(robot, sheet=sheet)
    if sheet is not None:
        raise InputError("a nominal arm has its own data sheet", "leave sheet out, or give a URDF", where="sheet")
    return robot


def checked_motion(motion: str | Reference, n_joints: int) -> str | Reference:
    """The motion, if an arm of n joints can follow it.

    Raises:
        InputError: unknown name, a straight line with fewer than three joints, or a reference of other joints.
    """
    if isinstance(motion, str):
        check_motion_name(motion, n_joints)
    elif not all(callable(getattr(motion, name, None)) for name in ("position", "velocity", "acceleration")):
        raise InputError(
            f"{motion!r} is no motion", "give a name, or position, velocity and acceleration", where="motion"
        )
    elif (shape := motion.position(np.zeros(1)).shape) != (1, n_joints):
        raise InputError(
            f"one sample of the motion has shape {shape}, the arm has {n_joints} joints",
            f"let it return shape (N, {n_joints})",
            where="motion",
        )
    return motion


def chosen_feedforward(feedforward: str | Feedforward) -> str | Feedforward:
    """What is fed forward: a name of ``arm.feedforward.KINDS``, or a model.

    Raises:
        InputError: an unknown name, or an object without ``series``.
    """
    if isinstance(feedforward, str):
        return check_known("feedforward", feedforward, FEEDFORWARDS, where="feedforward")
    if not callable(getattr(feedforward, "series", None)):
        raise InputError(
            f"{feedforward!r} is no feedforward",
            f"give {', '.join(FEEDFORWARDS)}, or a model with series(motion) in N m",
            where="feedforward",
        )
    return feedforward


def chosen_base(simulated: CorrectedArm | None, arm: NominalArm, effects: Effects) -> CorrectedArm:
    """The arm that is simulated: the one given, or the nominal arm.

    Raises:
        InputError: it has other joints, or effects are given beside it.
    """
    if simulated is None:
        return CorrectedArm(arm)
    if effects is not None:
        raise InputError("are given beside simulated, which has its own", "leave them out", where="effects")
    if simulated.arm.joints != arm.joints:
        raise InputError(
            f"has the joints {', '.join(simulated.arm.joints)}, the robot has {', '.join(arm.joints)}",
            "identify or diagnose the arm that is the robot",
            where="simulated",
        )
    simulated.check()
    return simulated


def chosen_effects(effects: Effects, arm: NominalArm) -> tuple[AppliedEffect, ...]:
    """The effects as records.

    Raises:
        InputError: the file is at fault, what was given is no effect, or an effect acts on a joint that the arm lacks.
    """
    if effects is None:
        return ()
    found = read_corrected(effects) if isinstance(effects, (str, Path)) else tuple(effects)
    for applied in found:
        if not isinstance(applied, AppliedEffect):
            raise InputError(
                f"{applied!r} is no effect with values",
                "give AppliedEffect records, or the path of a corrected.yaml",
                where="effects",
            )
    with blaming(effects if isinstance(effects, (str, Path)) else None, found):
        CorrectedArm(arm, found).check()
    return found


def described(applied: AppliedEffect) -> dict[str, Any]:
    """An effect as in ``corrected.yaml``: plain data."""
    values = {name: value.tolist() for name, value in applied.parameters.items()}
    return {"effect": applied.name, "joints": list(applied.joints), "parameters": values}
