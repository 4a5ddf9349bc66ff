"""What a case reads wrongly, by its torque: the one answer of ``inspect``, ``check`` and ``identify``."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import yaml

from gapscope.arm.case import Case
from gapscope.arm.display import effect_name, listing
from gapscope.arm.joint_units import common_unit
from gapscope.arm.nominal import NominalArm
from gapscope.arm.root_mean_square import rms
from gapscope.diagnosis.document.wording import (
    another_scale,
    capital,
    misread,
    much,
)
from gapscope.diagnosis.gap.plausible_data import check_moving, select_windows
from gapscope.diagnosis.setup_faults.detection import (
    as_nominal_arm,
    find_setup_faults,
    nominal_gap,
    upright,
)
from gapscope.diagnosis.setup_faults.fault_search import common_factor
from gapscope.diagnosis.setup_faults.found_fault import FoundFault, repaired
from gapscope.effects.setup_faults import TimeStamps, TorqueUnit, UnitMismatch

# One line of the check of a case.


LEVELS = ("ok", "warn", "error")
"""As it should be; can be diagnosed, with what it costs; cannot be diagnosed."""


@dataclass(frozen=True)
class Remark:
    """One line of the check of a case.

    Attributes:
        level: one of ``LEVELS``.
        topic: ``case``, ``recordings``, ``channels``, ``time``, ``positions``, ``torque``, ``excitation``,
            ``data sheet``, ``controller`` or ``model``.
        place: recordings or joints that it concerns, or an empty string.
        said: what was found, with numbers and units.
        remedy: what to do; empty if nothing is to be done.
    """

    level: str
    topic: str
    place: str
    said: str
    remedy: str = ""

    @property
    def text(self) -> str:
        """What was found, and where."""
        return f"{self.place}: {self.said}" if self.place else self.said


def numbers(joints: list[int]) -> str:
    """Joints, counted from 1, in words."""
    listed = ", ".join(str(joint) for joint in joints)
    return f"joint {listed}" if len(joints) == 1 else f"joints {listed}"


@dataclass(frozen=True)
class SetUp:
    """How the torque of a case fits its nominal arm as it is read.

    Attributes:
        faults: faults of the set-up, in the order in which they must be corrected.
        arm: nominal arm, the faults put right, with the gravity that the case says.
        shown: gravity that the torque shows [m/s^2], (3,); the arm's own object unless the base is mounted turned.
        off: RMS over the joints of the nominal arm's gap, the faults put right [1]; ``None`` if it makes no sense.
        another_arm: whether the recordings are of another arm than the nominal one.
        factor: on all torques that explains them decisively better, and its deviation [1]; ``None`` if none does.
    """

    faults: tuple[FoundFault, ...]
    arm: NominalArm
    shown: np.ndarray
    off: float | None
    another_arm: bool
    factor: tuple[float, float] | None

    @property
    def misreads(self) -> bool:
        """Whether the case reads another arm out of its log than was recorded: bodies fitted so are those of no arm."""
        turned = self.shown is not self.arm.gravity
        mends = (_mend(fault, self.arm.n_joints) for fault in self.faults)
        return self.another_arm or turned or any(mends)

    def remarks(self) -> Iterator[Remark]:
        """What is wrong, each with the line that puts it right; or that nothing is."""
        for fault in self.faults:
            yield fault_remark(fault, self.arm.n_joints)
        if self.factor is not None:
            yield Remark("warn", "torque", "", *another_scale(*self.factor))
        if self.off is None:
            return
        said, remedy = misread(
            self.off, self.shown, self.arm.gravity, another=self.another_arm
        )
        if said:
            yield Remark("warn", "torque", "", said, remedy)
        # nothing but stamps is wrong: the columns are read right
        elif self.factor is None and all(_topic(f) == "time" for f in self.faults):
            unit = common_unit("N m", self.arm.sliding)
            yield Remark(
                "ok",
                "torque",
                "",
                f"in {unit} of the joint, gravity included: no other unit, sign, order or clock of the columns "
                f"explains it better; the nominal arm is off by {much(self.off)} it",
            )


def look_at_set_up(case: Case, seen: Sequence[FoundFault] = ()) -> SetUp:
    """How the torque of a case fits its nominal arm, by the search with which a diagnosis begins.

    Args:
        case: the case, with references put right.
        seen: faults of references.

    Raises:
        InputError: the arm stands still, or time stamps cannot be put right.
    """
    check_moving(case)
    # as a diagnosis begins, so that all commands say the same
    found, another = as_nominal_arm(case, find_setup_faults(case))
    right = repaired(case, found)
    # the gap with the gravity that the case says, then the gravity that shows
    gap, mounted = nominal_gap(right), upright(right)
    return SetUp(
        # references were put right before the rest could be looked for
        faults=(*seen, *found),
        arm=right.arm,
        shown=mounted.arm.gravity,
        off=None if gap is None else float(rms(gap, None)),
        another_arm=another,
        # a factor between two different arms says nothing
        factor=None if another else common_factor(select_windows(mounted)),
    )


def fault_remark(fault: FoundFault, n_joints: int) -> Remark:
    """A fault in words, by how much the gap falls if it is put right, and the line that does that."""
    variant = f" ({fault.variant.replace('_', ' ')})" * bool(fault.variant)
    said = f"{capital(effect_name(fault.name))}{variant}, probability {fault.probability:.0%}"
    before, after = fault.gap_without_this, fault.gap_after
    if before is not None and after is not None:
        read, right = (much(float(rms(gap, None))) for gap in (before, after))
        # as rounded: a gap that reads the same convinces nobody
        if read != right:
            said += f": the nominal arm is off by {read} the torque as it is read, by {right} it if that is put right"
    # a line to be copied by hand: five digits are enough
    mend = _rounded(_mend(fault, n_joints))
    line = yaml.safe_dump(mend, default_flow_style=True, width=1000).strip()
    remedy = (
        f"import: {{mend: {line}}} puts it right; gapscope diagnose writes mended_case.yaml"
        if mend
        else "gapscope diagnose puts it right and says what to correct"
    )
    # a factor fitted to the nominal arm is only as good as that arm
    if mend and isinstance(fault.fault, TorqueUnit | UnitMismatch) and fault.std:
        (values,), (stds,) = fault.fault.values().values(), fault.std.values()
        share = max(std / abs(x) for x, std in zip(values, stds, strict=True))
        remedy += (
            f"; by the torque alone to ± {share:.0%}: put there what a data sheet says"
        )
    places = [
        *fault.recordings,
        *([numbers(list(fault.joints))] * bool(fault.joints)),
    ]
    return Remark("warn", _topic(fault), listing(places), said, remedy)


def _mend(fault: FoundFault, n_joints: int) -> dict[str, Any]:
    """The entry of ``mend:`` that puts a fault right; empty if none does."""
    return fault.reading(n_joints).to_mend()


def _topic(fault: FoundFault) -> str:
    """What of a case a fault is of."""
    if fault.name == TimeStamps.name:
        return "time"
    # which fields differ does not depend on the number of joints
    reading = fault.fault.reading(max(fault.joints, default=1))
    topics = {
        "positions": ("motion",),
        "controller": ("kp_factor", "kd_factor", "law", "lead", "pace"),
        "model": ("link_shift",),
    }
    return next((t for t, what in topics.items() if reading.differs(*what)), "torque")


def _rounded(entry: Any) -> Any:
    """An entry of a case file with as many digits of its numbers as a person copies."""
    if isinstance(entry, dict):
        return {key: _rounded(value) for key, value in entry.items()}
    if isinstance(entry, (list, tuple)):
        return [_rounded(value) for value in entry]
    return float(f"{entry:.5g}") if isinstance(entry, float) else entry
