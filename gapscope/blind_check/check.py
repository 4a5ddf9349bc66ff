"""A sealed blind check: its plan, its cases, their seal, and the run over them."""

from __future__ import annotations

import platform
import secrets
import shutil
import time
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from joblib import Parallel, delayed

from gapscope.arm.case import load_case
from gapscope.arm.errors import GapscopeError, InputError
from gapscope.arm.io.case_file import read_yaml
from gapscope.arm.io.json_file import plain, read_json, schema_fault, write_json
from gapscope.arm.nearest_name import check_keys, nearest
from gapscope.blind_check.generator.arms import ROBOTS, USUAL
from gapscope.blind_check.generator.case import make_case, write_case
from gapscope.blind_check.generator.law import Draws, Law, LawValues
from gapscope.blind_check.generator.laws import BEYOND, INSIDE, LAWS, SETUP
from gapscope.blind_check.generator.simulate import (
    STRONG,
    WEAK,
    CaseSpec,
    allocate,
    draw_conditions,
)
from gapscope.blind_check.generator.true_arm import TrueArm
from gapscope.diagnosis import thresholds
from gapscope.diagnosis.diagnose import diagnose
from gapscope.diagnosis.document.diagnosis_json import write_document
from gapscope.diagnosis.prepare import Progress, silent
from gapscope.effects.arm_scale import ArmScale
from gapscope.effects.catalogue import CATALOGUE, SHIPPED
from gapscope.effects.corrected_file import write_corrected
from gapscope.effects.effect import Signals, TorqueLaw
from gapscope.effects.severity import draw
from gapscope.provenance import library_versions, sha256, source_hash

# What a set of blind cases holds, and its allocation to single cases.


TOGETHER = (
    {
        "coulomb_friction",
        "stribeck_friction",
        "saturating_friction",
        "load_friction",
        "friction_drift",
    },
    {"viscous_friction", "saturating_friction"},
    {"actuator_lag", "actuator_delay"},
    {"payload", "link_inertia"},
    {"joint_elasticity", "backlash"},
    {"external_force", "friction_drift"},
    {"torque_saturation", "torque_scale"},
)
"""Effects of which no two are put into one case: they hide each other by their nature."""
ALONE = {"encoder_quantization", *SETUP}
"""Effects that only single cases have."""


@dataclass(frozen=True)
class BlindPlan:
    """A set of blind cases.

    Attributes:
        singles, pairs, triples, outside, healthy: numbers of cases of each kind, at a severity of 3 to 20.
        ladder: number of single effects at a severity of 0.5 to 3.
        effects: effects of singles, pairs, triples and the ladder; empty: all of the package. A case with an effect of
            a user, whose own law generates it, is of the kind ``recovery``.
        robots: arms.
        inertials_off: share of the cases whose nominal inertials are 1 to 10 % off [1].
        noisy: share with three times the encoder noise [1].
        bare: share whose controller is unknown [1].
        duration: shortest and longest recording [s].
    """

    singles: int = 100
    pairs: int = 60
    triples: int = 30
    outside: int = 30
    healthy: int = 80
    ladder: int = 60
    effects: tuple[str, ...] = ()
    robots: tuple[str, ...] = USUAL
    inertials_off: float = 0.4
    noisy: float = 0.15
    bare: float = 1 / 3
    duration: tuple[float, float] = (8.0, 14.0)

    def __post_init__(self) -> None:
        """Check the names and the numbers.

        Raises:
            InputError: an effect or a robot is unknown, or a number cannot be.
        """
        content = plain(asdict(self), null_if_not_finite=True)
        fault = schema_fault(content, "plan")
        if fault is not None:
            name = str(fault.absolute_path[0])
            raise InputError(
                f"expected {fault.schema['description']}, got {getattr(self, name)!r}",
                where=f"plan, {name}",
            )
        if self.duration[0] > self.duration[1]:
            raise InputError(
                f"the shortest of {self.duration} s is longer than the longest",
                "give the shortest first",
                where="plan, duration",
            )
        own = [name for name in CATALOGUE if name not in SHIPPED]
        _check_names("effects", self.effects, (*INSIDE, *SETUP, *own))
        # laws of a user are entered before the plan is used: all else looks them up
        enter_own_laws(self.effects)
        _check_names("robots", self.robots, ROBOTS)
        # 3.0 is a number of cases too
        for name in COUNTS:
            object.__setattr__(self, name, int(getattr(self, name)))

    @property
    def size(self) -> int:
        """Number of cases."""
        return sum(getattr(self, field) for field in COUNTS)

    def plain(self) -> dict[str, Any]:
        """The plan as JSON or YAML data."""
        return plain(asdict(self))


