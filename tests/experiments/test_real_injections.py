"""Effects put into recordings: against values worked out by hand for a pendulum about z, gravity along -y."""

import importlib
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from arms import ROD, chain

from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording

sys.path.insert(0, str(Path(__file__).parents[2] / "experiments"))
laws, injections = (
    importlib.import_module(name) for name in ("real_laws", "real_cases")
)
ONE = np.array([0])


@pytest.fixture
def arm(tmp_path) -> NominalArm:
    """2 kg at 0.5 m: 10 N m where it is level under 10 m/s^2."""
    bob = ROD._replace(
        axis="0 0 1",
        inertia="0.01 0.01 0.01",
        limit="-3 3 9 3",
        kind="revolute",
    )
    return chain(tmp_path, "pendulum", bob, gravity=[0.0, -10.0, 0.0])


def scene_of(arm, q, tau, rate=100.0):
    t = np.arange(len(q)) / rate
    recording = Recording("r", t, np.reshape(q, (-1, 1)), np.reshape(tau, (-1, 1)))
    return laws.Scene(recording, arm, arm, np.ones(1))


def ramp(arm, speed=1.0, tau=0.0, seconds=4.0):
    """A joint that turns at a constant speed under a constant torque."""
    t = np.arange(int(100 * seconds)) / 100
    return scene_of(arm, speed * t, np.full(len(t), float(tau)))


def swing(arm):
    """The pendulum swings by 1 rad at 0.5 Hz; recorded is m g l cos q + (I + m l^2) ddq."""
    t = np.arange(1000) / 100
    q, bend = np.sin(np.pi * t), -(np.pi**2) * np.sin(np.pi * t)
    return scene_of(arm, q, 10 * np.cos(q) + 0.51 * bend)


def changed(law, scene, x, **drawn):
    return law(laws.Put(scene, scene.recording, ONE, np.array(x, ndmin=1), drawn))


def middle(recording):
    return float(recording.tau[200, 0])


def test_coulomb_friction_adds_to_the_recorded_torque_in_the_direction_of_motion(arm):
    forward, back = ramp(arm, 1.0, 5.0), ramp(arm, -1.0, 5.0)
    # atan at a hundred widths is 0.9936 of its end
    for scene, expected in ((forward, 5 + 2 * 0.99363), (back, 5 - 2 * 0.99363)):
        recording, values = changed(laws.coulomb, scene, 2.0, width=0.01, skew=0.0)
        assert middle(recording) == pytest.approx(expected, abs=1e-3)
        assert values["torque"] == pytest.approx(1.987, abs=5e-3)


def test_viscous_friction_of_another_power_equals_the_linear_one_at_the_rms_speed(arm):
    recording, values = changed(laws.viscous, ramp(arm, 2.0), 3.0, power=0.8)
    assert middle(recording) == pytest.approx(6.0, abs=0.01)
    assert values["coefficient"] == pytest.approx(3.0, abs=0.01)


def test_stribeck_friction_is_halved_at_its_velocity(arm):
    scene = ramp(arm, 0.5)
    recording, _ = changed(laws.stribeck, scene, 4.0, velocity=np.array([0.5]))
    assert middle(recording) == pytest.approx(2.0, abs=0.02)


def test_load_friction_is_overcome_by_the_motor_too(arm):
    scene = ramp(arm, 1.0, 8.0)
    recording, values = changed(laws.load_friction, scene, 0.2, power=1.0)
    # 8 = (1 - 0.2) tau against the motion, so 10 N m of which 2 are friction
    assert middle(recording) == pytest.approx(10.0)
    assert values["coefficient"] == pytest.approx(0.2)


def test_armature_is_inertia_times_acceleration(arm):
    scene = swing(arm)
    recording, values = changed(laws.armature, scene, 0.4)
    extra = recording.tau - scene.recording.tau
    # at t = 2.5 s the acceleration is -pi^2
    assert float(extra[250, 0]) == pytest.approx(-0.4 * np.pi**2, rel=0.01)
    assert values["inertia"] == 0.4


def test_payload_weighs_at_its_lever_and_has_inertia_of_its_own(arm):
    scene = scene_of(arm, np.zeros(400), np.zeros(400))
    drawn = {"com": np.array([0.2, 0, 0]), "gyration": np.ones(3)}
    recording, values = changed(laws.payload, scene, 1.5, **drawn)
    assert middle(recording) == pytest.approx(1.5 * 10 * 0.2, abs=1e-9)
    assert values["mass"] == 1.5
    # 2 kg at 0.1 m on x: nothing about x, 0.02 kg m^2 about y and z, beside its own
    body = laws.ten_parameters(2.0, np.array([0.1, 0, 0]), 0.3 * np.eye(3))
    assert body == pytest.approx([2, 0.2, 0, 0, 0.3, 0, 0.32, 0, 0, 0.32])


def test_heavier_link_weighs_more_on_its_own_joint(arm):
    scene = scene_of(arm, np.zeros(400), np.zeros(400))
    drawn = {"link": 0, "com": np.array([0.1, 0, 0])}
    recording, values = changed(laws.link_inertia, scene, 1.0, **drawn)
    # 3 kg at 0.6 m instead of 2 kg at 0.5 m
    assert middle(recording) == pytest.approx(18 - 10, abs=1e-9)
    assert values["link"] == 1


