"""Which limit keeps a motion too small to determine an arm's parameters."""

from __future__ import annotations

import warnings
from typing import NamedTuple

import numpy as np

from gapscope.arm.errors import InputError, ModelWarning
from gapscope.arm.motions.trajectory import Limits
from gapscope.ident.excitation.criteria import condition_number
from gapscope.ident.excitation.trajectory_parametrisation import Parametrisation
from gapscope.ident.excitation.trajectory_search import SAMPLES, TrajectorySearch
from gapscope.ident.uncertainty.identifiability import CONDITION_LIMIT

USELESS = 1e8
"""Condition number above which a trajectory is refused: noise of 1e-8 of the torque would drown a parameter [1]."""
WIDER = 10.0
"""Factor by which a limit is widened to see what it costs [1]."""
WORTH = 2.0
"""Factor in the condition number that a wider limit must be worth to be named [1]."""
OPTIONS = {
    "acceleration": "raise --acceleration",
    "velocity": "raise --velocity",
    "position": "lower --margin",
}
"""Limits of the motion, and what widens each."""


class BindingLimit(NamedTuple):
    """The limit that keeps a motion small, and the condition number that it would have were it ``WIDER`` [1]."""

    limit: str
    condition: float


def binding_limit(
    search: TrajectorySearch, x: np.ndarray, condition: float
) -> BindingLimit | None:
    """The limit of the motion that costs a candidate most of its condition number; ``None`` if none costs much.

    With wider limits the same numbers x are a larger motion, so each limit can be widened alone.

    Args:
        search: what the candidate comes from.
        x: its numbers, shape (d,).
        condition: its condition number [1].
    """
    widened = [BindingLimit(name, _widened(search, x, name)) for name in OPTIONS]
    best = min(widened, key=lambda found: found.condition)
    return best if WORTH * best.condition <= condition else None


def check_condition(search: TrajectorySearch, x: np.ndarray, condition: float) -> None:
    """Warn if the condition number of a candidate exceeds ``CONDITION_LIMIT``, and name what would lower it.

    Raises:
        InputError: it exceeds ``USELESS``.
    """
    if condition <= CONDITION_LIMIT:
        return
    problem = f"the motion hardly determines the parameters, its condition number is {condition:.2g}"
    remedy = "allow more evaluations, more harmonics or a longer motion"
    binding = binding_limit(search, x, condition)
    if binding is not None:
        problem += f": the limit of {binding.limit} keeps it small"
        remedy = f"{OPTIONS[binding.limit]}; {WIDER:g} times as wide, it would leave {binding.condition:.2g}"
    if condition > USELESS:
        raise InputError(
            problem, remedy, where="limits" if binding is None else binding.limit
        )
    warnings.warn(f"{problem}; {remedy}", ModelWarning, stacklevel=3)


def _widened(search: TrajectorySearch, x: np.ndarray, name: str) -> float:
    """Condition number of the candidate were one limit ``WIDER`` [1]."""
    space = search.parametrisation
    t = np.linspace(0.0, space.family.duration, SAMPLES)
    wider = Parametrisation(space.family, _wider(space.limits, name))
    motion = wider.motion(x, t, space.family.basis(t))
    return condition_number(search.model.matrix(motion))


def _wider(limits: Limits, name: str) -> Limits:
    """Limits with one of them ``WIDER``."""
    if name != "position":
        return limits._replace(**{name: WIDER * getattr(limits, name)})
    middle = (limits.upper + limits.lower) / 2
    half = WIDER * ((limits.upper - limits.lower) / 2)
    return limits._replace(lower=middle - half, upper=middle + half)
