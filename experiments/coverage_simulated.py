"""Simulated cases on which intervals are measured, and how one is made; see ``51_interval_coverage.py``.

Arms, motions and laws are those of the blind check's generator, which shares no formula with the catalogue. The errors
of the nominal inertials are set: masses off by up to the width, evenly, centres by up to that share of their distance.
"""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path
from zlib import crc32

from gapscope.arm.io.json_file import write_json
from gapscope.blind_check.generator.arms import USUAL
from gapscope.blind_check.generator.case import make_case, write_case
from gapscope.blind_check.generator.conditions import STRONG, CaseSpec, Conditions

WIDTHS = (0.03, 0.06, 0.1)
"""Largest relative errors of the nominal inertials [1]."""
EFFECTS = (
    ("payload",),
    ("payload", "coulomb_friction"),
    ("payload", "viscous_friction"),
    ("armature", "coulomb_friction"),
    ("armature", "torque_offset"),
    ("viscous_friction", "torque_offset"),
    ("torque_scale",),
    ("encoder_offset",),
    ("actuator_delay",),
    ("actuator_lag",),
    ("parallel_spring",),
    ("joint_elasticity",),
    ("base_tilt",),
    ("link_inertia",),
    ("torque_ripple",),
)
"""Effects of the cases; each set is made once per width."""
RATES = (100, 250)
"""Rates of the recordings [Hz]."""
LONGEST = (8.0, 12.0)
"""Shortest and longest recording [s]."""


@dataclass(frozen=True)
class Simulated:
    """One simulated case.

    Attributes:
        effects: laws at work.
        width: largest relative error of the nominal inertials [1].
        robot: name of the arm.
        severity: RMS of each effect over the floor of a healthy arm, from and to [1].
        rate: of the recordings [Hz].
        number: within the plan, from 0.
    """

    effects: tuple[str, ...]
    width: float
    robot: str
    severity: tuple[float, float]
    rate: int
    number: int

    @property
    def name(self) -> str:
        """Name of the case; it tells nothing of the truth."""
        return f"simulated_{self.number:03d}"


def planned(rounds: int) -> list[Simulated]:
    """All cases: every set of effects at every width, on another arm each time; so many rounds of them."""
    out: list[Simulated] = []
    for turn in range(rounds):
        for k, effects in enumerate(EFFECTS):
            for w, width in enumerate(WIDTHS):
                number = len(out)
                place = k + 2 * w + turn
                out.append(
                    Simulated(
                        effects,
                        width,
                        USUAL[place % len(USUAL)],
                        STRONG[(place // 2) % len(STRONG)],
                        RATES[(k + w) % len(RATES)],
                        number,
                    )
                )
    return out


def make(plan: Simulated, seed: int, out: Path) -> None:
    """Write one case, and its truth beside the cases, unless both are there."""
    truth, folder = out / "truth" / f"{plan.name}.json", out / "cases" / plan.name
    if truth.is_file() and folder.is_dir():
        return
    conditions = Conditions(
        robot=plan.robot,
        inertials_off=plan.width,
        rate=plan.rate,
        duration=LONGEST,
    )
    spec = CaseSpec("single", plan.effects, plan.severity, conditions)
    made = make_case(spec, (seed, crc32(plan.name.encode())))
    aside = out / "cases" / f".{plan.name}"
    shutil.rmtree(aside, ignore_errors=True)
    shutil.rmtree(folder, ignore_errors=True)
    write_case(made, plan.name, False, aside, out / "unseen" / f"{plan.name}.csv")
    truth.parent.mkdir(parents=True, exist_ok=True)
    write_json(made.label, truth)
    aside.rename(folder)
