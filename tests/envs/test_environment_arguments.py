"""The environment's arguments and actions: what is at fault is refused with what to do."""

from pathlib import Path

import numpy as np
import pytest

import gapscope  # noqa: F401 (registers the environment)
from gapscope.arm.errors import InputError, ModelWarning
from gapscope.arm.motions.trajectory import Limits, point_to_point
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected_file import write_corrected
from gapscope.envs.environment import ArmTracking

COULOMB = AppliedEffect("coulomb_friction", (1, 4), {"torque": [3.0, 2.0]})


@pytest.mark.parametrize(
    ("action", "kind", "text"),
    [
        (np.full(7, np.nan), "residual", "not finite"),
        (np.array([np.inf] + [0.0] * 6), "torque", "not finite"),
        (np.zeros(1), "residual", r"expected 7 numbers in -1 .. 1, got shape \(1,\)"),
        (np.zeros((1, 7)), "residual", r"shape \(1, 7\)"),
        (0.0, "torque", r"shape \(\)"),
        (np.zeros(7), "scale", "expected 14 numbers"),
        (np.zeros(7), "gains", "expected 1 numbers"),
        (["much"] * 7, "residual", "not a number"),
    ],
)
def test_actions_at_fault_are_refused(action: object, kind: str, text: str) -> None:
    env = ArmTracking(action=kind)
    env.reset(seed=0)
    with pytest.raises(InputError, match=text) as caught:
        env.step(action)
    assert caught.value.where == "action"
    env.step(np.zeros(env.action_space.shape))  # the episode goes on
    env.close()


BAD = [
    ({"robot": "kuka_iwa"}, "did you mean 'kuka_iiwa'"),
    ({"robot": 3}, "robot: expected NominalArm, got 3(?s:.)*xarm6"),
    ({"engine": "MuJoCo"}, "did you mean 'mujoco'"),
    ({"effects": ("payload",)}, r"effects\[0\]: expected AppliedEffect, got 'payload"),
    ({"effects": "coulomb_friction"}, "is the name of an effect, without values"),
    ({"effects": 3}, "effects: 3 is no effect with values"),
    ({"effects": {"effects": [], "residual": "r.npz"}}, "no effect(?s:.)*simulated="),
    ({"effects": {"effect": "payload"}}, r"effects\[0\], payload: expected the param"),
    ({"effects": "missing.yaml"}, "missing.yaml"),
    ({"simulated": "corrected.yaml"}, "expected CorrectedArm(?s:.)*read_corrected_arm"),
    ({"encoder_noise": -1e-3}, "encoder_noise: expected one number from zero on, or 7"),
    ({"encoder_noise": [1e-3] * 6}, "encoder_noise"),
    ({"encoder_noise": "some"}, "encoder_noise: holds what is not a number"),
    ({"reward": 0.01}, "reward: expected Reward"),
    ({"randomisation": "payload"}, "randomisation: expected Randomisation"),
    ({"limits": 3}, "limits: expected Limits, got 3"),
    ({"limits": Limits(*[[1.0] * 6] * 4)}, "limits.lower: expected 7 numbers"),
    ({"limits": Limits(*[[1.0] * 7] * 4)}, "limits: lower has to be below upper"),
    ({"limits": Limits(*[["x"] * 7] * 4)}, "limits: holds what is not a number"),
    ({"action": "torqe"}, "did you mean 'torque'"),
    ({"feedforward": "full"}, "nominal"),
    ({"feedforward": 3}, r"series\(motion\)"),
    ({"motion": "weld"}, "did you mean 'weld_seam'"),
    ({"motion": 3}, "is no motion"),
    ({"motion": point_to_point(np.zeros(3), np.ones(3), 1.0)}, r"shape \(1, 3\)"),
    ({"posture": [0.0] * 6}, "expected 7 numbers"),
    ({"posture": [float("nan")] * 7}, "outside its limits"),
    ({"posture": "home"}, "posture: holds what is not a number"),
    ({"episode_length": -1.0}, "episode_length: expected a number above zero"),
    ({"time_step": float("nan")}, "time_step"),
    ({"sub_steps": 2.5}, "sub_steps: expected a whole number"),
    ({"look_ahead": [float("inf")]}, "look_ahead: expected times above zero"),
    ({"look_ahead": 0.1}, "look_ahead: expected times above zero(?s:.)*give a list"),
    ({"bandwidth": 0}, "bandwidth"),
    ({"action_share": -1}, "action_share"),
    ({"action": "torque", "action_reach": 0.1}, "action_reach"),
    ({"action_share": 0.1, "action_reach": 0.1}, "action_reach"),
    ({"render_mode": "ascii"}, "rgb_array"),
    ({"sheet": "sheet.yaml"}, "sheet: expected a mapping"),
]


@pytest.mark.parametrize(("options", "message"), BAD, ids=lambda value: str(value)[:40])
def test_bad_arguments_are_refused_with_what_to_do(options: dict, message: str) -> None:
    with pytest.raises(InputError, match=message):
        ArmTracking(**options)


def test_effects_as_records_entries_and_file(tmp_path: Path) -> None:
    """One or several, as records, as entries of a corrected.yaml, as its whole content, or as the file."""
    entry = {"effect": "coulomb_friction", "joints": [1, 4]}
    entry["parameters"] = {"torque": [3.0, 2.0]}
    whole = {"schema": 1, "effects": [entry]}
    file = tmp_path / "corrected.yaml"
    write_corrected("test", (COULOMB,), file)
    for effects in (COULOMB, [COULOMB], entry, [entry], whole, file):
        env = ArmTracking(effects=effects)
        (found,) = env.effects
        assert (found.name, found.joints) == ("coulomb_friction", (1, 4))
        assert found.parameters["torque"].tolist() == [3, 2]
        env.reset(seed=0, options={"effects": effects})
        env.close()


def test_a_residual_network_among_effects_is_pointed_to_where_it_goes(
    tmp_path: Path,
) -> None:
    file = tmp_path / "corrected.yaml"
    file.write_text("schema: 1\neffects: []\nresidual: residual.npz\n")
    where = "simulated=gapscope.effects.corrected_file.read_corrected_arm"
    with pytest.warns(ModelWarning, match=where):
        ArmTracking(effects=file).close()


def test_effects_at_fault_leave_the_environment_as_it_was() -> None:
    """The next episode is simulated as if nothing had happened."""
    env = ArmTracking(episode_length=0.2)
    values = {"stiffness": 1e4, "damping": 0.0}
    bare = AppliedEffect("joint_elasticity", (2,), values)
    faults = {"effects": (bare,)}, {"effects": 3}, {"randomisation": "payload"}
    for options in (*faults, {"motion": None}):
        with pytest.raises(InputError):
            env.reset(seed=0, options=options)
    env.reset(seed=0)
    env.step(np.zeros(7))
    env.close()
