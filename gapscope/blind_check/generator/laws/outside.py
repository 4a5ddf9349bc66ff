"""Causes that no effect of the catalogue describes; a diagnosis should answer ``unexplained``."""

from __future__ import annotations

import numpy as np

from gapscope.blind_check.generator.law import Law, LawContext, LawValues, sign, times
from gapscope.blind_check.generator.plant import Outer, TrueArm


def _bouc_wen(
    rng: np.random.Generator, scene: LawContext, joints: np.ndarray
) -> LawValues:
    count = len(joints)
    return {
        "torque": scene.deviation[joints] * rng.uniform(0.05, 0.2, count),
        "reach": scene.swing[joints] * rng.uniform(0.15, 0.35, count),
    }


def _bend(plant: TrueArm, joints: np.ndarray, values: LawValues) -> None:
    plant.put("hysteresis", joints, values["torque"])
    plant.put("reach", joints, values["reach"])


def _uneven(
    rng: np.random.Generator, scene: LawContext, joints: np.ndarray
) -> LawValues:
    count = len(joints)
    return {
        "torque": scene.arm.coulomb[joints] * rng.uniform(0.5, 1.5, count),
        "cycles": rng.uniform(1.5, 5.0, count)
        / np.maximum(scene.swing[joints] / 2, 0.2),
        "phase": rng.uniform(-np.pi, np.pi, count),
    }


def _rough(plant: TrueArm, joints: np.ndarray, values: LawValues) -> None:
    """Dry friction c + A (1 + sin(n q + phi)) / 2, with c lowered by A / 2 as far as it goes: no more on average."""
    before = plant.values["coulomb"][joints]
    after = np.maximum(before, values["torque"])
    plant.put("coulomb", joints, after)
    plant.put("uneven", joints, np.minimum(values["torque"] / after, 0.95))
    plant.put("uneven_cycles", joints, values["cycles"])
    plant.put("uneven_phase", joints, values["phase"])


def _leak(rng: np.random.Generator, scene: LawContext, joints: np.ndarray) -> LawValues:
    before = np.roll(scene.deviation, 1)[joints]
    return {
        "share": sign(rng, len(joints))
        * rng.uniform(0.05, 0.2, len(joints))
        * scene.deviation[joints]
        / before
    }


def _couple(plant: TrueArm, joints: np.ndarray, values: LawValues) -> None:
    plant.put("leak", joints, values["share"])


def _shake(
    rng: np.random.Generator, scene: LawContext, joints: np.ndarray
) -> LawValues:
    way = rng.standard_normal(3)
    return {
        "acceleration": rng.uniform(0.2, 1.0) * way / np.linalg.norm(way),
        "frequency": np.array(rng.uniform(1.5, 9.0)),
        "phase": np.array(rng.uniform(-np.pi, np.pi)),
    }


def _vibrate(plant: TrueArm, joints: np.ndarray, values: LawValues) -> None:
    plant.shaken = (
        values["acceleration"],
        float(values["frequency"]),
        float(values["phase"]),
    )


def _hum(rng: np.random.Generator, scene: LawContext, joints: np.ndarray) -> LawValues:
    count = len(joints)
    return {
        "torque": scene.deviation[joints] * rng.uniform(0.05, 0.2, count),
        "frequency": np.full(count, rng.uniform(1.5, 9.0)),
        "phase": rng.uniform(-np.pi, np.pi, count),
    }


def _disturb(plant: TrueArm, joints: np.ndarray, values: LawValues) -> None:
    for name, value in (
        ("shake", "torque"),
        ("shake_frequency", "frequency"),
        ("shake_phase", "phase"),
    ):
        plant.put(name, joints, values[value])


def _fade(rng: np.random.Generator, scene: LawContext, joints: np.ndarray) -> LawValues:
    count = len(joints)
    return {
        "share": rng.uniform(0.1, 0.25, count),
        "time": np.full(count, rng.uniform(0.25, 0.5) * scene.shortest),
        "load": scene.deviation[joints] + 0.3 * scene.peak[joints],
    }


def _weaken(plant: TrueArm, joints: np.ndarray, values: LawValues) -> None:
    for name, value in (
        ("fade", "share"),
        ("fade_time", "time"),
        ("fade_load", "load"),
    ):
        plant.put(name, joints, values[value])


def _wall(rng: np.random.Generator, scene: LawContext, joints: np.ndarray) -> LawValues:
    way = rng.standard_normal(3)
    way /= np.linalg.norm(way)
    along = scene.tip @ way
    level = float(np.quantile(along, rng.uniform(0.8, 0.92)))
    depth = max(float(along.max()) - level, 0.01)
    return {
        "stiffness": np.array(rng.uniform(5.0, 20.0) / depth),
        "normal": way,
        "level": np.array(level),
    }


def _meet(plant: TrueArm, joints: np.ndarray, values: LawValues) -> None:
    normal, level, stiffness = (
        values["normal"],
        float(values["level"]),
        float(values["stiffness"]),
    )

    def pressed(t: float, place: np.ndarray, speed: np.ndarray) -> np.ndarray:
        """Hunt and Crossley [hunt1975]: -k x (1 + 0.3 dx) along the normal while the tip is x behind the wall."""
        depth = float(place @ normal) - level
        return (
            -normal * max(stiffness * depth * (1.0 + 0.3 * float(speed @ normal)), 0.0)
            if depth > 0
            else 0 * normal
        )

    outer: Outer = pressed
    plant.push = outer


def _one_sided(
    rng: np.random.Generator, scene: LawContext, joints: np.ndarray
) -> LawValues:
    drag = (scene.arm.coulomb + scene.arm.viscous)[joints]
    return {"coefficient": drag * rng.uniform(0.5, 2.0, len(joints))}


def _drag(plant: TrueArm, joints: np.ndarray, values: LawValues) -> None:
    plant.put("one_sided", joints, values["coefficient"])


OUTSIDE = (
    Law(
        "hysteresis",
        _bouc_wen,
        _bend,
        times("torque"),
        {"torque": "N m", "reach": "rad"},
        outside=True,
        form="Bouc-Wen",
    ),
    Law(
        "position_dependent_friction",
        _uneven,
        _rough,
        times("torque"),
        {"torque": "N m", "cycles": "1", "phase": "rad"},
        outside=True,
        form="dry friction that varies over a turn",
    ),
    Law(
        "joint_coupling",
        _leak,
        _couple,
        times("share"),
        {"share": "1"},
        joints="later",
        outside=True,
        form="torque of the joint before leaks in",
    ),
    Law(
        "base_vibration",
        _shake,
        _vibrate,
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
        _hum,
        _disturb,
        times("torque"),
        {"torque": "N m", "frequency": "Hz", "phase": "rad"},
        joints="one",
        outside=True,
        form="a sine over time",
    ),
    Law(
        "fading_torque_constant",
        _fade,
        _weaken,
        times("share"),
        {"share": "1", "time": "s", "load": "N m"},
        outside=True,
        largest={"share": 0.5},
        form="falls as the winding warms",
    ),
    Law(
        "contact",
        _wall,
        _meet,
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
        _one_sided,
        _drag,
        times("coefficient"),
        {"coefficient": "N m s^2/rad^2"},
        outside=True,
        form="quadratic, in one direction only",
    ),
)
"""The laws outside the catalogue."""
