"""What the figures of the report draw: decimated curves as base64 of float32, little endian."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np

from gapscope.diagnosis.document.wording import (
    joint_names,
    joint_slides,
    short_names,
    worst_joint,
)
from gapscope.diagnosis.result import Diagnosis, Signature, Spectrum, Trace
from gapscope.reports.diagnosis import guesses, places
from gapscope.reports.diagnosis.encoding import encode

POINTS_PER_CURVE = 4000
"""Most points of one curve over time."""

POINTS_OF_ALL_TRACES = 180_000
"""Most points of all curves over time together, 1 MB; many recordings share them."""

POINTS_PER_SIGNATURE = 700


def payload(diagnosis: Diagnosis) -> dict[str, Any]:
    """All that the script of the report draws, as JSON-ready values."""
    names = joint_names(diagnosis.document)
    roles = {r["name"]: r["role"] for r in diagnosis.document.get("recordings", [])}
    most = POINTS_OF_ALL_TRACES // max(1, 4 * len(names) * len(diagnosis.traces))
    points = int(np.clip(most, 400, POINTS_PER_CURVE))
    return {
        "joints": [
            f"J{number} {name}".strip()
            for number, name in enumerate(short_names(names), 1)
        ],
        "worst": (worst_joint(diagnosis.document, "before") or 1) - 1,
        "recordings": [
            {
                "name": trace.recording,
                "role": roles.get(trace.recording, ""),
                "joints": _curves(trace, points),
            }
            for trace in diagnosis.traces
        ],
        "spectrum": _spectrum(diagnosis.spectrum),
        "places": places.curves(diagnosis),
        "guesses": guesses.curves(diagnosis),
        "slides": joint_slides(diagnosis.document),
        "signatures": [_signature(signature) for signature in diagnosis.signatures],
    }


def _curves(trace: Trace, points: int) -> list[dict[str, str]]:
    """Per joint the curves of one recording, all four at the same samples."""
    joints = []
    for joint in range(trace.measured.shape[1]):
        measured, nominal, corrected = (
            x[:, joint] for x in (trace.measured, trace.nominal, trace.corrected)
        )
        keep = keep_extremes([measured, measured - corrected], points)
        curves = {
            "t": trace.t,
            "measured": measured,
            "nominal": nominal,
            "corrected": corrected,
        }
        joints.append({name: encode(curve[keep]) for name, curve in curves.items()})
    return joints


def keep_extremes(series: list[np.ndarray], points: int) -> np.ndarray:
    """Indices of at most ``points`` samples that keep the peaks: of each series the extremes of equal stretches."""
    n = len(series[0])
    if n <= points:
        return np.arange(n)
    edges = np.linspace(0, n, max(1, points // (2 * len(series))) + 1).astype(int)
    pairs = list(pairwise(edges))
    kept = [
        a + pick(np.nan_to_num(x[a:b]))
        for x in series
        for a, b in pairs
        for pick in (np.argmin, np.argmax)
    ]
    return np.unique(kept)


def _signature(signature: Signature) -> dict[str, Any]:
    """A signature with its samples thinned evenly; ``line`` if the axis only grows, as time does."""
    n = len(signature.x)
    keep = (
        np.unique(np.linspace(0, n - 1, min(n, POINTS_PER_SIGNATURE)).astype(int))
        if n
        else np.arange(0)
    )
    return {
        "joint": signature.joint - 1,
        "axis": signature.axis,
        "unit": signature.unit,
        "line": bool(n > 1 and np.all(np.diff(signature.x) > 0)),
        "x": encode(signature.x[keep]),
        "gap": encode(signature.gap[keep]),
        "explained": encode(signature.explained[keep]),
    }


def _spectrum(spectrum: Spectrum) -> dict[str, Any]:
    return {
        "frequency": encode(spectrum.frequency),
        "before": [encode(column) for column in np.atleast_2d(spectrum.before.T)],
        "after": [encode(column) for column in np.atleast_2d(spectrum.after.T)],
    }
