"""Every control law recorded, replayed, and with the stability that its modes have."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from gapscope.arm.control import LAWS, PD, ControlLoop, Targets, like_pd
from gapscope.arm.controller import Controller
from gapscope.arm.errors import GapscopeError
from gapscope.arm.motions.trajectory import Fourier
from gapscope.arm.nominal import NominalArm
from gapscope.arm.velocity_filter import VelocityFilter, filter_gains
from gapscope.effects.applied import AppliedEffect
from gapscope.envs.position_controller import SampledLoop
from gapscope.envs.recorder import record
from gapscope.envs.replay import replay

INERTIA = 0.55
"""Of the pendulum [kg m^2]."""
MOTION = Fourier(np.zeros(1), np.full((1, 1), 0.3), np.zeros((1, 1)), 0.5, 3.0, 1.0)
PAYLOAD = AppliedEffect("payload", (), {"mass": 0.5, "com": [0.5, 0.0, 0.0]})


def law(kind: str, bandwidth: float = 4.0) -> Controller:
    """A controller of the pendulum with nominal feedforward, but for computed torque, which needs none."""
    w = 2 * np.pi * bandwidth
    kp, kd = np.array([w**2 * INERTIA]), np.array([1.4 * w * INERTIA])
    pd = PD(rate=1000.0, kp=kp, kd=kd, feedforward="nominal", velocity_cutoff=80.0)
    return like_pd(pd, kind, 0.7)


@pytest.mark.parametrize("kind", LAWS)
def test_a_replay_with_the_effect_closes_the_gap(kind: str, pendulum) -> None:
    """The start of an integrator is that of the recorded torque, or of the torque that the arm needs."""
    arm, controller = pendulum(viscous=0.5, armature=0.1), law(kind)
    rng = np.random.default_rng(0)
    recording = record(arm, (PAYLOAD,), MOTION, controller, duration=3.0, rng=rng)
    before = replay(arm, (), recording, controller).rmse[0]
    assert before > 5e-4
    for tau in (recording.tau, None):
        known = replace(recording, tau=tau)
        after = replay(arm, (PAYLOAD,), known, controller).rmse[0]
        assert after < 0.05 * before


def _speed_left(controller: Controller, weightless: NominalArm) -> float:
    """Speed of a pushed joint of the pendulum's inertia, without gravity, after 4 s [rad/s]."""
    control = ControlLoop(controller, weightless)
    filtered = VelocityFilter(
        (controller.rate, controller.velocity_cutoff, 0.9), np.zeros(1), np.zeros(1)
    )
    rest = Targets(*np.zeros((4, 1)))
    q, dq, dt = np.zeros(1), np.full(1, 1e-3), 1 / controller.rate
    for _ in range(4000):
        dq = dq + dt * control(rest, q, filtered(q)) / INERTIA
        q = q + dt * dq
    return float(np.abs(dq[0]))


@pytest.mark.parametrize("kind", LAWS)
def test_modes_say_which_bandwidth_is_stable(kind: str, pendulum) -> None:
    """Stepped in time: a pushed joint comes to rest a little below the limit of the modes, and not a little above."""
    weightless = replace(pendulum(), gravity=np.zeros(3))
    controller = law(kind)
    loop = SampledLoop(controller, 1e-3, filter_gains(1000.0, 80.0, 0.9))

    def stable(share: float) -> bool:
        return loop.times(share).stable(np.array([[INERTIA]]), np.zeros(1))

    shares = np.geomspace(1.0, 100.0, 200)
    limit = next(share for share in shares if not stable(share))
    assert stable(1.0)
    assert _speed_left(controller.times(0.95 * limit), weightless) < 1e-5
    assert not _speed_left(controller.times(1.05 * limit), weightless) < 1.0


def recorded(arm: NominalArm, controller: Controller, *effects: AppliedEffect) -> None:
    """A recording, of which a step of the encoders sets off what is unstable."""
    rng = np.random.default_rng(0)
    record(arm, effects, MOTION, controller, duration=3.0, rng=rng, encoder_step=1e-4)


def mended(controller: Controller, said: str) -> Controller:
    """With the gains that a message advises."""
    gains = {gain.name: getattr(controller, gain.name) for gain in controller.gains}
    factors = {x: float(re.search(rf"{x} by ([\d.]+)", said)[1]) for x in gains}
    return replace(controller, **{x: factors[x] * gains[x] for x in gains})


@pytest.mark.parametrize("kind", LAWS)
def test_gains_are_named_and_what_is_advised_is_stable(kind: str, pendulum) -> None:
    """No effect was given, so none is blamed; what the data sheet lacks is named."""
    controller = law(kind).times(60.0)
    with pytest.raises(GapscopeError, match="diverged at joint 1, at t =") as caught:
        recorded(pendulum(), controller)
    said = str(caught.value)
    assert "effect" not in said and "severity" not in said
    assert "torque_limit" in said and "armature" in said
    recorded(pendulum(), mended(controller, said))


def test_effects_are_named_if_the_loop_is_stable_without_them(pendulum) -> None:
    delay = AppliedEffect("actuator_delay", (1,), {"delay": np.array([0.06])})
    controller = law("pd", 6.0)
    recorded(pendulum(), controller)
    message = "actuator_delay makes a stable loop unstable"
    with pytest.raises(GapscopeError, match=message) as caught:
        recorded(pendulum(), controller, delay)
    recorded(pendulum(), mended(controller, str(caught.value)), delay)
