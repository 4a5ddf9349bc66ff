"""LeRobot datasets, versions 2 and 3: a folder with ``meta/info.json`` and Parquet files of frames."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gapscope.arm.errors import InputError
from gapscope.arm.input_file import check_folder_files, is_file
from gapscope.arm.io.formats.table_files import check_unpacked
from gapscope.arm.io.json_file import read_json
from gapscope.arm.io.layouts import LEROBOT
from gapscope.arm.io.table import Log, Table

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
    numbers: set[int] = set()
    for file in _data_files(path):
        numbers.update(_read(file, [_EPISODE], None).column(_EPISODE).to_pylist())
    return sorted(numbers)


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
    wanted = sorted(set(dataset_episodes(path) if episodes is None else episodes))
    frames: dict[int, list[Any]] = {number: [] for number in wanted}
    for file in _data_files(path, wanted):
        content = _read(file, None, wanted)
        places = np.asarray(content.column(_EPISODE))
        for number in np.unique(places):
            own = np.flatnonzero(places == number)
            frames[int(number)].append(content.slice(own[0], len(own)))
    tables = []
    for number, parts in frames.items():
        if not parts:
            there = ", ".join(map(str, dataset_episodes(path)))
            raise InputError(
                f"has no episode {number}; it has {there}",
                "correct episodes: in the import section",
                file=path,
            )
        columns = _columns(path, parts, names, float(info["fps"]))
        rows = range(1, len(columns["t"]) + 1)
        name = episode_name(number)
        tables.append(Table(path, columns, rows, "frame", name=name, kind=LEROBOT))
    videos = [key for key, f in features.items() if f.get("dtype") in _PICTURES]
    version = f"LeRobot dataset {info.get('codebase_version', '')}".strip()
    return Log(path, version, tuple(tables), unread=tuple(videos))


_PICTURES = ("video", "image")


def _info(path: Path) -> Mapping[str, Any]:
    """What the dataset says of itself."""
    file = path / INFO
    info = read_json(file, "is the dataset complete?")
    try:
        fps, features = float(info["fps"]), info["features"]
        complete = fps > 0 and all(isinstance(f, dict) for f in features.values())
    except (ValueError, KeyError, TypeError, AttributeError, OverflowError) as error:
        raise InputError(
            f"cannot be read as the description of a LeRobot dataset ({error!r})",
            "is the dataset complete? it needs fps and features",
            file=file,
        ) from None
    if not complete:
        raise InputError("lacks the rate or the features", file=file)
    return dict(info)


def _names(feature: Mapping[str, Any]) -> list[str]:
    """Names of the entries of a feature: a list, or lists by group."""
    names = feature.get("names")
    if isinstance(names, Mapping):
        groups = [g if isinstance(g, list) else [g] for g in names.values()]
        return [str(name) for group in groups for name in group]
    return [str(name) for name in names] if isinstance(names, list) else []


def _data_files(path: Path, episodes: Sequence[int] | None = None) -> list[Path]:
    """Files of frames; those of version 2 hold one episode each and say so in their names."""
    files = dataset_files(path)[1:]
    if not files:
        raise InputError(
            "has no data/*/*.parquet", "is the dataset complete?", file=path
        )
    check_folder_files(files)
    if episodes is None:
        return files
    own = {f"episode_{number:06d}" for number in episodes}
    return [
        file
        for file in files
        if not file.stem.startswith("episode_") or file.stem in own
    ]


def _read(file: Path, columns: list[str] | None, episodes: Sequence[int] | None) -> Any:
    """Frames of some episodes from one file."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    chosen = None if episodes is None else [(_EPISODE, "in", list(episodes))]
    try:
        check_unpacked(pq.read_metadata(file), file)
        return pq.read_table(file, columns=columns, filters=chosen)
    # a name of a column that is no text is a ValueError
    except (pa.ArrowException, OSError, KeyError, ValueError, MemoryError) as error:
        raise InputError(
            f"cannot be read as frames of a LeRobot dataset ({error})",
            "is the file complete? Git LFS leaves pointers in place of files that were not fetched",
            file=file,
        ) from None


def _columns(
    path: Path, parts: Sequence[Any], names: Mapping[str, list[str]], fps: float
) -> dict[str, np.ndarray]:
    """Columns of one episode from its frames."""
    import pyarrow as pa

    content = pa.concat_tables(parts)
    columns: dict[str, np.ndarray] = {}
    if _TIME in content.column_names:
        columns["t"] = np.asarray(content.column(_TIME), dtype=float)
    else:
        columns["t"] = np.asarray(content.column(_FRAME), dtype=float) / fps
    for key in content.column_names:
        column = content.column(key)
        if pa.types.is_floating(column.type) and key != _TIME:
            columns[key] = np.asarray(column, dtype=float)
        elif pa.types.is_list(column.type) or pa.types.is_fixed_size_list(column.type):
            columns |= _of_lists(path, key, column, names.get(key, []))
    return columns


def _of_lists(
    path: Path, key: str, column: Any, names: Sequence[str]
) -> dict[str, np.ndarray]:
    """A column for each entry of the lists in a column; none if they hold no numbers."""
    try:
        values = np.array(column.to_pylist(), dtype=float)
    except (ValueError, TypeError):
        return {}
    if values.ndim != 2:
        return {}
    count = values.shape[1]
    if names and len(names) != count:
        raise InputError(
            f"names {len(names)} entries of {key}, the frames hold {count}",
            "repair meta/info.json",
            file=path / INFO,
        )
    labels = names or [str(place) for place in range(count)]
    return {f"{key}[{label}]": values[:, i] for i, label in enumerate(labels)}
