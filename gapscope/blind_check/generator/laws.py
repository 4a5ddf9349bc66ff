"""The laws of the generator by name: ``laws.yaml``, and in code what is more than products of draws."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from scipy.spatial.transform import Rotation

from gapscope.blind_check.generator.arms import (
    Inertial,
    added,
    inertial_of,
    moved_links,
    set_inertial,
    shifted,
)
from gapscope.blind_check.generator.law import Act, Draw, Draws, Law, LawValues
from gapscope.blind_check.generator.true_arm import Columns, TrueArm

# Friction and rigid bodies.


def _drift(draws: Draws) -> LawValues:
    speed = draws.speed
    friction = draws.coulomb + draws.viscous * speed
    return {
        "amplitude": draws.uniform(0.5, 1.0),
        "time_constant": np.full(
            len(speed), draws.rng.uniform(0.25, 0.7) * draws.whole.shortest
        ),
        "share": draws.common(0.05, 0.15),
        "power": np.maximum(friction * speed, 1e-6),
    }


def _payload(draws: Draws) -> LawValues:
    rng, largest = draws.rng, draws.whole.arm.payload
    x, y, z = (rng.uniform(*r) for r in ((-0.04, 0.04), (-0.04, 0.04), (-0.01, 0.1)))
    mass = largest * rng.uniform(0.2, 0.9)
    radius = rng.choice([0.0, 0.03, 0.06])
    return {"mass": mass, "com": [x, y, z], "radius": radius, "top": mass / largest}


def _apply_payload(plant: TrueArm, joints: np.ndarray, values: LawValues) -> None:
    link = moved_links(plant.root)[-1]
    mass, radius = float(values["mass"]), float(values["radius"])
    ball = 0.4 * mass * radius**2 * np.eye(3)
    load = Inertial(mass, values["com"], ball)
    set_inertial(link, added(inertial_of(link), load))


def _link(draws: Draws) -> LawValues:
    rng, arm = draws.rng, draws.whole.arm
    link = int(rng.integers(2, max(arm.n, 3)))
    body = inertial_of(moved_links(arm.root)[link - 1])
    share = float(rng.choice([-1.0, 1.0], 1)[0] * rng.uniform(0.1, 0.3))
    distance = max(float(np.linalg.norm(body.com)), 0.04)
    shift = 0.5 * abs(share) * distance
    direction = rng.standard_normal(3)
    return {
        "link": link,
        "mass": share * body.mass,
        "com": shift * direction / np.linalg.norm(direction),
        "share": share,
    }


def _apply_link(plant: TrueArm, joints: np.ndarray, values: LawValues) -> None:
    link = moved_links(plant.root)[int(values["link"]) - 1]
    body = inertial_of(link)
    mass = body.mass + float(values["mass"])
    com = body.com + values["com"]
    inertia = body.inertia * mass / body.mass  # the same radii of gyration
    set_inertial(link, Inertial(mass, com, inertia))


def _tilt(draws: Draws) -> LawValues:
    angle = np.radians(draws.rng.uniform(0.5, 4.0))
    direction = draws.rng.uniform(0, 2 * np.pi)
    return {
        "roll": angle * np.cos(direction),
        "pitch": angle * np.sin(direction),
    }


def _apply_tilt(plant: TrueArm, joints: np.ndarray, values: LawValues) -> None:
    angles = [float(values["roll"]), float(values["pitch"])]
    turn = Rotation.from_euler("xy", angles)  # first x, then y, fixed axes
    plant.gravity = turn.inv().apply(plant.gravity)


# Transmission and motor.

TOOTH = 80.0
"""Resonance of the closed gear of a joint with free play [Hz]."""


def _two_masses(
    draws: Draws, frequency: np.ndarray | float
) -> tuple[np.ndarray, np.ndarray]:
    """Stiffness of a joint whose link swings at a frequency [Hz], and half of its critical damping."""
    link, rotor = draws.inertia, draws.armature
    stiffness = link * (2 * np.pi * frequency) ** 2
    # sqrt(k m), with the reduced mass of link and rotor
    return stiffness, np.sqrt(stiffness * link * rotor / (link + rotor))


def _elasticity(draws: Draws) -> LawValues:
    frequency = draws.uniform(6.0, 14.0)
    stiffness, half_critical = _two_masses(draws, frequency)
    ratio = draws.rng.uniform(0.04, 0.1)
    inverse_twist = stiffness / np.maximum(draws.peak, 1e-6)
    return {
        "stiffness": stiffness,
        "damping": 2 * ratio * half_critical,
        "hardening": draws.rng.uniform(0.02, 0.08) * inverse_twist**2,
        "frequency": frequency,
    }


def _backlash(draws: Draws) -> LawValues:
    stiffness, half_critical = _two_masses(draws, TOOTH)
    width = np.radians(draws.uniform(0.3, 1.2))
    return {
        "width": width,
        "half": 0.5 * width,
        "stiffness": stiffness,
        "damping": 2 * 0.2 * half_critical,
    }


def _spring(draws: Draws) -> LawValues:
    swing = np.maximum(draws.swing, 0.3)
    share = draws.uniform(0.2, 0.6)
    return {
        "stiffness": draws.deviation * share / swing,
        "rest": draws.middle + draws.uniform(-0.6, 0.6) * swing,
        "cubic": draws.sign() * draws.uniform(0.02, 0.06) / swing**2,
        "share": share,
    }


def _lag(draws: Draws) -> LawValues:
    return {
        "time_constant": draws.uniform(0.003, 0.01),
        "second": np.full(len(draws.joints), float(draws.rng.integers(0, 2))),
    }


# The outer world.


def _force(draws: Draws) -> LawValues:
    rng, shortest = draws.rng, draws.whole.shortest
    way = rng.standard_normal(3)
    lasts = rng.uniform(0.15, 0.4) * shortest
    start = rng.uniform(1.2, shortest - lasts - 1.2)
    return {
        # 10 N is a first guess; the sizing scales it
        "force": 10.0 * rng.uniform(0.5, 2.0) * way / np.linalg.norm(way),
        "start": start,
        "end": start + lasts,
        "ramp": rng.uniform(0.01, 0.04),
    }


def _push(plant: TrueArm, joints: np.ndarray, values: LawValues) -> None:
    force = values["force"]
    start, end, ramp = (float(values[name]) for name in ("start", "end", "ramp"))

    def pushed(t: float, place: np.ndarray, speed: np.ndarray) -> np.ndarray:
        """A force that grows and fades smoothly; start and end are where it is half of its size."""
        begun, over = np.tanh((t - start) / ramp), np.tanh((t - end) / ramp)
        return force * 0.5 * (begun - over)

    plant.push = pushed


# Faults of the set-up.

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


def in_other_units(rows: Columns, unit: str, ratio: float) -> Columns:
    """Columns of a recording in one of ``UNITS``; the motor's side of a gear of a ratio."""
    if unit == "milliseconds":
        return {**rows, "t": 1e3 * rows["t"]}
    factor = 180.0 / np.pi if unit == "degrees" else ratio
    out = dict(rows)
    for name in rows.keys() - {"t", "tau"}:
        out[name] = rows[name] * factor
    if unit == "motor_side":
        out["tau"] = rows["tau"] / ratio
    return out


