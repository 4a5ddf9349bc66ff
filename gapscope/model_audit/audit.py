"""The audit of a model: findings over its description, worst first, and the torque of still poses."""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from gapscope.arm.case import load_case
from gapscope.arm.display import marked
from gapscope.arm.dynamics.description import (
    Description,
    Joint,
    Link,
    read_description,
)
from gapscope.arm.dynamics.rigid_body import RigidBody, arm_model
from gapscope.arm.errors import GapscopeError, InputError
from gapscope.arm.input_file import is_file
from gapscope.arm.io.case_file import is_case
from gapscope.arm.io.json_file import plain
from gapscope.arm.io.load_recording import load_recording
from gapscope.arm.io.table import runs
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording
from gapscope.arm.robots import load_nominal_arm, shifted_arm
from gapscope.arm.root_mean_square import rms
from gapscope.model_audit.checks import (
    GRAVITY_MISFIT,
    GRAVITY_TOLERANCE,
    LIGHT_SHARE,
    MIN_POSE,
    MIN_POSES,
    OPPOSITE,
    REST_SPEED,
    STANDARD_GRAVITY,
    box_density,
    check_geometry,
    check_inertials,
    check_joints,
    check_products,
    check_repeats,
    check_shifted,
)
from gapscope.model_audit.description import (
    SEVERITIES,
    Finding,
    Geometry,
    find_robot,
    link_geometries,
    worst_first,
)

# Gravity torque of the model against the torque measured at rest.


FIRST_MOMENTS = 4
"""Columns of a link's regressor that gravity acts on: mass and first moments."""
AS_IS = "the model as it is"
"""The first explanation."""
FLAT = 1e-6
"""Deviation below which a torque is constant [N m]."""


def static_poses(robot: str | Path, recording: Path) -> dict[str, Any]:
    """Compare the torque at rest with the model's gravity torque.

    Args:
        robot: URDF or MJCF file, known name, or case.
        recording: a recording in the columns of the case format, or a case; at rest in several poses.

    Returns:
        ``joints`` by name, and how many ``poses``; of each of the n joints ``correlation`` and ``scale`` of the
        measured torque with the model's [1], nan where gravity does not act, ``offset`` from scale times the model's,
        ``rms`` of measured minus model, and ``spread``, the standard deviation of the measured torque [N m];
        ``explanations``, best first, the model as it is among them, with their ``name``, ``misfit``, the RMS of what
        is left, offsets free, over the spread [1], how many ``parameters`` were fitted beside the offsets, and of a
        wrong link the ``changes`` of its mass [kg] and first moments [kg m].

    Raises:
        InputError: robot or recording cannot be used, it has no torque, or it rests in too few poses.
    """
    arm, recordings = _read(robot, recording)
    rests = [rest for one in recordings for rest in _rests(one)]
    if len(rests) < MIN_POSES:
        raise InputError(
            f"rests in {len(rests)} poses (all joints below {REST_SPEED:g} rad/s for {MIN_POSE:g} s), "
            f"expected at least {MIN_POSES}",
            "hold the arm for a second in each of twenty poses that differ in all joints",
            file=recording,
        )
    q, tau = (np.array([rest[k] for rest in rests]) for k in (0, 1))
    body = RigidBody(arm)
    model = body.gravity_torque(q)
    fits = [_line(model[:, j], tau[:, j]) for j in range(arm.n_joints)]
    correlation, scale, offset = np.array(fits).T
    # hypotheses on what is wrong, by what they leave; each parameter costs as in Akaike's criterion
    # offsets are free: means are taken off
    torque = tau - tau.mean(axis=0)
    size = float(rms(torque, axis=None))
    if size < FLAT:
        raise InputError(
            "has the same torque in all poses",
            "check the columns tau1.., or hold the arm in poses that differ",
            file=recording,
        )
    by_model = model - model.mean(axis=0)

    def explained(
        name: str, left: np.ndarray, changes: Sequence[float] = ()
    ) -> dict[str, Any]:
        return {
            "name": name,
            "misfit": float(rms(left, axis=None)) / size,
            "parameters": len(changes),
            "changes": changes,
        }

    found = [
        explained(AS_IS, torque - by_model),
        explained("a torque column without gravity", torque),
        explained("torque of the opposite sign on all joints", torque + by_model),
    ]
    # gravity acts on no joint of an arm that lies on a table
    if np.isfinite(scale).any():
        common = float((torque * by_model).sum() / (by_model**2).sum())
        name = f"one scale of {common:.3g} on all joints"
        scaled = explained(name, torque - common * by_model)
        found.append({**scaled, "parameters": 1})
    # joints on which gravity hardly acts keep their sign
    opposite = correlation < OPPOSITE
    if opposite.any() and not opposite.all():
        signs = np.where(opposite, -1.0, 1.0)
        name = f"torque of the opposite sign on joint {marked(opposite)}"
        found.append(explained(name, torque - signs * by_model))
    # inertials of the next and of the previous link, if they make an arm
    for by, word in ((1, "next"), (-1, "previous")):
        with suppress(GapscopeError):
            # the file's inertials go back to where they belong
            other = shifted_arm(arm, -by)
            if other is not arm:
                shifted = RigidBody(other).gravity_torque(q)
                name = f"each link with the inertial of the {word} one"
                found.append(explained(name, torque - shifted + shifted.mean(axis=0)))
    # mass and first moments of one link fitted to the error of the model
    error = (torque - by_model).ravel()
    regressor = body.regressor(q, np.zeros_like(q), np.zeros_like(q))
    # without the means: an offset of each joint explains what is constant
    regressor -= regressor.mean(axis=0)
    for j, joint in enumerate(arm.joints):
        columns = regressor[:, :, 10 * j : 10 * j + FIRST_MOMENTS]
        columns = columns.reshape(-1, FIRST_MOMENTS)
        changes = np.linalg.lstsq(columns, error, rcond=1e-6)[0]
        name = f"another mass or centre of the link moved by joint {j + 1} ({joint})"
        found.append(explained(name, error - columns @ changes, changes.tolist()))

    def criterion(one: Mapping[str, Any]) -> float:
        # N log(misfit^2) + 2 k, but for what all hypotheses share
        misfit = torque.size * 2 * np.log(max(one["misfit"], 1e-6))
        return float(misfit + 2 * one["parameters"])

    return {
        "joints": arm.joints,
        "poses": len(q),
        "correlation": correlation,
        "scale": scale,
        "offset": offset,
        "rms": rms(tau - model),
        "spread": tau.std(axis=0),
        "explanations": sorted(found, key=criterion),
    }


