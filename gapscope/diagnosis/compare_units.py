"""Units of one type: effects that they share or not, values that differ, types of friction, and what is mixed up."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import pi
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import chi2
from threadpoolctl import threadpool_limits

from gapscope.arm.case import load_case
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import GapscopeError, InputError
from gapscope.arm.io.json_file import plain
from gapscope.arm.nominal import SHEET_UNITS, NominalArm
from gapscope.arm.root_mean_square import SMALLEST
from gapscope.diagnosis.document.diagnosis_json import read_document
from gapscope.diagnosis.document.numbers import Number, numbers_of
from gapscope.diagnosis.gap.plausible_data import no_torque
from gapscope.diagnosis.thresholds import (
    ALIKE_NRMSE,
    EFFECT_FORM,
    FLEET_LEVEL,
    FRICTION_DAY_TO_DAY,
    VISIBLE_EFFECT,
)
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.catalogue import CATALOGUE
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.corrected_file import read_corrected_arm
from gapscope.effects.effect import TorqueLaw
from gapscope.envs.effect_ranges import (
    EffectRange,
    EffectRanges,
    effect_range,
    spread,
    within_nominal,
)
from gapscope.model.changes import FRICTION, PLAIN_FRICTION, own_of_units
from gapscope.model.conditioning import condition
from gapscope.model.rows import comparable
from gapscope.model.torque_gap import torque_gap

# The ranges of effects from the files of one or several diagnoses.


ROUNDING = 1e-6
"""Relative difference up to which a value is the same in two files, and exact but for rounding [1]."""


def read_ranges(
    corrected: Path, found: CorrectedArm, units: Sequence[Path]
) -> EffectRanges:
    """The 95 % intervals of a diagnosis, or the ranges that hold those of several units.

    Args:
        corrected: the file with the effects; ``diagnosis.json`` is beside it.
        found: the arm with them.
        units: folders of diagnoses of other units of the same type.

    Raises:
        InputError: a diagnosis is missing or not that of its ``corrected.yaml``, or of another arm.
    """
    # the unit itself is one of those that the ranges have to hold
    intervals = [_intervals(corrected, found.effects)]
    for folder in units:
        file = folder / "corrected.yaml"
        other = read_corrected_arm(found.arm, file)
        intervals.append(_intervals(file, other.effects))
    return within_nominal(spread(intervals), found.arm)


def _intervals(
    corrected: Path, effects: tuple[AppliedEffect, ...]
) -> list[EffectRange]:
    """The intervals of the effects of one unit."""
    path = corrected.parent / "diagnosis.json"
    findings = read_document(path)["effects"]
    intervals = []
    for applied in effects:
        # values tie the file to its diagnosis: another run may name the same effect
        same = (f for f in findings if _is_of(f, applied))
        finding = next(same, None)
        if finding is None:
            raise InputError(
                f"has no {applied.name} with the values of {corrected.name}",
                "give the corrected.yaml that gapscope diagnose wrote beside it, unchanged",
                file=path,
                where="effects",
            )
        # what has no standard deviation keeps its value
        stds = {
            p.name: np.nan_to_num(
                np.array(finding["parameters"][p.name]["std"], dtype=float)
            )
            for p in map(applied.effect.parameter, applied.given)
        }
        intervals.append(effect_range(applied, stds))
    return intervals


def _is_of(finding: Mapping[str, Any], applied: AppliedEffect) -> bool:
    """Whether a finding is that of an effect with its values."""
    if finding["effect"] != applied.name or finding["joints"] != list(applied.joints):
        return False
    return all(
        np.allclose(
            np.array(finding["parameters"][name]["value"], dtype=float),
            value,
            rtol=ROUNDING,
            atol=0.0,
        )
        for name, value in applied.parameters.items()
        if name in applied.given
    )


# Whether values estimated on several units are the same but for their uncertainty, and what their common value is.


@dataclass(frozen=True)
class Pooled:
    """Values x_i with standard deviations s_i of k units, taken together.

    Fixed effect: weights w_i = 1 / s_i^2, mean m = sum w x / sum w. Cochran's Q = sum w_i (x_i - m)^2 is chi-squared
    with k - 1 degrees of freedom if all units have one value [cochran1954]; I^2 = max(0, 1 - (k - 1) / Q) is the
    share of the scatter that the s_i do not account for [higgins2002]. Random effects: each unit has its own value,
    drawn around the common one with variance tau^2, here by moments [dersimonian1986].

    Attributes:
        estimate: common value, weights 1 / (s_i^2 + tau^2).
        std: its standard deviation.
        between: tau, by which the units differ beyond their s_i.
        q: Cochran's Q [1].
        p: probability of a Q at least as large if all units have one value [1].
        i_squared: I^2 [1].
    """

    estimate: float
    std: float
    between: float
    q: float
    p: float
    i_squared: float


def pooled(
    values: Sequence[float], stds: Sequence[float | None], form: float = EFFECT_FORM
) -> Pooled:
    """Take the values of several units together.

    Args:
        values: one per unit, (k,).
        stds: their standard deviations, in the same unit; ``None`` or 0 if not known.
        form: share of the mean magnitude that is added to each deviation in squares: the catalogue's laws are simple,
            real ones differ in form, and two units that were moved differently then differ by that much.
    """
    x = np.asarray(values, dtype=float)
    size = np.abs(x).mean()
    s = np.array([0.0 if std is None else std for std in stds])
    # form and rounding keep each deviation above zero, and so all weights finite
    s = np.sqrt(s**2 + (form * size) ** 2 + (ROUNDING * size) ** 2 + SMALLEST)
    unit = (
        s.min()
    )  # weights relative to the largest: no overflow if deviations are tiny
    w = (unit / s) ** 2
    # relative to the first value: no loss of digits
    mean = x[0] + (w * (x - x[0])).sum() / w.sum()
    q = float((w * ((x - mean) / unit) ** 2).sum())
    freedom = len(x) - 1
    # tau^2 = (Q - (k - 1)) / (sum w - sum w^2 / sum w), back in the squared unit
    spread = w.sum() - (w**2).sum() / w.sum()
    tau2 = max(0.0, q - freedom) / spread * unit**2 if freedom and spread > 0 else 0.0
    # weights once more, with what the units themselves differ by
    w = unit**2 / (s**2 + tau2)
    return Pooled(
        estimate=float(x[0] + (w * (x - x[0])).sum() / w.sum()),
        std=float(unit / np.sqrt(w.sum())),
        between=float(np.sqrt(tau2)),
        q=q,
        p=float(chi2.sf(q, freedom)) if freedom else 1.0,
        i_squared=max(0.0, 1.0 - freedom / q) if q > 0 else 0.0,
    )


# Effects that several units of one type of arm share, and effects of one of them.


ANGLES = ("phase",)
"""Parameters that repeat after a full turn, of which a share means nothing."""
SHARED, DIFFERING, SOME, ONE = (
    "shared",
    "shared_differing_size",
    "some_units",
    "one_unit",
)
ORDER = (SHARED, DIFFERING, SOME, ONE)


Place = tuple[str, int | None, int | None]
"""An effect, and its joint, or the link that it changes."""


def groups(
    documents: Mapping[str, Document],
) -> dict[tuple[str, tuple[str, ...]], dict[str, Document]]:
    """Diagnoses by robot and joints: only arms of one type are compared."""
    found: dict[tuple[str, tuple[str, ...]], dict[str, Document]] = {}
    for unit, document in documents.items():
        # a diagnosis that does not say of which arm it is compares with none
        if "arm" in document:
            arm = document["arm"]
            found.setdefault((arm["robot"], tuple(arm["joints"])), {})[unit] = document
    return found


def compare(documents: Mapping[str, Document]) -> list[dict[str, Any]]:
    """Compare the diagnoses of units of one type of arm.

    Args:
        documents: content of ``diagnosis.json`` by name of the unit; two or more.

    Returns:
        Each effect on each place as in ``units.json``; those on all units first, the largest share first among equals.
        ``instead``: units without it if an effect was found of which it is an alternative, and that effect.
    """
    numbers = (
        (unit, number, float(entry["share"]))
        for unit, document in documents.items()
        for entry in document["effects"]
        for number in numbers_of(entry)
    )
    rows = []
    for row in shared_effects(numbers, len(documents)):
        place = row["effect"], row["joint"], row["link"]
        rows.append({**row, "instead": _instead(documents, place, row["units"])})
    # those on all units first, then the largest share
    return sorted(
        rows,
        key=lambda row: (
            ORDER.index(row["kind"]),
            -max(row["shares"].values()),
            row["joint"] or 0,
        ),
    )


def shared_effects(
    numbers: Iterable[tuple[str, Number, float]], count: int
) -> list[dict[str, Any]]:
    """Each effect on each place, and the units that have it.

    Args:
        numbers: a unit, a number of one of its effects, and the share of that effect [1].
        count: units that were diagnosed.

    Returns:
        Of each ``effect``, ``joint``, ``link``, ``units`` and ``shares`` by unit, and how the units compare.
        ``kind``: ``shared``: on all units, values agree; ``shared_differing_size``: on all, values differ;
        ``some_units``: on two or more, not on all; ``one_unit``. ``agree``: whether no value differs, the level divided
        by the number of values tested; ``None`` for one unit. ``parameters``: numbers that all of these units have.
    """
    found: dict[Place, dict[str, dict[tuple[str, str], Number]]] = {}
    shares: dict[Place, dict[str, float]] = {}
    for unit, number, share in numbers:
        # effect, joint and link come first in a number
        place = number[:3]
        own = found.setdefault(place, {}).setdefault(unit, {})
        own[number.parameter, number.component] = number
        shares.setdefault(place, {})[unit] = share
    return [
        {**_shared(place, by_unit, count), "shares": shares[place]}
        for place, by_unit in found.items()
    ]


def _shared(
    place: Place, by_unit: Mapping[str, Mapping[tuple[str, str], Number]], count: int
) -> dict[str, Any]:
    """One effect on one place: its numbers on each unit that has it, by parameter and component, compared."""
    parameters: list[dict[str, Any]] = []
    first, *others = by_unit.values()
    for name, component in first:
        if not name or any((name, component) not in other for other in others):
            continue
        numbers = {unit: own[name, component] for unit, own in by_unit.items()}
        values = {unit: float(n.value or 0.0) for unit, n in numbers.items()}
        stds = {unit: n.std for unit, n in numbers.items()}
        together = _together(name, list(values.values()), list(stds.values()))
        parameters.append(
            {
                "name": name,
                "component": component,
                "unit": first[name, component].unit,
                "value": values,
                "std": stds,
                "together": together and vars(together),
            }
        )
    # one rate of false alarms over all numbers of the effect
    level = FLEET_LEVEL / max(len(parameters), 1)
    pools = [parameter["together"] for parameter in parameters]
    agree = all(pool is None or pool["p"] >= level for pool in pools)
    kind = SHARED if agree else DIFFERING
    if len(by_unit) < count:
        kind = SOME
    effect, joint, link = place
    return {
        "effect": effect,
        "joint": joint,
        "link": link,
        "kind": kind if others else ONE,
        "units": list(by_unit),
        "agree": agree if others else None,
        "parameters": parameters,
    }


def _instead(
    documents: Mapping[str, Document], place: Place, having: Collection[str]
) -> dict[str, str]:
    """By unit that lacks an effect one found on the place of which it is an alternative."""
    effect, joint, _ = place
    found: dict[str, str] = {}
    for unit, document in documents.items():
        for entry in document["effects"] if unit not in having else ():
            # an effect on the arm or on a link lists no joints
            here = joint in entry["joints"] if joint else not entry["joints"]
            if here and any(o["effect"] == effect for o in entry["alternatives"]):
                found.setdefault(unit, str(entry["effect"]))
    return found


def _together(
    name: str, values: Sequence[float], stds: Sequence[float | None]
) -> Pooled | None:
    """The values of all units taken together; ``None`` for one unit."""
    if len(values) < 2:
        return None
    if name not in ANGLES:
        return pooled(values, stds)
    # within half a turn of the first; a share of an angle means nothing, so that no error of form is added
    first = values[0]
    turns = [float(first + np.remainder(a - first + pi, 2 * pi) - pi) for a in values]
    return pooled(turns, stds, form=0.0)


# One law of friction for a type of robot, unless a unit shows otherwise.
#
# Units of one design rub alike, by different amounts. Where each of them has friction on a joint, but by different
# laws, most of them tell the law; the others are asked again without what they have in its place, and keep their own
# where that explains more.


Document = Mapping[str, Any]


def other_laws(documents: Mapping[str, Document]) -> dict[str, tuple[str, ...]]:
    """Laws of friction that units have in the place of those of their type, by the unit.

    Args:
        documents: content of ``diagnosis.json`` by name of the unit.
    """
    out: dict[str, tuple[str, ...]] = {}
    for members in groups(documents).values():
        # of two units neither has the law of the type
        if len(members) <= 2:
            continue
        own = {unit: _laws(document) for unit, document in members.items()}
        # joints on which all of them have friction
        joints = set.intersection(*(set(laws) for laws in own.values()))
        common: set[str] = set()
        apart: dict[str, set[str]] = {unit: set() for unit in members}
        for joint in sorted(joints):
            counts = Counter(laws[joint] for laws in own.values())
            (most, number), *others = counts.most_common()
            common |= most
            # a tie tells no law of the type
            if others and number > others[0][1]:
                for unit, laws in own.items():
                    apart[unit] |= laws[joint] - most
        # a law that the type has on another joint cannot be left out
        kept = {unit: tuple(sorted(names - common)) for unit, names in apart.items()}
        out |= {unit: names for unit, names in kept.items() if names}
    return out


def _laws(document: Document) -> dict[int, frozenset[str]]:
    """Names of the laws of friction by joint, of those on which there are any."""
    found: dict[int, set[str]] = {}
    for entry in document["effects"]:
        effect = CATALOGUE.get(entry["effect"])
        if isinstance(effect, TorqueLaw) and effect.family == "friction":
            for joint in entry["joints"]:
                found.setdefault(joint, set()).add(effect.name)
    return {joint: frozenset(names) for joint, names in found.items()}


def explains_as_much(asked: Document, before: Document) -> bool:
    """Whether a diagnosis with the law of the type leaves no more of any joint's torque than that with a unit's own."""
    if asked["verdict"] != before["verdict"]:
        return False
    left, least = (
        np.array(document["gap"]["after"]["torque_nrmse"], dtype=float)
        for document in (asked, before)
    )
    # more by less than can be seen is as much
    return bool((left <= least + VISIBLE_EFFECT).all())


# Which unit is this? The corrected arm of each unit predicts the torque recorded on every other.


NOMINAL = "nominal"
"""Row of the arm without effects."""


@dataclass(frozen=True)
class FleetUnit:
    """One unit: its case, and what its diagnosis found.

    Attributes:
        name: name of the unit.
        case: folder of the case, or its case file.
        corrected: its ``corrected.yaml``.
    """

    name: str
    case: Path
    corrected: Path


@dataclass(frozen=True)
class ConfusionColumn:
    """How well each arm predicts the recordings of one unit, R arms with n joints.

    Attributes:
        unit: whose recordings.
        torque_nrmse: of each arm, (n,) [1]; ``None`` for an arm that cannot predict them.
        problem: why there is no value at all, else empty.
    """

    unit: str
    torque_nrmse: Mapping[str, np.ndarray | None]
    problem: str = ""

    def mean(self, row: str) -> float | None:
        """Mean over the joints of one arm's torque NRMSE [1]."""
        values = self.torque_nrmse.get(row)
        return None if values is None else float(values.mean())

    @property
    def best(self) -> str | None:
        """The unit whose arm leaves least; the unit itself among equals."""
        means = {row: self.mean(row) for row in self.torque_nrmse if row != NOMINAL}
        known = {row: mean for row, mean in means.items() if mean is not None}
        if not known:
            return None
        return min(known, key=lambda row: (known[row], row != self.unit))

    @property
    def confused_with(self) -> tuple[str, ...]:
        """Other units whose arm predicts this one as well: no larger mean, or no joint worse by ``ALIKE_NRMSE``."""
        own = self.torque_nrmse.get(self.unit)
        if own is None:
            return ()
        alike = []
        for row, nrmse in self.torque_nrmse.items():
            if row in (NOMINAL, self.unit) or nrmse is None:
                continue
            if nrmse.mean() <= own.mean() or (nrmse - own).max() < ALIKE_NRMSE:
                alike.append(row)
        return tuple(alike)


