"""The corrected arm: how effects compose, whatever their order in the file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from arms import iiwa_of_three

import gapscope
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError, ModelWarning
from gapscope.arm.motions.motion import Motion
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.arm_scale import ArmScale
from gapscope.effects.catalogue import CATALOGUE, COUPLED_MOTORS
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.corrected_file import (
    read_corrected,
    read_corrected_arm,
    write_corrected,
)
from gapscope.effects.severity import draw

COULOMB = AppliedEffect("coulomb_friction", (2,), {"torque": [3.0]})
VISCOUS = AppliedEffect("viscous_friction", (2,), {"coefficient": [2.0]})
LOAD = AppliedEffect("load_friction", (2,), {"coefficient": [0.2]})
ARMATURE = AppliedEffect("armature", (2,), {"inertia": [0.5]})
OFFSET = AppliedEffect("torque_offset", (2,), {"torque": [2.0]})
SCALE = AppliedEffect("torque_scale", (2,), {"scale": [0.25]})
DELAY = AppliedEffect("actuator_delay", (2,), {"delay": [0.02]})
ENCODER = AppliedEffect("encoder_offset", (1, 2), {"offset": [0.1, -0.3]})
PAYLOAD = AppliedEffect("payload", (), {"mass": 1.2, "com": [0.3, 0.1, 0.0]})


def by_pinocchio(
    model: pin.Model, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray
) -> np.ndarray:
    data, rows = model.createData(), zip(q, dq, ddq, strict=True)
    return np.array([pin.rnea(model, data, *row) for row in rows])


def test_nominal_arm_is_rigid_body_and_data_sheet(
    two: NominalArm, body: RigidBody, motion: Motion
) -> None:
    """Against pinocchio, with armature 0.3 and 0.1, Coulomb 1 and 0.5, viscous 0.8 and 0.4 added by hand."""
    model, dq, ddq = pin.buildModelFromUrdf(str(two.urdf)), motion.dq, motion.ddq
    expected = by_pinocchio(model, motion.q, dq, ddq) + [0.3, 0.1] * ddq
    expected += [1.0, 0.5] * np.tanh(dq / 0.005) + [0.8, 0.4] * dq
    found = CorrectedArm(two).predict(body, motion)
    np.testing.assert_allclose(found, expected, atol=1e-9)


def test_the_whole_way_to_the_joint(two: NominalArm, motion: Motion) -> None:
    """recorded(t) = (needed(t + T) - offset) / (1 + s)."""
    needed = np.column_stack([np.cos(2 * motion.t), np.sin(5 * motion.t)])
    arm = CorrectedArm(two, (DELAY, OFFSET, SCALE))
    recorded = arm.recorded_torque(needed, motion)
    expected = (np.sin(5 * (motion.t + 0.02)) - 2.0) / 1.25
    np.testing.assert_allclose(recorded[:490, 1], expected[:490], atol=1e-6)
    np.testing.assert_array_equal(recorded[:, 0], needed[:, 0])


def test_load_friction_acts_on_the_whole_motor_torque(two: NominalArm) -> None:
    """rigid 10 + Coulomb 0.5 + 3, viscous (0.4 + 2) v with v = 1, rotor (0.1 + 0.5) 2: 17.1, over 1 - 0.2."""
    arm, one = CorrectedArm(two, (COULOMB, VISCOUS, ARMATURE, LOAD)), np.ones((11, 2))
    there, back = (
        arm.needed_torque(10 * one, Motion(np.arange(11) / 10, one, v * one, 2 * one))
        for v in (1.0, -1.0)
    )
    np.testing.assert_allclose(there[:, 1], 17.1 / 0.8)
    np.testing.assert_allclose(back[:, 1], (10 + 1.2 - 3.5 - 2.4) / 1.2)


def test_payload_hangs_where_the_arm_truly_is(
    two: NominalArm, body: RigidBody, motion: Motion
) -> None:
    model = pin.buildModelFromUrdf(str(two.urdf))
    load = pin.Inertia(1.2, np.array([0.3, 0.1, 0.0]), np.zeros((3, 3)))
    model.appendBodyToJoint(2, load, pin.SE3.Identity())
    true = motion.q - [0.1, -0.3]
    expected = by_pinocchio(model, true, motion.dq, motion.ddq)
    found = CorrectedArm(two, (ENCODER, PAYLOAD)).rigid_torque(body, motion)
    np.testing.assert_allclose(found, expected, atol=1e-9)


def test_all_effects_in_any_order_predict_the_same(
    two: NominalArm, body: RigidBody, motion: Motion
) -> None:
    effects = (COULOMB, VISCOUS, LOAD, ARMATURE, OFFSET, SCALE, DELAY, ENCODER, PAYLOAD)
    expected = CorrectedArm(two, effects).predict(body, motion)
    rng = np.random.default_rng(0)
    orders = [effects[::-1], *(rng.permutation(effects) for _ in range(4))]
    for order in orders:
        found = CorrectedArm(two, tuple(order)).predict(body, motion)
        np.testing.assert_allclose(found, expected, atol=1e-9)


SPRING = {"stiffness": [2000.0], "damping": [5.0]}
ELASTIC = AppliedEffect("joint_elasticity", (2,), SPRING)
PLAY = AppliedEffect("backlash", (2,), {"width": [0.01]})


def test_encoders_on_the_joints_see_the_links_themselves(
    two: NominalArm, body: RigidBody, motion: Motion
) -> None:
    """The bodies' torque is rigid; only the motor, with its rotor and friction, moves otherwise."""
    outside = replace(two, encoder="joint")
    plain, bent = (CorrectedArm(outside, e) for e in ((), (ELASTIC, PLAY)))
    rigid = body.inverse_dynamics(motion.q, motion.dq, motion.ddq)
    np.testing.assert_allclose(bent.rigid_torque(body, motion), rigid, atol=1e-9)
    added = bent.needed_torque(rigid, motion) - plain.needed_torque(rigid, motion)
    np.testing.assert_allclose(added[:, 0], 0, atol=1e-9)
    assert np.abs(added)[:, 1].max() > 1e-3


