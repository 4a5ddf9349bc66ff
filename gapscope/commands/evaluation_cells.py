"""Finished cells of an evaluation, kept beside its results until it is whole."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, replace
from functools import cache
from pathlib import Path
from typing import Any

from gapscope.agents.evaluation import TrackingBench
from gapscope.agents.models import AgentModel, ArmModel, Candidate
from gapscope.arm.errors import GapscopeError
from gapscope.arm.io.atomic_write import atomic_write
from gapscope.arm.io.json_file import to_json
from gapscope.provenance import KEY, PACKAGE, fingerprint, program

FOLDER = "unfinished"
"""Folder in that of the results, which is there as long as an evaluation is not whole."""


class Cells:
    """Cells as files, each with the hash of what it was made from: program, arm, hidden effects, plan and model.

    Args:
        out: folder of the results.
        bench: the arm and the plan.
        again: forget what an earlier run has kept.

    Attributes:
        reused: how many cells were taken from an earlier run.

    Raises:
        GapscopeError: a kept cell cannot be removed.
    """

    def __init__(self, out: Path, bench: TrackingBench, again: bool = False) -> None:
        self._folder = out / FOLDER
        self.reused = 0
        # seeds and engines are in the keys: with more of them what is kept still counts
        plan = replace(bench.plan, seeds=(0,), engines=bench.plan.engines[:1])
        self._common = [
            _source(),
            fingerprint(bench.arm),
            fingerprint(bench.effects),
            fingerprint(asdict(plan)),
        ]
        if again:
            self.clear()

    def clear(self) -> None:
        """Remove what is kept, once the results are whole."""
        try:
            for file in self._folder.glob("*.json"):
                file.unlink()
            if self._folder.is_dir():
                self._folder.rmdir()
        except OSError as error:
            raise GapscopeError(
                f"{self._folder}: cannot be removed ({error.strerror})", "remove it"
            ) from None

    def __call__(
        self,
        key: tuple[str, ...],
        model: Candidate,
        compute: Callable[[], Any],
    ) -> Any:
        """What a cell holds. Numbers that are infinite are written as Python reads them."""
        # PD alone and gravity have nothing but their kind
        parts = [*self._common, *key, type(model).__name__]
        if isinstance(model, ArmModel):
            parts.append(_of(model))
        elif isinstance(model, AgentModel):
            parts.append(model.digest)
        digest = fingerprint(parts)
        file = self._folder / f"{digest}.json"
        try:
            kept = json.loads(file.read_text(encoding="utf-8"))
            if isinstance(kept, dict) and kept.get(KEY) == digest:
                value = kept["value"]
                self.reused += 1
                return value
        except (OSError, ValueError, KeyError):
            pass  # not kept, or cut short: made again
        value = compute()
        # an arm that diverged has infinite errors, which are kept like others
        text = to_json({KEY: digest, "cell": key, "value": value}, allow_nan=True)
        with atomic_write(file) as aside:
            aside.write_text(text, encoding="utf-8")
        return value


@cache
def _of(model: ArmModel) -> str:
    return fingerprint(model.corrected)


@cache
def _source() -> str:
    """The program, its agents included, and the libraries."""
    folder = PACKAGE / "agents"
    # agents lead to no diagnosis, so that the program's hash leaves them out
    own = {
        path.relative_to(folder).as_posix(): path
        for path in sorted(folder.rglob("*.py"))
    }
    return fingerprint([program(), own])
