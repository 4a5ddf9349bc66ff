"""How diagnoses are scored against the truth: classes, closure, intervals and their statistics."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from joblib import Parallel, delayed
from scipy.stats import binomtest, norm

from gapscope.arm.case import load_case
from gapscope.arm.errors import GapscopeError
from gapscope.arm.io.json_file import read_json
from gapscope.arm.io.load_recording import load_recording
from gapscope.arm.recording import Recording
from gapscope.arm.root_mean_square import rms
from gapscope.blind_check.baselines import (
    Design,
    chance,
    classified,
    design,
    features,
    forward_bic,
    largest_r2,
    ridge,
    train,
)
from gapscope.blind_check.check import DONE, FROZEN, UNSEEN, diagnosis_hash, open_labels
from gapscope.blind_check.generator.simulate import residual
from gapscope.diagnosis.document.wording import Document
from gapscope.diagnosis.gap.predict import predict_torque
from gapscope.diagnosis.prepare import Progress, silent
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.corrected_file import read_corrected_arm
from gapscope.provenance import source_hash

# Shares with intervals, and how good probabilities are.


def share(values: Sequence[bool]) -> Document:
    """How many of some values are true, as JSON data with Wilson's interval."""
    hits, count = int(sum(values)), len(values)
    low, high = wilson(hits, count)
    rate = hits / count if count else None
    return {"hits": hits, "count": count, "rate": rate, "low": low, "high": high}


def wilson(hits: int, count: int) -> tuple[float, float]:
    """Wilson's 95 % interval of a share [wilson1927]; (0, 1) without cases."""
    if not count:
        return 0.0, 1.0
    interval = binomtest(hits, count).proportion_ci(method="wilson")
    return float(interval.low), float(interval.high)


def brier(probability: np.ndarray, right: np.ndarray) -> float | None:
    """Mean of (p - right)^2, or ``None`` without findings."""
    return float(np.mean((probability - right) ** 2)) if len(probability) else None


BINS = 10
"""Bins of probability."""


def reliability(probability: np.ndarray, right: np.ndarray) -> list[dict[str, float]]:
    """Per bin of probability that holds findings: its edges, how many, mean probability, share that is right."""
    # a probability of one belongs to the last bin
    bin_of = np.minimum((probability * BINS).astype(int), BINS - 1)
    rows = []
    for k in np.unique(bin_of).tolist():
        inside = bin_of == k
        rows.append(
            {
                "from": k / BINS,
                "to": (k + 1) / BINS,
                "count": int(inside.sum()),
                "probability": float(probability[inside].mean()),
                "right": float(right[inside].mean()),
            }
        )
    return rows


def ece(probability: np.ndarray, right: np.ndarray) -> float | None:
    """Expected calibration error: mean over findings of |mean p - share right| of the bin; ``None`` without any."""
    if not len(probability):
        return None
    rows = reliability(probability, right)
    weighted = [row["count"] * abs(row["probability"] - row["right"]) for row in rows]
    return float(sum(weighted) / len(probability))


def smallest_set(candidates: Sequence[tuple[str, float]], level: float) -> list[str]:
    """The likeliest candidates until their probability reaches a level."""
    out, total = [], 0.0
    for name, probability in sorted(candidates, key=lambda c: -c[1]):
        out.append(name)
        total += probability
        # the one that crosses the level belongs to the set
        if total >= level:
            break
    return out


# Effects that recordings cannot separate, declared before any run; scores are given strictly and modulo these.


@dataclass(frozen=True)
class Named:
    """An effect that is named, by a label or a diagnosis.

    Attributes:
        effect: its name.
        joints: its joints, from 1; empty for the arm or a link.
        link: the link of ``link_inertia``, from 1; 0 for others.
    """

    effect: str
    joints: tuple[int, ...] = ()
    link: int = 0


FAST = "fast"
"""The kind of motion that moves above 3 Hz."""


