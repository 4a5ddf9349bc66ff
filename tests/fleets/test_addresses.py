"""Where cases are found, and what is refused before or while they are fetched."""

from __future__ import annotations

import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import fsspec
import pytest

from gapscope.arm.errors import GapscopeError, InputError
from gapscope.many.cases import (
    all_cases,
    fetch,
    find_cases,
    leaves_folder,
    list_case,
    open_address,
)

CASE = "name: x\nrobot: robot.urdf\nrecordings: [a.csv]\n"


@pytest.fixture
def memory() -> Iterator[Any]:
    """The file system in memory, empty."""
    system = fsspec.filesystem("memory")
    yield system
    system.store.clear()


def put(folder: Path, text: str = CASE) -> Path:
    """A folder with a case file and one more file."""
    folder.mkdir(parents=True)
    (folder / "case.yaml").write_text(text)
    (folder / "a.csv").write_text("t,q1\n")
    return folder


def got(address: str, to: Path, most: int = 10_000) -> int:
    """Fetch a case."""
    to.mkdir()
    system, folder = open_address(address)
    return fetch(system, folder, list_case(system, folder), to, most)


def test_folders_patterns_archives_and_lists(tmp_path: Path, memory: Any) -> None:
    for name in ("a/2026-01-01", "b", "b/deeper"):
        put(tmp_path / name)
    put(tmp_path / "b" / ".deeper.x1" / "new")  # not written to its end
    found = [case.address for case in find_cases(str(tmp_path))]
    assert found == [f"{tmp_path}/{name}" for name in ("a/2026-01-01", "b", "b/deeper")]
    assert [c.address for c in find_cases(f"{tmp_path}/*/2026*")] == found[:1]
    assert [c.address for c in find_cases(f"{tmp_path}/b/case.yaml")] == found[1:]

    with zipfile.ZipFile(tmp_path / "more.zip", "w") as archive:
        archive.writestr("arm/case.yaml", CASE)
        archive.writestr("arm/a.csv", "t,q1\n")
    memory.pipe("/bucket/more.zip", (tmp_path / "more.zip").read_bytes())
    for address in (f"{tmp_path}/more.zip", "zip://::memory://bucket/more.zip"):
        (case,) = find_cases(address)
        assert case.address.startswith("zip://arm::") and case.fingerprint
        size = got(case.address, tmp_path / f"to{len(address)}")
        assert size == len(CASE) + len("t,q1\n")

    table = tmp_path / "cases.csv"
    table.write_text("case,unit,date\nb,arm7,2026-02-03\ns3://x/y,,\n")
    first, second = all_cases((str(table),))
    assert first.address == f"{tmp_path}/b"
    assert (first.unit, first.date) == ("arm7", "2026-02-03")
    assert second.address == "s3://x/y" and not second.unit
    lines = tmp_path / "cases.txt"
    lines.write_text("# two\n\nb\n/abs/c/case.yaml\n")
    assert [c.address for c in all_cases((str(lines),))] == [f"{tmp_path}/b", "/abs/c"]


def test_the_fingerprint_is_that_of_the_listing(tmp_path: Path) -> None:
    folder = put(tmp_path / "x")
    (before,), (same,) = find_cases(str(folder)), find_cases(str(folder))
    assert before.fingerprint == same.fingerprint
    (folder / "a.csv").write_text("t,q1\n1,2\n")
    (after,) = find_cases(str(folder))
    assert after.fingerprint != before.fingerprint


@pytest.mark.parametrize(
    ("address", "text", "said"),
    [
        ("nowhere", "", "no case.yaml"),
        ("unknown://x", "", "cannot be opened"),
        ("bad.csv", "case,date\nx,soon\n", "line 2: 'soon' is no date"),
        ("empty.csv", "case,date\n,2026-01-01\n", "line 2: names no case"),
        ("other.csv", "folder\nx\n", "line 1: has the columns folder"),
        ("missing.txt", "", "cannot be read"),
    ],
)
def test_addresses_that_cannot_be_used(
    tmp_path: Path, monkeypatch, address: str, text: str, said: str
) -> None:
    monkeypatch.chdir(tmp_path)
    if text:
        Path(address).write_text(text)
    with pytest.raises(GapscopeError, match=said):
        list(all_cases((address,)))


@pytest.mark.parametrize(
    "name", ["../x", "a/../../x", "/etc/passwd", "..\\x", "C:\\x", "C:x", "\\x", ""]
)
def test_names_that_leave_the_folder(name: str) -> None:
    assert leaves_folder(name)
    assert not leaves_folder("a/b..c.csv")


@pytest.mark.parametrize(
    ("field", "case"),
    [
        ("robot", CASE.replace("robot.urdf", "../robot.urdf")),
        ("recordings", CASE.replace("a.csv", "/etc/passwd")),
        ("judge", CASE + "judge: ['${GAPSCOPE_DATA}/x.csv']\n"),
        ("import.calibration", CASE + "import: {calibration: ../c.json}\n"),
    ],
)
def test_a_case_that_reads_other_files_is_refused(
    tmp_path: Path, field: str, case: str
) -> None:
    put(tmp_path / "x", case)
    with pytest.raises(InputError, match=f"field {field}: names .* outside"):
        got(str(tmp_path / "x"), tmp_path / "to")


def test_links_large_cases_and_archives_that_lie_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = put(tmp_path / "x")
    with pytest.raises(InputError, match="2 files of"):
        got(str(folder), tmp_path / "to1", most=10)
    monkeypatch.setattr("gapscope.many.cases._check_files", lambda *_: None)
    with pytest.raises(InputError, match="more than its storage says"):
        got(str(folder), tmp_path / "to2", most=10)
    monkeypatch.undo()
    (folder / "b.csv").symlink_to(folder / "a.csv")
    with pytest.raises(InputError, match=r"b\.csv is a link"):
        got(str(folder), tmp_path / "to3")
    with zipfile.ZipFile(tmp_path / "evil.zip", "w") as archive:
        archive.writestr("case.yaml", CASE)
        archive.writestr("../evil", "")
    with pytest.raises(InputError, match=r"'\.\./evil' leaves"):
        got(f"zip://::{tmp_path}/evil.zip", tmp_path / "to4")
    assert not (tmp_path / "evil").exists()
