"""The laws of the generator, by family, and all of them by name."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.spatial.transform import Rotation

from gapscope.blind_check.generator.arms import (
    Inertial,
    added,
    inertial_of,
    moved_links,
    set_inertial,
    shifted,
)
from gapscope.blind_check.generator.law import (
    Act,
    Draws,
    Law,
    LawValues,
    adds,
    puts,
)
from gapscope.blind_check.generator.true_arm import Columns, TrueArm

# Friction: LuGre with a Stribeck curve, load inside it, warming by its own losses [armstrong1994, bittencourt2012].


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


FRICTION = (
    Law(
        "coulomb_friction",
        lambda draws: {"torque": draws.coulomb * draws.uniform(0.8, 2.0)},
        adds(coulomb="torque"),
        {"torque": "N m"},
        form="LuGre: bristles bend before the joint slides",
    ),
    Law(
        "viscous_friction",
        lambda draws: {"coefficient": draws.viscous * draws.uniform(0.8, 3.0)},
        adds(viscous="coefficient"),
        {"coefficient": "N m s/rad"},
        form="b |v|^a sgn v with a in 0.94 .. 1",
    ),
    Law(
        "stribeck_friction",
        lambda draws: {
            "torque": draws.coulomb * draws.uniform(0.8, 2.0),
            "velocity": draws.speed * draws.uniform(0.15, 0.6),
            "power": draws.uniform(1.8, 2.2),
        },
        puts(fall="torque", fall_speed="velocity", fall_power="power"),
        {"torque": "N m", "velocity": "rad/s"},
        form="inside LuGre, exp(-(|v| / vs)^p) with p in 1.8 .. 2.2",
    ),
    Law(
        "saturating_friction",
        lambda draws: {
            "torque": draws.coulomb * draws.uniform(0.8, 2.0),
            "velocity": draws.speed * draws.uniform(0.3, 0.8),
            "power": draws.uniform(1.4, 3.0),
        },
        puts(level="torque", level_speed="velocity", level_power="power"),
        {"torque": "N m", "velocity": "rad/s"},
        form="d v / (|v|^p + w^p)^(1 / p) with p in 1.4 .. 3",
    ),
    Law(
        "load_friction",
        lambda draws: {"coefficient": draws.uniform(0.05, 0.15)},
        puts(load="coefficient"),
        {"coefficient": "1"},
        largest={"coefficient": 0.35},
        form="inside LuGre, on the torque behind the motor",
    ),
    Law(
        "friction_drift",
        _drift,
        puts(
            drift="amplitude",
            drift_time="time_constant",
            drift_share="share",
            drift_power="power",
        ),
        {"amplitude": "1", "time_constant": "s"},
        largest={"amplitude": 3.0},
        form="a joint that warms by its own losses, friction curved in temperature",
    ),
)
"""The laws of friction."""


# Rigid bodies: load, one link off, rotor, a base that is not level [hollerbach2008].


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


def _armature(draws: Draws) -> LawValues:
    share = draws.uniform(0.2, 0.8)
    return {"inertia": draws.armature * share, "share": share}


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


BODY = (
    Law(
        "payload",
        _payload,
        _apply_payload,
        {"mass": "kg", "com": "m"},
        powers={"mass": 1, "top": 1},
        joints="arm",
        largest={"top": 1.5},
        own=False,
        form="a ball of finite radius",
    ),
    Law(
        "link_inertia",
        _link,
        _apply_link,
        {"link": "1", "mass": "kg", "com": "m"},
        powers={"mass": 1, "com": 1, "share": 1},
        joints="arm",
        largest={"share": 0.6},
        own=False,
        form="the rigid body itself is changed",
    ),
    Law(
        "armature",
        _armature,
        adds(armature="inertia"),
        {"inertia": "kg m^2"},
        powers={"inertia": 1, "share": 1},
        largest={"share": 2.0},
        form="a rotor of its own",
    ),
    Law(
        "base_tilt",
        _tilt,
        _apply_tilt,
        {"roll": "rad", "pitch": "rad"},
        powers={"roll": 1, "pitch": 1},
        joints="arm",
        largest={"roll": 0.2, "pitch": 0.2},
        own=False,
        form="gravity turned in the simulator",
    ),
)
"""The laws of rigid bodies."""


# Transmission: two masses with a hardening spring, free play, cogging, a dress pack [deluca2016, tuttle1996].

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


TRANSMISSION = (
    Law(
        "joint_elasticity",
        _elasticity,
        puts(stiffness="stiffness", damping="damping", hardening="hardening"),
        {"stiffness": "N m/rad", "damping": "N m s/rad"},
        # a spring that yields that many times as far, with the same damping ratio
        powers={"stiffness": -1, "damping": -0.5, "hardening": -2, "frequency": -0.5},
        joints="inner",
        largest={"frequency": -3.0},
        own=False,
        form="two masses, the spring hardens with its twist",
    ),
    Law(
        "backlash",
        _backlash,
        puts(play="half", stiffness="stiffness", damping="damping"),
        {"width": "rad"},
        powers={"width": 1, "half": 1},
        joints="inner",
        largest={"width": 0.06},
        own=False,
        form="two masses, teeth of finite stiffness that meet with an impact",
    ),
    Law(
        "torque_ripple",
        lambda draws: {
            "amplitude": draws.deviation * draws.uniform(0.05, 0.15),
            "cycles": draws.rng.integers(4, 31, len(draws.joints)).astype(float),
            "phase": draws.uniform(-np.pi, np.pi),
            "harmonic": draws.common(0.02, 0.08),
        },
        puts(ripple="amplitude", cycles="cycles", phase="phase", harmonic="harmonic"),
        {"amplitude": "N m", "cycles": "1", "phase": "rad"},
        form="cogging with a second harmonic",
    ),
    Law(
        "parallel_spring",
        _spring,
        puts(spring="stiffness", rest="rest", cubic="cubic"),
        {"stiffness": "N m/rad", "rest": "rad"},
        powers={"stiffness": 1, "share": 1},
        largest={"share": 4.0},
        form="slightly cubic",
    ),
)
"""The laws of the transmission."""


# The motor: torque constant, bias, current clamp, dead time, current loop [gautier2014, hwangbo2019].


def _saturation(draws: Draws) -> LawValues:
    share = draws.uniform(0.65, 0.85)
    slope = draws.common(0.0, 0.03)
    return {"limit": share * draws.peak, "slope": slope, "share": share}


def _envelope(draws: Draws) -> LawValues:
    # the mean square speed is a third of the largest one, about
    no_load = draws.uniform(2.6, 3.6) * draws.speed
    corner = draws.uniform(0.2, 0.5) * no_load
    share = draws.uniform(0.7, 0.95)
    limit = share * draws.peak
    return {
        "limit": limit,
        "corner_speed": corner,
        "no_load_speed": no_load,
        "stall": limit * no_load / (no_load - corner),
        "share": share,
    }


VARIANTS = {
    "torque_speed_limit": Law(
        "torque_saturation",
        _envelope,
        puts(clamp="limit", stall="stall", no_load="no_load_speed"),
        {"limit": "N m", "corner_speed": "rad/s", "no_load_speed": "rad/s"},
        powers={"limit": -1, "stall": -1, "share": -1},
        joints="one",
        largest={"share": -0.4},
        form="a line of the voltage, rounded off where it meets the current clamp",
    )
}
"""Further laws of effects of the catalogue, which sealed sets do not draw."""


ACTUATION = (
    Law(
        "torque_scale",
        lambda draws: {
            "scale": draws.sign() * draws.uniform(0.07, 0.2),
            "iron": draws.uniform(0.0, 0.03),
            "peak": 1.5 * draws.peak,
        },
        puts(scale="scale", iron="iron", peak="peak"),
        {"scale": "1"},
        largest={"scale": 0.45},
        form="the torque constant falls a little with current",
    ),
    Law(
        "torque_offset",
        lambda draws: {
            "torque": draws.sign() * draws.uniform(0.05, 0.3) * draws.deviation
        },
        puts(offset="torque"),
        {"torque": "N m"},
        form="a bias of the current sensor",
    ),
    Law(
        "torque_saturation",
        _saturation,
        puts(clamp="limit", clamp_slope="slope"),
        {"limit": "N m"},
        powers={"limit": -1, "share": -1},
        largest={"share": -0.4},
        form="a clamp that falls with speed (back-EMF)",
    ),
    Law(
        "actuator_lag",
        lambda draws: {
            "time_constant": draws.uniform(0.003, 0.01),
            "second": np.full(len(draws.joints), float(draws.rng.integers(0, 2))),
        },
        puts(lag="time_constant", second="second"),
        {"time_constant": "s"},
        largest={"time_constant": 0.025},
        form="a current loop of first order, or of second with two equal poles",
    ),
    Law(
        "actuator_delay",
        lambda draws: {"delay": draws.uniform(0.003, 0.009)},
        puts(delay="delay"),
        {"delay": "s"},
        largest={"delay": 0.025},
        form="a dead time in whole steps of the drive",
    ),
)
"""The laws of the motor."""


# Encoders and the outer world: offset with eccentricity, coarse steps, a push [haddadin2017].


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


SENSING = (
    Law(
        "encoder_offset",
        lambda draws: {
            "offset": draws.sign() * draws.uniform(0.015, 0.06),
            "eccentric": draws.common(0.0, 0.05),
        },
        puts(encoder="offset", eccentric="eccentric"),
        {"offset": "rad"},
        joints="middle",
        largest={"offset": 0.2},
        own=False,
        form="with eccentricity, delta (1 + e sin q)",
    ),
    Law(
        "encoder_quantization",
        lambda draws: {"step": draws.whole.encoder_step * draws.common(3.0, 20.0)},
        puts(step="step"),
        {"step": "rad"},
        largest={"step": 0.02},
        own=False,
        measure="step",
        form="noise comes before the rounding, the controller sees it too",
    ),
    Law(
        "external_force",
        _force,
        _push,
        {"force": "N", "start": "s", "end": "s"},
        joints="arm",
        largest={"force": 300.0},
        own=False,
        form="grows and fades smoothly, on MuJoCo's body",
    ),
)
"""The laws of sensing and of the outer world."""


# Faults of the set-up: the recording, or the nominal URDF, differs from its description.

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


FAULTS = (
    Law(
        "sign_flip",
        lambda draws: {},
        _torque(lambda torque, joints: -torque[:, joints]),
        joints="one",
        measure="none",
        form="torque of a joint turned round",
    ),
    Law(
        "joint_swap",
        lambda draws: {},
        _torque(lambda torque, joints: torque[:, joints[::-1]]),
        joints="pair",
        measure="none",
        form="torque of two joints exchanged",
    ),
    Law(
        "unit_mismatch",
        lambda draws: {
            "unit": draws.rng.choice(UNITS),
            "ratio": float(draws.rng.integers(50, 161)),
        },
        _apply_unit,
        {"unit": ""},
        joints="all",
        measure="none",
        form="degrees, milliseconds, or the motor's side of the gear",
    ),
    Law(
        "shifted_inertials",
        lambda draws: {},
        _apply_shift,
        joints="arm",
        measure="none",
        form="in the URDF that the user believes",
    ),
    Law(
        "time_stamps",
        _stamps,
        _apply_stamps,
        {"kind": "", "amount": "1"},
        joints="arm",
        measure="none",
        form="stretches lost, samples repeated, jitter, or a wrong rate",
    ),
)
"""The faults of the set-up."""


# Causes that no effect of the catalogue describes; a diagnosis should answer ``unexplained``.


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


OUTSIDE = (
    Law(
        "hysteresis",
        lambda draws: {
            "torque": draws.deviation * draws.uniform(0.05, 0.2),
            "reach": draws.swing * draws.uniform(0.15, 0.35),
        },
        puts(hysteresis="torque", reach="reach"),
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
        {"torque": "N m", "cycles": "1", "phase": "rad"},
        outside=True,
        form="dry friction that varies over a turn",
    ),
    Law(
        "joint_coupling",
        _coupling,
        puts(leak="share"),
        {"share": "1"},
        joints="later",
        outside=True,
        form="torque of the joint before leaks in",
    ),
    Law(
        "base_vibration",
        _vibration,
        _shake,
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
        {"torque": "N m", "frequency": "Hz", "phase": "rad"},
        joints="one",
        outside=True,
        form="a sine over time",
    ),
    Law(
        "fading_torque_constant",
        lambda draws: {
            "share": draws.uniform(0.1, 0.25),
            "time": draws.common(0.25, 0.5) * draws.whole.shortest,
            "load": draws.deviation + 0.3 * draws.peak,
        },
        puts(fade="share", fade_time="time", fade_load="load"),
        {"share": "1", "time": "s", "load": "N m"},
        outside=True,
        largest={"share": 0.5},
        form="falls as the winding warms",
    ),
    Law(
        "contact",
        _contact,
        _press,
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
        {"coefficient": "N m s^2/rad^2"},
        outside=True,
        form="quadratic, in one direction only",
    ),
)
"""The laws outside the catalogue."""


# All of them

LAWS = {
    law.name: law
    for law in (
        *FRICTION,
        *BODY,
        *TRANSMISSION,
        *ACTUATION,
        *SENSING,
        *FAULTS,
        *OUTSIDE,
    )
}
INSIDE = tuple(
    law.name for law in (*FRICTION, *BODY, *TRANSMISSION, *ACTUATION, *SENSING)
)
"""Names of the effects that are in the catalogue."""
SETUP = tuple(law.name for law in FAULTS)
"""Names of the faults of the set-up."""
BEYOND = tuple(law.name for law in OUTSIDE)
"""Names of the laws outside the catalogue."""
