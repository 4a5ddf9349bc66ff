"""LeRobot datasets, laid out as versions 2.1 and 3.0 are documented."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import yaml

from gapscope.arm.case import case_files, load_case
from gapscope.arm.errors import InputError
from gapscope.arm.io.case_file import files_of
from gapscope.arm.io.import_section import parse_import
from gapscope.arm.io.load_recording import load_recording
from gapscope.arm.io.log import open_log
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording

Read = Callable[..., Recording]
FPS = 50
FRAMES = 100


def episode(number: int) -> dict[str, np.ndarray]:
    """Positions [deg] and commands of both joints and a gripper, (FRAMES, 3) each."""
    t = np.arange(FRAMES, dtype=np.float32)[:, None] / FPS
    state = np.hstack([40 * np.sin(3 * t + number), 20 * np.cos(4 * t), 50 + 0 * t])
    effort = np.hstack([np.cos(3 * t), np.sin(4 * t), 0 * t])
    return {
        "observation.state": state,
        "action": state + np.float32(1),
        "observation.effort": effort,
    }


def frames(number: int) -> pa.Table:
    """One episode as a data file holds it."""
    columns: dict[str, Any] = {
        name: pa.array(list(values), type=pa.list_(pa.float32(), 3))
        for name, values in episode(number).items()
    }
    count = np.arange(FRAMES)
    columns["timestamp"] = (count / FPS).astype(np.float32)
    columns["frame_index"] = count
    columns["episode_index"] = np.full(FRAMES, number)
    return pa.table(columns)


def dataset(folder: Path, version: str, names: Any, episodes: int = 3) -> Path:
    """A dataset of several episodes."""
    feature = {"dtype": "float32", "shape": [3], "names": names}
    features: dict[str, Any] = {key: feature for key in episode(0)}
    features["observation.images.top"] = {"dtype": "video", "shape": [480, 640, 3]}
    info = {"codebase_version": version, "fps": FPS, "features": features}
    (folder / "meta").mkdir(parents=True)
    (folder / "meta" / "info.json").write_text(json.dumps(info))
    chunk = folder / "data" / "chunk-000"
    chunk.mkdir(parents=True)
    tables = [frames(number) for number in range(episodes)]
    if version == "v2.1":
        for number, table in enumerate(tables):
            pq.write_table(table, chunk / f"episode_{number:06d}.parquet")
    else:
        pq.write_table(pa.concat_tables(tables), chunk / "file-000.parquet")
    return folder


NEW_NAMES = ["shoulder.pos", "elbow.pos", "gripper.pos"]
OLD_NAMES = {"motors": ["shoulder", "elbow", "gripper"]}


@pytest.fixture(params=[("v2.1", OLD_NAMES), ("v3.0", NEW_NAMES)])
def folder(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """A dataset of three episodes, in both versions."""
    return dataset(tmp_path / "dataset", *request.param)


@pytest.fixture
def read(folder: Path, arm: NominalArm, tmp_path: Path) -> Read:
    """An episode by an import section."""

    def of(episode: int, **section: Any) -> Recording:
        how = parse_import(section, 2, tmp_path / "case.yaml")
        return load_recording(folder, arm, how, episode=episode)

    return of


def state_of(number: int) -> np.ndarray:
    """Positions of both joints [deg], (FRAMES, 2)."""
    return episode(number)["observation.state"][:, :2].astype(float)


def test_each_episode_is_a_table(folder: Path) -> None:
    log = open_log(folder)
    assert log.format.startswith("LeRobot dataset v")
    assert log.names == ["episode 0", "episode 1", "episode 2"]
    assert log.unread == ("observation.images.top",)
    columns = log.tables[1].columns
    np.testing.assert_allclose(columns["t"], np.arange(FRAMES) / FPS, atol=1e-6)
    first = next(name for name in columns if name.startswith("observation.state"))
    expected = episode(1)["observation.state"][:, 0]
    np.testing.assert_array_equal(columns[first], expected)


def test_degrees_with_the_action_as_the_reference(read: Read) -> None:
    recording, state = read(2, q={"unit": "deg"}, tau=None), state_of(2)
    np.testing.assert_allclose(recording.q, np.deg2rad(state))
    np.testing.assert_allclose(recording.q_ref, np.deg2rad(state + 1), atol=1e-6)
    assert recording.tau is None and recording.name == "dataset episode 2"
    pushed = read(0, q={"unit": "deg"}, tau={"scale": 0.5}).tau
    effort = episode(0)["observation.effort"][:, :2].astype(float)
    np.testing.assert_allclose(pushed, 0.5 * effort)
    # the unit has to be said
    with pytest.raises(InputError, match="does not say whether its positions are"):
        read(0, tau=None)
    with pytest.raises(InputError, match="give the arm's calibration file"):
        read(0, q={"unit": "normalised"}, tau=None)


MOTOR = {"drive_mode": 0, "homing_offset": 12, "range_min": 1024, "range_max": 3072}
NORMALISED = {"q": {"unit": "normalised"}, "tau": None, "calibration": "arm.json"}


def calibrate(folder: Path, **elbow: int) -> Path:
    """Write the arm's calibration."""
    content = {"shoulder": MOTOR, "elbow": MOTOR | elbow}
    (folder / "arm.json").write_text(json.dumps(content))
    return folder / "arm.json"


