"""Cases of the benchmark of real arms: effects of known size put into a healthy recording, drawn, applied and labelled.

Saturation is left out: what a recording would have been with less torque than it shows is not known. Shifted inertials
and wrong time stamps are left out too. Everything is drawn from the seed, the arm, the mode and the number of the case:
a run on some arms has the same cases as one on all of them (``26_real_benchmark.py``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple
from zlib import crc32

import numpy as np
from real_carriers import (
    ARMS,
    CUT_FILES,
    cut_folder,
    cut_residual,
    load_prepared,
    write_piece,
)
from real_laws import LAWS, STEPS, Scene

from gapscope.arm.io.json_file import read_json
from gapscope.arm.joint_units import size_per_radian
from gapscope.arm.recording import Recording
from gapscope.blind_check.generator.recorded import Put, RecordedLaw, Values
from gapscope.blind_check.scoring import VECTORS
from gapscope.effects.catalogue import CATALOGUE

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


class Injection(NamedTuple):
    """A law with all its values.

    Attributes:
        law: the law.
        joints: from 0; empty for the arm.
        x: its size, one per joint or one number.
        drawn: its other values.
    """

    law: RecordedLaw
    joints: np.ndarray
    x: np.ndarray
    drawn: Values

    def applied(self, scene: Scene, recording: Recording) -> tuple[Recording, Values]:
        """A recording with it, and the values of the label."""
        return self.law.apply(Put(scene, recording, self.joints, self.x, self.drawn))


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
    if scene.nominal.sliding == (True,) and not law.slides:
        return None
    for _ in range(ATTEMPTS):
        joints = _joints(scene, law, rng)
        drawn = law.draw(rng, scene, joints)
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


def _joints(scene: Scene, law: RecordedLaw, rng: np.random.Generator) -> np.ndarray:
    """Joints of a law, from 0."""
    n = scene.nominal.n_joints
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
    law, effect = one.law, CATALOGUE[one.law.name]
    sizes = VECTORS.get(law.name, effect.needed[:1])
    for parameter in map(effect.parameter, effect.needed):
        # of a slide in m, N and kg
        unit = size_per_radian(parameter.unit, scene.nominal.sliding)[one.joints]
        unit = unit if len(unit) else np.ones(1)
        value = np.asarray(values[parameter.name], dtype=float) / unit
        low, high = parameter.bounds
        if not ((value >= low) & (value <= high)).all():
            return False
        least, most = (abs(x) for x in parameter.typical)
        sized = parameter.name in sizes
        if parameter.name == "stiffness" and law.motor:
            if (value < least / BEYOND_TYPICAL).any():
                return False
        elif sized and (np.abs(value) > BEYOND_TYPICAL * max(least, most)).any():
            return False
    return True


def inject(
    scene: Scene, injections: Sequence[Injection]
) -> tuple[Recording, list[dict[str, Any]]]:
    """The recording with all effects, and their entries for the label, in the order given."""
    recording = scene.recording
    values = {}
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


# The plan, and how a case is made

MODES = ("against", "plain")
SIZES = (2.5, 4.0, 8.0)
"""RMS of an effect over what a full model leaves [1]."""
PAIR_ATTEMPTS = 12
"""Second effects that are tried for a pair."""


class Planned(NamedTuple):
    """One case to be made.

    Attributes:
        arm: short name of the carrier.
        mode: ``against`` a reference, or ``plain`` with the identified arm as the nominal one.
        kind: ``healthy``, ``single`` or ``pair``.
        number: within arm, mode and kind, from 0.
        size: RMS of each effect over what a full model leaves [1]; 0 if healthy.
    """

    arm: str
    mode: str
    kind: str
    number: int
    size: float

    @property
    def name(self) -> str:
        """Name of the case; it says nothing of the truth but the kind of carrier."""
        first = {"healthy": 100, "single": 200, "pair": 300}[self.kind]
        scrambled = crc32(f"{self.arm} {self.mode} {first + self.number}".encode())
        return f"{self.arm}_{self.mode}_{scrambled % 0xFFFFFF:06x}"

    @property
    def cut(self) -> int:
        """Number of the cut: each healthy case has its own, cases with an effect share the first three."""
        return self.number if self.kind == "healthy" else (self.number + 1) % 3


PER_ARM = 9
"""Cases per arm and mode, if not said otherwise."""


def counts(per_arm: int = PER_ARM) -> dict[str, int]:
    """Cases by kind for a total per arm and mode: a third healthy, a ninth pairs."""
    healthy, pairs = -(-per_arm // 3), per_arm // 9
    return {"healthy": healthy, "single": per_arm - healthy - pairs, "pair": pairs}


COUNTS = counts()


def planned(
    arms: list[str], modes: list[str], sizes: list[float], number: dict[str, int]
) -> list[Planned]:
    """All cases, arm by arm."""
    out = []
    for arm in arms:
        for mode in modes:
            for kind, count in number.items():
                for k in range(count):
                    # every arm and mode begins with another size
                    first = k + list(ARMS).index(arm) + MODES.index(mode)
                    size = 0.0 if kind == "healthy" else sizes[first % len(sizes)]
                    out.append(Planned(arm, mode, kind, k, size))
    return out


def make_case(plan: Planned, seed: int, out: Path) -> dict[str, Any]:
    """Write one case; its truth."""
    folder = out / "cases" / plan.name
    prepared = load_prepared(plan.arm, plan.cut, out)
    base = prepared.case if plan.mode == "against" else prepared.identified
    healthy = Scene(
        base.recordings[0],
        # a comparison identifies the arm itself
        prepared.whole.arm if plan.mode == "against" else base.arm,
        prepared.whole.arm,
        cut_residual(prepared, plan.mode == "against"),
    )
    injections = drawn(plan, seed, healthy)
    recording, entries = inject(healthy, injections)
    recording = replace(recording, name="recording")
    case = replace(base, name=plan.name, recordings=(recording,))
    write_piece(case, folder)
    return label(plan, healthy, injections, entries)


def drawn(plan: Planned, seed: int, healthy: Scene) -> list[Injection]:
    """The effects of a case: the next ones in an order of all effects that this carrier can have."""
    if plan.kind == "healthy":
        return []
    place = [MODES.index(plan.mode), 0 if plan.kind == "single" else 1, plan.number]
    rng = np.random.default_rng([seed, crc32(plan.arm.encode()), *place])
    if plan.kind == "single":
        return [first_possible(order(plan, seed), plan.size, healthy, rng)]
    for _ in range(PAIR_ATTEMPTS):
        names = [str(name) for name in rng.permutation(list(LAWS))]
        first = first_possible(names, plan.size, healthy, rng)
        # neither may be a fault, nor the two look alike
        own = first.law
        others = [
            n
            for n in names
            if n != own.name
            and 7 not in (own.stage, LAWS[n].stage)
            and not any({own.name, n} <= group for group in ALIKE)
        ]
        if others:
            return [first, first_possible(others, plan.size, healthy, rng)]
    raise RuntimeError(f"no pair of effects is possible on {plan.arm}")


def order(plan: Planned, seed: int) -> list[str]:
    """Effects to try for a single one, so that all occur about equally often and none twice among five cases.

    A permutation of all effects is turned on by five from one arm and mode to the next; of five cases the first tries
    every fifth name from the first on, the second every fifth from the second on, and so on.
    """
    group, place = divmod(plan.number, COUNTS["single"])
    names = np.random.default_rng([seed, group]).permutation(list(LAWS))
    arm, mode = list(ARMS).index(plan.arm), MODES.index(plan.mode)
    turned = np.roll(names, -(len(MODES) * arm + mode) * COUNTS["single"])
    first = turned[place :: COUNTS["single"]]
    return [str(name) for name in (*first, *turned)]


def first_possible(
    names: list[str], size: float, healthy: Scene, rng: np.random.Generator
) -> Injection:
    """The first of some effects that the carrier can have in a size."""
    for name in names:
        found = draw(healthy, name, size, rng)
        if found is not None:
            return found
    raise RuntimeError(f"no effect of {size} times the residual is possible")


def label(
    plan: Planned,
    healthy: Scene,
    injections: list[Injection],
    entries: list[dict[str, Any]],
) -> dict[str, Any]:
    """The truth of a case, in the form that ``gapscope.blind_check.scoring`` reads."""
    sized = any(one.law.place != "none" for one in injections)
    ratios = [
        (healthy.gap(one.applied(healthy, healthy.recording)[0]) / healthy.residual)
        if one.law.stage < 7
        else np.zeros(healthy.nominal.n_joints)
        for one in injections
    ]
    return {
        "kind": plan.kind,
        "effects": entries,
        "forms": [one.law.form for one in injections],
        "gap": np.max([np.zeros(healthy.nominal.n_joints), *ratios], axis=0).tolist(),
        "residual": healthy.residual.tolist(),
        "motions": ["slow", "slow"],
        "severity": [plan.size, plan.size] if injections else None,
        "measure": "torque" if sized else "none",
        "conditions": {
            "robot": plan.arm,
            "mode": plan.mode,
            "cut": plan.cut,
            "size": plan.size,
        },
    }


def read_truth(plan: Planned, out: Path) -> dict[str, Any]:
    """The truth of a case."""
    return dict(read_json(truth_file(plan, out), "--step make"))


def truth_file(plan: Planned, out: Path) -> Path:
    """Where it stands."""
    return out / "truth" / f"{plan.name}.json"


def reference_of(plan: Planned, out: Path) -> Path:
    """Folder of the reference of a case."""
    return cut_folder(plan.arm, plan.cut, out) / CUT_FILES[0]
