"""The parts of a case's files that are recordings of their own: ranges of rows, episodes of a dataset."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from gapscope.arm.io.formats.lerobot import dataset_episodes, episode_name, is_dataset
from gapscope.arm.io.import_section import Import

Entry = Path | dict[str, Path]
"""A file, or files side by side by label."""


@dataclass(frozen=True)
class Part:
    """One recording of an entry.

    Attributes:
        entry: the file, or files side by side.
        rows: first and last row, from 0, both included; ``None``: all.
        episode: of a dataset; ``None`` for other files.
    """

    entry: Entry
    rows: tuple[int, int] | None = None
    episode: int | None = None


def fitted_parts(entry: Entry, importing: Import) -> list[Part]:
    """The recordings of an entry that may be fitted: by default all rows, of all episodes.

    An episode may also be named as a table is, in ``topic``.
    """
    episodes: Iterable[int] = importing.fit_episodes
    if isinstance(entry, Path) and is_dataset(entry):
        episodes = episodes or dataset_episodes(entry)
        if importing.topic is not None:
            episodes = [k for k in episodes if episode_name(k) == importing.topic]
        return [Part(entry, episode=episode) for episode in episodes]
    return _ranges(entry, importing.fit or (None,))


def judged_parts(entry: Entry, importing: Import) -> list[Part]:
    """The recordings of an entry that are held out: none by default."""
    if isinstance(entry, Path) and is_dataset(entry):
        return [Part(entry, episode=episode) for episode in importing.judge_episodes]
    return _ranges(entry, importing.judge)


def whole_parts(entry: Entry) -> list[Part]:
    """All recordings of an entry that is held out whole."""
    return fitted_parts(entry, Import())


def _ranges(entry: Entry, ranges: Sequence[tuple[int, int] | None]) -> list[Part]:
    return [Part(entry, rows) for rows in ranges]
