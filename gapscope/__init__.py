"""Gapscope finds out why a simulated robot arm and a real one disagree.

The functions below are the Python interface; each takes a case, a folder or arrays, and returns a record with
``save(folder)``, ``summary()`` and ``to_frame()``. They are imported when they are first used.

>>> import gapscope
>>> case = gapscope.load_case("my_arm")  # doctest: +SKIP
>>> gapscope.diagnose(case).save("out")  # doctest: +SKIP
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from gapscope.envs.registration import register_environment

if TYPE_CHECKING:
    from gapscope.arm.case import Case, load_case
    from gapscope.effects.catalogue import load_effects
    from gapscope.interface.advise import advise, excite
    from gapscope.interface.diagnose import diagnose
    from gapscope.interface.identify import identify
    from gapscope.interface.logs import agree, audit, check, inspect
    from gapscope.interface.models import (
        export,
        gap,
        make_arm,
        predict,
        read_corrected,
        replay,
    )
    from gapscope.many.fleet import fleet
    from gapscope.many.matter import matter
    from gapscope.many.rehearse import rehearse

    __version__: str

__all__ = [
    "Case",
    "advise",
    "agree",
    "audit",
    "check",
    "diagnose",
    "excite",
    "export",
    "fleet",
    "gap",
    "identify",
    "inspect",
    "load_case",
    "load_effects",
    "make_arm",
    "matter",
    "predict",
    "read_corrected",
    "rehearse",
    "replay",
]

_MODULES = {
    "Case": "arm.case",
    "load_case": "arm.case",
    "load_effects": "effects.catalogue",
    "make_arm": "interface.models",
    "read_corrected": "interface.models",
    "fleet": "many.fleet",
    "matter": "many.matter",
    "rehearse": "many.rehearse",
    **dict.fromkeys(("agree", "audit", "check", "inspect"), "interface.logs"),
    **dict.fromkeys(("export", "gap", "predict", "replay"), "interface.models"),
    **dict.fromkeys(("advise", "excite"), "interface.advise"),
    "diagnose": "interface.diagnose",
    "identify": "interface.identify",
}
"""Where each name lies; it is imported when it is first asked for."""

# gymnasium knows the environment's name once gapscope is imported
register_environment()


def __getattr__(name: str) -> Any:
    if name == "__version__":  # a look into the installed packages, which takes time
        return import_module("importlib.metadata").version("gapscope")
    if name not in _MODULES:
        raise AttributeError(f"module 'gapscope' has no attribute {name!r}")
    return getattr(import_module(f"gapscope.{_MODULES[name]}"), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