def confusion_column(unit: FleetUnit, units: Sequence[FleetUnit]) -> ConfusionColumn:
    """Predict the recordings of a unit with the nominal arm and with the corrected arm of every unit.

    An arm is the URDF and data sheet of its own case with the effects found there; gravity is that of the unit that was
    recorded, which may hang from another wall. Nothing is read but cases and ``corrected.yaml``. The unit's own arm was
    fitted to these recordings, or to most of them, and has the advantage of that.
    """
    nrmse: dict[str, np.ndarray | None] = {}
    try:
        case = load_case(unit.case)
        # held-out ones too: their torque judges all arms alike
        every = tuple(r for r in (*case.recordings, *case.judged) if r.tau is not None)
        if not every:
            raise no_torque(case)
        segments = [segment for recording in every for segment in condition(recording)]
        arms = {NOMINAL: CorrectedArm(case.arm)}
        for other in units:
            arm = case.arm
            if other.name != unit.name:
                arm = load_case(other.case, read_recordings=False).arm
            # the other arm, hung where the recorded unit hangs
            mounted = replace(arm, gravity=case.arm.gravity)
            # with all that predicts beside its effects, of the last of its states
            whole = read_corrected_arm(mounted, other.corrected)
            arms[other.name] = replace(whole, states=())
        for row, predicting in arms.items():
            found = torque_gap(predicting, RigidBody(predicting.arm), segments).nrmse
            nrmse[row] = found if np.isfinite(found).all() else None
    # a case that cannot be read costs its own column alone
    except GapscopeError as error:
        return ConfusionColumn(unit.name, {}, str(error))
    return ConfusionColumn(unit.name, nrmse)


