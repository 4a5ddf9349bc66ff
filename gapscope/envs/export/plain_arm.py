"""What a file for another simulator is written from: the bodies of a corrected arm, and the drive of each joint.

A drive is what acts between the command and the body of a joint, nominal values and effects together, joint side.
"""

from __future__ import annotations

import json
import os
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from textwrap import indent
from types import MappingProxyType
from typing import Any, NamedTuple

import jinja2
import numpy as np
import pandas as pd
import yaml
from scipy.spatial.transform import Rotation

from gapscope.arm.dynamics.description import turn_of_z
from gapscope.arm.dynamics.inertials import odd_inertials
from gapscope.arm.dynamics.link_shapes import (
    Frame,
    PlacedShape,
    read_frames,
    read_shapes,
)
from gapscope.arm.dynamics.plain_urdf import (
    Link,
    Place,
    angles,
    check_inertia,
    link_name,
    moving_links,
    numbers,
)
from gapscope.arm.dynamics.rigid_body import RigidBody, joint_motion
from gapscope.arm.joint_units import common_unit
from gapscope.arm.nominal import FRICTION_SMOOTHING, NominalArm
from gapscope.effects.actuation import MIN_FALL
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.arm_scale import usual_load
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.effect import Effect, LinkChange
from gapscope.envs.drive.arm_drive import least_inertia, mass_matrices, teeth

# What a file for another simulator is written from: the bodies of a corrected arm, and the drive of each joint.


PASSIVE = ("friction", "damping", "rotor")
"""Quantities of a drive that may not be negative in total."""
DRIVEN = (
    *("breakaway", "breakaway_speed", "saturating", "saturating_speed"),
    *("stiffness", "rest", "delay", "lag", "scale", "offset", "zero"),
    *("ripple", "ripple_cycles", "ripple_phase"),
    *("gear_stiffness", "gear_damping", "play"),
    *("corner_speed", "no_load_speed"),
)
"""The other quantities of a drive."""


def joint_drives(corrected: CorrectedArm, body: RigidBody) -> pd.DataFrame:
    """The drives of a corrected arm, a row for each joint by its name.

    Columns are quantities with the names and units of ``gapscope.effects.effect.QUANTITIES``, nominal values and
    effects together, joint side; ``rest`` and ``ripple_phase`` hold at the coordinate of the file, which is what the
    encoder reads. Beside them:

    - presliding: distance over which dry friction builds up [rad], 0 if at once;
    - inertia: smallest inertia that friction holds, however the other joints move [kg m^2];
    - gear: whether something yields between the joint and a motor of its own, whose rotor is known;
    - elastic: whether stiffness and damping of the gear are those of an effect, not of teeth in contact;
    - effort, velocity: lowest known limits of the commanded torque [N m] and of the velocity [rad/s], or infinite;
    - stall: torque to which the line goes back at rest that falls to none at ``no_load_speed`` [N m], 0 without one.

    Args:
        corrected: the arm.
        body: its changed bodies.

    Raises:
        InputError: friction or rotor inertia that is negative in total.
    """
    arm = corrected.arm
    drives = pd.DataFrame(index=list(arm.joints))
    for name in PASSIVE:
        drives[name] = corrected.passive(name)
    for name in DRIVEN:
        drives[name] = corrected.quantity(name)
    # springs and ripple follow the true position, the coordinates of a file are what the encoders read
    drives["rest"] += drives["zero"]
    drives["ripple_phase"] -= drives["ripple_cycles"] * drives["zero"]
    # in the arm's joint order, as the table is
    masses = mass_matrices(body)[:, body.places][:, :, body.places]
    rotors = drives["rotor"].to_numpy()
    drives["elastic"] = drives["gear_stiffness"] > 0
    # a gear needs a rotor behind it: without one there is no second mass
    drives["gear"] = (rotors > 0) & (drives["elastic"] | (drives["play"] > 0))
    names = ("gear_stiffness", "gear_damping")
    # a gear with play alone has teeth for its spring, as in the simulator
    for name, value in zip(names, teeth(rotors, least_inertia(masses)), strict=True):
        drives[name] = drives[name].where(drives["elastic"], value)
    limit = body.effort_limits() if arm.torque_limit is None else arm.torque_limit
    drives["presliding"] = arm.presliding
    # springs of any stiffness s on all joints are no faster than sqrt(s / inertia): with each joint's own least inertia
    # as unit, the largest eigenvalue of M^-1 of the bodies and the motors that are not behind a gear
    alone = drives["gear"].to_numpy()
    together = masses + np.diag(np.where(alone, 0.0, rotors))
    least = least_inertia(together)
    root = np.sqrt(least)
    coupling = np.linalg.eigvalsh(root[:, None] * np.linalg.inv(together) * root)
    # behind a gear friction holds the rotor alone
    drives["inertia"] = np.where(alone, rotors, least / coupling.max())
    drives["effort"] = np.minimum(_known(limit), _known(corrected.quantity("limit")))
    drives["velocity"] = _known(body.velocity_limits())
    corner, no_load = drives["corner_speed"], drives["no_load_speed"]
    # T(w) = limit (w0 - w) / (w0 - corner), and its value at rest
    span = (no_load - corner).clip(lower=MIN_FALL)
    drives["stall"] = corrected.quantity("limit") * no_load / span
    return drives