def test_effects_that_add_may_occur_twice_and_no_others(
    two: NominalArm, body: RigidBody, motion: Motion
) -> None:
    """Two limits on one joint are no limit of their sum, two tilts no tilt of either."""
    half = AppliedEffect("payload", (), {"mass": 0.6, "com": [0.3, 0.1, 0.0]})
    arms = [CorrectedArm(two, effects) for effects in ((half, half), (PAYLOAD,))]
    for arm in arms:
        arm.check()
    np.testing.assert_allclose(*(arm.predict(body, motion) for arm in arms), rtol=1e-9)
    limit = AppliedEffect("torque_saturation", (2,), {"limit": [10.0]})
    tilt = AppliedEffect("base_tilt", (), {"roll": 0.01, "pitch": 0.0})
    for once in (limit, tilt):
        with pytest.raises(InputError, match="occurs twice") as caught:
            CorrectedArm(two, (COULOMB, once, once)).check()
        assert caught.value.where == once.name


def test_what_bodies_lack_adds_its_own_torque_and_need_not_be_possible(
    two: NominalArm, body: RigidBody, motion: Motion
) -> None:
    """Minus three kilograms on the second link: as the regressor has it, whatever the arm carries."""
    remainder = np.zeros((2, 10))
    remainder[1, :2] = -3.0, 0.3
    plain = CorrectedArm(two, (PAYLOAD,))
    lacking = replace(plain, remainder=remainder)
    lacking.check()
    added = lacking.predict(body, motion) - plain.predict(body, motion)
    own = body.regressor(motion.q, motion.dq, motion.ddq) @ remainder.ravel()
    assert added == pytest.approx(own, abs=1e-9)


# Effects that an arm has in some recordings, or spans of them: the file says where, and torque follows.


COMMON = "{effect: coulomb_friction, joints: [2], parameters: {torque: [4.0]}}"
CARRIED = "{effect: payload, parameters: {mass: %s, com: [0, 0, 0.1]}, %s}"
FILE = f"""schema: 1
case: tools
effects:
  - {COMMON}
  - {CARRIED % (2.0, "recordings: [a.csv]")}
  - {CARRIED % (1.0, "recordings: [b.csv], from: 3.0")}
recordings: [a.csv, b.csv]
"""
T = np.arange(0.0, 6.0, 0.01)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "corrected.yaml"
    path.write_text(FILE, encoding="utf-8")
    return path


