"""The document of an identification, with what was examined and filtered."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from gapscope.arm.dynamics.plain_urdf import moving_links, numbers, plain_urdf
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import GapscopeError
from gapscope.arm.io.atomic_write import atomic_write
from gapscope.arm.io.case_file import moved, read_case_file
from gapscope.arm.io.json_file import field, plain, schema_fault, write_json
from gapscope.arm.io.write_case import nominal_section
from gapscope.arm.joint_units import common_unit
from gapscope.arm.nominal import NominalArm, arm_entry
from gapscope.arm.root_mean_square import rms
from gapscope.effects.applied import AppliedEffect, drives_with
from gapscope.ident.estimators.by_name import method
from gapscope.ident.examination import (
    CONDITION_LIMIT,
    MOVING,
    Examination,
    Validation,
    Whiteness,
)
from gapscope.ident.identification import Identification
from gapscope.ident.intervals import DOUBT, PredictedTorque
from gapscope.ident.kalman import FilterReview, StatesAndFriction, Track
from gapscope.ident.model.base_parameters import TINY
from gapscope.ident.model.friction import PULLS
from gapscope.ident.model.physical_parameters import LinkCheck
from gapscope.model.changes import change_findings

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
        np.savez_compressed(file, allow_pickle=False, **arrays)


# What recordings determine of the parameters, as plain data for ``identification.json``.


def examined_document(
    examined: Examination, predicted: PredictedTorque | None
) -> dict[str, Any]:
    """The sections ``samples``, ``identifiability``, ``essential``, ``repeated_groups`` and ``torque_interval``."""
    shown, counted, names = examined.shown, examined.counted, examined.shown.base.names
    essential, groups = examined.essential, examined.groups
    found: dict[str, Any] = {
        "samples": {
            name: getattr(counted, name)
            for name in ("seconds", "bandwidth", "independent", "per_parameter")
        },
        "identifiability": {
            "structural": shown.base.count,
            "rank": shown.rank,
            "condition": shown.condition,
            "condition_limit": CONDITION_LIMIT,
            "singular_values": shown.singular_values,
            "weakest": shown.weakest,
            "column_norms": dict(zip(names, shown.column_norms, strict=True)),
        },
        "essential": None,
        "repeated_groups": None,
        "torque_interval": None,
        "not_examined": examined.reasons,
    }
    if essential is not None:
        before, after = essential.residual
        found["essential"] = {
            "names": essential.names,
            "relative_std": essential.relative_std,
            "dropped": essential.dropped,
            "residual_growth": after / (before + TINY) - 1,
        }
    if groups is not None:
        meaning = (
            "they differ as much as the errors that they state; an error that all of them share, such as the form of "
            "the friction makes, does not show here"
        )
        found["repeated_groups"] = {
            "count": len(groups.values),
            "stated_std": np.sqrt(groups.stated),
            "std_between": np.sqrt(groups.between),
            "ratio": groups.ratio,
            "p_value": groups.p_value,
            "verdict": groups.verdict,
            "meaning": (*groups.warnings, meaning)[0],
        }
    if examined.interval is not None and predicted is not None:
        error = examined.interval.error
        found["torque_interval"] = {
            "level": predicted.level,
            "half_width": predicted.half_width,
            "half_width_recorded": predicted.recorded,
            "held": predicted.held,
            "model_error": error.systematic,
            "noise": error.noise,
            "p_value": error.p_value,
            "joints_with_model_error": error.found,
        }
    return found


# The filter beside the batch, as ``identification.json`` holds it.


MOMENTS = 60
"""Moments at which the estimates are written, at most."""


def filter_document(review: FilterReview, expressions: Sequence[str]) -> dict[str, Any]:
    """Estimates over time with standard deviations, innovations, convergence, departures.

    Args:
        review: of the filter.
        expressions: the base parameters in words, shape (b,).
    """
    followed, start = review.followed, review.converged
    track, chosen = followed.track, _moments(review.times)
    # the recordings in the order of the filter, each with its end
    until = dict(zip(review.recordings, review.elapsed, strict=True))
    departures = []
    for departure in review.departures:
        k, i = departure.stretch, departure.parameter
        departures.append(
            {
                "expression": expressions[i],
                "recording": review.recordings[k],
                "time": review.times[k],
                "elapsed": review.elapsed[k],
                "filter": track.value[k, i],
                "std": track.deviation[k, i],
                "batch": review.batch[i],
                "standard_errors": departure.size,
            }
        )
    batch = (
        {"expression": e, "batch": x}
        for e, x in zip(expressions, review.batch, strict=True)
    )
    return {
        "process_noise": followed.level,
        "stretch": followed.stretches.length,
        "converged": None if start is None else review.elapsed[start],
        "elapsed": review.elapsed[chosen],
        "recordings": [{"name": name, "until": end} for name, end in until.items()],
        "parameters": _over_time(track, chosen, batch),
        "innovations": {
            "rms": review.rms,
            "samples_per_independent": followed.inflation,
            **_whiteness(review.whiteness),
        },
        "departures": departures,
    }


def _over_time(
    track: Track, chosen: np.ndarray, heads: Iterable[dict[str, Any]]
) -> list[dict[str, Any]]:
    """Entries of parameters with values and standard deviations at some moments, in five significant digits."""
    value, deviation = track.value[chosen].T, track.deviation[chosen].T
    return [
        {**head, "value": _rounded(x), "std": _rounded(s)}
        for head, x, s in zip(heads, value, deviation, strict=True)
    ]


def states_document(states: StatesAndFriction | None) -> dict[str, Any] | None:
    """Friction by the unscented filter over time, and how well it predicts the encoders; ``None`` if not asked for."""
    if states is None:
        return None
    track, chosen = states.friction, _moments(states.friction.t)
    heads = (
        {"name": name, "identified": x}
        for name, x in zip(track.names, states.start, strict=True)
    )
    return {
        "recording": states.recording,
        "time": track.t[chosen],
        "innovation_rms": rms(states.innovation[1:]),
        "parameters": _over_time(track, chosen, heads),
    }


def _moments(times: np.ndarray) -> np.ndarray:
    """Rows of up to ``MOMENTS`` moments, from the first to the last."""
    count = len(times)
    return np.unique(np.linspace(0, count - 1, min(count, MOMENTS)).astype(int))


def _whiteness(white: Whiteness) -> dict[str, Any]:
    return {
        "ljung_box": white.statistic,
        "p_value": white.p_value,
        "level": DOUBT,
        "white": white.white,
        "largest_autocorrelation": white.largest,
        "bound": white.bound,
    }


def _rounded(series: np.ndarray) -> list[float]:
    """Five significant digits, which keeps the file small."""
    return [float(f"{x:.5g}") for x in series]


# The document of an identification, ``identification.json``: checked against its schema and written whole.


def document(
    result: Identification, files: Mapping[str, str] | None = None
) -> dict[str, Any]:
    """What was identified, as plain data in the form of ``identification.schema.json``.

    Args:
        result: what was identified.
        files: what was written beside it, by purpose.
    """
    arm = result.case.arm
    return {
        "schema": 1,
        "case": result.case.name,
        "arm": arm_entry(arm),
        "settings": _settings(result),
        "base": _base(result),
        **examined_document(result.examined, result.predicted),
        "changes": [_change(entry) for entry in change_findings(result.changes)],
        "filter": filter_document(result.filtered, result.base.expressions()),
        "states_and_friction": states_document(result.states),
        "parameters": result.recovered,
        "links": [
            _link(b, a)
            for b, a in zip(result.physical.before, result.physical.after, strict=True)
        ],
        "joint_zeros": {
            "unit": common_unit("rad", arm.sliding),
            "offset": result.zeros.offset,
            "std": result.zeros.deviation,
            "known": result.zeros.known,
            "asked": result.zeros.asked + 1,
        },
        "validation": [_validation(v) for v in result.validation],
        "troubleshooting": result.table,
        "questions": result.questions,
        "warnings": result.warnings,
        "files": dict(files or {}),
    }


def _settings(result: Identification) -> dict[str, Any]:
    """What was asked for, and the friction law and pull that were chosen."""
    choice, settings = result.choice, result.settings
    law = choice.law
    return {
        "cutoff": settings.cutoff,
        "estimator": settings.estimator,
        "trimmed": settings.trim,
        "moving": MOVING,
        "friction": str(law),
        "stribeck_speed": law.stribeck_speed,
        "saturation_speeds": law.saturation_speeds,
        "presliding": law.presliding,
        "pull": choice.pull,
        "strongest_pull": choice.pull >= max(PULLS),
        "tried": [
            {"what": what, "unseen_error": error} for what, error in choice.tried
        ],
    }


def _base(result: Identification) -> dict[str, Any]:
    base, value = result.base, result.estimate.value
    low, high = result.uncertainty.interval(value)
    columns = {
        "expression": base.expressions(),
        "value": value,
        "std": result.uncertainty.deviation,
        "interval": np.column_stack([low, high]),
        "consistent": base.of(result.physical.value),
        "nominal": base.of(result.columns.nominal(result.choice.law)),
    }
    if result.moved is not None:
        columns["moved"] = result.moved
    return {
        "count": base.count,
        "condition": result.condition,
        "interval": method(result.settings.estimator).kind,
        "freedom": result.uncertainty.freedom,
        "parameters": [
            dict(zip(columns, row, strict=True))
            for row in zip(*columns.values(), strict=True)
        ],
    }


def _change(entry: dict[str, Any]) -> dict[str, Any]:
    """A finding of ``change_findings`` with its parameters side by side."""
    names = list(entry["parameters"])
    values, deviations = (
        np.hstack([part[key] for part in entry["parameters"].values()])
        for key in ("value", "std")
    )
    return {
        **{key: x for key, x in entry.items() if key != "times_threshold"},
        "parameters": names,
        "size": values,
        "std": deviations,
        "statistic": entry["times_threshold"],
    }


def _link(before: LinkCheck, after: LinkCheck) -> dict[str, Any]:
    return {
        "link": after.link,
        "mass": after.mass,
        "principal_moments": after.moments,
        "positive_mass": after.positive_mass,
        "positive_inertia": after.positive_inertia,
        "triangle": after.triangle,
        "pseudo_inertia": after.consistent,
        "unconstrained": {"mass": before.mass, "consistent": before.consistent},
    }


def _validation(validation: Validation) -> dict[str, Any]:
    names = ("role", "recordings", "every", "moving", "nominal")
    found = {name: getattr(validation, name) for name in names}
    return {**found, "whiteness": _whiteness(validation.whiteness)}


def check(content: Mapping[str, Any]) -> None:
    """Check a plain document against ``identification.schema.json``.

    Raises:
        GapscopeError: a field is missing or has a wrong value; the message names the field.
    """
    error = schema_fault(content, "identification")
    if error is not None:
        raise GapscopeError(
            f"identification.json, field {field(error.absolute_path) or 'at the top'}: {error.message}",
            "gapscope/schemas/identification.schema.json describes the format",
        )


def write_document(content: Mapping[str, Any], path: Path | str) -> None:
    """Write a document as JSON; ``path`` never holds half of one.

    Raises:
        GapscopeError: the document is not valid, or ``path`` cannot be written.
    """
    found = plain(content, null_if_not_finite=True)
    check(found)
    write_json(found, path)


# The identified arm as files that other tools read: a URDF of consistent bodies, a data sheet, effects.
#
# Any ten parameters per link need a URDF, which ``link_inertia`` of the catalogue (mass and centre of mass alone)
# cannot replace; rotor inertia, Coulomb and viscous friction go into the data sheet; offsets, a Stribeck term, and
# rotor and friction of coupled motors are effects. How it builds up stands beside them.


UNNOTICED = 1e-9
"""Offsets and friction below this are not written [N m]."""
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
    size = arm.per_radian if result.choice.law.presliding else 1.0
    return np.array(distances)[:n] * size


def identified_bodies(result: Identification) -> RigidBody:
    """The identified bodies: base parameters describe none, the consistent ones do."""
    body = result.columns.body
    links = result.physical.value[: 10 * result.case.arm.n_joints]
    return body.changed((links - body.inertial_parameters()).reshape(-1, 10))


def urdf_text(arm: NominalArm, body: RigidBody) -> str:
    """URDF of bodies of an arm: the nominal arm's kinematics and limits, one link per joint, no shapes.

    Frames and axes are those of the nominal arm's joints; inertial frames lie along the principal axes.
    """
    links = moving_links(body)
    root = ET.fromstring(plain_urdf(links))
    root.set("name", arm.name)
    # principal moments in full precision
    for link, element in zip(links, root.findall("link")[1:], strict=True):
        inertia = element.find("inertial/inertia")
        assert inertia is not None
        for key, value in zip(("ixx", "iyy", "izz"), link.moments, strict=True):
            inertia.set(key, repr(float(value)))
    # limits of the nominal arm
    speed, effort = body.velocity_limits(), body.effort_limits()
    for joint in root.findall("joint"):
        limit = joint.find("limit")
        if limit is None:
            continue
        j = arm.joints.index(joint.get("name", ""))
        if speed[j] > 0:
            limit.set("velocity", numbers(speed[j : j + 1]))
        if effort[j] > 0:
            limit.set("effort", numbers(effort[j : j + 1]))
    ET.indent(root)
    return ET.tostring(root, encoding="unicode") + "\n"


def with_sheet(result: Identification) -> NominalArm:
    """The nominal arm with rotor inertia [kg m^2], Coulomb [N m] and viscous friction [N m s/rad] as identified."""
    arm, named = result.case.arm, _named(result)

    def joints(symbol: str) -> np.ndarray:
        values = [named.get(f"{symbol}{j + 1}", 0.0) for j in range(arm.n_joints)]
        return np.array([round(max(value, 0.0), 9) for value in values])

    return replace(arm, armature=joints("I"), coulomb=joints("c"), viscous=joints("b"))


def sheet(result: Identification) -> dict[str, Any]:
    """The ``nominal:`` section of an identified arm."""
    return nominal_section(with_sheet(result))


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
    motors = [(COUPLED, [k]) for k in range(n, len(labels))]
    for quantities, places in (*motors, (DRIVES, list(range(n)))):
        for symbol, quantity in quantities.items():
            values = np.array([named.get(f"{symbol}{labels[k]}", 0.0) for k in places])
            some = np.flatnonzero(np.abs(values) > UNNOTICED)
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
