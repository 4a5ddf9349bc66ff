"""What a user can get wrong about a simulated arm: each fault names its place, and says what to do.

Through ``gapscope record`` and ``gapscope replay``, which return 2 without a traceback, and through the environment.
"""

import re
from pathlib import Path

import numpy as np
import pytest
import yaml

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError, ModelWarning
from gapscope.arm.robots import load_nominal_arm
from gapscope.cli import main
from gapscope.envs.engines import ENGINES
from gapscope.envs.environment import ArmTracking
from gapscope.envs.simulated_arm import SimulatedArm

IIWA = load_nominal_arm("kuka_iiwa").urdf


def _entry(name: str, parameters: dict, joints: list[int] | None = None) -> dict:
    where = {} if joints is None else {"joints": joints}
    return {"effect": name, "parameters": parameters} | where


def _file(tmp_path: Path, *entries: dict) -> Path:
    """A file of effects, the first of which is at fault neither here nor there."""
    path = tmp_path / "corrected.yaml"
    harmless = _entry("actuator_delay", {"delay": [0.002]}, [1])
    content = {"schema": 1, "effects": [harmless, *entries]}
    path.write_text(yaml.safe_dump(content, sort_keys=False))
    return path


def _run(capsys: pytest.CaptureFixture, *arguments: object) -> tuple[int, str]:
    """Exit code and what a command writes on standard error, in one line."""
    with pytest.raises(SystemExit) as stopped:
        main([str(argument) for argument in arguments])
    return int(stopped.value.code or 0), " ".join(capsys.readouterr().err.split())


def _record(
    capsys: pytest.CaptureFixture, robot: object, effects: Path
) -> tuple[int, str]:
    out = ("--effects", effects, "--out", effects.parent / "case")
    short = ("--recordings", 1, "--duration", 1.0, "--seed", 1)
    return _run(capsys, "record", robot, *out, *short)


ROTOR = _entry("armature", {"inertia": [1e-3]}, [2])
NOWHERE = {"link": 9, "mass": 1.0, "com": [0, 0, 0]}
LESS = {"mass": -3.0, "com": [0, 0, 0]}


def _spring(name: str = "stiffness", value: float = 1e4) -> dict:
    return _entry("joint_elasticity", {name: [value], "damping": [0.0]}, [2])


def _dry(torque: float, joint: int) -> dict:
    return _entry("coulomb_friction", {"torque": [torque]}, [joint])


EFFECTS = {
    "joint that does not exist": (
        [_dry(1.0, 9)],
        "effects[1], coulomb_friction: joint 9 of an arm with 7 joints",
        "joints count from 1 to 7",
    ),
    "link that does not exist": (
        [_entry("link_inertia", NOWHERE)],
        "effects[1], link_inertia: joint 9 of an arm with 7 joints",
        "a link has the number of the joint that moves it",
    ),
    "payload that leaves a negative mass": (
        [_entry("payload", LESS)],
        "effects[1], payload: the link moved by joint 7 (lbr_iiwa_joint_7) has mass -2.7 kg",
        "an increment that leaves the link's mass and inertia above zero",
    ),
    "friction that feeds energy in": (
        [_dry(-5.0, 3)],
        "effects[1], coulomb_friction: nominal value plus effect is -5 N m at joint 3",
        "zero or above",
    ),
    "stiffness that the step cannot hold": (
        [ROTOR, _spring(value=1e7)],
        "effects[2], joint_elasticity.stiffness: the stiffness or damping about joint 2 moves at",
        "a lower stiffness or damping, or more rotor inertia",
    ),
    "elasticity without a rotor": (
        [_spring()],
        "effects[1], joint_elasticity: joint 2 has a motor of its own but no rotor inertia",
        "nominal.armature",
    ),
    "unknown parameter": (
        [_spring("stifness")],
        "effects[1], joint_elasticity: expected the parameters stiffness, damping; got stifness, damping",
        "'stifness' is unknown: did you mean 'stiffness'? give stiffness in N m/rad, damping in N m s/rad",
    ),
}


@pytest.mark.parametrize(
    ("entries", "message", "remedy"), EFFECTS.values(), ids=EFFECTS
)
def test_an_effect_at_fault(
    capsys, tmp_path: Path, entries: list[dict], message: str, remedy: str
) -> None:
    """File, entry and field, and what to do; from the command, and from the environment that is given the file."""
    file = _file(tmp_path, *entries)
    code, text = _record(capsys, "kuka_iiwa", file)
    assert code == 2 and "Traceback" not in text and not (tmp_path / "case").exists()
    assert (
        f"gapscope: {file}, {message}" in text and remedy in text.split("remedy: ")[1]
    )
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


MASS, INERTIA = r"<mass [^>]*/>", r"<inertia [^>]*/>"
THIRD = "link lbr_iiwa_link_3"
BODIES = [
    (MASS, '<mass value="-2"/>', f"line 152, {THIRD}, <inertial>: mass is -2 kg", "correct its value"),
    (INERTIA, _moments(-1.0), "principal moments -1, 0.1, 0.1 kg m^2", "they are about the centre of mass"),
    (MASS, '<mass value="heavy"/>', f"{THIRD}, <mass value>: expected a number, got 'heavy'", "correct the"),
    (MASS, "", f"{THIRD}, <inertial>: has no <mass value>", "leave <inertial> out of a link that has no mass"),
    (r"<mass.*", "", "is not valid XML", "was it cut short?"),
]  # fmt: skip


@pytest.mark.parametrize(("old", "new", "message", "remedy"), BODIES)
def test_an_inertia_that_no_body_can_have_is_refused(
    capsys, tmp_path: Path, old: str, new: str, message: str, remedy: str
) -> None:
    file = tmp_path / "broken.urdf"
    file.write_text(_third_link(old, new))
    code, text = _record(capsys, file, _file(tmp_path))
    assert code == 2 and f"{file}" in text and message in text
    assert remedy in text.split("remedy: ")[1]


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
    capsys, tmp_path: Path, change: tuple[str, str], message: str
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
            simulated.reset(q, dq)
            simulated.step(torque)
            ddq = (simulated.dq - dq) / simulated.dt
            needed = body.inverse_dynamics(q[None], dq[None], ddq[None])[0]
            np.testing.assert_allclose(
                needed, torque, atol=1e-6 * np.abs(body.bias(q, dq)).max()
            )
    code, text = _record(capsys, file, _file(tmp_path))
    assert code == 0 and f"note: {file}: {message}" in text


def test_a_corrected_model_at_fault_is_not_replayed(capsys, tmp_path: Path) -> None:
    assert _record(capsys, "kuka_iiwa", _file(tmp_path))[0] == 0
    model, case = _file(tmp_path, _entry("payload", LESS)), tmp_path / "case"
    more = ("--recording", case / "recording_1.csv", "--out", tmp_path / "out.csv")
    code, text = _run(capsys, "replay", case, "--model", model, *more)
    said = f"{model}, effects[1], payload: the link moved by joint 7"
    assert code == 2 and said in text
