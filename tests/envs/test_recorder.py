"""The recorder: timing, controller, and the contract that every effect of the catalogue fulfils."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from scipy.interpolate import make_interp_spline
from scipy.signal import butter, sosfiltfilt

from gapscope.arm.control import PD
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import GapscopeError, InputError
from gapscope.arm.motions.motion import Motion
from gapscope.arm.motions.trajectory import Fourier, urdf_limits
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected import CorrectedArm
from gapscope.envs.engines import ENGINES
from gapscope.envs.mystery_arm import HIDDEN, POSTURE
from gapscope.envs.position_controller import position_controller
from gapscope.envs.recorder import record

DURATION = 5.0
RATE = 250.0


def _reference(arm: NominalArm, seed: int = 0) -> Fourier:
    limits = urdf_limits(RigidBody(arm), acceleration=5.0)._replace(
        velocity=np.full(arm.n_joints, 1.2)
    )
    return Fourier.random(
        np.random.default_rng(seed),
        limits,
        duration=DURATION,
        centre=POSTURE,
        frequency=0.2,
    )


def _record(arm: NominalArm, *effects: AppliedEffect, **options: object) -> Recording:
    settings = {
        "rng": np.random.default_rng(3),
        "duration": DURATION,
        "rate": RATE,
    } | options
    return record(
        arm, effects, _reference(arm), position_controller(arm, POSTURE), **settings
    )


def _smooth(series: np.ndarray, rate: float = RATE) -> np.ndarray:
    return sosfiltfilt(butter(4, 12.0, output="sos", fs=rate), series, axis=0)


def _motion(recording: Recording) -> Motion:
    q = sosfiltfilt(butter(4, 40.0, output="sos", fs=RATE), recording.q, axis=0)
    spline = make_interp_spline(recording.t, q, k=5)
    return Motion(recording.t, *(spline(recording.t, order) for order in range(3)))


def _rms(series: np.ndarray) -> np.ndarray:
    return np.sqrt(np.mean(series[75:-75] ** 2, axis=0))


def _loaded_torque(
    arm: NominalArm, motion: Motion, effect: AppliedEffect
) -> np.ndarray:
    """What a point mass welded to the last link adds to the torque, by pinocchio's own means."""
    model = pin.buildModelFromUrdf(str(arm.urdf))
    inertia = pin.Inertia(
        float(effect.parameters["mass"]), effect.parameters["com"], np.zeros((3, 3))
    )
    model.appendBodyToJoint(arm.n_joints, inertia, pin.SE3.Identity())
    data = model.createData()
    loaded = [
        pin.rnea(model, data, q, v, a)
        for q, v, a in zip(motion.q, motion.dq, motion.ddq, strict=True)
    ]
    return np.array(loaded) - RigidBody(arm).inverse_dynamics(
        motion.q, motion.dq, motion.ddq
    )


def _turned_torque(arm: NominalArm, motion: Motion, offset: np.ndarray) -> np.ndarray:
    body = RigidBody(arm)
    turned, seen = (
        body.inverse_dynamics(q, motion.dq, motion.ddq)
        for q in (motion.q - offset, motion.q)
    )
    return turned - seen


def _advanced(t: np.ndarray, series: np.ndarray, ahead: np.ndarray) -> np.ndarray:
    return np.stack(
        [
            np.interp(t + T, t, column)
            for T, column in zip(ahead, series.T, strict=True)
        ],
        axis=1,
    )


Expected = Callable[[NominalArm, Motion, np.ndarray, np.ndarray], np.ndarray]

