"""The drives of an exported MJCF, in MuJoCo alone, do what the effects' laws say."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from arms import Link, chain, changed

from gapscope.arm.nominal import NominalArm
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.arm_scale import ArmScale
from gapscope.effects.catalogue import CATALOGUE
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.friction import friction_direction
from gapscope.effects.severity import draw
from gapscope.envs.export.formats import export
from gapscope.envs.export.plain_arm import TARGETS, holds
from gapscope.envs.simulated_arm import SimulatedArm

mujoco = pytest.importorskip("mujoco")

SHEET = {"armature": [0.5, 0.4, 0.2], "coulomb": [2.0, 2.0, 1.0]}
SHEET["viscous"] = [1.0, 1.0, 0.5]
PERIOD, TICKS = 1e-3, 800
EXACT = 1e-3
ROUGH = {
    "stribeck_friction": 0.15,
    "saturating_friction": 0.03,
    "actuator_lag": 0.03,
    "backlash": 0.3,
}
"""Share of the gap that may remain of what MuJoCo has in another form; see ``docs/export.md``."""


LINKS = changed(
    [
        Link("j1", "l1", "0 0 1", "0 0 0.2"),
        Link("j2", "l2", "0 1 0", "0 0 0.3"),
        Link("j3", "l3", "0 1 0", "0 0 0.3"),
    ],
    mass=3,
    com="0 0 0.15",
    inertia="0.04 0.04 0.02",
    limit="-3 3 200 5",
)
Effects = tuple[AppliedEffect, ...]


@pytest.fixture
def arm(tmp_path: Path) -> NominalArm:
    return chain(tmp_path, "robot", *LINKS, **SHEET)


def load(arm: NominalArm, effects: Effects, folder: Path) -> Any:
    file = folder / "arm.xml"
    export(CorrectedArm(arm, effects), "mjcf", file)
    return mujoco.MjModel.from_xml_path(str(file))


def applied(name: str, joint: int, **values: float) -> AppliedEffect:
    return AppliedEffect(name, (joint,), {key: [x] for key, x in values.items()})


class Loop:
    """PD to a swing about the upright posture, through which all joints reverse; it begins at rest with no torque."""

    def __init__(self) -> None:
        self.before = np.zeros(3)

    def __call__(self, tick: int, seen: np.ndarray) -> np.ndarray:
        goal = 0.2 * (1 - np.cos(2 * np.pi * np.array([1.5, 2.0, 2.5]) * tick * PERIOD))
        error = goal - seen
        rate = (error - self.before) / PERIOD if tick else 0.0 * error
        self.before = error
        return np.array([300.0, 400.0, 100.0]) * error + [20.0, 30.0, 8.0] * rate


def in_mujoco(model: Any) -> np.ndarray:
    data, steps = mujoco.MjData(model), round(PERIOD / model.opt.timestep)
    loop, out = Loop(), np.empty((TICKS, 3))
    for tick in range(TICKS):
        mujoco.mj_step1(model, data)
        out[tick] = data.sensordata
        data.ctrl[:] = loop(tick, out[tick])
        mujoco.mj_step2(model, data)
        mujoco.mj_step(model, data, steps - 1)
    return out


def gaps(
    arm: NominalArm, effects: Effects, folder: Path, others: Effects = ()
) -> list[float]:
    """Gap of MuJoCo's arm to the simulator's with effects, in MuJoCo without them and with them, beside others."""
    loop, wanted = Loop(), np.empty((TICKS, 3))
    with SimulatedArm(arm, (*effects, *others), PERIOD) as simulated:
        simulated.start(np.zeros(3))
        for tick in range(TICKS):
            wanted[tick] = simulated.encoders()
            simulated.step(loop(tick, wanted[tick]))
    models = (load(arm, x, folder) for x in (others, (*effects, *others)))
    off = ((in_mujoco(model) - wanted)[300:] for model in models)
    return [float(np.sqrt(np.mean(each**2))) for each in off]


@pytest.mark.parametrize(
    "name",
    [name for name, effect in CATALOGUE.items() if holds(TARGETS["mjcf"].held, effect)],
)
def test_a_held_effect_moves_the_arm_as_it_does_in_the_simulator(
    arm: NominalArm, tmp_path: Path, name: str
) -> None:
    effects = (draw(name, np.random.default_rng(1), ArmScale.of(arm), (2, 3)),)
    before, after = gaps(arm, effects, tmp_path)
    assert before > 1e-6
    assert after < ROUGH.get(name, EXACT) * before


EDGE = applied("torque_saturation", 3, limit=9.0, corner_speed=0.2, no_load_speed=3.0)


@pytest.mark.parametrize(
    "others",
    [
        (),
        (applied("torque_scale", 3, scale=0.1), applied("torque_offset", 3, torque=1.0)),
        (applied("actuator_delay", 3, delay=0.004), applied("actuator_lag", 3, time_constant=0.01)),
    ],
    ids=["alone", "scaled and offset", "late"],
)  # fmt: skip
def test_a_motor_at_its_edge_moves_the_arm_as_it_does_in_the_simulator(
    arm: NominalArm, tmp_path: Path, others: tuple[AppliedEffect, ...]
) -> None:
    """Back-EMF takes torque from joint 3, as it does in MuJoCo's ``dcmotor``."""
    before, after = gaps(arm, (EDGE,), tmp_path, others)
    assert before > 1e-4
    assert after < 0.03 * before


