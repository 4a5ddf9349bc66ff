"""Effects put into recordings: against values worked out by hand for a pendulum about z, gravity along -y."""

from dataclasses import replace

import numpy as np
import pytest
import real_cases as injections
import real_laws as laws
from arms import ROD, chain

from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording

ONE = np.array([0])


@pytest.fixture
def arm(tmp_path) -> NominalArm:
    """2 kg at 0.5 m: 10 N m where it is level under 10 m/s^2."""
    bob = ROD._replace(axis="0 0 1", inertia="0.01 0.01 0.01", limit="-3 3 9 3")
    bob = bob._replace(kind="revolute")
    return chain(tmp_path, "pendulum", bob, gravity=[0.0, -10.0, 0.0])


def scene_of(arm, q, tau):
    t = np.arange(len(q)) / 100
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


def changed(name, scene, x, **drawn):
    put = laws.Put(scene, scene.recording, ONE, np.array(x, ndmin=1), drawn)
    return laws.LAWS[name].apply(put)


def middle(recording):
    return float(recording.tau[200, 0])


def still(arm, q=0.0, tau=0.0, count=400):
    """The pendulum at rest."""
    return scene_of(arm, np.full(count, q), np.full(count, tau))


ZERO = np.zeros(1)
LAWS = {
    # atan at a hundred widths is 0.9936 of its end
    "coulomb_friction": (ramp, (1.0, 5.0), 2.0, {"width": 0.01, "skew": 0.0}, 5 + 2 * 0.99363, {"torque": 1.987}),
    "coulomb_friction back": (ramp, (-1.0, 5.0), 2.0, {"width": 0.01, "skew": 0.0}, 5 - 2 * 0.99363, {}),
    # of another power it equals the linear one at the RMS speed
    "viscous_friction": (ramp, (2.0,), 3.0, {"power": 0.8, "speed": 2.0}, 6.0, {"coefficient": 3.0}),
    "stribeck_friction": (ramp, (0.5,), 4.0, {"velocity": np.array([0.5])}, 2.0, {}),
    # 8 = (1 - 0.2) tau against the motion, so 10 N m of which 2 are friction
    "load_friction": (ramp, (1.0, 8.0), 0.2, {"power": 1.0, "speed": 1.0, "load": 8.0}, 10.0, {"coefficient": 0.2}),
    "payload": (still, (), 1.5, {"com": np.array([0.2, 0, 0]), "gyration": np.ones(3)}, 1.5 * 10 * 0.2, {"mass": 1.5}),
    # 3 kg at 0.6 m instead of 2 kg at 0.5 m
    "link_inertia": (still, (), 1.0, {"link": 0, "com": np.array([0.1, 0, 0])}, 18 - 10, {"link": 1}),
    # at 1 rad of at most 1.995
    "parallel_spring": (ramp, (0.5,), 6.0, {"rest": ZERO, "largest": 1.995**2}, 6 * (1 + 0.15 / 1.995**2), {}),
    "torque_offset": (ramp, (1.0, 10.0), 2.0, {}, 8.0, {"torque": 2.0}),
    # one period per turn at thirty degrees
    "torque_ripple": (still, (np.pi / 6,), 2.0, {"cycles": np.ones(1), "phase": ZERO, "second": ZERO}, -1.433, {}),
}  # fmt: skip
"""Scene, size and drawn values, the torque at 2 s by hand [N m], and what the label says."""


@pytest.mark.parametrize("name", LAWS)
def test_a_law_changes_the_torque_as_worked_out_by_hand(arm, name):
    scene, how, x, drawn, torque, label = LAWS[name]
    recording, values = changed(name.split()[0], scene(arm, *how), x, **drawn)
    assert middle(recording) == pytest.approx(torque, abs=0.02)
    for key, value in label.items():
        assert values[key] == pytest.approx(value, abs=0.01)


