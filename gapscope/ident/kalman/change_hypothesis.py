"""What may change during a recording: a load on a link, friction of a joint."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from gapscope.arm.errors import InputError
from gapscope.model.change_findings import PAYLOAD


class Parameters(Protocol):
    """Parameters beta = C pi of a problem, such as ``BaseParameters``: names of pi, (p,), and C, (b, p)."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of pi."""

    @property
    def combination(self) -> np.ndarray:
        """The matrix C."""


@dataclass(frozen=True)
class ChangeHypothesis:
    """What may change at once, beta' = beta + D delta.

    Attributes:
        name: in words, such as ``payload``.
        names: of the elements of delta, shape (s,).
        directions: D, shape (b, s).
        beside: N, shape (b, r): what may change at the same moment and is no evidence; none by default.
    """

    name: str
    names: tuple[str, ...]
    directions: np.ndarray
    beside: np.ndarray | None = None

    @property
    def all_directions(self) -> np.ndarray:
        """D and N, shape (b, s + r)."""
        if self.beside is None:
            return self.directions
        return np.concatenate([self.directions, self.beside], axis=1)


def payload_hypothesis(base: Parameters, link: int) -> ChangeHypothesis:
    """A payload picked up or put down: mass [kg] and first moment [kg m] of a link, in the frame of its joint.

    Its inertia about that frame, m c^2, is left out: it is small against rotor and link if the load is near.

    Args:
        base: the base parameters of the problem.
        link: that carries it, counted from 1.
    """
    names = tuple(f"{kind}{link}" for kind in ("m", "mx", "my", "mz"))
    places = [base.names.index(name) for name in names]
    return ChangeHypothesis(PAYLOAD, names, base.combination[:, places])


def friction_hypothesis(base: Parameters, joint: int) -> ChangeHypothesis:
    """Viscous [N m s/rad] and Coulomb friction [N m] of a joint, counted from 1, changed.

    The joint's offset may change beside them: a change of friction has to show in both directions of motion. What shows
    in one is as well an error of the gravity torque there, or friction that differs between the directions.
    """
    both = (f"b{joint}", f"c{joint}")
    names = tuple(name for name in both if name in base.names)
    if not names:
        raise InputError(
            f"the problem has no friction of joint {joint}",
            "give the regressor friction columns",
        )
    places = [base.names.index(name) for name in names]
    offset = [k for k, name in enumerate(base.names) if name == f"o{joint}"]
    return ChangeHypothesis(
        f"friction of joint {joint}",
        names,
        base.combination[:, places],
        beside=base.combination[:, offset],
    )