def check_static(static: Mapping[str, Any]) -> Iterator[Finding]:
    """What the measured gravity torque says of the model."""
    explanations = static["explanations"]
    as_is = next(x for x in explanations if x["name"] == AS_IS)
    # nothing to say: what is left is as small as rounding and friction make it
    if as_is["misfit"] <= GRAVITY_MISFIT:
        return
    best = explanations[0]
    # a small gain over the model as it is explains nothing
    if best is as_is or best["misfit"] > 0.7 * as_is["misfit"]:
        said = "no single error of sign, scale, link or assignment explains it"
        remedy = "check units and order of the joints (gapscope check), then identify the arm (gapscope identify)"
    else:
        said = f"{best['name']} leaves {best['misfit']:.0%}"
        remedy = "put this right and run the audit again; several explanations that leave as much cannot be told apart"
    yield Finding(
        "implausible",
        "gravity_torque",
        "",
        0,
        f"at rest the measured torque differs from the model's gravity torque by {as_is['misfit']:.0%} of its spread; "
        f"{said}",
        f"less than {GRAVITY_MISFIT:.0%}, offsets left free",
        remedy,
        20.0 + as_is["misfit"],
    )


def _read(robot: str | Path, recording: Path) -> tuple[NominalArm, list[Recording]]:
    """The arm, and its recordings with torque."""
    path = Path(robot)
    own = load_case(path, read_recordings=False) if is_case(path) else None
    # a recording that is a case brings its own import section and joints
    if recording.suffix in (".yaml", ".yml") or is_file(recording / "case.yaml"):
        case = load_case(recording)
        found = [*case.recordings, *case.judged]
        # the model that is audited takes the place of that of the case
        arm = load_nominal_arm(
            robot if own is None else own.arm.urdf,
            joints=case.arm.joints,
            locked=(case if own is None else own).arm.locked,
            gravity=case.arm.gravity.tolist(),
        )
    elif own is not None:
        arm, found = own.arm, [load_recording(recording, own.arm, own.importing)]
    else:
        arm = load_nominal_arm(robot)
        found = [load_recording(recording, arm)]
    found = [one for one in found if one.tau is not None]
    if not found:
        raise InputError(
            "holds no torque that can be trusted",
            "give columns tau1.., or a case whose import section names them",
            file=recording,
        )
    return arm, found


