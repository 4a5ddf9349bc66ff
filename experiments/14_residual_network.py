"""The residual network against nothing and boosted trees: torque left per remainder, arm and joint.

    .venv/bin/python experiments/14_residual_network.py [--out out/residual] [--only NAME] [--table]

Needs the extras `learn` and `blind`. Ten problems come from the blind check's generator: five kinds of remainder on an
arm with six joints and one with seven, six recordings of 10 s to fit, two to judge. Data sheet and bodies of the
nominal arm are those of the simulated one, so that the gap is the remainder, on every joint at the size that the
generator draws before it sizes an effect for a class of severity, and the small imperfections of a healthy arm. Two
problems are real: what a diagnosis leaves of the TX40, judged on its other recording, and of the UR10, judged on the
last 40 % of its only one. Networks and trees are trained on the same rows and judged on the same others, which nothing
has seen; both sides are filtered at 12 Hz. Each problem is a JSON file, written whole; a rerun continues where the last
one ended. ``--table`` only prints what is there, as Markdown.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from common import CASES, DATA, command_line, kept, markdown
from generator_arms import recorded

from gapscope.arm.case import Case, load_case
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.recording import Recording
from gapscope.arm.robots import load_nominal_arm
from gapscope.blind_check.generator.case import CaseSetup, draw_setup, sheet_of
from gapscope.blind_check.generator.laws import LAWS
from gapscope.blind_check.generator.simulate import (
    Conditions,
    draw_motion,
    nominal_torque,
)
from gapscope.diagnosis.diagnose import diagnose
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.residual import ADDITIVE, write_residual
from gapscope.ident.residual.fit import (
    APART,
    ResidualSettings,
    Trajectory,
    boosted_trees,
    fit_residual,
    from_segment,
    rows_of,
    torque_left,
)
from gapscope.model.conditioning import condition, position_cutoff

# Arms with one remainder each

REMAINDERS = {
    "posture_friction": "position_dependent_friction",
    "coupling": "joint_coupling",
    "hysteresis": "hysteresis",
    "transmission_error": "torque_ripple",
    "thermal_fading": "fading_torque_constant",
}
"""Kinds of remainder, and the generator's law of each."""
ARMS = ("ur5_like", "franka_panda")
"""An arm with six joints and one with seven."""
KINDS = (
    "slow",
    "middle",
    "point_to_point",
    "fast",
    "middle",
    "crawl",
    "middle",
    "point_to_point",
)
"""Motions of the recordings; the last two judge."""
JUDGED = 2
"""Recordings set aside."""
DURATION = 10.0
"""Of a recording [s]."""
ATTEMPTS = 20
"""Draws of an arm with its remainder until the loop runs well."""


def simulated(arm: str, remainder: str, folder: Path) -> list[list[Trajectory]]:
    """Trajectories to fit and to judge of an arm with a remainder; its URDF is written into ``folder``."""
    place = list(REMAINDERS).index(remainder)
    rng = np.random.default_rng((14, ARMS.index(arm), place, 0))
    for _ in range(ATTEMPTS):
        setup = draw_setup(Conditions(arm), rng)
        recordings = None if setup is None else _recorded(setup, remainder, rng)
        if setup is None or recordings is None:
            continue
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / "robot.urdf"
        path.write_text(setup.arm.urdf, encoding="utf-8")
        nominal = load_nominal_arm(path, sheet=sheet_of(setup.arm))
        parts = recordings[:-JUDGED], recordings[-JUDGED:]
        return remaining(CorrectedArm(nominal), *parts)
    raise RuntimeError(f"no {arm} with {remainder} ran well in {ATTEMPTS} draws")


def remaining(
    corrected: CorrectedArm, *parts: Sequence[Recording]
) -> list[list[Trajectory]]:
    """What an arm leaves of recordings in parts, of which the first one says how positions are filtered."""
    body, cutoff = RigidBody(corrected.arm), position_cutoff(tuple(parts[0]))
    return [
        [from_segment(corrected, body, s) for r in own for s in condition(r, cutoff)]
        for own in parts
    ]


def _recorded(
    setup: CaseSetup, remainder: str, rng: np.random.Generator
) -> list[Recording] | None:
    """Recordings of ``KINDS``, fed forward with the nominal torque, with the remainder on every joint.

    ``None`` if a loop does not run well.
    """
    motions = [
        draw_motion(kind, setup.arm, DURATION, setup.loop.rate, rng) for kind in KINDS
    ]
    sheet = sheet_of(setup.arm)
    ahead = [nominal_torque(setup.model, sheet, m.t, m.q) for m in motions]
    noise = [setup.healthy.noise * rng.standard_normal(m.q.shape) for m in motions]
    setup = replace(setup, motions=motions, ahead=ahead, noise=noise)
    law = LAWS[REMAINDERS[remainder]]
    joints = np.arange(1 if law.joints == "later" else 0, setup.arm.n)
    plant = setup.plant((law.cause(rng, setup, joints),))
    rows = recorded(setup, plant, range(len(KINDS)))
    return rows and [
        Recording(f"{kind}_{k}", row["t"], row["q"], row["tau"])
        for k, (kind, row) in enumerate(zip(KINDS, rows, strict=True))
    ]


# Networks and trees

FITTED = 0.6
"""Share of a single recording that is used to fit."""
EVEN = 1.01
"""A network is no worse than trees or nothing up to this ratio of what they leave."""


Problem = list[list[Trajectory]]
"""Trajectories to train on and to judge on."""


