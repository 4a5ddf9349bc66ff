"""Two stories of identification, on recordings of a simulated Panda: a wrong zero, and faults that name themselves.

    .venv/bin/python experiments/13_identification_stories.py

The arm is recorded in PyBullet with the effects given, under position control. Printed for each story: the offset that
is estimated for the joint, whether it is asked about, links that no body can be and negative masses among the
parameters nearest to the nominal arm that fit best, the relative error on the judged recording of the nominal and of
the identified arm, and the rows of the troubleshooting table that fire.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from arm.case import Case
from arm.recording import Recording
from arm.robots import load_nominal_arm
from effects.applied import AppliedEffect
from envs.session import Plan, record_case
from ident.identification import Identification, Settings, identify
from ident.troubleshooting import FOUND

SHEET = {
    "armature": [0.4, 0.4, 0.25, 0.25, 0.1, 0.08, 0.05],
    "coulomb": [5.0, 5.0, 4.0, 4.0, 3.0, 2.0, 1.5],
    "viscous": [4.0, 4.0, 3.0, 3.0, 2.0, 1.0, 0.8],
}
SETTINGS = Settings(cutoff=20.0)


def recorded(*effects: AppliedEffect) -> Case:
    """Four recordings of a Panda with effects, the fastest to judge on."""
    arm = load_nominal_arm("franka_panda", sheet=SHEET)
    return record_case("panda", arm, effects, Plan(recordings=4), np.random.default_rng(0))


def zero(joint: int, degrees: float = 5.0) -> AppliedEffect:
    """An encoder zero that is off."""
    return AppliedEffect("encoder_offset", (joint,), {"offset": np.array([np.deg2rad(degrees)])})


def late(recording: Recording) -> Recording:
    """Torque recorded 20 ms late."""
    assert recording.tau is not None
    cut = {name: getattr(recording, name)[5:] for name in ("t", "q", "dq", "q_ref", "dq_ref")}
    return replace(recording, tau=recording.tau[:-5], **cut)


def columns(order: list[int], signs: list[int]) -> Callable[[Recording], Recording]:
    """Torque columns in another order, or with other signs."""
    return lambda recording: replace(recording, tau=np.asarray(recording.tau)[:, order] * signs)


def told(name: str, result: Identification, joint: int | None = None) -> None:
    """Print one story."""
    zeros, before = result.zeros, result.physical.before
    offset = "" if joint is None else (
        f"zero {np.rad2deg(zeros.offset[joint - 1]):+.2f} ± {np.rad2deg(zeros.deviation[joint - 1]):.2f} deg; "
    )  # fmt: skip
    fired = [f"{row.entry.key} {list(row.joints) or ''}".strip() for row in result.table if row.verdict == FOUND]
    judged, negative = result.validation[1], [c.link for c in before if not c.positive_mass]
    print(
        f"{name}: {offset}asks about {(zeros.asked + 1).tolist() or 'nothing'}; no body "
        f"{[c.link for c in before if not c.consistent]}, negative mass {negative}; "
        f"error {judged.nominal.overall:.1%} -> {judged.every.overall:.1%}; found: {', '.join(fired) or 'nothing'}"
    )


def main() -> None:
    """Record and identify each."""
    healthy = recorded()
    told("healthy arm", identify(healthy, SETTINGS))
    for joint in (2, 3, 4, 5, 6):
        told(f"zero of joint {joint} off by 5 deg", identify(recorded(zero(joint)), SETTINGS), joint)
    stribeck = AppliedEffect("stribeck_friction", (1, 2), {"torque": [4.0, 4.0], "velocity": [0.2, 0.2]})
    told("Stribeck friction on joints 1 and 2", identify(recorded(stribeck), SETTINGS))
    changes = {
        "torque of joint 4 counted backwards": columns([0, 1, 2, 3, 4, 5, 6], [1, 1, 1, -1, 1, 1, 1]),
        "torque of joints 3 and 4 exchanged": columns([0, 1, 3, 2, 4, 5, 6], [1] * 7),
        "torque 20 ms late": late,
    }
    for name, change in changes.items():
        told(name, identify(replace(healthy, recordings=tuple(map(change, healthy.recordings))), SETTINGS))


if __name__ == "__main__":
    main()