def _rests(recording: Recording) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Mean position [rad] and torque [N m] of each rest, each of shape (n,)."""
    assert recording.tau is not None
    window, row = (
        max(1, int(MIN_POSE * recording.rate / 2)),
        np.arange(len(recording.t)),
    )
    # over a window, so that the steps of an encoder are no speed
    late, early = np.minimum(row + window, row[-1]), np.maximum(row - window, 0)
    passed = recording.t[late] - recording.t[early]
    speed = np.abs(recording.q[late] - recording.q[early]) / passed[:, None]
    still = (speed < REST_SPEED).all(axis=1)
    for rows in runs(still):
        if np.ptp(recording.t[rows]) >= MIN_POSE:
            yield recording.q[rows].mean(axis=0), recording.tau[rows].mean(axis=0)


def _line(model: np.ndarray, tau: np.ndarray) -> tuple[float, float, float]:
    """Correlation, scale and offset of measured over computed torque; nan where gravity does not act."""
    # gravity does not act about a vertical axis: any scale would fit
    if model.std() < FLAT or tau.std() == 0:
        return np.nan, np.nan, float(tau.mean() - model.mean())
    correlation = float(np.corrcoef(model, tau)[0, 1])
    # least squares of tau = scale model + offset
    scale = correlation * tau.std() / model.std()
    return correlation, float(scale), float(tau.mean() - scale * model.mean())


# All checks of a model file.


def odd_kinds(robot: Path) -> str:
    """What no arm has, or hardly any, in the file of a robot: kinds of findings with their numbers; empty if nothing.

    Raises:
        InputError: the file is no XML of a robot.
    """
    found = audit_model(robot)["findings"]
    odd = Counter(x["kind"] for x in found if x["severity"] in SEVERITIES[:2])
    return ", ".join(
        f"{kind.replace('_', ' ')} ({count})" for kind, count in odd.items()
    )


def audit_model(robot: str | Path, recording: Path | None = None) -> dict[str, Any]:
    """Audit the file of a robot, and its gravity torque if there are static poses.

    Args:
        robot: URDF or MJCF file, known name, or case.
        recording: a recording of static poses, or a case of them.

    Returns:
        The content of ``audit.json``, plain; what is not known is null. Findings are worst first. Moments are
        principal ones about the centre of mass [kg m^2]; ``density`` is mass over the volume of the link's shapes,
        ``box_density`` that of the homogeneous box with the same mass and moments [kg/m^3].

    Raises:
        InputError: there is no such file, it is no XML of a robot, or the recording has no static poses.
    """
    path, case, said = find_robot(robot)
    description = read_description(path)
    geometries = link_geometries(description)
    refused = _refused(description)
    # first of all: other figures cannot be trusted without these numbers
    findings = [
        Finding(
            "impossible",
            "unreadable_number" if one.got is not None else "incomplete_inertial",
            one.place.removeprefix("shape of "),
            one.line,
            f"{one.element}: {one.problem}",
            one.wanted if one.got is not None else "mass and inertia",
            one.remedy,
            1e6,
        )
        for one in description.unreadable
    ]
    findings += check_description(description, geometries, said.get("nominal") or ())
    findings += _gravity(case, said.get("gravity"))
    # before findings on joints and links: no other command takes the file
    if refused:
        findings.append(
            Finding(
                "impossible",
                "refused",
                "",
                0,
                refused,
                "a model that can be built",
                "put right what is named here first: no other command can use this file",
                1e4,
            )
        )
    static = None
    if recording is not None:
        static = static_poses(robot, recording)
        findings += check_static(static)
    counts = Counter(one.severity for one in findings)
    content = {
        "schema": 1,
        "robot": description.name,
        "file": str(description.file),
        "form": description.form,
        "refused": refused or None,
        "total_mass": total_mass(description),
        "counts": dict.fromkeys(SEVERITIES, 0) | counts,
        "findings": worst_first(findings),
        "links": [
            _link(link, description, geometries.get(link.name))
            for link in description.links
        ],
        "joints": [_joint(joint) for joint in description.joints],
        "static": static,
    }
    found: dict[str, Any] = plain(content, null_if_not_finite=True)
    return found


def check_description(
    description: Description,
    geometries: dict[str, Geometry],
    sheet: Collection[str] = (),
) -> list[Finding]:
    """Findings of all checks of a file as it stands, in no order.

    Args:
        description: the file.
        geometries: size of each link with usable shapes, by name.
        sheet: what the data sheet of its case gives.
    """
    found = [
        *check_inertials(description, geometries),
        *check_geometry(description, geometries),
        *check_products(description, geometries),
        *check_shifted(description, geometries),
        *check_repeats(description),
        *check_joints(description, sheet),
        *_lost_meshes(description),
    ]
    return [_weighed(one, description) for one in found]


def _weighed(finding: Finding, description: Description) -> Finding:
    """A finding about a link that no joint moves, or that is very light, is a note: it hardly changes any torque."""
    tag, _, name = finding.place.partition(" ")
    names = {link.name for link in description.links}
    # a moved link without mass stays what it is: a simulator cannot move it
    if tag != "link" or name not in names or finding.kind == "no_mass":
        return finding
    inertial = description.by_name[name].inertial
    least = LIGHT_SHARE * total_mass(description)
    light = inertial is not None and 0 < inertial.mass < least
    # the base does not move, however odd it is
    if not description.is_moved(name):
        why = "no joint moves it: of no effect on a fixed base"
    elif light:
        why = "a light link, of little effect"
    else:
        return finding
    return replace(finding, severity="note", found=f"{finding.found} ({why})")


def total_mass(description: Description) -> float:
    """Sum of the masses of all links [kg]."""
    return sum(link.inertial.mass for link in description.links if link.inertial)


def _refused(description: Description) -> str:
    """Why other commands refuse the file with all of its joints; empty if they take it."""
    joints = [joint.name for joint in description.moving]
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # what is odd is found here
            arm_model(description.file, joints, np.zeros(3))
    except GapscopeError as error:
        return error.message
    return ""


def _lost_meshes(description: Description) -> Iterator[Finding]:
    """Meshes that were not found, all in one finding."""
    links = [link for link in description.links if link.lost]
    if not links:
        return
    names = list(dict.fromkeys(name for link in links for name in link.lost))
    yield Finding(
        "note",
        "lost_meshes",
        "",
        links[0].line,
        f"{len(names)} meshes of {len(links)} links are not found, {names[0]} the first",
        "meshes beside the file, or in a package folder above it",
        "put them there: without them sizes, densities and centres are judged by the joints' frames alone, or not",
        0.1,
    )


def _gravity(case: Path | None, gravity: list[float] | None) -> Iterator[Finding]:
    """Gravity of a case [m/s^2] that is not that of the Earth."""
    if gravity is None:
        return
    # the direction depends on how the base is mounted: only the size is known
    size = float(np.linalg.norm(gravity))
    if abs(size - STANDARD_GRAVITY) > GRAVITY_TOLERANCE:
        yield Finding(
            "implausible",
            "gravity",
            "",
            0,
            f"gravity of {case} is {size:.4g} m/s^2",
            f"{STANDARD_GRAVITY:.4g} m/s^2 in the direction in which the base is mounted",
            "correct gravity: in the case; 0 is right only of an arm that lies on a table or floats",
            1.0,
        )


# Links and joints in the document of an audit.


def _link(
    link: Link, description: Description, geometry: Geometry | None
) -> dict[str, Any]:
    inertial, above = link.inertial, description.above.get(link.name)
    content = {
        "name": link.name,
        "line": link.line,
        "joint": None if above is None else above.name,
        "moved": description.is_moved(link.name),
        "volume": None if geometry is None else geometry.volume,
    }
    # what is not known of a link without an inertial
    content |= dict.fromkeys(("mass", "com", "moments", "density", "box_density"))
    if inertial is None:
        return content
    if geometry is not None:
        content["density"] = inertial.mass / geometry.volume
    if inertial.is_body:
        content["box_density"] = box_density(inertial)
    moments = np.linalg.eigvalsh(inertial.moments)
    return {**content, "mass": inertial.mass, "com": inertial.com, "moments": moments}


def _joint(joint: Joint) -> dict[str, Any]:
    # what a file may leave out
    numbers = [each.name for each in fields(joint) if each.default is None]
    return {
        "name": joint.name,
        "line": joint.line,
        "kind": joint.kind,
        "parent": joint.parent,
        "child": joint.child,
        **{name: getattr(joint, name) for name in numbers},
    }