def _known(limit: np.ndarray) -> np.ndarray:
    """Limits, infinite where none is known."""
    return np.where(limit > 0, limit, np.inf)


EXACT = 1e-12
"""Frames that differ by less are one [m], [rad]."""


class PlainArm(NamedTuple):
    """A corrected arm as bodies and drives.

    Attributes:
        corrected: the arm that it was made from.
        nominal: the bodies of the nominal arm.
        body: the bodies of the corrected arm.
        links: the moving bodies, parents before children; their joints' coordinates are what the encoders read.
        drives: see ``joint_drives``.
        mount: turn from the base to a world whose gravity points along -z: the orientation of the base, with tilt.
        gravity: strength of gravity [m/s^2].
        frames: links of the URDF by name, empty of an MJCF file.
        shapes: shapes of the URDF.
        missing: a sentence for each shape that cannot be used.
    """

    corrected: CorrectedArm
    nominal: RigidBody
    body: RigidBody
    links: tuple[Link, ...]
    drives: pd.DataFrame
    mount: Place
    gravity: float
    frames: dict[str, Frame]
    shapes: tuple[PlacedShape, ...]
    missing: tuple[str, ...]

    def body_name(self, joint: str) -> str:
        """Name of the body that a joint moves, the base for an empty string: its link's in the URDF.

        No body is called ``world``, which means what does not move in other formats.
        """
        # of several links at one place the first that is the body's own frame
        own = (
            frame.name
            for frame in self.frames.values()
            if frame.joint == joint
            and frame.name != "world"
            and frame.place.isIdentity(EXACT)
        )
        return next(own, link_name(joint))

    @property
    def upright(self) -> bool:
        """Whether the base is oriented like the world."""
        return bool(self.mount.isIdentity(EXACT))


def plain_arm(corrected: CorrectedArm) -> PlainArm:
    """The bodies and drives of a corrected arm.

    Raises:
        InputError: an effect on a joint that does not exist, friction or armature that is negative in total, or bodies
            that no torque can move.
    """
    corrected.check()
    nominal = RigidBody(corrected.arm)
    body = corrected.body(nominal)
    # bodies that no torque moves are an error of the effects, or of the file
    check_inertia(
        body,
        ", ".join(
            e.name for e in corrected.effects if isinstance(e.effect, LinkChange)
        ),
    )
    gravity = np.array(corrected.arm.gravity)
    # a world in which what is up in the base's frame is up
    mount = turn_of_z(-gravity).T @ corrected.base_rotation()
    shapes, missing = read_shapes(body)
    drives = joint_drives(corrected, body)
    links = tuple(
        _shifted(x, float(drives.at[x.joint, "zero"])) for x in moving_links(body)
    )
    return PlainArm(
        corrected,
        nominal,
        body,
        links,
        drives,
        Place(mount, np.zeros(3)),
        float(np.linalg.norm(gravity)),
        read_frames(body),
        shapes,
        missing,
    )


def _shifted(link: Link, zero: float) -> Link:
    """A body whose joint coordinate is the true one plus ``zero`` [rad or m]: the same place, reached further on."""
    if zero == 0:
        return link
    limits = link.limits
    if limits is not None:
        limits = (limits[0] + zero, limits[1] + zero)
    # from the new coordinate back to the true one, within the joint's own frame
    back = joint_motion(link.kind, link.axis, -zero)
    return replace(link, origin=link.origin * back, limits=limits)


def mesh_path(mesh: Path, out: Path, relative: bool) -> str:
    """How a file ``out`` names a mesh: from its own folder, or absolutely."""
    if not relative:
        return mesh.resolve().as_posix()
    return Path(os.path.relpath(mesh.resolve(), out.resolve().parent)).as_posix()


# What exported files say: their templates, the comment at their head, and what a format cannot hold of an arm.


TEMPLATES = Path(__file__).parent / "templates"
LONGEST = 100
"""Characters of a line of Python, beyond which a dict takes several."""
BODIES = frozenset({"body", "load", "gravity", "zero"})
"""Quantities of bodies and where they are: in the file of the arm that a snippet belongs to."""
GEAR = {"gear_stiffness", "gear_damping", "play"}
"""Quantities between a joint and a motor of its own, which needs a rotor."""

NOT_FOUND = "is not found"
"""How it ends what is said of a mesh that is not there."""


