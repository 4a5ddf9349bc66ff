"""Imports inside the package: one way, no cycles, libraries only where they belong; effects named in records alone."""

from __future__ import annotations

import ast
from collections import Counter
from functools import cache
from importlib import import_module
from pathlib import Path

import pytest

from gapscope.effects.catalogue import SHIPPED
from gapscope.effects.effect import Effect

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

NAMES_EFFECTS = {
    # armature is the data sheet's or a model file's own key
    *("arm.nominal", "arm.robots", "envs.mystery_arm", "model_audit.checks"),
    "diagnosis.diagnose_change",
    # payload is the case's key of a known load
    "diagnosis.document.content",
    # the blind check keeps what hides what, and plain methods, apart
    *("blind_check.baselines", "blind_check.check", "blind_check.scoring"),
}
"""Modules outside ``effects/`` that name an effect all the same. No new ones: ask the records."""

FILES = {
    ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): path
    for path in sorted(PACKAGE.rglob("*.py"))
}  # fmt: skip
"""Path of each module, by its dotted name."""


def imports_in(nodes: list[ast.AST]) -> set[str]:
    """Dotted names that a module imports, lazy ones and those for type checking included."""
    names = set()
    for node in nodes:
        if isinstance(node, ast.Import):
            names.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            whole = {f"{node.module}.{alias.name}" for alias in node.names}
            names |= whole & FILES.keys()
            if whole - FILES.keys():
                names.add(node.module)
    return names


def effects_in(nodes: list[ast.AST]) -> set[str]:
    """Effects that a module names: as a string, docstrings aside, or by importing their record."""
    documented = {id(node.value) for node in nodes if isinstance(node, ast.Expr)}
    named = set()
    for node in nodes:
        if isinstance(node, ast.Constant) and id(node) not in documented:
            named |= {node.value} & SHIPPED
        elif isinstance(node, ast.ImportFrom) and below(
            node.module or "", "gapscope.effects"
        ):
            source = import_module(node.module)
            records = (getattr(source, alias.name, None) for alias in node.names)
            named |= {x.name for x in records if isinstance(x, Effect)}
    return named


@cache
def named_in(module: str) -> tuple[set[str], set[str]]:
    """What a module imports, and the effects that it names."""
    text = FILES[module].read_text(encoding="utf-8")
    nodes = list(ast.walk(ast.parse(text)))
    return imports_in(nodes) - {module}, effects_in(nodes)


def imports_of(module: str) -> set[str]:
    return named_in(module)[0]


def below(module: str, folder: str) -> str:
    """First part of a module's name below a folder, if it lies in there."""
    before, _, rest = module.partition(f"{folder}.")
    return "" if before else rest.split(".")[0]


def check_layers(module: str, folder: str, layers: tuple[set[str], ...]) -> None:
    """Assert that what a module imports below a folder lies in its own layer or a lower one."""
    number = {name: place for place, layer in enumerate(layers) for name in layer}
    own = below(module, folder)
    for imported in imports_of(module) if own else ():
        other = below(imported, folder)
        assert not other or number[other] <= number[own], imported


@pytest.mark.parametrize("module", FILES)
def test_imports_go_one_way_and_libraries_are_where_they_belong(module):
    check_layers(module, "gapscope", LAYERS)
    check_layers(module, "gapscope.diagnosis", DIAGNOSIS_LAYERS)
    own, imported = below(module, "gapscope"), imports_of(module)
    for pair in APART:
        if own in pair:
            others = {below(name, "gapscope") for name in imported}
            assert not others & (pair - {own})
    place = FILES[module].relative_to(PACKAGE).as_posix()
    libraries = {name.split(".")[0] for name in imported}
    for library, places in ONLY_IN.items():
        assert library not in libraries or place.startswith(places)


def test_the_generator_of_the_blind_check_imports_nothing_of_what_is_checked():
    own = "gapscope.blind_check.generator"
    modules = [module for module in FILES if module.startswith(own)]
    assert len(modules) > 6
    imported = set().union(*map(imports_of, modules))
    ours = {name for name in imported if name.startswith("gapscope")}
    assert all(name.startswith((own, "gapscope.arm.")) for name in ours)


def test_no_module_imports_itself_by_way_of_others():
    waiting = {m: {n for n in imports_of(m) if n in FILES} for m in FILES}
    while waiting:
        free = {m for m, needed in waiting.items() if not needed & waiting.keys()}
        assert free, f"cycle among {sorted(waiting)}"
        waiting = {m: needed for m, needed in waiting.items() if m not in free}


def test_effects_are_named_in_their_records_alone():
    """The generator of the blind check shares nothing with them and has names of its own."""
    apart = ("gapscope.effects", "gapscope.blind_check.generator")
    naming = {m for m in FILES if not m.startswith(apart) and named_in(m)[1]}
    assert naming == {f"gapscope.{module}" for module in NAMES_EFFECTS}


def test_names_of_test_modules_are_unique():
    """Pytest imports them by their bare name: of two, one is not collected."""
    paths = (ROOT / "tests").rglob("*.py")
    names = Counter(path.stem for path in paths)
    del names["conftest"], names["__init__"]
    assert [name for name, count in names.items() if count > 1] == []
