"""Friction and inertia of one joint against ``mujoco.sysid``, on the same recordings.

Each round draws a motion and noise anew (``one_joint.py``). Gapscope rolls out the closed loop under the known
controller (``gapscope identify --estimator output_error``), or fits the inverse dynamics (``wls``); its time is that of
all of ``identify``. ``mujoco.sysid`` rolls out the recorded torque, in its own environment; its time is that of the
fit. Both free the inertia, two kinds of friction, the centre of mass and an offset. The truth is Coulomb's law, which
neither of the models has exactly.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from experiments.benchmarks.child import run_child
from experiments.benchmarks.foreign import SYSID, install
from experiments.benchmarks.one_joint import (
    KD,
    KP,
    LEVER,
    LINK_INERTIA,
    MASS,
    RATE,
    TRUTH,
    OneJoint,
    recorded,
    write_urdf,
)
from experiments.benchmarks.point import Point, Settings
from experiments.benchmarks.row import Row, compared
from gapscope.arm.case import Case
from gapscope.arm.control.pd import PD
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording
from gapscope.arm.robots import load_nominal_arm
from gapscope.ident.identification import IdentificationSettings, identify

SECONDS, SHORT = 10.0, 6.0
"""Of a recording [s]."""
SHEET = {"armature": [0.02], "viscous": [0.1], "coulomb": [0.1]}
"""What the nominal arm believes; ``mujoco.sysid`` starts from the same."""
OURS = ("output_error", "wls")
THEIRS = ("default", "stiff")
"""Settings of MuJoCo's dry friction."""
PARAMETERS = {"Iyy1 + I1": "inertia", "b1": "viscous", "c1": "coulomb"}
"""Base parameters of the arm that are compared."""

Fit = Callable[[OneJoint], Mapping[str, Any]]
"""Processor time [s], values, and half widths of 95 % intervals."""


def points(settings: Settings) -> list[Point]:
    """All tools in turns."""
    return [Point("one joint", partial(_compared, settings))]


def _compared(settings: Settings) -> list[Row]:
    fits = _fits(settings)
    seconds = SHORT if settings.quick else SECONDS
    runs: dict[str, list[Mapping[str, Any]]] = {name: [] for name in fits}
    with threadpool_limits(1):
        for seed in range(settings.rounds):
            recording = recorded(seconds, np.random.default_rng(seed))
            for name, fit in fits.items():
                runs[name].append(fit(recording))
    times = {name: [run["cpu"] for run in found] for name, found in runs.items()}
    rows = compared(times, list(fits)[-1])
    return [
        replace(row, details=_accuracy(found))
        for row, found in zip(rows, runs.values(), strict=True)
    ]


def _fits(settings: Settings) -> dict[str, Fit]:
    """What is compared; ``mujoco.sysid`` last, as far as it can be installed."""
    settings.out.mkdir(parents=True, exist_ok=True)
    arm = load_nominal_arm(write_urdf(settings.out / "pendulum.urdf"), sheet=SHEET)
    fits: dict[str, Fit] = {
        f"Gapscope, {estimator}": partial(_ours, arm, estimator) for estimator in OURS
    }
    python = install(settings.out.parent / "sysid", SYSID)
    if python is not None:
        file = settings.out / "recording.npz"
        fits |= {
            f"mujoco.sysid, {kind} friction": partial(_theirs, python, file, kind)
            for kind in THEIRS
        }
    return fits


def _ours(arm: NominalArm, estimator: str, joint: OneJoint) -> Mapping[str, Any]:
    series = {name: column[:, None] for name, column in joint.columns.items()}
    t = series.pop("t")[:, 0]
    gains = {"kp": np.array([KP]), "kd": np.array([KD])}
    controller = PD(rate=RATE, feedforward="none", **gains)
    recordings = (Recording("recording", t, **series),)
    case = Case("pendulum", Path(), arm, recordings, controller=controller)
    start = time.process_time()
    found = identify(case, IdentificationSettings(estimator=estimator))
    cpu = time.process_time() - start
    _, upper = found.uncertainty.interval(found.estimate.value)
    values, halves = {}, {}
    for k, expression in enumerate(found.base.expressions()):
        name = PARAMETERS.get(str(expression))
        if name is not None:
            values[name] = float(found.estimate.value[k])
            halves[name] = float(upper[k]) - values[name]
    return {"cpu": cpu, "values": values, "half": halves}


def _theirs(python: Path, file: Path, kind: str, joint: OneJoint) -> Mapping[str, Any]:
    known = {"mass": MASS, "lever": LEVER, "across": LINK_INERTIA}
    np.savez(file, **joint.columns, **known)
    return run_child("sysid_joint.py", file, kind, python=python)


def _accuracy(runs: list[Mapping[str, Any]]) -> dict[str, float | str]:
    """Median errors in percent, the median half width of the intervals, and how many of them hold the truth."""
    found: dict[str, float | str] = {}
    held = 0
    for name, truth in TRUTH.items():
        errors = np.array([abs(run["values"][name] - truth) for run in runs])
        halves = np.array([run["half"][name] for run in runs])
        error, half = (100 * float(np.median(x)) / truth for x in (errors, halves))
        found[f"{name} [%]"] = f"{error:.2g} ± {half:.2g}"
        held += int((errors <= halves).sum())
    return {**found, "hold the truth": f"{held} of {len(TRUTH) * len(runs)}"}
