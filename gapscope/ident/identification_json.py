"""The document of an identification, with what was examined and filtered."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.io.atomic_write import atomic_write
from gapscope.arm.io.case_file import moved, read_case_file
from gapscope.arm.io.write_case import nominal_section
from gapscope.arm.joint_units import common_unit
from gapscope.arm.nominal import NominalArm, arm_entry
from gapscope.arm.root_mean_square import rms
from gapscope.effects.applied import AppliedEffect, drives_with
from gapscope.ident.estimators.by_name import method
from gapscope.ident.identification import Identification
from gapscope.ident.kalman import FilterReview, StatesAndFriction, Track
from gapscope.ident.samples import MOVING, PULLS
from gapscope.model.changes import change_findings
from gapscope.model.conditioning import MIN_FLOOR

# The document of an identification, with what was examined and filtered.


# The base parameters as matrices, both ways: ``base_parameters.npz``.


def write_base(result: Identification, path: Path | str) -> None:
    """Write the base parameters of an identification as arrays; ``path`` never holds half a file.

    ``names`` and ``kept_names`` of the p parameters pi and of the b that represent combinations; ``combination`` C
    with beta = C pi, shape (b, p); ``back`` and ``null_space`` N with pi = back beta + N z for any z, shapes (p, b)
    and (p, p - b); ``value`` and ``covariance`` of beta, ``consistent`` and ``nominal`` pi. ``orthonormal`` V with
    gamma = V^T pi and the shortest pi = V gamma, shape (p, b), by singular value decomposition; ``from_orthonormal``
    and ``to_orthonormal`` T with beta = T gamma and gamma = T beta, shape (b, b).

    Raises:
        GapscopeError: ``path`` cannot be written.
    """
    base, names = result.base, result.base.names
    # the row space of the samples
    orthonormal = np.linalg.svd(base.combination, full_matrices=False)[2].T
    from_orthonormal = base.combination @ orthonormal
    # each base parameter stands for its combination: the others are zero there
    back = np.zeros((len(names), base.count))
    back[base.kept] = np.eye(base.count)
    arrays = {
        "names": np.array(names),
        "kept_names": np.array(base.kept_names),
        "combination": base.combination,
        "back": back,
        "null_space": base.null_space,
        "value": result.estimate.value,
        "covariance": result.uncertainty.covariance,
        "consistent": result.physical.value,
        "nominal": result.columns.nominal(result.choice.law),
        "orthonormal": orthonormal,
        "from_orthonormal": from_orthonormal,
        "to_orthonormal": np.linalg.inv(from_orthonormal),
    }
    with atomic_write(path) as aside, aside.open("wb") as file:
        np.savez_compressed(file, **arrays)


# The filter beside the batch, as ``identification.json`` holds it.


MOMENTS = 60
"""Moments at which the estimates are written, at most."""


def filter_document(review: FilterReview, expressions: Sequence[str]) -> dict[str, Any]:
    """Estimates over time with standard deviations, innovations, convergence, departures.

    Args:
        review: of the filter.
        expressions: the base parameters in words, shape (b,).
    """
    track, start, departures = review.track, review.converged, review.departures
    elapsed, chosen = track.t, _moments(review.times)
    # the recordings in the order of the filter, each with its end
    until = dict(zip(review.recordings, elapsed, strict=True))
    k = [departure.stretch for departure in departures]
    i = [departure.parameter for departure in departures]
    return {
        "process_noise": review.level,
        "stretch": review.length,
        "converged": None if start is None else elapsed[start],
        "elapsed": elapsed[chosen],
        "recordings": _rows(name=until.keys(), until=until.values()),
        "parameters": _rows(
            expression=expressions, batch=review.batch, **_over_time(track, chosen)
        ),
        "innovations": {
            "rms": review.rms,
            "samples_per_independent": review.inflation,
            **vars(review.whiteness),
        },
        "departures": _rows(
            expression=[expressions[place] for place in i],
            recording=[review.recordings[stretch] for stretch in k],
            time=review.times[k],
            elapsed=elapsed[k],
            filter=track.value[k, i],
            std=track.deviation[k, i],
            batch=review.batch[i],
            standard_errors=[departure.size for departure in departures],
        ),
    }


def _rows(**columns: Iterable[Any]) -> list[dict[str, Any]]:
    """The rows of a table given by its columns."""
    rows = zip(*columns.values(), strict=True)
    return [dict(zip(columns, row, strict=True)) for row in rows]


def _over_time(track: Track, chosen: np.ndarray) -> dict[str, list[list[float]]]:
    """Values and standard deviations of each parameter at some moments, in five digits, which keeps the file small."""
    return {
        name: [[float(f"{x:.5g}") for x in own] for own in series[chosen].T]
        for name, series in (("value", track.value), ("std", track.deviation))
    }


def states_document(states: StatesAndFriction | None) -> dict[str, Any] | None:
    """Friction by the unscented filter over time, and how well it predicts the encoders; ``None`` if not asked for."""
    if states is None:
        return None
    track, chosen = states.friction, _moments(states.friction.t)
    return {
        "recording": states.recording,
        "time": track.t[chosen],
        # the first sample starts the filter: nothing predicts it
        "innovation_rms": rms(states.innovation[1:]),
        "parameters": _rows(
            name=track.names, identified=states.start, **_over_time(track, chosen)
        ),
    }


def _moments(times: np.ndarray) -> np.ndarray:
    """Rows of up to ``MOMENTS`` moments, from the first to the last."""
    count = len(times)
    return np.unique(np.linspace(0, count - 1, min(count, MOMENTS)).astype(int))


# The document of an identification, ``identification.json``: checked against its schema and written whole.


def document(
    result: Identification, files: Mapping[str, str] | None = None
) -> dict[str, Any]:
    """What was identified, as plain data in the form of ``identification.schema.json``.

    Args:
        result: what was identified.
        files: what was written beside it, by purpose.
    """
    arm, base, physical = result.case.arm, result.base, result.physical
    settings, choice, law = result.settings, result.choice, result.choice.law
    value, zeros = result.estimate.value, result.zeros
    columns = {
        "expression": base.expressions(),
        "value": value,
        "std": result.uncertainty.deviation,
        "interval": np.column_stack(result.uncertainty.interval(value)),
        "consistent": base.of(physical.value),
        "nominal": base.of(result.columns.nominal(law)),
    }
    # only a partial update leaves some parameters where they were
    if result.moved is not None:
        columns["moved"] = result.moved
    compared = ("role", "recordings", "every", "moving", "nominal", "whiteness")
    return {
        "schema": 1,
        "case": result.case.name,
        "arm": arm_entry(arm),
        # what was asked for, and the friction law and pull that were chosen
        "settings": {
            "cutoff": settings.cutoff,
            "estimator": settings.estimator,
            "trimmed": settings.trim,
            "moving": MOVING,
            "friction": str(law),
            "stribeck_speed": law.stribeck_speed,
            "saturation_speeds": law.saturation_speeds,
            "presliding": law.presliding,
            "pull": choice.pull,
            # at the end of what was tried: a stronger one might be better still
            "strongest_pull": choice.pull >= max(PULLS),
            "tried": [
                {"what": what, "unseen_error": error} for what, error in choice.tried
            ],
        },
        "base": {
            "count": base.count,
            "condition": result.condition,
            "interval": method(settings.estimator).kind,
            "freedom": result.uncertainty.freedom,
            "parameters": _rows(**columns),
        },
        "samples": result.counted,
        "identifiability": result.determined,
        "essential": result.essential,
        "repeated_groups": result.groups,
        "torque_interval": result.predicted,
        "not_examined": result.reasons,
        "changes": [_change(entry) for entry in change_findings(result.changes)],
        "filter": filter_document(result.filtered, base.expressions()),
        "states_and_friction": states_document(result.states),
        "parameters": result.recovered,
        "links": [
            {
                "link": after.link,
                "mass": after.mass,
                "principal_moments": after.moments,
                "positive_mass": after.positive_mass,
                "positive_inertia": after.positive_inertia,
                "triangle": after.triangle,
                "pseudo_inertia": after.consistent,
                "unconstrained": {"mass": before.mass, "consistent": before.consistent},
            }
            for before, after in zip(physical.before, physical.after, strict=True)
        ],
        "joint_zeros": {
            "unit": common_unit("rad", arm.sliding),
            "offset": zeros.offset,
            "std": zeros.deviation,
            "known": zeros.known,
            # joints count from 1 in files, from 0 in arrays
            "asked": zeros.asked + 1,
        },
        "validation": [
            {name: getattr(one, name) for name in compared} for one in result.validation
        ],
        "troubleshooting": result.table,
        "questions": result.questions,
        "warnings": result.warnings,
        "files": dict(files or {}),
    }


def _change(entry: dict[str, Any]) -> dict[str, Any]:
    """A finding of ``change_findings`` with its parameters side by side."""
    parts = entry["parameters"].values()
    found = {key: x for key, x in entry.items() if key != "times_threshold"}
    return {
        **found,
        "parameters": list(entry["parameters"]),
        "size": np.hstack([part["value"] for part in parts]),
        "std": np.hstack([part["std"] for part in parts]),
        "statistic": entry["times_threshold"],
    }


# The identified arm as files that other tools read: a URDF of consistent bodies, a data sheet, effects.
#
# Any ten parameters per link need a URDF, which ``link_inertia`` of the catalogue (mass and centre of mass alone)
# cannot replace; rotor inertia, Coulomb and viscous friction go into the data sheet; offsets, a Stribeck term, and
# rotor and friction of coupled motors are effects. How it builds up stands beside them.


DRIVES = {"o": "offset", "d": "breakaway", "s": "saturating"}
"""Quantity of a joint that is an effect, by the symbol of its column."""
COUPLED = {
    "I": "motor_rotor",
    "b": "motor_damping",
    "c": "motor_friction",
    "d": "motor_breakaway",
    "s": "motor_saturating",
}
"""Quantity of a coupled motor by the symbol of its column."""


def presliding(result: Identification) -> np.ndarray:
    """Distance over which the dry friction of each joint builds up, and of the motor of its number [rad], (n,)."""
    distances = result.choice.law.presliding or result.case.arm.presliding
    n, arm = result.case.arm.n_joints, result.case.arm
    # the law counts as a radian what does, the data sheet each joint's own unit
    size = arm.per_radian if result.choice.law.presliding else 1.0
    return np.array(distances)[:n] * size


def identified_bodies(result: Identification) -> RigidBody:
    """The identified bodies: base parameters describe none, the consistent ones do."""
    body = result.columns.body
    links = result.physical.value[: 10 * result.case.arm.n_joints]
    return body.changed((links - body.inertial_parameters()).reshape(-1, 10))


def with_sheet(result: Identification) -> NominalArm:
    """The nominal arm with rotor inertia [kg m^2], Coulomb [N m] and viscous friction [N m s/rad] as identified."""
    arm, named = result.case.arm, _named(result)

    def joints(symbol: str) -> np.ndarray:
        values = [named.get(f"{symbol}{j + 1}", 0.0) for j in range(arm.n_joints)]
        # friction below zero is no data sheet's: the simulator would gain energy
        return np.array([round(max(value, 0.0), 9) for value in values])

    return replace(arm, armature=joints("I"), coulomb=joints("c"), viscous=joints("b"))


def effects(result: Identification) -> tuple[AppliedEffect, ...]:
    """Offsets, Stribeck and saturating friction, rotors and friction of coupled motors as effects."""
    columns, law, named = result.columns, result.choice.law, _named(result)
    n, labels = result.case.arm.n_joints, columns.labels
    # the friction law has its speeds in what counts as a radian
    speeds = {}
    if law.stribeck_speed is not None:
        speeds["d"] = law.stribeck_speed * columns.per_radian
    if law.saturation_speeds is not None:
        speeds["s"] = np.array(law.saturation_speeds) * columns.per_radian
    found = []
    # coupled motors one by one, the joints all together
    motors = [(COUPLED, [k]) for k in range(n, len(labels))]
    for quantities, places in (*motors, (DRIVES, list(range(n)))):
        for symbol, quantity in quantities.items():
            values = np.array([named.get(f"{symbol}{labels[k]}", 0.0) for k in places])
            some = np.flatnonzero(np.abs(values) > MIN_FLOOR)
            chosen = [places[i] for i in some]
            own = {quantity: values[some]}
            if symbol in speeds:
                own[f"{quantity}_speed"] = speeds[symbol][chosen]
            numbers = tuple(int(labels[k].removesuffix("m")) for k in chosen)
            if numbers:
                found.append(drives_with(numbers, **own))
    return tuple(found)


def write_case_beside(arm: NominalArm, source: Path, path: Path, urdf: str) -> None:
    """Write a case like the one at ``source`` whose nominal arm is the identified one.

    Args:
        arm: the identified arm.
        source: the case file.
        path: the case file to write; the recordings stay where they are.
        urdf: name of the URDF beside it.

    Raises:
        GapscopeError: the file cannot be written.
    """
    content = moved(read_case_file(source), source.parent, path.parent)
    # the URDF holds the arm's moving bodies alone
    for key in ("chain", "locked"):
        content.pop(key, None)
    content |= {
        "name": f"{content['name']} identified",
        "robot": urdf,
        "joints": list(arm.joints),
        "gravity": arm.gravity.tolist(),
        "nominal": nominal_section(arm),
    }
    with atomic_write(path) as aside:
        aside.write_text(
            yaml.safe_dump(
                content, sort_keys=False, default_flow_style=None, width=120
            ),
            encoding="utf-8",
        )


def _named(result: Identification) -> dict[str, float]:
    names = result.columns.names(result.choice.law)
    return dict(zip(names, result.physical.value.tolist(), strict=True))
