"""Which packages are installed, and which commands need those that are not."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import metadata

NEEDED_FOR = {
    "blind": "a faster gapscope blind make",
    "cluster": "gapscope fleet and diagnose --backend ray",
    "dart": "--engine dart",
    "hdf5": "logs in HDF5 and MATLAB 7.3 files",
    "learn": "gapscope train, gapscope residual, agents in gapscope evaluate",
    "pybullet": "--engine pybullet, the robot xarm6",
    "robots": "robots by the names of robot_descriptions",
    "tune": "gapscope train --tune",
}
"""What each extra is for; ``dev`` is for developers and left out."""
_NAME = re.compile(r"^[A-Za-z0-9._-]+")
_EXTRA = re.compile(r"extra\s*==\s*['\"]([^'\"]+)['\"]")


@dataclass(frozen=True)
class Package:
    """A package that the project names.

    Attributes:
        name: of its distribution.
        version: that is installed, or ``None``.
        extra: that brings it; empty if the core needs it.
        needed_for: what does not work without it.
    """

    name: str
    version: str | None
    extra: str
    needed_for: str

    @property
    def remedy(self) -> str:
        """How to install it."""
        what = f"gapscope[{self.extra}]" if self.extra else self.name
        return f"pip install '{what}'"


def packages() -> list[Package]:
    """Packages of the core, then of the extras, as the installed project names them."""
    return [*_of_core(), *_of_extras()]


def _of_core() -> Iterator[Package]:
    for requirement in metadata.requires("gapscope") or ():
        # a marker limits a requirement to some machines; PyBullet is asked for as an extra
        if ";" not in requirement:
            name = _name(requirement)
            yield Package(name, _version(name), "", "every command")


def _of_extras() -> Iterator[Package]:
    for requirement in metadata.requires("gapscope") or ():
        extra = _EXTRA.search(requirement)
        if extra and extra[1] in NEEDED_FOR:
            name = _name(requirement)
            yield Package(name, _version(name), extra[1], NEEDED_FOR[extra[1]])


def _name(requirement: str) -> str:
    match = _NAME.match(requirement)
    assert match is not None, requirement
    return match[0]


def _version(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None
