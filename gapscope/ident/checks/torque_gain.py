"""A gain that recorded torque has over the nominal arm's common to all joints: another unit, or another scale."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gapscope.ident.checks.fit_evidence import NominalSimilarity

CLEAR = 0.05
"""A joint counts if only the rigid bodies explain this share of its torque's variance [1]."""
ALIKE = 1.25
"""Gains within this factor of their median agree [1]."""
MOSTLY = 0.75
"""Share of the joints that count whose gains have to agree [1]."""
GAIN = 1.3
"""Gains beyond this, or below its inverse, are not those of torque in N m [1]."""
UNITS = {
    "mN m": 1e3,
    "ozf in": 141.6,
    "N cm": 1e2,
    "kgf cm": 10.2,
    "lbf in": 8.851,
    "lbf ft": 0.7376,
    "kgf m": 0.102,
}
"""What 1 N m is in other units."""


@dataclass(frozen=True)
class TorqueGain:
    """Gain of the nominal rigid bodies' torque in the recorded one, friction left free.

    Attributes:
        gain: median over the joints that count [1]; 1 if fewer than two do.
        alike: whether those joints agree.
        joints: those joints, from 1.
    """

    gain: float
    alike: bool
    joints: tuple[int, ...]

    @property
    def size(self) -> float:
        """The gain or its inverse, whichever is larger, of joints that agree [1]; 1 if they do not."""
        return max(self.gain, 1 / self.gain) if self.alike else 1.0

    @property
    def found(self) -> bool:
        """Whether the torque is another by a common factor."""
        return self.size > GAIN

    def warning(self) -> str:
        """What is wrong, the factor, and what to do."""
        near = [
            unit for unit, value in UNITS.items() if 1 / 1.03 < self.gain / value < 1.03
        ]
        guess = f", as if it were in {near[0]}" if near else ""
        return (
            f"the recorded torque is {self.gain:.3g} times the nominal arm's on joint "
            f"{', '.join(map(str, self.joints))} alike{guess}: masses and friction come out off by that factor if "
            "the unit is wrong; say in the case import: {tau: {scale: [...]}}, torque constants and gear ratios "
            "included, or correct the URDF"
        )


def torque_gain(found: NominalSimilarity) -> TorqueGain:
    """The common gain, of the joints on which the rigid bodies show."""
    clear = np.flatnonzero((found.weight > CLEAR) & (found.gain > 0))
    # one joint alone may have an error of its own
    if len(clear) < 2:
        return TorqueGain(1.0, False, ())
    gains = found.gain[clear]
    median = float(np.median(gains))
    factor = np.maximum(gains / median, median / gains)
    alike = factor < ALIKE
    joints = tuple(int(j) + 1 for j in clear[alike])
    return TorqueGain(median, bool(alike.mean() >= MOSTLY), joints)