class Declared(NamedTuple):
    """A pair of effects that count as the same under a condition.

    Attributes:
        first, second: names.
        when: the condition, in words.
        why: the reason.
        holds: the condition, of both effects, the number of joints and the kinds of the recordings.
    """

    first: str
    second: str
    when: str
    why: str
    holds: Callable[[Named, Named, int, Sequence[str]], bool]


CLASSES = (
    Declared(
        "actuator_delay",
        "actuator_lag",
        "no recording that was given moves above 3 Hz",
        "both delay the torque by the same time there; cosine of the signatures 1.00",
        lambda delay, lag, n, motions: FAST not in motions,
    ),
    Declared(
        "armature",
        "link_inertia",
        "the armature acts on joints 1 or 2 only",
        "the same base parameters, exactly",
        lambda rotor, link, n, motions: max(rotor.joints, default=9) <= 2,
    ),
    Declared(
        "payload",
        "link_inertia",
        "the link is the last one",
        "the same body, exactly",
        lambda load, link, n, motions: link.link == n,
    ),
)
"""The classes."""


def named(entry: Document) -> Named:
    """An entry of ``effects`` of a label or a diagnosis."""
    link = 0
    if entry["effect"] == "link_inertia":
        link = entry.get("parameters", {}).get("link", {}).get("value", 0)
    # a link is a parameter like others: its value may be a list
    if isinstance(link, list):
        link = link[0]
    return Named(entry["effect"], tuple(entry["joints"]), int(link))


def same(one: Named, other: Named, n_joints: int, motions: Sequence[str]) -> bool:
    """Whether two effects count as the same modulo the classes.

    Args:
        one, other: what is named.
        n_joints: joints of the arm.
        motions: kinds of the recordings that the diagnosis was given.
    """
    if one.effect == other.effect:
        return True
    # by name: a class knows which of the two is which
    pair = {one.effect: one, other.effect: other}
    return any(
        c.holds(pair[c.first], pair[c.second], n_joints, motions)
        for c in CLASSES
        if {c.first, c.second} == set(pair)
    )


def matched(
    truth: Sequence[Named], found: Sequence[Named], n: int, motions: Sequence[str]
) -> list[tuple[int, int]]:
    """Pairs (place in truth, place in found) of effects that count as the same, each used once, equal names first."""
    pairs = [(i, j) for i in range(len(truth)) for j in range(len(found))]
    # equal names first, so that a class never takes an effect away from its own name
    pairs.sort(key=lambda pair: truth[pair[0]].effect != found[pair[1]].effect)
    out: list[tuple[int, int]] = []
    for i, j in pairs:
        used = any(i == a or j == b for a, b in out)
        if not used and same(truth[i], found[j], n, motions):
            out.append((i, j))
    return out


def strict(truth: Iterable[Named], found: Iterable[Named]) -> bool:
    """Whether the same names are in both, classes aside."""
    return sorted(x.effect for x in truth) == sorted(x.effect for x in found)


# One verdict beside its truth.


LEVEL = 0.9
"""Probability that a conformal set is to cover."""
VECTORS = {
    "base_tilt": ("roll", "pitch"),
    "external_force": ("force",),
    "link_inertia": ("mass",),
    "payload": ("mass",),
}
"""Parameters whose common length is compared for an effect on the arm; of a joint effect it is the first parameter."""


@dataclass(frozen=True)
class ScoredFinding:
    """One effect that a diagnosis named: its probability, whether it is right, and its set of rivals.

    ``covered`` and ``size`` describe the smallest set of names that reaches ``LEVEL``.
    """

    probability: float
    right: bool
    covered: bool
    size: int


