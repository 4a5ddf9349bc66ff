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
from gapscope.effects.catalogue import CATALOGUE, register, remove
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

OFF = {
    "torque_saturation": {"limit": 1e4},
    "stribeck_friction": {"torque": 0.0, "velocity": 0.1},
    "saturating_friction": {"torque": 0.0, "velocity": 0.5},
    "friction_drift": {"amplitude": 0.0, "time_constant": 10.0},
    "link_inertia": {"link": 3.0},
}
"""Values that switch an effect off, where that is not zero."""
NEVER_OFF = ("joint_elasticity",)
"""No stiffness makes a joint rigid: ``drive/test_two_mass.py`` compares it with closed formulas."""
SIGNED = {
    "coulomb_friction": "torque",
    "viscous_friction": "coefficient",
    "armature": "inertia",
    "payload": "mass",
    "link_inertia": "mass",
    "base_tilt": "roll",
    "parallel_spring": "stiffness",
    "torque_ripple": "amplitude",
    "torque_scale": "scale",
    "torque_offset": "torque",
    "friction_drift": "amplitude",
    "external_force": "force",
    "encoder_offset": "offset",
}
"""Parameters whose sign has a meaning, and that act in proportion while they are small."""


def _applied(
    effect: Effect, values: dict[str, object], joints: tuple[int, ...] = (2, 4)
) -> AppliedEffect:
    return AppliedEffect(effect.name, joints if effect.scope == "joint" else (), values)  # type: ignore[arg-type]


def _drawn(arm: NominalArm, name: str) -> AppliedEffect:
    return draw(name, np.random.default_rng(7), ArmScale.of(arm), joints=(2, 4))


def _run(
    arm: NominalArm, effects: tuple[AppliedEffect, ...], engine: str, steps: int = 60
) -> np.ndarray:
    """Readings and true state under a torque that changes its sign, shape (steps, 3 n)."""
    rows, how = [], {"engine": engine, "encoder_noise": 1e-5}
    with SimulatedArm(arm, effects, rng=np.random.default_rng(3), **how) as simulated:
        simulated.reset(POSTURE, SPEED, time=1.9)
        for i in range(steps):
            simulated.step(TORQUE * np.cos(0.2 * i), 2)
            rows.append(np.r_[simulated.encoders(), simulated.q, simulated.dq])
    return np.array(rows)


def _zero(effect: Effect, **others: float) -> dict[str, object]:
    """No effect by its values, but for others."""
    return {
        p.name: np.zeros(p.size) if p.size > 1 else others.get(p.name, 0.0)
        for p in effect.parameters
    }


SHORTLY = {
    # drawn beyond the torque of a short motion
    "torque_saturation": {"limit": [10.0, 10.0]},
    "external_force": {"force": [20.0, 5.0, -9.0], "start": 1.9, "end": 2.0},
}
ACTING = {"link": 3.0, "velocity": 1.0, "time_constant": 5.0, "cycles": 3.0, "phase": 0.5, "end": 9.0}  # fmt: skip
"""Parameters that are not zero where another one acts."""


@EACH_ENGINE
@pytest.mark.parametrize("name", CATALOGUE)
def test_an_effect_repeats_itself_and_on_means_on_and_off_means_off(
    engines, data_sheet_arm: NominalArm, name: str, engine: str
) -> None:
    arm, effect, engine = data_sheet_arm, CATALOGUE[name], engines(engine)
    nominal = _run(arm, (), engine)
    drawn, again = (_run(arm, (_drawn(arm, name),), engine) for _ in "ab")
    assert np.isfinite(drawn).all() and np.ptp(drawn, axis=0).min() > 0
    np.testing.assert_array_equal(drawn, again)
    if name in SHORTLY:
        drawn = _run(arm, (_applied(effect, SHORTLY[name]),), engine)
    assert np.abs(drawn - nominal).max() > 1e-5
    if name not in NEVER_OFF:
        off = _applied(effect, _zero(effect) | OFF.get(name, {}))
        np.testing.assert_allclose(_run(arm, (off,), engine), nominal, atol=1e-12)


@EACH_ENGINE
@pytest.mark.parametrize("name", SIGNED)
def test_a_negative_value_acts_the_other_way(
    engines, data_sheet_arm: NominalArm, name: str, engine: str
) -> None:
    effect, key = CATALOGUE[name], SIGNED[name]
    size = np.array([1.0, 2.0, 3.0]) if name == "external_force" else 0.01
    below, zero, above = (
        _run(
            data_sheet_arm,
            (_applied(effect, _zero(effect, **ACTING) | {key: sign * size}),),
            engines(engine),
            steps=3,
        )
        for sign in (-1.0, 0.0, 1.0)
    )
    up, down = above - zero, below - zero
    assert np.abs(up).max() > 1e-9
    np.testing.assert_allclose(up, -down, atol=0.03 * np.abs(up).max())


STEADY = tuple(
    name for name, effect in CATALOGUE.items() if not isinstance(effect, Transmission)
)
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
    arm: NominalArm, effect: AppliedEffect, engine: str
) -> tuple[float, float, np.ndarray, np.ndarray]:
    """Largest torque gap before and after correction [N m] over a simulated motion; readings and true positions."""
    plan, body, corrected = _planned(), RigidBody(arm), CorrectedArm(arm, (effect,))
    commanded = corrected.unlimited.predict(body, plan)
    rows = []
    with SimulatedArm(arm, (effect,), DT, engine=engine) as simulated:
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


SEVERE = {
    "torque_saturation": {"limit": [67.5, 19.0]},
    "torque_saturation falling with the speed": {
        "limit": [75.0, 22.0],
        "corner_speed": 0.3,
        "no_load_speed": [1.05, 1.5],
    },
    "torque_scale falling with heat": {
        "scale": 0.0,
        "fading": 0.15,
        "rated": [60.0, 20.0],
        "warming_time": 0.2,
    },
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
        effect = _applied(CATALOGUE[name.split()[0]], SEVERE[name])
    else:
        effect = on_arm(name) if name in RECORDS else _drawn(arm, name)
    before, after, seen, q = _gaps(arm, effect, engines(engine))
    assert after < 0.012
    assert before > 0.4 or name == "encoder_quantization"
    for law, values in CorrectedArm(arm, (effect,)).of_kind(Sensing):
        np.testing.assert_allclose(seen, law.recorded(q, *values), rtol=1e-15)


@pytest.mark.parametrize(
    "record",
    [
        Path(
            *("slow", "actuation", "joint", "", ()),
            *("", ""),
            inverse=lambda needed, series, s: needed + s * series.rate(needed),
            applied=lambda recorded, series, s: recorded - s * series.rate(recorded),
            place=3,
            varies_with="time",
        ),
        Transmission(
            *("sloppy", "transmission", "joint", "", ()),
            *("", ""),
            deflection=lambda torque, s: s * torque,
            lag=lambda s: np.zeros_like(s),
            behind=lambda matrices, rate, torque, s: torque,
            starts=lambda inertia, torque: iter(()),
        ),
    ],
    ids=lambda record: record.name,
)
def test_an_effect_without_a_step_is_refused(
    data_sheet_arm: NominalArm, record: Effect
) -> None:
    record = replace(record, parameters=(CATALOGUE["torque_scale"].parameter("scale"),))
    register(record)
    try:
        applied = AppliedEffect(record.name, (1,), {"scale": 0.1})
        with pytest.raises(InputError, match="no step for this effect") as caught:
            SimulatedArm(data_sheet_arm, (applied,))
    finally:
        remove(record.name)
    assert caught.value.where == record.name
