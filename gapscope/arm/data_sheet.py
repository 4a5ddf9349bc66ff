"""The data sheet of an arm: what a user says about its joints, checked."""

from __future__ import annotations

import math
import numbers
from collections.abc import Mapping
from typing import Any

import numpy as np

from gapscope.arm.coupling import coupling_of_entries
from gapscope.arm.errors import InputError
from gapscope.arm.nearest_name import check_known
from gapscope.arm.nominal import SHEET_UNITS

KNOWN = (*SHEET_UNITS, "encoder", "encoder_step", "coupling")
"""Entries that a data sheet may have; ``encoder`` is checked by the nominal arm."""


def checked_sheet(
    sheet: Mapping[str, Any] | None, n_joints: int, where: str
) -> dict[str, Any]:
    """The entries of a data sheet.

    Args:
        sheet: armature [kg m^2], coulomb [N m], viscous [N m s/rad] and torque_limit [N m], each of shape (n,);
            encoder, encoder_step [rad]; coupling, a list of motors that turn with a further joint, returned as the
            matrix D, (n, n). An entry that is ``None`` is absent.
        n_joints: n.
        where: the argument or field that holds the sheet.

    Raises:
        InputError: an unknown entry, a list without one number per joint, or a number that is out of bounds.
    """
    if sheet is None:
        return {}
    if not isinstance(sheet, Mapping):
        raise InputError(
            f"expected entries by name, got {sheet!r}",
            f"known are {', '.join(KNOWN)}",
            where=where,
        )
    sheet = {key: value for key, value in sheet.items() if value is not None}
    for key, value in sheet.items():
        check_known("entry of a data sheet", key, KNOWN, where=where)
        if key in SHEET_UNITS:
            _check_numbers(key, value, n_joints, f"{where}.{key}")
    _check_step(sheet.get("encoder_step"), f"{where}.encoder_step")
    if "coupling" in sheet:
        entries, place = sheet["coupling"], f"{where}.coupling"
        if not isinstance(entries, list | tuple):
            raise InputError(f"expected a list, got {entries!r}", where=place)
        sheet["coupling"] = coupling_of_entries(entries, n_joints, place)
    return sheet


def _check_numbers(key: str, value: Any, n_joints: int, where: str) -> None:
    """Check that there is one number per joint, zero or above; a torque limit above zero, or infinite for none."""
    unit = SHEET_UNITS[key]
    try:
        array = np.array(value, dtype=float)
    except (TypeError, ValueError, OverflowError):
        raise InputError(
            f"holds what is not a number, {value!r}",
            f"give numbers in {unit}",
            where=where,
        ) from None
    if array.shape != (n_joints,):
        got = array.size if array.ndim == 1 else repr(value)
        raise InputError(
            f"expected {n_joints} numbers, one per joint, got {got}",
            f"give a list of numbers in {unit}",
            where=where,
        )
    limit = key == "torque_limit"
    allowed = array > 0 if limit else (array >= 0) & np.isfinite(array)
    if not allowed.all():
        joint = int((~allowed).argmax())
        raise InputError(
            f"{array[joint]:g} {unit} at joint {joint + 1}",
            f"give numbers {'above zero' if limit else 'from zero on'}, or leave {key} out",
            where=where,
        )


def _check_step(step: object, where: str) -> None:
    """Check a quantisation step [rad], ``None`` for none."""
    if step is None:
        return
    if (
        isinstance(step, bool)
        or not isinstance(step, numbers.Real)
        or not 0 <= float(step) < math.inf
    ):
        raise InputError(
            f"expected a number from zero on [rad], got {step!r}",
            "or leave it out",
            where=where,
        )
