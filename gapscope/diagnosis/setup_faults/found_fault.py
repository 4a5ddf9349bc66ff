"""Faults of the set-up: candidate readings, what was found, and one fault where two are the same."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from gapscope.arm.case import Case
from gapscope.arm.display import effect_name, listing
from gapscope.arm.nominal import NominalArm
from gapscope.arm.reading import Reading
from gapscope.arm.recording import Recording
from gapscope.arm.root_mean_square import SMALLEST
from gapscope.diagnosis.thresholds import KNOWN_FACTOR_R2, OBVIOUS_FAULT_PROBABILITY
from gapscope.effects.catalogue import of_quantity
from gapscope.effects.setup_faults import Fault, Look
from gapscope.model.readings import (
    COULOMB,
    OFFSET,
    VISCOUS,
    ReadingEquations,
    ReadingScorer,
)

# What a case shows under a reading, from which faults tell where they may be; and bases turned, which look like them.
#
# A torque's factor is looked for from where the nominal arm has it: with what friction and an offset explain taken
# out of both, torque and nominal torque of a joint have variances whose ratio is the square of the factor.


TURN = 2 * np.pi


@dataclass(frozen=True)
class TurnedBase(Fault):
    """A base turned by roll and pitch [rad].

    No fault: it is an effect, which the search finds. Here it competes with the faults that look like it: all torques
    turned are gravity turned, but for friction and inertia.
    """

    name = of_quantity("gravity")[0].name
    roll: float
    pitch: float

    def reading(self, n: int) -> Reading:
        """With the base turned."""
        return Reading.identity(n, turn=(self.roll, self.pitch))


HALF, QUARTER = np.pi, np.pi / 2
TURNED_BASES = (
    TurnedBase(HALF, 0.0),
    TurnedBase(QUARTER, 0.0),
    TurnedBase(-QUARTER, 0.0),
    TurnedBase(0.0, QUARTER),
    TurnedBase(0.0, -QUARTER),
)
"""Arms that hang, or are mounted sideways."""


def look_at(
    scorer: ReadingScorer,
    equations: ReadingEquations,
    reading: Reading,
    rate_is_known: bool,
) -> Look:
    """What samples of a case show under a reading, given the equations under it."""
    arm = scorer.arm
    factor, known = factor_starts(equations, reading)
    n = arm.n_joints
    return Look(
        reading,
        tuple(np.flatnonzero(~np.array(arm.sliding)).tolist()),
        joints_beyond_range(scorer, reading),
        factor,
        known,
        # gravity torques come after the n recorded ones
        bool(equations.products[:, n:, n:].any()),
        rate_is_known or reading.differs("time_factor"),
    )


def joints_beyond_range(scorer: ReadingScorer, reading: Reading) -> tuple[int, ...]:
    """Joints, from 0, that travel more than a turn, or farther than their limits in the URDF are apart."""
    samples = scorer.samples
    q, _, _ = reading.true_motion(samples.q, samples.dq, samples.ddq)
    travel = np.ptp(q, axis=0)
    lower, upper = scorer.body.position_limits()
    # a slide may travel as far as its limits allow
    most = np.where(scorer.arm.sliding, np.inf, 1.05 * TURN)
    allowed = np.minimum(upper - lower, most)
    return tuple(int(j) for j in np.flatnonzero(travel > allowed))


def factor_starts(
    eq: ReadingEquations, reading: Reading
) -> tuple[np.ndarray, np.ndarray]:
    """Nominal over read torque of each joint [1], (n,), and of which joints it is known, (n,)."""
    torque = eq.read(reading)
    columns = eq.shared + np.array([0, COULOMB, VISCOUS, OFFSET])
    # recorded and nominal torque, then what explains both
    sums = np.empty((len(torque.square), 5, 5))
    sums[:, 0, 0] = torque.square
    sums[:, 0, 1:] = sums[:, 1:, 0] = torque.cross[:, columns]
    sums[:, 1:, 1:] = eq.gram[:, columns][:, :, columns]
    # what friction and offset explain is taken out of both: a Schur complement
    own = np.linalg.pinv(sums[:, 2:, 2:], hermitian=True)
    left = sums[:, :2, :2] - sums[:, :2, 2:] @ own @ sums[:, 2:, :2]
    recorded, nominal = np.maximum(left[:, 0, 0], 0.0), np.maximum(left[:, 1, 1], 0.0)
    power = recorded * nominal
    there = np.maximum(power, SMALLEST)
    factors = np.where(power > 0, nominal / np.sqrt(there), 1.0)
    # share of the variance that both have in common
    return factors, (power > 0) & (left[:, 0, 1] ** 2 > KNOWN_FACTOR_R2 * there)


# A setup fault that was found, and how to put it right.


@dataclass(frozen=True)
class FoundFault:
    """A setup fault, or what else shows in the recordings themselves, n joints.

    Attributes:
        fault: the fault with its values.
        probability: that it is this fault.
        std: standard deviation of each value of a parameter, by its name; without it the value is a choice among few.
        recordings: names of the recordings that have it; empty: all.
        log_odds: of the fault against none [nats]; ``None`` if it shows in the recordings themselves.
        charge: what its values and the choice of its joints owe, which ``log_odds`` hold already [nats].
        others: what it may be instead, and how probable that is, the most probable first.
        gap_with_only_this, gap_without_this: torque NRMSE, (n,), with this fault alone corrected, and with all others
            but this; ``None`` if it cannot be computed.
        gap_before, gap_after: torque NRMSE, (n,), of the case as it is, and with all faults corrected.
    """

    fault: Fault
    probability: float
    std: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    recordings: tuple[str, ...] = ()
    log_odds: float | None = None
    charge: float = 0.0
    others: tuple[tuple[Fault, float], ...] = ()
    gap_with_only_this: np.ndarray | None = field(default=None, repr=False)
    gap_without_this: np.ndarray | None = field(default=None, repr=False)
    gap_before: np.ndarray | None = field(default=None, repr=False)
    gap_after: np.ndarray | None = field(default=None, repr=False)

    @property
    def name(self) -> str:
        """Name of the fault, or ``encoder_quantization``."""
        return self.fault.name

    @property
    def variant(self) -> str:
        """Which channel, unit or kind; empty if there is one only."""
        return self.fault.kind[1]

    @property
    def joints(self) -> tuple[int, ...]:
        """From 1; empty if it concerns the whole arm."""
        return self.fault.kind[2]

    def reading(self, n: int) -> Reading:
        """How its recordings must be read, of n joints; time by files, each as a whole."""
        reading = self.fault.reading(n)
        if not reading.differs("time_factor"):
            return reading
        # a recording may be rows or an episode of a file, and a file has one clock
        names = (name.partition(" rows ")[0] for name in self.recordings)
        files = dict.fromkeys(name.partition(" episode ")[0] for name in names)
        return replace(reading, files=tuple(files))

    def repair(self, recording: Recording, arm: NominalArm | None = None) -> Recording:
        """The recording as a right set-up would have written it, with a note; unchanged if it does not have it.

        Args:
            recording: as it was read.
            arm: the nominal arm, if gravity may have been left out of the torque.
        """
        if self.recordings and recording.name not in self.recordings:
            return recording
        reading = self.fault.reading(recording.n_joints)
        out = reading(recording, arm)
        # shifted inertials change the arm alone, and are noted here all the same
        if out is recording and not reading.link_shift:
            return recording
        return replace(out, notes=(*out.notes, f"put right: {self}"))

    def document(self) -> dict[str, Any]:
        """The parameters as ``diagnosis.json`` holds them, and the variant."""
        units = {parameter.name: parameter.unit for parameter in self.fault.parameters}
        parameters = {}
        for name, values in self.fault.values().items():
            stds = self.std.get(name)
            value: Any = list(values)
            std: Any = None if stds is None else list(stds)
            if not self.joints:  # one value for the arm
                value, std = value[0], std[0] if std else None
            parameters[name] = {"unit": units[name], "value": value, "std": std}
        content: dict[str, Any] = {"parameters": parameters}
        if self.variant:
            content["variant"] = self.variant
        return content

    def __str__(self) -> str:
        """In words."""
        variant = f" ({self.variant.replace('_', ' ')})" if self.variant else ""
        plural = "s" if len(self.joints) > 1 else ""
        joints = f" of joint{plural} {listing(list(map(str, self.joints)))}"
        return f"{effect_name(self.name)}{variant}{joints if self.joints else ''}"


def by_recordings(
    fault: Callable[[float], Fault],
    parameter: str,
    amounts: Mapping[str, float],
    recordings: Iterable[Recording],
) -> FoundFault:
    """The fault that shows in the recordings themselves: its value is the median over them.

    Its deviation is by how much they differ, and no less than that of a size from N rows, 1 / sqrt(2 N) of it.

    Args:
        fault: of a value.
        parameter: name of the value.
        amounts: the value in each recording that has it, by name.
        recordings: all of them.
    """
    values = np.array(list(amounts.values()))
    median = float(np.median(values))
    rows = sum(len(r.t) for r in recordings)
    std = max(float(values.std()), abs(median) / np.sqrt(2 * rows))
    return FoundFault(
        fault(median), OBVIOUS_FAULT_PROBABILITY, {parameter: (std,)}, tuple(amounts)
    )


def repaired(case: Case, faults: tuple[FoundFault, ...]) -> Case:
    """The case with all faults corrected, in the order in which they were found."""
    arm, recordings, judged = case.arm, case.recordings, case.judged
    controller = case.controller
    for fault in faults:
        reading = fault.reading(arm.n_joints)
        # the arm first: gravity that is put back is that of the right one
        arm, controller = reading.arm(arm), reading.controller(controller)
        recordings = tuple(fault.repair(r, arm) for r in recordings)
        judged = tuple(fault.repair(r, arm) for r in judged)
        if controller is not None and reading.law:
            # the declared controller gives the torque that was not measured
            recordings = tuple(replace(r, tau=None) for r in recordings)
            judged = tuple(replace(r, tau=None) for r in judged)
    return replace(
        case, arm=arm, recordings=recordings, judged=judged, controller=controller
    )


# Findings of the same fault on several joints, made one.


def merged(faults: Iterable[FoundFault]) -> tuple[FoundFault, ...]:
    """Faults with the same name and variant as one, joints in order; swaps stay apart, and keep all others apart."""
    faults = tuple(faults)
    # after a swap, joint numbers mean something else
    if any(f.name == "joint_swap" for f in faults):
        return faults
    out: dict[tuple[str, str, tuple[str, ...], bool], FoundFault] = {}
    for fault in faults:
        key = (fault.name, fault.variant, fault.recordings, bool(fault.joints))
        out[key] = _joined(out[key], fault) if key in out and fault.joints else fault
    return tuple(out.values())


def _joined(first: FoundFault, second: FoundFault) -> FoundFault:
    """Both as one; the first if they share a joint."""
    joints = first.joints + second.joints
    if len(set(joints)) < len(joints):
        return first
    order = np.argsort(joints)
    shared = first.std.keys() & second.std.keys()
    both = {name: np.array(first.std[name] + second.std[name]) for name in shared}
    return replace(
        first,
        fault=first.fault.joined(second.fault),
        std={name: tuple(std[order].tolist()) for name, std in both.items()},
        probability=min(first.probability, second.probability),
        charge=first.charge + second.charge,
    )
