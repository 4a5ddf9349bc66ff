"""What each optimiser finds for a KUKA iiwa within all limits, against the best of 1000 random trajectories.

Fourier series of order 5 on 0.1 Hz over 10 s; limits as ``gapscope excite`` has them by default, all met at every
sample of 1 ms. The condition number is that of the base regressor with columns for rotor inertia, viscous and Coulomb
friction and offset, every column scaled to unit norm. Each optimiser may judge as many candidates as the random search
needed for 1000 that keep all limits; a candidate with its gradient counts as eight.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

from arm.dynamics import RigidBody
from arm.robots import load_nominal_arm
from ident.excitation.criteria import CRITERIA, condition_number
from ident.excitation.design import TIGHTER, accept, sampled
from ident.excitation.limits import Checker
from ident.excitation.model import ExcitationModel
from ident.excitation.optimiser import Optimiser
from ident.excitation.parametrisation import Parametrisation
from ident.excitation.plan import OPTIMISERS, LimitPlan, Plan
from ident.excitation.random_search import RandomSearch
from ident.excitation.search import Budget, Search


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robot", default="kuka_iiwa")
    parser.add_argument("--feasible", type=int, default=1000, help="random trajectories that keep all limits")
    parser.add_argument("--seeds", type=int, default=1)
    given = parser.parse_args()
    arm = load_nominal_arm(given.robot)
    body, plan, limits = RigidBody(arm), Plan(), LimitPlan()
    allowed, collision = limits.allowed(arm, body), limits.collision(arm, body)
    assert collision is not None
    tight, final = allowed.tightened(**TIGHTER), Checker(arm, body, allowed, collision)
    checker = Checker(arm, body, tight, collision.nearby(tight.clearance))
    space = Parametrisation(plan.family(arm.n_joints), allowed.motion)
    model, inertial = ExcitationModel(arm, body, plan.columns), ExcitationModel(arm, body)

    def run(name: str, optimiser: Optimiser, budget: Budget, seed: int) -> int:
        search = Search(space, model, CRITERIA["condition"], checker, budget)
        begun = time.perf_counter()
        optimiser.run(search, np.random.default_rng(seed))
        taken = time.perf_counter() - begun
        reference, margins = accept(search, final, plan)
        few = sampled(reference, plan.length, 200.0)
        slack = {margin.name: float(np.min(margin.margin)) for margin in margins}
        print(
            f"{name:10} {seed:4} {condition_number(model.matrix(few)):10.1f} "
            f"{condition_number(inertial.matrix(few)):10.1f} {taken:8.1f} {search.evaluations:11} "
            f"{search.feasible:9} {search.found[-1].evaluations:8} {slack['distance'] + allowed.clearance:12.3f}",
            flush=True,
        )
        return search.evaluations

    print(
        f"{'optimiser':10} {'seed':>4} {'condition':>10} {'inertial':>10} {'time [s]':>8} {'evaluations':>11} "
        f"{'feasible':>9} {'best at':>8} {'distance [m]':>12}"
    )
    for seed in range(given.seeds):
        count = run("random", RandomSearch(given.feasible), Budget(1_000_000), seed)
        for name, make in OPTIMISERS.items():
            if name != "random":
                run(name, make(), Budget(count), seed)


if __name__ == "__main__":
    main()
