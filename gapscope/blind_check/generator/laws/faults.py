"""Faults of the set-up: the recording, or the URDF that the user believes, is not what it is taken for."""

from __future__ import annotations

import numpy as np

from gapscope.blind_check.generator.law import Law, LawContext, LawValues, fixed
from gapscope.blind_check.generator.plant import Columns, TrueArm
from gapscope.blind_check.generator.urdf import shifted

STAMPS = ("gaps", "repeats", "jitter", "wrong_rate")
"""Kinds of wrong time stamps."""
UNITS = ("degrees", "milliseconds", "motor_side")
"""Kinds of wrong units."""


def _nothing(
    rng: np.random.Generator, scene: LawContext, joints: np.ndarray
) -> LawValues:
    return {}


def _flip(plant: TrueArm, joints: np.ndarray, values: LawValues) -> None:
    def spoil(rows: Columns, rng: np.random.Generator) -> Columns:
        torque = rows["tau"].copy()
        torque[:, joints] *= -1.0
        return {**rows, "tau": torque}

    plant.spoil.append(spoil)


def _swap(plant: TrueArm, joints: np.ndarray, values: LawValues) -> None:
    def spoil(rows: Columns, rng: np.random.Generator) -> Columns:
        torque = rows["tau"].copy()
        torque[:, joints] = torque[:, joints[::-1]]
        return {**rows, "tau": torque}

    plant.spoil.append(spoil)


def _unit(rng: np.random.Generator, scene: LawContext, joints: np.ndarray) -> LawValues:
    return {"unit": rng.choice(UNITS), "ratio": np.array(float(rng.integers(50, 161)))}


def _rename(plant: TrueArm, joints: np.ndarray, values: LawValues) -> None:
    unit, ratio = str(values["unit"]), float(values["ratio"])

    def spoil(rows: Columns, rng: np.random.Generator) -> Columns:
        if unit == "milliseconds":
            return {**rows, "t": 1e3 * rows["t"]}
        factor = 180.0 / np.pi if unit == "degrees" else ratio
        out = {k: v if k in ("t", "tau") else v * factor for k, v in rows.items()}
        if unit == "motor_side":
            out["tau"] = rows["tau"] / ratio
        return out

    plant.spoil.append(spoil)


def _shift(plant: TrueArm, joints: np.ndarray, values: LawValues) -> None:
    plant.spoil_urdf = shifted


def _stamps(
    rng: np.random.Generator, scene: LawContext, joints: np.ndarray
) -> LawValues:
    kind = str(rng.choice(STAMPS))
    amount = {
        "gaps": rng.uniform(0.03, 0.1),
        "repeats": rng.uniform(0.02, 0.1),
        "jitter": rng.uniform(0.1, 0.3),
        "wrong_rate": float(rng.choice([0.8, 0.9, 1.1, 1.25])),
    }[kind]
    return {"kind": np.array(kind), "amount": np.array(amount)}


def _restamp(plant: TrueArm, joints: np.ndarray, values: LawValues) -> None:
    kind, amount = str(values["kind"]), float(values["amount"])

    def spoil(rows: Columns, rng: np.random.Generator) -> Columns:
        t = rows["t"]
        count = len(t)
        if kind == "wrong_rate":
            return {**rows, "t": t[0] + (t - t[0]) * amount}
        if kind == "jitter":
            return {
                **rows,
                "t": t
                + (t[1] - t[0])
                * np.clip(amount * rng.standard_normal(count), -0.4, 0.4),
            }
        if kind == "repeats":
            keep = np.arange(count)
            stale = rng.random(count) < amount
            stale[0] = False
            keep[stale] -= 1  # the logger saw the old sample once more
            return {k: v if k == "t" else v[keep] for k, v in rows.items()}
        lost = np.zeros(count, dtype=bool)
        for _ in range(4):
            begin = rng.integers(count // 20, count - count // 20)
            lost[begin : begin + max(2, int(amount * count / 4))] = True
        return {k: v[~lost] for k, v in rows.items()}

    plant.spoil.append(spoil)


FAULTS = (
    Law(
        "sign_flip",
        _nothing,
        _flip,
        fixed,
        {},
        joints="one",
        measure="none",
        form="torque of a joint turned round",
    ),
    Law(
        "joint_swap",
        _nothing,
        _swap,
        fixed,
        {},
        joints="pair",
        measure="none",
        form="torque of two joints exchanged",
    ),
    Law(
        "unit_mismatch",
        _unit,
        _rename,
        fixed,
        {"unit": ""},
        joints="all",
        measure="none",
        form="degrees, milliseconds, or the motor's side of the gear",
    ),
    Law(
        "shifted_inertials",
        _nothing,
        _shift,
        fixed,
        {},
        joints="arm",
        measure="none",
        form="in the URDF that the user believes",
    ),
    Law(
        "time_stamps",
        _stamps,
        _restamp,
        fixed,
        {"kind": "", "amount": "1"},
        joints="arm",
        measure="none",
        form="stretches lost, samples repeated, jitter, or a wrong rate",
    ),
)
"""The faults of the set-up."""
