"""What the pictures of where a gap lies draw, and the words under them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from gapscope.arm.joint_units import joint_unit
from gapscope.diagnosis.document.slide_units import in_text
from gapscope.diagnosis.document.wording import capital, joint_slides
from gapscope.diagnosis.localisation.locate import JointLocalisation
from gapscope.diagnosis.localisation.region import Region
from gapscope.diagnosis.localisation.spectra import DRIVES
from gapscope.diagnosis.result import Diagnosis
from gapscope.reports.diagnosis.encoding import encode


@dataclass(frozen=True)
class Picture:
    """One picture: its place among the curves, and what it shows, in words."""

    index: int
    title: str
    words: str


def pictures(diagnosis: Diagnosis, stage: str) -> list[Picture]:
    """The pictures of one stage, in the order of ``curves``; only kinds that have something to say."""
    return [
        Picture(i, c["title"], c["words"])
        for i, c in enumerate(curves(diagnosis))
        if c["stage"] == stage
    ]


def curves(diagnosis: Diagnosis) -> list[dict[str, Any]]:
    """All pictures as JSON-ready values: of a rule, of intervals of time, of bands and lines of frequency."""
    out = []
    slides = joint_slides(diagnosis.document)
    for located in diagnosis.located:
        place = located.place
        for kind, drawn in (
            ("rule", _rule(place, slides[place.joint - 1])),
            ("time", _time(place)),
            ("frequency", _frequency(place)),
        ):
            if drawn is not None:
                out.append(
                    {
                        "stage": located.stage,
                        "joint": place.joint,
                        "kind": kind,
                        **drawn,
                    }
                )
    return out


def _rule(place: JointLocalisation, slides: bool) -> dict[str, Any] | None:
    profile = place.profile
    if profile is None:
        return None
    words = f"{profile.words}. The shaded part is where the rule holds, the dashed line the floor of a healthy arm."
    return {
        "title": f"J{place.joint}: in which part of the motion",
        "words": capital(in_text(words) if slides else words),
        "axis": f"{profile.symbol} [{joint_unit(profile.unit, slides)}]",
        "x": encode(profile.x),
        "rms": encode(profile.rms),
        "above": profile.above,
        "below": profile.below,
        "floor": place.floor,
    }


def _time(place: JointLocalisation) -> dict[str, Any] | None:
    told = [region for region in place.regions if region.kind == "interval"]
    if not told:
        return None
    name = told[0].detail["recording"]
    level = next(level for level in place.levels if level.recording == name)
    return {
        "title": f"J{place.joint}: when",
        "words": f"{_joined(told)}. The line is the RMS of the gap over a quarter of a second, the steps its level.",
        "axis": f"time in {name} [s]",
        "x": encode(level.t),
        "rms": encode(level.rms),
        "steps": encode(level.steps),
        "floor": place.floor,
    }


def _frequency(place: JointLocalisation) -> dict[str, Any] | None:
    told = [region for region in place.regions if region.kind in ("line", "coherence")]
    if not told:
        return None
    if told[0].kind == "line":
        meaning = "What has a frequency of its own does not follow the motion: vibration, a resonance, a ripple."
    else:
        meaning = (
            "Coherence is the share of the gap that follows a signal: 1 all of it, 0 none. A gap that follows the "
            "torque is a matter of the drive or of the load, one that follows velocity of friction or delay, one that "
            "follows acceleration of inertia."
        )
    found = place.spectra
    return {
        "title": f"J{place.joint}: at which frequencies",
        "words": f"{_joined(told)}. {meaning}",
        "x": encode(found.frequency),
        "gap": encode(found.gap / max(float(found.gap.max()), 1e-300)),
        "coherence": [
            {"name": drive.name, "y": encode(np.clip(row, 0.0, 1.0))}
            for drive, row in zip(DRIVES, found.coherence, strict=True)
        ],
    }


def _joined(regions: list[Region]) -> str:
    return capital("; ".join(region.regime for region in regions))
