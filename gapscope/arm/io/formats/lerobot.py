"""LeRobot datasets, versions 2 and 3: a folder with ``meta/info.json`` and Parquet files of frames."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gapscope.arm.errors import InputError
from gapscope.arm.input_file import (
    check_folder_files,
    check_unpacked,
    complete_file,
    is_file,
)
from gapscope.arm.io.formats.table_files import parquet_size
from gapscope.arm.io.json_file import read_json
from gapscope.arm.io.layouts import LEROBOT
from gapscope.arm.io.table import Log, Table

if TYPE_CHECKING:
    import pandas as pd

INFO = Path("meta") / "info.json"
"""The file that describes a dataset."""

_EPISODE = "episode_index"
_FRAME = "frame_index"
_TIME = "timestamp"


def is_dataset(path: Path) -> bool:
    """Whether a folder is a LeRobot dataset."""
    return is_file(path / INFO)


def dataset_files(path: Path) -> list[Path]:
    """The files of a dataset that hold its description and its frames, without videos."""
    return [path / INFO, *sorted((path / "data").rglob("*.parquet"))]


def dataset_episodes(path: Path) -> list[int]:
    """Numbers of the episodes of a dataset.

    Raises:
        InputError: the dataset is damaged.
    """
    return sorted(map(int, _frames(path, [_EPISODE])[_EPISODE].unique()))


def episode_name(number: int) -> str:
    """Name of the table of an episode."""
    return f"episode {number}"


def read_dataset(path: Path, episodes: Iterable[int] | None = None) -> Log:
    """Episodes of a dataset as tables: ``t`` [s] and ``observation.state[shoulder_pan.pos]`` and the like.

    The names in brackets are those of ``meta/info.json``. Units are as stored, which the dataset does not state.

    Args:
        path: folder of the dataset.
        episodes: numbers of the episodes to read; by default all.

    Raises:
        InputError: the dataset is damaged, or lacks an episode.
    """
    info = _info(path)
    features = info["features"]
    names = {key: _names(feature) for key, feature in features.items()}
    wanted = None if episodes is None else sorted(set(episodes))
    # one pass over the frames, then by episode
    found = dict(iter(_frames(path, None, wanted).groupby(_EPISODE)))
    tables = []
    for number in wanted or sorted(found):
        if number not in found:
            there = ", ".join(map(str, dataset_episodes(path)))
            raise InputError(
                f"has no episode {number}; it has {there}",
                "correct episodes: in the import section",
                file=path,
            )
        with complete_file(path, "frames of a LeRobot dataset"):
            columns = _columns(path, found[number], names, float(info["fps"]))
        rows = range(1, len(columns["t"]) + 1)
        name = episode_name(number)
        tables.append(Table(path, columns, rows, "frame", name=name, kind=LEROBOT))
    # what fits in no table: frames of the cameras
    videos = [
        key for key, f in features.items() if f.get("dtype") in ("video", "image")
    ]
    version = f"LeRobot dataset {info.get('codebase_version', '')}".strip()
    return Log(path, version, tuple(tables), unread=tuple(videos))


def _info(path: Path) -> Mapping[str, Any]:
    """What the dataset says of itself."""
    file = path / INFO
    info = read_json(file, "is the dataset complete?")
    remedy = "is the dataset complete? it needs fps and features"
    with complete_file(file, "the description of a LeRobot dataset", remedy):
        features = info["features"].values()
        if not (float(info["fps"]) > 0 and all(isinstance(f, dict) for f in features)):
            raise ValueError("it lacks the rate or the features")
        return dict(info)


def _names(feature: Mapping[str, Any]) -> list[str]:
    """Names of the entries of a feature: a list, or lists by group."""
    names = feature.get("names")
    if isinstance(names, Mapping):
        # groups, as of motors of two arms, in their order
        groups = [g if isinstance(g, list) else [g] for g in names.values()]
        return [str(name) for group in groups for name in group]
    return [str(name) for name in names] if isinstance(names, list) else []


def _frames(
    path: Path, columns: list[str] | None, episodes: Sequence[int] | None = None
) -> pd.DataFrame:
    """Frames of some episodes, all by default; files of version 2 hold one episode each and say so in their names."""
    import pandas as pd
    import pyarrow.parquet as pq

    files = dataset_files(path)[1:]
    if not files:
        raise InputError(
            "has no data/*/*.parquet", "is the dataset complete?", file=path
        )
    check_folder_files(files)
    own = {f"episode_{number:06d}" for number in episodes or ()}
    chosen = None if episodes is None else [(_EPISODE, "in", list(episodes))]
    remedy = "is the file complete? Git LFS leaves pointers in place of files that were not fetched"
    parts = []
    for file in files:
        named = file.stem.startswith("episode_")
        # an episode's file says so in its name: others need not be opened
        if episodes is not None and named and file.stem not in own:
            continue
        with complete_file(file, "frames of a LeRobot dataset", remedy):
            # before it is read: a few kilobytes may unpack to any size
            check_unpacked(parquet_size(pq.read_metadata(file)), file)
            found = pq.read_table(file, columns=columns, filters=chosen)
            # raises if it is not there
            found.column(_EPISODE)
            parts.append(found.to_pandas())
    return pd.concat(parts) if parts else pd.DataFrame({_EPISODE: []})


def _columns(
    path: Path, frames: pd.DataFrame, names: Mapping[str, list[str]], fps: float
) -> dict[str, np.ndarray]:
    """Columns of one episode from its frames; one for each entry of the lists in a column, if they hold numbers."""
    # without stamps frames are counted, at the rate of the dataset
    t = frames[_TIME] if _TIME in frames else frames[_FRAME] / fps
    columns = {"t": np.asarray(t, dtype=float)}
    for key, column in frames.items():
        if column.dtype.kind == "f" and key != _TIME:
            columns[str(key)] = np.asarray(column, dtype=float)
        # objects are lists, one for each frame, or something else
        if column.dtype.kind != "O":
            continue
        try:
            values = np.array(column.to_list(), dtype=float)
        except (ValueError, TypeError):
            continue
        if values.ndim != 2:
            continue
        count, labels = values.shape[1], names.get(str(key), [])
        if labels and len(labels) != count:
            raise InputError(
                f"names {len(labels)} entries of {key}, the frames hold {count}",
                "repair meta/info.json",
                file=path / INFO,
            )
        labels = labels or [str(place) for place in range(count)]
        columns |= {f"{key}[{label}]": values[:, i] for i, label in enumerate(labels)}
    return columns