def rendered(template: str, **content: Any) -> str:
    """Text of a file of ``templates``; those of XML escape what they are given."""
    return _templates().get_template(template).render(**content)


@cache
def _templates() -> jinja2.Environment:
    made = jinja2.Environment(
        loader=jinja2.FileSystemLoader(TEMPLATES),
        # a template that asks for what is not there is a fault, not an empty place
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        # names with quotes or brackets would break the file
        autoescape=lambda name: ".xml." in (name or ""),
    )
    made.filters |= {
        "number": number,
        "pair": pair,
        "table": table,
        "quoted": quoted,
        "exact": lambda value: repr(float(value)),
        "numbers": numbers,
        # position [m] and roll, pitch, yaw [rad]
        "pose": lambda place: numbers(np.r_[place.translation, angles(place)]),
        # MuJoCo writes the real part first
        "quaternion": lambda turn: numbers(
            np.roll(Rotation.from_matrix(turn).as_quat(), 1)
        ),
    }
    made.globals |= {"inf": np.inf, "friction_smoothing": FRICTION_SMOOTHING}
    return made


def number(value: float) -> str:
    """A number as Python and YAML read it, with six digits; infinity as ``float("inf")``."""
    if not np.isfinite(value):
        return 'float("inf")'
    return repr(float(f"{value:.6g}"))


def pair(ends: tuple[float, float]) -> str:
    """Two numbers in parentheses."""
    return f"({number(ends[0])}, {number(ends[1])})"


def quoted(name: str) -> str:
    """A name as Python and YAML read it."""
    return json.dumps(name, ensure_ascii=False)


def table(values: Mapping[str, Any], indent: int = 0) -> str:
    """A dict in Python with a number or pair for each name, a line each if it is long.

    Args:
        values: the numbers or pairs.
        indent: of the line on which it begins.
    """
    items = [
        f"{quoted(name)}: {pair(value) if isinstance(value, tuple) else number(value)}"
        for name, value in values.items()
    ]
    line = "{" + ", ".join(items) + "}"
    if len(line) + indent <= LONGEST:
        return line
    rows = "".join(f"{' ' * (indent + 4)}{item},\n" for item in items)
    return "{\n" + rows + " " * indent + "}"


class Target(NamedTuple):
    """A format that can be written; the texts of all are files of ``templates``, but for that of URDF.

    Attributes:
        name: of the format.
        title: its simulator and the versions whose words are used.
        held: quantities that the format holds, as far as ``hints`` says; see ``gapscope.effects.effect.QUANTITIES``.
        hints: what else there is to say on a quantity.
        notes: what to know of the simulator, a sentence each.
        model: format of the file of bodies that a snippet belongs to; empty if it has none.
        whole: whether it holds the whole arm, not a snippet.
        xml: whether it is XML, and the comment at its head too.
        needs_ranges: whether there is nothing to write without ranges.
        draws: whether ranges can be written.
    """

    name: str
    title: str
    held: Sequence[str]
    hints: Mapping[str, str] = MappingProxyType({})
    notes: Sequence[str] = ()
    model: str = "urdf"
    whole: bool = False
    xml: bool = False
    needs_ranges: bool = False
    draws: bool = True


TARGETS = {
    name: Target(name, **fields)
    for name, fields in yaml.safe_load(
        (TEMPLATES / "targets.yaml").read_text(encoding="utf-8")
    ).items()
}
"""Formats by their names."""


def heading(
    arm: PlainArm, target: Target, missing: Sequence[str], known: Sequence[str]
) -> str:
    """The comment at the head of a file: what it is, what it leaves out, what to know.

    Args:
        arm: the arm.
        target: the format.
        missing: what is left out, a sentence each.
        known: what to know beside the notes of the format.
    """
    names = ", ".join(dict.fromkeys(e.name for e in arm.corrected.effects))
    lines = [
        f"Corrected arm of {arm.body.file.name} for {target.title}, written by gapscope export;",
        f"SI units, joint side. Effects: {names or 'none'}.",
    ]
    for title, said in (
        ("Left out, or held in part:", missing or ["nothing"]),
        ("To know:", (*known, *target.notes)),
        ("Odd, and some simulators change such inertias:", remarks(arm)),
    ):
        if said:
            lines += [title, *(f"  {line}" for line in said)]
    text = "\n".join(lines)
    if not target.xml:
        return indent(text, "# ") + "\n\n"
    while "--" in text:  # which no comment of XML may hold
        text = text.replace("--", "- -")
    return f"<!--\n{text}\n-->\n"


def holds(
    held: Collection[str], effect: Effect, given: Collection[str] | None = None
) -> bool:
    """Whether what has these quantities has all parameters of an effect that are given, by default that have to be."""
    return all(effect.quantities.get(x) in held for x in given or effect.needed)