def masses(corrected: CorrectedArm, name: str) -> list[tuple[float, float]]:
    """Mass of the load in each span of a recording, and since when."""
    out = []
    for inside, arm in corrected.spans(name, T):
        loads = [e.parameters["mass"] for e in arm.effects if e.name == "payload"]
        out.append((float(T[inside][0]), float(sum(loads))))
    return out


def test_each_recording_has_its_state_and_an_unknown_one_the_last(file: Path) -> None:
    corrected = read_corrected_arm(iiwa_of_three(), file)
    # what takes no recording, a simulator, has the last state
    assert [e.name for e in read_corrected(file)] == ["coulomb_friction", "payload"]
    other = file.with_name("other.yaml")
    write_corrected("tools", corrected.effects, other, states=corrected.states)
    assert other.read_text(encoding="utf-8").count("coulomb_friction") == 1
    for each in (corrected, read_corrected_arm(iiwa_of_three(), other)):
        assert masses(each, "a.csv") == [(0.0, 2.0)]
        assert masses(each, "b.csv") == [(0.0, 0.0), (3.0, 1.0)]
        assert masses(each, "c.csv") == [(0.0, 1.0)]


def test_predicted_torque_has_the_load_where_it_is(file: Path) -> None:
    arm, q = iiwa_of_three(), 0.5 * np.sin(np.outer(T, [1.0, 0.8, 1.3]))
    b, c = (Recording(name, T, q) for name in ("b.csv", "c.csv"))
    with pytest.warns(ModelWarning, match=r"c\.csv: its state is not known"):
        last = gapscope.predict(arm, c, file).tau
    common = read_corrected_arm(arm, file).effects[:1]
    without = gapscope.predict(arm, b, common).tau
    found, before = gapscope.predict(arm, b, file).tau, T < 3.0
    assert found[before] == pytest.approx(without[before])
    assert found[~before] == pytest.approx(last[~before])
    assert np.abs(last - without).max() > 0.5


# Rotor and friction of a motor that turns two joints: by hand, through the file, and refused without a coupling.


EFFECTS = (
    AppliedEffect("coupled_coulomb_friction", (2,), {"torque": [1.5]}),
    AppliedEffect("coupled_viscous_friction", (2,), {"coefficient": [0.7]}),
    AppliedEffect("coupled_armature", (2,), {"inertia": [0.2]}),
)


@pytest.fixture
def coupled(two: NominalArm) -> NominalArm:
    """Motor 2 turns half backwards with joint 1."""
    return replace(two, coupling=np.array([[1.0, 0.0], [-0.5, 1.0]]))


@pytest.fixture
def moved() -> Motion:
    rng = np.random.default_rng(4)
    q, dq, ddq = rng.uniform(-1.0, 1.0, (3, 50, 2))
    return Motion(np.arange(50) / 100, q, dq, ddq)


def test_torque_of_a_coupled_motor(coupled: NominalArm, moved: Motion) -> None:
    """w = dq2 - dq1 / 2; f = 1.5 sgn w + 0.7 w + 0.2 dw/dt acts on joint 2, and -f / 2 on joint 1."""
    body = RigidBody(coupled)
    without = CorrectedArm(coupled).predict(body, moved)
    added = CorrectedArm(coupled, EFFECTS).predict(body, moved) - without
    w, a = (x[:, 1] - 0.5 * x[:, 0] for x in (moved.dq, moved.ddq))
    f = 1.5 * np.tanh(w / 0.005) + 0.7 * w + 0.2 * a
    np.testing.assert_allclose(added, np.column_stack([-0.5 * f, f]), atol=1e-9)
    # any friction takes power
    for name in ("coupled_stribeck_friction", "coupled_saturating_friction"):
        dry = AppliedEffect(name, (2,), {"torque": [1.0], "velocity": [0.3]})
        added = CorrectedArm(coupled, (dry,)).predict(body, moved) - without
        assert ((added * moved.dq).sum(axis=1) > 0).all()


@pytest.mark.parametrize("name", COUPLED_MOTORS)
def test_refused_on_a_motor_that_turns_one_joint(
    two: NominalArm, coupled: NominalArm, name: str
) -> None:
    values = {p: [1.0] for p in COUPLED_MOTORS[name].names}
    for arm, motor in ((two, 2), (coupled, 1)):
        with pytest.raises(InputError, match="coupling"):
            CorrectedArm(arm, (AppliedEffect(name, (motor,), values),)).check()


# Corrected arms stay passive: friction takes power, bodies have kinetic energy, and what would not is refused.


