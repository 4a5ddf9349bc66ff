"""Motors at their edge: torque that falls with speed or with heat, in the generator's own forms, and a real carriage.

    .venv/bin/python experiments/63_motor_limits.py [--draws 2]

Voltage and current clamp of the generator meet in a round corner, and its torque constant falls with the copper loss.
For each arm: the torque gap of its widest joint for the nominal arm, beside the true values in the catalogue's law, and
what a diagnosis names. The carriage is EMPS, in ``$GAPSCOPE_DATA``, which is far from its limits.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from common import CASES, DATA, command_line, markdown, names_of

from gapscope.arm.case import Case, load_case
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.root_mean_square import rms
from gapscope.blind_check.generator.case import MadeCase, make_case, write_case
from gapscope.blind_check.generator.law import Draws, Law, LawValues
from gapscope.blind_check.generator.laws import LAWS
from gapscope.blind_check.generator.simulate import STRONG, CaseSpec, Conditions
from gapscope.diagnosis.diagnose import diagnose
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected import CorrectedArm
from gapscope.model.rows import Rows
from gapscope.model.torque_gap import gap_on_rows

ROBOTS = ("ur5_like", "franka_panda", "kuka_iiwa", "xarm6")
HEAT = {"fading": "share", "rated": "load", "warming_time": "time"}
"""Parameters of ``torque_scale`` by the generator's values."""
ENVELOPE = "torque_speed_limit"
KINDS = {"envelope": ENVELOPE, "heat": "fading_torque_constant"}
"""Name of each kind's law in the generator."""
HEAD = ("arm", "law", "gap", "beside the true values", "named")


def envelope(draws: Draws) -> LawValues:
    """A torque limit that falls beyond a corner speed."""
    # the mean square speed is a third of the largest one, about
    no_load = draws.uniform(2.6, 3.6) * draws.speed
    corner = draws.uniform(0.2, 0.5) * no_load
    share = draws.uniform(0.7, 0.95)
    limit = share * draws.peak
    return {
        "limit": limit,
        "corner_speed": corner,
        "no_load_speed": no_load,
        "stall": limit * no_load / (no_load - corner),
        "share": share,
    }


LAW = Law(
    "torque_saturation",
    envelope,
    units={"limit": "N m", "corner_speed": "rad/s", "no_load_speed": "rad/s"},
    puts={"clamp": "limit", "stall": "stall", "no_load": "no_load_speed"},
    powers={"limit": -1, "stall": -1, "share": -1},
    joints="one",
    largest={"share": -0.4},
)
"""A law of the generator that sealed sets do not draw: a line of the voltage, rounded off where it meets the clamp."""


def truth(made: MadeCase, law: str) -> AppliedEffect:
    """What the arm has, as an effect of the catalogue."""
    (cause,) = made.causes
    joints = tuple((cause.joints + 1).tolist())
    if law == "heat":
        values = {name: cause.values[own] for name, own in HEAT.items()}
        values["scale"] = np.zeros(len(joints))
        return AppliedEffect("torque_scale", joints, values)
    names = ("limit", "corner_speed", "no_load_speed")
    values = {name: cause.values[name] for name in names}
    return AppliedEffect("torque_saturation", joints, values)


def gap(case: Case, effects: tuple[AppliedEffect, ...]) -> np.ndarray:
    """Torque NRMSE of each joint, (n,)."""
    rows = Rows.recorded([case.recordings])
    left = gap_on_rows(rows, CorrectedArm(case.arm, effects), RigidBody(case.arm))
    return rms(left) / rows.scale


def rows(draws: int) -> Iterator[list[str]]:
    """The table."""
    for law, robot in ((law, robot) for law in KINDS for robot in ROBOTS[:draws]):
        with tempfile.TemporaryDirectory() as aside:
            folder, unseen = Path(aside) / "case", Path(aside) / "unseen.csv"
            conditions = Conditions(robot, inertials_off=0.01)
            spec = CaseSpec("single", (KINDS[law],), STRONG[1], conditions)
            made = make_case(spec, (61, ROBOTS.index(robot)))
            write_case(made, robot, False, folder, unseen)
            case = load_case(folder)
            none, known = gap(case, ()), gap(case, (truth(made, law),))
            widest = int(none.argmax())
            named = names_of({"document": diagnose(case).document})
        gaps = [f"{x[widest]:.3f}" for x in (none, known)]
        yield [robot, law, *gaps, ", ".join(named) or "nothing"]


def main() -> None:
    """Print the table."""
    options = command_line(__doc__, draws=2).parse_args()
    LAWS[ENVELOPE] = LAW
    table = list(rows(options.draws))
    if DATA.is_dir():
        case = load_case(CASES / "emps.yaml")
        named = names_of({"document": diagnose(case).document})
        table.append(["EMPS", "none", "", "", ", ".join(named) or "nothing"])
    print(markdown(HEAD, table))


if __name__ == "__main__":
    main()
