"""Estimators where the motion determines little: torque left on other motions, beside the nominal arm's.

Arms that pinocchio alone moves: bodies up to 25 % off, friction and rotors half stated, 1 % noise. Three recordings of
10 s stay within ``--reach`` rad of their middle; two others, at full speed, are held out. The table has the RMS of what
is left over the RMS of the torque there, median and worst over arms and draws, and how often it is more than the
nominal arm leaves.

    python experiments/59_little_motion.py --draws 3
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import NamedTuple, NoReturn

import numpy as np
from common import command_line, markdown
from pinocchio_arms import FORM_ARMS, FORMS, FormArm

from gapscope.arm.case import Case
from gapscope.arm.errors import InputError
from gapscope.ident.estimators.by_name import METHODS, SIMULATING, Given
from gapscope.ident.identification import (
    FittedParameters,
    IdentificationSettings,
    fit_parameters,
    model_value,
    predicts_worse,
    validated,
)
from gapscope.ident.samples import count_samples

FIT, JUDGE, NOISE, STATED = 3, 2, 0.01, 0.5
"""Recordings to fit and to judge, noise over the torque's deviation, and share of friction that is stated."""


def little_motion(
    arm: FormArm, friction: str, reach: float, rng: np.random.Generator
) -> Case:
    """A case of small motions, judged on large ones."""
    motions = arm.motions(rng, FIT, reach) + arm.motions(rng, JUDGE)
    stated = replace(
        arm.model,
        armature=STATED * arm.rotors,
        coulomb=STATED * arm.coulomb,
        viscous=STATED * arm.viscous,
    )
    recordings = arm.recorded(FORMS[friction], NOISE, motions)
    return Case(arm.model.name, Path(), stated, recordings[:FIT], recordings[FIT:])


class Left(NamedTuple):
    """Share of the torque held out that a model leaves [1], and whether it is said to be worse than the nominal arm."""

    share: float
    said: bool


def left(fitted: FittedParameters) -> dict[str, Left]:
    """What the nominal arm and each estimator leave; estimators that simulate are not asked."""
    nominal = fitted.columns.nominal(fitted.choice.law)
    given = Given(fitted.base, nominal, _no_simulation)
    values = {"nominal": nominal}
    for name, method in METHODS.items():
        if name in SIMULATING:
            continue
        try:
            beta = method.make(given)(fitted.problem).value
        except InputError:
            # the nominal arm has a body that cannot exist
            continue
        values[name] = model_value(fitted, name, beta)
    segments = fitted.samples.band.segments(fitted.held_out)
    counted = count_samples(fitted.samples, fitted.base.count).per_parameter
    out = {}
    for name, value in values.items():
        fit = validated(fitted, value, "fit", fitted.samples.segments)
        judged = validated(fitted, value, "judge", segments)
        out[name] = Left(judged.every.overall, predicts_worse(fit, judged, counted))
    return out


def _no_simulation() -> NoReturn:
    raise AssertionError("no estimator here simulates")


def main() -> None:
    """Print the table."""
    parser = command_line(__doc__, draws=3)
    parser.add_argument(
        "--reach", type=float, default=0.08, help="of the motions to fit [rad]"
    )
    parser.add_argument("--arms", nargs="+", choices=FORM_ARMS, default=list(FORM_ARMS))
    parser.add_argument("--friction", choices=FORMS, default="sharp Coulomb")
    options = parser.parse_args()
    rows: list[dict[str, Left]] = []
    for name, draw in product(options.arms, range(options.draws)):
        rng = np.random.default_rng([59, list(FORM_ARMS).index(name), draw])
        arm = FormArm.drawn(FORM_ARMS[name], rng)
        case = little_motion(arm, options.friction, options.reach, rng)
        rows.append(left(fit_parameters(case, IdentificationSettings())))
        shown = ", ".join(f"{key} {own.share:.1%}" for key, own in rows[-1].items())
        print(f"{name} {draw}: {shown}", flush=True)
    table = []
    for name in rows[0]:
        some = [row for row in rows if name in row]
        shares = np.array([row[name].share for row in some])
        worse = sum(row[name].share > row["nominal"].share for row in some)
        said = sum(row[name].said for row in some)
        of_all = f"{worse} of {len(some)}"
        figures = [f"{np.median(shares):.1%}", f"{shares.max():.1%}"]
        table.append([name, *figures, of_all, said])
    head = ("estimator", "median", "worst", "worse than nominal", "said")
    print(f"\n{markdown(head, table)}")


if __name__ == "__main__":
    main()