# What one unit has and the others have not: the contrast of their recordings (``gapscope.model``).


def unit_differences(units: Sequence[FleetUnit]) -> list[dict[str, Any]] | None:
    """What units of a type have of their own: ``unit``, ``what``, ``joints``, ``probability`` and ``parameters``.

    ``None`` if their recordings cannot be compared: one unit has none that is long enough, or hangs otherwise.
    """
    if len(units) < 2:
        return None
    try:
        cases = [load_case(unit.case) for unit in units]
    except GapscopeError:  # the case was changed since; its column shows it
        return None
    first = cases[0].arm
    recorded = {
        unit.name: comparable((*case.recordings, *case.judged))
        for unit, case in zip(units, cases, strict=True)
    }
    hung = all(np.allclose(case.arm.gravity, first.gravity) for case in cases)
    if not (hung and all(recorded.values())):
        return None
    with threadpool_limits(1):
        return own_of_units(recorded, first, FRICTION_DAY_TO_DAY)


def is_of(difference: Mapping[str, Any], row: Mapping[str, Any]) -> bool:
    """Whether a difference between units is of an effect and place of ``units.json``."""
    term = CATALOGUE.get(row["effect"])
    friction = term is not None and set(term.quantities.values()) & set(FRICTION)
    what = PLAIN_FRICTION if friction else row["effect"]
    joints = [row["joint"]] if row["joint"] else []
    return (difference["what"], difference["joints"]) == (what, joints)


