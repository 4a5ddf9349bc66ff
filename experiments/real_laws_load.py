"""Laws of loads, friction and rotors for the benchmark of real arms: they add to the recorded torque.

Their forms are not the catalogue's. The true value of a parameter that only the catalogue's form has is the one with
which that form fits the injected torque best by least squares.
"""

from __future__ import annotations

import numpy as np
from real_scene import Law, Scene, Values, added, amount, no_values, on_joints
from scipy.optimize import curve_fit

from gapscope.arm.recording import Recording

SELF_LOCKED = 1e4
"""Torque at which a joint counts as locked by its own friction [N m]."""
LOAD_ROUNDS = 60
"""Times that friction and the torque which overcomes it are put into each other."""
BODY_SIZE = (0.03, 0.1)
"""Radius of gyration of an added body [m]."""


def sign(v: np.ndarray) -> np.ndarray:
    """The sign of a velocity as friction has it on average, tanh(v / 0.005 rad/s) [1]."""
    return np.tanh(v / 0.005)


def draw_coulomb(scene: Scene, rng: np.random.Generator, joints: np.ndarray) -> Values:
    """A step of a certain width, or one that differs between the directions by 15 %."""
    width = rng.uniform(0.01, 0.04) * scene.speed[joints]
    return {"width": width, "skew": float(rng.choice([0.0, 0.075, -0.075]))}


def coulomb(
    scene: Scene, recording: Recording, joints: np.ndarray, x: np.ndarray, drawn: Values
) -> tuple[Recording, Values]:
    """C (2 / pi) atan(v / w) (1 + skew sgn v)."""
    v = scene.dq[:, joints]
    step = 2 / np.pi * np.arctan(v / drawn["width"])
    torque = np.zeros_like(scene.dq)
    torque[:, joints] = x * step * (1 + drawn["skew"] * np.sign(v))
    # of the asymmetric one the mean over both directions
    form = sign(v)
    return added(recording, torque), {"torque": amount(form, torque[:, joints])}


def draw_viscous(scene: Scene, rng: np.random.Generator, joints: np.ndarray) -> Values:
    """The power of the speed."""
    return {"power": float(rng.choice([0.8, 0.9, 1.1, 1.2]))}


def viscous(
    scene: Scene, recording: Recording, joints: np.ndarray, x: np.ndarray, drawn: Values
) -> tuple[Recording, Values]:
    """B v0 (abs v / v0)^p sgn v, with v0 the RMS speed."""
    v, mean = scene.dq[:, joints], scene.speed[joints]
    torque = np.zeros_like(scene.dq)
    torque[:, joints] = x * mean * (np.abs(v) / mean) ** drawn["power"] * np.sign(v)
    return added(recording, torque), {"coefficient": amount(v, torque[:, joints])}


def draw_stribeck(scene: Scene, rng: np.random.Generator, joints: np.ndarray) -> Values:
    """The velocity at which half of it is gone."""
    velocity = rng.uniform(0.1, 0.5) * scene.speed[joints]
    return {"velocity": np.clip(velocity, 0.02, 2.9)}


def stribeck(
    scene: Scene, recording: Recording, joints: np.ndarray, x: np.ndarray, drawn: Values
) -> tuple[Recording, Values]:
    """D sgn v / (1 + (v / vs)^2); the catalogue has a Gaussian."""
    v, scale = scene.dq[:, joints], drawn["velocity"]
    torque = np.zeros_like(scene.dq)
    torque[:, joints] = x * sign(v) / (1 + (v / scale) ** 2)
    truth = {"torque": x, "velocity": scale}
    for k in range(len(joints)):

        def gauss(speed: np.ndarray, d: float, vs: float) -> np.ndarray:
            return d * np.exp(-((speed / vs) ** 2)) * sign(speed)

        start = (x[k], scale[k])
        found, _ = curve_fit(gauss, v[:, k], torque[:, joints[k]], start, maxfev=2000)
        truth["torque"] = np.append(truth["torque"][:k], [found[0], *x[k + 1 :]])
        truth["velocity"] = np.append(
            truth["velocity"][:k], [abs(found[1]), *scale[k + 1 :]]
        )
    return added(recording, torque), truth


def load_friction(
    scene: Scene, recording: Recording, joints: np.ndarray, x: np.ndarray, drawn: Values
) -> tuple[Recording, Values]:
    """Mu T (abs tau / T)^p tanh(v / w), T the mean load; tau, the motor's torque, overcomes this friction too."""
    without, v = scene.torque[:, joints], scene.dq[:, joints]
    mean = np.abs(without).mean(axis=0)
    direction = np.tanh(v / (0.02 * scene.speed[joints]))
    motor = without
    for _ in range(LOAD_ROUNDS):
        law = x * mean * (np.abs(motor) / mean) ** drawn["power"] * direction
        # a joint that locks itself has no finite torque, and is no case
        motor = np.clip(without + law, -SELF_LOCKED, SELF_LOCKED)
    torque = np.zeros_like(scene.dq)
    torque[:, joints] = law
    form = np.abs(motor) * sign(v)
    return added(recording, torque), {"coefficient": amount(form, law)}


def draw_drift(scene: Scene, rng: np.random.Generator, joints: np.ndarray) -> Values:
    """Time of the warm-up as a share of the recording, and its form."""
    form = str(rng.choice(["linear", "two exponentials"]))
    return {"share": float(rng.uniform(0.2, 0.6)), "form": form}


