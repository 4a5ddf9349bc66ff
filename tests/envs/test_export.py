"""An exported arm, loaded again by other simulators, needs the torque that the corrected arm needs."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.motions.motion import Motion
from gapscope.arm.nominal import NominalArm
from gapscope.arm.robots import load_nominal_arm
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.arm_scale import ArmScale
from gapscope.effects.catalogue import CATALOGUE, register, remove
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.friction import COULOMB
from gapscope.effects.parameter import Parameter
from gapscope.effects.severity import draw
from gapscope.envs.engines import installed
from gapscope.envs.export.formats import export
from gapscope.envs.export.plain_arm import FORMATS, HELD, holds

BODIES = (
    AppliedEffect("payload", (), {"mass": 1.3, "com": [0.02, -0.01, 0.05]}),
    AppliedEffect(
        "link_inertia", (), {"link": 2, "mass": 0.4, "com": [0.01, 0.02, -0.01]}
    ),
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
HARD = (
    AppliedEffect("load_friction", (2,), {"coefficient": [0.1]}),
    AppliedEffect(
        "friction_drift", (4,), {"amplitude": [0.5], "time_constant": [60.0]}
    ),
    AppliedEffect("encoder_quantization", (3,), {"step": [0.002]}),
)
ROBOTS = ("kuka_iiwa", "franka_panda")
Torque = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]


def states(arm: CorrectedArm, seed: int = 0, count: int = 6) -> Motion:
    """Random states within the limits, as a motion whose samples have nothing to do with each other."""
    rng, n = np.random.default_rng(seed), arm.arm.n_joints
    low, high = RigidBody(arm.arm).position_limits()
    q = rng.uniform(np.clip(0.9 * low, -2, 2), np.clip(0.9 * high, -2, 2), (count, n))
    return Motion(
        np.arange(count) / 250,
        q,
        rng.normal(size=(count, n)),
        3 * rng.normal(size=(count, n)),
    )


def each(motion: Motion, torque: Torque) -> np.ndarray:
    return np.array(
        [torque(*state) for state in zip(motion.q, motion.dq, motion.ddq, strict=True)]
    )


def needed(arm: CorrectedArm, motion: Motion) -> np.ndarray:
    return arm.needed_torque(arm.rigid_torque(RigidBody(arm.arm), motion), motion)


def random_effects(rng: np.random.Generator, n: int) -> tuple[AppliedEffect, ...]:
    """Changes of the bodies, of any size that a body can have."""
    return (
        AppliedEffect(
            "payload", (), {"mass": rng.uniform(0, 5), "com": rng.uniform(-0.2, 0.2, 3)}
        ),
        *(
            AppliedEffect(
                "link_inertia",
                (),
                {
                    "link": j + 1,
                    "mass": rng.uniform(-0.4, 1),
                    "com": rng.uniform(-0.05, 0.05, 3),
                },
            )
            for j in range(n)
        ),
        AppliedEffect(
            "base_tilt", (), {"roll": rng.uniform(-1, 1), "pitch": rng.uniform(-1, 1)}
        ),
    )


def exported(
    arm: CorrectedArm, form: str, folder: Path, **options: object
) -> tuple[Path, tuple[str, ...]]:
    """The file of an arm, and what it leaves out."""
    out = folder / f"arm.{form}"
    missing, _ = export(arm, form, out, **options)
    return out, missing


def iiwa(*effects: AppliedEffect, **options: object) -> CorrectedArm:
    return CorrectedArm(load_nominal_arm("kuka_iiwa", **options), effects)


def in_pinocchio(file: Path, motion: Motion, **options: object) -> np.ndarray:
    """Inverse dynamics of the arm of a file."""
    body = RigidBody(load_nominal_arm(file, **options))
    return body.inverse_dynamics(motion.q, motion.dq, motion.ddq)


@pytest.fixture(params=ROBOTS)
def nominal(request: pytest.FixtureRequest) -> NominalArm:
    return load_nominal_arm(request.param)


@pytest.fixture
def bullet() -> Iterator[object]:
    import pybullet

    client = pybullet.connect(pybullet.DIRECT)
    pybullet.setGravity(0, 0, -9.81)
    yield pybullet
    pybullet.disconnect(client)


class TestTorque:
    @pytest.mark.parametrize("seed", range(3))
    def test_of_urdf_in_pinocchio(
        self, nominal: NominalArm, tmp_path: Path, seed: int
    ) -> None:
        effects = random_effects(np.random.default_rng(seed), nominal.n_joints)
        arm = CorrectedArm(nominal, effects)
        file, _ = exported(arm, "urdf", tmp_path)
        motion = states(arm, seed)
        want = arm.rigid_torque(RigidBody(nominal), motion)
        got = in_pinocchio(file, motion, joints=nominal.joints)
        assert got == pytest.approx(want, rel=1e-9)

    def test_of_urdf_in_pybullet(
        self, nominal: NominalArm, bullet, tmp_path: Path
    ) -> None:
        arm = CorrectedArm(nominal, BODIES)
        export(arm, "urdf", tmp_path / "arm.urdf")
        flags = bullet.URDF_USE_INERTIA_FROM_FILE
        robot = bullet.loadURDF(
            str(tmp_path / "arm.urdf"), useFixedBase=True, flags=flags
        )

        def torque(*state: np.ndarray) -> np.ndarray:
            return np.array(
                bullet.calculateInverseDynamics(robot, *(x.tolist() for x in state))
            )

        motion = states(arm)
        want = arm.rigid_torque(RigidBody(nominal), motion)
        assert each(motion, torque) == pytest.approx(want, rel=1e-6, abs=1e-6)

    @pytest.mark.skipif(not installed("mujoco"), reason="mujoco is not installed")
    def test_of_mjcf_in_mujoco_with_rotors_friction_and_springs(
        self, nominal: NominalArm, tmp_path: Path
    ) -> None:
        import mujoco

        arm = CorrectedArm(nominal, BODIES + DRIVES + OFF)
        missing, _ = export(arm, "mjcf", tmp_path / "arm.xml")
        assert missing == ("velocity limits of the joints: MuJoCo knows none",)
        model = mujoco.MjModel.from_xml_path(str(tmp_path / "arm.xml"))
        dry = model.dof_frictionloss.copy()
        off = (
            mujoco.mjtDisableBit.mjDSBL_CONTACT
            | mujoco.mjtDisableBit.mjDSBL_FRICTIONLOSS
        )
        model.opt.disableflags |= off
        data = mujoco.MjData(model)

        def torque(*state: np.ndarray) -> np.ndarray:
            data.qpos[:], data.qvel[:], data.qacc[:] = state
            mujoco.mj_inverse(model, data)
            return data.qfrc_inverse.copy()

        motion = states(arm)
        got = each(motion, torque) + dry * np.tanh(motion.dq / 0.005)
        assert got == pytest.approx(needed(arm, motion), rel=1e-6, abs=1e-9)

    def test_of_sdf_in_dart(self, tmp_path: Path) -> None:
        dartpy = pytest.importorskip("dartpy")

        arm = iiwa(*BODIES, *OFF)
        export(arm, "sdf", tmp_path / "arm.sdf")
        text = ET.parse(tmp_path / "arm.sdf")
        for link in text.getroot().iter("link"):  # DART is slow at shapes
            for shape in (*link.findall("visual"), *link.findall("collision")):
                link.remove(shape)
        text.write(tmp_path / "arm.sdf")
        skeleton = dartpy.utils.SdfParser.readSkeleton(str(tmp_path / "arm.sdf"))
        skeleton.setGravity(np.array([0, 0, -9.81]))

        def torque(*state: np.ndarray) -> np.ndarray:
            for setter, value in zip(
                ("Positions", "Velocities", "Accelerations"), state, strict=True
            ):
                getattr(skeleton, f"set{setter}")(value)
            skeleton.computeInverseDynamics()
            return skeleton.getForces().copy()

        motion = states(arm)
        assert each(motion, torque) == pytest.approx(
            arm.rigid_torque(RigidBody(arm.arm), motion), rel=1e-6, abs=1e-9
        )

    @pytest.mark.parametrize(
        ("effects", "gravity"), [(OFF, (0.0, 0.0, -9.81)), (BODIES, (0.0, -9.81, 0.0))]
    )
    def test_at_what_encoders_read_and_as_gravity_of_the_case_says(
        self, tmp_path: Path, effects: tuple, gravity: tuple
    ) -> None:
        """With its encoders off, and on a wall."""
        arm = iiwa(*effects, gravity=list(gravity))
        file, _ = exported(arm, "urdf", tmp_path)
        motion, nominal = states(arm), RigidBody(arm.arm)
        want = arm.rigid_torque(nominal, motion)
        assert in_pinocchio(file, motion) == pytest.approx(want, rel=1e-9)
        low, high = nominal.position_limits()
        shift = arm.quantity("zero")
        limits = np.array(RigidBody(load_nominal_arm(file)).position_limits())
        assert limits == pytest.approx(np.array([low + shift, high + shift]))

    def test_of_a_link_that_takes_over_what_is_fixed_to_it(
        self, tmp_path: Path
    ) -> None:
        """3 kg less than the flange weighs alone, but its hand is heavier still."""
        (tmp_path / "robot.urdf").write_text(
            '<robot name="r"><link name="base"/><joint name="j" type="revolute"><parent link="base"/><child link="l"/>'
            '<axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="9" velocity="3"/></joint><link name="l"><inertial>'
            '<mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
            '<joint name="f" type="fixed"><parent link="l"/><child link="hand"/><origin xyz="0.5 0 0"/></joint>'
            '<link name="hand"><inertial><mass value="9"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
            "</inertial></link></robot>"
        )
        lighter = AppliedEffect(
            "link_inertia", (), {"link": 1, "mass": -3.0, "com": [0.0, 0.0, 0.1]}
        )
        arm = CorrectedArm(load_nominal_arm(tmp_path / "robot.urdf"), (lighter,))
        file, _ = exported(arm, "urdf", tmp_path)
        mass = RigidBody(load_nominal_arm(file)).inertial_parameters()[0]
        assert mass == pytest.approx(7.0)
        motion = states(arm)
        want = arm.rigid_torque(RigidBody(arm.arm), motion)
        assert in_pinocchio(file, motion) == pytest.approx(want, rel=1e-9)


class TestJoints:
    def test_friction_and_limits_in_urdf(self, tmp_path: Path) -> None:
        arm = iiwa(*DRIVES)
        file, _ = exported(arm, "urdf", tmp_path)
        again = load_nominal_arm(file)
        assert again.viscous == pytest.approx(arm.quantity("damping"))
        assert again.coulomb == pytest.approx([0, 4, 0, 0, 0, 0, 0])
        body, nominal = RigidBody(again), RigidBody(arm.arm)
        effort = np.where(np.arange(7) == 3, 20.0, nominal.effort_limits())
        assert body.effort_limits() == pytest.approx(effort)
        for limits in ("position_limits", "velocity_limits"):
            got, want = (np.array(getattr(x, limits)()) for x in (body, nominal))
            assert got == pytest.approx(want)

    def test_friction_spring_and_limits_in_sdf(self, tmp_path: Path) -> None:
        arm = iiwa(*DRIVES)
        export(arm, "sdf", tmp_path / "arm.sdf")
        root = ET.parse(tmp_path / "arm.sdf").getroot()
        joints = {joint.get("name"): joint for joint in root.iter("joint")}
        said = {
            x.tag: float(x.text)
            for x in joints[arm.arm.joints[1]].find("axis/dynamics")
        }
        assert said == {
            "damping": 0.5,
            "friction": 4.0,
            "spring_reference": 0.3,
            "spring_stiffness": 12.0,
        }
        limit = {
            x.tag: float(x.text) for x in joints[arm.arm.joints[3]].find("axis/limit")
        }
        assert limit == pytest.approx(
            {"lower": -2.0943951, "upper": 2.0943951, "effort": 20.0, "velocity": 10.0}
        )

    def test_joints_that_are_not_the_arms_are_fixed(self, tmp_path: Path) -> None:
        missing, _ = export(
            CorrectedArm(load_nominal_arm("franka_panda")),
            "urdf",
            tmp_path / "arm.urdf",
        )
        assert (
            len(missing) == 1
            and "panda_finger_joint1, panda_finger_joint2" in missing[0]
        )
        assert load_nominal_arm(tmp_path / "arm.urdf").n_joints == 7


class TestShapes:
    @pytest.mark.parametrize("form", FORMATS)
    @pytest.mark.parametrize("relative", [False, True])
    def test_meshes_are_found_from_the_new_place(
        self, tmp_path: Path, form: str, relative: bool
    ) -> None:
        out = tmp_path / "deep" / "arm.xml"
        export(
            CorrectedArm(load_nominal_arm("franka_panda")), form, out, relative=relative
        )
        root = ET.parse(out).getroot()
        names = [
            x.get("filename") or x.get("file")
            for x in root.iter("mesh")
            if x.get("filename") or x.get("file")
        ]
        names += [uri.text for uri in root.iter("uri")]
        assert len(names) > 8
        for name in names:
            assert (
                Path(name).is_absolute() != relative and (out.parent / name).is_file()
            )

    def test_a_urdf_without_its_meshes_is_read_by_pybullet(
        self, tmp_path: Path
    ) -> None:
        """A recorded case has the URDF alone: shapes without a mesh are left out, those of packages keep their name."""
        pybullet = pytest.importorskip("pybullet")
        pytest.importorskip("pybullet_data", reason="the iiwa's meshes are there")
        text = load_nominal_arm("kuka_iiwa").urdf.read_text()
        text = text.replace("meshes/link_3.stl", "package://iiwa/link_3.stl")
        (tmp_path / "robot.urdf").write_text(text)
        out = tmp_path / "arm.urdf"
        arm = CorrectedArm(load_nominal_arm(tmp_path / "robot.urdf"))
        missing, _ = export(arm, "urdf", out)
        names = {x.get("filename") for x in ET.parse(out).getroot().iter("mesh")}
        assert names == {"package://iiwa/link_3.stl"}
        said = "\n".join(missing)
        assert "link_3.stl is not found, its name is kept" in said
        assert "link_4.stl is not found" in said
        (tmp_path / "robot.urdf").write_text(
            load_nominal_arm("kuka_iiwa").urdf.read_text()
        )
        export(CorrectedArm(load_nominal_arm(tmp_path / "robot.urdf")), "urdf", out)
        client = pybullet.connect(pybullet.DIRECT)
        try:
            body = pybullet.loadURDF(str(out), physicsClientId=client)
            assert pybullet.getNumJoints(body, physicsClientId=client) >= 7
        finally:
            pybullet.disconnect(client)


class TestLeftOut:
    @pytest.mark.parametrize("form", FORMATS)
    def test_is_told_and_written_with_figures(self, tmp_path: Path, form: str) -> None:
        out = tmp_path / "arm.xml"
        missing, _ = export(iiwa(*DRIVES, *HARD), form, out)
        text = out.read_text(encoding="utf-8")
        said = "\n".join(missing)
        for part in (
            "nearest: Coulomb friction higher by",
            "friction_drift, joint 4: amplitude 0.5; time_constant 60 s",
            "encoder_quantization, joint 3: step 0.002 rad",
        ):
            assert part in said
        assert ("armature" in said) == (form != "mjcf") and (
            "parallel_spring" in said
        ) == (form == "urdf")
        assert all(line in text for line in missing)

    @pytest.mark.parametrize("form", FORMATS)
    @pytest.mark.parametrize("name", CATALOGUE)
    def test_every_effect_is_held_or_told(
        self, data_sheet_arm: NominalArm, tmp_path: Path, form: str, name: str
    ) -> None:
        scale = ArmScale.of(data_sheet_arm)
        effect = draw(name, np.random.default_rng(0), scale, (1,))
        _, missing = exported(CorrectedArm(data_sheet_arm, (effect,)), form, tmp_path)
        told = any(line.startswith(name) for line in missing)
        assert told != holds(HELD[form], CATALOGUE[name])


class TestMjcfSource:
    MJCF = (
        '<mujoco model="m"><compiler angle="radian" autolimits="true"/><worldbody><body name="base"><body name="l">'
        '<inertial pos="0.3 0 0.1" mass="2" diaginertia="0.1 0.2 0.25"/><joint name="j" axis="0 1 0" range="-1 1" '
        'armature="0.3" damping="0.4" frictionloss="0.5"/></body></body></worldbody></mujoco>'
    )

    @pytest.mark.parametrize("form", ["urdf", "mjcf"])
    def test_bodies_are_written_without_shapes(self, tmp_path: Path, form: str) -> None:
        (tmp_path / "robot.xml").write_text(self.MJCF)
        arm = CorrectedArm(load_nominal_arm(tmp_path / "robot.xml"), BODIES[:1])
        out = tmp_path / "out.xml"
        missing, _ = export(arm, form, out)
        assert any("URDF files alone" in line for line in missing)
        again, motion = load_nominal_arm(out), states(arm)
        want = arm.rigid_torque(RigidBody(arm.arm), motion)
        assert in_pinocchio(out, motion) == pytest.approx(want, rel=1e-9)
        assert again.viscous == pytest.approx([0.4]) and again.coulomb == pytest.approx(
            [0.5]
        )


@pytest.mark.parametrize(
    ("form", "effects", "message"),
    [
        ("mjc", (), "did you mean 'mjcf'"),
        (
            "urdf",
            (AppliedEffect("viscous_friction", (2,), {"coefficient": [-3.0]}),),
            "feed energy in",
        ),
        (
            "sdf",
            (AppliedEffect("payload", (), {"mass": -40.0, "com": [0.0, 0.0, 0.0]}),),
            "payload",
        ),
    ],
)
def test_what_cannot_be_is_refused(
    tmp_path: Path, form: str, effects: tuple, message: str
) -> None:
    with pytest.raises(InputError, match=message):
        exported(iiwa(*effects), form, tmp_path)
    assert not list(tmp_path.iterdir())


class TestOwnEffect:
    """A user's own effect is exported by the quantities that its record says; without any it is left out."""

    SEAL = replace(
        COULOMB,
        name="seal_drag",
        parameters=(Parameter("drag", "s", "N m", (0.0, 10.0), (0.1, 1.0)),),
        quantities={"drag": "friction"},
        parametrisation=None,
        severity=None,
    )

    @pytest.fixture(params=["friction", "nothing"])
    def said(self, request: pytest.FixtureRequest) -> Iterator[bool]:
        says = request.param == "friction"
        register(self.SEAL if says else replace(self.SEAL, quantities={}))
        yield says
        remove(self.SEAL.name)

    @pytest.mark.parametrize("form", [*FORMATS, "isaac_lab", "gazebo"])
    def test_is_held_by_its_quantities(
        self, tmp_path: Path, form: str, said: bool
    ) -> None:
        effect = AppliedEffect("seal_drag", (2,), {"drag": [0.625]})
        arm = iiwa(effect)
        missing, _ = export(arm, form, tmp_path / "arm.out")
        assert any(line.startswith("seal_drag, joint 2") for line in missing) != said
        written = (tmp_path / "arm.out").read_text().replace("drag 0.625", "")
        assert ("0.625" in written) == said
