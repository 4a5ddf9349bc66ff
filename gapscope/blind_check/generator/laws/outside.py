"""Causes that no effect of the catalogue describes; a diagnosis should answer ``unexplained``."""

from __future__ import annotations

import numpy as np

from gapscope.blind_check.generator.law import Draws, Law, LawValues, puts, times
from gapscope.blind_check.generator.true_arm import TrueArm


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
        "frequency": np.array(rng.uniform(1.5, 9.0)),
        "phase": np.array(rng.uniform(-np.pi, np.pi)),
    }


def _shake(plant: TrueArm, joints: np.ndarray, values: LawValues) -> None:
    frequency, phase = float(values["frequency"]), float(values["phase"])
    plant.shaken = values["acceleration"], frequency, phase


def _contact(draws: Draws) -> LawValues:
    rng = draws.rng
    way = rng.standard_normal(3)
    way /= np.linalg.norm(way)
    along = draws.tip @ way
    level = float(np.quantile(along, rng.uniform(0.8, 0.92)))
    depth = max(float(along.max()) - level, 0.01)
    return {
        "stiffness": np.array(rng.uniform(5.0, 20.0) / depth),
        "normal": way,
        "level": np.array(level),
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


OUTSIDE = (
    Law(
        "hysteresis",
        lambda draws: {
            "torque": draws.deviation * draws.uniform(0.05, 0.2),
            "reach": draws.swing * draws.uniform(0.15, 0.35),
        },
        puts(hysteresis="torque", reach="reach"),
        times("torque"),
        {"torque": "N m", "reach": "rad"},
        outside=True,
        form="Bouc-Wen",
    ),
    Law(
        "position_dependent_friction",
        lambda draws: {
            "torque": draws.coulomb * draws.uniform(0.5, 1.5),
            "cycles": draws.uniform(1.5, 5.0) / np.maximum(draws.swing / 2, 0.2),
            "phase": draws.uniform(-np.pi, np.pi),
        },
        _uneven,
        times("torque"),
        {"torque": "N m", "cycles": "1", "phase": "rad"},
        outside=True,
        form="dry friction that varies over a turn",
    ),
    Law(
        "joint_coupling",
        _coupling,
        puts(leak="share"),
        times("share"),
        {"share": "1"},
        joints="later",
        outside=True,
        form="torque of the joint before leaks in",
    ),
    Law(
        "base_vibration",
        _vibration,
        _shake,
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
        lambda draws: {
            "torque": draws.deviation * draws.uniform(0.05, 0.2),
            "frequency": draws.common(1.5, 9.0),
            "phase": draws.uniform(-np.pi, np.pi),
        },
        puts(shake="torque", shake_frequency="frequency", shake_phase="phase"),
        times("torque"),
        {"torque": "N m", "frequency": "Hz", "phase": "rad"},
        joints="one",
        outside=True,
        form="a sine over time",
    ),
    Law(
        "fading_torque_constant",
        lambda draws: {
            "share": draws.uniform(0.1, 0.25),
            "time": draws.common(0.25, 0.5) * draws.shortest,
            "load": draws.deviation + 0.3 * draws.peak,
        },
        puts(fade="share", fade_time="time", fade_load="load"),
        times("share"),
        {"share": "1", "time": "s", "load": "N m"},
        outside=True,
        largest={"share": 0.5},
        form="falls as the winding warms",
    ),
    Law(
        "contact",
        _contact,
        _press,
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
        lambda draws: {
            "coefficient": (draws.coulomb + draws.viscous) * draws.uniform(0.5, 2.0)
        },
        puts(one_sided="coefficient"),
        times("coefficient"),
        {"coefficient": "N m s^2/rad^2"},
        outside=True,
        form="quadratic, in one direction only",
    ),
)
"""The laws outside the catalogue."""