@dataclass(frozen=True)
class Compared:
    """One case: what is true, what was reported.

    Attributes:
        name, kind: the case.
        severity: its severity class as text, ``fault`` or ``healthy``.
        truth, found: what is at work and what was named, largest share first.
        unknown: whether the cause is outside the catalogue.
        verdict: of the diagnosis; ``failed`` if there is none.
        top, exact, exact_strict: first name right; the set right, modulo classes and strictly.
        jaccard: of the two sets, modulo classes.
        joints: per effect named rightly whether all of its joints are right.
        errors: per such effect on the right joints, the relative error of its first parameter.
        held: per value of these parameters whether its interval of 95 % holds the true one.
        findings: probabilities.
        closure: share of the gap closed, or ``None``.
        seconds: duration of the diagnosis [s].
        conditions: of the case.
    """

    name: str
    kind: str
    severity: str
    truth: tuple[Named, ...]
    found: tuple[Named, ...]
    unknown: bool
    verdict: str
    top: bool
    exact: bool
    exact_strict: bool
    jaccard: float
    joints: tuple[bool, ...]
    errors: tuple[float, ...]
    held: tuple[bool, ...]
    findings: tuple[ScoredFinding, ...]
    closure: Document | None
    seconds: float | None
    conditions: dict[str, Any]


def compare(
    name: str,
    label: Document,
    document: Document | None,
    seconds: float | None = None,
    closed: Document | None = None,
) -> Compared:
    """Set a diagnosis beside its label; ``None`` means a diagnosis that failed."""
    # the last motion is the one held out: no diagnosis has seen it
    n, motions = len(label["gap"]), label["motions"][:-1]
    unknown = any(entry["effect"] == "unknown" for entry in label["effects"])
    # what is outside the catalogue has no name that could be right
    entries = [entry for entry in label["effects"] if entry["effect"] != "unknown"]
    reported = document["effects"] if document else []
    verdict = document["verdict"] if document else "failed"
    truth, found = tuple(map(named, entries)), tuple(map(named, reported))
    pairs = matched(truth, found, n, motions)
    common, every = len(pairs), len(truth) + len(found)
    # of two empty sets the verdict decides
    jaccard = float(verdict == ("unexplained" if unknown else "no_gap"))
    if every:
        # matched effects are in both: the union has them once
        jaccard = common / max(every - common, 1)
    if label["severity"] is None:
        severity = "healthy"
    elif label["measure"] == "none":
        severity = "fault"
    else:
        severity = "{:g}-{:g}".format(*label["severity"])
    sizes = (first_parameter(entries[i], reported[j]) for i, j in pairs)
    known = [size for size in sizes if size is not None]
    return Compared(
        name=name,
        kind=label["kind"],
        severity=severity,
        truth=truth,
        found=found,
        unknown=unknown,
        verdict=verdict,
        top=bool(found) and any(same(t, found[0], n, motions) for t in truth),
        # of a healthy arm the verdict says all: no name can be exact
        exact=bool(truth) and common == len(truth) == len(found),
        exact_strict=bool(truth) and strict(truth, found),
        jaccard=jaccard,
        joints=tuple(
            set(truth[i].joints) == set(found[j].joints)
            for i, j in pairs
            # effects of a class may act on other joints and still be the same
            if truth[i].joints and truth[i].effect == found[j].effect
        ),
        errors=tuple(size.error for size in known),
        held=tuple(bool(held) for size in known for held in size.held),
        findings=tuple(_finding(entry, truth, n, motions) for entry in reported),
        closure=closed,
        seconds=seconds,
        conditions=label["conditions"],
    )


class FirstParameter(NamedTuple):
    """The first parameter of an effect, true and found, one value per joint or the components of a vector.

    Attributes:
        true, value, std: in its unit, (K,).
        vector: whether its length is the size.
    """

    true: np.ndarray
    value: np.ndarray
    std: np.ndarray
    vector: bool

    @property
    def error(self) -> float:
        """|found - true| / |true|, median over joints."""
        off = np.abs(self.value - self.true)
        if self.vector:
            return float(np.linalg.norm(off) / np.linalg.norm(self.true))
        return float(np.median(off / np.maximum(np.abs(self.true), 1e-12)))

    @property
    def held(self) -> np.ndarray:
        """Whether the interval of 95 % of each value holds the true one, (K,)."""
        return np.abs(self.value - self.true) <= norm.ppf(0.975) * self.std