def test_friction_holds_a_joint_at_rest(arm: NominalArm, tmp_path: Path) -> None:
    """Half of its Coulomb friction turns joint 3 by less than 1e-5 rad in a second; three halves turn it away."""
    model = load(arm, (), tmp_path)
    model.opt.gravity[:] = 0
    turned = []
    for torque in (0.5, 1.5):
        data = mujoco.MjData(model)
        data.ctrl[2] = torque
        mujoco.mj_step(model, data, 1000)
        turned.append(float(data.qpos[2]))
    assert abs(turned[0]) < 1e-5 and turned[1] > 0.1


def test_friction_builds_up_over_the_presliding_distance(
    arm: NominalArm, tmp_path: Path
) -> None:
    """Along a path with reversals, as ``friction_direction`` says."""
    bends = replace(arm, presliding=np.array([0.0, 0.0, 0.01]))
    model = load(bends, (), tmp_path)
    data, h = mujoco.MjData(model), model.opt.timestep
    t = np.arange(0.0, 1.0, h)
    path, speed = 0.02 * np.sin(6 * t), 0.12 * np.cos(6 * t)
    got = np.empty(len(t))
    for i in range(len(t)):
        data.qpos[:], data.qvel[:] = [0, 0, path[i]], [0, 0, speed[i]]
        mujoco.mj_step(model, data)
        got[i] = -data.qfrc_actuator[2]
    bend = friction_direction(path[:, None], speed[:, None], np.array([0.01]))
    # the bristle starts unbent
    later = t > 0.8
    assert got[later] == pytest.approx(bend[later, 0], abs=0.03)


def test_command_meets_ripple_where_the_joint_truly_is(
    arm: NominalArm, tmp_path: Path
) -> None:
    """0.3 sin(7.5 q + 0.4) at q = 0.7, read as 0.75 by an encoder that is off by 0.05."""
    ripple = applied("torque_ripple", 2, amplitude=0.3, cycles=7.5, phase=0.4)
    off = applied("encoder_offset", 2, offset=0.05)
    for effects, reading in (((ripple,), 0.7), ((ripple, off), 0.75)):
        model = load(arm, effects, tmp_path)
        data = mujoco.MjData(model)
        data.qpos[1] = reading
        mujoco.mj_forward(model, data)
        want = 0.3 * np.sin(7.5 * 0.7 + 0.4)
        assert data.qfrc_actuator[1] == pytest.approx(want)


@pytest.mark.parametrize("encoder", ["motor", "joint"])
def test_gear_is_read_where_the_encoder_sits(
    arm: NominalArm, tmp_path: Path, encoder: str
) -> None:
    arm = replace(arm, encoder=encoder)
    effect = applied("joint_elasticity", 3, stiffness=1000.0, damping=5.0)
    model = load(arm, (effect,), tmp_path)
    data = mujoco.MjData(model)
    data.joint("j3").qpos, data.joint("j3_motor").qpos = 0.1, 0.2
    mujoco.mj_forward(model, data)
    assert data.sensor("j3").data[0] == (0.2 if encoder == "motor" else 0.1)


def test_gear_without_a_rotor_is_left_out(tmp_path: Path) -> None:
    bare = chain(tmp_path, "bare", *LINKS)
    effect = applied("backlash", 2, width=0.01)
    missing, _ = export(CorrectedArm(bare, (effect,)), "mjcf", tmp_path / "a.xml")
    said = [line for line in missing if line.startswith("backlash, joint 2")]
    assert len(said) == 1 and "nominal.armature" in said[0]


def test_coupled_motors_turn_with_their_joints(arm: NominalArm, tmp_path: Path) -> None:
    """Motor 3 turns joint 3 and half of joint 2: rotor, viscous and Coulomb friction act on both."""
    coupling = np.array([[1.0, 0, 0], [0, 1, 0], [0, 0.5, 1]])
    coupled = replace(arm, coupling=coupling)
    effects = (
        applied("coupled_armature", 3, inertia=0.3),
        applied("coupled_viscous_friction", 3, coefficient=2.0),
        applied("coupled_coulomb_friction", 3, torque=1.0),
    )
    before, after = gaps(coupled, effects, tmp_path)
    assert after < 0.01 * before
