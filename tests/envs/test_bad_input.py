"""What a user can get wrong about a simulated arm: each fault names its place, and says what to do.

Through ``gapscope record`` and ``gapscope replay``, which return 2 without a traceback, and through the environment.
"""

import re
from pathlib import Path

import numpy as np
import pytest
from episodes import missing_torque

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError, ModelWarning
from gapscope.arm.robots import load_nominal_arm
from gapscope.envs.engines import ENGINES
from gapscope.envs.environment import ArmTracking
from gapscope.envs.simulated_arm import SimulatedArm

IIWA = load_nominal_arm("kuka_iiwa").urdf


HEAD = """schema: 1
effects:
- {effect: actuator_delay, joints: [1], parameters: {delay: [0.002]}}
"""
"""An effect that is at fault neither here nor there."""


def written(tmp_path: Path, *entries: str) -> Path:
    """A file of effects, in the words of YAML."""
    path = tmp_path / "corrected.yaml"
    path.write_text(HEAD + "".join(f"- {{effect: {entry}}}\n" for entry in entries))
    return path


@pytest.fixture
def record(gapscope, tmp_path: Path):
    """Records an arm with the effects of a file, or without any, into ``case``."""
    short = ("--recordings", 1, "--duration", 1.0, "--seed", 1, "--out")

    def call(robot: object, effects: Path | None = None):
        file = effects or written(tmp_path)
        return gapscope("record", robot, "--effects", file, *short, tmp_path / "case")

    return call


ROTOR = "armature, joints: [2], parameters: {inertia: [1e-3]}"
ELASTIC = "joint_elasticity, joints: [2], parameters: {%s: [%s], damping: [0.0]}"
HEAVY = "payload, parameters: {mass: -3.0, com: [0, 0, 0]}"
EFFECTS = {
    "joint that does not exist": (
        ["coulomb_friction, joints: [9], parameters: {torque: [1.0]}"],
        "effects[1], coulomb_friction: joint 9 of an arm with 7 joints",
        "joints count from 1 to 7",
    ),
    "link that does not exist": (
        ["link_inertia, parameters: {link: 9, mass: 1.0, com: [0, 0, 0]}"],
        "effects[1], link_inertia: joint 9 of an arm with 7 joints",
        "a link has the number of the joint that moves it",
    ),
    "payload that leaves a negative mass": (
        [HEAVY],
        "effects[1], payload: the link moved by joint 7 (lbr_iiwa_joint_7) has mass -2.7 kg",
        "an increment that leaves the link's mass and inertia above zero",
    ),
    "friction that feeds energy in": (
        ["coulomb_friction, joints: [3], parameters: {torque: [-5.0]}"],
        "effects[1], coulomb_friction: nominal value plus effect is -5 N m at joint 3",
        "zero or above",
    ),
    "stiffness that the step cannot hold": (
        [ROTOR, ELASTIC % ("stiffness", 1e7)],
        "effects[2], joint_elasticity.stiffness: the stiffness or damping about joint 2 moves at",
        "a lower stiffness or damping, or more rotor inertia",
    ),
    "elasticity without a rotor": (
        [ELASTIC % ("stiffness", 1e4)],
        "effects[1], joint_elasticity: joint 2 has a motor of its own but no rotor inertia",
        "nominal.armature",
    ),
    "unknown parameter": (
        [ELASTIC % ("stifness", 1e4)],
        "effects[1], joint_elasticity: expected the parameters stiffness, damping; got stifness, damping",
        "'stifness' is unknown: did you mean 'stiffness'? give stiffness in N m/rad, damping in N m s/rad",
    ),
}


@pytest.mark.parametrize(
    ("entries", "message", "remedy"), EFFECTS.values(), ids=EFFECTS
)
def test_an_effect_at_fault(
    record, tmp_path: Path, entries: list[str], message: str, remedy: str
) -> None:
    """File, entry and field, and what to do; from the command, and from the environment that is given the file."""
    file = written(tmp_path, *entries)
    done = record("kuka_iiwa", file)
    assert done.code == 2 and not (tmp_path / "case").exists()
    assert f"gapscope: {file}, {message}" in done.said
    assert remedy in done.said.split("remedy: ")[1]
    with pytest.raises(InputError, match=re.escape(message.split(": ", 1)[1])):
        ArmTracking("kuka_iiwa", effects=file)