FRICTION = [name for name, each in CATALOGUE.items() if each.family == "friction"]
SHEETS = {
    "coulomb_friction": ("torque", "coulomb"),
    "viscous_friction": ("coefficient", "viscous"),
    "armature": ("inertia", "armature"),
}
"""Parameters that add to values of the data sheet."""


def friction_power(corrected: CorrectedArm, rng: np.random.Generator) -> np.ndarray:
    """What the friction of the corrected arm takes on each joint in random states under any load [W], (N, 2)."""
    q, dq, ddq, load = rng.standard_normal((4, 200, 2))
    motion, load = Motion(np.arange(200) / 100.0, q, 0.5 * dq, 3.0 * ddq), 30.0 * load
    kept = [e for e in corrected.effects if e.effect.family != "friction"]
    smooth = replace(corrected.arm, coulomb=np.zeros(2), viscous=np.zeros(2))
    without = CorrectedArm(smooth, tuple(kept)).needed_torque(load, motion)
    return motion.dq * (corrected.needed_torque(load, motion) - without)


@pytest.mark.parametrize("name", CATALOGUE)
def test_every_effect_leaves_the_arm_passive(name: str, two: NominalArm) -> None:
    """With values as drawn for simulated arms: friction takes power, and the mass matrix is positive definite."""
    rng, body = np.random.default_rng(3), RigidBody(two)
    scale = ArmScale.of(two)
    for _ in range(5):
        corrected = CorrectedArm(two, (draw(name, rng, scale),))
        corrected.check()
        assert (friction_power(corrected, rng) >= -1e-9).all()
        rotors = two.armature + corrected.value("armature", "inertia")
        assert (rotors >= 0).all()
        bodies = corrected.body(body)
        for q in rng.uniform(-3.0, 3.0, (10, 2)):
            assert np.linalg.eigvalsh(bodies.mass_matrix(q))[0] > 0


def test_all_friction_together_at_the_edge_takes_power(two: NominalArm) -> None:
    """Nothing is left of the data sheet's friction, which fades by 95 % as well."""
    edge: dict[str, dict[str, Any]] = {
        "coulomb_friction": {"torque": -two.coulomb},
        "viscous_friction": {"coefficient": -two.viscous},
        "load_friction": {"coefficient": [0.3, 0.8]},
        "stribeck_friction": {"torque": 5.0, "velocity": 0.02},
        "saturating_friction": {"torque": 5.0, "velocity": 0.05},
        "friction_drift": {"amplitude": -0.95, "time_constant": 5.0},
    }
    assert set(edge) == set(FRICTION)
    effects = [AppliedEffect(name, (1, 2), values) for name, values in edge.items()]
    corrected = CorrectedArm(two, tuple(effects))
    corrected.check()
    power = friction_power(corrected, np.random.default_rng(4))
    assert (power >= -1e-9).all() and power.max() > 0.1


@pytest.mark.parametrize("name", SHEETS)
def test_what_is_negative_in_total_is_refused(name: str, two: NominalArm) -> None:
    parameter, stated = SHEETS[name]
    nominal = getattr(two, stated)[1]
    rest = AppliedEffect(name, (2,), {parameter: -nominal})
    CorrectedArm(two, (rest,)).check()
    beyond = AppliedEffect(name, (2,), {parameter: -1.01 * nominal})
    with pytest.raises(InputError, match=f"{name}.*joint 2, which would feed energy"):
        CorrectedArm(two, (beyond,)).check()


@pytest.mark.parametrize(
    ("mass", "com", "expected"),
    [
        (3.0, (0.9, 0.9, 0.0), False),
        (-0.5, (0.5, 0.0, 0.0), False),
        (-1.5, (0.9, 0.0, 0.0), True),
        (-0.5, (0.5, 0.0, 1.0), True),
    ],
)
def test_a_load_that_takes_more_inertia_than_there_is_feeds_energy(
    mass: float, com: tuple[float, ...], expected: bool, two: NominalArm
) -> None:
    """The last link: 2 kg at 0.5 m, 0.55 kg m^2 about its axis. 1.5 kg at 0.9 m would take 1.2 kg m^2."""
    load = AppliedEffect("payload", (), {"mass": np.array(mass), "com": np.array(com)})
    assert CorrectedArm(two, (load,)).feeds_energy(RigidBody(two)) is expected
