"""A residual network on what the effects leave: held-out torque error, behaviour outside its training, time per call.

    .venv/bin/python experiments/14_residual_network.py [--out out/residual] [--only NAME]

Needs the extra `learn`. A case is diagnosed on the first recordings, or on the first 60 % of a single one; networks and
baselines are trained on the same data; the error is measured on the rest, which nothing has seen. Both sides are
filtered at 12 Hz. For the Kinova arm the torque from the motor currents is explained by the joint torque sensors, a
scale, friction, rotor and offset fitted by least squares. Printed are Markdown tables; `outside_NAME.html` shows
torque, spread and trust on the way out of the range of training (``residual_outside.py``).
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from residual_outside import report

from gapscope.arm.case import Case, load_case
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.io.load_recording import load_recording
from gapscope.arm.motions.motion import Motion
from gapscope.arm.nominal import smooth_sign
from gapscope.arm.recording import Recording
from gapscope.diagnosis.diagnose import diagnose
from gapscope.diagnosis.gap.torque_gap import torque_scale
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.residual.file import read_residual, write_residual
from gapscope.effects.residual.model import ResidualNetwork
from gapscope.ident.residual.baselines import (
    Baseline,
    gaussian_process,
    gradient_boosting,
)
from gapscope.ident.residual.export import torchscript
from gapscope.ident.residual.fit import Report, fit_residual, rows_of
from gapscope.ident.residual.settings import ResidualSettings
from gapscope.ident.residual.trajectory import Trajectory, chosen_rows, from_segment
from gapscope.ident.signals.conditioning import (
    TORQUE_CUTOFF,
    Segment,
    condition,
    low_pass,
    position_cutoff,
)

CASES = Path(__file__).parent / "cases"
DATA = Path(os.environ.get("GAPSCOPE_DATA", CASES.parents[1] / "../shared/data"))
FITTED = 0.6
"""Share of a single recording that is used to fit."""
Predict = Callable[[Motion, np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Problem:
    """Trajectories to train on and to judge on."""

    name: str
    fit: list[Trajectory]
    judge: list[Trajectory]


def cut(recording: Recording, rows: slice) -> Recording:
    """Some rows of a recording."""
    names = ("t", "q", "tau", "dq", "q_ref", "dq_ref", "tau_sensor", "temperature")
    parts = {
        k: x[rows] for k in names if (x := getattr(recording, k, None)) is not None
    }
    return replace(recording, **parts)


def split(recording: Recording) -> tuple[Recording, Recording]:
    """The first part of a recording, and the rest."""
    edge = int(FITTED * len(recording.t))
    return cut(recording, slice(0, edge)), cut(recording, slice(edge, None))


def diagnosed(
    name: str, case: Case, fit: Sequence[Recording], judge: Sequence[Recording]
) -> Problem:
    """What the effects found on ``fit`` leave of both."""
    result = diagnose(replace(case, recordings=tuple(fit), judged=()))
    print(
        f"{name}: {result.document['verdict']}; {', '.join(e.name for e in result.effects) or 'no effects'}\n"
    )
    corrected, body, cutoff = (
        CorrectedArm(case.arm, result.effects),
        RigidBody(case.arm),
        position_cutoff(tuple(fit)),
    )
    parts = [
        [from_segment(corrected, body, s) for r in rs for s in condition(r, cutoff)]
        for rs in (fit, judge)
    ]
    return Problem(name, *parts)


def current_and_sensor(case: Case) -> Problem:
    """Torque from motor current against the joint torque sensors of the same arm."""
    recording = next(r for r in case.recordings if r.tau_sensor is not None)
    cutoff = position_cutoff((recording,))
    parts = [
        [s for s in condition(r, cutoff) if s.torque is not None]
        for r in split(recording)
    ]
    columns = [[sensor_columns(s) for s in segments] for segments in parts]
    x, y = (
        np.concatenate(z)
        for z in (columns[0], [filtered(s, np.asarray(s.torque)) for s in parts[0]])
    )
    theta = np.stack(
        [np.linalg.lstsq(x[:, j], y[:, j], rcond=None)[0] for j in range(y.shape[1])]
    )
    found = [
        [sensor_trajectory(s, c, theta) for s, c in zip(segments, cs, strict=True)]
        for segments, cs in zip(parts, columns, strict=True)
    ]
    return Problem(case.name, *found)


def sensor_columns(segment: Segment) -> np.ndarray:
    """Sensor, direction, velocity, acceleration and 1, of each joint; (N, n, 5), low-passed."""
    m = segment.motion
    return filtered(
        segment,
        np.stack(
            [
                np.asarray(segment.torque_sensor),
                smooth_sign(m.dq),
                m.dq,
                m.ddq,
                np.ones_like(m.dq),
            ],
            axis=2,
        ),
    )


def filtered(segment: Segment, series: np.ndarray) -> np.ndarray:
    """In the band of the torque gap."""
    return low_pass(series, segment.motion.rate, TORQUE_CUTOFF)


def sensor_trajectory(
    segment: Segment, columns: np.ndarray, theta: np.ndarray
) -> Trajectory:
    """What the fitted columns leave of the torque from current."""
    torque, load = (
        filtered(segment, np.asarray(segment.torque)),
        np.asarray(segment.torque_sensor),
    )
    n, rows = load.shape[1], chosen_rows(segment)
    apart = np.einsum("mjk,ji->mjik", columns[rows], np.eye(n)).reshape(
        len(rows), n, -1
    )
    left = torque - np.einsum("mjk,jk->mj", columns, theta)
    return Trajectory(
        segment.recording, segment.motion, load, left, torque, apart, apart, rows
    )


def sources() -> dict[str, Callable[[], Problem]]:
    """The recordings, by name."""

    def sample() -> Problem:
        case = load_case(DATA / "sample_cases" / "case008" / "case.yaml")
        unseen = load_recording(
            DATA / "sample_cases" / "case008" / "recording_d.csv",
            case.arm,
            case.importing,
        )
        return diagnosed("case008", case, case.recordings, [unseen])

    def ur10() -> Problem:
        case = load_case(CASES / "ur10.yaml", data_root=DATA)
        first, rest = split(case.recordings[0])
        return diagnosed("ur10", case, [first], [rest])

    def tx40() -> Problem:
        case = load_case(CASES / "staubli_tx40.yaml", data_root=DATA)
        return diagnosed("staubli_tx40", case, case.recordings, case.judged)

    def kinova() -> Problem:
        return current_and_sensor(
            load_case(CASES / "kinova_gen3_current.yaml", data_root=DATA)
        )

    return {
        "case008": sample,
        "ur10": ur10,
        "staubli_tx40": tx40,
        "kinova_current": kinova,
    }


def nrmse(problem: Problem, predict: Predict | None) -> np.ndarray:
    """Torque NRMSE of each joint on the held-out trajectories, (n,)."""
    errors, torques = [], []
    for x in problem.judge:
        said = np.zeros_like(x.residual)
        if predict is not None:
            said = low_pass(predict(x.motion, x.load), x.motion.rate, TORQUE_CUTOFF)
        errors.append((x.residual - said)[x.rows])
        torques.append(x.recorded[x.rows])
    return np.asarray(
        np.sqrt((np.concatenate(errors) ** 2).mean(axis=0))
        / torque_scale(np.concatenate(torques))
    )


def of_baseline(
    baseline: Baseline, problem: Problem, settings: ResidualSettings
) -> Predict:
    """A baseline on all samples of a motion, a thousand at a time."""
    inputs = rows_of(problem.fit, settings).inputs

    def predict(motion: Motion, load: np.ndarray) -> np.ndarray:
        step = max(1, int(motion.rate / 50))  # it is low-passed after
        rows = np.arange(0, len(motion.t), step)
        parts = np.array_split(rows, max(1, len(rows) // 1000))
        said = np.concatenate(
            [baseline(inputs.windows(motion, load, part)) for part in parts]
        )
        return np.column_stack([np.interp(motion.t, motion.t[rows], x) for x in said.T])

    return predict


def study(problem: Problem, out: Path) -> list[ResidualNetwork]:
    """Train, compare and print one table; the networks."""
    print(f"### {problem.name}\n")
    seconds = [
        sum(float(x.motion.t[-1] - x.motion.t[0]) for x in xs)
        for xs in (problem.fit, problem.judge)
    ]
    print(
        f"Trained on {seconds[0]:.1f} s, judged on {seconds[1]:.1f} s that nothing has seen.\n"
    )
    n = problem.fit[0].residual.shape[1]
    print(
        "| | "
        + " | ".join(f"J{j + 1}" for j in range(n))
        + " | mean | processor time [s] |"
    )
    print("|---|" + "---|" * (n + 2))
    row("without", nrmse(problem, None), 0.0)
    networks, notes = [], []
    for form in ("mlp", "tcn"):
        start = time.process_time()
        residual, report = fit_residual(problem.fit, ResidualSettings(form=form))
        row(form.upper(), nrmse(problem, residual.torque), time.process_time() - start)
        path = out / f"{problem.name}_{form}.npz"
        write_residual(residual, path)
        networks.append(read_residual(path))
        notes.append(note(form, report, residual, problem))
    plain = ResidualSettings()
    for name, make in (
        ("gradient boosting", gradient_boosting),
        ("Gaussian process", gaussian_process),
    ):
        start = time.process_time()
        baseline = make(rows_of(problem.fit, plain))
        row(
            name,
            nrmse(problem, of_baseline(baseline, problem, plain)),
            time.process_time() - start,
        )
    print("\n" + "\n".join(notes) + "\n", flush=True)
    return networks


def row(name: str, values: np.ndarray, seconds: float) -> None:
    """One row of the table."""
    print(
        f"| {name} | "
        + " | ".join(f"{v:.3f}" for v in values)
        + f" | {values.mean():.3f} | {seconds:.1f} |"
    )


def note(form: str, report: Report, residual: ResidualNetwork, problem: Problem) -> str:
    """What a training says of itself, in a line."""
    moves = [float(m.max(initial=0.0)) for m in report.moves]
    trust = np.mean(
        [residual.predict(x.motion, x.load).trust[x.rows].mean() for x in problem.judge]
    )
    gains = ", ".join(f"{g:.2f}" for g in report.gain)
    return (
        f"- {form.upper()}: gain per joint {gains}; squares of the residual in the span of the physics "
        f"{report.in_target:.1%}; of the output {report.in_output[0]:.1e} before and {report.in_output[1]:.1e} after "
        f"the projection; refitted with the network a parameter of the effects would move by at most {moves[0]:.2f} "
        f"std before and {moves[1]:.1e} after; mean trust on the unseen rows {trust:.2f}."
    )


def latency(residual: ResidualNetwork) -> tuple[float, float]:
    """Median time per call for one sample on one core [us]: by numpy, and by TorchScript."""
    torch.set_num_threads(1)
    inputs = residual.inputs
    windows = np.random.default_rng(0).standard_normal(
        (inputs.n, 1, inputs.taps, inputs.channels)
    )
    module, tensor = torchscript(residual), torch.as_tensor(windows)
    with torch.inference_mode():
        calls = (lambda: residual.of_windows(windows), lambda: module(tensor))
        found = []
        for call in calls:
            times = []
            for _ in range(600):
                start = time.perf_counter()
                call()
                times.append(time.perf_counter() - start)
            found.append(1e6 * float(np.median(times[100:])))
    return found[0], found[1]


def main() -> None:
    """Study each recording."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--out", type=Path, default=Path("out/residual"))
    parser.add_argument("--only", choices=list(sources()))
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    problems = [
        make() for name, make in sources().items() if arguments.only in (None, name)
    ]
    networks = [study(problem, arguments.out) for problem in problems]
    print(
        "### Time per call\n\n| recording | form | numpy [µs] | TorchScript [µs] |\n|---|---|---|---|"
    )
    for problem, forms in zip(problems, networks, strict=True):
        for residual in forms:
            numpy_time, script_time = latency(residual)
            print(
                f"| {problem.name} | {residual.network.form.upper()} | {numpy_time:.0f} | {script_time:.0f} |"
            )
    print()
    for problem, forms in zip(problems, networks, strict=True):
        print(
            report(problem.name, forms, problem.fit[0], arguments.out) + "\n",
            flush=True,
        )


if __name__ == "__main__":
    main()
