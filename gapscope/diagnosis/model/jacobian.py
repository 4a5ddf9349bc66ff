"""How the recorded torque changes with the linear coordinates of every term, on one segment.

Most effects on a joint change the torque of that joint alone; their columns are finite differences of the corrected
arm. What moves or loads the bodies changes the torque of all joints, by the derivatives of the inverse dynamics.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.known_load import point_mass_parameters
from gapscope.arm.motions.motion import Motion
from gapscope.diagnosis.model.terms import Terms, parametrisation_of
from gapscope.diagnosis.thresholds import BACKLASH_START
from gapscope.effects.catalogue import effect as by_name
from gapscope.effects.catalogue import explained
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.deflection import play_columns
from gapscope.effects.effect import Effect, Path, Transmission
from gapscope.effects.environment import acts, tilt
from gapscope.effects.rigid_body import link_change
from gapscope.effects.series import slow_with_rates
from gapscope.ident.signals.conditioning import Segment

DERIVED = (
    "payload",
    "link_inertia",
    "base_tilt",
    "external_force",
    "encoder_offset",
    "joint_elasticity",
    "backlash",
)
"""Effects that reach other joints and whose columns are derived here; those of others are finite differences."""


@dataclass(frozen=True)
class Bodies:
    """What the columns of a segment need of its bodies whatever the parameters are, N samples.

    Attributes:
        gravity: G with g(q) = G g, shape (N, n, 3); kg m.
        force: J^T of the last link's centre of mass, shape (N, n, 3); m.
        last: regressor of the last link, shape (N, n, 10).
        play: torque from a little free play on each joint, per radian, shape (N, n, n).
    """

    gravity: np.ndarray
    force: np.ndarray
    last: np.ndarray
    play: np.ndarray

    @classmethod
    def of(cls, body: RigidBody, segment: Segment, regressor: np.ndarray) -> Bodies:
        """The bodies of a segment, its known load included, with its inertial regressor, shape (N, n, 10 n)."""
        motion, last = segment.motion, 10 * body.last_link
        torque = regressor @ body.inertial_parameters()
        return cls(
            body.gravity_regressor(motion.q),
            body.force_regressor(motion.q),
            regressor[:, :, last : last + 10].copy(),
            play_columns(body, motion, torque, BACKLASH_START),
        )


def columns(
    corrected: CorrectedArm,
    body: RigidBody,
    segment: Segment,
    bodies: Bodies,
    terms: Terms,
    theta: np.ndarray,
    only: frozenset[str] | set[str] | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Predicted torque at theta, (N, n), and its derivatives by theta, (N, n, P); [N m] per unit of theta.

    Those of ``link_inertia`` are left zero: they are combinations of the inertial regressor.

    Args:
        corrected: the arm with the effects of theta.
        body: dynamics of the nominal arm.
        segment: the segment, with its torque.
        bodies: what does not depend on theta.
        terms: all terms, with the shapes of those that have one.
        theta: linear coordinates around which to differentiate, shape (P,).
        only: effects whose columns are wanted; all if ``None``, the others' are zero.
    """
    motion = segment.motion
    arm, body = corrected.unlimited, segment.bodies(body)
    rigid = arm.rigid_torque(body, motion)

    def recorded(of: CorrectedArm, torque: np.ndarray) -> np.ndarray:
        return of.recorded_torque(of.needed_torque(torque, motion), motion)

    base = recorded(arm, rigid)
    out = np.zeros((len(motion.t), arm.arm.n_joints, terms.size))
    for effect in explained():
        # behind encoders on the joints a transmission moves the motors, not the links
        own = effect.reach == "joint" or (
            isinstance(effect, Transmission) and arm.arm.encoder == "joint"
        )
        if not own or effect.limits or (only and effect.name not in only):
            continue
        step = parametrisation_of(effect).step
        for i, places in enumerate(terms.block(effect.name)):
            moved = moved_arm(arm, terms, theta, effect.name, i)
            if moved is not None:
                change = (recorded(moved, rigid) - base) / step
                out[:, np.arange(len(places)), places] = change
    _rest(out, terms, theta)
    _saturate(out, segment, terms)
    bodily = (
        forced_columns(arm, segment, bodies, terms)
        if only
        else bodily_columns(arm, body, segment, bodies, terms, theta, rigid)
    )
    if not bodily:
        return base, out
    gain = (recorded(arm, rigid + 1e-3) - recorded(arm, rigid - 1e-3)) / 2e-3
    through = (
        _delayed(arm, np.stack(list(bodily.values()), axis=2), motion.t)
        * np.clip(gain, 0.2, 5.0)[:, :, None]
    )
    out[:, :, list(bodily)] = through
    return base, out


