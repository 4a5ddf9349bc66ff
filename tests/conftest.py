"""What tests of several folders share: where the measured recordings and the sample cases lie."""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from multiprocessing.util import Finalize
from pathlib import Path
from shutil import rmtree
from typing import NamedTuple

import pytest
from own_effect_page import write_example

from gapscope.arm.robots import KNOWN_ROBOTS
from gapscope.cli import main
from gapscope.effects.catalogue import load_effects, remove
from gapscope.effects.effect import TorqueLaw

# helpers of tests in their sub-folders and in other folders: ``documents``, ``synthetic``, ``problems``
sys.path[:0] = [str(Path(__file__).parent / name) for name in ("diagnosis", "ident")]
# what the scripts of the experiments share
sys.path.append(str(Path(__file__).parents[1] / "experiments"))

BESIDE_THE_PROJECT = Path(__file__).resolve().parents[2] / "shared" / "data"


def pytest_configure(config: pytest.Config) -> None:
    """Let temporary files of the tests, and of programs that they start or kill, lie in one folder that goes with them.

    The folders of ``tmp_path`` stay where pytest keeps them for a look at failed tests.
    """
    if "PYTEST_XDIST_WORKER" in os.environ:
        return  # a worker has the folder of the process that started it
    os.environ.setdefault("PYTEST_DEBUG_TEMPROOT", tempfile.gettempdir())
    # a short name: paths of sockets have at most 107 characters
    folder = tempfile.mkdtemp(prefix="gapscope-")
    os.environ["TMPDIR"] = tempfile.tempdir = folder
    # after multiprocessing's own temporary folder, which lies in it and has the priority -100
    Finalize(None, rmtree, (folder, True), exitpriority=-200)


@pytest.fixture(scope="session")
def data_root() -> Path:
    """The folder of measured recordings and sample cases, which a user of the project does not have."""
    root = Path(os.environ.get("GAPSCOPE_DATA") or BESIDE_THE_PROJECT)
    if not root.is_dir():
        pytest.skip(f"no measured recordings: {root} is no folder (set GAPSCOPE_DATA)")
    return root


@pytest.fixture(scope="session")
def sample_cases(data_root: Path) -> Path:
    """The folder of the sample cases and their labels."""
    folder = data_root / "sample_cases"
    if not (folder / "labels.json").is_file():
        pytest.skip(f"no sample cases in {data_root} (set GAPSCOPE_DATA)")
    return folder


class Outcome(NamedTuple):
    """What a command left: exit code, standard output, standard error, and both in one line."""

    code: int
    out: str
    err: str

    @property
    def said(self) -> str:
        return " ".join((self.out + self.err).split())


@pytest.fixture
def gapscope(capsys: pytest.CaptureFixture[str]) -> Callable[..., Outcome]:
    """Runs a command in this process, as a user would."""

    def call(*arguments: object) -> Outcome:
        with pytest.raises(SystemExit) as ended:
            main([str(argument) for argument in arguments])
        code = ended.value.code
        assert code is None or isinstance(code, int)
        return Outcome(code or 0, *capsys.readouterr())

    return call


@pytest.fixture
def command(gapscope: Callable[..., Outcome]) -> Callable[..., Outcome]:
    """The same, where ``gapscope`` is the package."""
    return gapscope


@pytest.fixture
def cable_drag(tmp_path: Path) -> Iterator[TorqueLaw]:
    """The effect of a user that the documentation shows, in the catalogue for one test."""
    (effect,) = load_effects(write_example(tmp_path))
    assert isinstance(effect, TorqueLaw)
    yield effect
    remove(effect.name)


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Skip what is asked of a robot whose model comes with PyBullet, if that is not installed."""
    robots = {name for name, robot in KNOWN_ROBOTS.items() if robot.plain is None}
    callspec = getattr(item, "callspec", None)
    asked = {str(value) for value in callspec.params.values()} if callspec else set()
    if asked & robots and find_spec("pybullet_data") is None:
        pytest.skip(f"the model of {', '.join(asked & robots)} comes with PyBullet")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo[None]) -> object:
    """Skip instead of fail what asks for PyBullet, by name or by a robot of its, where it has no wheel."""
    report = yield
    asked = call.excinfo is not None and (
        getattr(call.excinfo.value, "remedy", None) or str(call.excinfo.value)
    )
    if asked and "pybullet" in asked and find_spec("pybullet") is None:
        report.outcome = "skipped"
        report.longrepr = (str(item.path), 0, "needs PyBullet, which is not installed")
    return report


LEARN = ("sklearn", "stable_baselines3", "tensorboard", "torch")
"""Packages of the extra ``learn`` that tests need."""


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Say in the last lines what was not run for lack of packages, and how to run it."""
    missing = [name for name in LEARN if find_spec(name) is None]
    if missing:
        terminalreporter.write_line(
            f"not run without {', '.join(missing)}: tests of residual networks and agents; make setup-learn adds them"
        )
