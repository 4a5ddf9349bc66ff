"""Identification against FIGAROH on a real arm.

The Stäubli TX40, rows and filter of ``experiments/10_tx40_against_figaroh.py``: time of all of ``gapscope identify``
and of FIGAROH's regressor and base-parameter fit, and the residual over the torque on held-out rows (RMS, all joints,
where they move).
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from gapscope.arm.case import Case, load_case
from gapscope.ident.identification import IdentificationSettings, identify
from gapscope.ident.samples import MOVING, Band
from gapscope.model.conditioning import Segment

from .cases import CASES, data_folder
from .child import FIGAROH, figaroh_fit, install
from .measure import Point, Row, Settings, compared

CUTOFF = 10.0
"""Of the filter on both sides [Hz]."""
TX40 = "staubli_tx40"
OURS, BARE = "gapscope identify", "bare pinocchio loop"


def points(settings: Settings) -> list[Point]:
    """The real arm if its recording is there."""
    if data_folder() is None:
        return []
    return [Point("TX40", partial(_against_figaroh, settings))]


def _against_figaroh(settings: Settings) -> list[Row]:
    case = load_case(CASES / f"{TX40}.yaml")
    band = Band(CUTOFF, trim=False)
    (fit,), (judged,) = band.segments(case.recordings), band.segments(case.judged)
    fits: dict[str, Callable[[], tuple[float, np.ndarray]]] = {
        OURS: lambda: _ours(case, judged, band)
    }
    python = install(settings.out.parent / "figaroh")
    if python is not None:
        fits[FIGAROH] = lambda: _theirs(python, case, fit, judged, settings.out)
    runs: dict[str, list[tuple[float, np.ndarray]]] = {name: [] for name in fits}
    with threadpool_limits(1):
        for _ in range(settings.rounds):
            for name, run in fits.items():
                runs[name].append(run())
    rows = compared(
        {name: [seconds for seconds, _ in found] for name, found in runs.items()},
        list(fits)[-1],
        what="TX40",
    )
    errors = (_error(found[0][1], judged, band) for found in runs.values())
    return [
        replace(row, details={"held-out residual over torque [%]": 100 * error})
        for row, error in zip(rows, errors, strict=True)
    ]


def _ours(case: Case, judged: Segment, band: Band) -> tuple[float, np.ndarray]:
    """Processor time [s], and the torque predicted on the held-out rows, in the band [N m]."""
    start = time.process_time()
    found = identify(case, IdentificationSettings(cutoff=CUTOFF, trim=False))
    cpu = time.process_time() - start
    return cpu, band.filtered(found.predict(judged.motion), judged)


def _theirs(
    python: Path, case: Case, fit: Segment, judged: Segment, out: Path
) -> tuple[float, np.ndarray]:
    found = figaroh_fit(python, case, fit, judged, CUTOFF, out)
    return found["work"], found["judged"]


def _error(predicted: np.ndarray, judged: Segment, band: Band) -> float:
    """RMS residual over RMS torque of the samples whose joint moves."""
    torque = band.filtered(np.asarray(judged.torque), judged)
    moving = np.abs(judged.motion.dq) > MOVING
    residual = (torque - predicted)[moving]
    return float(np.sqrt((residual**2).sum() / (torque[moving] ** 2).sum()))