def moved_arm(
    arm: CorrectedArm, terms: Terms, theta: np.ndarray, name: str, coordinate: int
) -> CorrectedArm | None:
    """The arm with one coordinate of an effect moved by a step on all joints; ``None`` if none has a shape yet."""
    chosen = [t for t in terms.of(name) if t in terms.open]
    if not chosen:
        return None
    moved = theta.copy()
    moved[[t.columns[coordinate] for t in chosen]] += parametrisation_of(
        by_name(name)
    ).step
    others = tuple(e for e in arm.effects if e.name != name)
    return replace(arm, effects=(*others, *terms.effects(moved, chosen)))


def bodily_columns(
    arm: CorrectedArm,
    body: RigidBody,
    segment: Segment,
    bodies: Bodies,
    terms: Terms,
    theta: np.ndarray,
    rigid: np.ndarray,
) -> dict[int, np.ndarray]:
    """Derivatives of the bodies' torque, (N, n), by place in theta; ``body`` carries the segment's known load."""
    motion, out = segment.motion, {}
    q = arm.true_position(motion.q)
    changed = arm.body(body)
    by_position, by_velocity, mass = changed.sensitivities(q, motion.dq, motion.ddq)
    for j, place in enumerate(terms.block("encoder_offset")[0]):
        out[int(place)] = -by_position[:, :, j]
    payload, places = terms.block("payload")[:, 0], terms.block("base_tilt")[:, 0]
    last, gravity = bodies.last, bodies.gravity
    if theta[places].any() or (q != motion.q).any():
        last = changed.last_link_regressor(q, motion.dq, motion.ddq)
    if arm.inertial_increments(body).any() or (q != motion.q).any():
        gravity = changed.gravity_regressor(q)
    _add(out, payload, last @ _payload_tangent(theta[payload]))
    _add(out, places, gravity @ _tilt_tangent(theta[places], arm.arm.gravity))
    out.update(forced_columns(arm, segment, bodies, terms))
    for effect in explained():
        if effect.reach == "arm" and effect.name not in DERIVED:
            out |= _differences(arm, body, motion, terms, theta, effect, rigid)
    if arm.arm.encoder == "motor":
        twist = _transmitted(arm, segment)
        for unit, places in zip(
            (twist, -np.gradient(twist, motion.t, axis=0)),
            terms.block("joint_elasticity"),
            strict=True,
        ):
            moved = slow_with_rates(unit, motion)
            for j, place in enumerate(places):
                parts = zip((by_position, by_velocity, mass), moved, strict=True)
                out[int(place)] = -sum(
                    matrix[:, :, j] * x[:, j, None] for matrix, x in parts
                )
        for j, place in enumerate(terms.block("backlash")[0]):
            out[int(place)] = bodies.play[:, :, j]
        for term in (
            t for name in ("joint_elasticity", "backlash") for t in terms.of(name)
        ):
            if theta[list(term.columns)].any():
                for place in term.columns:
                    out[place] = _bent(
                        arm, body, motion, terms, theta, term.effect, place, rigid
                    )
    return out


def _differences(
    arm: CorrectedArm,
    body: RigidBody,
    motion: Motion,
    terms: Terms,
    theta: np.ndarray,
    effect: Effect,
    rigid: np.ndarray,
) -> dict[int, np.ndarray]:
    """Derivatives of the bodies' torque, (N, n), by the coordinates of an effect, as finite differences."""
    out: dict[int, np.ndarray] = {}
    step = parametrisation_of(effect).step
    others = tuple(e for e in arm.effects if e.name != effect.name)
    for term in terms.of(effect.name):
        for place in term.columns if term in terms.open else ():
            moved = theta.copy()
            moved[place] += step
            chosen = [t for t in terms.of(effect.name) if moved[list(t.columns)].any()]
            changed = replace(arm, effects=(*others, *terms.effects(moved, chosen)))
            out[place] = (changed.rigid_torque(body, motion) - rigid) / step
    return out


