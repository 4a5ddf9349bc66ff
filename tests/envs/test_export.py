"""An exported arm, loaded again by other simulators, needs the torque that the corrected arm needs."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from arms import ROD, Link, written

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.motions.motion import Motion
from gapscope.arm.nominal import NominalArm
from gapscope.arm.robots import load_nominal_arm
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.arm_scale import ArmScale
from gapscope.effects.catalogue import CATALOGUE
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.friction import COULOMB
from gapscope.effects.parameter import Parameter
from gapscope.effects.severity import draw
from gapscope.envs.export.formats import export
from gapscope.envs.export.plain_arm import TARGETS, holds
from gapscope.ident.model.physical_parameters import urdf_text

LINK_2 = {"link": 2, "mass": 0.4, "com": [0.01, 0.02, -0.01]}
BODIES = (
    AppliedEffect("payload", (), {"mass": 1.3, "com": [0.02, -0.01, 0.05]}),
    AppliedEffect("link_inertia", (), LINK_2),
    AppliedEffect("base_tilt", (), {"roll": 0.1, "pitch": -0.2}),
)
DRIVES = (
    AppliedEffect("viscous_friction", (1, 3), {"coefficient": [2.0, 3.0]}),
    AppliedEffect("coulomb_friction", (2,), {"torque": [4.0]}),
    AppliedEffect("armature", (1, 2), {"inertia": [0.4, 0.3]}),
    AppliedEffect("parallel_spring", (2,), {"stiffness": [12.0], "rest": [0.3]}),
    AppliedEffect("torque_saturation", (4,), {"limit": [20.0]}),
)
OFF = (AppliedEffect("encoder_offset", (2, 4), {"offset": [0.03, -0.05]}),)
WARMING = {"amplitude": [0.5], "time_constant": [60.0]}
HARD = (
    AppliedEffect("load_friction", (2,), {"coefficient": [0.1]}),
    AppliedEffect("friction_drift", (4,), WARMING),
    AppliedEffect("encoder_quantization", (3,), {"step": [0.002]}),
)
FORMATS = ("urdf", "mjcf", "sdf")
ROBOTS = ("kuka_iiwa", "franka_panda")
Torque = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]


def states(arm: CorrectedArm, count: int = 6) -> Motion:
    """Random states within the limits, as a motion whose samples have nothing to do with each other."""
    rng, n = np.random.default_rng(0), arm.arm.n_joints
    ends = np.clip(0.9 * np.array(RigidBody(arm.arm).position_limits()), -2, 2)
    q, dq, ddq = rng.uniform(*ends, (count, n)), *rng.normal(size=(2, count, n))
    return Motion(np.arange(count) / 250, q, dq, 3 * ddq)


def assert_needed(arm: CorrectedArm, torque: Torque, **near: float) -> None:
    """Another program needs the torque of the corrected bodies at these states."""
    motion = states(arm)
    want = arm.rigid_torque(RigidBody(arm.arm), motion)
    got = [torque(*x) for x in zip(motion.q, motion.dq, motion.ddq, strict=True)]
    assert np.array(got) == pytest.approx(want, **near)


def random_effects(rng: np.random.Generator, n: int) -> tuple[AppliedEffect, ...]:
    """Changes of the bodies, of any size that a body can have."""
    payload = {"mass": rng.uniform(0, 5), "com": rng.uniform(-0.2, 0.2, 3)}
    tilt = {"roll": rng.uniform(-1, 1), "pitch": rng.uniform(-1, 1)}
    found = [
        AppliedEffect("payload", (), payload),
        AppliedEffect("base_tilt", (), tilt),
    ]
    for joint in range(1, n + 1):
        more = {"mass": rng.uniform(-0.4, 1), "com": rng.uniform(-0.05, 0.05, 3)}
        found.append(AppliedEffect("link_inertia", (), {"link": joint, **more}))
    return tuple(found)


def exported(
    arm: CorrectedArm, form: str, folder: Path, **options: object
) -> tuple[Path, tuple[str, ...]]:
    """The file of an arm, and what it leaves out."""
    out = folder / f"arm.{form}"
    missing, _ = export(arm, form, out, **options)
    return out, missing


def iiwa(*effects: AppliedEffect, **options: object) -> CorrectedArm:
    return CorrectedArm(load_nominal_arm("kuka_iiwa", **options), effects)


def assert_in_file(arm: CorrectedArm, file: Path, joints: object = None) -> None:
    """The bodies of a file are those of the corrected arm."""
    body = RigidBody(load_nominal_arm(file, joints=joints))
    one = lambda *state: body.inverse_dynamics(*(x[None] for x in state))[0]  # noqa: E731
    assert_needed(arm, one, rel=1e-9)


@pytest.fixture
def bullet() -> Iterator[object]:
    pybullet = pytest.importorskip("pybullet")
    client = pybullet.connect(pybullet.DIRECT)
    pybullet.setGravity(0, 0, -9.81)
    yield pybullet
    pybullet.disconnect(client)


@pytest.mark.parametrize("robot", ROBOTS)
@pytest.mark.parametrize("seed", range(3))
def test_torque_of_urdf_in_pinocchio(tmp_path: Path, robot: str, seed: int) -> None:
    nominal = load_nominal_arm(robot)
    effects = random_effects(np.random.default_rng(seed), nominal.n_joints)
    arm = CorrectedArm(nominal, effects)
    file, _ = exported(arm, "urdf", tmp_path)
    assert_in_file(arm, file, nominal.joints)


@pytest.mark.parametrize("robot", ROBOTS)
def test_torque_of_urdf_in_pybullet(bullet, tmp_path: Path, robot: str) -> None:
    arm = CorrectedArm(load_nominal_arm(robot), BODIES)
    file, _ = exported(arm, "urdf", tmp_path)
    flags = bullet.URDF_USE_INERTIA_FROM_FILE
    loaded = bullet.loadURDF(str(file), useFixedBase=True, flags=flags)

    def torque(*state: np.ndarray) -> np.ndarray:
        lists = (x.tolist() for x in state)
        return np.array(bullet.calculateInverseDynamics(loaded, *lists))

    assert_needed(arm, torque, rel=1e-6, abs=1e-6)


@pytest.mark.parametrize("robot", ROBOTS)
def test_torque_of_mjcf_in_mujoco_with_rotors_friction_and_springs(
    tmp_path: Path, robot: str
) -> None:
    mujoco = pytest.importorskip("mujoco")
    arm = CorrectedArm(load_nominal_arm(robot), BODIES + DRIVES + OFF)
    file, missing = exported(arm, "mjcf", tmp_path)
    assert missing == ("velocity limits of the joints: MuJoCo knows none",)
    model = mujoco.MjModel.from_xml_path(str(file))
    dry, bits = model.dof_frictionloss.copy(), mujoco.mjtDisableBit
    model.opt.disableflags |= bits.mjDSBL_CONTACT | bits.mjDSBL_FRICTIONLOSS
    data, motion = mujoco.MjData(model), states(arm)
    want = arm.needed_torque(arm.rigid_torque(RigidBody(arm.arm), motion), motion)
    for k, wanted in enumerate(want):
        data.qpos[:], data.qvel[:] = motion.q[k], motion.dq[k]
        data.qacc[:] = motion.ddq[k]
        mujoco.mj_inverse(model, data)
        got = data.qfrc_inverse + dry * np.tanh(motion.dq[k] / 0.005)
        assert got == pytest.approx(wanted, rel=1e-6, abs=1e-9)


def test_torque_of_sdf_in_dart(tmp_path: Path) -> None:
    dartpy = pytest.importorskip("dartpy")
    arm = iiwa(*BODIES, *OFF)
    file, _ = exported(arm, "sdf", tmp_path)
    text = ET.parse(file)
    for link in text.getroot().iter("link"):  # DART is slow at shapes
        for shape in (*link.findall("visual"), *link.findall("collision")):
            link.remove(shape)
    text.write(file)
    skeleton = dartpy.utils.SdfParser.readSkeleton(str(file))
    skeleton.setGravity(np.array([0, 0, -9.81]))

    def torque(q: np.ndarray, dq: np.ndarray, ddq: np.ndarray) -> np.ndarray:
        skeleton.setPositions(q)
        skeleton.setVelocities(dq)
        skeleton.setAccelerations(ddq)
        skeleton.computeInverseDynamics()
        return skeleton.getForces().copy()

    assert_needed(arm, torque, rel=1e-6, abs=1e-9)


@pytest.mark.parametrize(
    ("effects", "gravity"), [(OFF, (0.0, 0.0, -9.81)), (BODIES, (0.0, -9.81, 0.0))]
)
def test_torque_at_what_encoders_read_and_as_gravity_of_the_case_says(
    tmp_path: Path, effects: tuple, gravity: tuple
) -> None:
    """With its encoders off, and on a wall."""
    arm = iiwa(*effects, gravity=list(gravity))
    file, _ = exported(arm, "urdf", tmp_path)
    assert_in_file(arm, file)
    several = arm.arm, load_nominal_arm(file)
    before, after = (np.array(RigidBody(x).position_limits()) for x in several)
    assert after == pytest.approx(before + arm.quantity("zero"))


def test_torque_of_a_link_that_takes_over_what_is_fixed_to_it(tmp_path: Path) -> None:
    """3 kg less than the flange weighs alone, but its hand is heavier still."""
    flange = Link("j", "l", mass=1, com="0 0 0", inertia="1 1 1")
    hand = flange._replace(joint="f", name="hand", mass=9, origin="0.5 0 0")
    hand = hand._replace(kind="fixed")
    robot = load_nominal_arm(written(tmp_path / "robot.urdf", "r", flange, hand))
    less = {"link": 1, "mass": -3.0, "com": [0.0, 0.0, 0.1]}
    arm = CorrectedArm(robot, (AppliedEffect("link_inertia", (), less),))
    file, _ = exported(arm, "urdf", tmp_path)
    mass = RigidBody(load_nominal_arm(file)).inertial_parameters()[0]
    assert mass == pytest.approx(7.0)
    assert_in_file(arm, file)


def test_friction_and_limits_in_urdf(tmp_path: Path) -> None:
    arm = iiwa(*DRIVES)
    file, _ = exported(arm, "urdf", tmp_path)
    again = load_nominal_arm(file)
    assert again.viscous == pytest.approx(arm.quantity("damping"))
    assert again.coulomb == pytest.approx([0, 4, 0, 0, 0, 0, 0])
    body, nominal = RigidBody(again), RigidBody(arm.arm)
    effort = np.where(np.arange(7) == 3, 20.0, nominal.effort_limits())
    assert body.effort_limits() == pytest.approx(effort)
    assert body.velocity_limits() == pytest.approx(nominal.velocity_limits())


@pytest.mark.parametrize("limit", ["", '<limit effort="99" velocity="9"/>'])
def test_limits_of_a_joint_that_turns_on_and_on(tmp_path: Path, limit: str) -> None:
    """Also as an identified arm; what is not known is no limit: 0 would hold the joint."""
    original, identified = tmp_path / "robot.urdf", tmp_path / "identified.urdf"
    robot = load_nominal_arm(written(original, "r", ROD._replace(more=limit)))
    identified.write_text(urdf_text(robot, RigidBody(robot)))
    file, _ = exported(CorrectedArm(robot), "urdf", tmp_path)
    files = original, identified, file
    want, *found = (pin.buildModelFromUrdf(str(x)) for x in files)
    for model in found:
        assert model.effortLimit == want.effortLimit
        assert model.velocityLimit == want.velocityLimit
    less = AppliedEffect("torque_saturation", (1,), {"limit": [20.0]})
    file, _ = exported(CorrectedArm(robot, (less,)), "urdf", tmp_path)
    model = pin.buildModelFromUrdf(str(file))
    assert model.effortLimit == 20 and model.velocityLimit >= 9


def test_friction_spring_and_limits_in_sdf(tmp_path: Path) -> None:
    arm = iiwa(*DRIVES)
    file, _ = exported(arm, "sdf", tmp_path)
    joints = list(ET.parse(file).getroot().iter("joint"))
    named = {joint.get("name"): joint for joint in joints}
    second, fourth = (named[arm.arm.joints[j]] for j in (1, 3))
    drive = {"damping": 0.5, "friction": 4, "spring_reference": 0.3}
    drive |= {"spring_stiffness": 12}
    limit = {"lower": -2.0943951, "upper": 2.0943951, "effort": 20, "velocity": 10}
    for said, expected in ((second, drive), (fourth, limit)):
        found = {key: float(said.find(f".//{key}").text) for key in expected}
        assert found == pytest.approx(expected)


@pytest.mark.parametrize("form", FORMATS)
@pytest.mark.parametrize("relative", [False, True])
def test_meshes_are_found_from_the_new_place(
    tmp_path: Path, form: str, relative: bool
) -> None:
    out, arm = tmp_path / "deep" / "arm.xml", load_nominal_arm("franka_panda")
    export(CorrectedArm(arm), form, out, relative=relative)
    root = ET.parse(out).getroot()
    given = [x.get("filename") or x.get("file") for x in root.iter("mesh")]
    names = [*filter(None, given), *(uri.text for uri in root.iter("uri"))]
    assert len(names) > 8
    assert all(Path(name).is_absolute() != relative for name in names)
    assert all((out.parent / name).is_file() for name in names)


def test_a_urdf_without_its_meshes_is_read_by_pybullet(bullet, tmp_path: Path) -> None:
    """A recorded case has the URDF alone: shapes without a mesh are left out, those of packages keep their name."""
    known, robot = load_nominal_arm("kuka_iiwa").urdf, tmp_path / "robot.urdf"
    text = known.read_text()
    robot.write_text(text.replace("meshes/link_3.stl", "package://iiwa/link_3.stl"))
    out, missing = exported(CorrectedArm(load_nominal_arm(robot)), "urdf", tmp_path)
    names = {x.get("filename") for x in ET.parse(out).getroot().iter("mesh")}
    assert names == {"package://iiwa/link_3.stl"}
    said = "\n".join(missing)
    assert "link_3.stl is not found, its name is kept" in said
    assert "link_4.stl is not found" in said
    robot.write_text(text)
    exported(CorrectedArm(load_nominal_arm(robot)), "urdf", tmp_path)
    assert bullet.getNumJoints(bullet.loadURDF(str(out))) >= 7


@pytest.mark.parametrize("form", FORMATS)
def test_left_out_is_told_and_written_with_figures(tmp_path: Path, form: str) -> None:
    file, missing = exported(iiwa(*DRIVES, *HARD), form, tmp_path)
    said, text = "\n".join(missing), file.read_text(encoding="utf-8")
    assert "nearest: Coulomb friction higher by" in said
    assert "friction_drift, joint 4: amplitude 0.5; time_constant 60 s" in said
    assert "encoder_quantization, joint 3: step 0.002 rad" in said
    assert ("armature" in said) == (form != "mjcf")
    assert ("parallel_spring" in said) == (form == "urdf")
    assert all(line in text for line in missing)


def test_left_out_what_slides_has_forces_masses_and_metres(tmp_path: Path) -> None:
    rail = Link("rail", "cart", kind="prismatic")
    robot = load_nominal_arm(
        written(tmp_path / "robot.urdf", "r", rail),
        sheet={"armature": [1.5], "encoder_step": 1e-5},
    )
    effects = (
        AppliedEffect("torque_offset", (1,), {"torque": [3.0]}),
        AppliedEffect("load_friction", (1,), {"coefficient": [0.1]}),
    )
    _, missing = exported(CorrectedArm(robot, effects), "urdf", tmp_path)
    text = "\n".join(missing)
    assert {"3 N", "1.5 kg", "1e-05 m"} <= set(re.findall(r"[\d.e-]+ [Nkgm]+\b", text))
    assert not re.search(r"N m|m\^2|rad", text)


@pytest.mark.parametrize("form", FORMATS)
def test_every_effect_is_held_or_told(
    data_sheet_arm: NominalArm, tmp_path: Path, form: str
) -> None:
    """All of them on one arm."""
    rng, scale = np.random.default_rng(0), ArmScale.of(data_sheet_arm)
    effects = tuple(draw(name, rng, scale, (1,)) for name in CATALOGUE)
    _, missing = exported(CorrectedArm(data_sheet_arm, effects), form, tmp_path)
    told = {name for name in CATALOGUE for x in missing if x.startswith(name)}
    possible = TARGETS[form].held
    assert told == {x for x, law in CATALOGUE.items() if not holds(possible, law)}


MJCF = (
    '<mujoco model="m"><compiler angle="radian" autolimits="true"/><worldbody><body name="base"><body name="l">'
    '<inertial pos="0.3 0 0.1" mass="2" diaginertia="0.1 0.2 0.25"/><joint name="j" axis="0 1 0" range="-1 1" '
    'armature="0.3" damping="0.4" frictionloss="0.5"/></body></body></worldbody></mujoco>'
)


@pytest.mark.parametrize("form", ["urdf", "mjcf"])
def test_bodies_of_an_mjcf_are_written_without_shapes(
    tmp_path: Path, form: str
) -> None:
    (tmp_path / "robot.xml").write_text(MJCF)
    arm = CorrectedArm(load_nominal_arm(tmp_path / "robot.xml"), BODIES[:1])
    out = tmp_path / "out.xml"
    missing, _ = export(arm, form, out)
    assert any("URDF files alone" in line for line in missing)
    assert_in_file(arm, out)
    again = load_nominal_arm(out)
    assert (*again.viscous, *again.coulomb) == pytest.approx((0.4, 0.5))


ENERGY = AppliedEffect("viscous_friction", (2,), {"coefficient": [-3.0]})
WEIGHTLESS = AppliedEffect("payload", (), {"mass": -40.0, "com": [0.0, 0.0, 0.0]})


@pytest.mark.parametrize(
    ("form", "effects", "message"),
    [
        ("mjc", (), "did you mean 'mjcf'"),
        ("urdf", (ENERGY,), "feed energy in"),
        ("sdf", (WEIGHTLESS,), "payload"),
    ],
)
def test_what_cannot_be_is_refused(
    tmp_path: Path, form: str, effects: tuple, message: str
) -> None:
    with pytest.raises(InputError, match=message):
        exported(iiwa(*effects), form, tmp_path)
    assert not list(tmp_path.iterdir())


SEAL = replace(
    COULOMB,
    name="seal_drag",
    parameters=(Parameter("drag", "s", "N m", (0.0, 10.0), (0.1, 1.0)),),
    quantities={"drag": "friction"},
    parametrisation=None,
    severity=None,
)
"""The effect of a user."""


@pytest.mark.parametrize("says", [True, False], ids=["friction", "nothing"])
@pytest.mark.parametrize("form", [*FORMATS, "isaac_lab", "gazebo"])
def test_an_own_effect_is_held_by_its_quantities_or_left_out(
    tmp_path: Path, form: str, says: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    record = SEAL if says else replace(SEAL, quantities={})
    monkeypatch.setitem(CATALOGUE, SEAL.name, record)
    arm = iiwa(AppliedEffect("seal_drag", (2,), {"drag": [0.625]}))
    file, missing = exported(arm, form, tmp_path)
    assert any(line.startswith("seal_drag, joint 2") for line in missing) != says
    assert ("0.625" in file.read_text().replace("drag 0.625", "")) == says
