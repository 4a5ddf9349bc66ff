"""The environment's name in Gymnasium.

Gymnasium reads no entry points since its version 1.0. So the environment is registered at the moment at which somebody
imports Gymnasium: ``import gapscope`` waits neither for it nor for NumPy.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from importlib.util import spec_from_file_location
from types import ModuleType

NAME = "gapscope/ArmTracking-v0"
REGISTRY = "gymnasium.envs.registration"
"""The module of Gymnasium that keeps the names."""


def register_environment() -> None:
    """Make ``NAME`` known to Gymnasium: now if it is imported already, else once it is; nothing else is imported."""
    if REGISTRY in sys.modules:
        _register(sys.modules[REGISTRY])
    else:
        sys.meta_path.insert(0, _RegistryFinder())


def _register(registration: ModuleType) -> None:
    if NAME not in registration.registry:
        registration.register(
            id=NAME,
            entry_point="gapscope.envs.environment:ArmTracking",
            vector_entry_point="gapscope.envs.environment:VectorArmTracking",
        )


class _RegistryLoader(SourceFileLoader):
    """Loads Gymnasium's registry as Python does, then adds the environment."""

    def exec_module(self, module: ModuleType) -> None:
        super().exec_module(module)
        _register(module)


class _RegistryFinder:
    """Gives Gymnasium's registry the loader above; every other module is left to the other finders."""

    def find_spec(
        self,
        fullname: str,
        path: Sequence[str] | None,
        target: ModuleType | None = None,
    ) -> ModuleSpec | None:
        if fullname != REGISTRY:
            return None
        found = PathFinder.find_spec(fullname, path, target)
        if found is None or found.origin is None:
            return None
        loader = _RegistryLoader(fullname, found.origin)
        return spec_from_file_location(fullname, found.origin, loader=loader)
