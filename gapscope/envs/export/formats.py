"""A corrected arm written as a file for another simulator."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from gapscope.arm.controller import Controller
from gapscope.arm.dynamics.description import (
    SCHEMES,
    Description,
    find_mesh,
    read_description,
)
from gapscope.arm.dynamics.inertials import (
    own_parameters,
    possible,
    set_parameters,
)
from gapscope.arm.dynamics.link_shapes import PlacedShape
from gapscope.arm.dynamics.plain_urdf import (
    Place,
    exact_urdf,
    numbers,
    set_limit,
    set_origin,
)
from gapscope.arm.dynamics.rigid_body import joint_motion
from gapscope.arm.dynamics.rollout import LONGEST_STEP
from gapscope.arm.errors import InputError
from gapscope.arm.io.atomic_write import atomic_write
from gapscope.arm.nearest_name import check_known
from gapscope.effects.corrected import CorrectedArm
from gapscope.envs.drive.arm_drive import (
    TOOTH_DAMPING,
    TOOTH_FREQUENCY,
    mass_matrices,
    substeps,
)
from gapscope.envs.effect_ranges import EffectRanges, write_effect_ranges
from gapscope.envs.export.plain_arm import (
    PASSIVE,
    TARGETS,
    PlainArm,
    heading,
    left_out,
    mesh_path,
    plain_arm,
    remarks,
    rendered,
)
from gapscope.envs.export.snippets import snippet

# A corrected arm as URDF: that of the nominal arm with other inertials, friction and limits, or one of its bodies.


MOVABLE = ("revolute", "continuous", "prismatic", "floating", "planar")
"""Types of joints that move."""
LIMITS = (
    ("limit", "lower"),
    ("limit", "upper"),
    ("safety_controller", "soft_lower_limit"),
    ("safety_controller", "soft_upper_limit"),
)
"""Elements and attributes that hold a position of a joint."""


def as_urdf(arm: PlainArm, out: Path, relative: bool) -> tuple[str, tuple[str, ...]]:
    """The arm as URDF, and what else is left out.

    Joints that are not the arm's are fixed where its model has them locked. The base is turned by a fixed joint on a
    link of its own. Of an arm from an MJCF file the moving bodies alone are written.

    Args:
        arm: the arm.
        out: the file that it is written to.
        relative: whether meshes are named from the folder of ``out``.
    """
    root = ET.parse(arm.body.file).getroot()
    notes: tuple[str, ...] = ()
    # changes go into the file itself: what Gapscope does not read stays in it
    if root.tag == "robot":
        described = read_description(arm.body.file, shapes=False)
        notes = _fix_others(root, arm, described)
        notes += _name_meshes(root, arm, out, relative)
        _set_bodies(root, arm, described)
        _shift_zeros(root, arm, described)
    else:
        root = exact_urdf(arm.corrected.arm.name, arm.links)
    for joint in root.findall("joint"):
        if joint.get("name") in arm.drives.index:
            _set_drive(joint, arm.drives.loc[joint.get("name")])
    if not arm.upright:
        _turn_base(root, arm.mount)
    return ET.tostring(root, encoding="unicode"), notes


def _fix_others(
    root: ET.Element, arm: PlainArm, described: Description
) -> tuple[str, ...]:
    """Fix joints that are not the arm's; says which."""
    fixed = []
    for joint in root.findall("joint"):
        if joint.get("type") in MOVABLE and joint.get("name") not in arm.drives.index:
            fixed.append(joint.get("name", ""))
            position = arm.corrected.arm.locked.get(joint.get("name", ""), 0.0)
            _set_origin(joint, described, position)
            joint.set("type", "fixed")
            # a fixed joint has no limits, friction or mimic
            for element in list(joint):
                if element.tag not in ("origin", "parent", "child"):
                    joint.remove(element)
    return (
        (
            f"motion of {', '.join(fixed)}: not among the joints of the arm, fixed where they are locked",
        )
        if fixed
        else ()
    )


