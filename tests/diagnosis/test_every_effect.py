"""Recovery check of the catalogue: an arm with one effect is recorded, and that effect is found and no other.

Recorded by ``synthetic``, which shares no code with ``effects``: analytic motions, or where a joint saturates, bends or
plays, a simulation written out there.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
import synthetic
from sweeps import daily
from synthetic import Truth

from gapscope.diagnosis.diagnose import diagnose
from gapscope.diagnosis.document.diagnosis_json import validate
from gapscope.effects.catalogue import CATALOGUE, explained


@dataclass(frozen=True)
class Entry:
    """An arm with one effect.

    Attributes:
        truth: the arm.
        joints: where the effect has to be found.
        values: of the effect's first parameter that is searched or fitted, as in the document.
        within: relative tolerance of the values.
        alike: an effect that these motions cannot tell from it, which has to be listed beside it.
        closed: share of the gap above the floor that it has to close.
    """

    truth: Truth
    joints: tuple[int, ...]
    values: list[float]
    within: float = 0.05
    alike: str = ""
    closed: float = 0.9


EVERY = {
    "coulomb_friction": Entry(Truth(coulomb=(0.0, 2.0, 0.8)), (2, 3), [2.0, 0.8]),
    "coulomb_friction below the data sheet": Entry(
        Truth(coulomb=(-1.2, 0.0, 0.0)), (1,), [-1.2]
    ),
    "viscous_friction": Entry(Truth(viscous=(3.0, 0.0, 0.0)), (1,), [3.0]),
    "load_friction": Entry(Truth(load=(0.0, 0.15, 0.12)), (2, 3), [0.15, 0.12]),
    "stribeck_friction": Entry(
        Truth(stribeck=(0.0, 3.0, 0.0), stribeck_speed=0.2), (2,), [3.0]
    ),
    "saturating_friction": Entry(
        Truth(saturation=(0.0, 6.0, 2.0), saturation_speed=0.3), (2, 3), [6.0, 2.0]
    ),
    "friction_drift": Entry(Truth(drift=(0.0, 0.8, 0.0), drift_time=3.0), (2,), [0.8]),
    "payload": Entry(Truth(mass=1.5, com=(0.2, 0.03, 0.02)), (), [1.5]),
    "link_inertia": Entry(
        Truth(link=2, link_mass=2.0, link_com=(0.03, 0.0, 0.0)), (), [2.0], 0.1
    ),
    "armature": Entry(Truth(armature=(0.5, 0.0, 0.3)), (1, 3), [0.5, 0.3]),
    "base_tilt": Entry(Truth(tilt=(0.05, -0.03)), (), [0.05]),
    "joint_elasticity": Entry(
        Truth(stiffness=(1500.0, 0.0, 0.0), damping=(3.0, 0.0, 0.0)),
        (1,),
        [1500.0],
        0.1,
    ),
    "backlash": Entry(Truth(play=(0.003, 0.0, 0.0)), (1,), [0.003], 0.3),
    "torque_ripple": Entry(Truth(ripple=(0.0, 1.5, 0.0)), (2,), [1.5]),
    "parallel_spring": Entry(Truth(spring=(0.0, 6.0, 0.0)), (2,), [6.0]),
    "torque_scale": Entry(Truth(scale=(0.0, 0.2, 0.0)), (2,), [0.2]),
    "torque_scale below one": Entry(Truth(scale=(0.0, 0.0, -0.2)), (3,), [-0.2]),
    "torque_offset": Entry(Truth(offset=(1.0, 0.0, -0.7)), (1, 3), [1.0, -0.7]),
    "torque_saturation": Entry(Truth(limit=(0.0, 40.0, 0.0)), (2,), [40.0]),
    "actuator_lag": Entry(Truth(lag=(0.0, 0.012, 0.0)), (2,), [0.012], 0.1),
    "actuator_delay": Entry(
        Truth(delay=(0.0, 0.012, 0.008)), (2, 3), [0.012, 0.008], 0.06, "actuator_lag"
    ),
    "encoder_offset": Entry(Truth(encoder=(0.0, 0.05, 0.0)), (2,), [0.05]),
    "external_force": Entry(
        Truth(force=(8.0, 0.0, -12.0), window=(2.0, 4.0)), (), [8.0, 0.0, -12.0]
    ),
}
PARAMETER = {"link_inertia": "mass"}
OTHERS: dict[str, dict[str, tuple[list[float], float]]] = {
    "stribeck_friction": {"velocity": ([0.2], 0.02)},
    "saturating_friction": {"velocity": ([0.3, 0.3], 0.05)},
    "friction_drift": {"time_constant": ([3.0], 0.3)},
    "payload": {"com": ([0.2, 0.03, 0.02], 0.01)},
    "link_inertia": {"link": ([2.0], 0.0), "com": ([0.03, 0.0, 0.0], 0.01)},
    "base_tilt": {"pitch": ([-0.03], 0.005)},
    "torque_ripple": {"cycles": ([16.0], 0.1), "phase": ([0.7], 0.1)},
    "parallel_spring": {"rest": ([0.3], 0.02)},
    "external_force": {"start": ([2.0], 0.1), "end": ([4.0], 0.1)},
}
"""Further parameters: what they have to be, and how nearly."""
DAILY = (
    "stribeck_friction",
    "payload",
    "base_tilt",
    "torque_scale",
    "actuator_delay",
)
"""One of each family: friction, bodies, gravity, size and time of the torque; ``test_recovery`` has further ones."""


def test_every_effect_of_the_catalogue_is_here() -> None:
    """Quantisation, which shows in the positions themselves, has a file of its own."""
    assert (
        {label.split()[0] for label in EVERY}
        == {effect.name for effect in explained()}
        == set(CATALOGUE) - {"encoder_quantization"}
    )


@pytest.mark.parametrize(
    "label",
    daily(EVERY, *DAILY),
)
def test_an_effect_is_found_with_its_joints_and_values(label: str) -> None:
    entry, name = EVERY[label], label.split()[0]
    result = diagnose(synthetic.case(entry.truth, seed=1, duration=6.0))
    document = result.document
    validate(document)
    found = [
        (effect["effect"], tuple(effect["joints"])) for effect in document["effects"]
    ]
    if entry.alike and found == [(entry.alike, entry.joints)]:
        (effect,) = document["effects"]
        assert _alternative(effect, name) > 0.005
        return
    assert document["verdict"] == "effects_found"
    assert found == [(name, entry.joints)]
    if name == "base_tilt":
        # roll of 0.05 and pitch of -0.03 rad
        near = 9.81 * np.array([-0.03, -0.05, -1.0])
        assert np.allclose(document["effects"][0]["gravity"], near, atol=0.1)
    (effect,) = document["effects"]
    if entry.alike and effect["probability"] < 0.9:
        assert effect["probability"] > 0.5 and _alternative(effect, entry.alike) > 0.05
        assert entry.alike in document["next_recording"]
    else:
        assert effect["probability"] > 0.8
    parameter = PARAMETER.get(name, CATALOGUE[name].names[0])
    np.testing.assert_array_equal(
        result.effects[0].parameters[parameter],
        effect["parameters"][parameter]["value"],
    )
    check(effect, parameter, entry.values, entry.within * max(map(abs, entry.values)))
    for further, (values, tolerance) in OTHERS.get(label, {}).items():
        check(effect, further, values, tolerance)
    assert effect["share"] > entry.closed
    assert not document["unexplained"]["above_floor"]


@pytest.mark.nightly
@pytest.mark.parametrize(("link", "mass"), [(2, 1.0), (3, 1.2)])
def test_a_link_that_a_poor_data_sheet_may_be_off_by_is_not_named_otherwise(
    link: int, mass: float
) -> None:
    """Of three joints motion shows 13 combinations of the bodies, and four values of one link move five of them.

    A data sheet all of whose bodies are off by a tenth explains that as well: what is left of it goes by no other name.
    """
    truth = Truth(link=link, link_mass=mass, link_com=(0.02, 0.01, 0.0))
    document = diagnose(synthetic.case(truth, seed=1, duration=6.0)).document
    assert not document["effects"]


def check(
    effect: dict[str, Any], parameter: str, expected: list[float], tolerance: float
) -> None:
    """The value of a parameter, its unit, and a standard deviation that does not claim too much or too little."""
    entry = effect["parameters"][parameter]
    value, std = (np.atleast_1d(entry[key]) for key in ("value", "std"))
    assert entry["unit"] == CATALOGUE[effect["effect"]].parameter(parameter).unit
    np.testing.assert_allclose(value, expected, atol=tolerance + 1e-12)
    assert (std >= 0).all() and (
        std < 0.5 * np.maximum(np.abs(expected).max(), 0.1)
    ).all()


def _alternative(effect: dict[str, Any], name: str) -> float:
    return max(
        (a["probability"] for a in effect["alternatives"] if a["effect"] == name),
        default=0.0,
    )
