"""Numbers as a person reads them: sensible digits, units with prefixes, value with standard deviation."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import ArrayLike
from scipy.constants import micro, milli

MISSING = "–"
"""Shown for an unknown number."""

_DEGREE = math.degrees(1.0)
_PREFIXES: dict[str, tuple[tuple[float, float, str], ...]] = {
    "s": ((0.0, 1 / micro, "µs"), (milli, 1 / milli, "ms"), (0.2, 1.0, "s")),
    "m": ((0.0, 1 / milli, "mm"), (1.0, 1.0, "m")),
    "rad": (
        (0.0, 1 / micro, "µrad"),
        (0.1 * milli, 1 / milli, "mrad"),
        (0.1 / _DEGREE, _DEGREE, "°"),
    ),
    "1": ((0.0, 1.0, ""),),
}
"""Per SI unit: from which magnitude on, multiplied by what, called what."""


_PROPER = {"coulomb": "Coulomb", "stribeck": "Stribeck"}


def unit_name(unit: str) -> str:
    """An SI unit as it is shown; nothing of a ratio."""
    return "" if unit == "1" else unit.replace("^2", "²").replace("^3", "³")


def display_unit(unit: str, magnitude: float) -> tuple[float, str]:
    """Factor and name of the unit in which a value of this magnitude (in ``unit``, SI) reads best."""
    if unit not in _PREFIXES:
        return 1.0, unit_name(unit)
    # the last unit whose range the value has reached
    return [
        (factor, name)
        for least, factor, name in _PREFIXES[unit]
        if magnitude >= least or least == 0.0
    ][-1]


def significant(value: float | None, digits: int = 3, signed: bool = False) -> str:
    """Value with this many significant digits, without exponent; a dash for ``None``."""
    if value is None or not math.isfinite(value):
        return MISSING
    if value == 0.0:
        return "0"
    return _fixed(value, digits - 1 - math.floor(math.log10(abs(value))), signed)


def compact(value: float | None) -> str:
    """A setting, such as a rate, without trailing zeros; a dash for ``None``."""
    return MISSING if value is None else f"{value:.5g}"


def uncertain(value: float, std: float | None, signed: bool = False) -> str:
    """``value ± std``, both cut where the standard deviation stops being informative (one or two of its digits)."""
    if std is None or std <= 0.0 or not math.isfinite(std):
        return significant(value, signed=signed)
    exponent = math.floor(math.log10(std))
    # two digits of a deviation that begins with 1, 2 or 3, one of others
    places = (0 if std / 10.0**exponent >= 3.55 else 1) - exponent
    if value:
        # no more digits than a value of doubtful size deserves
        places = min(places, 5 - math.floor(math.log10(abs(value))))
    return (
        f"{_fixed(value, places, signed)} ± {_fixed(max(std, 10.0**-places), places)}"
    )


def nrmse(value: float | None) -> str:
    """A torque NRMSE: three decimals, for values below one; a dash for ``None``."""
    return (
        MISSING if value is None else f"{value:.3f}" if value < 10.0 else f"{value:.0f}"
    )


def listing(parts: Sequence[str]) -> str:
    """Parts joined as in a sentence: ``a, b and c``."""
    if len(parts) < 2:
        return "".join(parts)
    first = ", ".join(parts[:-1])
    return f"{first} and {parts[-1]}"


def marked(mask: ArrayLike, prefix: str = "") -> str:
    """Numbers from 1 of what a mask, (n,), marks: ``2, 5``, or with a prefix ``q2, q5``."""
    return ", ".join(f"{prefix}{place + 1}" for place in np.flatnonzero(mask))


def figures(values: Iterable[float], digits: int = 4) -> str:
    """Numbers with so many significant digits each."""
    return ", ".join(f"{value:.{digits}g}" for value in values)


def percent(fraction: float | None) -> str:
    """A share or a probability as a whole percentage; never 0 % or 100 % of something that is not exactly that."""
    if fraction is None:
        return MISSING
    whole = _fixed(100.0 * fraction, 0)
    # rounded to nothing or all, which it is not
    if whole == "0" and fraction > 0.0:
        return "< 1 %"
    if whole == "100" and fraction < 1.0:
        return "> 99 %"
    return f"{whole} %"


def _fixed(value: float, places: int, signed: bool = False) -> str:
    rounded = round(value, places) + 0.0  # no negative zero
    text = f"{abs(rounded):.{max(places, 0)}f}"
    return f"{'−' if rounded < 0.0 else '+' if signed and rounded > 0.0 else ''}{text}"


def effect_name(name: str) -> str:
    """Readable name of an effect: ``coulomb_friction`` becomes ``Coulomb friction``."""
    return " ".join(_PROPER.get(word, word) for word in name.split("_"))