COUNTS = ("singles", "pairs", "triples", "outside", "healthy", "ladder")
"""Fields of a plan that count cases."""


def _check_names(field: str, names: tuple[str, ...], known: Sequence[str]) -> None:
    """Check that all names are known; raises ``InputError``."""
    for name in names:
        if name not in known:
            raise InputError(
                f"unknown {name!r}",
                f"{nearest(name, known)}use {', '.join(known)}; an effect of your own needs --effects-from",
                where=f"plan, {field}",
            )


def read_plan(path: Path) -> BlindPlan:
    """A plan from a YAML file whose keys are the fields of ``BlindPlan``.

    Raises:
        InputError: the file cannot be read, or a key or value is wrong.
    """
    content = read_yaml(path, "give a YAML file with a plan")
    try:
        content = check_keys(content, [field.name for field in fields(BlindPlan)])
        # tuples, as a plan cannot change, and is compared with one begun before
        values: dict[str, Any] = {
            key: tuple(value) if isinstance(value, list) else value
            for key, value in content.items()
        }
        return BlindPlan(**values)
    except InputError as error:
        raise error.at(path) from None


def allocate_cases(plan: BlindPlan, seed: int) -> list[CaseSpec]:
    """The cases of a plan, in random order; the same seed gives the same cases."""
    # 1 is the stream of the deck; each case draws from its own, 2 and its number
    rng = np.random.default_rng([seed, 1])
    effects = plan.effects or (*INSIDE, *SETUP)
    mixable = [name for name in effects if name not in (*ALONE, *SETUP, *BEYOND)]
    # a ladder needs a measure of severity, and an effect with a name to find
    graded = [
        name
        for name in effects
        if LAWS[name].measure != "none" and not LAWS[name].outside
    ]
    # kind and laws of each case; drawn in this order, so that a seed gives the same set
    deck: list[tuple[str, tuple[str, ...]]] = []
    deck += [("single", (name,)) for name in _cycled(effects, plan.singles, rng)]
    deck += [("ladder", (name,)) for name in _cycled(graded, plan.ladder, rng)]
    deck += [("outside", (name,)) for name in _cycled(BEYOND, plan.outside, rng)]
    deck += [("pair", _mixed(mixable, 2, rng)) for _ in range(plan.pairs)]
    deck += [("triple", _mixed(mixable, 3, rng)) for _ in range(plan.triples)]
    deck += [("healthy", ())] * plan.healthy
    conditions = draw_conditions(rng, len(deck), plan.plain())
    # of both one for each case: what is drawn does not depend on the kinds
    strong = allocate(rng, len(deck), STRONG, [1.0] * len(STRONG))
    weak = allocate(rng, len(deck), WEAK, [1.0] * len(WEAK))
    specs = []
    for k, (kind, laws) in enumerate(deck):
        severity = weak[k] if kind == "ladder" else strong[k]
        # the law that made the case is also the one looked for: no accuracy
        if any(LAWS[name].recovery for name in laws):
            kind = "recovery"
        wanted = None if kind == "healthy" else severity
        specs.append(CaseSpec(kind, laws, wanted, conditions[k]))
    # the number of a case must not tell its kind
    return [specs[k] for k in rng.permutation(len(specs))]


