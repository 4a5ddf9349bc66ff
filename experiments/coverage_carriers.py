"""Cases of real arms on which intervals are measured, and how one is made; see ``51_interval_coverage.py``.

A piece of a carrier gets an effect of known size by the laws of the benchmark of real arms. Its nominal arm is the one
identified on all recordings of the carrier, which stands for the true one as nearly as can be, with its inertials put
off by a known width. What is left of the piece otherwise is what no model of a real arm explains.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import dataclass, replace
from pathlib import Path
from zlib import crc32

import numpy as np
from real_carriers import (
    ARMS,
    cut,
    left,
    load_carrier,
    model_residual,
    prepare_arm,
    windows,
    write_piece,
)
from real_cases import Planned, draw, inject, label
from real_laws import Scene

from gapscope.arm.case import load_case
from gapscope.arm.io.atomic_write import atomic_write
from gapscope.arm.io.json_file import write_json
from gapscope.blind_check.generator.urdf import perturb_inertials, text_of

WIDTHS = (0.03, 0.06, 0.1)
"""Largest relative errors of the nominal inertials, beside those of the identification [1]."""
EFFECTS = (
    "payload",
    "coulomb_friction",
    "viscous_friction",
    "torque_scale",
    "torque_offset",
    "armature",
    "encoder_offset",
    "base_tilt",
    "parallel_spring",
    "actuator_delay",
)
"""Effects of the cases; an arm gets a load at every width, and of the others one after the other."""
SIZES = (4.0, 8.0)
"""RMS of an effect over what a full model leaves [1]."""
OTHERS = 4
"""Cases of an arm beside those with a load."""


@dataclass(frozen=True)
class Carried:
    """One case of a real arm.

    Attributes:
        arm: short name of the carrier.
        effect: the effect that is wanted; if the arm cannot have it in this size, the next one of ``EFFECTS``.
        width: largest relative error of the nominal inertials that is added [1].
        size: RMS of the effect over what a full model leaves [1].
        number: within the arm, from 0.
    """

    arm: str
    effect: str
    width: float
    size: float
    number: int

    @property
    def name(self) -> str:
        """Name of the case; it tells nothing of the truth."""
        return f"real_{self.arm}_{self.number:02d}"


def planned() -> list[Carried]:
    """All cases, arm by arm."""
    out = []
    for place, arm in enumerate(ARMS):
        others = [EFFECTS[1 + (OTHERS * place + k) % 9] for k in range(OTHERS)]
        for number, effect in enumerate((*["payload"] * len(WIDTHS), *others)):
            width = WIDTHS[(number + place) % len(WIDTHS)]
            size = SIZES[(number + place) % len(SIZES)]
            out.append(Carried(arm, effect, width, size, number))
    return out


def make(plan: Carried, seed: int, out: Path) -> None:
    """Write one case, and its truth beside the cases, unless both are there; an arm is identified once."""
    truth, folder = out / "truth" / f"{plan.name}.json", out / "cases" / plan.name
    if truth.is_file() and (folder / "case.yaml").is_file():
        return
    prepare_arm(plan.arm, out)
    carrier = load_carrier(plan.arm, out / "carriers" / plan.arm)
    whole = load_case(out / "carriers" / plan.arm / "whole")
    _, piece = cut(whole, windows(carrier, plan.number, seed)[0])
    rest = np.maximum(model_residual(carrier), left(piece))
    healthy = Scene(piece.recordings[0], piece.arm, piece.arm, rest)
    rng = np.random.default_rng([seed, crc32(plan.name.encode())])
    first = EFFECTS.index(plan.effect)
    names = np.roll(EFFECTS, -first).tolist()
    found = (draw(healthy, name, plan.size, rng) for name in names)
    injection = next(one for one in found if one is not None)
    recording, entries = inject(healthy, [injection])
    recording = replace(recording, name="recording")
    urdf = out / f".{plan.name}.urdf"
    root = ET.parse(healthy.nominal.urdf).getroot()
    perturb_inertials(root, plan.width, rng)
    with atomic_write(urdf) as aside:
        aside.write_text(text_of(root), encoding="utf-8")
    arm = replace(healthy.nominal, urdf=urdf)
    case = replace(piece, name=plan.name, arm=arm, recordings=(recording,))
    write_piece(case, folder)
    urdf.unlink()
    as_planned = Planned(plan.arm, "plain", "single", plan.number, plan.size)
    stated = label(as_planned, healthy, [injection], entries)
    stated["conditions"]["inertials_off"] = plan.width
    truth.parent.mkdir(parents=True, exist_ok=True)
    write_json(stated, truth)
