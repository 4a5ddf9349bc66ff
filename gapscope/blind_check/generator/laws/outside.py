"""Causes that no effect of the catalogue describes; a diagnosis should answer ``unexplained``."""

from __future__ import annotations

import numpy as np

from gapscope.blind_check.generator.law import Law, LawContext, LawValues, sign, times
from gapscope.blind_check.generator.true_arm import TipForce, TrueArm


def _draw_hysteresis(
    rng: np.random.Generator, context: LawContext, joints: np.ndarray
) -> LawValues:
    count = len(joints)
    return {
        "torque": context.deviation[joints] * rng.uniform(0.05, 0.2, count),
        "reach": context.swing[joints] * rng.uniform(0.15, 0.35, count),
    }


def _apply_hysteresis(plant: TrueArm, joints: np.ndarray, values: LawValues) -> None:
    plant.put("hysteresis", joints, values["torque"])
    plant.put("reach", joints, values["reach"])


def _draw_uneven(
    rng: np.random.Generator, context: LawContext, joints: np.ndarray
) -> LawValues:
    count = len(joints)
    half_swing = np.maximum(context.swing[joints] / 2, 0.2)
    return {
        "torque": context.arm.coulomb[joints] * rng.uniform(0.5, 1.5, count),
        "cycles": rng.uniform(1.5, 5.0, count) / half_swing,
        "phase": rng.uniform(-np.pi, np.pi, count),
    }


def _apply_uneven(plant: TrueArm, joints: np.ndarray, values: LawValues) -> None:
    """Dry friction c + A (1 + sin(n q + phi)) / 2, with c lowered by A / 2 as far as it goes: no more on average."""
    before = plant.values["coulomb"][joints]
    after = np.maximum(before, values["torque"])
    plant.put("coulomb", joints, after)
    plant.put("uneven", joints, np.minimum(values["torque"] / after, 0.95))
    plant.put("uneven_cycles", joints, values["cycles"])
    plant.put("uneven_phase", joints, values["phase"])


def _draw_coupling(
    rng: np.random.Generator, context: LawContext, joints: np.ndarray
) -> LawValues:
    count = len(joints)
    before = np.roll(context.deviation, 1)[joints]
    share = sign(rng, count) * rng.uniform(0.05, 0.2, count)
    return {"share": share * context.deviation[joints] / before}


def _apply_coupling(plant: TrueArm, joints: np.ndarray, values: LawValues) -> None:
    plant.put("leak", joints, values["share"])


def _draw_vibration(
    rng: np.random.Generator, context: LawContext, joints: np.ndarray
) -> LawValues:
    way = rng.standard_normal(3)
    return {
        "acceleration": rng.uniform(0.2, 1.0) * way / np.linalg.norm(way),
        "frequency": np.array(rng.uniform(1.5, 9.0)),
        "phase": np.array(rng.uniform(-np.pi, np.pi)),
    }


def _apply_vibration(plant: TrueArm, joints: np.ndarray, values: LawValues) -> None:
    plant.shaken = (
        values["acceleration"],
        float(values["frequency"]),
        float(values["phase"]),
    )


def _draw_disturbance(
    rng: np.random.Generator, context: LawContext, joints: np.ndarray
) -> LawValues:
    count = len(joints)
    return {
        "torque": context.deviation[joints] * rng.uniform(0.05, 0.2, count),
        "frequency": np.full(count, rng.uniform(1.5, 9.0)),
        "phase": rng.uniform(-np.pi, np.pi, count),
    }


def _apply_disturbance(plant: TrueArm, joints: np.ndarray, values: LawValues) -> None:
    for name, value in (
        ("shake", "torque"),
        ("shake_frequency", "frequency"),
        ("shake_phase", "phase"),
    ):
        plant.put(name, joints, values[value])


def _draw_fading(
    rng: np.random.Generator, context: LawContext, joints: np.ndarray
) -> LawValues:
    count = len(joints)
    return {
        "share": rng.uniform(0.1, 0.25, count),
        "time": np.full(count, rng.uniform(0.25, 0.5) * context.shortest),
        "load": context.deviation[joints] + 0.3 * context.peak[joints],
    }


