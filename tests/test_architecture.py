"""Imports inside the package: one way, no cycles, libraries only where they belong; effects named in records alone."""

from __future__ import annotations

import ast
from collections import Counter
from functools import cache
from pathlib import Path

import pytest

from gapscope.effects import (
    actuation,
    catalogue,
    environment,
    friction,
    rigid_body,
    sensing,
    transmission,
)
from gapscope.effects.effect import Effect

FAMILIES = (
    *(actuation, catalogue, environment, friction),
    *(rigid_body, sensing, transmission),
)
"""Modules that hold the records of effects."""

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "gapscope"

LAYERS: tuple[set[str], ...] = (
    {"arm"},
    {"effects"},
    {"model", "model_audit"},
    {"envs", "ident"},
    {"diagnosis"},
    {"inspection", "installation"},
    {"provenance"},
    {"agents", "blind_check", "case_check", "watching"},
    {"reports"},
    {"interface"},
    {"terminal"},
    {"many"},
    {"commands"},
    {"cli", "__main__"},
)
"""Folders and modules below ``gapscope``; each imports its own layer's and lower ones."""

APART = ({"envs", "ident"}, {"agents", "blind_check"})
"""Never import each other, although they share a layer."""

DIAGNOSIS_LAYERS: tuple[set[str], ...] = (
    {"change_points", "thresholds"},
    {"gap", "setup_faults"},
    {"locate", "selection"},
    {"agreement", "states", "told_controller"},
    {"prepare"},
    {"assessment", "comparison"},
    {"result"},
    {"document"},
    {"diagnose", "set_up"},
    {"diagnose_change", "next_recording"},
    {"compare_units"},
)
"""The same inside ``diagnosis``."""

ONLY_IN = {
    "pinocchio": ("arm/", "ident/model/regressor.py"),
    "pybullet": ("envs/engines/",),
    "pybullet_data": ("envs/engines/",),
    "mujoco": (
        "arm/dynamics/description.py",
        "envs/engines/",
        "blind_check/generator/rigid.py",
    ),
    "numba": ("blind_check/generator/joint.py",),
    "dartpy": (),
    "torch": ("ident/residual/", "agents/training/"),
    "stable_baselines3": ("agents/training/",),
    "optuna": ("agents/training/training_loop.py",),
    "sklearn": (
        "ident/residual/fit.py",
        "blind_check/baselines.py",
    ),
}
"""The only places that may import a library."""

EFFECTS = {
    value.name: key
    for source in FAMILIES
    for key, value in vars(source).items()
    if isinstance(value, Effect)
}
"""The record of each effect in the package, by the effect's name."""

NAMES_EFFECTS: dict[str, str] = {
    f"gapscope.{module}": reason
    for reason, modules in {
        "armature is the data sheet's or a model file's own key": (
            *("arm.nominal", "arm.robots"),
            "envs.mystery_arm",
            *("model_audit.checks",),
            "diagnosis.diagnose_change",
        ),
        "payload is the case's key of a known load": ("diagnosis.document.content",),
        "the blind check keeps what hides what, and plain methods, apart": (
            *("blind_check.baselines", "blind_check.check", "blind_check.scoring"),
        ),
    }.items()
    for module in modules
}
"""Modules outside ``effects/`` that name an effect all the same, with what for. No new ones: ask the records."""

FILES = {
    ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(
        ".__init__"
    ): path
    for path in sorted(PACKAGE.rglob("*.py"))
}
"""Path of each module, by its dotted name."""


@cache
def imports_of(module: str) -> frozenset[str]:
    """Dotted names that a module imports, lazy ones and those for type checking included."""
    tree = ast.parse(FILES[module].read_text(encoding="utf-8"))
    names = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            whole = {f"{node.module}.{alias.name}" for alias in node.names}
            submodules = whole & FILES.keys()
            names.update(
                submodules if submodules == whole else {*submodules, node.module}
            )
    return frozenset(names - {module})


def layer_of(name: str, layers: tuple[set[str], ...]) -> int:
    """Number of the layer that holds a folder or module."""
    return next(number for number, layer in enumerate(layers) if name in layer)


def parts_below(module: str, folder: str) -> str | None:
    """First part of a module's name below a folder, if it lies in there."""
    return (
        module.removeprefix(f"{folder}.").split(".")[0]
        if module.startswith(f"{folder}.")
        else None
    )


def check_layers(module: str, folder: str, layers: tuple[set[str], ...]) -> None:
    """Assert that what a module imports below a folder lies in its own layer or a lower one."""
    place = parts_below(module, folder)
    if place is None:
        return
    for imported in imports_of(module):
        other = parts_below(imported, folder)
        if other is not None:
            assert layer_of(other, layers) <= layer_of(place, layers), imported


@pytest.mark.parametrize("module", FILES)
def test_imports_go_one_way(module):
    check_layers(module, "gapscope", LAYERS)
    check_layers(module, "gapscope.diagnosis", DIAGNOSIS_LAYERS)
    place = parts_below(module, "gapscope")
    for pair in APART:
        if place in pair:
            others = {parts_below(name, "gapscope") for name in imports_of(module)}
            assert not others & (pair - {place})


@pytest.mark.parametrize("module", FILES)
def test_libraries_are_imported_where_they_belong(module):
    place = FILES[module].relative_to(PACKAGE).as_posix()
    libraries = {name.split(".")[0] for name in imports_of(module)}
    for library, places in ONLY_IN.items():
        assert library not in libraries or place.startswith(places)


def test_no_module_imports_itself_by_way_of_others():
    waiting = {m: {n for n in imports_of(m) if n in FILES} for m in FILES}
    while waiting:
        free = {
            module for module, needed in waiting.items() if not needed & waiting.keys()
        }
        assert free, f"cycle among {sorted(waiting)}"
        waiting = {
            module: needed for module, needed in waiting.items() if module not in free
        }


def effects_named(module: str) -> set[str]:
    """Effects that a module names: as a string, docstrings aside, or by importing their record."""
    tree = ast.parse(FILES[module].read_text(encoding="utf-8"))
    documented = {
        id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)
    }
    named = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and id(node) not in documented:
            named |= {node.value} & EFFECTS.keys()
        elif isinstance(node, ast.ImportFrom) and (node.module or "").startswith(
            "gapscope.effects"
        ):
            records = {alias.name for alias in node.names}
            named |= {name for name, record in EFFECTS.items() if record in records}
    return named


def test_effects_are_named_in_their_records_alone():
    """The generator of the blind check shares nothing with them and has names of its own."""
    apart = ("gapscope.effects", "gapscope.blind_check.generator")
    naming = {m for m in FILES if not m.startswith(apart) and effects_named(m)}
    assert naming == NAMES_EFFECTS.keys()


def test_names_of_test_modules_are_unique():
    """Pytest imports them by their bare name: of two, one is not collected."""
    paths = [
        path
        for path in (ROOT / "tests").rglob("*.py")
        if path.stem not in ("conftest", "__init__")
    ]
    names = Counter(path.stem for path in paths)
    assert [name for name, count in names.items() if count > 1] == []
