"""What every effect of the catalogue has to fulfil on every engine."""

from dataclasses import replace

import numpy as np
import pytest
from own_effects import RECORDS, on_arm
from sweeps import daily

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.motions.motion import Motion
from gapscope.arm.nominal import NominalArm
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.arm_scale import ArmScale
from gapscope.effects.catalogue import CATALOGUE
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.effect import Effect, Path, Sensing, Transmission
from gapscope.effects.severity import draw
from gapscope.envs.engines import ENGINES
from gapscope.envs.simulated_arm import SimulatedArm

EACH_ENGINE = pytest.mark.parametrize("engine", daily(ENGINES, "mujoco"))
"""Effects belong to the drive, which is the same for every engine; ``test_engines.py`` holds the engines' contract."""
POSTURE = np.array([0.1, 0.6, -0.2, -1.2, 0.3, 0.8, 0.1])
SPEED = np.array([0.4, -0.3, 0.5, 0.4, -0.5, 0.6, -0.7])
TORQUE = np.array([20.0, -60.0, 15.0, 25.0, -4.0, 2.0, 1.5])

NEVER_OFF = ("joint_elasticity",)
"""No stiffness makes a joint rigid: ``drive/test_two_mass.py`` compares it with closed formulas."""
SIGNED = {
    name: effect.parameters[number].name
    for name, effect in CATALOGUE.items()
    for number in (1 if name == "link_inertia" else 0,)
    if effect.parameters[number].bounds[0] < 0
}
"""Parameters whose sign has a meaning, and that act in proportion while they are small."""
SHORTLY = {
    # drawn beyond the torque of a short motion
    "torque_saturation": {"limit": [10.0, 10.0]},
    "external_force": {"force": [20.0, 5.0, -9.0], "start": 1.9, "end": 2.0},
}


def _applied(name: str, values: dict[str, object]) -> AppliedEffect:
    joints = (2, 4) if CATALOGUE[name].scope == "joint" else ()
    return AppliedEffect(name, joints, values)  # type: ignore[arg-type]


def _drawn(arm: NominalArm, name: str) -> AppliedEffect:
    return draw(name, np.random.default_rng(7), ArmScale.of(arm), joints=(2, 4))


def _values(arm: NominalArm, name: str) -> dict[str, object]:
    """Values that show on a short motion."""
    return SHORTLY.get(name) or _drawn(arm, name).parameters


def _run(
    arm: NominalArm, engine: str, *effects: AppliedEffect, steps: int = 60
) -> np.ndarray:
    """Readings and true state under a torque that changes its sign, shape (steps, 3 n)."""
    rows, how = [], {"engine": engine, "encoder_noise": 1e-5}
    with SimulatedArm(arm, effects, rng=np.random.default_rng(3), **how) as simulated:
        simulated.reset(POSTURE, SPEED, time=1.9)
        for i in range(steps):
            simulated.step(TORQUE * np.cos(0.2 * i), 2)
            rows.append(np.r_[simulated.encoders(), simulated.q, simulated.dq])
    return np.array(rows)


@EACH_ENGINE
@pytest.mark.parametrize("name", CATALOGUE)
def test_an_effect_repeats_itself_and_on_means_on_and_off_means_off(
    engines, data_sheet_arm: NominalArm, name: str, engine: str
) -> None:
    arm, engine = data_sheet_arm, engines(engine)
    values, nominal = _values(arm, name), _run(arm, engine)
    on, again = (_run(arm, engine, _applied(name, values)) for _ in "ab")
    assert np.isfinite(on).all() and np.ptp(on, axis=0).min() > 0
    np.testing.assert_array_equal(on, again)
    assert np.abs(on - nominal).max() > 1e-5
    # what goes with the severity is zero, a limit is beyond all that is met
    none = {1: 0.0, -1: 1e4}
    parameters = [p for p in CATALOGUE[name].parameters if p.severity]
    zero = {
        p.name: np.full(p.size, none[p.severity]).squeeze()
        for p in parameters
        if p.name in values
    }
    if name not in NEVER_OFF:
        off = _run(arm, engine, _applied(name, values | zero))
        np.testing.assert_allclose(off, nominal, atol=1e-12)


@EACH_ENGINE
@pytest.mark.parametrize("name", SIGNED)
def test_a_negative_value_acts_the_other_way(
    engines, data_sheet_arm: NominalArm, name: str, engine: str
) -> None:
    arm, values = data_sheet_arm, _values(data_sheet_arm, name)
    size = np.array([1.0, 2.0, 3.0]) if name == "external_force" else 0.01
    several = [_applied(name, values | {SIGNED[name]: x * size}) for x in (-1, 0, 1)]
    below, zero, above = (_run(arm, engines(engine), x, steps=3) for x in several)
    up, down = above - zero, below - zero
    assert np.abs(up).max() > 1e-9
    np.testing.assert_allclose(up, -down, atol=0.03 * np.abs(up).max())


STEADY = [x for x, law in CATALOGUE.items() if not isinstance(law, Transmission)]
"""Joints with two masses ring; they are compared with closed formulas in ``drive/test_two_mass.py``."""

DT = 1e-3


