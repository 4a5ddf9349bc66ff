"""Identify the Stäubli TX40 and set the result beside FIGAROH's base-parameter fit on the same rows and filter.

    .venv/bin/python experiments/10_tx40_against_figaroh.py [--out out/tx40]

Rows 0-24749 of the published log are fitted, rows 29250-44999 judged; every row counts, and once more without 0.3 s at
both ends, where the filter settles. Both sides pass a zero-phase Butterworth filter of order 4 at 10 and at 100 Hz. The
error is the RMS residual over the RMS torque, stacked over joints and per joint; *moving* are samples with |dq| > 0.05
rad/s. FIGAROH is installed in an environment of its own and runs as a child on the arrays that the project fits;
``experiments/benchmarks/children/figaroh_fit.py`` says what of it is called. *Plain* is least squares of minimum norm
on all columns, with the smoothed sign of the velocity; *sharp* has its sign, as FIGAROH, and *unfiltered* columns that
pass no filter.

Then the residual on joint rows of the project's fit is explained by one effect after another, fitted to the residual
of the fitted rows, and judged on the residual of the others.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from time import perf_counter, process_time

import numpy as np
from benchmarks.child import FIGAROH, figaroh_fit, install

from gapscope.arm.case import load_case
from gapscope.arm.nominal import smooth_sign
from gapscope.ident.examination import MOVING
from gapscope.ident.identification import (
    Identification,
    IdentificationSettings,
    identify,
)
from gapscope.ident.model.linear_problem import FrictionLaw, ModelColumns
from gapscope.ident.samples import Band
from gapscope.model.conditioning import TRIM, Segment

HERE = Path(__file__).parent
ORDERS = (1, 2)
"""Cycles of ripple per turn of a motor."""


class SharpLaw(FrictionLaw):
    """Coulomb friction by the sign of the velocity, which flips with the encoder's last digit at rest."""

    def columns(self, position: np.ndarray, velocity: np.ndarray) -> list[np.ndarray]:
        """What c multiplies [1], (N, k)."""
        return [np.sign(velocity)]


def plain(
    columns: ModelColumns,
    fit: Segment,
    judged: Segment,
    band: Band,
    law: FrictionLaw,
    filtered: bool = True,
) -> tuple[np.ndarray, np.ndarray]:
    """Torque of a plain fit on both segments, in the band [N m]."""
    x, z = (columns.matrix(s.motion, law) for s in (fit, judged))
    if filtered:
        x, z = band.filtered(x, fit), band.filtered(z, judged)
    y = band.filtered(np.asarray(fit.torque), fit)
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
    band: Band,
) -> None:
    """Print the errors of one model; predictions in the band on every row, (N, 6)."""
    torque = [band.filtered(np.asarray(s.torque), s) for s in (fit, judged)]
    moving = np.abs(judged.motion.dq) > MOVING
    inner = np.zeros(moving.shape, dtype=bool)
    inner[judged.inner] = True
    rows = {
        "fitted": (torque[0] - fitted, torque[0], np.full(fitted.shape, True)),
        "judged, moving": (torque[1] - predicted, torque[1], moving),
        "judged": (torque[1] - predicted, torque[1], np.full(moving.shape, True)),
        f"judged, moving, less {TRIM} s": (
            torque[1] - predicted,
            torque[1],
            moving & inner,
        ),
        f"judged, less {TRIM} s": (torque[1] - predicted, torque[1], inner),
    }
    for label, entry in rows.items():
        total, *joints = relative(*entry)
        print(
            f"  {name:10} {label:27} {total:6.1%}  joints "
            + " ".join(f"{x:6.1%}" for x in joints)
        )


