"""Growing files and folders: what is new, once, whatever the writer does."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gapscope.arm.errors import InputError
from gapscope.arm.recording import Recording
from gapscope.watching.detector import Event
from gapscope.watching.watch import Folder, GrowingFile, Reading, check_readable

Write = Callable[[Recording, Path], Path]


def samples(items: list[Any]) -> np.ndarray:
    """Times of all rows that a source gave."""
    parts = [item.t for item in items if isinstance(item, Recording)]
    return np.concatenate([np.empty(0), *parts])


def notes(items: list[Any]) -> str:
    return "\n".join(item.sentence for item in items if isinstance(item, Event))


@pytest.fixture
def reading(at_work: Any) -> Reading:
    return Reading(at_work.arm, None)


@pytest.fixture
def log(at_work: Any, write_csv: Write, tmp_path: Path) -> bytes:
    """The text of a recording of 4 s, 400 rows."""
    return write_csv(at_work.recording(4.0), tmp_path / "whole.csv").read_bytes()


class Growing:
    """A file to which parts are written, and what a source that follows it gives."""

    def __init__(self, file: Path, reading: Reading, first: bytes) -> None:
        self.file, self.reading = file, reading
        file.write_bytes(first)
        self.source = GrowingFile(file, reading, rest=30.0)
        self.first = list(self.source.poll())

    def add(self, part: bytes) -> None:
        with self.file.open("ab") as growing:
            growing.write(part)

    def polled(self, part: bytes = b"") -> list[Any]:
        self.add(part)
        return list(self.source.poll())


@pytest.fixture
def growing(reading: Reading, tmp_path: Path) -> Callable[[bytes], Growing]:
    return lambda first: Growing(tmp_path / "log.csv", reading, first)


def rows(log: bytes, first: int, last: int | None = None) -> bytes:
    """Whole lines of a log, the head is number 0."""
    return b"".join(log.splitlines(keepends=True)[first:last])


@pytest.mark.parametrize("later_run", [False, True])
def test_half_a_line_waits_for_the_rest(
    later_run: bool, growing: Any, log: bytes
) -> None:
    """Also for a later run that goes on at the position."""
    cut = len(log) // 2
    made = growing(log[:cut])
    if later_run:
        position = made.source.position()
        made.source = GrowingFile(made.file, made.reading, 30.0, position)
    t = samples(made.first + made.polled(log[cut:]))
    assert np.allclose(t, np.arange(400) / 100)
    assert 0 < len(samples(made.first)) < 400


@pytest.mark.parametrize("start", [0, 100_000, 1_790_000_000])
def test_parts_go_on_by_the_clock_of_the_log(
    start: int, growing: Any, log: bytes
) -> None:
    head, *lines = log.decode().splitlines()
    split = (line.partition(",") for line in lines)
    later = [f"{start + float(t):.6f},{rest}\n".encode() for t, _, rest in split]
    half = len(later) // 2
    made = growing(head.encode() + b"\n" + b"".join(later[:half]))
    t = samples(made.first + made.polled(b"".join(later[half:])))
    assert np.allclose(np.diff(t), 1 / 100, atol=1e-6)


def test_a_file_that_was_cut_is_read_from_its_start(growing: Any, log: bytes) -> None:
    made = growing(log)
    made.file.write_bytes(rows(log, 0, 201))
    again = made.polled()
    assert "was cut" in notes(again)
    assert len(samples(again)) == 200
    assert again[-1].name == "log.csv (2)"


@pytest.mark.parametrize("stop", [201, 111])
def test_rotation_loses_nothing(stop: int, growing: Any, log: bytes) -> None:
    """Nor the last lines, too few to be read before."""
    made = growing(rows(log, 0, 101))
    made.add(rows(log, 101, stop))
    made.file.rename(made.file.with_suffix(".1"))
    made.file.write_bytes(rows(log, 0, 1) + rows(log, stop))
    second = made.polled()
    assert "took its place" in notes(second)
    assert np.allclose(samples(made.first + second), np.arange(400) / 100)


def test_the_last_lines_are_read_once_the_file_rests(growing: Any, log: bytes) -> None:
    made = growing(rows(log, 0, 375))
    assert made.polled(rows(log, 375)) == [] and made.source.unfinished
    long_ago = made.file.stat().st_mtime - 60
    os.utime(made.file, (long_ago, long_ago))
    t = samples(made.first + list(made.source.poll()))
    assert np.allclose(t, np.arange(400) / 100) and not made.source.unfinished


def test_a_damaged_row_is_left_out_with_its_line(growing: Any, log: bytes) -> None:
    made = growing(rows(log, 0, 101))
    bad = rows(log, 150, 151).split(b",")
    bad[3] = b"nan"
    said = made.polled(rows(log, 101, 150) + b",".join(bad) + rows(log, 151, 152))
    assert "line 151" in notes(said)
    assert made.reading.failure is None
    assert len(samples(made.polled(rows(log, 152)))) > 200


def test_remarks_and_a_wrong_byte_take_no_more_than_their_lines(
    growing: Any, log: bytes
) -> None:
    above, bad = b"# logged in cell 4\n", rows(log, 20, 21).replace(b",", b"\xff,", 1)
    made = growing(above + rows(log, 0, 20) + bad + rows(log, 21, 201))
    assert "line 22" in notes(made.first)
    assert len(samples(made.first + made.polled(rows(log, 201)))) == 399


def test_a_file_in_a_folder_is_read_once_it_rests(
    reading: Reading, log: bytes, tmp_path: Path
):
    folder = tmp_path / "logs"
    folder.mkdir()
    for name in ("run_10.csv", "run_9.csv", ".hidden.csv", "run_11.csv.part"):
        (folder / name).write_bytes(log)
    writing = folder / "run_10.csv"
    old = writing.stat().st_mtime - 60
    os.utime(folder / "run_9.csv", (old, old))
    source = Folder(folder, reading, rest=30.0)
    assert [item.name for item in source.poll()] == ["run_9.csv"]
    os.utime(writing, (old, old))
    assert [item.name for item in source.poll()] == ["run_10.csv"]
    assert list(source.poll()) == []
    resumed = Folder(folder, reading, rest=30.0, position=source.position())
    assert list(resumed.poll()) == []


def test_an_unreadable_file_is_tried_again_when_it_grew(
    reading: Reading, log: bytes, tmp_path: Path
):
    file = tmp_path / "run.csv"
    file.write_bytes(b"")
    source = Folder(tmp_path, reading, rest=0.0, without=None)
    (tmp_path / "whole.csv").unlink()
    assert "run.csv" in notes(list(source.poll()))
    assert list(source.poll()) == []
    file.write_bytes(log)
    assert len(samples(list(source.poll()))) == 400


def test_a_dataset_in_a_folder_is_said_to_be_left_out(
    reading: Reading, tmp_path: Path
) -> None:
    info = tmp_path / "logs" / "pick" / "meta" / "info.json"
    info.parent.mkdir(parents=True)
    info.write_text("{}", encoding="utf-8")
    source = Folder(tmp_path / "logs", reading, rest=0.0)
    assert "pick: is a LeRobot dataset" in notes(list(source.poll()))
    assert list(source.poll()) == []
    with pytest.raises(InputError, match="is a LeRobot dataset"):
        check_readable(tmp_path / "logs" / "pick")


def test_a_split_bag_is_read_file_by_file(
    at_work: Any, reading: Reading, tmp_path: Path
):
    """Of a bag that is still being written, all files but the newest are complete."""
    rosbag2 = pytest.importorskip("rosbags.rosbag2")
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    state = store.types["sensor_msgs/msg/JointState"]
    header = store.types["std_msgs/msg/Header"]
    stamp = store.types["builtin_interfaces/msg/Time"]
    bag = tmp_path / "logs" / "work"
    bag.mkdir(parents=True)
    recording = at_work.recording(6.0)
    for number in range(2):
        single = tmp_path / f"single_{number}"
        with rosbag2.Writer(single, version=9) as writer:
            kind = state.__msgtype__
            topic = writer.add_connection("/joint_states", kind, typestore=store)
            for k in range(300 * number, 300 * (number + 1)):
                seconds, rest = divmod(recording.t[k], 1.0)
                when = stamp(sec=int(seconds), nanosec=int(rest * 1e9))
                above, names = header(stamp=when, frame_id=""), list(at_work.arm.joints)
                series = recording.q[k], np.empty(0), np.asarray(recording.tau)[k]
                raw = store.serialize_cdr(state(above, names, *series), kind)
                writer.write(topic, int(recording.t[k] * 1e9), raw)
        next(single.glob("*.db3")).rename(bag / f"work_{number}.db3")
    source = Folder(bag.parent, reading, rest=3600.0)
    assert [item.name for item in source.poll()] == ["work/work_0.db3"]
    (bag / "metadata.yaml").write_text("", encoding="utf-8")
    assert [item.name for item in source.poll()] == ["work/work_1.db3"]
