"""What a watch can name: a load, friction, offset or encoder of a joint, each with the catalogue's name."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gapscope.effects.catalogue import of_quantity
from gapscope.ident.kalman.change_hypothesis import (
    PAYLOAD,
    ChangeHypothesis,
    friction_hypothesis,
    payload_hypothesis,
)
from gapscope.watching.detection.watched_arm import WatchedArm

OFFSET, ENCODER = (of_quantity(x)[0].name for x in ("offset", "zero"))
FRICTION, OTHER = "friction", "other"
"""Names in alarms beside those of effects; friction is viscous and Coulomb friction together."""


@dataclass(frozen=True)
class WatchedChange:
    """One change that can be named.

    Attributes:
        effect: what changes.
        joint: on which joint, from 1; ``None`` for the whole arm.
        hypothesis: the same in the parameters.
    """

    effect: str
    joint: int | None
    hypothesis: ChangeHypothesis

    @property
    def joints(self) -> list[int]:
        """The joint as a list, empty for the whole arm."""
        return [] if self.joint is None else [self.joint]


def watched_changes(arm: WatchedArm) -> tuple[WatchedChange, ...]:
    """All changes of an arm of n joints that can be named: 1 + 3 n.

    The encoder of the last joint in the arm's kinematics is left out: no gravity beyond it changes with its zero.
    """
    load = payload_hypothesis(arm, arm.body.last_link + 1)
    found = [WatchedChange(PAYLOAD, None, load)]
    for joint in range(1, arm.arm.n_joints + 1):
        found += [
            WatchedChange(FRICTION, joint, friction_hypothesis(arm, joint)),
            WatchedChange(OFFSET, joint, _single(arm, "o", joint)),
        ]
        if joint != arm.body.last_link + 1:
            found.append(WatchedChange(ENCODER, joint, _single(arm, "e", joint)))
    return tuple(found)


def _single(arm: WatchedArm, symbol: str, joint: int) -> ChangeHypothesis:
    """The change of one parameter of a joint."""
    name = f"{symbol}{joint}"
    direction = np.zeros((len(arm.names), 1))
    direction[arm.names.index(name)] = 1.0
    return ChangeHypothesis(name, (name,), direction)