def test_force_against_gravity_relieves_the_motor(arm):
    scene = scene_of(arm, np.zeros(1000), np.full(1000, 10.0))
    drawn = {"direction": np.array([0, 1.0, 0]), "start": 2.0, "end": 8.0}
    recording, values = changed(laws.external_force, scene, 4.0, **drawn)
    # 4 N at 0.5 m, in the middle of the push
    assert recording.tau[500, 0] == pytest.approx(8.0)
    assert recording.tau[100, 0] == 10.0
    # 0.6 of the time at its full size, two edges of a fifth that count half
    assert values["force"] == pytest.approx([0, 4 * 0.8, 0], abs=0.02)


def test_spring_pulls_the_motor_back(arm):
    scene = ramp(arm, 0.5)
    recording, values = changed(laws.spring, scene, 6.0, rest=np.array([0.0]))
    # at 1 rad of at most 1.995: 6 (1 + 0.15 / 1.995^2)
    assert middle(recording) == pytest.approx(6 * (1 + 0.15 / 1.995**2))
    assert values["stiffness"] > 6


def test_scale_and_offset_act_between_recorded_and_applied_torque(arm):
    recording, values = changed(laws.scale, ramp(arm, tau=10), 0.2)
    # constant, so at its largest: applied 10 = (1 + 0.2 * 0.85) u, but for the largest, which is that of applied
    u = middle(recording)
    assert u * (1 + 0.2 * (1 - 0.15 * (u / 10) ** 2)) == pytest.approx(10)
    assert values["scale"] == pytest.approx(10 / u - 1)
    recording, values = changed(laws.offset, ramp(arm, tau=10), 2.0)
    assert recording.tau.mean() == pytest.approx(8.0)
    assert values["torque"] == 2.0


def test_ripple_of_one_period_per_turn_at_thirty_degrees(arm):
    scene = scene_of(arm, np.full(400, np.pi / 6), np.zeros(400))
    drawn = {"cycles": np.array([1.0]), "phase": np.zeros(1), "second": np.zeros(1)}
    recording, _ = changed(laws.ripple, scene, 2.0, **drawn)
    assert middle(recording) == pytest.approx(-2 * (0.5 + 0.25 * np.sqrt(3) / 2))


def test_delayed_torque_is_commanded_earlier_and_lagging_torque_by_its_rate(arm):
    t = np.arange(400) / 100
    scene = scene_of(arm, np.zeros(400), 3 * t)
    recording, _ = changed(laws.delay, scene, 0.02)
    assert middle(recording) == pytest.approx(3 * 2.02)
    assert len(recording.t) == 398
    scene = swing(arm)
    recording, _ = changed(laws.lag, scene, 0.05, second=0.0)
    # at 2 s it passes q = 0 at pi rad/s: the rate of the torque is -0.51 pi^3 N m/s
    extra = middle(recording) - middle(scene.recording)
    assert extra == pytest.approx(-0.05 * 0.51 * np.pi**3, rel=0.01)


def test_motor_leads_the_joint_by_twist_and_free_play(arm):
    scene = scene_of(arm, np.zeros(400), np.full(400, 10.0))
    recording, values = changed(laws.elasticity, scene, 2.0)
    # 10 N m at 2 rad / kN m, a quarter stiffer at the largest torque
    assert recording.q[200, 0] == pytest.approx(0.02 / 1.25)
    assert values["stiffness"] == pytest.approx(500 * 1.25)
    recording, _ = changed(laws.backlash, scene, 0.01)
    assert recording.q[200, 0] == pytest.approx(0.005)


def test_motor_with_rotor_and_friction_needs_torque_for_its_own_motion(arm):
    rotor = replace(arm, armature=np.array([0.5]), viscous=np.array([2.0]))
    scene = replace(ramp(arm), truth=rotor)
    twist = (scene.recording.t**2)[:, None]
    moved = laws.motor_moved(laws.Put(scene, scene.recording, ONE, ONE, {}), twist)
    # rate 2 t = 4 rad/s at 2 s, acceleration 2 rad/s^2
    assert middle(moved) == pytest.approx(0.5 * 2 + 2 * 4)


def test_encoder_is_shifted_or_rounded(arm):
    scene = scene_of(arm, np.full(400, 0.0149), np.zeros(400))
    assert changed(laws.encoder_offset, scene, 0.1)[0].q[0, 0] == 0.1149
    still = np.zeros((400, 1))
    rounded, _ = changed(laws.quantization, scene, 0.01, noise=still)
    assert rounded.q[0, 0] == pytest.approx(0.01)


@pytest.mark.parametrize("name", ["coulomb_friction", "torque_scale", "actuator_delay"])
def test_size_is_that_of_the_gap_over_what_a_model_leaves(arm, name):
    scene = replace(swing(arm), residual=np.array([0.05]))
    one = injections.draw(scene, name, 4.0, np.random.default_rng(1))
    recording, entries = injections.inject(scene, [one])
    assert scene.gap(recording)[0] / 0.05 == pytest.approx(4.0, rel=0.03)
    assert entries[0]["effect"] == name
    assert entries[0]["joints"] == [1]


def test_effect_beyond_what_real_arms_have_is_not_drawn(arm):
    scene = replace(swing(arm), residual=np.array([100.0]))
    assert injections.draw(scene, "armature", 8.0, np.random.default_rng(1)) is None
