"""What a set of blind cases holds, and its allocation to single cases."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from gapscope.arm.errors import InputError
from gapscope.arm.nearest_name import nearest
from gapscope.blind_check.generator.arms import ROBOTS, USUAL
from gapscope.blind_check.generator.conditions import (
    STRONG,
    WEAK,
    CaseSpec,
    allocate,
    draw_conditions,
)
from gapscope.blind_check.generator.laws import BEYOND, INSIDE, LAWS, SETUP
from gapscope.blind_check.own_laws import enter_own_laws, own_names

TOGETHER = (
    {
        "coulomb_friction",
        "stribeck_friction",
        "saturating_friction",
        "load_friction",
        "friction_drift",
    },
    {"viscous_friction", "saturating_friction"},
    {"actuator_lag", "actuator_delay"},
    {"payload", "link_inertia"},
    {"joint_elasticity", "backlash"},
    {"external_force", "friction_drift"},
    {"torque_saturation", "torque_scale"},
)
"""Effects of which no two are put into one case: they hide each other by their nature."""
ALONE = {"encoder_quantization", *SETUP}
"""Effects that only single cases have."""


@dataclass(frozen=True)
class BlindPlan:
    """A set of blind cases.

    Attributes:
        singles, pairs, triples, outside, healthy: numbers of cases of each kind, at a severity of 3 to 20.
        ladder: number of single effects at a severity of 0.5 to 3.
        effects: effects of singles, pairs, triples and the ladder; empty: all of the package. A case with an effect of
            a user, whose own law generates it, is of the kind ``recovery``.
        robots: arms.
        inertials_off: share of the cases whose nominal inertials are 1 to 10 % off [1].
        noisy: share with three times the encoder noise [1].
        bare: share whose controller is unknown [1].
        duration: shortest and longest recording [s].
    """

    singles: int = 100
    pairs: int = 60
    triples: int = 30
    outside: int = 30
    healthy: int = 80
    ladder: int = 60
    effects: tuple[str, ...] = ()
    robots: tuple[str, ...] = USUAL
    inertials_off: float = 0.4
    noisy: float = 0.15
    bare: float = 1 / 3
    duration: tuple[float, float] = (8.0, 14.0)

    def __post_init__(self) -> None:
        """Check the names and the numbers.

        Raises:
            InputError: an effect or a robot is unknown, or a number cannot be.
        """
        _check_names("effects", self.effects, (*INSIDE, *SETUP, *own_names()))
        enter_own_laws(self.effects)
        _check_names("robots", self.robots, ROBOTS)
        for field in COUNTS:
            count = getattr(self, field)
            if not isinstance(count, int) or count < 0:
                raise InputError(
                    f"{count!r} is not a number of cases",
                    where=f"plan, {field}",
                )
        if not 3.0 <= self.duration[0] <= self.duration[1]:
            raise InputError(
                f"{self.duration} s",
                "give the shortest, at least 3 s, and the longest",
                where="duration",
            )

    @property
    def size(self) -> int:
        """Number of cases."""
        return sum(getattr(self, field) for field in COUNTS)

    def plain(self) -> dict[str, Any]:
        """The plan as JSON or YAML data."""
        return {
            key: list(value) if isinstance(value, tuple) else value
            for key, value in asdict(self).items()
        }


COUNTS = ("singles", "pairs", "triples", "outside", "healthy", "ladder")
"""Fields of a plan that count cases."""


def _check_names(field: str, names: tuple[str, ...], known: Sequence[str]) -> None:
    """Check that all names are known; raises ``InputError``."""
    for name in names:
        if name not in known:
            raise InputError(
                f"unknown {name!r}",
                f"{nearest(name, known)}use {', '.join(known)}; an effect of your own needs --effects-from",
                where=f"plan, {field}",
            )


def read_plan(path: Path) -> BlindPlan:
    """A plan from a YAML file whose keys are the fields of ``BlindPlan``.

    Raises:
        InputError: the file cannot be read, or a key or value is wrong.
    """
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise InputError(
            f"cannot be read as YAML ({error})",
            "give a YAML file with a plan",
            file=path,
        ) from None
    known = [field.name for field in fields(BlindPlan)]
    remedy = f"known keys: {', '.join(known)}"
    if not isinstance(content, dict):
        raise InputError("is not a mapping", remedy, file=path)
    for key in content:
        if key not in known:
            raise InputError(f"unknown key {key!r}", remedy, file=path)
    values: dict[str, Any] = {
        key: tuple(value) if isinstance(value, list) else value
        for key, value in content.items()
    }
    return BlindPlan(**values)


def allocate_cases(plan: BlindPlan, seed: int) -> list[CaseSpec]:
    """The cases of a plan, in random order; the same seed gives the same cases."""
    rng = np.random.default_rng([seed, 1])
    effects = plan.effects or (*INSIDE, *SETUP)
    mixable = [name for name in effects if name not in (*ALONE, *SETUP, *BEYOND)]
    graded = [
        name
        for name in effects
        if LAWS[name].measure != "none" and not LAWS[name].outside
    ]
    # kind and laws of each case; drawn in this order, so that a seed gives the same set
    deck: list[tuple[str, tuple[str, ...]]] = []
    deck += [("single", (name,)) for name in _cycled(effects, plan.singles, rng)]
    deck += [("ladder", (name,)) for name in _cycled(graded, plan.ladder, rng)]
    deck += [("outside", (name,)) for name in _cycled(BEYOND, plan.outside, rng)]
    deck += [("pair", _mixed(mixable, 2, rng)) for _ in range(plan.pairs)]
    deck += [("triple", _mixed(mixable, 3, rng)) for _ in range(plan.triples)]
    deck += [("healthy", ())] * plan.healthy
    conditions = draw_conditions(rng, len(deck), plan.plain())
    strong = allocate(rng, len(deck), STRONG, [1.0] * len(STRONG))
    weak = allocate(rng, len(deck), WEAK, [1.0] * len(WEAK))
    specs = []
    for k, (kind, laws) in enumerate(deck):
        severity = weak[k] if kind == "ladder" else strong[k]
        if any(LAWS[name].recovery for name in laws):
            kind = "recovery"
        wanted = None if kind == "healthy" else severity
        specs.append(CaseSpec(kind, laws, wanted, conditions[k]))
    return [specs[k] for k in rng.permutation(len(specs))]


def _cycled(
    names: tuple[str, ...] | list[str], count: int, rng: np.random.Generator
) -> list[str]:
    """``count`` names, each as often as the others but for one."""
    if not names:
        return []
    rounds = [rng.permutation(list(names)) for _ in range(count // len(names) + 1)]
    return [str(name) for name in np.concatenate(rounds)[:count]]


def _mixed(names: list[str], count: int, rng: np.random.Generator) -> tuple[str, ...]:
    """Different effects that do not hide each other by their nature."""
    size = min(count, len(names))
    for _ in range(1000):
        drawn = [str(name) for name in rng.choice(names, size, replace=False)]
        hidden = any(len(group & set(drawn)) > 1 for group in TOGETHER)
        if len(drawn) == count and not hidden:
            return tuple(sorted(drawn))
    raise InputError(
        f"no {count} of {', '.join(names)} can be told apart in one case",
        "name more effects",
        where="plan",
    )