# The comparison of several units as data: ``units.json``.


SPOILS = (
    "sign_flip",
    "joint_swap",
    "unit_mismatch",
    "shifted_inertials",
    "torque_unit",
    "gravity_compensated_torque",
    "zero_offset",
    "unmeasured_torque",
)
"""Faults of a set-up with which the recordings, or the arm believed, are of no use to another unit."""


@dataclass(frozen=True)
class FleetGroup:
    """Units of one type of arm.

    Attributes:
        robot: name of the robot.
        joints: names of its joints.
        documents: diagnosis of each unit.
        units: those that take part in the confusion.
        left_out: those that do not, and why.
        differ: what the cases do not believe alike of the nominal arm: ``urdf``, or entries of the data sheet.
    """

    robot: str
    joints: tuple[str, ...]
    documents: Mapping[str, Document]
    units: tuple[FleetUnit, ...]
    left_out: Mapping[str, str]
    differ: tuple[str, ...]


def grouped(
    documents: Mapping[str, Document], units: Sequence[FleetUnit]
) -> tuple[tuple[FleetGroup, ...], tuple[str, ...]]:
    """Groups of two and more units of one type of arm, and the units that are alone.

    Args:
        documents: diagnosis of each unit, by its name.
        units: where each unit's case and ``corrected.yaml`` lie.
    """
    made = []
    for (robot, joints), members in groups(documents).items():
        if len(members) < 2:
            continue
        own = [unit for unit in units if unit.name in members]
        # those with a faulty set-up take no part in the confusion
        problems = {}
        for name, document in members.items():
            effects = [entry["effect"] for entry in document["effects"]]
            faults = [e.replace("_", " ") for e in effects if e in SPOILS]
            if faults:
                problems[name] = f"its set-up is at fault: {', '.join(faults)}"
        sound = tuple(unit for unit in own if unit.name not in problems)
        # one unit alone cannot be taken for another
        sound = sound if len(sound) > 1 else ()
        group = FleetGroup(robot, joints, members, sound, problems, _differ(own))
        made.append(group)
    compared = {unit for group in made for unit in group.documents}
    return tuple(made), tuple(unit for unit in documents if unit not in compared)