def _set_origin(joint: ET.Element, described: Description, position: float) -> None:
    """Move the origin of a joint to where it takes its link at a position [rad or m]."""
    if position:
        own = described.above[_end(joint, "child")]
        set_origin(joint, own.place * joint_motion(own.kind, own.axis, position))


def _name_meshes(
    root: ET.Element, arm: PlainArm, out: Path, relative: bool
) -> tuple[str, ...]:
    """Let meshes and textures be found from the new place; says which textures are not found.

    A shape whose mesh is not there is removed, since simulators refuse the file; a name in a package is kept, which may
    be elsewhere.
    """
    missing = []
    for link in root.iter("link"):
        for shape in [*link.findall("visual"), *link.findall("collision")]:
            mesh = shape.find("geometry/mesh")
            name = "" if mesh is None else mesh.get("filename", "")
            lost = mesh is not None and find_mesh(name, arm.body.file) is None
            # in a package it may be found by whoever reads the file
            if lost and not name.startswith(SCHEMES):
                link.remove(shape)
    for element in (*root.iter("mesh"), *root.iter("texture")):
        name = element.get("filename", "")
        found = find_mesh(name, arm.body.file)
        if found is not None:
            element.set("filename", mesh_path(found, out, relative))
        elif element.tag == "texture":
            missing.append(f"the texture {name}: it is not found, its name is kept")
    return tuple(dict.fromkeys(missing))


def _set_bodies(root: ET.Element, arm: PlainArm, described: Description) -> None:
    """Add the changes of inertia to the links that the joints move.

    A link that alone could not lose so much takes over the inertia of what is fixed to it.
    """
    links = {link.get("name", ""): link for link in root.findall("link")}
    child = {j.get("name", ""): _end(j, "child") for j in root.findall("joint")}
    increments = arm.corrected.inertial_increments(arm.nominal)
    # inertia of a link and of what is fixed to it, in the order of the joints
    merged = arm.body.inertial_parameters().reshape(-1, 10)
    for joint, increment, total in zip(
        arm.corrected.arm.joints, increments, merged, strict=True
    ):
        if not increment.any():
            continue
        link = links[child[joint]]
        own = described.by_name[child[joint]].inertial
        alone = own_parameters(own) + increment
        # the link alone bears the change, or even all together do not
        if possible(alone) or not possible(total):
            set_parameters(link, alone)
            continue
        # the total goes onto the link: nothing stays on what is fixed there
        for name, frame in arm.frames.items():
            if frame.joint == joint and name in links:
                set_parameters(links[name], np.zeros(10))
        set_parameters(link, total)


def _set_drive(joint: ET.Element, drive: pd.Series) -> None:
    """Friction and limits of a joint."""
    dynamics = joint.find("dynamics")
    dynamics = ET.SubElement(joint, "dynamics") if dynamics is None else dynamics
    dynamics.set("damping", repr(float(drive.damping)))
    dynamics.set("friction", repr(float(drive.friction)))
    set_limit(joint, drive.effort, drive.velocity)


def _shift_zeros(root: ET.Element, arm: PlainArm, described: Description) -> None:
    """Let the coordinates of the joints be what their encoders read, the true ones plus a zero [rad or m]."""
    zeros = arm.drives["zero"]
    for joint in root.findall("joint"):
        zero = float(zeros.get(joint.get("name"), 0.0))
        if zero == 0:
            continue
        # coordinate = true + zero: the origin turns back, limits move on
        _set_origin(joint, described, -zero)
        for tag, name in LIMITS:
            element = joint.find(tag)
            limit = None if element is None else element.get(name)
            if element is not None and limit is not None:
                element.set(name, repr(float(limit) + zero))


def _turn_base(root: ET.Element, mount: Place) -> None:
    """A fixed joint between a new root link and the base."""
    links = [x.get("name", "") for x in root.findall("link")]
    joints = root.findall("joint")
    carried = {_end(joint, "child") for joint in joints}
    # the base hangs on no joint
    base = next(name for name in links if name not in carried)
    taken = {*links, *(joint.get("name", "") for joint in joints)}

    def unused(name: str) -> str:
        return unused(f"{name}_") if name in taken else name

    # a file may use these names already
    world, holder = unused("world"), unused("mount")
    joint = ET.Element("joint", name=holder, type="fixed")
    ET.SubElement(joint, "parent", link=world)
    ET.SubElement(joint, "child", link=base)
    set_origin(joint, mount)
    root.insert(0, ET.Element("link", name=world))
    root.insert(1, joint)


