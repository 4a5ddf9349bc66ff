"""Tables from the samples of a bag's topics, on one time."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from gapscope.arm.io.formats.joint_messages import Sample
from gapscope.arm.io.log_table import LogTable
from gapscope.arm.io.table import Table

OTHER_CLOCK = 1.0
"""Stamps and times of logging that are further apart than this come from two clocks, simulated and real [s]."""

LOGGING_TIME = "time is that of logging: the stamps in the messages are not set"
"""Note of a table without stamps."""


def tables_of_samples(
    path: Path, topics: Mapping[tuple[str, str], Sequence[Sample]]
) -> tuple[LogTable, ...]:
    """A table for each topic and set of joints, in the order of the bag.

    Args:
        path: the bag, for messages.
        topics: samples by topic and type of message.
    """
    every = [sample for samples in topics.values() for sample in samples]
    stamped = [s.logged - s.stamp for s in every if s.stamp]
    # a sample without a stamp takes its time of logging, on the clock of the stamps
    lead = int(np.median(stamped)) if stamped else 0
    if abs(lead) < OTHER_CLOCK * 1e9:
        lead = 0
    start = min((s.stamp or s.logged - lead for s in every), default=0)
    tables: list[LogTable] = []
    for (topic, kind), samples in topics.items():
        groups: dict[frozenset[str], list[Sample]] = defaultdict(list)
        for sample in samples:
            groups[frozenset(sample.joints)].append(sample)
        for group in groups.values():
            table = _table(path, group, start, lead)
            tables.append(LogTable(topic, kind, table))
    return tuple(tables)


def _table(path: Path, samples: Sequence[Sample], start: int, lead: int) -> Table:
    """Samples about the same joints, with the columns that all of them have."""
    stamps = np.array([s.stamp or s.logged - lead for s in samples], dtype=np.int64)
    columns: dict[str, np.ndarray] = {"t": (stamps - start) * 1e-9}
    kept = _common_columns(samples)
    places = {
        names: [names.index(name) for name in kept]
        for names in {sample.columns for sample in samples}
    }
    values = np.array([sample.values[places[sample.columns]] for sample in samples])
    columns |= {name: values[:, place] for place, name in enumerate(kept)}
    notes = []
    if not all(sample.stamp for sample in samples):
        notes.append(LOGGING_TIME)
    dropped = {name for sample in samples for name in sample.columns} - set(kept)
    if dropped:
        notes.append(
            f"left out, as some messages lack them: {', '.join(sorted(dropped))}"
        )
    rows = range(1, len(samples) + 1)
    return Table(path, columns, rows, "message", notes=tuple(notes))


def _common_columns(samples: Sequence[Sample]) -> list[str]:
    """Names that every sample has, in the order of the first; a joint named twice counts once."""
    variants = {sample.columns for sample in samples}
    common = set(samples[0].columns).intersection(*variants)
    return [name for name in dict.fromkeys(samples[0].columns) if name in common]


def followed_trajectories(points: Sequence[Sample]) -> list[Sample]:
    """The points of all commanded trajectories in the order of time; a new one ends what is left of the one before.

    Args:
        points: in the order in which they were logged.
    """
    kept: list[Sample] = []
    for point in points:
        while kept and kept[-1].logged < point.logged and kept[-1].stamp >= point.stamp:
            kept.pop()
        kept.append(point)
    return kept
