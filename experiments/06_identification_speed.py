"""Speed of regressor and base parameters against FIGAROH and a bare pinocchio loop, and of streaming long recordings.

First table: samples of random Fourier motions, made on the fly, streamed into triangular factors, each length in a
process of its own; time, peak memory of that process, and the error of the estimate in standard deviations, which is
about 1 in RMS. ``--full`` adds ten million samples.

Second table: 40 000 states of the KUKA iiwa, 280 000 rows by 98 columns (70 inertial ones, rotor inertia, viscous and
Coulomb friction, offset), the same for all, one thread each, in turns; medians over the rounds. FIGAROH is installed in
an environment of its own below the output folder; where that fails, the script says why and continues without it.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from figaroh_environment import FIGAROH, install
from threadpoolctl import threadpool_limits

from gapscope.arm.motions.motion import Motion
from gapscope.arm.motions.trajectory import Fourier, urdf_limits
from gapscope.arm.robots import load_nominal_arm
from gapscope.ident.model.base_parameters import (
    base_parameters,
    random_states,
    structural_base,
)
from gapscope.ident.model.regressor import Regressor
from gapscope.ident.model.tsqr import JointFactors, factored

OURS, STREAMED = "this project", "... streamed"
STATES = 40_000
CHUNK, RATE, NOISE = 5_000, 1e3, 0.5
"""Samples at a time, their rate [Hz], and noise of their torque [N m]."""
LENGTHS = (100_000, 1_000_000)
FULL = 10_000_000


def iiwa() -> Regressor:
    """The regressor that both tables use."""
    return Regressor(
        load_nominal_arm(
            "kuka_iiwa", sheet={"coulomb": [1.0] * 7, "viscous": [0.5] * 7}
        )
    )


def figaroh(python: Path, urdf: Path, states: Path) -> dict[str, Any]:
    """Times of FIGAROH [s], and its number of base parameters."""
    child = Path(__file__).with_name("figaroh_speed.py")
    threads = dict.fromkeys(
        ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"
    )
    command = [str(x) for x in (python, child, urdf, states)]
    done = subprocess.run(
        command,
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, **threads},
    )
    return json.loads(done.stdout.splitlines()[-1])


def clock() -> np.ndarray:
    """Wall time, and processor time of this process [s], shape (2,); the second is the fairer on a busy machine."""
    return np.array([time.perf_counter(), time.process_time()])


def bare_loop(regressor: Regressor, motion: Motion) -> dict[str, Any]:
    """Times of pinocchio's regressor alone, called from a loop that keeps nothing [s]."""
    model, data = regressor.body.model, regressor.body.model.createData()
    start = clock()
    for sample in zip(motion.q, motion.dq, motion.ddq, strict=True):
        pin.computeJointTorqueRegressor(model, data, *sample)
    return {"regressor": clock() - start, "base": np.zeros(2), "count": 0}


def ours(regressor: Regressor, motion: Motion) -> dict[str, Any]:
    """Times of this project [s], and its number of base parameters; base includes R of the data and expressions."""
    ticks = [clock()]
    Y = regressor.matrix(motion)
    ticks.append(clock())
    factors = JointFactors(regressor.support)
    factors.add(Y)
    base = base_parameters(factors.stacked().triangle, regressor.names)
    base.expressions()
    ticks.append(clock())
    np.take(Y.reshape(-1, Y.shape[2]), base.kept, axis=1)
    ticks.append(clock())
    first, second, copy = np.diff(ticks, axis=0)
    return {"regressor": first, "base": second, "copy": copy, "count": base.count}


def streamed(regressor: Regressor, motion: Motion) -> dict[str, Any]:
    """Times of this project without holding the regressor, which is all that base parameters and estimates need."""
    start = clock()
    base = base_parameters(
        factored(regressor, motion).stacked().triangle, regressor.names
    )
    base.expressions()
    return {
        "regressor": np.zeros(2),
        "base": clock() - start,
        "copy": np.zeros(2),
        "count": base.count,
    }


