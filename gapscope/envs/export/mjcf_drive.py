"""The drives of an arm in MJCF: motors behind gears, friction, what happens to a command, and encoders."""

from __future__ import annotations

import xml.etree.ElementTree as ET

import numpy as np

from gapscope.arm.dynamics.plain_urdf import Link, numbers
from gapscope.envs.drive.substeps import mass_matrices, substeps
from gapscope.envs.drive.two_mass import TOOTH_DAMPING, TOOTH_FREQUENCY
from gapscope.envs.export.bristles import (
    builds_up,
    dry_bristle,
    presliding_distance,
    saturating_bristles,
)
from gapscope.envs.export.joint_drive import JointDrive, passive_quantity
from gapscope.envs.export.plain_arm import PlainArm

LONGEST_STEP = 1e-3
"""Time step of a file without springs [s]."""
HARD = "0.9999 0.9999 0.001 0.5 2"
"""Impedance of friction and free play: by default MuJoCo lets a joint under friction creep."""
TEETH = f"{1 / (2 * np.pi * TOOTH_FREQUENCY * TOOTH_DAMPING)!r} {TOOTH_DAMPING!r}"
"""Time constant [s] and damping ratio [1] of teeth that meet: their resonance."""
LEAST_MASS = "1e-9"
"""Mass [kg] of a body that stands for a rotor; its inertia is the armature of its joint."""
LEAST_MOMENTS = "1e-12 1e-12 1e-12"
"""Moments of inertia of that body [kg m^2]."""
PASSIVE = {"input": "none", "motorconst": "1e-6", "resistance": "1"}
"""A ``dcmotor`` without a winding's torque: nothing is commanded, and its back-EMF damps by 1e-12 N m s/rad."""


USE = """
  Command the actuator of a joint's name, with the torque as recorded; read the sensor of its name. Coordinates of
  joints are what encoders read. Keep the time step: delays would be shorter with a shorter one, friction and gears
  shake with a longer one.
"""
"""What to know of every file."""
USE_OF_GEARS = """\
  A joint with a gear has its motor's joint beside it, called ..._motor: start both at the same position.
"""
"""What to know of a file with gears."""
USE_OF_MEMORY = """\
  Before the first command delays and lags hold zero: see mj_initCtrlHistory, and act of mjData.
"""
"""What to know of a file with delays or lags."""


def how_to_use(arm: PlainArm) -> str:
    """What to know of a file, as the text of a comment."""
    drives = arm.drives.values()
    text = USE
    if any(drive.gear is not None for drive in drives):
        text += USE_OF_GEARS
    if any(drive.delay or drive.lag for drive in drives):
        text += USE_OF_MEMORY
    return text


def time_step(arm: PlainArm) -> float:
    """Time step that follows the gears and springs [s].

    Raises:
        InputError: a stiffness needs a step that is too short to be simulated.
    """
    joints = [arm.drives[name] for name in arm.body.joints]
    gears = [drive.gear for drive in joints]
    stiffness = np.array([g.stiffness if g else 0.0 for g in gears])
    damping = np.array([g.damping if g else 0.0 for g in gears])
    order = arm.body.order
    parts = substeps(
        mass_matrices(arm.body),
        np.array([drive.rotor for drive in joints])[order],
        np.array([gear is not None for gear in gears])[order],
        stiffness[order],
        damping[order],
        np.array([drive.stiffness for drive in joints])[order],
        LONGEST_STEP,
    )
    return LONGEST_STEP / parts


def motor_name(joint: str, drive: JointDrive) -> str:
    """Name of the joint on which the motor acts: the joint itself, or its motor's if there is a gear between."""
    return joint if drive.gear is None else f"{joint}_motor"


def add_friction_default(root: ET.Element, step: float) -> None:
    """Let dry friction of all joints and coupled motors stick within two steps."""
    default = ET.SubElement(root, "default")
    for tag in ("joint", "tendon"):
        ET.SubElement(
            default, tag, solreffriction=f"{2 * step!r} 1", solimpfriction=HARD
        )


def set_drive(joint: ET.Element, drive: JointDrive) -> None:
    """Friction and rotor on the joint that the motor turns."""
    set_values(
        joint,
        damping=drive.damping,
        frictionloss=0.0 if builds_up(drive) else drive.friction,
        armature=drive.rotor,
    )


def set_values(element: ET.Element, **values: float) -> None:
    """Attributes that are not zero."""
    for name, value in values.items():
        if value:
            element.set(name, repr(float(value)))


def add_motor(parent: ET.Element, link: Link, drive: JointDrive) -> ET.Element:
    """A rotor beside the body that it moves, about the same axis; its place is still to be set."""
    name = motor_name(link.joint, drive)
    body = ET.SubElement(parent, "body", name=name)
    ET.SubElement(
        body, "inertial", pos="0 0 0", mass=LEAST_MASS, diaginertia=LEAST_MOMENTS
    )
    kind = "hinge" if link.kind == "revolute" else "slide"
    joint = ET.SubElement(body, "joint", name=name, type=kind, axis=numbers(link.axis))
    set_drive(joint, drive)
    return body


