"""Synthetic diagnoses: two effects on seven joints, no gap, and a gap that nothing explains."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np

from gapscope.diagnosis.result import Diagnosis, Signature, Spectrum, Trace
from gapscope.effects.applied import AppliedEffect

JOINTS = [f"panda_joint{number}" for number in range(1, 8)]
BEFORE = [0.062, 0.181, 0.094, 0.412, 0.655, 0.071, 0.058]
AFTER = [0.031, 0.029, 0.041, 0.052, 0.066, 0.043, 0.055]
FLOOR = [0.028, 0.024, 0.035, 0.038, 0.047, 0.041, 0.052]
CLOSED = 1 - 0.052 / 1.268
"""By hand: 0.052 are left above the floor of 1.268 in the sum over the joints."""


def two_effects() -> dict[str, Any]:
    """A delay on joints 4 and 5 and a payload."""
    before = {"torque_nrmse": list(BEFORE), "floor": list(FLOOR)}
    before["replay_rmse"] = [0.004, 0.011, 0.005, 0.021, 0.034, 0.003, 0.002]
    after: dict[str, Any] = {"torque_nrmse": list(AFTER)}
    after["replay_rmse"] = [0.001, 0.001, 0.001, 0.002, 0.0025, 0.001, None]
    reversals, band = "acceleration reversals above 2 Hz", "2 to 5 Hz"
    stretched = "arm stretched out, |gravity torque| above 40 N m"
    bends = "the phase grows linearly with frequency, a lag bends it"
    elsewhere = "explains joint 2, but not joints 4 and 6 at the same time"
    dear = "gains less than its parameter costs"
    return {
        "schema": 1,
        "case": "case005",
        "verdict": "effects_found",
        "gap": {"before": before, "after": after},
        "effects": [_delay(), _payload()],
        "possible": [],
        "closed": CLOSED,
        "unexplained": {"share": 1.0 - CLOSED, "above_floor": False, "where": []},
        "next_recording": "a chirp on joints 4 and 5 up to 15 Hz, amplitude 0.02 rad, to settle delay against lag",
        "arm": {"robot": "Franka Panda", "joints": list(JOINTS)},
        "recordings": [
            _recording("excitation_a.csv", 24.0, "fit"),
            _recording("excitation_b.csv", 18.0, "judge"),
        ],
        "conditioning": {
            **{"rate": 500.0, "position_cutoff": 15.0, "torque_cutoff": 12.0},
            "how": "zero-phase Butterworth",
        },
        "warnings": [
            "excitation_a.csv: 3 samples repeat their time stamp; they were dropped"
        ],
        "where": [
            _region(4, reversals, 0.70, 0.21, "regime"),
            _region(5, band, 0.81, 0.25, "frequency"),
            _region(2, stretched, 0.52, 0.3, "position"),
        ],
        "considered": [
            _considered("actuator_lag", [4, 5], -14.2, 0.61, bends),
            _considered("link_inertia", [], -31.0, 0.22, elsewhere),
            _considered("armature", [4], -88.5, 0.09, dear),
        ],
        "judged_on": "excitation_b.csv, which was set aside",
    }


def no_gap() -> dict[str, Any]:
    """A healthy arm."""
    document = two_effects()
    document |= {"case": "healthy", "verdict": "no_gap"}
    document |= {"closed": None, "next_recording": None}
    document |= {"effects": [], "warnings": [], "where": []}
    for stage in ("before", "after"):
        document["gap"][stage]["torque_nrmse"] = list(FLOOR)
    document["unexplained"] = {"share": 0.0, "above_floor": False, "where": []}
    return document


def unexplained() -> dict[str, Any]:
    """A gap on joint 4 that no effect explains."""
    document = two_effects()
    document |= {"case": "riddle", "verdict": "unexplained", "effects": []}
    document["closed"] = 0.0
    document["gap"]["after"] = copy.deepcopy(document["gap"]["before"])
    region = _region(4, "between 3.1 and 4.6 s", 0.64, 0.08, "time")
    document["unexplained"] = {"share": 1.0, "above_floor": True, "where": [region]}
    return document


def one_possible() -> dict[str, Any]:
    """A delay that is named, and a payload that is possible only."""
    document = two_effects()
    delay, payload = document["effects"]
    document["effects"] = [delay]
    rival = {"effect": "torque_offset", "probability": 0.3, "separated_by": "a rest"}
    payload |= {"probability": 0.31, "alternatives": [rival], "settled_by": "a rest"}
    document["possible"] = [payload]
    return document


def changed() -> dict[str, Any]:
    """A delay and a payload against a reference."""
    document = two_effects()
    document["case"] = "monday"
    sheet = {"armature": [0.5] * 7, "coulomb": [2.0] * 7, "viscous": [3.0] * 7}
    offsets = {"effect": "torque_offset", "joints": [1, 2, 3]}
    offsets["parameters"] = {"torque": [0.6, -0.5, 0.2]}
    today = {"coulomb": [2.2] * 7, "torque_nrmse": [0.017] * 7}
    document["against"] = {
        "reference": "friday",
        "recordings": ["a.csv", "b.csv"],
        "identified": sheet,
        "identified_std": {key: [0.02] * 7 for key in sheet},
        "friction_law": "Coulomb and viscous",
        "base_parameters": 43,
        "torque_ratio_to_nominal": 0.94,
        "sampling_skew": -0.0004,
        "held_out": {"rmse": [0.1] * 7, "torque_nrmse": [0.013] * 7},
        "remainder": {"torque_nrmse": [0.002] * 6 + [0.012]},
        "inherent": [offsets],
        "today": {**sheet, **today, "friction_allowed": 0.15},
    }
    return document


def diagnosis(document: dict[str, Any]) -> Diagnosis:
    """A diagnosis around a document, with curves that look like its effects."""
    rng, found = np.random.default_rng(5), bool(document["effects"])
    traces = tuple(
        _trace(r["name"], r["duration"], document, rng) for r in document["recordings"]
    )
    com = np.array([0.01, 0.0, 0.05])
    effects = (
        AppliedEffect("actuator_delay", (4, 5), {"delay": np.array([0.0088, 0.0146])}),
        AppliedEffect("payload", (), {"mass": np.array(1.05), "com": com}),
    )
    signatures = tuple(_signature(*each, rng) for each in _SIGNATURES if found)
    frequency = np.linspace(0.0, 12.0, 200)
    shape = np.exp(-((frequency[:, None] - 2.5) ** 2) / 3.0) + 0.02
    gaps = (10.0 * shape * np.array(gap) for gap in (BEFORE, AFTER))
    spectrum = Spectrum(frequency, *gaps)
    return Diagnosis(document, effects if found else (), traces, signatures, spectrum)


_SIGNATURES = [
    ("actuator_delay", 4, "rate of the torque", "N m/s"),
    ("actuator_delay", 5, "rate of the torque", "N m/s"),
    ("payload", 2, "gravity torque of the last link", "N m/kg"),
    ("payload", 4, "time", "s"),
]


LATE = [0.062, 0.181, 0.094, 0.118, 0.081, 0.071, 0.058]
LOADED = [0.031, 0.029, 0.041, 0.372, 0.641, 0.043, 0.055]
"""Gaps with the delay or the payload alone."""


def _delay() -> dict[str, Any]:
    delay = {"unit": "s", "value": [0.0088, 0.0146], "std": [0.0002, 0.0003]}
    lag = {"effect": "actuator_lag", "probability": 0.02}
    regime = "acceleration reversals above 2 Hz"
    return {
        **{"effect": "actuator_delay", "joints": [4, 5], "probability": 0.98},
        "parameters": {"delay": delay},
        "gap_with_only_this": {"torque_nrmse": list(LATE)},
        "gap_without_this": {"torque_nrmse": list(LOADED)},
        "share": 0.78,
        "where": [{"joint": 4, "regime": regime, "share": 0.7}],
        "alternatives": [lag | {"separated_by": "a chirp above 10 Hz"}],
    }


def _payload() -> dict[str, Any]:
    com = {"value": [0.0098, -0.0012, 0.0514], "std": [0.0011, 0.001, 0.002]}
    mass = {"unit": "kg", "value": 1.0512, "std": 0.013}
    return {
        **{"effect": "payload", "joints": [], "probability": 0.999},
        "parameters": {"mass": mass, "com": {"unit": "m", **com}},
        "gap_with_only_this": {"torque_nrmse": list(LOADED)},
        "gap_without_this": {"torque_nrmse": list(LATE)},
        **{"share": 0.19, "where": [], "alternatives": []},
    }


def _recording(name: str, seconds: float, role: str) -> dict[str, Any]:
    return {"name": name, "duration": seconds, "rate": 500.0, "role": role}


def _region(
    joint: int, regime: str, share: float, coverage: float, kind: str
) -> dict[str, Any]:
    sizes = {"share": share, "coverage": coverage, "enrichment": share / coverage}
    return {"joint": joint, "kind": kind, "regime": regime, **sizes}


def _considered(
    effect: str, joints: list[int], evidence: float, closed: float, reason: str
) -> dict[str, Any]:
    said = {"log_evidence": evidence, "gap_closed": closed, "reason": reason}
    return {"effect": effect, "joints": joints, **said}


def _trace(
    name: str, duration: float, document: dict[str, Any], rng: np.random.Generator
) -> Trace:
    t = np.arange(0.0, duration, 0.002)
    scale = np.array([8.0, 35.0, 9.0, 18.0, 2.0, 1.6, 0.4])
    phase = rng.uniform(0.0, 6.0, len(JOINTS))
    slow, fast = 2.0 * t[:, None] + phase, 7.3 * t[:, None] + 2 * phase
    measured = scale * (np.sin(slow) + 0.4 * np.sin(fast))
    wave = 1.3 * scale * np.sin(fast + 1.5)
    left = (
        measured - wave * np.array(document["gap"][stage]["torque_nrmse"], dtype=float)
        for stage in ("before", "after")
    )
    return Trace(name, t, 0.5 * np.sin(slow), measured, *left)


def _signature(
    effect: str, joint: int, axis: str, unit: str, rng: np.random.Generator
) -> Signature:
    over_time = axis == "time"
    x = np.linspace(0.0, 18.0, 3000) if over_time else rng.uniform(-60.0, 60.0, 3000)
    explained = 3.0 * np.sin(x) if over_time else 0.0088 * x
    seen = explained + rng.normal(0.0, 0.2 * np.std(explained), 3000)
    return Signature(effect, joint, axis, unit, x, seen, explained)
