"""One run at a time in a folder, and nothing that looks whole after a write that was killed."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from gapscope.arm.errors import GapscopeError
from gapscope.arm.io.locked_section import LOCK, locked

KILLED = """
import os, signal, sys
from pathlib import Path
from gapscope.arm.io.locked_section import locked
from gapscope.arm.io.atomic_write import atomic_write
folder = Path(sys.argv[1])
with locked(folder), atomic_write(folder / "diagnosis.json") as aside:
    aside.write_text('{"schema": ')
    print("writes", flush=True)
    sys.stdin.read()
"""


WRITERS = (
    *("identify case", "diagnose case", "diagnose case other", "residual case"),
    *("agree case", "audit kuka_iiwa", "blind run cases", "fleet cases"),
)


@pytest.mark.parametrize("words", WRITERS)
def test_a_second_run_in_a_folder_says_who_holds_it(
    words: str,
    command: Callable[..., Any],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    if "residual" in words:
        pytest.importorskip("torch", reason="the command asks for torch first")
    (tmp_path / "identification.json").write_text("{}")
    monkeypatch.setattr(sys, "argv", ["gapscope", "identify", "my_arm"])
    with locked(tmp_path):
        ended = command(*words.split(), "--out", tmp_path)
    held = f"{tmp_path}: another run writes to this folder: process {os.getpid()} on"
    assert ended.code == 1 and held in ended.err
    assert "gapscope identify my_arm\n" in ended.err
    assert "choose another folder" in ended.err
    # what the first run writes is left alone
    assert (tmp_path / "identification.json").is_file()
    assert not (tmp_path / LOCK).exists()


def test_a_killed_run_leaves_nothing_whole_and_holds_nothing(tmp_path: Path) -> None:
    out = tmp_path / "out"
    words = [sys.executable, "-c", KILLED, str(out)]
    with subprocess.Popen(
        words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as run:
        assert run.stdout is not None and run.stdout.readline() == "writes\n"
        with pytest.raises(GapscopeError, match=f"process {run.pid} on"), locked(out):
            pass
        run.send_signal(signal.SIGKILL)
    assert (out / LOCK).is_file() and not (out / "diagnosis.json").exists()
    with locked(out):
        assert (out / LOCK).is_file()
    assert not (out / LOCK).exists()


def test_a_folder_made_for_nothing_is_removed(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="no"), locked(tmp_path / "new"):
        raise ValueError("no")
    assert not (tmp_path / "new").exists()