def drift(
    scene: Scene, recording: Recording, joints: np.ndarray, x: np.ndarray, drawn: Values
) -> tuple[Recording, Values]:
    """Friction of the identified arm times a warm-up: linear to zero, or two exponentials."""
    t, v, arm = recording.t, scene.dq, scene.truth
    time = drawn["share"] * recording.duration
    fade = 0.7 * np.exp(-t / (0.6 * time)) + 0.3 * np.exp(-t / (2 * time))
    if drawn["form"] == "linear":
        fade = np.clip(1 - t / (2 * time), 0.0, 1.0)
    friction = arm.coulomb * sign(v) + arm.viscous * v
    torque = on_joints(friction * fade[:, None], joints)
    torque[:, joints] *= x

    def exponential(at: np.ndarray, a: float, constant: float) -> np.ndarray:
        return a * np.exp(-at / constant)

    (height, constant), _ = curve_fit(exponential, t, fade, (1.0, time), maxfev=2000)
    constants = np.full(len(joints), constant)
    return added(recording, torque), {
        "amplitude": x * height,
        "time_constant": constants,
    }


def draw_payload(scene: Scene, rng: np.random.Generator, joints: np.ndarray) -> Values:
    """Centre of mass [m] and radius of gyration about each axis [m]."""
    return {"com": rng.uniform(-0.1, 0.1, 3), "gyration": rng.uniform(*BODY_SIZE, 3)}


def payload(
    scene: Scene, recording: Recording, joints: np.ndarray, x: np.ndarray, drawn: Values
) -> tuple[Recording, Values]:
    """A body on the last link, with rotational inertia of its own."""
    mass, c = float(x), drawn["com"]
    own = np.diag(mass * drawn["gyration"] ** 2)
    body = ten_parameters(mass, c, own)
    increments = np.zeros((scene.n, 10))
    increments[scene.nominal_body.last_link] = body
    torque = changed_bodies(scene, increments)
    truth = {"mass": mass, "com": c}
    return added(recording, torque, link_side=True), truth


def ten_parameters(mass: float, com: np.ndarray, inertia: np.ndarray) -> np.ndarray:
    """Inertial parameters in pinocchio's order, (10,), of a body with an inertia about its centre [kg m^2], (3, 3)."""
    about = inertia + mass * (com @ com * np.eye(3) - np.outer(com, com))
    moments = about[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]
    return np.concatenate([[mass], mass * com, moments])


def changed_bodies(scene: Scene, increments: np.ndarray) -> np.ndarray:
    """Torque by which other bodies differ from the nominal ones [N m], (N, n); increments (n, 10)."""
    body = scene.nominal_body
    return scene.rigid(body.changed(increments)) - scene.rigid(body)


def draw_link(scene: Scene, rng: np.random.Generator, joints: np.ndarray) -> Values:
    """A link between the first and the last, and the shift of its centre [m]."""
    link = int(rng.integers(1, scene.n - 1))
    return {"link": link, "com": rng.uniform(-0.02, 0.02, 3)}


def link_inertia(
    scene: Scene, recording: Recording, joints: np.ndarray, x: np.ndarray, drawn: Values
) -> tuple[Recording, Values]:
    """A link of another size at the same density: its inertia grows with the power 5/3 of its mass."""
    place = drawn["link"]
    own = scene.nominal_body.model.inertias[int(scene.nominal_body.links[place])]
    mass = own.mass + float(x)
    growth = (max(mass, 1e-3) / max(own.mass, 1e-3)) ** (5 / 3)
    new = ten_parameters(
        mass, own.lever + drawn["com"], np.asarray(own.inertia) * growth
    )
    increments = np.zeros((scene.n, 10))
    increments[place] = new - own.toDynamicParameters()
    truth = {"link": place + 1, "mass": float(x), "com": drawn["com"]}
    torque = changed_bodies(scene, increments)
    return added(recording, torque, link_side=True), truth


def armature(
    scene: Scene, recording: Recording, joints: np.ndarray, x: np.ndarray, drawn: Values
) -> tuple[Recording, Values]:
    """I a, of the acceleration of the benchmark's own filter."""
    torque = on_joints(scene.ddq, joints)
    torque[:, joints] *= x
    return added(recording, torque), {"inertia": x}


LAWS = (
    Law("coulomb_friction", "atan of a width, or 15 % between the directions", 1, draw_coulomb, coulomb, 1.0, "torque"),
    Law("viscous_friction", "power 0.8 to 1.2 of the speed", 1, draw_viscous, viscous, 1.0, "coefficient"),
    Law("stribeck_friction", "1 / (1 + (v / vs)^2)", 1, draw_stribeck, stribeck, 1.0, "torque"),
    Law("load_friction", "power 0.8 to 1.2 of the load", 1, draw_viscous, load_friction, 0.1, "coefficient"),
    Law("friction_drift", "linear, or two exponentials", 1, draw_drift, drift, 0.5, "amplitude"),
    Law("payload", "a body with its own rotational inertia", 0, draw_payload, payload, 1.0, "mass", "arm"),
    Law("link_inertia", "inertia by the power 5/3 of the mass", 0, draw_link, link_inertia, 0.5, "mass", "arm", True),
    Law("armature", "another filter of the acceleration", 1, no_values, armature, 0.3, "inertia"),
)  # fmt: skip
"""The laws."""
