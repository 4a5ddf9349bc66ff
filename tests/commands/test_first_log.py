"""The page for newcomers with a log: its commands, run in its order, do what it says."""

from __future__ import annotations

import json
import re
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

PAGE = Path(__file__).parents[2] / "docs" / "first_log.md"


@pytest.mark.slow
def test_commands_of_the_page_run_in_their_order(
    gapscope: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = PAGE.read_text(encoding="utf-8")
    every = re.findall(r"```yaml\n(.*?)```", text, re.DOTALL)
    # other blocks are lines of a case
    (effects,) = [block for block in every if block.startswith("# effects.yaml")]
    commands = re.findall(r"```sh\ngapscope (.*?)\n```", text)
    monkeypatch.chdir(tmp_path)
    Path("effects.yaml").write_text(effects, encoding="utf-8")

    said = {}
    for command in commands:
        done = gapscope(*shlex.split(command))
        assert done.code == 0, f"{command}: {done.err}"
        said[command.split()[0]] = " ".join((done.out + done.err).split())

    assert list(said) == ["record", "inspect", "check", "diagnose", "gap", "export"]
    assert "can be diagnosed" in said["check"]
    assert "Sign flip (joint 4)" in said["diagnose"]
    found = json.loads(Path("out/diagnosis.json").read_text(encoding="utf-8"))
    payload = next(e for e in found["effects"] if e["effect"] == "payload")
    assert payload["parameters"]["mass"]["value"] == pytest.approx(1.5, abs=0.02)
    assert Path("arm.xml").is_file()