def test_armature_is_inertia_times_acceleration(arm):
    scene = swing(arm)
    recording, values = changed("armature", scene, 0.4)
    extra = recording.tau - scene.recording.tau
    # at t = 2.5 s the acceleration is -pi^2
    assert float(extra[250, 0]) == pytest.approx(-0.4 * np.pi**2, rel=0.01)
    assert values["inertia"] == 0.4


def test_a_body_has_inertia_of_its_own():
    # 2 kg at 0.1 m on x: nothing about x, 0.02 kg m^2 about y and z, beside its own
    body = laws.body_parameters(2.0, np.array([0.1, 0, 0]), 0.3 * np.eye(3))
    assert body == pytest.approx([2, 0.2, 0, 0, 0.3, 0, 0.32, 0, 0, 0.32])


def test_force_against_gravity_relieves_the_motor(arm):
    scene = still(arm, tau=10.0, count=1000)
    drawn = {"direction": np.array([0, 1.0, 0]), "start": 2.0, "end": 8.0}
    recording, values = changed("external_force", scene, 4.0, **drawn)
    # 4 N at 0.5 m, in the middle of the push
    assert recording.tau[500, 0] == pytest.approx(8.0)
    assert recording.tau[100, 0] == 10.0
    # 0.6 of the time at its full size, two edges of a fifth that count half
    assert values["force"] == pytest.approx([0, 4 * 0.8, 0], abs=0.02)


def test_scale_acts_between_recorded_and_applied_torque(arm):
    recording, values = changed("torque_scale", ramp(arm, tau=10), 0.2)
    # constant, so at its largest: applied 10 = (1 + 0.2 * 0.85) u, but for the largest, which is that of applied
    u = middle(recording)
    assert u * (1 + 0.2 * (1 - 0.15 * (u / 10) ** 2)) == pytest.approx(10)
    assert values["scale"] == pytest.approx(10 / u - 1)


def test_delayed_torque_is_commanded_earlier_and_lagging_torque_by_its_rate(arm):
    t = np.arange(400) / 100
    recording, _ = changed("actuator_delay", scene_of(arm, 0 * t, 3 * t), 0.02)
    assert middle(recording) == pytest.approx(3 * 2.02)
    assert len(recording.t) == 398
    scene = swing(arm)
    recording, _ = changed("actuator_lag", scene, 0.05, second=0.0)
    # at 2 s it passes q = 0 at pi rad/s: the rate of the torque is -0.51 pi^3 N m/s
    extra = middle(recording) - middle(scene.recording)
    assert extra == pytest.approx(-0.05 * 0.51 * np.pi**3, rel=0.01)


def test_motor_leads_the_joint_by_twist_and_free_play(arm):
    scene = still(arm, tau=10.0)
    recording, values = changed("joint_elasticity", scene, 2.0, largest=10.0)
    # 10 N m at 2 rad / kN m, a quarter stiffer at the largest torque
    assert recording.q[200, 0] == pytest.approx(0.02 / 1.25)
    assert values["stiffness"] == pytest.approx(500 * 1.25)
    recording, _ = changed("backlash", scene, 0.01, largest=10.0)
    assert recording.q[200, 0] == pytest.approx(0.005)


def test_motor_with_rotor_and_friction_needs_torque_for_its_own_motion(arm):
    rotor = replace(arm, armature=np.array([0.5]), viscous=np.array([2.0]))
    scene = replace(ramp(arm), truth=rotor)
    twist = (scene.recording.t**2)[:, None]
    moved = laws.motor_moved(laws.Put(scene, scene.recording, ONE, ONE, {}), twist)
    # rate 2 t = 4 rad/s at 2 s, acceleration 2 rad/s^2
    assert middle(moved) == pytest.approx(0.5 * 2 + 2 * 4)


def test_encoder_is_shifted_or_rounded(arm):
    scene = still(arm, 0.0149)
    assert changed("encoder_offset", scene, 0.1)[0].q[0, 0] == 0.1149
    noise = np.zeros((400, 1))
    rounded, _ = changed("encoder_quantization", scene, 0.01, noise=noise)
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
