"""Rigid bodies: load, one link off, rotor, a base that is not level [hollerbach2008]."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from gapscope.blind_check.generator.arms import (
    Inertial,
    added,
    inertial_of,
    moved_links,
    set_inertial,
)
from gapscope.blind_check.generator.law import Draws, Law, LawValues, adds, times
from gapscope.blind_check.generator.true_arm import TrueArm


def _payload(draws: Draws) -> LawValues:
    rng, largest = draws.rng, draws.arm.payload
    x, y, z = (rng.uniform(*r) for r in ((-0.04, 0.04), (-0.04, 0.04), (-0.01, 0.1)))
    com = np.array([x, y, z])
    mass = np.array(largest * rng.uniform(0.2, 0.9))
    radius = np.array(rng.choice([0.0, 0.03, 0.06]))
    return {"mass": mass, "com": com, "radius": radius, "top": mass / largest}


def _apply_payload(plant: TrueArm, joints: np.ndarray, values: LawValues) -> None:
    link = moved_links(plant.root)[-1]
    mass, radius = float(values["mass"]), float(values["radius"])
    ball = 0.4 * mass * radius**2 * np.eye(3)
    load = Inertial(mass, values["com"], ball)
    set_inertial(link, added(inertial_of(link), load))


def _link(draws: Draws) -> LawValues:
    rng, arm = draws.rng, draws.arm
    link = int(rng.integers(2, max(arm.n, 3)))
    body = inertial_of(moved_links(arm.root)[link - 1])
    share = float(rng.choice([-1.0, 1.0], 1)[0] * rng.uniform(0.1, 0.3))
    distance = max(float(np.linalg.norm(body.com)), 0.04)
    shift = 0.5 * abs(share) * distance
    direction = rng.standard_normal(3)
    return {
        "link": np.array(link),
        "mass": np.array(share * body.mass),
        "com": shift * direction / np.linalg.norm(direction),
        "share": np.array(share),
    }


def _apply_link(plant: TrueArm, joints: np.ndarray, values: LawValues) -> None:
    link = moved_links(plant.root)[int(values["link"]) - 1]
    body = inertial_of(link)
    mass = body.mass + float(values["mass"])
    com = body.com + values["com"]
    inertia = body.inertia * mass / body.mass  # the same radii of gyration
    set_inertial(link, Inertial(mass, com, inertia))


def _armature(draws: Draws) -> LawValues:
    share = draws.uniform(0.2, 0.8)
    return {"inertia": draws.armature * share, "share": share}


def _tilt(draws: Draws) -> LawValues:
    angle = np.radians(draws.rng.uniform(0.5, 4.0))
    direction = draws.rng.uniform(0, 2 * np.pi)
    return {
        "roll": np.array(angle * np.cos(direction)),
        "pitch": np.array(angle * np.sin(direction)),
    }


def _apply_tilt(plant: TrueArm, joints: np.ndarray, values: LawValues) -> None:
    angles = [float(values["roll"]), float(values["pitch"])]
    turn = Rotation.from_euler("xy", angles)  # first x, then y, fixed axes
    plant.gravity = turn.inv().apply(plant.gravity)


BODY = (
    Law(
        "payload",
        _payload,
        _apply_payload,
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
        _apply_link,
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
        adds(armature="inertia"),
        times("inertia", "share"),
        {"inertia": "kg m^2"},
        largest={"share": 2.0},
        form="a rotor of its own",
    ),
    Law(
        "base_tilt",
        _tilt,
        _apply_tilt,
        times("roll", "pitch"),
        {"roll": "rad", "pitch": "rad"},
        joints="arm",
        largest={"roll": 0.2, "pitch": 0.2},
        own=False,
        form="gravity turned in the simulator",
    ),
)
"""The laws of rigid bodies."""
