"""Friction and inertia of one joint against ``mujoco.sysid``, on the same recordings.

Each round draws a motion and noise anew. Gapscope rolls out the closed loop under the known
controller (``gapscope identify --estimator output_error``), or fits the inverse dynamics (``wls``); its time is that of
all of ``identify``. ``mujoco.sysid`` rolls out the recorded torque, in its own environment; its time is that of the
fit. Both free the inertia, two kinds of friction, the centre of mass and an offset. The truth is Coulomb's law, which
neither of the models has exactly.

The joint is a pendulum with friction and a rotor under PD control, simulated apart from the project and from MuJoCo:
I ddq = tau - g (x sin q + z cos q) - b dq - c s - o with s in sgn(dq), set-valued at rest. Each step solves for the
velocity at its end with dry friction implicit, so that the joint sticks exactly: v = S(v0 + h f / I', h c / I'), S the
soft threshold and I' = I + h b. The controller is sampled; it differentiates a noisy encoder backward.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from threadpoolctl import threadpool_limits

from gapscope.arm.case import Case
from gapscope.arm.control import PD
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording
from gapscope.arm.robots import load_nominal_arm
from gapscope.ident.identification import IdentificationSettings, identify

from .child import SYSID, install, run_child
from .measure import Point, Row, Settings, compared

GRAVITY = 9.81
MASS, LEVER, LINK_INERTIA = 2.0, 0.15, 0.02
"""Of the link [kg], its centre of mass from the axis [m], inertia about its centre of mass [kg m^2]."""
TRUTH = {"inertia": 0.12, "viscous": 0.25, "coulomb": 0.4}
"""Inertia about the axis with the rotor [kg m^2], friction [N m s/rad], [N m]."""
OFFSET = 0.1
"""Constant torque that the sensor shows and the joint does not feel [N m]."""
KP, KD = 30.0, 2.0
"""Gains [N m/rad], [N m s/rad]."""
RATE, SUBSTEPS = 1000.0, 20
"""Of controller and recording [Hz], and steps of the simulation in each period."""
ENCODER_NOISE = 1e-5
"""[rad]"""
HARMONICS, BASE_FREQUENCY, REACH = 5, 0.2, 1.2
"""Of the reference, its lowest frequency [Hz], its largest position [rad]."""


class OneJoint(NamedTuple):
    """A recording: time [s], reference and its velocity, measured position [rad], commanded torque [N m]."""

    t: np.ndarray
    q_ref: np.ndarray
    dq_ref: np.ndarray
    q: np.ndarray
    tau: np.ndarray


def recorded(seconds: float, rng: np.random.Generator) -> OneJoint:
    """A recording of a random motion."""
    t = np.arange(int(seconds * RATE)) / RATE
    q_ref, dq_ref = _reference(t, rng)
    noise = ENCODER_NOISE * rng.standard_normal(len(t))
    q, tau = _closed_loop(q_ref, dq_ref, noise)
    return OneJoint(t, q_ref, dq_ref, q, tau)


def _reference(
    t: np.ndarray, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """A Fourier series that begins at rest at zero."""
    w = 2 * np.pi * BASE_FREQUENCY * np.arange(1, HARMONICS + 1)
    sine, cosine = rng.standard_normal((2, HARMONICS)) / np.arange(1, HARMONICS + 1)
    series = np.sin(np.outer(t, w)) @ sine + np.cos(np.outer(t, w)) @ cosine
    # blended in over a second, with its derivative taken of the samples
    ramp = np.clip(t, 0.0, 1.0)
    series *= 3 * ramp**2 - 2 * ramp**3
    series *= REACH / np.abs(series).max()
    return series, np.gradient(series, 1 / RATE)


def _closed_loop(
    q_ref: np.ndarray, dq_ref: np.ndarray, noise: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Measured position and commanded torque at each tick."""
    h = 1 / (RATE * SUBSTEPS)
    inertia = TRUTH["inertia"] + h * TRUTH["viscous"]
    dry = h * TRUTH["coulomb"] / inertia
    q, v, last = 0.0, 0.0, noise[0]
    measured, torque = np.empty_like(q_ref), np.empty_like(q_ref)
    for k in range(len(q_ref)):
        measured[k] = encoder = q + noise[k]
        rate, last = (encoder - last) * RATE, encoder
        torque[k] = KP * (q_ref[k] - encoder) + KD * (dq_ref[k] - rate)
        for _ in range(SUBSTEPS):
            force = torque[k] - MASS * GRAVITY * LEVER * np.sin(q) - OFFSET
            # without dry friction the step would end with this velocity
            free = (TRUTH["inertia"] * v + h * force) / inertia
            v = np.sign(free) * max(abs(free) - dry, 0.0)
            q += h * v
    return measured, torque


URDF = f"""<robot name="pendulum"><link name="base"/>
  <link name="bob"><inertial><origin xyz="0 0 {-LEVER}"/><mass value="{MASS}"/>
    <inertia ixx="{LINK_INERTIA}" iyy="{LINK_INERTIA}" izz="{LINK_INERTIA / 10}" ixy="0" ixz="0" iyz="0"/>
  </inertial></link>
  <joint name="joint" type="revolute"><parent link="base"/><child link="bob"/><axis xyz="0 1 0"/>
    <limit lower="-3" upper="3" effort="100" velocity="20"/></joint></robot>
"""
"""The pendulum without rotor and friction, hanging along -z and turning about y."""


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
    runs = {name: [] for name in fits}
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
    path = settings.out / "pendulum.urdf"
    path.write_text(URDF, encoding="utf-8")
    arm = load_nominal_arm(path, sheet=SHEET)
    fits = {
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
    series = {name: column[:, None] for name, column in joint._asdict().items()}
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
    np.savez(file, **joint._asdict(), **known)
    return run_child("sysid_joint.py", file, kind, python=python)


def _accuracy(runs: list[Mapping[str, Any]]) -> dict[str, float | str]:
    """Median errors in percent, the median half width of the intervals, and how many of them hold the truth."""
    found = {}
    held = 0
    for name, truth in TRUTH.items():
        errors = np.array([abs(run["values"][name] - truth) for run in runs])
        halves = np.array([run["half"][name] for run in runs])
        error, half = (100 * float(np.median(x)) / truth for x in (errors, halves))
        found[f"{name} [%]"] = f"{error:.2g} ± {half:.2g}"
        held += int((errors <= halves).sum())
    return {**found, "hold the truth": f"{held} of {len(TRUTH) * len(runs)}"}
