"""Changes during a recording: found, missed and false, over arms, sizes, noise, healthy and real recordings.

Arms are those of the blind check's generator, another simulator with other laws of friction, vendor inertials 5 % off:
a load is picked up, friction of a joint rises, an encoder slips, or a torque constant falls, at a random moment of one
recording; and the same arms without change. Rises of friction are parted at ``SMALL`` of the joint's torque. Then real
arms as they were recorded, and with a change that the real benchmark's laws put into their longest recording, a push of
a few seconds among them. ``--healthy`` runs the arms without change alone.

Each case is a file in ``--out``, so that a run goes on where one before it ended; every arm has all kinds before the
next size of any. ``--table`` prints what is there.
"""

from __future__ import annotations

import argparse
import itertools
import tempfile
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from common import command_line, markdown, run_missing, share_text
from generator_arms import recorded, write_side
from real_carriers import ARMS, left, load_carrier, model_residual, prepare_arm
from real_cases import draw
from real_laws import Scene

from gapscope.arm.case import Case, load_case
from gapscope.arm.errors import ModelWarning
from gapscope.arm.root_mean_square import rms
from gapscope.blind_check.generator.arms import ROBOTS
from gapscope.blind_check.generator.case import CaseSetup, draw_setup
from gapscope.blind_check.generator.law import Cause
from gapscope.blind_check.generator.laws import LAWS
from gapscope.blind_check.generator.simulate import Conditions
from gapscope.blind_check.generator.true_arm import Columns, TrueArm
from gapscope.model.changes import (
    PAYLOAD,
    PLAIN_FRICTION,
    change_findings,
    changes_of,
)

LOADS = (0.1, 0.3, 0.7)
"""Loads picked up, over the largest that the arm carries [1]."""
RISES = (0.3, 0.6, 1.0)
"""Rise of a joint's friction, over that of its data sheet [1]."""
SLIPS = (1.0, 2.0, 5.0)
"""An encoder slips by so much [degrees]."""
FALLS = (0.1, 0.15, 0.2)
"""A torque constant falls by this share [1]."""
TIMES = (4.0, 8.0)
"""RMS of a change on a real arm over what a full model leaves of it [1]."""
SMALL = 0.03
"""Rises of friction below this share of the joint's RMS torque are counted by themselves [1]."""
SOON = 0.5
"""A change is found if its moment is off by at most this [s]."""
TRIES = 5
"""Draws of a change, until a loop stays a healthy one."""
HALF_WIDTH = 1.96
"""Standard deviations from the middle of a 95 % interval to its ends."""


@dataclass(frozen=True)
class Truth:
    """What was changed: ``what`` as the diagnosis calls it, size of the parameter that is judged, when and where."""

    what: str
    joints: list[int]
    parameter: str
    label: str
    recording: str = ""
    moment: float = 0.0
    size: float = 0.0


@dataclass(frozen=True)
class Outcome:
    """A change that was put in, or none, and what was found."""

    kind: str
    label: str
    truth: Truth | None
    found: list[dict[str, Any]]

    def like(self, where: bool = False, when: bool = False) -> dict[str, Any] | None:
        """The finding with the name of the change that was put in, at its joint and moment if that is asked."""
        truth = self.truth
        for entry in self.found:
            if truth is None or (entry["what"], entry["recording"]) != (
                truth.what,
                truth.recording,
            ):
                continue
            near = abs(entry["time"] - truth.moment) <= SOON
            if (entry["joints"] == truth.joints or not where) and (near or not when):
                return entry
        return None

    @property
    def hit(self) -> dict[str, Any] | None:
        """The finding of the change that was put in."""
        return self.like(where=True, when=True)

    @property
    def false(self) -> int:
        """Findings that are not the change that was put in; a push ends as well."""
        if self.truth is not None and self.truth.what == FORCE:
            return sum(entry["what"] != FORCE for entry in self.found)
        return len(self.found) - (self.hit is not None)

    @property
    def value(self) -> tuple[float, float]:
        """Relative error of the parameter that is judged [1], and over its standard deviation."""
        found = self.hit["parameters"].get(self.truth.parameter)
        if found is None:
            return 1.0, np.inf
        value, std = (np.ravel(found[key]) for key in ("value", "std"))
        # of a force how large it is
        if len(value) > 1:
            size = np.linalg.norm(value)
            value, std = [size], [np.linalg.norm(value * std) / size]
        error, std = float(value[0]) - self.truth.size, float(std[0])
        return abs(error / self.truth.size), abs(error) / max(std, 1e-12)

    @property
    def inside(self) -> bool:
        """Whether the interval holds the moment."""
        low, high = self.hit["interval"]
        return bool(low <= self.truth.moment <= high)