def compare(out: Path, rounds: int) -> None:
    """Print the second table."""
    regressor = iiwa()
    motion = random_states(regressor, np.random.default_rng(0), STATES)
    states = out / "states.npz"
    np.savez(states, q=motion.q, dq=motion.dq, ddq=motion.ddq)
    python = install(out / "figaroh")
    loops = {
        OURS: lambda: ours(regressor, motion),
        STREAMED: lambda: streamed(regressor, motion),
        "bare pinocchio loop": lambda: bare_loop(regressor, motion),
    }
    if python is not None:
        loops[FIGAROH] = lambda: figaroh(python, regressor.arm.urdf, states)
    with threadpool_limits(1):
        results = [
            {name: loop() for name, loop in loops.items()} for _ in range(rounds)
        ]
    print(
        f"\n{STATES * 7} rows by {len(regressor.names)} columns, {rounds} rounds, medians, wall | processor [s]"
    )
    print(f"{'':20}       regressor   base parameters               sum  number")
    for name in loops:
        parts = [
            np.median([r[name][key] for r in results], axis=0)
            for key in ("regressor", "base")
        ]
        columns = " ".join(
            f"{wall:8.3f} | {cpu:6.3f}" for wall, cpu in (*parts, sum(parts))
        )
        print(f"{name:20} {columns} {results[0][name]['count']:7d}")
    wall, cpu = np.median([r[OURS]["copy"] for r in results], axis=0)
    print(
        f"copying out the base columns, which FIGAROH's decomposition includes: another {wall:.3f} | {cpu:.3f} here"
    )
    if python is not None:
        for name, extra, words in (
            (OURS, 0, OURS),
            (OURS, 1, f"{OURS} with that copy"),
            (STREAMED, 0, STREAMED),
        ):
            ratios = [
                whole(r[FIGAROH]) / (whole(r[name]) + extra * r[name]["copy"])
                for r in results
            ]
            wall, cpu = np.median(ratios, axis=0)
            print(
                f"FIGAROH / {words}: {wall:.1f} | {cpu:.1f} (medians of the rounds' ratios)"
            )


def whole(times: dict[str, Any]) -> np.ndarray:
    """Wall and processor time of all [s], shape (2,)."""
    return np.add(times["regressor"], times["base"])


def stream(samples: int) -> dict[str, float]:
    """Stream samples of random motions; time [s], peak memory of the process [MB], and error of the estimate."""
    regressor, rng = iiwa(), np.random.default_rng(0)
    limits = urdf_limits(regressor.body, 6.0)
    base = structural_base(regressor, rng)
    factors, Y = (
        JointFactors(regressor.support),
        np.empty((CHUNK, 7, len(regressor.names))),
    )
    t = np.arange(CHUNK) / RATE
    start, making = clock(), 0.0
    for _ in range(samples // CHUNK):
        tick = clock()[1]
        motion = Fourier.random(rng, limits, duration=CHUNK / RATE, frequency=0.3)
        series = Motion(
            t, motion.position(t), motion.velocity(t), motion.acceleration(t)
        )
        noise = NOISE * rng.standard_normal((CHUNK, 7))
        making += clock()[1] - tick
        regressor.matrix(series, Y)
        factors.add(Y, Y @ regressor.nominal() + noise)
    factor = factors.stacked().select(base.kept)
    wall, cpu = clock() - start
    error = (factor.solve() - base.of(regressor.nominal())) / np.sqrt(
        np.diag(factor.covariance())
    )
    return {
        "samples": samples,
        "time": wall,
        "cpu": cpu,
        "making": making,
        "memory": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
        "error": float(np.sqrt(np.mean(error**2))),
    }


def stream_table(full: bool) -> None:
    """Print the first table."""
    print(f"streaming in chunks of {CHUNK} samples")
    print(
        "   samples  wall [s]  processor [s]  of it making [s]  us/sample  peak [MB]  RMS error [std]"
    )
    for samples in (*LENGTHS, *([FULL] if full else [])):
        command = [sys.executable, __file__, "--stream", str(samples)]
        r = json.loads(
            subprocess.run(command, capture_output=True, text=True, check=True).stdout
        )
        pace = 1e6 * r["cpu"] / samples
        row = f"{r['making']:17.1f} {pace:10.2f} {r['memory']:10.0f} {r['error']:16.2f}"
        print(f"{samples:10d} {r['time']:9.1f} {r['cpu']:14.1f} {row}", flush=True)
    if not full:
        print(
            f"at this pace {FULL:,} samples would take {FULL * pace / 1e6:.0f} s; --full runs them"
        )


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("out/identification_speed"),
        help="folder for FIGAROH and the states",
    )
    parser.add_argument(
        "--rounds", type=int, default=3, help="rounds of the second table"
    )
    parser.add_argument(
        "--full", action="store_true", help="stream ten million samples too"
    )
    parser.add_argument(
        "--stream",
        type=int,
        metavar="N",
        help="only stream N samples, and print the result as JSON",
    )
    options = parser.parse_args()
    if options.stream:
        with threadpool_limits(1):
            print(json.dumps(stream(options.stream)))
        return
    options.out.mkdir(parents=True, exist_ok=True)
    stream_table(
        options.full
    )  # first: a process inherits the peak memory of the one that starts it
    compare(options.out, options.rounds)


if __name__ == "__main__":
    main()
