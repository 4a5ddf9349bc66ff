"""The environment family: the base of the arm, and forces from outside."""

from __future__ import annotations

import numpy as np

from gapscope.effects.arm_scale import ArmScale
from gapscope.effects.effect import External, Turn
from gapscope.effects.parameter import Parameter
from gapscope.effects.parametrisation import Parametrisation, Values


def tilt(roll: float, pitch: float) -> np.ndarray:
    """R = Ry(pitch) Rx(roll), from base to world frame, shape (3, 3); angles in rad."""
    (cr, sr), (cp, sp) = (
        (np.cos(float(angle)), np.sin(float(angle))) for angle in (roll, pitch)
    )
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, cr, -sr], [0.0, sr, cr]])
    about_y = np.array([[cp, 0.0, sp], [0.0, 1.0, 0.0], [-sp, 0.0, cp]])
    return about_y @ about_x


def acts(t: np.ndarray | float, start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """1 from start to end, 0 elsewhere; times in s."""
    # the end is not in it: two forces in a row do not add up at one sample
    return ((np.asarray(t) >= start) & (np.asarray(t) < end)).astype(float)


def tilt_values(x: np.ndarray, nonlinear: np.ndarray) -> Values:
    """Roll = x0, pitch = x1, within a turn."""
    # an angle beyond half a turn is the same roll, from the other side
    roll = np.where(
        np.abs(x[0]) > np.pi, np.remainder(x[0] + np.pi, 2 * np.pi) - np.pi, x[0]
    )
    return {"roll": roll, "pitch": x[1]}


def clip_tilt(x: np.ndarray) -> np.ndarray:
    """Roll within a turn either way, pitch in its bounds: a fit may pass from an arm that hangs to the other side."""
    return np.vstack(
        [np.clip(x[0], -2 * np.pi, 2 * np.pi), np.clip(x[1], *PITCH.bounds)]
    )


def draw_tilt(rng: np.random.Generator, scale: ArmScale, j: np.ndarray) -> Values:
    """0.5 to 5 degrees in any direction."""
    angle = np.deg2rad(rng.uniform(0.5, 5.0))
    direction = rng.uniform(-np.pi, np.pi)
    return {"roll": angle * np.cos(direction), "pitch": angle * np.sin(direction)}


def draw_force(rng: np.random.Generator, scale: ArmScale, j: np.ndarray) -> Values:
    """20 to 60 % of the weight that the arm may carry, in any direction, for 0.5 to 3.5 s."""
    # three normal numbers prefer no direction
    direction = rng.standard_normal(3)
    start = rng.uniform(1.0, 4.0)
    size = 9.81 * scale.lift * rng.uniform(0.2, 0.6)
    return {
        "force": size * direction / np.linalg.norm(direction),
        "start": np.array(start),
        "end": np.array(start + rng.uniform(0.5, 3.0)),
    }


# a load that is not yet in a fit bends an arm on a wall beyond the right angle; with the load it comes back
PITCH = Parameter("pitch", "theta", "rad", (-3.15, 3.15), (-0.0873, 0.0873))

BASE_TILT = Turn(
    name="base_tilt",
    family="environment",
    scope="arm",
    equation="gravity in the base frame = R^T g, R = Ry(pitch) Rx(roll)",
    parameters=(
        Parameter("roll", "phi", "rad", (-3.15, 3.15), (-0.0873, 0.0873)),
        PITCH,
    ),
    looks_like="a gravity torque on a joint with a vertical axis",
    reference="hollerbach2008",
    confused_with=(
        ("encoder_offset", "static poses turned about the first joint"),
        ("torque_offset", "static poses turned about the first joint"),
    ),
    rotation=tilt,
    parametrisation=Parametrisation(
        tilt_values, linear=2, clip=clip_tilt, usual=0.0873
    ),
    severity=draw_tilt,
    quantities={"roll": "gravity", "pitch": "gravity"},
)

EXTERNAL_FORCE = External(
    name="external_force",
    family="environment",
    scope="arm",
    equation="recorded = nominal - J^T f between start and end",
    parameters=(
        Parameter("force", "f", "N", (-1e4, 1e4), (-50.0, 50.0), size=3),
        Parameter("start", "t0", "s", (-1e6, 1e6), (1.0, 5.0), severity=0),
        Parameter("end", "t1", "s", (-1e6, 1e6), (5.0, 10.0), severity=0),
    ),
    looks_like="a gap on several joints within one interval of time",
    reference="haddadin2017",
    confused_with=(("payload", "the same motion once more, with nobody near"),),
    active=acts,
    parametrisation=Parametrisation(
        lambda x, times: {"force": x, "start": times[0], "end": times[1]},
        linear=3,
        nonlinear=("start", "end"),
        # in any direction as large, wherever it moves a torque
        proportions=(1.0, 1.0, 1.0),
    ),
    severity=draw_force,
    quantities={"force": "contact", "start": "contact", "end": "contact"},
    without="it belongs to the recording in which it acted",
)