def left_over(
    result: Identification, fit: Segment, judged: Segment, band: Band
) -> None:
    """Print which effect explains how much of the residual, joint by joint, and where it stands."""
    left, rows = [], []
    for segment in (fit, judged):
        predicted = result.predict(segment.motion)
        rate, after = (
            band.filtered(x, segment) for x in _derivatives(predicted, segment)
        )
        left.append(band.filtered(np.asarray(segment.torque) - predicted, segment))
        rows.append(
            _effects(result, segment, band, predicted)
            | {"delay": [rate], "elasticity": [after]}
        )
    rest = np.abs(judged.motion.dq) <= MOVING
    power = (left[1] ** 2).sum()
    print(
        f"  of what is left on the judged rows, {(np.where(rest, left[1], 0) ** 2).sum() / power:.0%} at rest,"
    )
    print(
        f"  {(left[1][:, 4:] ** 2).sum() / power:.0%} on joints 5 and 6, whose residuals are correlated by "
        f"{np.corrcoef(left[1][:, 4], left[1][:, 5])[0, 1]:+.2f}"
    )
    for name in rows[0]:
        shares = []
        for j in range(6):
            x, z = (np.column_stack([column[:, j] for column in r[name]]) for r in rows)
            solution = np.linalg.lstsq(x, left[0][:, j], rcond=1e-9)[0]
            before = [(e[:, j] ** 2).sum() for e in left]
            after = [
                ((e[:, j] - c @ solution) ** 2).sum()
                for e, c in zip(left, (x, z), strict=True)
            ]
            shares.append([1 - a / b for a, b in zip(after, before, strict=True)])
        fitted, unseen = (" ".join(f"{s[k]:6.1%}" for s in shares) for k in range(2))
        print(f"    {name:20} explains of the fitted {fitted}   of the judged {unseen}")


def _derivatives(torque: np.ndarray, segment: Segment) -> tuple[np.ndarray, np.ndarray]:
    rate = np.gradient(torque, 1 / segment.motion.rate, axis=0)
    return rate, np.gradient(rate, 1 / segment.motion.rate, axis=0)


def _effects(
    result: Identification, segment: Segment, band: Band, predicted: np.ndarray
) -> dict[str, list[np.ndarray]]:
    """Columns of effects that the model lacks, (N, 6) each."""
    motion = segment.motion
    sign = smooth_sign(motion.dq)
    ratios = np.abs(np.diag(result.case.importing.transmission))  # type: ignore[union-attr]
    angles = [k * ratios * motion.q for k in ORDERS]
    found = {
        "load friction": [np.abs(predicted) * sign],
        "asymmetric friction": [np.abs(sign)],
        "friction, v |v|": [motion.dq * np.abs(motion.dq)],
        "ripple of the motor": [f(angle) for angle in angles for f in (np.sin, np.cos)],
    }
    return {
        name: [band.filtered(x, segment) for x in columns]
        for name, columns in found.items()
    }


def main() -> None:
    """Run both and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--out", type=Path, default=Path("out/tx40"))
    out = parser.parse_args().out
    out.mkdir(parents=True, exist_ok=True)
    python = install(out / "figaroh")
    if python is None:
        sys.exit(f"this comparison needs {FIGAROH}")
    start = perf_counter()
    case = load_case(HERE / "cases" / "staubli_tx40.yaml")
    print(f"read in {perf_counter() - start:.2f} s")
    for cutoff in (10.0, 100.0):
        band = Band(cutoff, trim=False)
        start, work = perf_counter(), process_time()
        result = identify(case, IdentificationSettings(cutoff=cutoff, trim=False))
        seconds, work = perf_counter() - start, process_time() - work
        (fit,), (judged,) = band.segments(case.recordings), band.segments(case.judged)
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
        for name, law, filtered in (
            ("plain", FrictionLaw(), True),
            ("sharp", SharpLaw(), True),
            ("unfiltered", FrictionLaw(), False),
        ):
            table(
                name,
                *plain(result.columns, fit, judged, band, law, filtered),
                fit,
                judged,
                band,
            )
        table("FIGAROH", other["fit"], other["judged"], fit, judged, band)
        ours = (band.filtered(result.predict(s.motion), s) for s in (fit, judged))
        table("Gapscope", *ours, fit, judged, band)
        left_over(result, fit, judged, band)


if __name__ == "__main__":
    main()
