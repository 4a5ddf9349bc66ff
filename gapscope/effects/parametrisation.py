"""How a diagnosis fits an effect: numbers in which the torque is linear, or nearly so, and those in which it is not.

A parameter like a ripple's phase or an elastic joint's stiffness enters the torque in an awkward way, a combination of
parameters in a simple one. The linear coordinates are fitted by least squares; the nonlinear parameters are searched.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Literal

import numpy as np

from gapscope.effects.parameter import Parameter

Values = Mapping[str, np.ndarray]
"""Values of parameters by name."""
GridUnit = Literal["own", "duration", "largest speed"]
"""What the values of a grid count in."""


@dataclass(frozen=True)
class Grid:
    """Values of a nonlinear parameter that a diagnosis tries first, in equal ratios.

    Attributes:
        lowest, highest: ends of the grid, in ``unit``.
        bounds: of the values tried later, about the best one, in ``unit``.
        unit: what the values count in: the parameter's own unit, the length of the longest recording [s], or the
            largest speed of the joint [rad/s].
        points: number of values.
    """

    lowest: float
    highest: float
    bounds: tuple[float, float]
    unit: GridUnit = "own"
    points: int = 16


@dataclass(frozen=True)
class Parametrisation:
    """How one effect is fitted, on m joints, one link (m = 1) or the whole arm (m = 1).

    Attributes:
        values: parameters from linear coordinates, shape (linear, m), and nonlinear parameters, shape (s, m).
        linear: number of linear coordinates.
        nonlinear: names of the parameters that are searched.
        step: step of the linear coordinates for finite differences; ``None`` if it goes with the torque of the joint.
        lowest: least value of the first linear coordinate.
        usual: size of the linear coordinates that is usual on real arms, the width of their prior; infinite if the
            recorded torque alone bounds them.
        data_sheet: quantity of the nominal arm to which the first linear coordinate adds, by its name in
            ``NominalArm``; the sum may not be negative.
        clip: moves linear coordinates, shape (linear, m), into the bounds of the parameters; ``None`` for no bounds.
        grid: where the search for the nonlinear parameter of a torque law or a drift begins.
    """

    values: Callable[[np.ndarray, np.ndarray], Values]
    linear: int = 1
    nonlinear: tuple[str, ...] = ()
    step: float | None = None
    lowest: float = -np.inf
    usual: float = np.inf
    data_sheet: str | None = None
    clip: Callable[[np.ndarray], np.ndarray] | None = None
    grid: Grid | None = None

    @property
    def cost(self) -> int:
        """Number of parameters that it spends."""
        return self.linear + len(self.nonlinear)


def linear_in(
    parameter: Parameter,
    *,
    step: float | None = None,
    lowest: float = -np.inf,
    data_sheet: str | None = None,
) -> Parametrisation:
    """The parametrisation of an effect whose torque is linear in its only parameter; see ``Parametrisation``.

    What multiplies speed, or is a torque itself, has no usual size: arms differ by orders of magnitude.
    """
    sized = parameter.unit not in ("N m", "N m s/rad")
    return Parametrisation(
        partial(_only, parameter.name),
        step=step,
        lowest=lowest,
        usual=max(map(abs, parameter.typical)) if sized else np.inf,
        data_sheet=data_sheet,
        clip=partial(_within, parameter.bounds),
    )


def amplitude_and_searched(
    amplitude: str,
    searched: str,
    grid: Grid | None = None,
    *,
    step: float | None = None,
    lowest: float = -np.inf,
) -> Parametrisation:
    """The parametrisation of an effect linear in one parameter, its amplitude, with another that is searched."""
    return Parametrisation(
        partial(_amplitude_and_searched, amplitude, searched),
        nonlinear=(searched,),
        step=step,
        lowest=lowest,
        grid=grid,
    )


def nonzero(divisor: np.ndarray) -> np.ndarray:
    """A divisor kept away from zero, its sign lost below 1e-9."""
    return np.where(np.abs(divisor) < 1e-9, 1e-9, divisor)


def _only(name: str, x: np.ndarray, nonlinear: np.ndarray) -> Values:
    return {name: x[0]}


def _amplitude_and_searched(
    amplitude: str, searched: str, x: np.ndarray, nonlinear: np.ndarray
) -> Values:
    return {amplitude: x[0], searched: nonlinear[0]}


def _within(bounds: tuple[float, float], x: np.ndarray) -> np.ndarray:
    return np.clip(x, *bounds)