def test_normalised_positions_with_a_calibration(read: Read, tmp_path: Path) -> None:
    calibrate(tmp_path, range_min=0, range_max=1024, drive_mode=1)
    recording, state = read(0, **NORMALISED), state_of(0) / 100 * np.pi
    # 2048 of 4096 steps are half a turn, from -100 to 100; 1024 a quarter, counted backwards
    np.testing.assert_allclose(recording.q, state * [1 / 2, -1 / 4])
    expected = state[:, 0] / 2 + np.pi / 200
    np.testing.assert_allclose(recording.q_ref[:, 0], expected, atol=1e-6)


NO_CALIBRATIONS = [
    ("[", "is not valid JSON"),
    ("{}", "expected a mapping"),
    ('{"elbow": {"range_min": 1}}', "motor elbow: expected the numbers drive_mode"),
    (json.dumps({"elbow": MOTOR | {"range_max": 5}}), "range_min 1024 is not below"),
]


@pytest.mark.parametrize(("content", "message"), NO_CALIBRATIONS)
def test_bad_calibrations(content: str, message: str, tmp_path: Path) -> None:
    (tmp_path / "arm.json").write_text(content)
    with pytest.raises(InputError, match=message):
        parse_import({"calibration": "arm.json"}, 2, tmp_path / "case.yaml")


@pytest.fixture
def case(folder: Path, urdf: Path) -> Callable[..., Path]:
    """A case of the dataset with an import section."""

    def of(**section: Any) -> Path:
        content = {"name": "hobby", "robot": urdf.name, "recordings": [folder.name]}
        file = folder.parent / "case.yaml"
        file.write_text(yaml.safe_dump(content | {"import": section}))
        return file

    return of


def test_a_case_chooses_episodes(case: Callable[..., Path]) -> None:
    read = {"q": {"unit": "deg"}, "tau": None}
    names = [recording.name for recording in load_case(case(**read)).recordings]
    assert names == [f"dataset episode {number}" for number in range(3)]
    some = load_case(case(**read, episodes={"fit": [0, 2], "judge": [1]}))
    assert [r.name[-1] for r in (*some.recordings, *some.judged)] == ["0", "2", "1"]
    (one,) = load_case(case(**read, topic="episode 1")).recordings
    assert one.name == "dataset episode 1"
    with pytest.raises(InputError, match="has no episode 7; it has 0, 1, 2"):
        load_case(case(**read, episodes={"fit": [7]}))


def test_a_calibration_is_a_file_of_a_case_and_videos_are_none(
    case: Callable[..., Path], folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calibration = calibrate(folder.parent)
    assert calibration in case_files(case(**NORMALISED).parent)
    # below the folder with the data sets, as any path of a case
    monkeypatch.setenv("GAPSCOPE_DATA", str(folder.parent))
    there = NORMALISED | {"calibration": "${GAPSCOPE_DATA}/arm.json"}
    assert calibration in case_files(case(**there).parent)
    (folder / "videos").mkdir()
    (folder / "videos" / "top.mp4").touch()
    assert {path.suffix for path in files_of(folder)} == {".json", ".parquet"}


WHOLE = frames(0)
SOON = pa.array(["soon"] * FRAMES)
FRAMES_OF = "frames of a LeRobot dataset"
DAMAGED: list[tuple[str, str | pa.Table | None, str]] = [
    ("info", '{"fps": "fast"}', "description of a LeRobot dataset"),
    ("data", "version https://git-lfs.github.com/spec/v1\n", "Git LFS leaves pointers"),
    ("data", None, "has no data"),
    ("names", None, "names 1 entries of observation.state, the frames hold 3"),
    ("data", WHOLE.drop_columns(["episode_index"]), FRAMES_OF),
    ("data", WHOLE.drop_columns(["timestamp", "frame_index"]), FRAMES_OF),
    ("data", WHOLE.drop_columns(["timestamp"]).append_column("timestamp", SOON), FRAMES_OF),
]  # fmt: skip
"""A part of a data set, what stands there instead, and what is said."""


@pytest.mark.parametrize(("part", "content", "message"), DAMAGED)
def test_damaged_datasets(
    part: str, content: str | pa.Table | None, message: str, tmp_path: Path
) -> None:
    names = ["a"] if part == "names" else NEW_NAMES
    folder = dataset(tmp_path / "dataset", "v3.0", names, episodes=1)
    info = folder / "meta" / "info.json"
    path = (
        info if part == "info" else folder / "data" / "chunk-000" / "file-000.parquet"
    )
    if isinstance(content, str):
        path.write_text(content)
    elif content is not None:
        pq.write_table(content, path)
    elif part == "data":
        path.unlink()
    with pytest.raises(InputError, match=message):
        open_log(folder)
