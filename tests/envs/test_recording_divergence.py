"""A recording that diverges is explained: gains, effects that were given, or what the data sheet lacks."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gapscope.arm.control import PD
from gapscope.arm.errors import GapscopeError
from gapscope.arm.motions.trajectory import Fourier
from gapscope.arm.nominal import NominalArm
from gapscope.effects.applied import AppliedEffect
from gapscope.envs.recorder import record

KP, KD = 700.0, 40.0


def _recorded(
    arm: NominalArm, *effects: AppliedEffect, kp: float = KP, kd: float = KD
) -> None:
    motion = Fourier(np.zeros(1), np.full((1, 1), 0.3), np.zeros((1, 1)), 0.5, 3.0, 1.0)
    controller = PD(
        rate=1000.0, kp=np.array([kp]), kd=np.array([kd]), velocity_cutoff=80.0
    )
    rng = np.random.default_rng(0)
    # a step of the encoders sets off what is unstable
    record(arm, effects, motion, controller, duration=3.0, rng=rng, encoder_step=1e-4)


def test_gains_are_named_and_what_is_advised_is_stable(pendulum) -> None:
    """No effect was given, so none is blamed."""
    with pytest.raises(GapscopeError, match="diverged at joint 1, at t =") as caught:
        _recorded(pendulum(), kp=30 * KP, kd=30 * KD)
    message = str(caught.value)
    assert "effect" not in message and "severity" not in message
    kp, kd = re.search(r"kp by ([\d.]+) and kd by ([\d.]+)", message).groups()
    _recorded(pendulum(), kp=30 * KP * float(kp), kd=30 * KD * float(kd))


def test_effects_are_named_if_the_loop_is_stable_without_them(pendulum) -> None:
    delay = AppliedEffect("actuator_delay", (1,), {"delay": np.array([0.06])})
    arm = pendulum()
    _recorded(arm)
    with pytest.raises(
        GapscopeError, match="actuator_delay makes a stable loop unstable"
    ) as caught:
        _recorded(arm, delay)
    kp, kd = re.search(r"kp by ([\d.]+) and kd by ([\d.]+)", str(caught.value)).groups()
    _recorded(arm, delay, kp=KP * float(kp), kd=KD * float(kd))


def test_what_the_data_sheet_lacks_is_named(pendulum, pendulum_urdf: Path) -> None:
    unlimited = replace(pendulum(), torque_limit=None)
    with pytest.raises(GapscopeError) as caught:
        _recorded(unlimited, kp=30 * KP, kd=30 * KD)
    assert "torque_limit" in str(caught.value) and "armature" in str(caught.value)