def first_parameter(truth: Document, found: Document) -> FirstParameter | None:
    """The first parameter of an effect that was found where it is; ``None`` if it cannot be compared."""
    same_joints = set(truth["joints"]) == set(found["joints"])
    if truth["effect"] != found["effect"] or not same_joints:
        return None
    # the first parameter is the effect's size, of a vector its length
    names = VECTORS.get(truth["effect"], tuple(truth["parameters"])[:1])
    given = found["parameters"]
    units = [truth["parameters"][name].get("unit") for name in names]
    # without a unit it is no size that could be off
    if not names or "" in units or not set(names) <= given.keys():
        return None
    true, value, std = (
        np.hstack([np.ravel(entry[name][key]) for name in names])
        for entry, key in (
            (truth["parameters"], "value"),
            (given, "value"),
            (given, "std"),
        )
    )
    if truth["effect"] in VECTORS:
        return FirstParameter(true, value, std, True)
    # the same joints in another order
    order = [found["joints"].index(joint) for joint in truth["joints"]]
    return FirstParameter(true, value[order], std[order], False)


def _finding(
    entry: Document, truth: Sequence[Named], n: int, motions: Sequence[str]
) -> ScoredFinding:
    """A finding with its rivals, beside the truth."""
    candidates = [entry, *entry["alternatives"]]
    effects = {candidate["effect"]: named(candidate) for candidate in candidates}
    probabilities = [(c["effect"], c["probability"]) for c in candidates]
    right = {
        name: any(same(true, effect, n, motions) for true in truth)
        for name, effect in effects.items()
    }
    chosen = smallest_set(probabilities, LEVEL)
    return ScoredFinding(
        probability=float(entry["probability"]),
        right=right[entry["effect"]],
        # the truth may be among the rivals: the set covers it then
        covered=any(right[name] for name in chosen),
        size=len(chosen),
    )


# How much of the gap above the floor a corrected arm closes on the recording that was held out.


ABOVE = 2.0
"""A joint counts when its gap is this many times its floor."""


def closure(
    case: Path, unseen: Path, corrected: Path, floor: np.ndarray
) -> Document | None:
    """Share of the gap above the floor that is closed on held-out data.

    (before - after) / (before - floor), each a torque NRMSE; ``mean`` sums above and below the line over the joints
    that count, ``worst`` is the smallest share among them.

    Args:
        case: folder of the case.
        unseen: the recording held out; of it t and q are predicted from, the torque compared with.
        corrected: ``corrected.yaml`` of the diagnosis.
        floor: torque NRMSE of the healthy twin, (n,).

    Returns:
        ``None`` if no joint is above its floor or nothing can be predicted.
    """
    try:
        loaded = load_case(case, read_recordings=False)
        recording = load_recording(unseen, loaded.arm, loaded.importing, every_row=True)
        arm = read_corrected_arm(loaded.arm, corrected)
        before = _nrmse(CorrectedArm(loaded.arm), recording)
        # without effects nothing changes: not predicted twice
        after = _nrmse(arm, recording) if arm.effects else before
    except (GapscopeError, ValueError):
        return None
    # near its floor a joint has nothing to close, and a share means nothing
    counts = before > ABOVE * floor
    if not counts.any():
        return None
    gained, wanted = (before - after)[counts], (before - floor)[counts]
    # an arm that is made far worse counts as -1: one case must not outweigh the rest
    return {
        "mean": np.clip(gained.sum() / wanted.sum(), -1.0, 1.0),
        "worst": np.clip((gained / wanted).min(), -1.0, 1.0),
        "before": before.tolist(),
        "after": after.tolist(),
    }