def _third_link(pattern: str, new: str) -> str:
    """The iiwa's URDF with its third link changed."""
    urdf = IIWA.read_text()
    link = re.search(r'<link name="lbr_iiwa_link_3">.*?</link>', urdf, re.DOTALL)[0]
    changed = re.sub(pattern, new, link, flags=re.DOTALL)
    assert changed != link
    return urdf.replace(link, changed)


def _moments(ixx: float) -> str:
    return f'<inertia ixx="{ixx}" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/>'


@pytest.mark.parametrize(
    ("change", "message", "remedy"),
    [
        (
            (r"<mass [^>]*/>", '<mass value="-2"/>'),
            "line 152, link lbr_iiwa_link_3, <inertial>: mass is -2 kg, expected zero or above",
            "correct its value",
        ),
        (
            (r"<inertia [^>]*/>", _moments(-1.0)),
            "principal moments -1, 0.1, 0.1 kg m^2",
            "they are about the centre of mass",
        ),
        (
            (r"<mass [^>]*/>", '<mass value="heavy"/>'),
            "link lbr_iiwa_link_3, <mass value>: expected a number, got 'heavy'",
            "correct the attribute",
        ),
        (
            (r"<mass [^>]*/>", ""),
            "link lbr_iiwa_link_3, <inertial>: has no <mass value>",
            "leave <inertial> out of a link that has no mass",
        ),
        ((r"<mass.*", ""), "is not valid XML", "was it cut short?"),
    ],
)
def test_an_inertia_that_no_body_can_have_is_refused(
    record, tmp_path: Path, change: tuple[str, str], message: str, remedy: str
) -> None:
    file = tmp_path / "broken.urdf"
    file.write_text(_third_link(*change))
    done = record(file)
    assert done.code == 2 and f"{file}" in done.said and message in done.said
    assert remedy in done.said.split("remedy: ")[1]


ODD = {
    "triangle inequality": (
        (r"<inertia [^>]*/>", _moments(1.0)),
        "the link moved by joint 3 (lbr_iiwa_joint_3) has the principal moments of inertia 0.1, 0.1, 1 kg m^2, of "
        "which no body has one above the sum of the others: they are simulated as they are",
    ),
    "no inertial": (
        (r"<inertial>.*</inertial>", ""),
        "the link moved by joint 3 (lbr_iiwa_joint_3) has no <inertial>: it is simulated without mass",
    ),
}


@pytest.mark.parametrize(("change", "message"), ODD.values(), ids=ODD)
@pytest.mark.filterwarnings("always::gapscope.arm.errors.ModelWarning")
def test_an_odd_inertia_is_told_and_simulated_alike_on_every_engine(
    record, tmp_path: Path, change: tuple[str, str], message: str
) -> None:
    """Published models break the triangle inequality; engines left alone would zero it, or give a link 1 kg."""
    file = tmp_path / "odd.urdf"
    file.write_text(_third_link(*change))
    arm = load_nominal_arm(file, sheet={"viscous": [0.0] * 7})
    body, rng = RigidBody(arm), np.random.default_rng(2)
    for name in ENGINES:
        try:
            with pytest.warns(ModelWarning, match=re.escape(f"{file}: {message}")):
                simulated = SimulatedArm(arm, engine=name)
        except InputError as error:
            assert "not installed" in str(error)
            continue
        with simulated:
            q, dq, torque = 0.5 * rng.standard_normal((3, 7))
            off = missing_torque(simulated, q, dq, torque)
            assert np.abs(off).max() < 1e-6 * np.abs(body.bias(q, dq)).max()
    done = record(file)
    assert done.code == 0 and f"note: {file}: {message}" in done.said


def test_a_corrected_model_at_fault_is_not_replayed(
    record, gapscope, tmp_path: Path
) -> None:
    assert record("kuka_iiwa").code == 0
    model, case = written(tmp_path, HEAVY), tmp_path / "case"
    files = ("--recording", case / "recording_1.csv", "--out", tmp_path / "out.csv")
    done = gapscope("replay", case, "--model", model, *files)
    said = f"{model}, effects[1], payload: the link moved by joint 7"
    assert done.code == 2 and said in done.said
