"""How models are evaluated: motions, disturbances, engines and the loop."""

from __future__ import annotations

from dataclasses import dataclass, field

from gapscope.agents.disturbances import NAMES as DISTURBANCES
from gapscope.agents.gains import Tuning
from gapscope.arm.errors import InputError
from gapscope.arm.nearest_name import check_known
from gapscope.envs.arguments import positive
from gapscope.envs.engines import check_engine, default_engine

LAWS = ("feedforward", "computed")
"""``gapscope.agents.controllers.Feedforward`` and ``gapscope.agents.controllers.ComputedTorque``."""
MOTIONS = ("fourier", "pick", "place", "weld_seam")
"""Motions by default."""


@dataclass(frozen=True)
class EvaluationPlan:
    """How models are evaluated.

    Attributes:
        motions, disturbances: names; each model does each of them.
        seeds: of the motions.
        engines: that simulate the arm.
        duration: of a motion [s].
        tuning: bandwidth and damping of the loop, on the nominal arm's inertia.
        law: one of ``LAWS``.

    Raises:
        InputError: a name that is not known, or nothing to do.
    """

    motions: tuple[str, ...] = MOTIONS
    disturbances: tuple[str, ...] = ("none", "push")
    seeds: tuple[int, ...] = (0, 1, 2)
    engines: tuple[str, ...] = field(default_factory=lambda: (default_engine(),))
    duration: float = 4.0
    tuning: Tuning = Tuning()  # noqa: RUF009 (it is frozen)
    law: str = "feedforward"

    def __post_init__(self) -> None:
        """Check names and numbers."""
        check_known("law", self.law, LAWS, where="law")
        positive("duration", self.duration, "s")
        for name in ("motions", "disturbances", "seeds", "engines"):
            if not getattr(self, name):
                raise InputError("expected at least one", where=name)
        for engine in self.engines:
            check_engine(engine)
        for name in self.disturbances:
            check_known("disturbance", name, DISTURBANCES, where="disturbances")
