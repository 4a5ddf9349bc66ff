"""Rigid bodies: load, one link off, rotor, a base that is not level [hollerbach2008]."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from gapscope.blind_check.generator.law import Law, LawContext, LawValues, sign, times
from gapscope.blind_check.generator.plant import TrueArm
from gapscope.blind_check.generator.urdf import (
    Inertial,
    added,
    inertial_of,
    moved_links,
    set_inertial,
)


def _payload(
    rng: np.random.Generator, scene: LawContext, joints: np.ndarray
) -> LawValues:
    com = np.array(
        [rng.uniform(-0.04, 0.04), rng.uniform(-0.04, 0.04), rng.uniform(-0.01, 0.1)]
    )
    mass = np.array(scene.arm.payload * rng.uniform(0.2, 0.9))
    radius = np.array(rng.choice([0.0, 0.03, 0.06]))
    return {"mass": mass, "com": com, "radius": radius, "top": mass / scene.arm.payload}


def _add_payload(plant: TrueArm, joints: np.ndarray, values: LawValues) -> None:
    link = moved_links(plant.root)[-1]
    mass, radius = float(values["mass"]), float(values["radius"])
    load = Inertial(mass, values["com"], 0.4 * mass * radius**2 * np.eye(3))
    set_inertial(link, added(inertial_of(link), load))


def _link(rng: np.random.Generator, scene: LawContext, joints: np.ndarray) -> LawValues:
    link = int(rng.integers(2, max(scene.arm.n, 3)))
    body = inertial_of(moved_links(scene.arm.root)[link - 1])
    share = float(sign(rng, 1)[0] * rng.uniform(0.1, 0.3))
    way = 0.5 * abs(share) * max(float(np.linalg.norm(body.com)), 0.04)
    turn = rng.standard_normal(3)
    return {
        "link": np.array(link),
        "mass": np.array(share * body.mass),
        "com": way * turn / np.linalg.norm(turn),
        "share": np.array(share),
    }


def _add_link(plant: TrueArm, joints: np.ndarray, values: LawValues) -> None:
    link = moved_links(plant.root)[int(values["link"]) - 1]
    body = inertial_of(link)
    mass = body.mass + float(values["mass"])
    set_inertial(
        link, Inertial(mass, body.com + values["com"], body.inertia * mass / body.mass)
    )


def _armature(
    rng: np.random.Generator, scene: LawContext, joints: np.ndarray
) -> LawValues:
    share = rng.uniform(0.2, 0.8, len(joints))
    return {"inertia": scene.arm.armature[joints] * share, "share": share}


def _add_armature(plant: TrueArm, joints: np.ndarray, values: LawValues) -> None:
    plant.add("armature", joints, values["inertia"])


def _tilt(rng: np.random.Generator, scene: LawContext, joints: np.ndarray) -> LawValues:
    angle, way = np.radians(rng.uniform(0.5, 4.0)), rng.uniform(0, 2 * np.pi)
    return {
        "roll": np.array(angle * np.cos(way)),
        "pitch": np.array(angle * np.sin(way)),
    }


def _tilted(plant: TrueArm, joints: np.ndarray, values: LawValues) -> None:
    turn = Rotation.from_euler(
        "xy", [float(values["roll"]), float(values["pitch"])]
    )  # first x, then y, fixed axes
    plant.gravity = turn.inv().apply(plant.gravity)


BODY = (
    Law(
        "payload",
        _payload,
        _add_payload,
        times("mass", "top"),
        {"mass": "kg", "com": "m"},
        joints="arm",
        largest={"top": 1.5},
        own=False,
        form="a ball of finite radius",
    ),
    Law(
        "link_inertia",
        _link,
        _add_link,
        times("mass", "com", "share"),
        {"link": "1", "mass": "kg", "com": "m"},
        joints="arm",
        largest={"share": 0.6},
        own=False,
        form="the rigid body itself is changed",
    ),
    Law(
        "armature",
        _armature,
        _add_armature,
        times("inertia", "share"),
        {"inertia": "kg m^2"},
        largest={"share": 2.0},
        form="a rotor of its own",
    ),
    Law(
        "base_tilt",
        _tilt,
        _tilted,
        times("roll", "pitch"),
        {"roll": "rad", "pitch": "rad"},
        joints="arm",
        largest={"roll": 0.2, "pitch": 0.2},
        own=False,
        form="gravity turned in the simulator",
    ),
)
"""The laws of rigid bodies."""
