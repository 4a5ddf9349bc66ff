"""A case: a folder with a nominal arm and its recordings."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from arm.controller import Controller
from arm.nominal import NominalArm
from arm.recording import Recording


@dataclass(frozen=True)
class Case:
    """A nominal arm and its recordings.

    Attributes:
        name: name of the case.
        folder: folder of ``case.yaml``.
        arm: the nominal arm.
        recordings: what may be fitted.
        judged: what may only be judged on; empty where the case does not set any aside.
        controller: the controller, where known.
        warnings: what was noticed about the whole case while reading.
    """

    name: str
    folder: Path
    arm: NominalArm
    recordings: tuple[Recording, ...]
    judged: tuple[Recording, ...] = ()
    controller: Controller | None = None
    warnings: tuple[str, ...] = ()
