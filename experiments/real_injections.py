"""Effects of known size put into a healthy recording: drawn, sized, applied and labelled; see ``26_real_benchmark.py``.

The laws are those of ``real_laws_load.py``, ``real_laws_path.py`` and ``real_laws_position.py``. Saturation is left
out: what a recording would have been with less torque than it shows is not known. Shifted inertials and wrong time
stamps are left out too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import real_laws_load
import real_laws_path
import real_laws_position
from real_laws_position import STEPS
from real_scene import Law, Scene, Values

from gapscope.arm.joint_units import size_per_radian
from gapscope.arm.recording import Recording
from gapscope.effects.catalogue import CATALOGUE

LAWS = {
    law.name: law
    for module in (real_laws_load, real_laws_path, real_laws_position)
    for law in module.LAWS
}
"""All laws by the effect that they make."""
NOT_ON_A_SLIDE = {
    "armature",
    "base_tilt",
    "encoder_offset",
    "joint_swap",
    "link_inertia",
    "torque_ripple",
    "unit_mismatch",
}
"""Laws that a single slide cannot have: a tilted base is an offset, its zero shows in nothing, its mass has one name,
``payload``, and neither angle nor revolution means anything."""
ROUNDS = 12
"""Times that a size is corrected."""
EXACT = 0.03
"""A size is met if it is this close [1]."""
BEYOND_TYPICAL = 3.0
"""Parameters go up to this many times what is typical on real arms."""
ATTEMPTS = 6
"""Draws of joints and values for one effect before another is taken."""
SEVERAL = 0.3
"""Share of the effects on joints that act on two of them [1]."""
ALIKE = (
    {"actuator_delay", "actuator_lag"},
    {"payload", "link_inertia"},
    {"payload", "base_tilt", "external_force"},
    {"armature", "link_inertia"},
    {"coulomb_friction", "stribeck_friction", "friction_drift"},
    {"coulomb_friction", "load_friction", "viscous_friction"},
    {"parallel_spring", "torque_offset", "encoder_offset"},
    {"joint_elasticity", "backlash", "encoder_quantization"},
)
"""Effects of which a pair holds one at most: side by side neither has a size of its own."""


@dataclass(frozen=True)
class Injection:
    """A law with all its values.

    Attributes:
        law: the law.
        joints: from 0; empty for the arm.
        x: its size, one per joint or one number.
        drawn: its other values.
    """

    law: Law
    joints: np.ndarray
    x: np.ndarray
    drawn: Values

    def applied(self, scene: Scene, recording: Recording) -> tuple[Recording, Values]:
        """A recording with it, and the values of the label."""
        return self.law.apply(scene, recording, self.joints, self.x, self.drawn)


def draw(
    scene: Scene, name: str, size: float, rng: np.random.Generator
) -> Injection | None:
    """An effect of a size, or ``None`` if this arm cannot have it within what is typical on real arms.

    Args:
        scene: the healthy recording.
        name: of the law.
        size: RMS of what it adds to the torque gap over what a full model leaves [1].
        rng: source of random numbers.
    """
    law = LAWS[name]
    if law.motor and scene.nominal.encoder == "joint":
        return None
    slides = scene.nominal.sliding
    if slides == (True,) and name in NOT_ON_A_SLIDE:
        return None
    for _ in range(ATTEMPTS):
        joints = _joints(scene, law, rng)
        drawn = law.draw(scene, rng, joints)
        count = len(joints) if law.place in ("joint", "spread", "none") else 1
        signs = rng.choice([-1.0, 1.0], count) if law.signed else np.ones(count)
        x = law.start * signs
        if name == "encoder_quantization":
            x = STEPS[size] * scene.nominal.per_radian[joints]
        one = Injection(law, joints, x, drawn)
        if law.place == "none":
            return one
        sized = _sized(scene, one, size)
        if sized is not None:
            return sized
    return None


def _joints(scene: Scene, law: Law, rng: np.random.Generator) -> np.ndarray:
    """Joints of a law, from 0."""
    n = scene.n
    if law.place == "arm":
        return np.array([], dtype=int)
    if law.name == "unit_mismatch":
        return np.arange(n)
    if law.name == "joint_swap":
        first = int(rng.integers(n - 1))
        return np.array([first, first + 1])
    if law.name == "encoder_offset":
        # neither an axis along gravity nor the last joint shows its zero
        return np.array([int(rng.integers(1, n - 1))])
    several = law.place == "joint" and rng.random() < SEVERAL
    return np.sort(rng.choice(n, min(n, 1 + several), replace=False))


def _sized(scene: Scene, one: Injection, size: float) -> Injection | None:
    """The same effect of a size, or ``None`` if that is beyond what is typical, or cannot be had."""
    x = one.x
    for _ in range(ROUNDS):
        current = Injection(one.law, one.joints, x, one.drawn)
        changed, values = current.applied(scene, scene.recording)
        if not _believable(scene, one, values):
            return None
        ratio = scene.gap(changed) / scene.residual
        own = one.law.place == "joint"
        ratio = ratio[one.joints] if own else np.full(x.shape, ratio.max())
        if (np.abs(ratio / size - 1) < EXACT).all():
            return current
        x = x * np.clip(size / np.maximum(ratio, 1e-9), 0.2, 5.0)
    return None


def _believable(scene: Scene, one: Injection, values: Values) -> bool:
    """Whether every parameter is within its bounds, and the size within three times what is typical."""
    law = one.law
    for parameter in CATALOGUE[law.name].parameters:
        # of a slide in m, N and kg
        unit = size_per_radian(parameter.unit, scene.nominal.sliding)[one.joints]
        unit = unit if len(unit) else np.ones(1)
        value = np.asarray(values[parameter.name], dtype=float) / unit
        low, high = parameter.bounds
        if not ((value >= low) & (value <= high)).all():
            return False
        least, most = (abs(x) for x in parameter.typical)
        sized = parameter.name == law.size or parameter.name in ("roll", "pitch")
        if parameter.name == "stiffness" and law.motor:
            if (value < least / BEYOND_TYPICAL).any():
                return False
        elif sized and (np.abs(value) > BEYOND_TYPICAL * max(least, most)).any():
            return False
    return True


def compatible(first: str, second: str) -> bool:
    """Whether two effects may stand in one case."""
    alike = any({first, second} <= group for group in ALIKE)
    faults = any(LAWS[name].stage == 7 for name in (first, second))
    return first != second and not alike and not faults


def inject(
    scene: Scene, injections: Sequence[Injection]
) -> tuple[Recording, list[dict[str, Any]]]:
    """The recording with all effects, and their entries for the label, in the order given."""
    recording = scene.recording
    values: dict[int, Values] = {}
    for k in sorted(range(len(injections)), key=lambda k: injections[k].law.stage):
        recording, values[k] = injections[k].applied(scene, recording)
    entries = [_entry(one, values[k]) for k, one in enumerate(injections)]
    return recording, entries


def _entry(one: Injection, values: Values) -> dict[str, Any]:
    """An effect as a label names it: joints from 1, units of the catalogue; a fault's parameters have none."""
    effect = CATALOGUE.get(one.law.name)
    parameters = {
        name: {
            "unit": effect.parameter(name).unit if effect else "",
            "value": np.asarray(value).tolist() if effect else value,
        }
        for name, value in values.items()
    }
    joints = (one.joints + 1).tolist()
    return {"effect": one.law.name, "joints": joints, "parameters": parameters}
