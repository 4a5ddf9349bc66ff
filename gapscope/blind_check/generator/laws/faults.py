"""Faults of the set-up: the recording, or the nominal URDF, differs from its description."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from gapscope.blind_check.generator.arms import shifted
from gapscope.blind_check.generator.law import Act, Draws, Law, LawValues, times
from gapscope.blind_check.generator.true_arm import Columns, TrueArm

STAMPS = ("gaps", "repeats", "jitter", "wrong_rate")
"""Kinds of wrong time stamps."""
UNITS = ("degrees", "milliseconds", "motor_side")
"""Kinds of wrong units."""


def _torque(change: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> Act:
    """Record another torque of some joints: what it changes theirs to, from the torque, (N, n), and the joints."""

    def act(plant: TrueArm, joints: np.ndarray, values: LawValues) -> None:
        def spoil(rows: Columns, rng: np.random.Generator) -> Columns:
            torque = rows["tau"].copy()
            torque[:, joints] = change(torque, joints)
            return {**rows, "tau": torque}

        plant.spoil.append(spoil)

    return act


def _apply_unit(plant: TrueArm, joints: np.ndarray, values: LawValues) -> None:
    unit, ratio = str(values["unit"]), float(values["ratio"])

    def spoil(rows: Columns, rng: np.random.Generator) -> Columns:
        if unit == "milliseconds":
            return {**rows, "t": 1e3 * rows["t"]}
        factor = 180.0 / np.pi if unit == "degrees" else ratio
        out = dict(rows)
        for name in rows.keys() - {"t", "tau"}:
            out[name] = rows[name] * factor
        if unit == "motor_side":
            out["tau"] = rows["tau"] / ratio
        return out

    plant.spoil.append(spoil)


def _apply_shift(plant: TrueArm, joints: np.ndarray, values: LawValues) -> None:
    plant.spoil_urdf = shifted


def _stamps(draws: Draws) -> LawValues:
    rng = draws.rng
    kind = str(rng.choice(STAMPS))
    amount = {
        "gaps": rng.uniform(0.03, 0.1),
        "repeats": rng.uniform(0.02, 0.1),
        "jitter": rng.uniform(0.1, 0.3),
        "wrong_rate": float(rng.choice([0.8, 0.9, 1.1, 1.25])),
    }[kind]
    return {"kind": np.array(kind), "amount": np.array(amount)}


def _apply_stamps(plant: TrueArm, joints: np.ndarray, values: LawValues) -> None:
    kind, amount = str(values["kind"]), float(values["amount"])
    change = {
        "wrong_rate": _stretched,
        "jitter": _jittered,
        "repeats": _repeated,
        "gaps": _with_gaps,
    }[kind]
    plant.spoil.append(lambda rows, rng: change(rows, amount, rng))


def _stretched(rows: Columns, amount: float, rng: np.random.Generator) -> Columns:
    """The clock runs at another rate."""
    t = rows["t"]
    return {**rows, "t": t[0] + (t - t[0]) * amount}


def _jittered(rows: Columns, amount: float, rng: np.random.Generator) -> Columns:
    """Each stamp is off by a normal error in periods, less than half a period."""
    t = rows["t"]
    error = np.clip(amount * rng.standard_normal(len(t)), -0.4, 0.4)
    return {**rows, "t": t + (t[1] - t[0]) * error}


def _repeated(rows: Columns, amount: float, rng: np.random.Generator) -> Columns:
    """In a share of the rows the logger saw the old sample once more."""
    count = len(rows["t"])
    stale = rng.random(count) < amount
    stale[0] = False
    source = np.arange(count) - stale
    return {name: x if name == "t" else x[source] for name, x in rows.items()}


def _with_gaps(rows: Columns, amount: float, rng: np.random.Generator) -> Columns:
    """Four stretches are lost."""
    count = len(rows["t"])
    length = max(2, int(amount * count / 4))
    lost = np.zeros(count, dtype=bool)
    for _ in range(4):
        begin = rng.integers(count // 20, count - count // 20)
        lost[begin : begin + length] = True
    return {name: x[~lost] for name, x in rows.items()}


FAULTS = (
    Law(
        "sign_flip",
        lambda draws: {},
        _torque(lambda torque, joints: -torque[:, joints]),
        times(),
        {},
        joints="one",
        measure="none",
        form="torque of a joint turned round",
    ),
    Law(
        "joint_swap",
        lambda draws: {},
        _torque(lambda torque, joints: torque[:, joints[::-1]]),
        times(),
        {},
        joints="pair",
        measure="none",
        form="torque of two joints exchanged",
    ),
    Law(
        "unit_mismatch",
        lambda draws: {
            "unit": draws.rng.choice(UNITS),
            "ratio": np.array(float(draws.rng.integers(50, 161))),
        },
        _apply_unit,
        times(),
        {"unit": ""},
        joints="all",
        measure="none",
        form="degrees, milliseconds, or the motor's side of the gear",
    ),
    Law(
        "shifted_inertials",
        lambda draws: {},
        _apply_shift,
        times(),
        {},
        joints="arm",
        measure="none",
        form="in the URDF that the user believes",
    ),
    Law(
        "time_stamps",
        _stamps,
        _apply_stamps,
        times(),
        {"kind": "", "amount": "1"},
        joints="arm",
        measure="none",
        form="stretches lost, samples repeated, jitter, or a wrong rate",
    ),
)
"""The faults of the set-up."""