def _end(joint: ET.Element, tag: str) -> str:
    """Link at an end of a joint."""
    element = joint.find(tag)
    return "" if element is None else element.get("link", "")


# A corrected arm as MJCF: what ``templates/mjcf.xml.j2`` is filled with.
#
# Dry friction that Coulomb's law does not say is written as bristles of the LuGre model, which MuJoCo's ``dcmotor``
# has. A bristle bends by z and slips at g(v),
#
#     dz/dt = v - sigma0 |v| z / g(v),   friction = sigma0 z + sigma1 dz/dt,   g(v) = Fc + (Fs - Fc) exp(-(v / vs)^2),
#
# so that at a constant speed the friction is g(v) sgn v (canudas1995). With Fs = Fc and sigma1 = 0 it is Dahl's model
# of ``gapscope.effects.friction``, whose distance is Fc / sigma0.


MESHES = (".stl", ".obj", ".msh")
"""Endings of the meshes that MuJoCo reads."""
MAX_FACES = 200_000
"""MuJoCo reads no STL file with more."""
ROUNDING = 1e-9
"""Share by which a moment of inertia may exceed the sum of the others before it counts as odd."""
LEAST = 1e-12
"""Mass [kg] and moments of inertia [kg m^2] that MuJoCo gives a moving body that has none."""
STIFFEST = 1.0
"""Phase that a bristle's resonance may cover in a step, w dt [rad]: MuJoCo's step of the bristle is explicit."""
MIN_SHARE = 0.01
"""Share of the Stribeck peak that its bristle keeps in fast motion [1], since MuJoCo divides by g(v)."""
TANH_SHARES = (0.3683, 0.1010, 0.5307)
"""Shares w_i of the bristles that together are tanh(x), sum_i w_i (1 - exp(-(x / s_i)^2)); see ``TANH_SPEEDS``."""
TANH_SPEEDS = (0.4220, 0.0713, 1.1432)
"""Their s_i [1]: the minimax fit for all x, wrong by at most 0.012."""


def as_mjcf(arm: PlainArm, out: Path, relative: bool) -> tuple[str, tuple[str, ...]]:
    """The arm as MJCF, and what else is left out.

    Collision shapes are in group 3, visual ones in group 2; links that are fixed to a body are sites. What an actuator
    is commanded is the recorded torque: clipped, delayed, lagged, scaled and offset as the drive does it. A joint with
    elasticity or free play has a second joint beside it, that of its motor. Sensors hold what the encoders read.

    Args:
        arm: the arm.
        out: the file that it is written to.
        relative: whether meshes are named from the folder of ``out``.

    Raises:
        InputError: friction or rotor inertia of a coupled motor is negative, or a stiffness needs a step that is too
            short to be simulated.
    """
    bounds, notes = _bounds(arm)
    # the bristles' stiffness and the filters depend on it
    step = time_step(arm)
    meshes: dict[tuple[str, str], str] = {}
    shapes = []
    for number, shape in enumerate(arm.shapes):
        name = ""
        if problem := _unreadable(shape):
            notes.append(f"a {shape.use} shape of link {shape.link}: {problem}")
            continue
        # a mesh of one scale is written once, named after its first shape
        if shape.mesh is not None:
            file = mesh_path(shape.mesh, out, relative)
            own = f"{Path(file).stem}_{number}"
            name = meshes.setdefault((file, numbers(np.array(shape.size))), own)
        shapes.append((shape, name))
    for joint, drive in arm.drives.iterrows():
        bristle = dry_bristle(drive, step)
        if bristle is not None and builds_up(drive):
            distance = bristle.coulomb / bristle.stiffness
            # the step did not allow the stiffness: more than rounding is told
            if distance > 1.01 * drive.presliding:
                notes.append(
                    f"presliding of {joint}: friction builds up over {distance / drive.presliding:.3g} times its "
                    f"distance, since steps of {step:.3g} s cannot hold it"
                )
    text = rendered(
        "mjcf.xml.j2",
        arm=arm,
        step=step,
        bounds=bounds,
        shapes=shapes,
        meshes=meshes,
        coupled=_coupled_motors(arm),
        # a motor of its own takes the actuator, and has a joint beside that of the link
        motor_name=lambda joint: joint + "_motor" * bool(arm.drives.at[joint, "gear"]),
        builds_up=builds_up,
        dry_bristle=dry_bristle,
        saturating_bristles=saturating_bristles,
        # MuJoCo applies a step's last torque throughout, which is early by half a step. The delay of its filter is
        # e / (1 - e) steps, with e = exp(-step / T'), at low frequency; it is T for T' = step / ln(1 + step / T)
        filter_time=lambda lag: step / np.log1p(step / lag),
        quarter_turn=np.pi / 2,
        within=_within,
        teeth=(1 / (2 * np.pi * TOOTH_FREQUENCY * TOOTH_DAMPING), TOOTH_DAMPING),
    )
    return text, tuple(dict.fromkeys(notes))


