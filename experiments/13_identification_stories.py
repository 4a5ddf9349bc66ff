"""Four stories of identification: a wrong zero, faults that name themselves, little data, and noise or model error.

    .venv/bin/python experiments/13_identification_stories.py

``zeros`` and ``faults``: a Panda is recorded in PyBullet with the effects given, under position control. Printed for
each: the offset that is estimated for the joint, whether it is asked about, links that no body can be and negative
masses among the parameters nearest to the nominal arm that fit best, the relative error on the judged recording of the
nominal and of the identified arm, and the rows of the troubleshooting table that fire.

``update``: what a simulated KUKA iiwa knows is carried over to an arm with other friction and masses 10 % larger,
recorded in PyBullet for a few seconds; printed is the error on other motions of the prior, of a full refit and of the
partial update. ``groups``: the same arm in six recordings with and without an effect that the model lacks; printed is
the variance between the recordings' estimates over the variance that each states. ``--stories`` chooses.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from transferred_arm import Transfer

from gapscope.arm.case import Case
from gapscope.arm.recording import Recording
from gapscope.arm.robots import load_nominal_arm
from gapscope.effects.applied import AppliedEffect
from gapscope.envs.recorder import Plan, record_case
from gapscope.ident.checks.table_row import FOUND
from gapscope.ident.estimators.ols import OrdinaryLeastSquares
from gapscope.ident.estimators.partial_update import PartialUpdate
from gapscope.ident.estimators.wls import WeightedLeastSquares
from gapscope.ident.identification import (
    Identification,
    IdentificationSettings,
    identify,
)
from gapscope.ident.uncertainty.repeated_groups import compare_groups

SHEET = {
    "armature": [0.4, 0.4, 0.25, 0.25, 0.1, 0.08, 0.05],
    "coulomb": [5.0, 5.0, 4.0, 4.0, 3.0, 2.0, 1.5],
    "viscous": [4.0, 4.0, 3.0, 3.0, 2.0, 1.0, 0.8],
}
SETTINGS = IdentificationSettings(cutoff=20.0)


def recorded(*effects: AppliedEffect) -> Case:
    """Four recordings of a Panda with effects, the fastest to judge on."""
    arm = load_nominal_arm("franka_panda", sheet=SHEET)
    return record_case(
        "panda", arm, effects, Plan(recordings=4), np.random.default_rng(0)
    )


def zero(joint: int, degrees: float = 5.0) -> AppliedEffect:
    """An encoder zero that is off."""
    return AppliedEffect(
        "encoder_offset", (joint,), {"offset": np.array([np.deg2rad(degrees)])}
    )


def late(recording: Recording) -> Recording:
    """Torque recorded 20 ms late."""
    assert recording.tau is not None
    cut = {
        name: getattr(recording, name)[5:]
        for name in ("t", "q", "dq", "q_ref", "dq_ref")
    }
    return replace(recording, tau=recording.tau[:-5], **cut)


def columns(order: list[int], signs: list[int]) -> Callable[[Recording], Recording]:
    """Torque columns in another order, or with other signs."""
    return lambda recording: replace(
        recording, tau=np.asarray(recording.tau)[:, order] * signs
    )


def told(name: str, result: Identification, joint: int | None = None) -> None:
    """Print one story."""
    zeros, before = result.zeros, result.physical.before
    offset = (
        ""
        if joint is None
        else (
            f"zero {np.rad2deg(zeros.offset[joint - 1]):+.2f} ± {np.rad2deg(zeros.deviation[joint - 1]):.2f} deg; "
        )
    )
    fired = [
        f"{row.entry.key} {list(row.joints) or ''}".strip()
        for row in result.table
        if row.verdict == FOUND
    ]
    judged, negative = (
        result.validation[1],
        [c.link for c in before if not c.positive_mass],
    )
    print(
        f"{name}: {offset}asks about {(zeros.asked + 1).tolist() or 'nothing'}; no body "
        f"{[c.link for c in before if not c.consistent]}, negative mass {negative}; "
        f"error {judged.nominal.overall:.1%} -> {judged.every.overall:.1%}; found: {', '.join(fired) or 'nothing'}"
    )


def zeros() -> None:
    """A zero that is five degrees off."""
    told("healthy arm", identify(recorded(), SETTINGS))
    for joint in (2, 3, 4, 5, 6):
        told(
            f"zero of joint {joint} off by 5 deg",
            identify(recorded(zero(joint)), SETTINGS),
            joint,
        )


def faults() -> None:
    """Faults that the troubleshooting table is to name; a zero of joint 4 is the fifth."""
    healthy = recorded()
    stribeck = AppliedEffect(
        "stribeck_friction", (1, 2), {"torque": [4.0, 4.0], "velocity": [0.2, 0.2]}
    )
    told("Stribeck friction on joints 1 and 2", identify(recorded(stribeck), SETTINGS))
    told("zero of joint 4 off by 5 deg", identify(recorded(zero(4)), SETTINGS), 4)
    changes = {
        "torque of joint 4 counted backwards": columns(
            [0, 1, 2, 3, 4, 5, 6], [1, 1, 1, -1, 1, 1, 1]
        ),
        "torque of joints 3 and 4 exchanged": columns([0, 1, 3, 2, 4, 5, 6], [1] * 7),
        "torque 20 ms late": late,
    }
    for name, change in changes.items():
        told(
            name,
            identify(
                replace(healthy, recordings=tuple(map(change, healthy.recordings))),
                SETTINGS,
            ),
        )


def update() -> None:
    """Partial update against prior and full refit, by the length of the recording."""
    transfer = Transfer()
    judged = transfer.problem(transfer.recorded(20.0, 1000, noise=0.0))
    print(
        "| recorded [s] | prior | full refit | partial update | RMSE on other motions [N m], mean of five draws |"
    )
    for duration in (2.0, 3.0, 5.0, 10.0, 30.0):
        errors = []
        for seed in range(5):
            given = transfer.problem(transfer.recorded(duration, seed))
            values = (
                transfer.prior,
                OrdinaryLeastSquares().estimate(given).value,
                PartialUpdate(transfer.prior).estimate(given).value,
            )
            errors.append(
                [
                    float(np.sqrt((judged.residual(value) ** 2).mean()))
                    for value in values
                ]
            )
        print(
            f"| {duration:g} | "
            + " | ".join(f"{x:.2f}" for x in np.mean(errors, axis=0))
            + " | |"
        )


def groups() -> None:
    """Variance between six recordings over the variance that they state, with and without a missing effect."""
    transfer = Transfer(dry=False)
    load = AppliedEffect("load_friction", (2, 4), {"coefficient": [0.15, 0.15]})
    for label, effects in (
        ("nothing missing", ()),
        ("load friction 0.15 of joints 2 and 4 missing", (load,)),
    ):
        for same in (False, True):
            seeds = [0] * 6 if same else range(6)
            recordings = [
                transfer.recorded(10.0, seed, effects, 0.02, k)
                for k, seed in enumerate(seeds)
            ]
            found = compare_groups(
                transfer.problem(*recordings), WeightedLeastSquares()
            )
            motions = "one motion six times" if same else "six motions"
            print(
                f"{label}, {motions}: ratio {found.ratio:.2f}, p {found.p_value:.1g}: {found.verdict}"
            )


STORIES = {"zeros": zeros, "faults": faults, "update": update, "groups": groups}


def main() -> None:
    """Tell each."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--stories", nargs="+", choices=STORIES, default=list(STORIES))
    for name in parser.parse_args().stories:
        STORIES[name]()


if __name__ == "__main__":
    main()
