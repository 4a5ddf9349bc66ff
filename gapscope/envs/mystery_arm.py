"""The mystery arm of ``gapscope demo``: a simulated KUKA iiwa with hidden effects."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gapscope.arm.case import Case
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import GapscopeError
from gapscope.arm.motions.motion import Motion
from gapscope.arm.motions.trajectory import Fourier, Limits, urdf_limits
from gapscope.arm.nominal import NominalArm
from gapscope.arm.robots import load_nominal_arm
from gapscope.arm.root_mean_square import rms
from gapscope.effects.applied import AppliedEffect, carried
from gapscope.effects.catalogue import CATALOGUE
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.effect import LinkChange
from gapscope.envs.position_controller import position_controller
from gapscope.envs.recorder import record
from gapscope.model.conditioning import torque_scale

HIDDEN_QUANTITIES = {
    *("friction", "damping", "load_factor", "rotor"),
    *("scale", "offset", "delay", "zero"),
}
"""Quantities of its drives that the mystery arm may hide, keys of ``gapscope.effects.effect.QUANTITIES``."""
HIDDEN = tuple(
    name
    for name, effect in CATALOGUE.items()
    if effect.needed_quantities <= HIDDEN_QUANTITIES
    or (isinstance(effect, LinkChange) and effect.scope == "arm")
)
"""Effects that the mystery arm may have: of these quantities, or a load; those that a diagnosis can find."""
DATA_SHEET = {
    "armature": [0.6, 0.6, 0.35, 0.35, 0.2, 0.1, 0.08],
    "coulomb": [3.0, 3.5, 2.0, 2.5, 1.2, 0.8, 0.5],
    "viscous": [4.0, 4.0, 2.5, 2.5, 1.5, 1.0, 0.6],
    "torque_limit": [320.0, 320.0, 176.0, 176.0, 110.0, 40.0, 40.0],
    "encoder_step": 2 * np.pi / 2**17,
}
"""Data sheet of the mystery arm; encoders of 17 bits per turn."""
DURATION, RATE = 10.0, 250.0
"""Length [s] and rate [Hz] of a recording."""
FREQUENCIES = (0.1, 0.15, 0.2, 0.3)
"""Base frequencies of the recordings' motions [Hz]: slow and fast ones separate friction laws and delays."""
VISIBLE = 0.03
"""Least torque of an effect on each of its joints, as RMS over the nominal torque's standard deviation."""
NOISE = 0.001
"""Noise of the recorded torque, standard deviation over the torque limit [1]."""
DRAWS = 1000
"""Draws of an effect before giving up."""
SPEED = np.deg2rad([85.0, 85.0, 100.0, 75.0, 130.0, 135.0, 135.0])
"""Velocity limits of the iiwa 14 R820 [rad/s]; its URDF has placeholders."""
POSTURE = np.array([0.0, 0.6, 0.0, -1.2, 0.0, 0.8, 0.0])
"""Posture about which the arm moves [rad]."""


def iiwa() -> NominalArm:
    """KUKA LBR iiwa: its URDF, torque limits of the iiwa 14 R820, rotors and friction of its class."""
    return load_nominal_arm("kuka_iiwa", sheet=DATA_SHEET)


def mystery_arm(rng: np.random.Generator) -> tuple[Case, tuple[AppliedEffect, ...]]:
    """A case with four recordings of an arm with one or two unknown effects, and the effects, to be kept apart.

    Args:
        rng: source of the effects, the motions and the noise; the same state gives the same arm, bit by bit.
    """
    arm = iiwa()
    references = [_reference(rng, arm, frequency) for frequency in FREQUENCIES]
    # effects are to show in the motions that will be recorded
    truth = draw_effects(rng, arm, references)
    controller = position_controller(arm, POSTURE)
    recordings = tuple(
        record(
            arm,
            truth,
            reference,
            controller,
            duration=DURATION,
            rng=rng,
            torque_noise=NOISE * np.array(DATA_SHEET["torque_limit"]),
            name=f"recording_{label}",
        )
        for label, reference in zip("abcd", references, strict=True)
    )
    return Case("mystery", Path(), arm, recordings, controller=controller), truth