def time_step(arm: PlainArm) -> float:
    """Time step that follows the gears and springs [s].

    Raises:
        InputError: a stiffness needs a step that is too short to be simulated.
    """
    # without springs as long as rigid bodies are stepped
    drives = arm.drives.iloc[arm.body.order]
    gear = drives["gear"].to_numpy()
    rotors, stiffness, damping, spring = (
        drives[name].to_numpy()
        for name in ("rotor", "gear_stiffness", "gear_damping", "stiffness")
    )
    masses = mass_matrices(arm.body)
    parts = substeps(masses, rotors, gear, stiffness, damping, spring, LONGEST_STEP)
    return LONGEST_STEP / parts


class Bristle(NamedTuple):
    """sigma0 [N m/rad], sigma1 [N m s/rad], Fc and Fs [N m], vs [rad/s], in MuJoCo's order."""

    stiffness: float
    damping: float
    coulomb: float
    static: float
    velocity: float


def dry_bristle(drive: pd.Series, step: float) -> Bristle | None:
    """The bristle of dry friction; ``None`` if Coulomb friction, set-valued at rest, says it all.

    With a presliding distance it carries Coulomb and Stribeck friction, and its damper makes good the step by which
    the explicit spring is late. Otherwise it carries the Stribeck peak beside Coulomb friction, which holds the joint
    at rest: as stiff as the step allows, and without a damper, whose torque would peak where g falls.

    Args:
        drive: of the joint.
        step: of the simulator [s].
    """
    peak, speed = drive.breakaway, drive.breakaway_speed
    # w dt of the bristle against the joint's inertia: an explicit step bears no more
    stiffest = drive.inertia * (STIFFEST / step) ** 2
    if builds_up(drive):
        stiffness = min(drive.friction / drive.presliding, stiffest)
        static = drive.friction + peak
        # without a peak Fs is Fc, and any speed says the same
        velocity = speed if peak else 1.0
        return Bristle(stiffness, stiffness * step, drive.friction, static, velocity)
    if peak:
        return Bristle(stiffest, 0.0, MIN_SHARE * peak, peak, speed)
    return None


def builds_up(drive: pd.Series) -> bool:
    """Whether Coulomb friction builds up over a distance."""
    return bool(drive.presliding > 0 and drive.friction > 0)


def saturating_bristles(drive: pd.Series, step: float) -> tuple[Bristle, ...]:
    """Saturating friction d tanh(v / vt) as bristles that carry nothing at rest, to 0.012 d.

    They need no damping, as they do not stick.

    Args:
        drive: of the joint.
        step: of the simulator [s].
    """
    if drive.saturating == 0:
        return ()
    stiffness = drive.inertia * (STIFFEST / step) ** 2
    return tuple(
        Bristle(
            stiffness,
            0.0,
            share * drive.saturating,
            0.0,
            relative * drive.saturating_speed,
        )
        for share, relative in zip(TANH_SHARES, TANH_SPEEDS, strict=True)
    )