# Effect with values, and recorded - nominal as EFFECTS.md has it, of motion m, recorded torque u, nominal torque n.
PAYLOAD = AppliedEffect("payload", (), {"mass": 2.0, "com": [0.03, -0.02, 0.08]})
CASES: dict[str, tuple[AppliedEffect, Expected]] = {
    "coulomb_friction": (
        AppliedEffect("coulomb_friction", (2, 5), {"torque": [4.0, 1.5]}),
        lambda arm, m, u, n: np.array([0, 4.0, 0, 0, 1.5, 0, 0]) * np.sign(m.dq),
    ),
    "viscous_friction": (
        AppliedEffect("viscous_friction", (1, 6), {"coefficient": [5.0, 1.0]}),
        lambda arm, m, u, n: np.array([5.0, 0, 0, 0, 0, 1.0, 0]) * m.dq,
    ),
    "load_friction": (
        AppliedEffect("load_friction", (2, 4), {"coefficient": [0.15, 0.1]}),
        lambda arm, m, u, n: (
            np.array([0, 0.15, 0, 0.1, 0, 0, 0]) * np.abs(u) * np.sign(m.dq)
        ),
    ),
    "payload": (PAYLOAD, lambda arm, m, u, n: _loaded_torque(arm, m, PAYLOAD)),
    "armature": (
        AppliedEffect("armature", (3, 7), {"inertia": [0.6, 0.2]}),
        lambda arm, m, u, n: np.array([0, 0, 0.6, 0, 0, 0, 0.2]) * m.ddq,
    ),
    "torque_scale": (
        AppliedEffect("torque_scale", (2, 4), {"scale": [0.25, -0.15]}),
        lambda arm, m, u, n: -np.array([0, 0.25, 0, -0.15, 0, 0, 0]) * u,
    ),
    "torque_offset": (
        AppliedEffect("torque_offset", (3, 6), {"torque": [2.0, -0.7]}),
        lambda arm, m, u, n: -np.array([0, 0, 2.0, 0, 0, -0.7, 0]) + 0 * u,
    ),
    "actuator_delay": (
        AppliedEffect("actuator_delay", (1, 3), {"delay": [0.0173, 0.02]}),
        lambda arm, m, u, n: (
            _advanced(m.t, n, np.array([0.0173, 0, 0.02, 0, 0, 0, 0])) - n
        ),
    ),
    "encoder_offset": (
        AppliedEffect("encoder_offset", (2, 4), {"offset": [0.06, -0.05]}),
        lambda arm, m, u, n: _turned_torque(
            arm, m, np.array([0, 0.06, 0, -0.05, 0, 0, 0])
        ),
    ),
}

LINK = AppliedEffect(
    "link_inertia", (), {"link": 4.0, "mass": 1.2, "com": [0.0, 0.02, 0.03]}
)
TILT = AppliedEffect("base_tilt", (), {"roll": 0.06, "pitch": -0.04})
FORCE = AppliedEffect(
    "external_force", (), {"force": [15.0, -10.0, 20.0], "start": 1.5, "end": 3.5}
)
FURTHER: dict[str, tuple[AppliedEffect, Expected]] = {
    "stribeck_friction": (
        AppliedEffect(
            "stribeck_friction", (1, 2), {"torque": [6.0, 6.0], "velocity": [0.4, 0.3]}
        ),
        lambda arm, m, u, n: (
            np.array([6.0, 6.0, 0, 0, 0, 0, 0])
            * np.exp(-((m.dq / np.array([0.4, 0.3, 1, 1, 1, 1, 1])) ** 2))
            * np.sign(m.dq)
        ),
    ),
    "friction_drift": (
        AppliedEffect(
            "friction_drift",
            (1, 2),
            {"amplitude": [1.0, 1.0], "time_constant": [2.0, 5.0]},
        ),
        lambda arm, m, u, n: (
            np.array([1.0, 1.0, 0, 0, 0, 0, 0])
            * np.exp(-m.t[:, None] / np.array([2.0, 5.0, 1, 1, 1, 1, 1]))
            * (arm.coulomb * np.sign(m.dq) + arm.viscous * m.dq)
        ),
    ),
    "link_inertia": (LINK, lambda arm, m, u, n: _changed_torque(arm, m)),
    "base_tilt": (TILT, lambda arm, m, u, n: _tilted_torque(arm, m)),
    "parallel_spring": (
        AppliedEffect(
            "parallel_spring", (2, 6), {"stiffness": [15.0, 4.0], "rest": [0.2, -0.1]}
        ),
        lambda arm, m, u, n: (
            np.array([0, 15.0, 0, 0, 0, 4.0, 0])
            * (m.q - np.array([0, 0.2, 0, 0, 0, -0.1, 0]))
        ),
    ),
    "torque_ripple": (
        AppliedEffect(
            "torque_ripple",
            (1, 2),
            {"amplitude": [3.0, 4.0], "cycles": [6.0, 9.0], "phase": [0.4, 0.0]},
        ),
        lambda arm, m, u, n: (
            -np.array([3.0, 4.0, 0, 0, 0, 0, 0])
            * np.sin(
                np.array([6.0, 9.0, 0, 0, 0, 0, 0]) * m.q
                + np.array([0.4, 0, 0, 0, 0, 0, 0])
            )
        ),
    ),
    "actuator_lag": (
        AppliedEffect("actuator_lag", (1, 3), {"time_constant": [0.03, 0.025]}),
        lambda arm, m, u, n: (
            np.array([0.03, 0, 0.025, 0, 0, 0, 0]) * np.gradient(n, m.t, axis=0)
        ),
    ),
    "external_force": (FORCE, lambda arm, m, u, n: _pushed_torque(arm, m)),
}


