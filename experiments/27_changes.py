"""Changes during a recording: found, missed and false, over arms, sizes, noise, healthy and real recordings.

Tables: (1) arms of the blind check's generator, another simulator with other laws of friction, vendor inertials 5 %
off: a load is picked up, friction of a joint rises, an encoder slips, or a torque constant falls, at a random moment of
one recording; and the same arms without change, also with every effect of the generator present throughout; rises of
friction are parted at ``SMALL`` of the joint's torque; (2) real arms, as they were recorded, and with the torque of a
load or of friction on the recorded motion added from some moment on. ``--healthy`` runs the arms without change alone.
``--out FILE.md`` writes them.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import track

from gapscope.arm.case import Case, load_case
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.io.atomic_write import atomic_write
from gapscope.arm.recording import Recording
from gapscope.blind_check.generator.arms import ROBOTS
from gapscope.blind_check.generator.case import (
    CaseSetup,
    MadeCase,
    draw_cause,
    draw_setup,
    write_case,
)
from gapscope.blind_check.generator.law import Cause
from gapscope.blind_check.generator.laws import LAWS, SETUP
from gapscope.blind_check.generator.simulate import STRONG, Conditions
from gapscope.blind_check.generator.true_arm import Columns, TrueArm
from gapscope.model.change_findings import (
    PAYLOAD,
    PLAIN_FRICTION,
    change_findings,
)
from gapscope.model.changes import changes_of
from gapscope.model.conditioning import condition, position_cutoff

CASES = Path(__file__).parent / "cases"
KEPT = tempfile.TemporaryDirectory(prefix="gapscope-")
"""Holds the URDF of every case until the end."""
REAL = (
    "staubli_tx40",
    "ur10",
    "kinova_gen3_current",
    "kinova_gen3_sensor",
    "panda",
    "kuka_med7",
    "unitree_z1",
)
LOADS = (0.1, 0.3, 0.7)
"""Loads picked up, over the largest that the arm carries [1]."""
RISES = (0.3, 0.6, 1.0)
"""Rise of a joint's friction, over that of its data sheet [1]."""
SLIPS = (1.0, 2.0, 5.0)
"""An encoder slips by so much [degrees]."""
FALLS = (0.1, 0.15, 0.2)
"""A torque constant falls by this share [1]."""
MASSES = (0.25, 0.5, 1.0, 2.0)
"""Loads put into recordings of real arms [kg]."""
SHARES = (0.05, 0.1, 0.2)
"""Coulomb friction put into them, over the RMS torque of the joint [1]."""
SMALL = 0.03
"""Rises of friction below this share of the joint's RMS torque are counted by themselves [1]."""
SOON, CLOSE = 0.5, 0.2
"""A change is found if its moment is off by at most this [s] and its first parameter by this share [1]."""


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

    group: str
    label: str
    truth: Truth | None
    found: list[dict[str, Any]]

    @property
    def hit(self) -> dict[str, Any] | None:
        """The finding of the change that was put in."""
        truth = self.truth
        for entry in self.found:
            if truth is None or entry["what"] != truth.what:
                continue
            same = entry["recording"] == truth.recording
            near = abs(entry["time"] - truth.moment) <= SOON
            if same and near and entry["joints"] == truth.joints:
                return entry
        return None

    @property
    def false(self) -> int:
        """Findings that are not the change that was put in."""
        return len(self.found) - (self.hit is not None)

    @property
    def error(self) -> float:
        """Relative error of mass or Coulomb friction [1]."""
        assert self.hit is not None and self.truth is not None
        found = self.hit["parameters"].get(self.truth.parameter, {"value": 0.0})
        return float(abs(found["value"] / self.truth.size - 1))

    @property
    def inside(self) -> bool:
        """Whether the interval holds the moment."""
        assert self.hit is not None and self.truth is not None
        low, high = self.hit["interval"]
        return bool(low <= self.truth.moment <= high)


def looked(case: Case, group: str, label: str, truth: Truth | None = None) -> Outcome:
    """What is found in a case."""
    found = change_findings(changes_of(case.recordings, case.arm).during)
    return Outcome(group, label, truth, found)