def _units(draws: Draws) -> LawValues:
    unit = draws.rng.choice(UNITS)
    return {"unit": unit, "ratio": float(draws.rng.integers(50, 161))}


def _apply_unit(plant: TrueArm, joints: np.ndarray, values: LawValues) -> None:
    unit, ratio = str(values["unit"]), float(values["ratio"])
    plant.spoil.append(lambda rows, rng: in_other_units(rows, unit, ratio))


def _apply_shift(plant: TrueArm, joints: np.ndarray, values: LawValues) -> None:
    plant.spoil_urdf = shifted


def _stamps(draws: Draws) -> LawValues:
    rng = draws.rng
    kind = str(rng.choice(list(STAMPS)))
    amount = {
        "gaps": rng.uniform(0.03, 0.1),
        "repeats": rng.uniform(0.02, 0.1),
        "jitter": rng.uniform(0.1, 0.3),
        "wrong_rate": float(rng.choice([0.8, 0.9, 1.1, 1.25])),
    }[kind]
    return {"kind": kind, "amount": amount}


def _apply_stamps(plant: TrueArm, joints: np.ndarray, values: LawValues) -> None:
    change, amount = STAMPS[str(values["kind"])], float(values["amount"])
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


STAMPS = {
    "gaps": _with_gaps,
    "repeats": _repeated,
    "jitter": _jittered,
    "wrong_rate": _stretched,
}
"""Kinds of wrong time stamps, and what they make of a recording and an amount."""


# Outside the catalogue.


def _varying(draws: Draws) -> LawValues:
    return {
        "torque": draws.coulomb * draws.uniform(0.5, 1.5),
        "cycles": draws.uniform(1.5, 5.0) / np.maximum(draws.swing / 2, 0.2),
        "phase": draws.angle(),
    }


def _uneven(plant: TrueArm, joints: np.ndarray, values: LawValues) -> None:
    """Dry friction c + A (1 + sin(n q + phi)) / 2, with c lowered by A / 2 as far as it goes: no more on average."""
    before = plant.values["coulomb"][joints]
    after = np.maximum(before, values["torque"])
    plant.put("coulomb", joints, after)
    plant.put("uneven", joints, np.minimum(values["torque"] / after, 0.95))
    plant.put("uneven_cycles", joints, values["cycles"])
    plant.put("uneven_phase", joints, values["phase"])


def _coupling(draws: Draws) -> LawValues:
    before = np.roll(draws.whole.deviation, 1)[draws.joints]
    share = draws.sign() * draws.uniform(0.05, 0.2)
    return {"share": share * draws.deviation / before}