def left_out(arm: PlainArm, target: Target) -> tuple[str, ...]:
    """What a file of this format does not hold of a corrected arm, or not as it is, in words and figures."""
    corrected = arm.corrected
    held = set(target.held)
    if target.whole:
        # rotors are told in total, nominal and found
        held.add("rotor")
    gear, rotors, distances = (arm.drives[x] for x in ("gear", "rotor", "presliding"))
    sliding = corrected.arm.sliding
    lines = []
    for applied in corrected.effects:
        effect = applied.effect
        quantities = effect.quantities.values()
        # the first hint that fits says what to do in place of the general one
        hint = next((target.hints[x] for x in quantities if x in target.hints), None)
        if hint is None and holds(held, effect, applied.given):
            # the format holds gears, but not one without a rotor behind it
            rigid = [joint for joint in applied.joints if not gear.iloc[joint - 1]]
            if rigid and not GEAR.isdisjoint(quantities):
                lines.append(
                    f"{applied.name}{_joints(rigid)}: a motor of its own needs a rotor; give nominal.armature in the "
                    "data sheet, or add the effect armature"
                )
            continue
        # what is of bodies is in the file of bodies that goes with a snippet
        if hint is None and target.model and holds(BODIES, effect):
            hint = f"in the file of gapscope export --format {target.model}, which this belongs to"
        lines.append(described(applied, corrected.arm, hint))
    if target.whole and "rotor" not in target.held and rotors.any():
        lines.append(
            f"armature (nominal and found), joints in order: inertia {_figures(rotors.to_numpy())} "
            f"{common_unit('kg m^2', sliding)}"
        )
    if "presliding" not in held and distances.any():
        figures = ", ".join(f"{n} {x:.6g}" for n, x in distances.items() if x)
        lines.append(
            f"presliding, {figures} {common_unit('rad', sliding)}: dry friction sets in at once, not over this distance"
        )
    if corrected.residual is not None:
        lines.append(
            "residual network: residual.onnx of gapscope residual --onnx predicts torque; nothing here calls it"
        )
    if not target.whole:
        return tuple(lines)
    if corrected.arm.encoder_step:
        lines.append(
            f"resolution of the encoders: {corrected.arm.encoder_step:.4g} {common_unit('rad', sliding)}"
        )
    if target.name == "mjcf" and (arm.drives["velocity"] < np.inf).any():
        lines.append("velocity limits of the joints: MuJoCo knows none")
    # of a URDF the elements stay as they are, if their mesh is in a package that may be elsewhere
    for said in arm.missing:
        kept = target.name == "urdf" and said.endswith(NOT_FOUND) and "://" in said
        lines.append(said + ", its name is kept" * kept)
    return tuple(lines)


def remarks(arm: PlainArm) -> tuple[str, ...]:
    """Implausible bodies, a sentence each, with the file's name instead of its path."""
    return tuple(
        note.replace(str(arm.body.file), arm.body.file.name)
        for note in odd_inertials(arm.body)
    )


def described(applied: AppliedEffect, arm: NominalArm, hint: str | None = None) -> str:
    """An effect on an arm with its joints and values, and what to do about it where it is left out.

    Args:
        applied: the effect.
        arm: the nominal arm.
        hint: what to do, in place of what holds for every format.
    """
    own = [arm.sliding[joint - 1] for joint in applied.joints]
    values = "; ".join(
        f"{p.name} {_figures(applied.parameters[p.name])}"
        + ("" if p.unit == "1" else f" {common_unit(p.unit, own)}")
        for p in map(applied.effect.parameter, applied.given)
    )
    nearest = nearest_friction(CorrectedArm(arm, (applied,)))
    if not hint and nearest.any():
        figures = _figures(nearest[np.array(applied.joints) - 1])
        hint = (
            f"nearest: Coulomb friction higher by {figures} {common_unit('N m', own)}, the coefficient times the RMS "
            "of the load over all postures; better, times the load of your motion"
        )
    hint = hint or applied.effect.without
    end = f" ({hint})" if hint else ""
    return f"{applied.name}{_joints(applied.joints)}: {values}{end}"


def nearest_friction(corrected: CorrectedArm) -> np.ndarray:
    """Coulomb friction that takes as much as friction by load does from motors that carry the usual load [N m], (n,).

    That is the RMS of gravity and dry friction over all postures.
    """
    factor = corrected.quantity("load_factor")
    return factor * usual_load(corrected.arm) if factor.any() else factor


def _joints(numbers: Collection[int]) -> str:
    """Joints of an effect, as they follow its name; empty without any."""
    if not numbers:
        return ""
    return f", joint{'s' * (len(numbers) > 1)} {', '.join(map(str, numbers))}"


def _figures(values: np.ndarray) -> str:
    return ", ".join(f"{value:.6g}" for value in np.atleast_1d(values).tolist())
