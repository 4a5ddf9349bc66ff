"""Columns of the case format from arrays in memory."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from gapscope.arm.errors import InputError

Samples = np.ndarray | Sequence[np.ndarray]
"""A channel of one recording, shape (N,) or (N, n), or a list of them: one for each recording."""


def frames_of_arrays(
    t: Samples, channels: Mapping[str, Samples | None]
) -> list[dict[str, np.ndarray]]:
    """Columns ``t``, ``q1..qn`` and so on for each recording.

    Args:
        t: time [s], shape (N,).
        channels: by name, shape (N, n); ``None`` for one that was not recorded.

    Raises:
        InputError: a channel has another number of recordings than ``t``, or another shape.
    """
    times = _listed(t)
    given = {name: _listed(x) for name, x in channels.items() if x is not None}
    for name, arrays in given.items():
        if len(arrays) != len(times):
            raise InputError(
                f"has {len(arrays)} recordings, t has {len(times)}",
                "give every channel an array for each recording",
                where=name,
            )
    frames = []
    for number, time in enumerate(times):
        columns = {"t": np.asarray(time, dtype=float)}
        for name, arrays in given.items():
            columns |= _numbered(name, np.asarray(arrays[number], dtype=float))
        frames.append(columns)
    return frames


def _listed(samples: Samples) -> Sequence[np.ndarray]:
    """Arrays of a channel, one for each recording."""
    return samples if isinstance(samples, (list, tuple)) else [np.asarray(samples)]


def _numbered(name: str, values: np.ndarray) -> dict[str, np.ndarray]:
    """Columns ``name1..namen`` of an array of shape (N, n)."""
    if values.ndim != 2:
        raise InputError(
            f"has shape {values.shape}, expected (N, n): a row for each sample, a column for each joint",
            where=name,
        )
    return {f"{name}{joint + 1}": column for joint, column in enumerate(values.T)}
