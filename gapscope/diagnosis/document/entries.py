"""Small parts of ``diagnosis.json`` that several sections share."""

from __future__ import annotations

from typing import Any

import numpy as np

from gapscope.diagnosis.agreement.agreement import Agreement
from gapscope.diagnosis.agreement.agreement_json import states
from gapscope.diagnosis.localisation.region import Region


def numbers(values: np.ndarray) -> list[float]:
    """One number per joint."""
    return [float(value) for value in values]


def known_numbers(values: np.ndarray | None) -> list[float] | None:
    """One number per joint, or ``None`` if they are not known."""
    return None if values is None else numbers(values)


def region_entry(region: Region) -> dict[str, Any]:
    """A region as the document holds it."""
    return {
        "joint": region.joint,
        "kind": region.kind,
        "regime": region.regime,
        "share": region.share,
        "coverage": region.coverage,
        "enrichment": region.enrichment,
        **region.detail,
    }


def states_entry(found: Agreement | None) -> dict[str, Any]:
    """``states`` of the document: whether the recordings share a state; nothing if that was not asked."""
    return {} if found is None else {"states": states(found)}
