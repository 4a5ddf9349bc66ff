"""Diagnose the labelled sample cases, and score verdicts and predictions on recordings that were held out.

The diagnosing commands see the case folders alone; the labels are opened here, afterwards.

    .venv/bin/python experiments/01_sample_cases.py [--data ../shared/data] [--out out/sample_cases]

Prints, per case: verdict, effects with joints beside the labels, the time, and the share of the gap above the floor
that closes on ``recording_d.csv``: sum over joints of before - after, over sum of before - floor, floor of the label.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from time import monotonic

import numpy as np
from common import DATA, command_line

from gapscope.arm.case import load_case
from gapscope.arm.io.formats.table_files import read_csv
from gapscope.arm.io.load_recording import load_recording
from gapscope.arm.root_mean_square import rms
from gapscope.model.conditioning import TORQUE_CUTOFF, TRIM, low_pass, torque_scale

GAPSCOPE = [sys.executable, "-m", "gapscope"]


def nrmse(measured: np.ndarray, predicted: np.ndarray, rate: float) -> np.ndarray:
    """``torque_nrmse`` per joint, both sides filtered at 12 Hz and trimmed by 0.3 s."""
    edge = int(np.ceil(TRIM * rate))
    measured, predicted = (
        low_pass(x, rate, TORQUE_CUTOFF)[edge:-edge] for x in (measured, predicted)
    )
    return rms(measured - predicted) / torque_scale(measured)


def predicted(case: Path, out: Path, model: Path | None) -> np.ndarray:
    """Torque that ``gapscope predict`` writes for the held-out recording, shape (N, n)."""
    file = out / ("corrected.csv" if model else "nominal.csv")
    options = ["--model", str(model)] if model else []
    recording = case / "recording_d.csv"
    command = [
        *GAPSCOPE,
        "predict",
        str(case),
        "--recording",
        str(recording),
        *options,
        "--out",
        str(file),
    ]
    subprocess.run(command, check=True, capture_output=True)
    table = read_csv(file)
    return np.column_stack(
        [table.numbers(name) for name in table.columns if name.startswith("tau")]
    )


def main() -> None:
    """Run all cases and print a table."""
    arguments = command_line(
        __doc__, data=DATA, out=Path("out/sample_cases")
    ).parse_args()
    folder = arguments.data / "sample_cases"
    labels = json.loads((folder / "labels.json").read_text(encoding="utf-8"))
    print(f"{'case':8} {'verdict':13} {'closed':>7} {'time':>6}  found | label")
    for label in labels:
        case, out = folder / label["case"], arguments.out / label["case"]
        start = monotonic()
        subprocess.run(
            [*GAPSCOPE, "diagnose", str(case), "--out", str(out)],
            check=True,
            capture_output=True,
        )
        elapsed = monotonic() - start
        document = json.loads((out / "diagnosis.json").read_text(encoding="utf-8"))
        held_out = load_recording(
            case / "recording_d.csv", load_case(case, read_recordings=False).arm
        )
        before = nrmse(held_out.tau, predicted(case, out, None), held_out.rate)
        after = nrmse(
            held_out.tau, predicted(case, out, out / "corrected.yaml"), held_out.rate
        )
        floor = np.array(label["floor"])
        closed = (
            (before - after).sum() / (before - floor).sum()
            if document["effects"]
            else np.nan
        )
        found, truth = (
            "; ".join(f"{e['effect']} {e['joints']}" for e in x["effects"])
            for x in (document, label)
        )
        verdict = (
            f"{label['case']:8} {document['verdict']:13} {closed:7.1%} {elapsed:5.1f}s"
        )
        print(f"{verdict}  {found or 'none'} | {truth or 'none'}")


if __name__ == "__main__":
    main()