def _coupled_motors(arm: PlainArm) -> list[dict[str, Any]]:
    """Rotor and friction of each motor that turns several joints, and its ratio by joint.

    Raises:
        InputError: friction or rotor inertia is negative.
    """
    corrected = arm.corrected
    if corrected.arm.coupling is None:
        return []
    columns = {name: corrected.passive(f"motor_{name}") for name in PASSIVE}
    # one motor on several joints: those that turn one alone are in the drives
    return [
        {name: column[motor] for name, column in columns.items()}
        | {
            "number": motor + 1,
            "ratios": dict(zip(corrected.arm.joints, ratios, strict=True)),
        }
        for motor, ratios in enumerate(corrected.arm.coupling)
        if any(column[motor] > 0 for column in columns.values())
    ]


def _bounds(arm: PlainArm) -> tuple[dict[str, str], list[str]]:
    """Attributes that let MuJoCo correct bodies that it would refuse, with a note."""
    bounds: dict[str, str] = {}
    notes = []
    # MuJoCo asks for some mass and moments of every moving body
    if any(link.mass < LEAST or link.moments.max() < LEAST for link in arm.links):
        bounds["boundmass"] = bounds["boundinertia"] = repr(LEAST)
    elif any(link.moments.min() < LEAST for link in arm.links):
        bounds["boundinertia"] = repr(LEAST)
    # moments ascend: the last against the sum of the first two
    odd = [
        link.joint
        for link in arm.links
        if link.moments[2] * (1 - ROUNDING) > link.moments[0] + link.moments[1]
    ]
    if odd:
        bounds["balanceinertia"] = "true"
        notes.append(
            f"principal moments of what is moved by {', '.join(odd)}: one is above the sum of the others, and MuJoCo "
            "puts their mean in their place"
        )
    return bounds, notes


def _within(moments: np.ndarray) -> np.ndarray:
    """Ascending principal moments [kg m^2], (3,), of which rounding does not raise the last above the others' sum."""
    low, middle, high = moments.tolist()
    return np.array(
        [
            low,
            middle,
            low + middle if 0 < high - low - middle <= ROUNDING * high else high,
        ]
    )


def _unreadable(shape: PlacedShape) -> str:
    """Why MuJoCo cannot read a shape's mesh, or an empty string."""
    if shape.mesh is None:
        return ""
    if shape.mesh.suffix.lower() not in MESHES:
        return f"MuJoCo reads no {shape.mesh.suffix or 'such'} file ({shape.mesh.name})"
    if shape.mesh.suffix.lower() == ".stl":
        with shape.mesh.open("rb") as file:
            head = file.read(84)
        # a binary STL: 80 bytes of head, the number of faces, 50 bytes for each
        faces = int.from_bytes(head[80:84], "little")
        if len(head) < 84 or shape.mesh.stat().st_size != 84 + 50 * faces:
            return f"MuJoCo reads no STL file in text ({shape.mesh.name})"
        if faces > MAX_FACES:
            return f"MuJoCo reads no mesh with more than {MAX_FACES} faces ({shape.mesh.name})"
    return ""


# A corrected arm written as a file for another simulator.


def as_sdf(arm: PlainArm, out: Path, relative: bool) -> tuple[str, tuple[str, ...]]:
    """The arm as SDF 1.6, a model of moving bodies on a base that is fixed to the world, and what else is left out.

    Poses of links are those of all joints at zero, in the world, in which the base is turned as it stands; axes are in
    the frames of the links that they move. Links that are fixed to another are merged into it. Arguments as those of
    ``as_mjcf``.
    """
    places = {"": arm.mount}
    tensors = {}
    # parents come before children, so that the place of each is known by then
    for link in arm.links:
        places[link.joint] = places[link.parent] * link.origin
        # from principal axes into those of the link
        axes = link.inertial.rotation
        tensors[link.joint] = axes @ np.diag(link.moments) @ axes.T
    text = rendered(
        "sdf.xml.j2",
        arm=arm,
        places=places,
        tensors=tensors,
        level=np.eye(3),
        mesh_path=lambda mesh: mesh_path(mesh, out, relative),
    )
    merged = [f.name for f in arm.frames.values() if f.name != arm.body_name(f.joint)]
    note = f"frames of {', '.join(merged)}: merged into the links that carry them"
    return text, (note,) * bool(merged)


