"""The package as a whole: one version everywhere, references that exist, a front door that does not wait."""

import importlib.metadata
import re
import subprocess
import sys
from pathlib import Path

import pytest
from guard import HANG

import gapscope
from gapscope.effects.catalogue import CATALOGUE

ROOT = Path(__file__).parents[1]

FRONT_DOORS = {
    "import": "import gapscope",
    "help": "sys.argv[1:] = ['--help']; from gapscope.cli import main; main()",
    "diagnose": "sys.argv[1:] = ['diagnose', '--help']; from gapscope.cli import main; main()",
    "first line": "import gapscope.terminal as t; t.Progress.__call__ = lambda *_: sys.exit(); "
    "sys.argv[1:] = ['diagnose', 'case', '--out', 'out']; from gapscope.cli import main; main()",
}
"""What a user waits for; the last one ends at the first line of progress."""
HEAVY = {
    *("gymnasium", "joblib", "matplotlib", "mujoco", "numpy", "pandas"),
    *("pinocchio", "pybullet", "scipy", "sklearn", "stable_baselines3", "torch"),
}


@pytest.mark.parametrize("call", FRONT_DOORS.values(), ids=FRONT_DOORS)
def test_front_door_does_not_wait_for_libraries(call):
    code = f"import sys\ntry:\n    {call}\nfinally:\n    print(*sys.modules, file=sys.stderr)"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=HANG
    )
    assert done.returncode == 0, done.stderr
    assert not HEAVY & set(done.stderr.split())


def test_version_is_the_same_everywhere():
    def found(pattern, file):
        text = (ROOT / file).read_text(encoding="utf-8")
        return re.search(pattern, text, re.MULTILINE)[1]

    version = found(r'^version = "(.+)"$', "pyproject.toml")
    assert gapscope.__version__ == importlib.metadata.version("gapscope") == version
    assert found(r"^## \[(.+?)\]", "CHANGELOG.md") == version
    assert found(r"^version: (.+)$", "CITATION.cff") == version


def test_references_of_effects_exist():
    text = (ROOT / "docs/references.md").read_text(encoding="utf-8")
    keys = re.findall(r"^\*\*(\w+)\*\*", text, re.MULTILINE)
    assert {effect.reference for effect in CATALOGUE.values()} <= set(keys)
