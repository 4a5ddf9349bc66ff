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
    return {"effect": name, "parameters": parameters} | (
        {} if joints is None else {"joints": joints}
    )


def _file(tmp_path: Path, *entries: dict) -> Path:
    """A file of effects, the first of which is at fault neither here nor there."""
    path = tmp_path / "corrected.yaml"
    harmless = _entry("actuator_delay", {"delay": [0.002]}, [1])
    path.write_text(
        yaml.safe_dump({"schema": 1, "effects": [harmless, *entries]}, sort_keys=False)
    )
    return path


def _run(capsys: pytest.CaptureFixture, *arguments: object) -> tuple[int, str]:
    """Exit code and what a command writes on standard error, in one line."""
    with pytest.raises(SystemExit) as stopped:
        main([str(argument) for argument in arguments])
    return int(stopped.value.code or 0), " ".join(capsys.readouterr().err.split())


def _record(
    capsys: pytest.CaptureFixture, robot: object, effects: Path, *options: object
) -> tuple[int, str]:
    short = (
        "--recordings",
        1,
        "--duration",
        1.0,
        "--seed",
        1,
        "--out",
        effects.parent / "case",
    )
    return _run(capsys, "record", robot, "--effects", effects, *short, *options)


ROTOR = _entry("armature", {"inertia": [1e-3]}, [2])
EFFECTS = {
    "joint that does not exist": (
        [_entry("coulomb_friction", {"torque": [1.0]}, [9])],
        "effects[1], coulomb_friction: joint 9 of an arm with 7 joints",
        "joints count from 1 to 7",
    ),
    "link that does not exist": (
        [_entry("link_inertia", {"link": 9, "mass": 1.0, "com": [0, 0, 0]})],
        "effects[1], link_inertia: joint 9 of an arm with 7 joints",
        "a link has the number of the joint that moves it",
    ),
    "payload that leaves a negative mass": (
        [_entry("payload", {"mass": -3.0, "com": [0, 0, 0]})],
        "effects[1], payload: the link moved by joint 7 (lbr_iiwa_joint_7) has mass -2.7 kg",
        "an increment that leaves the link's mass and inertia above zero",
    ),
    "friction that feeds energy in": (
        [_entry("coulomb_friction", {"torque": [-5.0]}, [3])],
        "effects[1], coulomb_friction: nominal value plus effect is -5 N m at joint 3",
        "zero or above",
    ),
    "stiffness that the step cannot hold": (
        [
            ROTOR,
            _entry("joint_elasticity", {"stiffness": [1e7], "damping": [0.0]}, [2]),
        ],
        "effects[2], joint_elasticity.stiffness: the stiffness or damping about joint 2 moves at",
        "a lower stiffness or damping, or more rotor inertia",
    ),
    "elasticity without a rotor": (
        [_entry("joint_elasticity", {"stiffness": [1e4], "damping": [0.0]}, [2])],
        "effects[1], joint_elasticity: joint 2 has a motor of its own but no rotor inertia",
        "nominal.armature",
    ),
    "unknown parameter": (
        [_entry("joint_elasticity", {"stifness": [1e4], "damping": [0.0]}, [2])],
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
    capsys, tmp_path: Path, change: tuple[str, str], message: str, remedy: str
) -> None:
    file = tmp_path / "broken.urdf"
    file.write_text(_third_link(*change))
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
    model = _file(tmp_path, _entry("payload", {"mass": -3.0, "com": [0, 0, 0]}))
    common = (
        "--recording",
        tmp_path / "case" / "recording_1.csv",
        "--out",
        tmp_path / "replayed.csv",
    )
    code, text = _run(capsys, "replay", tmp_path / "case", "--model", model, *common)
    assert (
        code == 2 and f"{model}, effects[1], payload: the link moved by joint 7" in text
    )