def _planned() -> Motion:
    """Half a second in which no joint turns round."""
    t = np.arange(500) * DT
    w = 4 * np.pi
    swing = np.sin(w * t)[:, None]
    q = POSTURE + SPEED * (t[:, None] + 0.3 * swing / w)
    dq = SPEED * (1 + 0.3 * np.cos(w * t)[:, None])
    return Motion(t, q, dq, -0.3 * w * SPEED * swing)


def _gaps(
    arm: NominalArm, effects: tuple[AppliedEffect, ...], engine: str
) -> tuple[float, float, np.ndarray, np.ndarray]:
    """Largest torque gap before and after correction [N m] over a simulated motion; readings and true positions."""
    plan, body, corrected = _planned(), RigidBody(arm), CorrectedArm(arm, effects)
    commanded = corrected.unlimited.predict(body, plan)
    rows = []
    with SimulatedArm(arm, effects, DT, engine=engine) as simulated:
        simulated.start(plan.q[0], plan.dq[0])
        for torque in commanded:
            rows.append((simulated.encoders(), simulated.q, simulated.dq))
            simulated.step(torque)
        rows.append((simulated.encoders(), simulated.q, simulated.dq))
    seen, q, dq = (np.array(x) for x in zip(*rows, strict=True))
    motion = Motion(plan.t, seen[:-1], dq[:-1], np.diff(dq, axis=0) / DT)
    before = commanded - CorrectedArm(arm).predict(body, motion)
    after = corrected.delivered(commanded, motion) - corrected.predict(body, motion)
    # the ends, at which nobody knows the torque before and after
    inner = slice(60, -60)
    assert np.sign(dq).tolist() == np.sign(np.tile(SPEED, (len(dq), 1))).tolist()
    return np.abs(before[inner]).max(), np.abs(after[inner]).max(), seen, q


SLOWER = {"limit": [75.0, 22.0], "corner_speed": 0.3, "no_load_speed": [1.05, 1.5]}
HOTTER = {"scale": 0.0, "fading": 0.15, "rated": [60.0, 20.0], "warming_time": 0.2}
SEVERE = {
    "torque_saturation": {"limit": [67.5, 19.0]},
    "torque_saturation falling with the speed": SLOWER,
    "torque_scale falling with heat": HOTTER,
    "external_force": {"force": [20.0, 5.0, -9.0], "start": 0.2, "end": 0.3},
}
"""Values that show on the planned motion, of effects whose drawn ones do not."""


@pytest.mark.usefixtures("own")
@EACH_ENGINE
@pytest.mark.parametrize("name", [*STEADY, *RECORDS, *(x for x in SEVERE if " " in x)])
def test_the_simulated_motion_needs_the_torque_that_the_law_says(
    engines, data_sheet_arm: NominalArm, name: str, engine: str
) -> None:
    """Viscous friction of the end of a step instead of its beginning makes 0.01 N m; the effects are 40 times that."""
    arm = data_sheet_arm
    if name in SEVERE:
        effect = _applied(name.split()[0], SEVERE[name])
    else:
        effect = on_arm(name) if name in RECORDS else _drawn(arm, name)
    before, after, seen, q = _gaps(arm, (effect,), engines(engine))
    assert after < 0.012
    assert before > 0.4 or name == "encoder_quantization"
    for law, values in CorrectedArm(arm, (effect,)).of_kind(Sensing):
        np.testing.assert_allclose(seen, law.recorded(q, *values), rtol=1e-15)


COUPLED = (
    AppliedEffect("coupled_coulomb_friction", (7,), {"torque": [1.0]}),
    AppliedEffect("coupled_viscous_friction", (7,), {"coefficient": [0.5]}),
    AppliedEffect("coupled_armature", (7,), {"inertia": [0.2]}),
    AppliedEffect("coulomb_friction", (6,), {"torque": [0.5]}),
)


@EACH_ENGINE
def test_so_does_that_of_a_motor_that_turns_two_joints(
    engines, coupled_arm: NominalArm, engine: str
) -> None:
    before, after, *_ = _gaps(coupled_arm, COUPLED, engines(engine))
    assert after < 0.012 and before > 0.4


SLOW = Path(
    *("slow", "actuation", "joint", "", ()),
    *("", ""),
    inverse=lambda needed, series, s: needed + s * series.rate(needed),
    applied=lambda recorded, series, s: recorded - s * series.rate(recorded),
    place=3,
    varies_with="time",
)
SLOPPY = Transmission(
    *("sloppy", "transmission", "joint", "", ()),
    *("", ""),
    deflection=lambda torque, s: s * torque,
    lag=lambda s: np.zeros_like(s),
    behind=lambda matrices, rate, torque, s: torque,
    starts=lambda inertia, torque: iter(()),
)


@pytest.mark.parametrize("record", [SLOW, SLOPPY], ids=lambda record: record.name)
def test_an_effect_without_a_step_is_refused(
    data_sheet_arm: NominalArm, record: Effect, monkeypatch: pytest.MonkeyPatch
) -> None:
    scale = CATALOGUE["torque_scale"].parameter("scale")
    record = replace(record, parameters=(scale,))
    monkeypatch.setitem(CATALOGUE, record.name, record)
    applied = AppliedEffect(record.name, (1,), {"scale": 0.1})
    with pytest.raises(InputError, match="no step for this effect") as caught:
        SimulatedArm(data_sheet_arm, (applied,))
    assert caught.value.where == record.name