def _changed_torque(arm: NominalArm, motion: Motion) -> np.ndarray:
    """What another mass and centre of link 4 change, by pinocchio's own means."""
    model = pin.buildModelFromUrdf(str(arm.urdf))
    old = model.inertias[4]
    mass = old.mass + 1.2
    model.inertias[4] = pin.Inertia(
        mass, old.lever + np.array([0.0, 0.02, 0.03]), old.inertia * mass / old.mass
    )
    return _rnea(model, motion) - RigidBody(arm).inverse_dynamics(
        motion.q, motion.dq, motion.ddq
    )


def _tilted_torque(arm: NominalArm, motion: Motion) -> np.ndarray:
    model = pin.buildModelFromUrdf(str(arm.urdf))
    turned = pin.rpy.rpyToMatrix(0.06, -0.04, 0.0)
    model.gravity = pin.Motion(turned.T @ [0, 0, -9.81], np.zeros(3))
    return _rnea(model, motion) - RigidBody(arm).inverse_dynamics(
        motion.q, motion.dq, motion.ddq
    )


def _pushed_torque(arm: NominalArm, motion: Motion) -> np.ndarray:
    """Power of the force by finite differences: -f . d p / d q_j, with p the last link's centre of mass."""
    model = pin.buildModelFromUrdf(str(arm.urdf))
    data = model.createData()

    def centre(q: np.ndarray) -> np.ndarray:
        pin.forwardKinematics(model, data, q)
        return data.oMi[7].act(model.inertias[7].lever)

    step, force = 1e-6 * np.eye(7), np.array([15.0, -10.0, 20.0])
    power = [
        [(centre(q + h) - centre(q - h)) @ force / 2e-6 for h in step] for q in motion.q
    ]
    return -np.array(power) * ((motion.t >= 1.5) & (motion.t < 3.5))[:, None]


def _rnea(model: pin.Model, motion: Motion) -> np.ndarray:
    data = model.createData()
    return np.array(
        [
            pin.rnea(model, data, *row)
            for row in zip(motion.q, motion.dq, motion.ddq, strict=True)
        ]
    )


def test_every_effect_that_a_diagnosis_finds_has_a_case() -> None:
    assert set(CASES) == set(HIDDEN)


@pytest.mark.parametrize("name", sorted(CASES | FURTHER))
def test_effect_changes_the_torque_as_documented(
    data_sheet_arm: NominalArm, name: str
) -> None:
    """The gap follows the documented law (slope 1), and the corrected arm removes at least two thirds of it."""
    effect, law = (CASES | FURTHER)[name]
    recording = _record(data_sheet_arm, effect, torque_noise=0.02)
    motion, body = _motion(recording), RigidBody(data_sheet_arm)
    nominal = CorrectedArm(data_sheet_arm).predict(body, motion)
    corrected = CorrectedArm(data_sheet_arm, (effect,)).predict(body, motion)
    gap, left = (
        _smooth(recording.tau - predicted) for predicted in (nominal, corrected)
    )
    expected = _smooth(law(data_sheet_arm, motion, recording.tau, nominal))
    far = (
        [1, 3] if name in ("link_inertia", "base_tilt") else [1, 3, 5]
    )  # the others hardly feel it
    joints = np.array(effect.joints, dtype=int) - 1 if effect.joints else np.array(far)
    inner = slice(75, -75)
    slope = (gap * expected)[inner].sum(axis=0)[joints] / (expected**2)[inner].sum(
        axis=0
    )[joints]
    np.testing.assert_allclose(slope, 1.0, atol=0.12)
    assert (_rms(gap)[joints] > 3 * _rms(left)[joints]).all(), (
        _rms(gap)[joints],
        _rms(left)[joints],
    )


@pytest.mark.parametrize("encoder", ["motor", "joint"])
def test_corrected_arm_follows_an_elastic_joint(
    data_sheet_arm: NominalArm, encoder: str
) -> None:
    """A soft joint that carries gravity: the corrected arm leaves less than a third of the gap, from either encoder."""
    arm = replace(
        data_sheet_arm, encoder=encoder, coulomb=np.zeros(7)
    )  # sticking has no law
    soft = AppliedEffect(
        "joint_elasticity", (2,), {"stiffness": [800.0], "damping": [30.0]}
    )
    recording = _record(arm, soft, encoder_step=0.0)
    motion, body = _motion(recording), RigidBody(arm)
    gap, left = (
        _rms(_smooth(recording.tau - CorrectedArm(arm, effects).predict(body, motion)))[
            1
        ]
        for effects in ((), (soft,))
    )
    assert left < 0.3 * gap, (gap, left)


