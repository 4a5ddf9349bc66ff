"""Identify the Stäubli TX40 and set the result beside FIGAROH's base-parameter fit on the same rows and filter.

    .venv/bin/python experiments/10_tx40_against_figaroh.py [--out out/tx40]

Rows 0-24749 of the published log are fitted, rows 29250-44999 judged; every row counts. Both sides pass a zero-phase
Butterworth filter of order 4 at 10 and at 100 Hz. The error is the RMS residual over the RMS torque, stacked over
joints and per joint; *moving* are samples with |dq| > 0.05 rad/s. FIGAROH is installed in an environment of its own and
runs as a child on the arrays that the project fits; ``experiments/benchmarks/children/figaroh_fit.py`` says what of it
is called. *Plain* is least squares of minimum norm on all columns, with the smoothed sign of the velocity.
"""

from __future__ import annotations

import sys
from pathlib import Path
from time import perf_counter, process_time

import numpy as np
from benchmarks.child import FIGAROH, figaroh_fit, install
from common import CASES, command_line

from gapscope.arm.case import load_case
from gapscope.ident.identification import (
    IdentificationSettings,
    identify,
)
from gapscope.ident.samples import MOVING, FrictionLaw, ModelColumns, Samples
from gapscope.model.conditioning import Segment


def plain(
    columns: ModelColumns, fit: Segment, judged: Segment, band: Samples
) -> tuple[np.ndarray, np.ndarray]:
    """Torque of a plain fit on both segments, in the band [N m]."""
    law = FrictionLaw()
    x, z = (band.filtered(columns.matrix(s.motion, law), s) for s in (fit, judged))
    y = band.filtered(fit.torque, fit)
    parameters = np.linalg.lstsq(x.reshape(-1, x.shape[2]), y.ravel(), rcond=1e-9)[0]
    return x @ parameters, z @ parameters


def relative(left: np.ndarray, torque: np.ndarray, rows: np.ndarray) -> list[float]:
    """RMS residual over RMS torque on the chosen samples: of all joints, and of each."""
    power = [(np.where(rows, x, 0.0) ** 2).sum(axis=0) for x in (left, torque)]
    return [
        float(np.sqrt(power[0].sum() / power[1].sum())),
        *np.sqrt(power[0] / power[1]).tolist(),
    ]


def table(
    name: str,
    fitted: np.ndarray,
    predicted: np.ndarray,
    fit: Segment,
    judged: Segment,
    band: Samples,
) -> None:
    """Print the errors of one model; predictions in the band on every row, (N, 6)."""
    torque = [band.filtered(s.torque, s) for s in (fit, judged)]
    moving = np.abs(judged.motion.dq) > MOVING
    rows = {
        "fitted": (torque[0] - fitted, torque[0], np.full(fitted.shape, True)),
        "judged, moving": (torque[1] - predicted, torque[1], moving),
        "judged": (torque[1] - predicted, torque[1], np.full(moving.shape, True)),
    }
    for label, entry in rows.items():
        total, *joints = relative(*entry)
        print(
            f"  {name:10} {label:27} {total:6.1%}  joints "
            + " ".join(f"{x:6.1%}" for x in joints)
        )


def main() -> None:
    """Run both and print the tables."""
    out = command_line(__doc__, out=Path("out/tx40")).parse_args().out
    out.mkdir(parents=True, exist_ok=True)
    python = install(out / "figaroh")
    if python is None:
        sys.exit(f"this comparison needs {FIGAROH}")
    start = perf_counter()
    case = load_case(CASES / "staubli_tx40.yaml")
    print(f"read in {perf_counter() - start:.2f} s")
    for cutoff in (10.0, 100.0):
        start, work = perf_counter(), process_time()
        result = identify(case, IdentificationSettings(cutoff=cutoff, trim=False))
        seconds, work = perf_counter() - start, process_time() - work
        band = result.samples
        (fit,), (judged,) = band.segments, band.of(case.judged).segments
        other = figaroh_fit(python, case, fit, judged, cutoff, out)
        possible = all(check.consistent for check in result.physical.after)
        print(
            f"\n{cutoff:g} Hz, {result.choice.law}; bodies {'all possible' if possible else 'NOT possible'}"
        )
        print(
            f"  Gapscope: {result.base.count} base parameters, {seconds:.2f} s, {work:.2f} s of processor"
        )
        seconds, work = other["seconds"], other["work"]
        print(
            f"  FIGAROH: {other['count']} base parameters, {seconds:.2f} s, {work:.2f} s of processor"
        )
        table("plain", *plain(result.columns, fit, judged, band), fit, judged, band)
        table("FIGAROH", other["fit"], other["judged"], fit, judged, band)
        ours = (band.filtered(result.predict(s.motion), s) for s in (fit, judged))
        table("Gapscope", *ours, fit, judged, band)


if __name__ == "__main__":
    main()