def _bent(
    arm: CorrectedArm,
    body: RigidBody,
    motion: Motion,
    terms: Terms,
    theta: np.ndarray,
    name: str,
    place: int,
    rigid: np.ndarray,
) -> np.ndarray:
    """Derivative of the bodies' torque, (N, n), by a coordinate of a transmission that is compliant already."""
    chosen = [t for t in terms.of(name) if theta[list(t.columns)].any()]
    step = 1e-3 * max(
        abs(theta[place]), 1e-3 * np.abs(theta[terms.block(name)[0]]).max()
    )
    moved = theta.copy()
    moved[place] += step
    others = tuple(e for e in arm.effects if e.name != name)
    bent = replace(arm, effects=(*others, *terms.effects(moved, chosen)))
    return (bent.rigid_torque(body, motion) - rigid) / step


def forced_columns(
    arm: CorrectedArm, segment: Segment, bodies: Bodies, terms: Terms
) -> dict[int, np.ndarray]:
    """Derivatives of the bodies' torque by the force from outside, (N, n), by place in theta."""
    out: dict[int, np.ndarray] = {}
    for term in terms.of("external_force"):
        if term in terms.shapes:
            start, end = terms.shapes[term]
            active = acts(segment.motion.t, np.array(start), np.array(end))
            _add(
                out,
                np.array(term.columns),
                -active[:, None, None] * (bodies.force @ arm.base_rotation().T),
            )
    return out


def _transmitted(arm: CorrectedArm, segment: Segment) -> np.ndarray:
    """Torque through the transmission as recorded [N m], (N, n): what reached the motors less what they need."""
    assert segment.torque is not None
    bare = replace(
        arm,
        effects=tuple(
            e for e in arm.effects if e.effect.family in ("friction", "rigid_body")
        ),
    )
    scale = 1.0 + arm.value("torque_scale", "scale")
    return scale * arm.delivered(segment.torque) - bare.needed_torque(
        np.zeros_like(segment.torque), segment.motion
    )


def _add(
    out: dict[int, np.ndarray], places: np.ndarray, derivatives: np.ndarray
) -> None:
    for i, place in enumerate(places):
        out[int(place)] = derivatives[:, :, i]


def _rest(out: np.ndarray, terms: Terms, theta: np.ndarray) -> None:
    """The rest of a spring of stiffness zero is undefined; its coordinate k q0 is a constant torque."""
    stiffness, rest = terms.block("parallel_spring")
    unused = theta[stiffness] == 0
    out[:, :, rest[unused]] = out[:, :, terms.block("torque_offset")[0][unused]]


def _saturate(out: np.ndarray, segment: Segment, terms: Terms) -> None:
    """What saturation keeps from the joint: the recorded torque beyond the limit, at the coordinate 1 of its term."""
    assert segment.torque is not None
    for term in terms.of("torque_saturation"):
        if term in terms.shapes:
            torque, limit = segment.torque[:, term.joint - 1], terms.shapes[term][0]
            out[:, term.joint - 1, term.columns[0]] = torque - np.clip(
                torque, -limit, limit
            )


def _payload_tangent(payload: np.ndarray) -> np.ndarray:
    """Derivative of the payload's ten inertial parameters by mass and first moment, shape (10, 4)."""
    mass = payload[0]
    if abs(mass) < 1e-3:
        return np.eye(10, 4)
    return _central(
        lambda p: point_mass_parameters(p[0], p[1:] / p[0]), payload, 1e-4 * abs(mass)
    )


def link_tangent(own: np.ndarray, link: int, change: np.ndarray) -> np.ndarray:
    """Derivative of a link's ten inertial parameters by its increments of mass and centre, shape (10, 4)."""
    return _central(
        lambda x: link_change(own, np.array(link), x[0], x[1:]), change, 1e-5
    )


def _tilt_tangent(angles: np.ndarray, gravity: np.ndarray) -> np.ndarray:
    """Derivative of gravity in the base frame, R^T g, by roll and pitch [m/s^2/rad], shape (3, 2)."""
    return _central(lambda a: tilt(a[0], a[1]).T @ np.asarray(gravity), angles, 1e-5)


def _central(function, at: np.ndarray, step: float) -> np.ndarray:  # type: ignore[no-untyped-def]
    steps = step * np.eye(len(at))
    return np.stack(
        [(function(at + s) - function(at - s)) / (2 * step) for s in steps], axis=1
    )


def _delayed(corrected: CorrectedArm, columns: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Columns (N, n, K) of the needed torque, each joint's shifted by its delay and lag, to first order in time."""
    times = (values[0] for effect, values in corrected.of_kind(Path) if effect.delays)
    ahead: np.ndarray = sum(times, np.zeros(corrected.arm.n_joints))
    if not ahead.any():
        return columns
    return columns + ahead[:, None] * np.gradient(columns, t, axis=0)