def test_without_effects_only_the_form_of_friction_is_left(
    data_sheet_arm: NominalArm,
) -> None:
    recording = _record(data_sheet_arm)
    gap = _smooth(
        recording.tau
        - CorrectedArm(data_sheet_arm).predict(
            RigidBody(data_sheet_arm), _motion(recording)
        )
    )
    assert (_rms(gap) < 0.05 * np.maximum(recording.tau.std(axis=0), 1.0)).all()


@pytest.mark.parametrize("engine", ENGINES)
def test_torque_belongs_to_the_motion_of_its_own_row(
    engines, bare_arm: NominalArm, engine: str
) -> None:
    """Inverse dynamics of central differences against the torque: a skew of 0.005 dt, 0.05 dt on light joints."""
    dt = 1e-3
    recording = _record(bare_arm, rate=1000.0, encoder_step=0.0, engine=engines(engine))
    q = recording.q
    ddq, dq = (q[2:] - 2 * q[1:-1] + q[:-2]) / dt**2, (q[2:] - q[:-2]) / (2 * dt)
    needed, torque = (
        RigidBody(bare_arm).inverse_dynamics(q[1:-1], dq, ddq),
        recording.tau,
    )
    rate = (torque[2:] - torque[:-2]) / (2 * dt)
    skew = ((needed - torque[1:-1]) * rate).sum(axis=0) / (rate**2).sum(axis=0)
    assert np.abs(skew).max() < 0.1 * dt, skew / dt
    np.testing.assert_allclose(needed, torque[1:-1], atol=0.01)


def test_columns(data_sheet_arm: NominalArm) -> None:
    recording = _record(data_sheet_arm)
    assert (
        recording.t[0] == 0.0
        and len(recording.t) == 1251
        and recording.rate == pytest.approx(RATE)
    )
    steps = recording.q / data_sheet_arm.encoder_step
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-6)
    reference = _reference(data_sheet_arm)
    np.testing.assert_allclose(recording.q_ref, reference.position(recording.t))
    np.testing.assert_allclose(recording.dq_ref, reference.velocity(recording.t))
    assert np.abs(recording.q - recording.q_ref).max() < 0.02
    assert np.abs(recording.dq - recording.dq_ref).max() < 0.2


def test_torque_is_the_documented_law_of_the_recorded_columns(
    data_sheet_arm: NominalArm,
) -> None:
    """tau = g(q_ref) + kp (q_ref - q) + kd (dq_ref - dq), clipped, row by row."""
    arm = replace(data_sheet_arm, torque_limit=np.full(7, 35.0))
    controller = replace(position_controller(arm, POSTURE), feedforward="gravity")
    recording = record(
        arm, (), _reference(arm), controller, duration=2.0, rng=np.random.default_rng(0)
    )
    zero = np.zeros_like(recording.q)
    torque = RigidBody(arm).inverse_dynamics(recording.q_ref, zero, zero)
    torque += controller.kp * (recording.q_ref - recording.q) + controller.kd * (
        recording.dq_ref - recording.dq
    )
    np.testing.assert_allclose(recording.tau, np.clip(torque, -35.0, 35.0), atol=1e-9)
    assert np.abs(recording.tau).max() == 35.0


def test_encoder_offset_turns_the_true_arm(bare_arm: NominalArm) -> None:
    """The encoders start at the reference although the joint does not, and the noise is on the torque alone."""
    effect = AppliedEffect("encoder_offset", (4,), {"offset": [0.05]})
    recording = _record(bare_arm, effect, duration=1.0, settle=0.0, torque_noise=3.0)
    np.testing.assert_allclose(recording.q[0], recording.q_ref[0], atol=1e-9)
    assert np.diff(recording.tau, axis=0).std() > 3.0


def test_same_seed_same_recording_bit_by_bit(data_sheet_arm: NominalArm) -> None:
    effect = CASES["load_friction"][0]
    first, second = (
        _record(data_sheet_arm, effect, torque_noise=0.1, duration=1.0)
        for _ in range(2)
    )
    for channel in ("q", "dq", "tau"):
        np.testing.assert_array_equal(getattr(first, channel), getattr(second, channel))


def test_rate_must_divide_the_controllers(data_sheet_arm: NominalArm) -> None:
    with pytest.raises(InputError, match="divide"):
        _record(data_sheet_arm, rate=300.0)


def test_unstable_gains_are_reported(data_sheet_arm: NominalArm) -> None:
    arm = replace(data_sheet_arm, torque_limit=None)
    controller = PD(rate=1000.0, kp=np.full(7, 1e7), kd=np.zeros(7))
    with pytest.raises(GapscopeError, match="diverged"):
        record(
            arm,
            (),
            _reference(arm),
            controller,
            duration=1.0,
            rng=np.random.default_rng(0),
        )