def units_document(
    made: Sequence[tuple[FleetGroup, Sequence[ConfusionColumn]]],
    alone: Sequence[str],
    differences: Sequence[Sequence[Mapping[str, Any]] | None],
) -> dict[str, Any]:
    """Content of ``units.json``: per type of arm the effects compared, what units have of their own, the confusion."""
    content = {
        "schema": 1,
        "groups": [
            {
                "robot": group.robot,
                "joints": group.joints,
                "units": list(group.documents),
                "nominal_differs": group.differ,
                "effects": compare(group.documents),
                "differences": own,
                "confusion": _confusion(columns, group.left_out),
            }
            for (group, columns), own in zip(made, differences, strict=True)
        ],
        "alone": alone,
    }
    document: dict[str, Any] = plain(content)
    return document


def _differ(units: Sequence[FleetUnit]) -> tuple[str, ...]:
    """What the nominal arms of units do not have alike."""
    try:
        arms = [load_case(unit.case, read_recordings=False).arm for unit in units]
    except GapscopeError:  # the case was changed since; its column shows it
        return ()
    first, *others = arms
    # by content: copies of one robot file lie in many folders
    urdf = first.urdf.read_bytes()
    differ = []
    if any(arm.urdf.read_bytes() != urdf for arm in others):
        differ.append("urdf")
    for key in SHEET_UNITS:
        if not all(_same(first, arm, key) for arm in others):
            differ.append(key)
    return tuple(differ)


def _same(one: NominalArm, other: NominalArm, key: str) -> bool:
    a, b = getattr(one, key), getattr(other, key)
    # stated in one case and left out of the other is not alike
    if a is None or b is None:
        return a is b
    return bool(np.allclose(a, b, rtol=ROUNDING))


def _confusion(
    columns: Sequence[ConfusionColumn], left_out: Mapping[str, str]
) -> dict[str, Any]:
    """Means over the joints and values per joint, rows by columns; problems of columns count as left out."""
    shown = [c for c in columns if not c.problem]
    # a unit whose own recordings fail still has a row: its arm predicts the others
    rows = [NOMINAL, *(c.unit for c in columns)] if shown else []
    return {
        "rows": rows,
        "columns": [c.unit for c in shown],
        "torque_nrmse": [[c.mean(row) for c in shown] for row in rows],
        "torque_nrmse_per_joint": [
            [c.torque_nrmse.get(row) for c in shown] for row in rows
        ],
        "best": {c.unit: c.best for c in shown},
        "confused_with": {c.unit: c.confused_with for c in shown},
        "left_out": {**left_out, **{c.unit: c.problem for c in columns if c.problem}},
    }