def draw_effects(
    rng: np.random.Generator, arm: NominalArm, references: list[Fourier]
) -> tuple[AppliedEffect, ...]:
    """One or two different effects, on different joints, each of which shows in the torque of these motions."""
    body, motion = RigidBody(arm), _motion(references)
    nominal = CorrectedArm(arm).predict(body, motion)
    scale = torque_scale(nominal)
    wanted = int(rng.integers(1, 3))
    effects: list[AppliedEffect] = []
    for _ in range(DRAWS):
        if len(effects) == wanted:
            return tuple(effects)
        names = [name for name in HIDDEN if name not in [e.name for e in effects]]
        # on joints of its own, so that no two effects stand for each other
        taken = {joint for e in effects for joint in e.joints}
        free = [joint for joint in range(1, arm.n_joints + 1) if joint not in taken]
        drawn = _draw(rng, str(rng.choice(names)), free, motion, scale)
        gap = CorrectedArm(arm, (drawn,)).predict(body, motion) - nominal
        # what an effect changes in the torque, on each joint over what that carries
        share = rms(gap) / scale
        # a load has no joints of its own: where it shows most it has to show
        own = (
            share[np.array(drawn.joints) - 1]
            if drawn.joints
            else share.max(keepdims=True)
        )
        # an effect that does not show is drawn again, until it does
        if own.min() >= VISIBLE:
            effects.append(drawn)
    raise GapscopeError(f"no visible effect in {DRAWS} draws", "use faster motions")


def _draw(
    rng: np.random.Generator,
    name: str,
    free: list[int],
    motion: Motion,
    scale: np.ndarray,
) -> AppliedEffect:
    """An effect with values of the size that real arms have; friction, rotors and offsets relative to the torque."""
    effect = CATALOGUE[name]
    if isinstance(effect, LinkChange):
        com = [*rng.uniform(-0.05, 0.05, 2), rng.uniform(0.0, 0.1)]
        return carried(rng.uniform(0.8, 5.0), com)
    joints = np.sort(rng.choice(free, size=int(rng.integers(1, 3)), replace=False))
    size, sign = len(joints), rng.choice([-1.0, 1.0])
    torque = (scale * rng.uniform(0.1, 0.4))[joints - 1]
    speed, acceleration = (rms(x)[joints - 1] for x in (motion.dq, motion.ddq))
    # damping and rotors take that torque at the usual speed or acceleration
    quantities = {
        "friction": torque,
        "damping": torque / speed,
        "load_factor": rng.uniform(0.08, 0.31, size),
        "rotor": np.minimum(torque / acceleration, 1.3),
        "scale": sign * rng.uniform(0.1, 0.3, size),
        "offset": sign * torque,
        "delay": rng.uniform(0.004, 0.02, size),
        # one to five degrees
        "zero": sign * rng.uniform(0.0175, 0.0873, size),
    }
    values = {name: quantities[effect.quantities[name]] for name in effect.needed}
    return AppliedEffect(name, tuple(int(joint) for joint in joints), values)


def _reference(rng: np.random.Generator, arm: NominalArm, frequency: float) -> Fourier:
    """A motion about the posture, the faster the higher its base frequency [Hz]."""
    limits = urdf_limits(RigidBody(arm), acceleration=6.0)
    # slow motions use less than the limits, so that laws of the velocity can be told
    speed = SPEED * min(1.0, frequency / 0.2)
    reach = 0.9 * np.minimum(limits.upper - POSTURE, POSTURE - limits.lower)
    around = Limits(
        POSTURE - reach,
        POSTURE + reach,
        np.minimum(limits.velocity, speed),
        limits.acceleration,
    )
    centre = POSTURE + rng.uniform(-0.25, 0.25, arm.n_joints)
    return Fourier.random(
        rng, around, duration=DURATION, centre=centre, frequency=frequency
    )


def _motion(references: list[Fourier]) -> Motion:
    """The references one after the other, as one motion."""
    t = np.arange(int(DURATION * RATE)) / RATE
    q, dq, ddq = (
        np.concatenate([getattr(reference, name)(t) for reference in references])
        for name in ("position", "velocity", "acceleration")
    )
    return Motion(np.arange(len(q)) / RATE, q, dq, ddq)