Look = Callable[[], Outcome | None]


def looked(case: Case, kind: str, label: str, truth: Truth | None = None) -> Outcome:
    """What is found in a case."""
    found = change_findings(changes_of(case.recordings, case.arm).during)
    return Outcome(kind, label, truth, found)


# Arms of the generator


def generated(seeds: range, options: argparse.Namespace) -> Iterator[tuple[str, Look]]:
    """Cases of arms by turns: all kinds of change in one size on every arm, then in the next size."""

    def task(seed: int, kind: str, size: float = 0.0) -> tuple[str, Look]:
        return f"{seed}_{kind}_{size:g}", partial(made, seed, kind, size)

    for turn in range(len(LOADS)):
        for seed in seeds:
            if turn == 0:
                yield task(seed, HEALTHY)
            for kind, (_, sizes) in KINDS.items():
                if not options.healthy:
                    yield task(seed, kind, sizes[(seed + turn) % len(sizes)])


@lru_cache(maxsize=1)
def drawn(seed: int) -> CaseSetup:
    """An arm with its motions; every second round of arms with three times the encoder noise."""
    rng = np.random.default_rng([27, seed])
    noise = (1.0, 3.0)[seed // len(ROBOTS) % 2]
    robot = tuple(ROBOTS)[seed % len(ROBOTS)]
    lengths = (8.0, 14.0)
    conditions = Conditions(robot, 0.05, noise, recordings=3, duration=lengths)
    return next(s for _ in range(60) if (s := draw_setup(conditions, rng)))


def made(seed: int, kind: str, size: float) -> Outcome | None:
    """A case of an arm, and what is found in it; ``None`` if it cannot be recorded."""
    setup = drawn(seed)
    rng = np.random.default_rng([27, seed, *kind.encode(), round(1000 * size)])
    plain_arm = setup.plant(())
    rows = recorded(setup, plain_arm, range(len(setup.motions) - 1))
    if rows is None or kind == HEALTHY:
        return rows and looked(written(setup, rows), kind, kind)
    for which in rng.integers(len(rows), size=TRIES).tolist():
        told = changed(setup, kind, size, which, rng)
        if told is not None:
            truth, rows[which] = told
            return looked(written(setup, rows), kind, truth.label, truth)
    return None


def changed(
    setup: CaseSetup, kind: str, size: float, which: int, rng: np.random.Generator
) -> tuple[Truth, Columns] | None:
    """A change at some moment of a recording, and that recording."""
    moment = float(rng.uniform(0.25, 0.75) * setup.motions[which].t[-1])
    later, factor = setup.plant(()), np.ones(setup.arm.n)
    truth = KINDS[kind][0](setup, later, size, rng)
    if kind == CONSTANT:
        # the arm moves as before, its drives count otherwise: applied = (1 + s) recorded
        factor[truth.joints[0] - 1] = 1.0 / (1.0 + truth.size)
    run = setup.run(setup.plant(()), which, (moment, later))
    if run is None:
        return None
    run = run | {"tau": np.where(run["t"][:, None] > moment, factor, 1.0) * run["tau"]}
    if kind == FRICTION:
        torque = run["tau"][:, truth.joints[0] - 1]
        small = truth.size < SMALL * rms(torque)
        part = f"{'below' if small else 'from'} {SMALL:.0%} of the torque"
        truth = replace(truth, label=f"{truth.label}, {part}")
    name = f"recording_{'abc'[which]}.csv"
    return replace(truth, recording=name, moment=moment), run


def written(setup: CaseSetup, rows: list[Columns]) -> Case:
    """The case as a user has it, through its files."""
    path = Path(tempfile.mkdtemp()) / "case"
    write_side(setup, rows, path, bare=False, poor=False)
    return load_case(path)


def _load(
    setup: CaseSetup, later: TrueArm, share: float, rng: np.random.Generator
) -> Truth:
    mass = share * setup.arm.payload
    x, y, z = rng.uniform([-0.04, -0.04, 0.0], [0.04, 0.04, 0.1])
    values = {"mass": np.array(mass), "com": np.array([x, y, z])}
    values |= {"radius": np.array(0.03), "top": np.array(1.0)}
    Cause(LAWS["payload"], np.array([], dtype=int), values).act(later)
    label = f"load, {share:.0%} of the largest"
    return Truth(PAYLOAD, [], "mass", label, size=mass)


def _friction(
    setup: CaseSetup, later: TrueArm, share: float, rng: np.random.Generator
) -> Truth:
    joint = int(rng.integers(setup.arm.n))
    size = share * float(setup.arm.coulomb[joint])
    later.add("coulomb", np.array([joint]), size)
    later.add("viscous", np.array([joint]), share * float(setup.arm.viscous[joint]))
    label = f"friction, +{share:.0%}"
    return Truth(PLAIN_FRICTION, [joint + 1], "coulomb", label, size=size)


def _slip(
    setup: CaseSetup, later: TrueArm, degrees: float, rng: np.random.Generator
) -> Truth:
    joint = int(rng.integers(setup.arm.n))
    size = float(np.radians(degrees) * rng.choice([-1.0, 1.0]))
    # the loop sees it, and moves the arm
    later.put("encoder", np.array([joint]), np.array([size]))
    label = f"encoder slips by {degrees:g} degrees"
    return Truth("encoder_offset", [joint + 1], "offset", label, size=size)


def _constant(
    setup: CaseSetup, later: TrueArm, share: float, rng: np.random.Generator
) -> Truth:
    joint = int(rng.integers(setup.arm.n)) + 1
    label = f"torque constant falls by {share:.0%}"
    value = 1.0 / (1.0 - share) - 1.0
    return Truth("torque_scale", [joint], "scale", label, size=value)


HEALTHY, FRICTION, CONSTANT = "healthy", "friction", "constant"
KINDS = {
    "load": (_load, LOADS),
    FRICTION: (_friction, RISES),
    "slip": (_slip, SLIPS),
    CONSTANT: (_constant, FALLS),
}
"""What puts in a change of each kind, and in which sizes."""


# Real arms


FORCE = "external_force"
PUT_IN = {
    "payload": (PAYLOAD, "mass", "mass"),
    "coulomb_friction": (PLAIN_FRICTION, "torque", "coulomb"),
    "encoder_offset": ("encoder_offset", "offset", "offset"),
    "torque_scale": ("torque_scale", "scale", "scale"),
    FORCE: (FORCE, "force", "force"),
}
"""What a law puts in as a diagnosis calls it, its size in the law's values, and the parameter that is judged."""


def carried(arm: str, law: str, times: float, out: Path) -> Outcome | None:
    """A real arm with a change in its longest recording, or as it was recorded; ``None`` if no size is possible."""
    folder = out / "carriers" / arm
    carrier = load_carrier(arm, folder)
    if not law:
        return looked(carrier, "real arms as recorded", arm)
    prepare_arm(arm, out)
    whole = load_case(folder / "whole")
    longest = max(carrier.recordings, key=lambda r: r.duration)
    residual = np.maximum(model_residual(carrier), left(whole))
    scene = Scene(longest, carrier.arm, whole.arm, residual)
    rng = np.random.default_rng([27, *f"{arm} {law} {times:g}".encode()])
    drawn = (draw(scene, law, times, rng) for _ in range(TRIES))
    # a change on two joints at once is two changes
    one = next((x for x in drawn if x is not None and len(x.joints) < 2), None)
    if one is None:
        return None
    changed, values = one.applied(scene, longest)
    moment = float(longest.t[0] + rng.uniform(0.3, 0.7) * longest.duration)
    if law == FORCE:
        # begins and ends by itself; half of it is there after half its rise
        moment = 0.9 * values["start"] + 0.1 * values["end"]
    else:
        before = longest.t < moment
        for name in ("q", "dq", "tau", "tau_sensor"):
            series = getattr(changed, name)
            if series is not None:
                series = np.where(before[:, None], getattr(longest, name), series)
                changed = replace(changed, **{name: series})
    what, named, parameter = PUT_IN[law]
    value = np.ravel(values[named])
    size = float(value[0] if len(value) == 1 else np.linalg.norm(value))
    joints = (one.joints + 1).tolist()
    label = f"{times:g} times what a full model leaves"
    truth = Truth(what, joints, parameter, label, longest.name, moment, size)
    recordings = tuple(changed if r is longest else r for r in carrier.recordings)
    case = replace(carrier, recordings=recordings)
    return looked(case, f"real arms, {law}", label, truth)


HEAD = ("change", "cases", "named", "and where", "and when", "false", "moment")
HEAD = (*HEAD, "off by (median, s)", "value", "off by (median)")


def table(outcomes: Sequence[Outcome]) -> str:
    """A row per kind, and per label: what was put in, what of it was told, what was false, and how far off."""
    kinds = {o.kind: [x for x in outcomes if x.kind == o.kind] for o in outcomes}
    rows = []
    for kind, own in kinds.items():
        rows.append(row(kind, own))
        labels = sorted({o.label for o in own} - {kind})
        rows += [row(f"- {x}", [o for o in own if o.label == x]) for x in labels]
    return markdown(HEAD, rows)


def row(name: str, own: Sequence[Outcome]) -> list[object]:
    """Cells of some outcomes; shares with Wilson's interval, moment and value those that lie in their intervals."""
    given = [o for o in own if o.truth is not None]
    told, off = [""] * 3, [""] * 4
    if given:
        by = ({}, {"where": True}, {"where": True, "when": True})
        named = [sum(o.like(**how) is not None for o in given) for how in by]
        told = [share_text(n, len(given)) for n in named]
    hits = [o for o in given if o.hit is not None]
    if hits:
        late = [abs(o.hit["time"] - o.truth.moment) for o in hits if o.hit and o.truth]
        errors, deviations = np.array([o.value for o in hits]).T
        inside = int((deviations <= HALF_WIDTH).sum())
        off = [
            share_text(sum(o.inside for o in hits), len(hits)),
            f"{np.median(late):.3f}",
            share_text(inside, len(hits)),
            f"{np.median(errors):.1%}",
        ]
    return [name, len(own), *told, sum(o.false for o in own), *off]


def main() -> None:
    """Run what is not there yet, and print the tables."""
    options = command_line(
        __doc__,
        no_real=False,
        out=Path("out/changes"),
        jobs=1,
        arms=(14, "of the generator"),
        first=(0, "number of the first arm"),
        healthy=(False, "without change alone"),
        table=(False, "of what is there"),
        limit=(600.0, "processor time of a case [s]"),
    ).parse_args()
    warnings.simplefilter("ignore", ModelWarning)
    seeds = range(options.first, options.first + options.arms)
    looks = dict(generated(seeds, options))
    if not options.no_real:
        changes = [("", 0.0), *itertools.product(PUT_IN, TIMES)]
        for arm, (law, times) in itertools.product(ARMS, changes):
            name = f"{arm}_{law}_{times:g}" if law else f"{arm}_as_recorded"
            looks[name] = partial(carried, arm, law, times, options.out)
    files = {options.out / f"{name}.json": look for name, look in looks.items()}
    if options.table:
        files = {file: look for file, look in files.items() if file.is_file()}

    def looked_at(look: Look) -> dict[str, Any] | None:
        # all that a case writes goes when this is over, and with it the process
        with tempfile.TemporaryDirectory(prefix="gapscope-") as tempfile.tempdir:
            outcome = look()
        return None if outcome is None else asdict(outcome)

    there = run_missing(looked_at, files, options.jobs, options.limit)
    outcomes = []
    for one in there:
        if one is not None:
            truth = one.pop("truth")
            outcomes.append(Outcome(**one, truth=truth and Truth(**truth)))
    print(table(outcomes))
    print(f"\n{len(looks) - len(there)} of {len(looks)} cases have no result")


if __name__ == "__main__":
    main()