def _cycled(
    names: tuple[str, ...] | list[str], count: int, rng: np.random.Generator
) -> list[str]:
    """``count`` names, each as often as the others but for one."""
    if not names:
        return []
    rounds = [rng.permutation(list(names)) for _ in range(count // len(names) + 1)]
    return [str(name) for name in np.concatenate(rounds)[:count]]


def _mixed(names: list[str], count: int, rng: np.random.Generator) -> tuple[str, ...]:
    """Different effects that do not hide each other by their nature."""
    # of too few names none can be drawn: the error below says so
    size = min(count, len(names))
    for _ in range(1000):
        drawn = [str(name) for name in rng.choice(names, size, replace=False)]
        hidden = any(len(group & set(drawn)) > 1 for group in TOGETHER)
        if len(drawn) == count and not hidden:
            return tuple(sorted(drawn))
    raise InputError(
        f"no {count} of {', '.join(names)} can be told apart in one case",
        "name more effects",
        where="plan",
    )


# What fixes a run: the hash of what leads to a diagnosis, its thresholds, and the versions.


def frozen() -> dict[str, Any]:
    """What a run is fixed by."""
    return {
        "source_sha256": source_hash(),
        "thresholds": {
            name: plain(value)
            for name, value in vars(thresholds).items()
            if name.isupper()
        },
        "python": platform.python_version(),
        "libraries": library_versions(),
    }


# The seal: labels that are kept apart from the cases, and the commitment published beside the cases.


COMMITMENT = "commitment.json"
"""File beside the cases that fixes the labels without revealing them."""
LABELS = "labels.json"
"""File with the truth."""
UNSEEN = "unseen"
"""Folder beside the labels with the recordings that are held out."""


def labels_folder(cases: Path) -> Path:
    """Where labels lie by default: ``DIR-labels`` beside DIR."""
    cases = cases.resolve()
    return cases.with_name(f"{cases.name}-labels")


def read_commitment(cases: Path) -> dict[str, Any]:
    """The commitment of a set of cases.

    Raises:
        InputError: there is none: the set is not complete, or this is no such set.
    """
    return read_json(
        cases / COMMITMENT,
        "gapscope blind make ends with it; run that again for the rest",
    )


def open_labels(cases: Path, labels: Path) -> dict[str, Any]:
    """The labels, after their hash was compared with the commitment.

    Raises:
        InputError: these are not the labels that were committed to.
    """
    labels = labels / LABELS if labels.is_dir() else labels
    content = read_json(labels, "give the labels that gapscope blind make wrote")
    # labels that changed after the cases were published are not these
    if sha256(labels) != read_commitment(cases)["labels_sha256"]:
        raise InputError(
            "is not the file whose hash was published with the cases",
            f"give the labels that belong to {cases}, unchanged",
            file=labels,
        )
    # the labels hold the hashes of the recordings, so these are sealed too
    for name, label in content["cases"].items():
        unseen = labels.parent / UNSEEN / f"{name}.csv"
        if not unseen.is_file() or sha256(unseen) != label["unseen_sha256"]:
            raise InputError(
                "is not the recording that was held out",
                "restore it beside the labels",
                file=unseen,
            )
    return content


def readable_labels(cases: Path, labels: Path | None = None) -> Path | None:
    """A file with the truth that this process can read, or ``None``.

    Looked at are the path given; every file in the place where labels lie by default; and, in the cases' folder and in
    the folders beside it, every ``labels.json`` with the hash that was committed to.
    """
    cases = cases.resolve()
    # here any readable file is one too many; elsewhere only that with the hash
    certain = [labels_folder(cases), *([] if labels is None else [labels.resolve()])]
    for place in certain:
        for file in (place, *sorted(place.rglob("*"))):
            if _readable(file):
                return file
    wanted = read_commitment(cases)["labels_sha256"]
    around = [
        file
        for folder in (cases, cases.parent)
        for depth in (LABELS, f"*/{LABELS}")
        for file in sorted(folder.glob(depth))
    ]
    for file in around:
        if _readable(file) and sha256(file) == wanted:
            return file
    return None


def _readable(path: Path) -> bool:
    try:
        with path.open("rb") as file:
            return bool(file.read(1))
    except OSError:
        return False


# Making a set of blind cases: in parallel, resumable, the labels apart.


PLAN = "plan.json"
"""Seed and plan of a set that is being made, beside its labels."""


def make(
    out: Path,
    plan: BlindPlan,
    *,
    seed: int | None = None,
    labels: Path | None = None,
    jobs: int = 1,
    progress: Progress = silent,
) -> tuple[Path, Path]:
    """Make the cases of a plan; those that are there already are kept.

    Args:
        out: folder of the cases.
        plan: what they are.
        seed: draws the same cases again; ``None``: a secret one, or that of the set that was begun.
        labels: folder of the labels and of the recordings held out; default ``out``-labels.
        jobs: cases at a time.
        progress: called with a short message after each case.

    Returns:
        The commitment and the labels.

    Raises:
        InputError: ``labels`` lies inside ``out``, or another plan or seed was begun there.
    """
    folder = (labels or labels_folder(out)).resolve()
    if folder.is_relative_to(out.resolve()):
        raise InputError(
            f"{folder} lies inside {out}",
            "keep the labels outside the cases",
            where="--labels",
        )
    # seed, salt and plan of the set, from an earlier run if there was one
    file = folder / PLAN
    if file.is_file():
        begun = read_json(file, "remove it and the cases made so far")
        if begun["plan"] != plan.plain() or seed not in (None, begun["seed"]):
            raise InputError(
                "was begun with another plan or seed",
                "give the same ones, or other folders for cases and labels",
                file=file,
            )
    else:
        begun = {
            # a secret seed: nobody can make the labels again from the cases
            "seed": secrets.randbits(64) if seed is None else seed,
            # the salt keeps the hash from being found by making sets of likely seeds
            "salt": secrets.token_hex(16),
            "plan": plan.plain(),
        }
    # a plan that cannot be dealt begins nothing
    specs = allocate_cases(plan, begun["seed"])
    folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    write_json(begun, file, private=True)
    names = [f"case{k:04d}" for k in range(len(specs))]
    parts = folder / "parts"
    # made is what has both: the folder comes last, so half a case is made again
    todo = [
        k
        for k, name in enumerate(names)
        if not (out / name).is_dir() or not (parts / f"{name}.json").is_file()
    ]
    done = len(specs) - len(todo)
    work = (
        # numbers of its own for each case: going on gives the set that one go gives
        delayed(_made)(specs[k], names[k], (begun["seed"], 2, k), out, folder)
        for k in todo
    )
    for line in Parallel(n_jobs=jobs, return_as="generator_unordered")(work):
        done += 1
        progress(f"{done} of {len(specs)} made, {line}")
    # as they were written: cases of an earlier run are among them
    cases = {
        name: read_json(parts / f"{name}.json", "run the command again")
        for name in names
    }
    write_json({"schema": 1, **begun, "cases": cases}, folder / LABELS, private=True)
    # publish the hash of the labels beside the cases
    sealed = sha256(folder / LABELS)
    commitment = {"schema": 1, "cases": len(names), "labels_sha256": sealed}
    write_json(commitment, out / COMMITMENT)
    return out / COMMITMENT, folder / LABELS


def _made(
    spec: CaseSpec, name: str, seed: tuple[int, ...], out: Path, folder: Path
) -> str:
    """Make one case; its folder is renamed into place at the end, after its label was written."""
    enter_own_laws(spec.laws)  # a process of its own does not have them yet
    aside = out / f".{name}"
    # what an interrupted run left of this case goes first
    shutil.rmtree(aside, ignore_errors=True)
    shutil.rmtree(out / name, ignore_errors=True)
    unseen = folder / UNSEEN / f"{name}.csv"
    try:
        made = make_case(spec, seed)
        write_case(made, name, spec.conditions.bare, aside, unseen)
        write_json(
            {**made.label, "unseen_sha256": sha256(unseen)},
            folder / "parts" / f"{name}.json",
            private=True,
        )
        # last: a folder in place has its label
        aside.rename(out / name)
    except OSError as error:
        raise GapscopeError(
            f"{error.filename}: cannot be written ({error.strerror})",
            "check the folder's permissions",
        ) from None
    attempts = made.label["attempts"]
    return f"in {attempts} draw{'s' if attempts > 1 else ''}"


# The run: every case of a blind set diagnosed with what is frozen at its start, the labels out of reach.


FROZEN = "frozen.json"
"""File of the results with what the run is fixed by, and at its end the hash of each diagnosis."""
DONE = "run.json"
"""File of a case's results, written last: seconds, and why it failed if it did."""


def run(
    cases: Path,
    out: Path,
    *,
    labels: Path | None = None,
    jobs: int = 1,
    progress: Progress = silent,
) -> int:
    """Diagnose every case; those that have been are kept, those that failed are tried again.

    Args:
        cases: folder that ``make`` wrote.
        out: folder of the results, one sub-folder per case.
        labels: where the labels lie, to make sure that they cannot be read.
        jobs: cases at a time.
        progress: called with a few words after each case.

    Returns:
        The number of cases that failed.

    Raises:
        InputError: the labels can be read, there is no commitment, or the run was begun with another source.
    """
    commitment = read_commitment(cases)
    found = readable_labels(cases, labels)
    if found is not None:
        raise InputError(
            "the labels can be read from here, so the check would not be blind",
            "move the folder of the labels to where this user cannot read it (another machine or user, or an "
            "encrypted archive), and bring it back for gapscope blind score",
            file=found,
        )
    folders = sorted(path.parent for path in cases.glob("*/case.yaml"))
    # cases left out would make the figures those of a choice
    if len(folders) != commitment["cases"]:
        raise InputError(
            f"holds {len(folders)} cases, but {commitment['cases']} were committed to",
            "restore the missing ones, or make the set again",
            file=cases,
        )
    # what the run is fixed by, or what an earlier part of the run was fixed by
    now = {"schema": 1, "labels_sha256": commitment["labels_sha256"], **frozen()}
    fixed = out / FROZEN
    if not fixed.is_file():
        write_json(now, fixed)
    before = read_json(fixed, "choose another folder with --out")
    # thresholds are part of the source; libraries are recorded, not held
    for key, what in (
        ("labels_sha256", "these are results on another set"),
        ("source_sha256", "the source changed"),
    ):
        if before[key] != now[key]:
            raise InputError(
                f"{what} since this run was begun",
                "choose another folder with --out",
                file=fixed,
            )
    # cases that failed stay to do
    done_files = {folder: out / folder.name / DONE for folder in folders}
    todo = [
        folder
        for folder, file in done_files.items()
        if not file.is_file() or read_json(file, "remove it")["error"] is not None
    ]
    done = len(folders) - len(todo)
    failed = 0
    work = (delayed(_diagnosed)(folder, out / folder.name) for folder in todo)
    results = Parallel(n_jobs=jobs, return_as="generator_unordered")(work)
    for name, problem in results:
        done += 1
        failed += bool(problem)
        why = f": {problem}" if problem else ""
        progress(f"{done} of {len(folders)} done, {name}{why}")
    # after the last case: hashes of all of them, failed ones too, and once more of the source, so that the scorer sees
    # what was touched
    content = read_json(fixed, "choose another folder with --out")
    names = (folder.name for folder in folders)
    content["diagnoses"] = {name: diagnosis_hash(out / name) for name in names}
    content["source_sha256_at_the_end"] = source_hash()
    write_json(content, fixed)
    return failed


def _diagnosed(case: Path, out: Path) -> tuple[str, str]:
    """Diagnose one case; its name, and why it failed."""
    begin, problem = time.perf_counter(), None
    try:
        result = diagnose(load_case(case, any_unit=True))
        write_corrected(
            case.name,
            result.effects,
            out / "corrected.yaml",
            presliding=result.presliding,
            states=result.states,
        )
        write_document(result.document, out / "diagnosis.json")
    except GapscopeError as error:
        problem = str(error)
    except Exception as error:
        # one case does not stop the rest; the scorer counts it as failed
        problem = f"{type(error).__name__}: {error}"
    # of a failure too: a case without it was interrupted
    write_json(
        {"seconds": round(time.perf_counter() - begin, 2), "error": problem}, out / DONE
    )
    return case.name, "" if problem is None else problem.splitlines()[0]


def diagnosis_hash(folder: Path) -> str | None:
    """SHA-256 of the diagnosis in a folder; ``None`` if there is none."""
    file = folder / "diagnosis.json"
    return sha256(file) if file.is_file() else None


# Effects of a user in the blind check: generated by the user's own law, since nothing else knows it.


def enter_own_laws(names: Iterable[str]) -> None:
    """Give the generator the laws of a user's effects, those of this process, by their names.

    Raises:
        InputError: one of them is not a smooth torque law, which alone can be put beside the generator's joints.
    """
    for name in names:
        if name in SHIPPED or name not in CATALOGUE:
            continue
        effect = CATALOGUE[name]
        # dry friction taken at the present velocity would chatter about standstill
        if type(effect) is not TorqueLaw or effect.reach != "joint":
            raise InputError(
                f"{name} is an effect of your own and no TorqueLaw: the blind check's generator shares nothing with "
                "the catalogue, and has no law for it",
                "leave it out; gapscope record and gapscope diagnose make a recovery check with it",
                where="plan, effects",
            )
        LAWS[name] = _law(effect)


def _law(effect: TorqueLaw) -> Law:
    """A user's torque law as the generator draws, sizes and applies it."""

    def drawn(draws: Draws) -> LawValues:
        whole, arm = draws.whole, draws.whole.arm
        scale = ArmScale(
            whole.deviation,
            whole.inertia,
            arm.armature,
            # over the speed of a joint that rests values would have no end
            np.maximum(whole.speed, 0.1),
            np.ones(arm.n),
            arm.payload,
        )
        joints = tuple(draws.joints + 1)
        return dict(draw(effect.name, draws.rng, scale, joints).parameters)

    def act(plant: TrueArm, joints: np.ndarray, values: LawValues) -> None:
        # the law takes a value of every joint: zero does nothing
        everywhere = [np.zeros(plant.arm.n) for _ in effect.names]
        for full, name in zip(everywhere, effect.names, strict=True):
            full[joints] = values[name]

        def resisting(
            t: float, q: np.ndarray, dq: np.ndarray, load: np.ndarray
        ) -> np.ndarray:
            return effect.law(Signals(t, q, dq, load), *everywhere)

        plant.resisting.append(resisting)

    return Law(
        effect.name,
        drawn,
        act,
        {p.name: p.unit for p in effect.parameters},
        powers={p.name: p.severity for p in effect.parameters if p.severity},
        largest={
            p.name: p.bounds[1] if p.severity > 0 else -p.bounds[0]
            for p in effect.parameters
            if p.severity
        },
        recovery=True,
        form="the user's own law: a recovery check",
    )