WRITERS = {"urdf": as_urdf, "mjcf": as_mjcf, "sdf": as_sdf}
"""Writers of whole arms by format."""
RANGES_HEAD = (
    "# Effects between two ends, drawn at every reset, written by gapscope export; SI units, joint side.\n"
    "# For gapscope/ArmTracking-v0: randomisation=gapscope.envs.effect_ranges.read_effect_ranges(FILE), no effects=.\n"
)
"""Comment at the head of a file of ranges."""


def export(
    corrected: CorrectedArm,
    form: str,
    out: Path,
    *,
    relative: bool = False,
    controller: Controller | None = None,
    ranges: EffectRanges | None = None,
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Write a corrected arm; ``out`` never holds half of it.

    Args:
        corrected: the arm with its effects.
        form: one of ``TARGETS``.
        out: the file.
        relative: name meshes from the folder of ``out``, not absolutely; whole arms alone have meshes.
        controller: of the case, whose gains a snippet may hold.
        ranges: what a snippet lets draw, or ``None``.

    Returns:
        What the file leaves out, and what is odd about the bodies; a sentence each. Both are in the file too.

    Raises:
        InputError: no such format, an effect on a joint that does not exist, friction or armature that is negative in
            total, bodies that no torque can move, or ranges for a format that has none.
        GapscopeError: the file cannot be written.
    """
    check_known("format", form, TARGETS, where="format")
    target = TARGETS[form]
    # ranges have to be diagnosed first: without them such a file would be empty
    if ranges is None and target.needs_ranges:
        raise InputError(
            f"{form} holds ranges alone",
            "add --randomise, with diagnosis.json beside corrected.yaml",
            where="--format",
        )
    if ranges is not None and not target.draws:
        drawing = ", ".join(name for name, each in TARGETS.items() if each.draws)
        raise InputError(
            f"{form} has no words for ranges",
            f"leave it out, or choose one of {drawing}",
            where="--randomise",
        )
    arm = plain_arm(corrected)
    # our own environment reads ranges as they are: no template
    if ranges is not None and form == "environment":
        write_effect_ranges(ranges, out, RANGES_HEAD)
        return (), remarks(arm)
    missing = left_out(arm, target)
    if target.whole:
        written, more = WRITERS[form](arm, out, relative)
        missing += more
        known = [
            f"Simulate it under gravity of {arm.gravity:g} m/s^2 along -z of the world"
            + (", as the base is turned into it." if not arm.upright else "."),
            f"Meshes are named by paths {'from the folder of this file' if relative else 'from the root of the disk'}.",
        ]
        # comments of the template and of the arm's own file stay
        comments = ET.XMLParser(target=ET.TreeBuilder(insert_comments=True))
        root = ET.fromstring(written, parser=comments)
        # blanks between elements are taken out, or indenting would leave them
        for element in root.iter():
            if not (element.text or "").strip():
                element.text = None
        ET.indent(root)
        begin, body = (
            '<?xml version="1.0" encoding="utf-8"?>\n',
            ET.tostring(root, encoding="unicode") + "\n",
        )
    else:
        begin, body = "", snippet(arm, form, controller, ranges)
        known = [
            "Ranges are 95 % intervals of the diagnosis, from the lowest to the highest end of its units."
        ] * (ranges is not None)
    with atomic_write(out) as aside:
        text = begin + heading(arm, target, missing, known) + body
        aside.write_text(text, encoding="utf-8")
    return missing, remarks(arm)
