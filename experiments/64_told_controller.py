"""Gains and feedforward of controllers that nobody stated, told without any torque; prints the tables as Markdown.

    GAPSCOPE_DATA=.../data .venv/bin/python experiments/64_told_controller.py --out out/told [--arms 36] [--go2]

Arms of the blind check's generator, whose laws are not the catalogue's, under PD with each feedforward, gains of half,
of the same and of twice the bandwidth, at 50 to 500 Hz, with usual and threefold encoder noise, nominal inertials up to
3 % off, some with a load. Of each, positions and references alone are read. Resumable: each arm has a result file.
``--go2``: the legs of the Go2, whose gains are known. Needs the extra ``blind``.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from common import command_line
from generator_arms import recorded, write_side
from real_carriers import LEGS, go2_leg

from gapscope.arm.case import Case, load_case
from gapscope.arm.control import FEEDFORWARDS
from gapscope.arm.io.json_file import plain, read_json, write_json
from gapscope.blind_check.generator.arms import USUAL
from gapscope.blind_check.generator.case import (
    draw_cause,
    draw_setup,
    fed_forward,
    needed_torque,
)
from gapscope.blind_check.generator.laws import LAWS
from gapscope.blind_check.generator.simulate import STRONG, Conditions
from gapscope.diagnosis.told_controller import told_controller
from gapscope.envs.effect_ranges import Z95

SEED = 61
RATES, NOISES, BANDWIDTHS = (50, 100, 250, 500), (1.0, 3.0), (0.5, 1.0, 2.0)
"""Of the recordings [Hz], of the encoders and of the loop over the usual [1]."""


def made(number: int, folder: Path) -> dict[str, Any] | None:
    """Write the case of an arm; what is true of it, or nothing if the loop does not run well."""
    rng = np.random.default_rng((SEED, number))
    conditions = Conditions(
        robot=USUAL[number % len(USUAL)],
        inertials_off=0.03,
        rate=RATES[number % 4],
        noise=NOISES[number // 2 % 2],
        duration=(8.0, 12.0),
    )
    setup = draw_setup(conditions, rng)
    if setup is None:
        return None
    loop, wider = setup.loop, BANDWIDTHS[number // 3 % 3]
    kind = FEEDFORWARDS[number % 3]
    loop = loop._replace(kp=loop.kp * wider**2, kd=loop.kd * wider, feedforward=kind)
    torques = []
    for motion in setup.motions:
        needed = needed_torque(setup.arm, setup.model, motion)
        torques.append(fed_forward(kind, setup.model, motion, needed))
    setup = replace(setup, loop=loop, ahead=torques)
    laden = number % 3 != 2 and number // 3 % 3 == 2
    cause = draw_cause(LAWS["payload"], setup, STRONG[0], rng) if laden else None
    plant = setup.plant([cause] if cause else [])
    rows = recorded(setup, plant, range(len(setup.motions) - 1))
    if rows is None:
        return None
    write_side(setup, rows, folder, bare=False, poor=False)
    return {
        "feedforward": kind,
        "kp": loop.kp,
        "kd": loop.kd,
        "rate": conditions.rate,
        "laden": cause is not None,
    }


def told(case: Case) -> dict[str, Any]:
    """What is told of a case by positions and references."""
    bare = tuple(replace(r, tau=None) for r in case.recordings)
    case = replace(case, controller=None, recordings=bare, judged=())
    found = told_controller(case)
    entry = found.entry()
    return {**entry, "gains": found.gains, "std": found.std}


def judged(number: int, out: Path) -> dict[str, Any]:
    """Truth and answer of an arm, made unless they are there."""
    file = out / f"{number:03d}.json"
    if not file.is_file():
        folder = out / "cases" / f"{number:03d}"
        if folder.is_dir():
            content = dict(read_json(out / f"truth{number:03d}.json", "remove it"))
        else:
            content = made(number, folder) or {}
            write_json(plain(content), out / f"truth{number:03d}.json")
        if content:
            content["told"] = told(load_case(folder))
        write_json(plain(content), file)
    return dict(read_json(file, "remove it"))


def table(results: list[dict[str, Any]]) -> None:
    """Errors of the gains: by feedforward without a load, and with one."""
    print("| arms | law right | joints told | kp: median error, within | kd |")
    print("|---|---|---|---|---|")
    kinds = {
        kind: [r for r in results if r["feedforward"] == kind] for kind in FEEDFORWARDS
    }
    rows = {kind: [r for r in own if not r["laden"]] for kind, own in kinds.items()}
    rows["with an unknown load"] = [r for r in results if r["laden"]]
    for name, own in rows.items():
        right = sum(r["told"]["feedforward"] == r["feedforward"] for r in own)
        joints = [
            (r, j, k)
            for r in own
            for j, known in enumerate(r["told"]["kp"]["interval"])
            for k in (0, 1)
            if known
        ]
        every = sum(len(r["kp"]) for r in own)
        texts = []
        for k, gain in enumerate(("kp", "kd")):
            mine = [(r, j) for r, j, of in joints if of == k]
            errors = [abs(r["told"]["gains"][j][k] / r[gain][j] - 1) for r, j in mine]
            within = []
            for r, j in mine:
                low, high = r["told"][gain]["interval"][j]
                within.append(low <= r[gain][j] <= high)
            if mine:
                texts.append(f"{np.median(errors):.1%}, {np.mean(within):.0%}")
        found = f"{right} of {len(own)} | {len(joints) // 2} of {every}"
        print(f"| {name} | {found} | {' | '.join(texts or ['', ''])} |")


def go2(out: Path) -> None:
    """Print what is told of the legs of the Go2."""
    for leg in LEGS:
        found = told_controller(go2_leg(leg, out))
        half = Z95 * found.std
        for k, gain in enumerate(("kp", "kd")):
            pairs = zip(found.gains[:, k], half[:, k], strict=True)
            said = ", ".join(f"{value:.3g} ± {of:.2g}" for value, of in pairs)
            print(f"{leg} {gain}: {said}; delay {found.delay:.4f} s")


def main() -> None:
    """Make, ask and print."""
    defaults = {"out": "out/told", "arms": 36, "first": 0, "go2": False}
    options = command_line(__doc__, **defaults).parse_args()
    out = Path(options.out)
    (out / "cases").mkdir(parents=True, exist_ok=True)
    if options.go2:
        go2(out)
        return
    results = []
    for number in range(options.first, options.arms):
        result = judged(number, out)
        if "told" in result:
            results.append(result)
    print(f"95 % intervals are {Z95:g} standard deviations.")
    table(results)


if __name__ == "__main__":
    main()
