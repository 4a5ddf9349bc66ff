"""Samples of random Fourier motions streamed into triangular factors; prints time, memory and error as JSON.

    python experiments/benchmarks/children/stream.py SAMPLES

Motions of the KUKA iiwa are made on the fly, in chunks. ``making`` is the part of the time that goes into them.
"""

from __future__ import annotations

import json
import sys
import time

import numpy as np
from diagnose_case import peak_mb
from threadpoolctl import threadpool_limits

from gapscope.arm.motions.motion import Motion
from gapscope.arm.motions.trajectory import Fourier, urdf_limits
from gapscope.arm.robots import load_nominal_arm
from gapscope.ident.estimators.linear import JointTriangles
from gapscope.ident.model.base_parameters import structural_base
from gapscope.ident.model.linear_problem import Problem
from gapscope.ident.model.regressor import Regressor

CHUNK, RATE, NOISE = 2_000, 1e3, 0.5
"""Samples at a time, their rate [Hz], and noise of their torque [N m]."""
SHEET = {"coulomb": [1.0] * 7, "viscous": [0.5] * 7}
"""Data sheet of the arm: friction [N m], [N m s/rad]."""


def stream(samples: int) -> dict[str, float]:
    """Stream samples: time of the processor [s], how much of it made motions, peak memory [MB], error [std]."""
    regressor = Regressor(load_nominal_arm("kuka_iiwa", sheet=SHEET))
    rng = np.random.default_rng(0)
    base = structural_base(regressor, rng)
    parts: list[JointTriangles] = []
    start, making = time.process_time(), 0.0
    for _ in range(samples // CHUNK):
        tick = time.process_time()
        motion, noise = _chunk(regressor, rng)
        making += time.process_time() - tick
        Y = regressor.matrix(motion)
        tau, group = Y @ regressor.nominal() + noise, np.zeros(CHUNK, dtype=int)
        own = Problem(Y, tau, regressor.names, group, 1 / RATE)
        parts = [JointTriangles.joined([*parts, JointTriangles.of(own)])]
    factor = parts[0].factor().select(base.kept)
    off = factor.solve() - base.of(regressor.nominal())
    variance = factor.rest / factor.freedom
    error = off / np.sqrt(variance * np.diag(factor.inverse_gram()))
    return {
        "cpu": time.process_time() - start,
        "making": making,
        "memory": peak_mb(),
        "error": float(np.sqrt(np.mean(error**2))),
    }


def _chunk(regressor: Regressor, rng: np.random.Generator) -> tuple[Motion, np.ndarray]:
    """A random motion, and noise of the torque."""
    limits = urdf_limits(regressor.body, 6.0)
    t = np.arange(CHUNK) / RATE
    path = Fourier.random(rng, limits, duration=CHUNK / RATE, frequency=0.3)
    motion = Motion(t, path.position(t), path.velocity(t), path.acceleration(t))
    return motion, NOISE * rng.standard_normal((CHUNK, 7))


if __name__ == "__main__":
    with threadpool_limits(1):
        print(json.dumps(stream(int(sys.argv[1]))))