def _apply_fading(plant: TrueArm, joints: np.ndarray, values: LawValues) -> None:
    for name, value in (
        ("fade", "share"),
        ("fade_time", "time"),
        ("fade_load", "load"),
    ):
        plant.put(name, joints, values[value])


def _draw_contact(
    rng: np.random.Generator, context: LawContext, joints: np.ndarray
) -> LawValues:
    way = rng.standard_normal(3)
    way /= np.linalg.norm(way)
    along = context.tip @ way
    level = float(np.quantile(along, rng.uniform(0.8, 0.92)))
    depth = max(float(along.max()) - level, 0.01)
    return {
        "stiffness": np.array(rng.uniform(5.0, 20.0) / depth),
        "normal": way,
        "level": np.array(level),
    }


def _apply_contact(plant: TrueArm, joints: np.ndarray, values: LawValues) -> None:
    normal = values["normal"]
    level, stiffness = float(values["level"]), float(values["stiffness"])

    def pressed(t: float, place: np.ndarray, speed: np.ndarray) -> np.ndarray:
        """Hunt and Crossley [hunt1975]: -k x (1 + 0.3 dx) along the normal while the tip is x behind the wall."""
        depth = float(place @ normal) - level
        if depth <= 0:
            return 0 * normal
        pressure = stiffness * depth * (1.0 + 0.3 * float(speed @ normal))
        return -normal * max(pressure, 0.0)  # a wall never pulls

    force: TipForce = pressed
    plant.push = force


def _draw_one_sided(
    rng: np.random.Generator, context: LawContext, joints: np.ndarray
) -> LawValues:
    drag = (context.arm.coulomb + context.arm.viscous)[joints]
    return {"coefficient": drag * rng.uniform(0.5, 2.0, len(joints))}


def _apply_one_sided(plant: TrueArm, joints: np.ndarray, values: LawValues) -> None:
    plant.put("one_sided", joints, values["coefficient"])


OUTSIDE = (
    Law(
        "hysteresis",
        _draw_hysteresis,
        _apply_hysteresis,
        times("torque"),
        {"torque": "N m", "reach": "rad"},
        outside=True,
        form="Bouc-Wen",
    ),
    Law(
        "position_dependent_friction",
        _draw_uneven,
        _apply_uneven,
        times("torque"),
        {"torque": "N m", "cycles": "1", "phase": "rad"},
        outside=True,
        form="dry friction that varies over a turn",
    ),
    Law(
        "joint_coupling",
        _draw_coupling,
        _apply_coupling,
        times("share"),
        {"share": "1"},
        joints="later",
        outside=True,
        form="torque of the joint before leaks in",
    ),
    Law(
        "base_vibration",
        _draw_vibration,
        _apply_vibration,
        times("acceleration"),
        {"acceleration": "m/s^2", "frequency": "Hz", "phase": "rad"},
        joints="arm",
        outside=True,
        own=False,
        largest={"acceleration": 6.0},
        form="the base is shaken at one frequency",
    ),
    Law(
        "periodic_disturbance",
        _draw_disturbance,
        _apply_disturbance,
        times("torque"),
        {"torque": "N m", "frequency": "Hz", "phase": "rad"},
        joints="one",
        outside=True,
        form="a sine over time",
    ),
    Law(
        "fading_torque_constant",
        _draw_fading,
        _apply_fading,
        times("share"),
        {"share": "1", "time": "s", "load": "N m"},
        outside=True,
        largest={"share": 0.5},
        form="falls as the winding warms",
    ),
    Law(
        "contact",
        _draw_contact,
        _apply_contact,
        times("stiffness"),
        {"stiffness": "N/m", "normal": "1", "level": "m"},
        joints="arm",
        outside=True,
        own=False,
        largest={"stiffness": 2e4},
        form="a wall, Hunt and Crossley",
    ),
    Law(
        "one_sided_friction",
        _draw_one_sided,
        _apply_one_sided,
        times("coefficient"),
        {"coefficient": "N m s^2/rad^2"},
        outside=True,
        form="quadratic, in one direction only",
    ),
)
"""The laws outside the catalogue."""
