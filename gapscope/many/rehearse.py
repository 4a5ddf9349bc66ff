"""Rehearse: effects of known size put into the recordings of a case, each diagnosed: what would be found here?"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from operator import itemgetter
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple
from zlib import crc32

import numpy as np

from gapscope.arm.case import Case
from gapscope.arm.display import effect_name
from gapscope.arm.errors import GapscopeError, InputError
from gapscope.arm.io.json_file import plain
from gapscope.arm.io.locked_section import locked
from gapscope.arm.joint_units import joint_unit
from gapscope.arm.nearest_name import check_known
from gapscope.arm.nominal import NominalArm, arm_entry
from gapscope.arm.recording import Recording
from gapscope.blind_check.generator.recorded import (
    RECORDED_LAWS,
    Changed,
    Put,
    RecordedLaw,
    Scene,
    Values,
)
from gapscope.blind_check.scoring import VECTORS
from gapscope.diagnosis.document.numbers import number_rows, place_text
from gapscope.diagnosis.document.wording import acts_on, called
from gapscope.diagnosis.prepare import Progress, silent
from gapscope.effects.arm_scale import ArmScale
from gapscope.effects.catalogue import CATALOGUE
from gapscope.effects.severity import draw
from gapscope.interface.models import case_of
from gapscope.interface.result import Document, DocumentResult
from gapscope.many.batch import diagnose_missing
from gapscope.provenance import KEY, made_from
from gapscope.reports.rehearsal import sentence, summary, write_page

SIZES = ("half", "nine_of_ten", "severity")
"""Sizes that are put in: those that ``expected`` of the recordings says would be named in half and in nine of ten
cases, and one that is usual on real arms, drawn from the catalogue; the last also where the others are not known."""
ROUNDS = 4
"""Times that a size is corrected: laws are proportional to it, or nearly so."""
AS_IS = "as_is"
"""Name of the diagnosis into which nothing was put."""


class Planned(NamedTuple):
    """An effect to be put in.

    Attributes:
        law: the law.
        joint: from 1; 0 for the arm.
        chance: one of ``SIZES``.
        size: of its parameter, or the length of several, SI, joint side.
    """

    law: RecordedLaw
    joint: int
    chance: str
    size: float

    @property
    def name(self) -> str:
        """Name of its diagnosis."""
        return f"{self.law.name}_{self.joint}_{self.chance}"


def size_parameters(effect: str) -> tuple[str, ...]:
    """The parameters of an effect whose length is its size."""
    return VECTORS.get(effect, CATALOGUE[effect].names[:1])


def size_of(effect: str, values: Values) -> float:
    """Size of an effect on one place, by the values of its parameters."""
    parts = [np.ravel(values[name]) for name in size_parameters(effect)]
    return float(np.linalg.norm(np.concatenate(parts)))


def put_in(case: Case, planned: Planned, seed: int) -> Case:
    """The case with an effect in all of its recordings, by one draw of what the law leaves open.

    Args:
        case: with torque in every recording.
        planned: what is put in.
        seed: of the draw.
    """
    # a seed of its own: what else is planned changes no draw
    rng = np.random.default_rng([seed, crc32(planned.name.encode())])
    law, arm = planned.law, case.arm
    # sized where most motion shows it; then the same on all recordings
    longest = max((*case.recordings, *case.judged), key=lambda r: r.duration)
    # empty for an effect on the arm
    joints = np.array([planned.joint - 1] * (planned.joint > 0), dtype=int)
    drawn = law.draw(rng, Scene(longest, arm, arm), joints)
    x = law.start * rng.choice([-1.0, 1.0] if law.signed else [1.0], 1)

    def changed(recording: Recording) -> Changed:
        scene = Scene(recording, arm, arm)
        return law.apply(Put(scene, recording, joints, x, drawn))

    # a law that bends is not proportional to its parameter: corrected step by step
    for _ in range(ROUNDS):
        x = x * planned.size / size_of(law.name, changed(longest)[1])
    return case.each(lambda recording: changed(recording)[0])


def rehearse(
    case: Case | str | Path,
    out: str | Path | None = None,
    *,
    effects: Sequence[str] = (),
    joints: Sequence[int] = (),
    sizes: Sequence[str] = SIZES[:2],
    seed: int = 0,
    jobs: int = 1,
    progress: Progress = silent,
) -> DocumentResult:
    """Put effects of known size into the recordings of a case, one at a time, and diagnose each.

    The laws are not the catalogue's. References are left out, as nobody knows how the effects would have changed them;
    so they are in the diagnosis of the recordings as they are, whose names do not count.

    Args:
        case: the case, or its folder.
        out: folder of the diagnoses: those that are there, of the same recordings by the same program, are kept.
        effects: names; by default all that there is a law for and the arm can have.
        joints: from 1; by default one of each effect, drawn.
        sizes: some of ``SIZES``.
        seed: of joints, signs and what else is drawn.
        jobs: diagnoses at a time.
        progress: called with a few words at each step.

    Raises:
        InputError: the case has no torque, or a name or joint is not known.
        GapscopeError: the case cannot be diagnosed as it is, or the run was stopped.

    Examples:
        >>> import gapscope
        >>> gapscope.rehearse("my_arm", "rehearsal", effects=["payload"])  # doctest: +SKIP
    """
    loaded = case_of(case)
    numbers = [str(joint) for joint in range(1, loaded.arm.n_joints + 1)]
    for name in effects:
        check_known("effect", name, RECORDED_LAWS, where="effect")
    for name in map(str, joints):
        check_known("joint", name, numbers, where="joint")
    for name in sizes:
        check_known("sizes", name, SIZES, where="sizes")
    # nobody knows how an effect would have changed the references
    bare, judged = (
        tuple(replace(r, q_ref=None, dq_ref=None) for r in own if r.tau is not None)
        for own in (loaded.recordings, loaded.judged)
    )
    if not bare:
        raise InputError(
            "has no torque, into which an effect could be put",
            "give recordings with tau1..",
            file=loaded.name,
        )
    # another case than that on disk; a controller without references says nothing
    stripped = replace(
        loaded, recordings=bare, judged=judged, controller=None, file=None
    )
    with TemporaryDirectory(prefix="gapscope-") as aside:
        folder = Path(out or aside)
        with locked(folder):
            # first alone: without it nobody knows what is newly named
            baseline = _diagnosed({AS_IS: stripped}, folder, 1, progress)[AS_IS]
            if "problem" in baseline:
                raise GapscopeError(
                    f"as it is, the case cannot be diagnosed: {baseline['problem']}",
                    "gapscope check says what its recordings cannot show",
                )
            laws = [RECORDED_LAWS[name] for name in effects or RECORDED_LAWS]
            planned = list(_planned(loaded.arm, laws, baseline, joints, sizes, seed))
            if not planned:
                raise InputError(
                    "all that is asked for is named as it is, or this arm cannot have it",
                    "choose another --effect or --joint; what changed on top is for gapscope diagnose --against",
                )
            cases = {one.name: put_in(stripped, one, seed) for one in planned}
            found = _diagnosed(cases, folder, jobs, progress)
    rows = [_row(loaded.arm, one, baseline, found[one.name]) for one in planned]
    content = {
        "schema": 1,
        "case": loaded.name,
        **arm_entry(loaded.arm),
        "seed": seed,
        "summary": sentence(rows),
        "as_is": [f"{called(one)}, {acts_on(one)}" for one in baseline["effects"]],
        "rows": rows,
        KEY: made_from(loaded),
    }
    document = plain(content, null_if_not_finite=True)
    return DocumentResult(
        "rehearsal", document, summary, itemgetter("rows"), write_page
    )


def _planned(
    arm: NominalArm,
    laws: Sequence[RecordedLaw],
    baseline: Document,
    joints: Sequence[int],
    sizes: Sequence[str],
    seed: int,
) -> Iterator[Planned]:
    """What is put in: nothing that the arm cannot have, or that is named as it is."""
    expected: dict[tuple[str, int], dict[str, Any]] = defaultdict(dict)
    for entry in baseline.get("expected", ()):
        # of one joint at most: the sum is its number, or 0
        expected[entry["effect"], sum(entry["joints"])] = entry
    taken = {(effect, joint or 0) for effect, joint, _ in _named(baseline)}
    scale = ArmScale.of(arm)
    for law in laws:
        rng = np.random.default_rng([seed, crc32(law.name.encode())])
        every = list(joints) or range(1, arm.n_joints + 1)
        places = [0] if law.place == "arm" else every
        # on top of one that is there the size put in is not the size named
        free = [place for place in places if (law.name, place) not in taken]
        # where nothing turns such a law means nothing of its own
        if not law.slides and all(arm.sliding):
            continue
        if not joints and len(free) > 1:
            # where it has a fair chance to be found, if there is such a joint
            likely = [p for p in free if expected[law.name, p].get("nine_of_ten")]
            free = [int(rng.choice(likely or free))]
        for place in free:
            entry = expected[law.name, place]
            # null: not named at any size
            given = {chance: entry[chance] for chance in sizes if entry.get(chance)}
            # without an expected size, the one that is usual on real arms
            if "severity" in sizes or not given:
                usual = draw(law.name, rng, scale, (place,)).parameters
                given["severity"] = size_of(law.name, usual)
            for chance, size in given.items():
                yield Planned(law, place, chance, abs(size))


def _diagnosed(
    cases: Mapping[str, Case], out: Path, jobs: int, progress: Progress
) -> dict[str, Document]:
    """The diagnosis of each case, kept from an earlier run or made now; its ``problem`` if there is none."""
    found = {}
    # kept by hashes of what was put in: another size or seed is another case
    for row, _ in diagnose_missing(cases, out, jobs):
        nothing = {"problem": row.problem, "effects": [], "possible": []}
        found[row.folder] = dict(row.document or nothing)
        progress(f"{len(found)} of {len(cases)} diagnosed, {row.folder}")
    return found


Place = tuple[str, int | None, int | None]
"""Effect, joint and link, from 1."""


def _named(document: Document) -> dict[Place, str]:
    """What a diagnosis names, in words, by effect and place."""
    return {
        (row["effect"], row["joint"], row["link"]): (
            f"{effect_name(row['effect'])}, {place_text(row['joint'], row['link'])}"
        )
        for row in number_rows(document)
        if row["named"]
    }


def _row(
    arm: NominalArm, planned: Planned, baseline: Document, found: Document
) -> dict[str, Any]:
    """What was put in, what was named, and the value said."""
    effect, joint = planned.law.name, planned.joint or None
    names = size_parameters(effect)
    # units of a slide are those of forces
    slides = joint is not None and arm.sliding[joint - 1]
    # what is named without the effect, too, is none of its doing
    before = _named(baseline)
    new = {key: text for key, text in _named(found).items() if key not in before}
    # the name alone on another joint is no find
    right = any(key[:2] == (effect, joint) for key in new)
    outcome = "found" if right else "confused" if new else "missed"
    row: dict[str, Any] = {
        "effect": effect,
        "joint": joint,
        "parameter": names[0],
        "unit": joint_unit(CATALOGUE[effect].parameter(names[0]).unit, slides),
        "chance": planned.chance,
        "size": planned.size,
        "outcome": outcome,
        "named": list(new.values()),
        "value": None,
        "std": None,
        "probability": None,
        "diagnosis": planned.name,
    }
    if "problem" in found:
        row |= {"outcome": "failed", "named": [found["problem"]]}
    # its value is told even if it is only possible
    said = [
        number
        for number in number_rows(found)
        if (number["effect"], number["joint"]) == (effect, joint)
        and number["parameter"] in names
    ]
    if said:
        value, std = np.array([(n["value"], n["std"]) for n in said], dtype=float).T
        row["value"] = size = np.linalg.norm(value)
        # of a length |x|: sqrt(sum x^2 s^2) / |x|
        row["std"] = np.linalg.norm(value * std) / size
        row["probability"] = said[0]["probability"]
    return row