def _nrmse(arm: CorrectedArm, recording: Recording) -> np.ndarray:
    """Torque NRMSE of an arm on a recording, (n,); if torque saturates, of what reached the joint."""
    predicted = predict_torque(arm, recording)
    assert recording.tau is not None
    torque = recording.tau
    for effect in arm.effects:
        if effect.name == "torque_saturation":
            columns = np.array(effect.joints) - 1
            # both sides at the limit: the motor gave no more, whatever was commanded
            limit = effect.parameters["limit"]
            torque = torque.copy()
            torque[:, columns] = np.clip(torque[:, columns], -limit, limit)
            predicted[:, columns] = np.clip(predicted[:, columns], -limit, limit)
    t = recording.t
    rate = (len(t) - 1) / (t[-1] - t[0])
    gap, _ = residual(torque, predicted, rate)
    # the scale is that of the torque as it was recorded, also under saturation
    _, scale = residual(recording.tau, predicted, rate)
    return rms(gap) / scale


# The figures of a blind check, from its cases.


def summary(cases: Sequence[Compared]) -> Document:
    """All figures, as JSON data."""

    def of(*names: str) -> list[Compared]:
        return [case for case in cases if case.kind in names]

    # a recovery check is no accuracy: it has a row of its own, and no part in the other figures
    counted = [case for case in cases if case.kind not in ("ladder", "recovery")]
    inside = [case for case in counted if case.truth]
    seconds = [case.seconds for case in cases if case.seconds is not None]
    return {
        "cases": len(cases),
        "failed": [case.name for case in cases if case.verdict == "failed"],
        "by_kind": _split(cases, lambda c: c.kind, ordered=False),
        "by_severity": _split(of("single", "ladder"), lambda c: c.severity),
        "by_robot": _split(inside, lambda c: c.conditions["robot"]),
        "by_rate": _split(inside, lambda c: f"{c.conditions['rate']} Hz"),
        "by_controller": _split(
            inside, lambda c: "unknown" if c.conditions["bare"] else "known"
        ),
        "by_inertials": _split(
            inside, lambda c: "off" if c.conditions["inertials_off"] else "true"
        ),
        # single cases only: of a pair no score belongs to one of its effects
        "by_effect": _split(of("single"), lambda c: c.truth[0].effect),
        "healthy": healthy(of("healthy")),
        "unknown": unknown(cases),
        "calibration": calibration(counted),
        "confusion": confusion(of("single", "outside", "healthy")),
        "seconds": _quantiles(seconds),
    }


def scores(cases: Sequence[Compared]) -> Document:
    """Names, joints, parameters and gap closed of some cases."""
    errors = [e for c in cases for e in c.errors]
    closed = [c.closure for c in cases if c.closure is not None]
    return {
        "count": len(cases),
        "top": share([c.top for c in cases]),
        "exact": share([c.exact for c in cases]),
        "exact_strict": share([c.exact_strict for c in cases]),
        "jaccard": np.mean([c.jaccard for c in cases]) if cases else None,
        "joints": share([right for c in cases for right in c.joints]),
        "called_unexplained": share([c.verdict == "unexplained" for c in cases]),
        "called_no_gap": share([c.verdict == "no_gap" for c in cases]),
        "parameter_error": _quantiles(errors),
        "intervals": share([held for c in cases for held in c.held]),
        "gap_closed": _quantiles([x["mean"] for x in closed]),
        "gap_closed_worst_joint": _quantiles([x["worst"] for x in closed]),
    }


def healthy(cases: Sequence[Compared]) -> Document:
    """False alarms: a healthy arm with the verdict of an effect or of an unexplained gap."""
    return {
        "count": len(cases),
        # a diagnosis that failed raised no alarm
        "false_alarms": share([c.verdict not in ("no_gap", "failed") for c in cases]),
        "effects_named": share([bool(c.found) for c in cases]),
    }


def unknown(cases: Sequence[Compared]) -> Document:
    """How often the verdict is ``unexplained``, rightly and wrongly."""
    outside = [c for c in cases if c.unknown]
    inside = [c for c in cases if c.truth and c.kind in ("single", "pair", "triple")]
    return {
        "recall": share([c.verdict == "unexplained" for c in outside]),
        "false_unknown": share([c.verdict == "unexplained" for c in inside]),
    }


