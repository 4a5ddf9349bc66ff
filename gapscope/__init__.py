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
    from gapscope.interface.advise import advise
    from gapscope.interface.agree import agree
    from gapscope.interface.audit import audit
    from gapscope.interface.check import check
    from gapscope.interface.diagnose import diagnose
    from gapscope.interface.excite import excite
    from gapscope.interface.export import export
    from gapscope.interface.gap import gap
    from gapscope.interface.identify import identify
    from gapscope.interface.inspect import inspect
    from gapscope.interface.models import make_arm, read_corrected
    from gapscope.interface.predict import predict
    from gapscope.interface.replay import replay
    from gapscope.many.fleet import fleet

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
    "predict",
    "read_corrected",
    "replay",
]

_MODULES = {
    "Case": "arm.case",
    "load_case": "arm.case",
    "load_effects": "effects.catalogue",
    "make_arm": "interface.models",
    "read_corrected": "interface.models",
    **{
        name: f"interface.{name}"
        for name in (
            "advise",
            "agree",
            "audit",
            "check",
            "diagnose",
            "excite",
            "export",
            "gap",
            "identify",
            "inspect",
            "predict",
            "replay",
        )
    },
    "fleet": "many.fleet",
}
"""Where each name lies; it is imported when it is first asked for."""

register_environment()


def __getattr__(name: str) -> Any:
    if name == "__version__":  # a look into the installed packages, which takes time
        return import_module("importlib.metadata").version("gapscope")
    if name not in _MODULES:
        raise AttributeError(f"module 'gapscope' has no attribute {name!r}")
    return getattr(import_module(f"gapscope.{_MODULES[name]}"), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
