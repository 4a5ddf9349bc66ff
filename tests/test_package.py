"""The package as a whole: one version everywhere, references that exist, imports that go one way."""

import ast
import importlib.metadata
import re
import subprocess
import sys
from pathlib import Path

import pytest

import gapscope
from effects.catalogue import CATALOGUE

ROOT = Path(__file__).parents[1]

MAY_IMPORT = {
    "arm": set(),
    "effects": {"arm"},
    "envs": {"arm", "effects"},
    "ident": {"arm", "effects"},
    "diagnosis": {"arm", "effects", "envs", "ident"},
    "agents": {"arm", "effects", "envs", "ident", "diagnosis"},
    "gapscope": {"arm", "effects", "envs", "ident", "diagnosis", "agents"},
}
"""What each package may import of the project."""

ONLY_IN = {
    "pinocchio": ("arm/", "ident/regressor.py"),
    "pybullet": ("envs/engines/",),
    "pybullet_data": ("envs/engines/",),
    "mujoco": ("envs/engines/", "diagnosis/blind/generator/rigid.py"),
    "numba": ("diagnosis/blind/generator/joint.py",),
    "dartpy": ("envs/engines/",),
    "torch": ("ident/residual/", "agents/training/"),
    "stable_baselines3": ("agents/training/",),
    "optuna": ("agents/training/tuning.py",),
    "sklearn": ("ident/residual/baselines.py",),
}
"""The only places that may import a library."""

OURS = {*MAY_IMPORT, "experiments", "tests"}
MODULES = [path for package in MAY_IMPORT for path in sorted((ROOT / package).rglob("*.py"))]


def imported(path: Path) -> set[str]:
    """Top-level names of what a module imports, lazy imports included."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            names.add(node.module)
    return {name.split(".")[0] for name in names}


@pytest.mark.parametrize("path", MODULES, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_imports_go_one_way(path):
    module = path.relative_to(ROOT).as_posix()
    package = module.split("/")[0]
    names = imported(path)
    assert names & OURS <= MAY_IMPORT[package] | {package}
    for library, places in ONLY_IN.items():
        assert library not in names or module.startswith(places)


FRONT_DOORS = {
    "import": "import gapscope",
    "help": "sys.argv[1:] = ['--help']; from gapscope.cli import main; main()",
    "diagnose": "sys.argv[1:] = ['diagnose', '--help']; from gapscope.cli import main; main()",
}


@pytest.mark.parametrize("call", FRONT_DOORS.values(), ids=FRONT_DOORS)
def test_front_door_does_not_wait_for_learning_libraries(call):
    code = f"import sys\ntry:\n    {call}\nfinally:\n    print(*sys.modules, file=sys.stderr)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    assert not {"torch", "stable_baselines3", "sklearn"} & set(done.stderr.split())


def test_version_is_the_same_everywhere():
    def found(pattern, file):
        return re.search(pattern, (ROOT / file).read_text(encoding="utf-8"), re.MULTILINE)[1]

    version = found(r'^version = "(.+)"$', "pyproject.toml")
    assert gapscope.__version__ == importlib.metadata.version("gapscope") == version
    assert found(r"^## \[(.+?)\]", "CHANGELOG.md") == version
    assert found(r"^version: (.+)$", "CITATION.cff") == version


@pytest.mark.parametrize("effect", CATALOGUE.values(), ids=CATALOGUE)
def test_reference_of_an_effect_exists(effect):
    keys = re.findall(r"^\*\*(\w+)\*\*", (ROOT / "docs/references.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert effect.reference in keys
