"""How a diagnosis fits an effect: numbers in which the torque is linear, or nearly so, and those in which it is not.

A parameter like a ripple's phase or an elastic joint's stiffness enters the torque in an awkward way, a combination of
parameters in a simple one. The linear coordinates are fitted by least squares; the nonlinear parameters are searched.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from gapscope.effects.parameter import Parameter

Values = Mapping[str, np.ndarray]
"""Values of parameters by name."""
GridUnit = Literal["own", "duration", "largest speed"]
"""What the values of a grid count in."""


FASTEST = 0.99
"""Quantile of a joint's speed that counts as its largest [1]: the last percent is noise and single peaks."""


class JointSeries(NamedTuple):
    """What one joint did in all recordings, by which values of a nonlinear parameter are chosen; a series per part.

    Attributes:
        t: time since the start of the recording [s], (N,) each.
        position, velocity: [rad], [rad/s].
        recorded: torque [N m].
        radian: what counts as a radian of this joint: 1, or of a slide a length [m].
    """

    t: Sequence[np.ndarray]
    position: Sequence[np.ndarray]
    velocity: Sequence[np.ndarray]
    recorded: Sequence[np.ndarray]
    radian: float


Tries = Callable[[JointSeries, float | None], np.ndarray]
"""Values of a nonlinear parameter to try, (K,): the first ones, or some about a value that is known."""


@dataclass(frozen=True)
class Grid:
    """Values of a nonlinear parameter that a diagnosis tries first, in equal ratios.

    Attributes:
        lowest, highest: ends of the grid, in ``unit``.
        bounds: of the values tried later, about the best one, in ``unit``.
        unit: what the values count in: the parameter's own unit, the length of the longest recording [s], or the
            largest speed of the joint [rad/s].
        points: number of values.
        least: of any value, in the parameter's own unit.
    """

    lowest: float
    highest: float
    bounds: tuple[float, float]
    unit: GridUnit = "own"
    points: int = 16
    least: float = 0.0

    def __call__(self, series: JointSeries, known: float | None) -> np.ndarray:
        """The values, (points,), or some about one that is known."""
        unit = self._unit(series)
        if known is None:
            # a unit may be next to nothing: no value is below the least
            first = max(unit * self.lowest, self.least)
            last = max(unit * self.highest, self.least)
            return np.geomspace(first, last, self.points)
        # to both sides of it in equal ratios, itself in the middle
        near = known * np.geomspace(0.6, 1 / 0.6, 13)
        least, most = unit * self.bounds[0], unit * self.bounds[1]
        return np.clip(near, max(least, self.least), most)

    def _unit(self, series: JointSeries) -> float:
        """What the values count in, in the parameter's own unit: 1, a time [s], or a speed [rad/s]."""
        if self.unit == "duration":
            # blocks of a recording begin when it has run for a while
            last = max(float(t[-1]) for t in series.t)
            return last - min(float(t[0]) for t in series.t)
        if self.unit == "largest speed":
            speeds = np.abs(np.concatenate(series.velocity))
            # a joint that never moves still needs a unit; nothing is found on it
            return max(float(np.quantile(speeds, FASTEST)), 1e-3)
        return 1.0


@dataclass(frozen=True)
class Parametrisation:
    """How one effect is fitted, on m joints, one link (m = 1) or the whole arm (m = 1).

    Attributes:
        values: parameters from linear coordinates, shape (linear, m), and nonlinear parameters, shape (s, m).
        linear: number of linear coordinates.
        nonlinear: names of the parameters that are searched.
        step: step of the linear coordinates for finite differences; ``None`` if it goes with the torque of the joint.
        lowest: least value of the first linear coordinate; or a function of the nominal masses of the links [kg], (n,),
            and of the number of the last link, from 0, that gives one value or one for each link.
        usual: size of the linear coordinates that is usual on real arms, the width of their prior; infinite if the
            recorded torque alone bounds them.
        proportions: how large the linear coordinates are beside each other on real arms, in their units; ``None`` if
            each may be as large as the torque allows.
        data_sheet: quantity of the nominal arm to which the first linear coordinate adds, by its name in
            ``NominalArm``; the sum may not be negative.
        constant: place of the linear coordinate that is a constant torque, as the offset of a joint is; or ``None``.
        clip: moves linear coordinates, shape (linear, m), into the bounds of the parameters; ``None`` for no bounds.
        grid: values of the nonlinear parameter to try; a ``Grid``, or a function of what the joint did.
        possible: which values the motion allows, (K,), by the torque recorded and the torque needed [N m], (M,) each;
            ``None`` if all.
    """

    values: Callable[[np.ndarray, np.ndarray], Values]
    linear: int = 1
    nonlinear: tuple[str, ...] = ()
    step: float | None = None
    lowest: float | Callable[[np.ndarray, int], np.ndarray | float] = -np.inf
    usual: float = np.inf
    proportions: tuple[float, ...] | None = None
    data_sheet: str | None = None
    constant: int | None = None
    clip: Callable[[np.ndarray], np.ndarray] | None = None
    grid: Tries | None = None
    possible: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray] | None = None


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
    # torque and what multiplies speed go with the size of the arm
    sized = parameter.unit not in ("N m", "N m s/rad")
    return Parametrisation(
        lambda x, _: {parameter.name: x[0]},
        step=step,
        lowest=lowest,
        # the typical range may reach to both sides of zero
        usual=max(map(abs, parameter.typical)) if sized else np.inf,
        data_sheet=data_sheet,
        clip=lambda x: np.clip(x, *parameter.bounds),
    )


def amplitude_and_searched(
    amplitude: str,
    searched: str,
    grid: Tries | None = None,
    *,
    step: float | None = None,
    lowest: float = -np.inf,
) -> Parametrisation:
    """The parametrisation of an effect linear in one parameter, its amplitude, with another that is searched."""
    return Parametrisation(
        lambda x, searches: {amplitude: x[0], searched: searches[0]},
        nonlinear=(searched,),
        step=step,
        lowest=lowest,
        grid=grid,
    )


def nonzero(divisor: np.ndarray) -> np.ndarray:
    """A divisor kept away from zero, its sign lost below 1e-9."""
    return np.where(np.abs(divisor) < 1e-9, 1e-9, divisor)