def add_gears(tendons: ET.Element, arm: PlainArm) -> None:
    """Springs, dampers and free play between motors and joints, as tendons whose length is theta - q."""
    for joint, drive in arm.drives.items():
        if drive.gear is None:
            continue
        gear, half = drive.gear, 0.5 * drive.gear.width
        tendon = ET.SubElement(tendons, "fixed", name=f"{joint}_gear")
        if gear.elastic:
            tendon.set("stiffness", repr(gear.stiffness))
            tendon.set("springlength", f"{-half!r} {half!r}" if half else "0")
            set_values(tendon, damping=gear.damping)
        else:
            # teeth meet: a limit pushes only and takes any load, with the rebound of the teeth's resonance
            tendon.set("range", f"{-half!r} {half!r}")
            tendon.set("solreflimit", TEETH)
            tendon.set("solimplimit", HARD)
        for name, factor in ((motor_name(joint, drive), "1"), (joint, "-1")):
            ET.SubElement(tendon, "joint", joint=name, coef=factor)


def add_coupled_motors(tendons: ET.Element, arm: PlainArm) -> None:
    """Rotor and friction of motors that turn several joints, as tendons of length D_m q.

    Their torque acts on the joints along D_m^T.

    Raises:
        InputError: friction or rotor inertia is negative.
    """
    corrected = arm.corrected
    if corrected.arm.coupling is None:
        return
    rotor, damping, friction = (
        passive_quantity(corrected, name, "motor_")
        for name in ("rotor", "damping", "friction")
    )
    for motor in np.flatnonzero((rotor > 0) | (damping > 0) | (friction > 0)).tolist():
        tendon = ET.SubElement(tendons, "fixed", name=f"motor_{motor + 1}")
        set_values(
            tendon,
            armature=rotor[motor],
            damping=damping[motor],
            frictionloss=friction[motor],
        )
        ratios = corrected.arm.coupling[motor]
        for joint, ratio in zip(corrected.arm.joints, ratios, strict=True):
            if ratio:
                ET.SubElement(tendon, "joint", joint=joint, coef=repr(float(ratio)))


def add_actuators(root: ET.Element, arm: PlainArm, step: float) -> tuple[str, ...]:
    """An actuator per joint in the arm's order, whose command is the recorded torque; then what nobody commands.

    Returns:
        What the step keeps from being exact, a sentence each.
    """
    actuators = ET.SubElement(root, "actuator")
    for joint, drive in arm.drives.items():
        _add_command(actuators, joint, drive, step)
    notes = []
    for joint, drive in arm.drives.items():
        bristle = dry_bristle(drive, step)
        ripple = (drive.ripple, drive.ripple_cycles, drive.ripple_phase)
        cogging = ripple if drive.ripple else None
        _add_passive(
            actuators, joint, drive, "friction", cogging=cogging, lugre=bristle
        )
        for number, each in enumerate(saturating_bristles(drive, step), 1):
            _add_passive(actuators, joint, drive, f"friction_{number}", lugre=each)
        if bristle is not None and builds_up(drive):
            distance = presliding_distance(bristle)
            if distance > 1.01 * drive.presliding:
                notes.append(
                    f"presliding of {joint}: friction builds up over {distance:.3g} rad in place of "
                    f"{drive.presliding:.3g}, which steps of {step:.3g} s cannot hold"
                )
    return tuple(notes)


def add_encoders(root: ET.Element, arm: PlainArm) -> None:
    """What each encoder reads, in the arm's order; it sits on the motor or on the joint."""
    sensors = ET.SubElement(root, "sensor")
    on_motor = arm.corrected.arm.encoder == "motor"
    for joint, drive in arm.drives.items():
        seen = motor_name(joint, drive) if on_motor else joint
        ET.SubElement(sensors, "jointpos", name=joint, joint=seen)


def _add_command(
    actuators: ET.Element, joint: str, drive: JointDrive, step: float
) -> None:
    """Torque arrives as (1 + scale) times the delayed and lagged command, plus the offset."""
    actuator = ET.SubElement(
        actuators,
        "general",
        name=joint,
        joint=motor_name(joint, drive),
        gainprm=repr(1.0 + drive.scale),
    )
    if drive.delay:
        # linear between two commands is the mean over a step of one that changes within it
        samples = int(np.ceil(drive.delay / step)) + 2
        actuator.set("delay", repr(drive.delay))
        actuator.set("nsample", str(samples))
        actuator.set("interp", "linear")
    if drive.offset:
        actuator.set("biastype", "affine")
        actuator.set("biasprm", f"{drive.offset!r} 0 0")
    if drive.lag:
        actuator.set("dyntype", "filterexact")
        actuator.set("dynprm", repr(_filter_time(drive.lag, step)))
        actuator.set("actearly", "true")
    if drive.effort < np.inf:
        actuator.set("ctrlrange", numbers(np.array([-drive.effort, drive.effort])))


def _filter_time(lag: float, step: float) -> float:
    """Time constant [s] of a filter whose torque at the end of each step is as late as 1 / (1 + T s) within it.

    MuJoCo applies a step's last torque throughout, which is early by half a step. The delay of its filter is
    e / (1 - e) steps, with e = exp(-step / T'), at low frequency; it is T for T' = step / ln(1 + step / T).
    """
    return float(step / np.log1p(step / lag))


def _add_passive(
    actuators: ET.Element,
    joint: str,
    drive: JointDrive,
    use: str,
    **values: tuple[float, ...] | None,
) -> None:
    """Attributes of what acts on the motor beside the command, if there are any."""
    present = {
        name: numbers(np.array(x)) for name, x in values.items() if x is not None
    }
    if present:
        moved = motor_name(joint, drive)
        passive = ET.SubElement(
            actuators, "dcmotor", name=f"{joint}_{use}", joint=moved
        )
        for name, value in {**PASSIVE, **present}.items():
            passive.set(name, value)
