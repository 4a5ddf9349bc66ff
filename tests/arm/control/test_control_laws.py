"""Control laws tick by tick, against steps worked out by hand, and as sections of a case."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from arms import ROD, chain

from gapscope.arm.control import (
    LAWS,
    PD,
    PID,
    Cascade,
    ComputedTorque,
    ControlLoop,
    Targets,
    feedforward,
    like_pd,
)
from gapscope.arm.controller import ANTI_WINDUP, Controller, Integrator
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.io.case_file import controller_section, parse_controller
from gapscope.arm.io.json_file import schema
from gapscope.arm.nominal import NominalArm

RATE = 10.0


def pid(**bounds: Any) -> PID:
    """kp 2, ki 5, kd 1 on both joints; the integrator gains 0.5 N m per tick of an error of 1 rad."""
    two, five, one = (np.full(2, x) for x in (2.0, 5.0, 1.0))
    return PID(rate=RATE, kp=two, ki=five, kd=one, integrator=Integrator(**bounds))


def torques(
    law: Controller, arm: NominalArm, errors: list[float], limit: float | None = None
) -> list[float]:
    """Torque of joint 1 at ticks with these errors [rad] and an error of the velocity of 0.5 rad/s."""
    both = None if limit is None else np.full(2, limit)
    limited = NominalArm(arm.name, arm.urdf, arm.joints, torque_limit=both)
    loop, nothing = ControlLoop(law, limited), np.zeros(2)
    out = []
    for error in errors:
        targets = Targets(np.full(2, error), np.full(2, 0.5), nothing, nothing)
        out.append(float(loop(targets, nothing, nothing)[0]))
    return out


FOUR, ONE, TWO = (np.full(2, x) for x in (4.0, 1.0, 2.0))
CASCADE = Cascade(rate=RATE, kp=FOUR, kv=ONE, ki=TWO)
UP, SLACK = [1.0, 1.0, 1.0, -1.0], {"anti_windup": "none"}
BACK = {"anti_windup": "back_calculation", "tracking_time": 0.2}
TICKS: dict[str, tuple[Controller, list[float], float | None, list[float]]] = {
    # 2 * 1 + 1 * 0.5 + z with z = 0, 0.5, 1
    "pid": (pid(), [1, 1, 1], None, [2.5, 3.0, 3.5]),
    # velocity set 4 * 0.5 + 0.5 = 2.5 rad/s; torque 1 * 2.5 + z, z = 0, 0.1 * 2 * 2.5 = 0.5, 1
    "cascade": (CASCADE, [0.5, 0.5, 0.5], None, [2.5, 3.0, 3.5]),
    # three ticks want 2.5, then 2.5 + z with z > 0.3: the limit of 2.8 N m cuts the second and third;
    # z = 0, 0.5, stays 0.5 at the limit; the fourth tick: -2 + 0.5 + 0.5
    "clamped": (pid(), UP, 2.8, [2.5, 2.8, 2.8, -1.0]),
    # at the limit an error of the other sign still counts: z = 0 after 0.5 - 0.5
    "unwinds": (pid(), [1, 1, -1, -1], 2.8, [2.5, 2.8, -1.0, -1.5]),
    # z after: 0.5; 0.5 + 0.1 (5 - 0.2 / 0.2) = 0.9; 0.9 + 0.1 (5 - 0.6 / 0.2) = 1.1
    "back calculation": (pid(**BACK), UP, 2.8, [2.5, 2.8, 2.8, -0.4]),
    # z = 1.5, and 0.7 of its own limit
    "no anti-windup": (pid(**SLACK), UP, 2.8, [2.5, 2.8, 2.8, 0.0]),
    "own limit": (pid(**SLACK, limit=np.full(2, 0.7)), UP, 2.8, [2.5, 2.8, 2.8, -0.8]),
}
"""Law, errors, torque limit and torque."""


@pytest.mark.parametrize("name", TICKS)
def test_ticks_by_hand(name: str, arm: NominalArm) -> None:
    law, errors, limit, torque = TICKS[name]
    assert torques(law, arm, errors, limit) == pytest.approx(torque)


def test_computed_torque_of_the_elbow(arm: NominalArm) -> None:
    """Shoulder still and upright: 0.14 kg m^2 times the acceleration, gravity of 1 kg at 0.2 m, friction 0.1 dq_ref."""
    law = ComputedTorque(rate=RATE, kp=np.full(2, 9.0), kd=np.full(2, 6.0))
    q, planned = np.array([0.0, 0.3]), ([0.0, 0.5], [0.0, 0.2], [0.0, 1.0], [0.0, 0.0])
    acceleration = 1.0 + 9.0 * 0.2 + 6.0 * 0.2
    expected = 0.14 * acceleration - 9.81 * 0.2 * np.sin(0.3) + 0.1 * 0.2
    torque = ControlLoop(law, arm)(Targets(*map(np.array, planned)), q, np.zeros(2))
    assert torque[1] == pytest.approx(expected)


def laws() -> list[Controller]:
    """One controller of each law, with all that it may have."""
    kp, kd = np.array([40.0, 9.0]), np.array([4.0, 1.0])
    pd = PD(rate=500.0, kp=kp, kd=kd, feedforward="gravity", velocity_cutoff=60.0)
    bounded = pid(limit=np.ones(2), anti_windup="back_calculation", tracking_time=0.1)
    return [*(like_pd(pd, kind, 0.7) for kind in LAWS), bounded]


@pytest.mark.parametrize("law", laws(), ids=lambda law: law.kind)
def test_a_section_is_read_as_it_was_written(law: Controller) -> None:
    section = json.loads(json.dumps(controller_section(law)))
    again = parse_controller(section, 2, Path("case.yaml"))
    assert controller_section(again) == section
    assert type(again) is type(law)


def test_the_schema_knows_the_laws_and_their_gains() -> None:
    controller = schema("case")["properties"]["controller"]
    section, rules = controller["properties"], controller["allOf"]
    gains = {gain.name for law in LAWS.values() for gain in law.gains}
    assert section["kind"]["enum"] == list(LAWS)
    assert gains < set(section)
    for law, rule in zip(LAWS.values(), rules, strict=True):
        assert rule["if"]["properties"] == {"kind": {"const": law.kind}}
        own = [gain.name for gain in law.gains]
        assert set(rule["then"]["required"]) == set(own)
        others = {*gains.difference(own), *(() if law.integrates else ("integrator",))}
        refused = rule["then"]["properties"].items()
        another = {"$ref": "#/$defs/of_another_law"}
        assert {key for key, value in refused if value == another} == others
    kinds = section["integrator"]["properties"]["anti_windup"]["enum"]
    assert kinds == list(ANTI_WINDUP)
    for law in LAWS.values():
        for gain in law.gains:
            assert gain.unit in section[gain.name]["description"], (law.kind, gain)


PD_KEYS: dict[str, Any] = {"rate": 100, "kp": [1, 1], "kd": [1, 1]}
PID_KEYS = {"kind": "pid", "ki": [1, 1]}
COMPUTED = {"kind": "computed_torque", "feedforward": "nominal"}
AT_FAULT = [
    ({"kind": "pid"}, "controller: lacks the key 'ki', which pid needs"),
    ({"ki": [1, 1]}, "controller.ki: is a key of another law"),
    ({"integrator": SLACK}, "controller.integrator: is a key of another law"),
    ({"kind": "pid", "kii": [1, 1]}, "controller: unknown key 'kii'"),
    (COMPUTED, "controller.feedforward: computed torque contains"),
    (PID_KEYS | {"integrator": {"anti_windup": "back_calculation"}}, "give tracking_time in s"),
    (PID_KEYS | {"integrator": {"tracking_time": 1}}, "tracking_time: belongs to back_calculation alone"),
    (PID_KEYS | {"integrator": {"limit": [1]}}, "controller.integrator.limit: expected 2 entries"),
    ({"kp": [1]}, "controller.kp: expected 2 entries, one per joint, got 1\n  remedy: give what the key stands for"),
]  # fmt: skip


@pytest.mark.parametrize(("section", "message"), AT_FAULT)
def test_a_section_at_fault_is_refused(section: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError) as caught:
        parse_controller(PD_KEYS | section, 2, Path("case.yaml"))
    assert message in str(caught.value)


def test_feedforward_by_hand(tmp_path: Path) -> None:
    """A rod of 2 kg at 0.5 m along x, which gravity turns about +y, inertia 0.55 kg m^2 about the hinge."""
    sheet = {"armature": [0.2], "coulomb": [3.0], "viscous": [0.7]}
    rod = chain(tmp_path, "pendulum", ROD, **sheet)
    q, dq, ddq = np.array([[0.0]]), np.array([[0.005]]), np.array([[2.0]])
    nominal = -9.81 + (0.55 + 0.2) * 2.0 + 3.0 * np.tanh(1.0) + 0.7 * 0.005
    for kind, expected in (("none", 0.0), ("gravity", -9.81), ("nominal", nominal)):
        fed = feedforward(rod, RigidBody(rod), kind, q, dq, ddq)
        np.testing.assert_allclose(fed, [[expected]], rtol=1e-12)
