"""The section on the Kalman filter: a sentence, the innovations per joint, and curves of the estimates over time."""

from __future__ import annotations

from typing import Any

import numpy as np

from gapscope.ident.identification import Identification
from gapscope.ident.kalman.review import FilterReview
from gapscope.model.change_findings import change_findings, change_text
from gapscope.reports.diagnosis.figures import encode, keep_extremes

POINTS = 1500
"""Most points of the innovations of one joint."""


def filter_sentence(document: dict[str, Any]) -> str:
    """What the filter did, in words, from the document of the identification."""
    shown = document["filter"]
    whole = shown["elapsed"][-1]
    parts = [f"does not converge in {whole:.3g} s"]
    if shown["converged"] is not None:
        parts = [f"converges after {shown['converged']:.3g} s of {whole:.3g} s"]
    level = shown["process_noise"]
    wander = (
        f"friction wanders by {100 * level:.2g} % in a second" if level else "no drift"
    )
    parts.append(wander)
    unlike = [
        j for j, white in enumerate(shown["innovations"]["white"], 1) if not white
    ]
    joints = ", ".join(map(str, unlike))
    parts.append(
        f"innovations not white on joint {joints}" if unlike else "white innovations"
    )
    count = len(shown["departures"])
    departs = "no parameter departs from the batch"
    if count:
        worst = shown["departures"][0]
        departs = (
            f"{count} of {len(shown['parameters'])} parameters depart from the batch, {worst['expression']} farthest "
            f"at {worst['time']:.3g} s of {worst['recording']}"
        )
    return "; ".join((*parts, departs))


def innovation_rows(document: dict[str, Any]) -> list[dict[str, Any]]:
    """A row per joint: RMS over the batch's residual, whiteness, and how many samples count as one."""
    found = document["filter"]["innovations"]
    keys = ("rms", "white", "largest_autocorrelation", "samples_per_independent")
    columns = zip(*(found[key] for key in keys), strict=True)
    return [
        {
            "label": f"J{j}",
            "rms": rms,
            "white": white,
            "largest": largest,
            "count": count,
        }
        for j, (rms, white, largest, count) in enumerate(columns, 1)
    ]


def filter_curves(result: Identification) -> dict[str, Any]:
    """What the figures draw: each parameter with its band and the batch, and each joint's innovations."""
    review = result.filtered
    track = review.followed.track
    expressions = result.base.expressions(1e-2)
    names = [result.base.names[k] for k in result.base.kept]
    nominal = result.base.of(result.columns.nominal(result.choice.law))
    parameters = [
        {
            "name": names[i],
            "expression": expression,
            "value": encode(track.value[:, i]),
            "std": encode(track.deviation[:, i]),
            "batch": float(review.batch[i]),
            "nominal": float(nominal[i]),
        }
        for i, expression in enumerate(expressions)
    ]
    start = review.converged
    return {
        "elapsed": encode(review.elapsed),
        "parameters": parameters,
        "first": _first(review, names),
        "innovations": _innovations(review),
        "converged": None if start is None else float(review.elapsed[start]),
        "changes": _changes(review),
        "starts": _starts(review),
    }


def _first(review: FilterReview, names: list[str]) -> int:
    """The parameter that is drawn at first: one that changed, or that departs, or friction of the first joint."""
    for moved in review.moved:
        return int(np.abs(moved / review.followed.track.deviation[-1]).argmax())
    if review.departures:
        return review.departures[0].parameter
    friction = [i for i, name in enumerate(names) if name[0] in "bc"]
    return friction[0] if friction else 0


def _innovations(review: FilterReview) -> list[dict[str, str]]:
    """Each joint's innovations over the elapsed time."""
    followed = review.followed
    t = followed.problem.interval * np.arange(len(followed.innovation))
    joints = []
    for series in followed.innovation.T:
        keep = keep_extremes([series], POINTS)
        joints.append({"t": encode(t[keep]), "value": encode(series[keep])})
    return joints


def _changes(review: FilterReview) -> list[dict[str, Any]]:
    """Moments of the changes in elapsed time, in words."""
    return [
        {
            "elapsed": _elapsed(review, entry["recording"], entry["time"]),
            "text": change_text(entry),
        }
        for entry in change_findings(review.changes)
    ]


def _elapsed(review: FilterReview, recording: str, time: float) -> float:
    """Elapsed time of a moment of a recording [s]."""
    own = np.array([name == recording for name in review.recordings])
    return float(np.interp(time, review.times[own], review.elapsed[own]))


def _starts(review: FilterReview) -> list[dict[str, Any]]:
    """Where recordings after the first begin, in elapsed time."""
    names = review.recordings
    edges = [k for k in range(1, len(names)) if names[k] != names[k - 1]]
    return [{"elapsed": float(review.elapsed[k - 1]), "name": names[k]} for k in edges]