def generated(
    seeds: range, effects: bool, healthy: bool, console: Console
) -> Iterator[Outcome]:
    """Arms of the generator by turns, every second round with three times the encoder noise."""
    for seed in track(seeds, "generator", console=console):
        rng = np.random.default_rng([27, seed])
        noise = (1.0, 3.0)[seed // len(ROBOTS) % 2]
        robot = tuple(ROBOTS)[seed % len(ROBOTS)]
        conditions = Conditions(robot=robot, noise=noise, inertials_off=0.05)
        setup = next(s for _ in range(60) if (s := draw_setup(conditions, rng)))
        plain = setup.plant(())
        rows = recorded(setup, plain)
        if rows is None:
            continue
        kind = f"encoder noise x {noise:g}"
        yield looked(written(setup, plain, rows), "generator", f"healthy, {kind}")
        if healthy:
            continue
        yield from changed(setup, rows, rng, kind)
        yield from fallen(written(setup, plain, rows), rng, kind)
        if effects:
            yield from constant(setup, rng)


def recorded(setup: CaseSetup, plant: TrueArm) -> list[Columns] | None:
    """All recordings that may be fitted, or ``None`` if one cannot be used."""
    rows = [setup.run(plant, k) for k in range(len(setup.motions) - 1)]
    return None if any(r is None for r in rows) else [r for r in rows if r is not None]


def written(setup: CaseSetup, plant: TrueArm, rows: list[Columns]) -> Case:
    """The case as a user has it, through its files."""
    with tempfile.TemporaryDirectory() as folder:
        made = MadeCase(setup, plant, (), [*rows, rows[0]], {})
        path = Path(folder)
        write_case(made, "case", False, path / "case", path / "unseen.csv")
        case = load_case(path / "case")
        # the nominal arm's dynamics is built while its URDF is there
        RigidBody(case.arm)
        keep = Path(tempfile.mkdtemp(dir=KEPT.name)) / "robot.urdf"
        keep.write_text(case.arm.urdf.read_text(encoding="utf-8"), encoding="utf-8")
    return replace(case, arm=replace(case.arm, urdf=keep))


def changed(
    setup: CaseSetup, rows: list[Columns], rng: np.random.Generator, kind: str
) -> Iterator[Outcome]:
    """Loads picked up, friction that rises, encoders that slip, each in one recording."""
    for what, sizes in ((_load, LOADS), (_friction, RISES), (_slip, SLIPS)):
        for size in sizes:
            which = int(rng.integers(len(rows)))
            moment = float(rng.uniform(0.25, 0.75) * setup.motions[which].t[-1])
            later = setup.plant(())
            truth = what(setup, later, size, rng)
            truth = replace(
                truth, recording=f"recording_{'abcd'[which]}.csv", moment=moment
            )
            run = setup.run(setup.plant(()), which, (moment, later))
            if run is None:
                continue
            if what is _friction:
                torque = run["tau"][:, truth.joints[0] - 1]
                small = truth.size < SMALL * float(np.sqrt(np.mean(torque**2)))
                part = f"{'below' if small else 'from'} {SMALL:.0%} of the torque"
                truth = replace(truth, label=f"{truth.label}, {part}")
            every = [run if k == which else own for k, own in enumerate(rows)]
            given = written(setup, setup.plant(()), every)
            yield looked(given, "generator", f"{truth.label}, {kind}", truth)


def fallen(case: Case, rng: np.random.Generator, kind: str) -> Iterator[Outcome]:
    """Torque constants that fall, each in one recording: the arm moves as before, its drives count otherwise."""
    for share in FALLS:
        which = int(rng.integers(len(case.recordings)))
        joint = int(rng.integers(case.arm.n_joints))
        own = case.recordings[which]
        moment = float(rng.uniform(0.25, 0.75) * own.duration)
        tau = np.asarray(own.tau).copy()
        tau[own.t - own.t[0] > moment, joint] *= 1.0 - share
        changed_one = replace(own, tau=tau)
        recordings = tuple(changed_one if r is own else r for r in case.recordings)
        # applied = (1 + s) recorded
        value = 1.0 / (1.0 - share) - 1.0
        truth = Truth(
            what="torque_scale",
            joints=[joint + 1],
            parameter="scale",
            label=f"torque constant falls by {share:.0%}",
            recording=own.name,
            moment=float(own.t[0]) + moment,
            size=value,
        )
        given = replace(case, recordings=recordings)
        yield looked(given, "generator", f"{truth.label}, {kind}", truth)


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


def constant(setup: CaseSetup, rng: np.random.Generator) -> Iterator[Outcome]:
    """Every effect of the generator, present from the first to the last sample; set-up faults are repaired before."""
    for name, law in LAWS.items():
        cause = None if name in SETUP else draw_cause(law, setup, STRONG[0], rng)
        if cause is None:
            continue
        plant = setup.plant([cause])
        rows = recorded(setup, plant)
        if rows is None:
            continue
        for spoil in plant.spoil:
            rows = [spoil(own, rng) for own in rows]
        yield looked(written(setup, plant, rows), "generator", f"no change, {name}")


def real(console: Console) -> Iterator[Outcome]:
    """Real arms as recorded, and with a change put into the longest recording."""
    for name in track(REAL, "real arms", console=console):
        case = load_case(CASES / f"{name}.yaml", any_unit=True)
        yield looked(case, f"real, {name}", "as recorded")
        longest = max(case.recordings, key=lambda recording: recording.duration)
        for part in (0.4, 0.6):
            moment = float(longest.t[0] + part * longest.duration)
            yield from _put_in(case, longest, moment, name)


def _put_in(
    case: Case, recording: Recording, moment: float, name: str
) -> Iterator[Outcome]:
    """Loads at the last link's frame, 5 cm along its axis, and Coulomb friction of each joint by turns."""
    torque = np.asarray(recording.tau)
    body = RigidBody(case.arm)
    for mass in MASSES:
        one = [mass, 0.0, 0.0, 0.05 * mass, *np.zeros(6)]
        added = _on_rows(recording, body, np.array(one))
        label = f"load of {mass:g} kg"
        truth = Truth(PAYLOAD, [], "mass", label, recording.name, moment, mass)
        yield _with(case, recording, added, truth, name)
    for k, share in enumerate(SHARES):
        joint = k % case.arm.n_joints
        size = share * float(np.sqrt(np.mean(torque[:, joint] ** 2)))
        speed = np.gradient(recording.q[:, joint], recording.t)
        added = np.zeros_like(torque)
        added[:, joint] = size * np.tanh(_smooth(speed, recording.rate) / 0.01)
        place = [joint + 1], "coulomb"
        label = f"Coulomb friction, {share:.0%} of the joint's torque"
        truth = Truth(PLAIN_FRICTION, *place, label, recording.name, moment, size)
        yield _with(case, recording, added, truth, name)


def _on_rows(
    recording: Recording, body: RigidBody, parameters: np.ndarray
) -> np.ndarray:
    """Torque of a body on the last link along the recorded motion [N m], (N, n)."""
    segments = condition(recording, position_cutoff((recording,)))
    t = np.concatenate([s.motion.t for s in segments])
    parts = []
    for segment in segments:
        m = segment.motion
        parts.append(body.last_link_regressor(m.q, m.dq, m.ddq) @ parameters)
    torque = np.concatenate(parts)
    columns = [np.interp(recording.t, t, column) for column in torque.T]
    return np.stack(columns, axis=1)


def _smooth(series: np.ndarray, rate: float) -> np.ndarray:
    """Mean over 40 ms."""
    width = max(1, round(0.04 * rate))
    return np.convolve(series, np.ones(width) / width, mode="same")


def _with(
    case: Case, recording: Recording, added: np.ndarray, truth: Truth, name: str
) -> Outcome:
    """The case with a torque added to a recording from the moment on."""
    after = (recording.t > truth.moment)[:, None]
    spoiled = replace(recording, tau=np.asarray(recording.tau) + after * added)
    recordings = tuple(spoiled if r is recording else r for r in case.recordings)
    given = replace(case, recordings=recordings)
    return looked(given, f"real, {name}", truth.label, truth)


def table(outcomes: list[Outcome]) -> str:
    """A row per group and kind: changes put in, found, missed, false, and how far off."""
    lines = [
        "| recordings | change | cases | found | missed | false | moment off by (median, s) "
        f"| in its interval | size off by (median) | within {SOON:g} s and {CLOSE:.0%} |",
        "|" + "---|" * 10,
    ]
    keys = list(dict.fromkeys((o.group, o.label) for o in outcomes))
    for group, label in keys:
        own = [o for o in outcomes if (o.group, o.label) == (group, label)]
        given = [o for o in own if o.truth is not None]
        hits = [o for o in given if o.hit is not None]
        false = sum(o.false for o in own)
        off = [abs(o.hit["time"] - o.truth.moment) for o in hits if o.hit and o.truth]
        errors = [o.error for o in hits]
        missed = len(given) - len(hits)
        inside = sum(o.inside for o in hits)
        good = sum(error <= CLOSE for error in errors)
        medians = (
            (f"{np.median(off):.3f}", inside, f"{np.median(errors):.1%}")
            if hits
            else ("", "", "")
        )
        cells = [group, label, len(own), len(hits), missed, false, *medians, good]
        if not given:
            cells[3] = cells[4] = cells[9] = ""
        lines.append("| " + " | ".join(map(str, cells)) + " |")
    return "\n".join(lines)


def main() -> None:
    """Run, print and write the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--arms", type=int, default=14, help="of the generator")
    parser.add_argument("--first", type=int, default=0, help="number of the first arm")
    parser.add_argument("--effects", action="store_true", help="with every effect, too")
    parser.add_argument("--healthy", action="store_true", help="without change alone")
    parser.add_argument("--no-real", action="store_true")
    parser.add_argument("--out", type=Path, default=None)
    options = parser.parse_args()
    console = Console()
    seeds = range(options.first, options.first + options.arms)
    outcomes = list(generated(seeds, options.effects, options.healthy, console))
    if not options.no_real:
        outcomes += real(console)
    text = table(outcomes)
    print(text)
    if options.out:
        with atomic_write(options.out) as aside:
            aside.write_text(text + "\n", encoding="utf-8")
        console.print(f"wrote {options.out}")


if __name__ == "__main__":
    main()