def _vibration(draws: Draws) -> LawValues:
    rng = draws.rng
    way = rng.standard_normal(3)
    return {
        "acceleration": rng.uniform(0.2, 1.0) * way / np.linalg.norm(way),
        "frequency": rng.uniform(1.5, 9.0),
        "phase": rng.uniform(-np.pi, np.pi),
    }


def _shake(plant: TrueArm, joints: np.ndarray, values: LawValues) -> None:
    frequency, phase = float(values["frequency"]), float(values["phase"])
    plant.shaken = values["acceleration"], frequency, phase


def _fading(draws: Draws) -> LawValues:
    return {
        "share": draws.uniform(0.1, 0.25),
        "time": draws.common(0.25, 0.5) * draws.whole.shortest,
        "load": draws.deviation + 0.3 * draws.peak,
    }


def _contact(draws: Draws) -> LawValues:
    rng = draws.rng
    way = rng.standard_normal(3)
    way /= np.linalg.norm(way)
    along = draws.whole.tip @ way
    level = float(np.quantile(along, rng.uniform(0.8, 0.92)))
    depth = max(float(along.max()) - level, 0.01)
    return {
        "stiffness": rng.uniform(5.0, 20.0) / depth,
        "normal": way,
        "level": level,
    }


def _press(plant: TrueArm, joints: np.ndarray, values: LawValues) -> None:
    normal = values["normal"]
    level, stiffness = float(values["level"]), float(values["stiffness"])

    def pressed(t: float, place: np.ndarray, speed: np.ndarray) -> np.ndarray:
        """Hunt and Crossley [hunt1975]: -k x (1 + 0.3 dx) along the normal while the tip is x behind the wall."""
        depth = float(place @ normal) - level
        if depth <= 0:
            return 0 * normal
        pressure = stiffness * depth * (1.0 + 0.3 * float(speed @ normal))
        return -normal * max(pressure, 0.0)  # a wall never pulls

    plant.push = pressed


def _one_sided(draws: Draws) -> LawValues:
    friction = draws.coulomb + draws.viscous
    return {"coefficient": friction * draws.uniform(0.5, 2.0)}


# All of them

DRAWS: dict[str, Draw] = {
    "friction_drift": _drift,
    "payload": _payload,
    "link_inertia": _link,
    "base_tilt": _tilt,
    "joint_elasticity": _elasticity,
    "backlash": _backlash,
    "parallel_spring": _spring,
    "actuator_lag": _lag,
    "external_force": _force,
    "unit_mismatch": _units,
    "time_stamps": _stamps,
    "position_dependent_friction": _varying,
    "joint_coupling": _coupling,
    "base_vibration": _vibration,
    "fading_torque_constant": _fading,
    "contact": _contact,
    "one_sided_friction": _one_sided,
}
"""Draws of laws that are more than products."""
ACTS: dict[str, Act] = {
    "payload": _apply_payload,
    "link_inertia": _apply_link,
    "base_tilt": _apply_tilt,
    "external_force": _push,
    "sign_flip": _torque(lambda torque, joints: -torque[:, joints]),
    "joint_swap": _torque(lambda torque, joints: torque[:, joints[::-1]]),
    "unit_mismatch": _apply_unit,
    "shifted_inertials": _apply_shift,
    "time_stamps": _apply_stamps,
    "position_dependent_friction": _uneven,
    "base_vibration": _shake,
    "contact": _press,
}
"""Acts of laws that do more than fill in fields of the joints."""


def _drawn(recipes: Mapping[str, Sequence[Any]], draws: Draws) -> LawValues:
    """Values as products of factors, drawn from left to right; see ``laws.yaml``."""
    values: LawValues = {}
    for name, factors in recipes.items():
        value: Any = 1.0
        for factor in factors:
            if isinstance(factor, list):
                method, *ends = factor
                factor = getattr(draws, method)(*ends)
            elif isinstance(factor, str):
                earlier = factor in values
                factor = values[factor] if earlier else getattr(draws, factor)
            value = value * factor
        values[name] = value
    return values


def _law(name: str, *, draw: Any = None, **entry: Any) -> Law:
    """An entry of ``laws.yaml``."""
    drawn = DRAWS.get(name) or partial(_drawn, draw or {})
    return Law(name, drawn, ACTS.get(name), **entry)


_DATA = yaml.safe_load(
    Path(__file__).with_name("laws.yaml").read_text(encoding="utf-8")
)
LAWS = {
    name: _law(name, outside=group == "outside", **entry)
    for group, laws in _DATA.items()
    for name, entry in laws.items()
}
INSIDE = tuple(_DATA["inside"])
"""Names of the effects that are in the catalogue."""
SETUP = tuple(_DATA["faults"])
"""Names of the faults of the set-up."""
BEYOND = tuple(_DATA["outside"])
"""Names of the laws outside the catalogue."""