def calibration(cases: Sequence[Compared]) -> Document:
    """Brier score, ECE and reliability of the probabilities; coverage and size of the sets at ``LEVEL``."""
    findings = [finding for c in cases for finding in c.findings]
    p = np.array([f.probability for f in findings])
    # every finding counts by itself, however many a case has
    right = np.array([f.right for f in findings], dtype=float)
    mean_size = np.mean([f.size for f in findings]) if findings else None
    return {
        "findings": len(findings),
        "brier": brier(p, right),
        "ece": ece(p, right),
        "reliability": reliability(p, right),
        "sets": {
            "level": LEVEL,
            "coverage": share([f.covered for f in findings]),
            "mean_size": mean_size,
        },
    }


def confusion(cases: Sequence[Compared]) -> dict[str, dict[str, int]]:
    """Truth to answer to number of cases; the answer is the first effect named, or the verdict if none is."""
    table: dict[str, Counter[str]] = {}
    for case in cases:
        true = case.truth[0].effect if case.truth else "healthy"
        # beside ``unexplained`` a name is only a part of the cause
        named = case.found and case.verdict != "unexplained"
        said = case.found[0].effect if named else case.verdict
        table.setdefault("unknown" if case.unknown else true, Counter())[said] += 1
    return {
        truth: dict(answers.most_common()) for truth, answers in sorted(table.items())
    }


def _split(
    cases: Sequence[Compared],
    key: Callable[[Compared], str],
    *,
    ordered: bool = True,
) -> Document:
    """Scores of the cases with each value of a key."""
    groups: dict[str, list[Compared]] = {}
    for case in cases:
        groups.setdefault(key(case), []).append(case)
    names = sorted(groups, key=_order) if ordered else list(groups)
    return {name: scores(groups[name]) for name in names}


def _order(name: str) -> tuple[float, str]:
    """Numbers by size, then names."""
    # "0.5-3" goes by 0.5, "250 Hz" by 250
    head = name.replace(" Hz", "").split("-")[0]
    is_number = head.replace(".", "").isdigit()
    return (float(head), name) if is_number else (1e9, name)


def _quantiles(values: Sequence[float]) -> dict[str, float] | None:
    """How many, median and quartiles; ``None`` without values."""
    if not values:
        return None
    low, middle, high = np.quantile(values, [0.25, 0.5, 0.75])
    return {
        "count": len(values),
        "median": float(middle),
        "lower": float(low),
        "upper": float(high),
    }


# The score: labels opened, each verdict set beside its truth, figures, tables and pictures.


METHODS = {"largest R^2": largest_r2, "forward BIC": forward_bic, "ridge": ridge}
"""Baselines that need nothing but the case."""


def score(
    cases: Path,
    results: Path,
    labels: Path,
    *,
    baselines: bool = True,
    training: tuple[Path, Path] | None = None,
    jobs: int = 1,
    progress: Progress = silent,
) -> tuple[dict[str, Any], tuple[Compared, ...]]:
    """Open the labels and score the verdicts.

    Args:
        cases, results: folders of ``make`` and ``run``.
        labels: file of the labels, or its folder.
        baselines: whether to run the plain methods as well.
        training: folder of other cases and their labels, on which the classifier is trained.
        jobs: cases at a time.
        progress: called with a few words at each step.

    Returns:
        The figures, as JSON data, and verdict and truth of each case.

    Raises:
        InputError: the labels are not those that were committed to.
    """
    progress("compares the labels with the commitment")
    content = open_labels(cases, labels)
    truth = content["cases"]
    fixed = _frozen(results, truth)
    folder = labels if labels.is_dir() else labels.parent
    # only from here on the truth is known: nothing is diagnosed any more
    progress("predicts the recordings held out")
    work = (
        delayed(_compare)(
            name,
            label,
            cases / name,
            folder / UNSEEN / f"{name}.csv",
            results / name,
        )
        for name, label in truth.items()
    )
    compared = tuple(Parallel(n_jobs=jobs)(work))
    figures = {
        "schema": 1,
        "frozen": fixed,
        "plan": content["plan"],
        "classes": [[c.first, c.second, c.when, c.why] for c in CLASSES],
        **summary(compared),
    }
    if baselines:
        progress("runs the baselines")
        figures["baselines"] = _baselines(cases, truth, training, jobs)
    return figures, compared


