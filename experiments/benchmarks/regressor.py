"""Regressor and base parameters of 40 000 states of the KUKA iiwa, against a bare pinocchio loop and FIGAROH.

280 000 rows by 98 columns (70 inertial ones, rotor inertia, viscous and Coulomb friction, offset), the same states for
all, one thread each. *Streamed* never holds the regressor, which is all that base parameters and estimates need. Base
parameters include their expressions in the standard ones; FIGAROH's decomposition includes a copy of the base columns.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial

import numpy as np
import pinocchio as pin
from threadpoolctl import threadpool_limits

from gapscope.arm.motions.motion import Motion
from gapscope.arm.robots import load_nominal_arm
from gapscope.ident.estimators.linear import joint_factors, weighted_factor
from gapscope.ident.model.base_parameters import (
    Factor,
    base_parameters,
    random_states,
)
from gapscope.ident.model.regressor import Regressor
from gapscope.ident.samples import Problem

from .child import FIGAROH, install, run_child, without_meshes
from .measure import Point, Row, Settings, compared

OURS, STREAMED, BARE = "Gapscope", "Gapscope, streamed", "bare pinocchio loop"
STATES, FEW = 40_000, 4_000
CHUNK = 2_000
"""States whose regressor is held at a time."""
Times = tuple[float, float]
"""Of the regressor, and of the base parameters after it [s]."""


def iiwa() -> Regressor:
    """The regressor of the KUKA iiwa with rotors, friction and offsets."""
    sheet = {"coulomb": [1.0] * 7, "viscous": [0.5] * 7}
    return Regressor(load_nominal_arm("kuka_iiwa", sheet=sheet))


def points(settings: Settings) -> list[Point]:
    """Regressor and base parameters at once, because they share the rounds."""
    states = FEW if settings.quick else STATES
    return [Point(f"{states} states", partial(_compared, settings, states))]


def _compared(settings: Settings, states: int) -> list[Row]:
    regressor = iiwa()
    motion = random_states(regressor, np.random.default_rng(0), states)
    loops = {
        OURS: lambda: _ours(regressor, motion),
        STREAMED: lambda: _streamed(regressor, motion),
        BARE: lambda: _bare(regressor, motion),
    }
    figaroh = _figaroh(settings, regressor, motion)
    if figaroh is not None:
        loops[FIGAROH] = figaroh
    with threadpool_limits(1):
        rounds = [
            {name: loop() for name, loop in loops.items()}
            for _ in range(settings.rounds)
        ]
    # the streamed form does not part regressor and base parameters
    alone = {x: [r[x][0] for r in rounds] for x in loops if x != STREAMED}
    both = {x: [sum(r[x]) for r in rounds] for x in loops if x != BARE}
    per = "µs a state", states * 1e-6
    yardstick = FIGAROH if FIGAROH in both else OURS
    what = "regressor and base parameters"
    return [
        *compared(alone, BARE, *per, "regressor"),
        *compared(both, yardstick, *per, what),
    ]


def _bare(regressor: Regressor, motion: Motion) -> Times:
    """Pinocchio's regressor alone, called from a loop that keeps nothing."""
    model, data = regressor.body.model, regressor.body.model.createData()
    start = time.process_time()
    for sample in zip(motion.q, motion.dq, motion.ddq, strict=True):
        pin.computeJointTorqueRegressor(model, data, *sample)
    return time.process_time() - start, 0.0


def _ours(regressor: Regressor, motion: Motion) -> Times:
    start = time.process_time()
    Y = regressor.matrix(motion)
    between = time.process_time()
    base = base_parameters(weighted_factor(_triangles(Y)).triangle, regressor.names)
    base.expressions()
    np.take(Y.reshape(-1, Y.shape[2]), base.kept, axis=1)  # as FIGAROH does
    return between - start, time.process_time() - between


def _streamed(regressor: Regressor, motion: Motion) -> Times:
    start = time.process_time()
    parts = []
    for first in range(0, len(motion.t), CHUNK):
        rows = slice(first, first + CHUNK)
        part = Motion(motion.t[rows], motion.q[rows], motion.dq[rows], motion.ddq[rows])
        parts.append(_triangles(regressor.matrix(part)))
    joints = [Factor.together(own) for own in zip(*parts, strict=True)]
    triangle = weighted_factor(joints).triangle
    base_parameters(triangle, regressor.names).expressions()
    return 0.0, time.process_time() - start


def _triangles(Y: np.ndarray) -> list[Factor]:
    """Triangles of a regressor alone: base parameters need no torque."""
    names = tuple(map(str, range(Y.shape[2])))
    group = np.zeros(len(Y), dtype=int)
    return joint_factors(
        Problem(Y, np.zeros(Y.shape[:2]), names, group, np.ones(len(Y)))
    )


def _figaroh(
    settings: Settings, regressor: Regressor, motion: Motion
) -> Callable[[], Times] | None:
    """A call of FIGAROH in its own environment, which is installed if it is missing; ``None`` if that fails."""
    settings.out.mkdir(parents=True, exist_ok=True)
    python = install(settings.out.parent / "figaroh")
    if python is None:
        return None
    states = settings.out / "states.npz"
    np.savez(states, q=motion.q, dq=motion.dq, ddq=motion.ddq)
    urdf = without_meshes(regressor.arm.urdf, settings.out / "arm.urdf")

    def times() -> Times:
        found = run_child("figaroh_speed.py", urdf, states, python=python)
        return found["regressor"][1], found["base"][1]

    return times
