"""Commands of the documentation are commands of the program: names, options and arguments are parsed as typed."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest
import typer.main

from gapscope.cli import app

ROOT = Path(__file__).parents[1]
PAGES = sorted(
    [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").rglob("*.md")]
)
FENCED = re.compile(r"```.*?\n(.*?)```", re.DOTALL)
INDENTED = re.compile(r"^ {4}.*$", re.MULTILINE)
COMMAND = re.compile(r"^ *(?:\.venv/bin/)?gapscope ((?:.*\\\n)*.*)$", re.MULTILINE)
INLINE = re.compile(r"`gapscope ([a-z]+(?: |\n)[^`]+)`")
NUMBERS = {"N": "1", "HZ": "1.0", "MASS": "1.0"}
"""Placeholders of numbers in the syntax of commands."""
FRAGMENTARY = {"MissingParameter", "BadOptionUsage"}
"""Errors that a command in running text may show: it names what the sentence is about, and no more."""


def words(command: str) -> list[str]:
    """Words of a command: all that may be given is given, and of several values the first."""
    command = re.sub(r"\s#.*", "", command.replace("\\\n", " "))
    command = re.sub(r"[\[\]]", "", command).replace("\\|", "|")
    parts = [word.split("|")[0].removesuffix("...") for word in shlex.split(command)]
    return [NUMBERS.get(word, word) for word in parts if word]


def parse(parts: list[str]) -> None:
    """Parse without running; raises what the command line would show a user."""
    command = typer.main.get_command(app)
    while hasattr(command, "commands"):
        name = parts[0]
        assert name in command.commands, f"no command {name}"
        command, parts = command.commands[name], parts[1:]
    command.make_context("gapscope", parts)


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.relative_to(ROOT).as_posix())
def test_commands_of_a_page_are_understood(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    blocks = "\n".join([*FENCED.findall(text), *INDENTED.findall(text)])
    whole = COMMAND.findall(blocks)
    for command in [*whole, *INLINE.findall(FENCED.sub("", text))]:
        try:
            parse(words(command))
        except Exception as error:
            if command in whole or type(error).__name__ not in FRAGMENTARY:
                pytest.fail(f"gapscope {command}: {error}")


@pytest.mark.parametrize(
    "wrong", ["diagnos CASE --out DIR", "diagnose CASE --outt DIR", "gap --json"]
)
def test_wrong_commands_would_be_noticed(wrong: str) -> None:
    with pytest.raises((AssertionError, Exception), match=r"no|No|Missing"):
        parse(words(wrong))