def diagnosed(
    name: str, case: Case, fit: Sequence[Recording], judge: Sequence[Recording]
) -> Problem:
    """What the effects found on ``fit`` leave of both."""
    result = diagnose(replace(case, recordings=tuple(fit), judged=()))
    print(
        f"{name}: {result.document['verdict']}; {', '.join(e.name for e in result.effects) or 'no effects'}\n"
    )
    return remaining(CorrectedArm(case.arm, result.effects), fit, judge)


def problems(out: Path) -> dict[str, Callable[[], Problem]]:
    """The problems, by name."""

    def ur10() -> Problem:
        case = load_case(CASES / "ur10.yaml", data_root=DATA)
        only = case.recordings[0]
        edge = int(FITTED * len(only.t))
        first, rest = only.part(slice(0, edge)), only.part(slice(edge, None))
        return diagnosed("ur10", case, [first], [rest])

    def tx40() -> Problem:
        case = load_case(CASES / "staubli_tx40.yaml", data_root=DATA)
        return diagnosed("staubli_tx40", case, case.recordings, case.judged)

    found = {
        f"{remainder}_{arm}": partial(
            simulated, arm, remainder, out / f"{remainder}_{arm}"
        )
        for remainder in REMAINDERS
        for arm in ARMS
    }
    return {**found, "tx40": tx40, "ur10": ur10}


def study(problem: Problem, path: Path) -> dict[str, Any]:
    """Train and judge the network and the trees, with the physics apart and, for the price of it, not."""
    fit, judge = problem
    start = time.process_time()
    residual, fitted = fit_residual(fit, ResidualSettings())
    seconds = time.process_time() - start
    write_residual(residual, path)
    left = {"nothing": torque_left(judge, None)}
    left["network"] = torque_left(judge, residual.torque)
    for apart in APART:
        own = ResidualSettings(apart=apart)
        trees = boosted_trees(rows_of(fit, own))
        left[f"trees_{apart}"] = torque_left(judge, trees)
        for form in (ADDITIVE, "mlp"):
            alone, _ = fit_residual(fit, replace(own, form=form))
            left[f"{form}_{apart}"] = torque_left(judge, alone.torque)
    return {
        **left,
        "apart": fitted.apart,
        "form": fitted.form,
        "closed": fitted.closed,
        "gain": fitted.gain,
        "in_target": fitted.in_target,
        "in_output": fitted.in_output,
        "moves": [float(x.max(initial=0.0)) for x in fitted.moves],
        "seconds": seconds,
    }


WAYS = [f"{what}_{apart}" for apart in APART for what in (ADDITIVE, "mlp", "trees")]
"""What is compared: each form, and trees, on what either way to keep apart leaves to them."""


def table(found: dict[str, dict[str, Any]]) -> str:
    """What each leaves of each joint."""
    rows = []
    for name, one in found.items():
        for key in ("nothing", "network", *WAYS):
            cells = [f"{x:.3g}" for x in one[key]]
            if key == "network":
                pairs = zip(cells, one["form"], strict=True)
                cells = [f"{cell} {form[:1]}" for cell, form in pairs]
            title = name if key == "nothing" else ""
            rows.append([title, key, *cells, *[""] * (7 - len(cells))])
    head = ["problem", "", *(f"J{j}" for j in range(1, 8))]
    return f"{markdown(head, rows)}\n\na: additive, m: MLP, none: silent\n"


def summary(found: dict[str, dict[str, Any]]) -> str:
    """Geometric means over joints of what is left over nothing, what was chosen, and the shares in the physics."""
    head = ["remainder", "joints", "no worse than nothing", "network"]
    head += ["apart from effects alone", "additive, MLP, silent", *WAYS]
    rows = []
    for kind in (*REMAINDERS, "tx40", "ur10", ""):
        own = [one for name, one in found.items() if name.startswith(kind)]
        if own:
            rows.append([kind or "all", *_row(own)])
    shares = max(one["in_output"][1] for one in found.values())
    moves = max(one["moves"][1] for one in found.values())
    seconds = [one["seconds"] for one in found.values()]
    return (
        f"{markdown(head, rows)}\n\nShare of the output in the span of the physics: at most {shares:.1e}; a parameter "
        f"would move by at most {moves:.1e} standard deviations. "
        f"Processor time of a training: {min(seconds):.0f} to {max(seconds):.0f} s.\n"
    )


def _row(own: Sequence[dict[str, Any]]) -> list[str]:
    """Counts, and geometric means over joints of what is left over nothing."""
    keys = ("nothing", "network", *WAYS)
    left = {key: np.concatenate([one[key] for one in own]) for key in keys}
    nothing = left["nothing"]
    forms = [form for one in own for form in one["form"]]
    counts = [len(nothing), int((left["network"] <= EVEN * nothing).sum())]
    ratios = [f"{np.exp(np.log(left[key] / nothing).mean()):.2f}" for key in keys[1:]]
    free = sum(one["apart"] == "effects" for one in own)
    chosen = ", ".join(str(forms.count(form)) for form in (ADDITIVE, "mlp", ""))
    return [*map(str, counts), ratios[0], f"{free} of {len(own)}", chosen, *ratios[1:]]


def main() -> None:
    """Study each problem that is not there yet, and print the tables."""
    arguments = command_line(
        __doc__, out=Path("out/residual"), table=False, only=str
    ).parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    found = {}
    for name, make in problems(arguments.out).items():
        path = arguments.out / f"{name}.json"
        wanted = not arguments.table and arguments.only in (None, name)
        if wanted or path.is_file():
            network = arguments.out / f"{name}.npz"
            found[name] = kept(path, lambda m=make, n=network: study(m(), n))
    if found:
        print(table(found))
        print(summary(found))


if __name__ == "__main__":
    main()