def _compare(
    name: str, label: Document, case: Path, unseen: Path, results: Path
) -> Compared:
    """One case, with the gap that the diagnosis closes on the held-out recording."""
    file = results / "diagnosis.json"
    document = (
        read_json(file, "run gapscope blind run again") if file.is_file() else None
    )
    done = results / DONE
    seconds = read_json(done, "remove it")["seconds"] if done.is_file() else None
    closed = None
    # a fault that shows in no torque has no torque gap to close
    if document is not None and label["measure"] == "torque" and label["effects"]:
        closed = closure(
            case, unseen, results / "corrected.yaml", np.array(label["floor"])
        )
    return compare(name, label, document, seconds, closed)


def _frozen(results: Path, truth: Document) -> Document:
    """Whether the run was frozen: one source throughout, no diagnosis changed after it."""
    begun = read_json(results / FROZEN, "run gapscope blind run first")
    # only a run that came to its end has them
    hashes = begun.get("diagnoses") or {}
    changed = [
        name for name in truth if hashes.get(name) != diagnosis_hash(results / name)
    ]
    source = begun["source_sha256"]
    return {
        "complete": bool(hashes),
        "source_sha256": source,
        "source_changed_during_the_run": begun.get("source_sha256_at_the_end")
        != source,
        "source_is_this": source == source_hash(),
        "changed_after_the_run": changed,
    }


def _baselines(
    cases: Path, truth: Document, training: tuple[Path, Path] | None, jobs: int
) -> Document:
    """Figures of each plain method on the same cases."""
    designs = dict(zip(truth, _designs(cases, list(truth), jobs), strict=True))
    # fixed, so that chance is the same whenever it is scored
    rng = np.random.default_rng(0)
    methods: dict[str, Callable[[Design], Document]] = dict(METHODS)
    if training is not None:
        methods["classifier"] = partial(classified, _trained(*training, jobs))
    answers: dict[str, dict[str, Document | None]] = {
        "chance": {k: chance(len(label["gap"]), rng) for k, label in truth.items()}
    }
    for method, function in methods.items():
        # a case that a plain method cannot read counts as failed
        answers[method] = {
            k: None if x is None else function(x) for k, x in designs.items()
        }
    figures = {}
    for method, own in answers.items():
        compared = [compare(k, truth[k], own[k]) for k in truth]
        figures[method] = {
            "by_kind": _split(compared, lambda c: c.kind, ordered=False),
            "healthy": healthy([case for case in compared if case.kind == "healthy"]),
            "unknown": unknown(compared),
        }
    return figures


def _designs(cases: Path, names: list[str], jobs: int) -> list[Design | None]:
    """The regressions of cases; ``None`` if a plain method cannot use a case's recordings."""

    def made(folder: Path) -> Design | None:
        try:
            return design(folder)
        except (GapscopeError, ValueError, np.linalg.LinAlgError):
            return None

    return list(Parallel(n_jobs=jobs)(delayed(made)(cases / name) for name in names))


def _trained(cases: Path, labels: Path, jobs: int) -> Any:
    """The classifier, trained on the cases with at most one cause; what is outside the catalogue is ``unknown``."""
    truth = open_labels(cases, labels)["cases"]
    # one class for each case: two causes have none
    names = [name for name, label in truth.items() if len(label["effects"]) <= 1]
    rows, classes = [], []
    for name, made in zip(names, _designs(cases, names, jobs), strict=True):
        if made is not None:
            rows.append(features(made))
            effects = [entry["effect"] for entry in truth[name]["effects"]]
            # no effect is a class too
            classes.append((*effects, "healthy")[0])
    return train(np.stack(rows), classes)
