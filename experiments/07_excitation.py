"""What each optimiser and each criterion finds for a KUKA iiwa within all limits, over several seeds.

    .venv/bin/python experiments/07_excitation.py [--seeds 3] [--tables optimisers criteria]

Limits are as ``gapscope excite`` has them by default, all met at every sample of 1 ms; series have order 5 on 0.1 Hz
over 10 s. The base regressor has columns for rotor inertia, viscous and Coulomb friction and offset.

``optimisers``: the condition number, every column scaled to unit norm, that each optimiser reaches with a Fourier
series. Each may judge as many candidates as the random search needed for 1000 that keep all limits; a candidate with
its gradient counts as eight.

``criteria``: for each kind of trajectory what is optimal by each criterion, beside the best of random candidates by
that criterion, ``--evaluations`` for both: condition number; geometric mean and smallest of the singular values, in
fixed scales (what D and E make large); separation of Coulomb from load friction, which is found by CMA-ES, the others
by gradients.
"""

from __future__ import annotations

import time

import numpy as np
from common import command_line, markdown

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.nominal import NominalArm
from gapscope.arm.robots import load_nominal_arm
from gapscope.ident.excitation.design import (
    OPTIMISERS,
    ExcitationPlan,
    LimitPlan,
    accept,
    design,
    prepare,
    sampled,
)
from gapscope.ident.excitation.trajectory_search import (
    CRITERIA,
    KINDS,
    Budget,
    ExcitationModel,
    Optimiser,
    TrajectorySearch,
)
from gapscope.ident.model.base_parameters import condition_number
from gapscope.ident.model.regressor import JOINT_COLUMNS

EFFECTS = ("coulomb_friction", "load_friction")
RATE = 200.0
"""Samples per second on which figures are stated [Hz]."""


def optimisers(arm: NominalArm, seeds: int, feasible: int) -> None:
    """Print the condition number that each optimiser reaches, with each seed."""
    head = ("optimiser", "seed", "condition", "inertial", "of random", "time [s]")
    head = (*head, "evaluations", "feasible", "best at", "distance [m]")
    print(markdown(head, ()), flush=True)

    def until_feasible(search: TrajectorySearch, rng: np.random.Generator) -> None:
        """Random candidates until so many kept all limits."""
        while search.feasible < feasible:
            search.score(search.parametrisation.draw(rng))

    for seed in range(seeds):
        count, best = optimised(arm, "random", until_feasible, Budget(1_000_000), seed)
        for name, optimiser in OPTIMISERS.items():
            if name != "random":
                optimised(arm, name, optimiser, Budget(count), seed, best)


def optimised(
    arm: NominalArm,
    name: str,
    optimiser: Optimiser,
    budget: Budget,
    seed: int,
    best: float = np.nan,
) -> tuple[int, float]:
    """Run one optimiser and print its row; evaluations, and the condition number [1]."""
    plan, limits = ExcitationPlan(budget=budget), LimitPlan()
    prepared = prepare(arm, plan, limits)
    search, final, body = prepared.search, prepared.final, prepared.body
    begun = time.process_time()
    optimiser(search, np.random.default_rng(seed))
    taken = time.process_time() - begun
    _, reference, margins = accept(search, final, plan)
    few = sampled(reference, plan.length, RATE)
    found, inertial = (
        condition_number(m.matrix(few))
        for m in (search.model, ExcitationModel(arm, body))
    )
    distance = next(float(m.limit + m.margin) for m in margins if m.name == "distance")
    figures = (f"{x:.3g}" for x in (found, inertial, found / best, taken))
    counts = search.evaluations, search.feasible, search.found[-1].evaluations
    print("|", *map("{} |".format, (name, seed, *figures, *counts, f"{distance:.3f}")))
    return search.evaluations, found


def criteria(arm: NominalArm, seeds: int, evaluations: int) -> None:
    """Print what is optimal by each criterion, for each kind of trajectory: median over the seeds, least and most."""
    body = RigidBody(arm)
    model = ExcitationModel(arm, body, JOINT_COLUMNS)
    measures = (
        float,
        *[lambda v: float(np.exp(-v))] * 2,
        float,
    )

    def figures(
        kind: str, criterion: str, optimiser: str | None, seed: int
    ) -> list[float]:
        plan = ExcitationPlan(
            kind,
            criterion=criterion,
            effects=EFFECTS,
            optimiser=optimiser,
            budget=Budget(evaluations),
        )
        begun = time.process_time()
        found = design(
            prepare(arm, plan, LimitPlan(), body=body), np.random.default_rng(seed)
        )
        taken = time.process_time() - begun
        matrix = model.matrix(sampled(found.reference, plan.length, RATE))
        d, e = (CRITERIA[name].evaluate(matrix, model.reference) for name in "de")
        values = (condition_number(matrix), d, e, found.separated.least)
        return [*(f(v) for f, v in zip(measures, values, strict=True)), taken]

    print(f"\n{evaluations} evaluations, {seeds} seeds: median (least, most)")
    heads = ("condition", "mean singular value", "smallest", "separation", "time [s]")
    print(markdown(("kind", "criterion", "search", *heads), ()), flush=True)
    for kind in KINDS:
        for name in (*CRITERIA, "separation"):
            for optimiser in ("random", None):
                rows = np.array(
                    [figures(kind, name, optimiser, seed) for seed in range(seeds)]
                ).T
                cells = [
                    f"{np.median(x):.3g} ({x.min():.3g}, {x.max():.3g})" for x in rows
                ]
                row = kind, name, optimiser or "optimum", *cells
                print("|", *map("{} |".format, row), flush=True)


def main() -> None:
    """Print the tables."""
    given = command_line(
        __doc__,
        robot="kuka_iiwa",
        seeds=(3, "searches of each sort"),
        feasible=(1000, "random trajectories that keep all limits"),
        evaluations=(1000, "of each search in the table of criteria"),
        tables={
            "nargs": "+",
            "choices": ("optimisers", "criteria"),
            "default": ("optimisers", "criteria"),
        },
    ).parse_args()
    arm = load_nominal_arm(given.robot)
    if "optimisers" in given.tables:
        optimisers(arm, given.seeds, given.feasible)
    if "criteria" in given.tables:
        criteria(arm, given.seeds, given.evaluations)


if __name__ == "__main__":
    main()
