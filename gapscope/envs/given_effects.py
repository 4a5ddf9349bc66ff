"""Effects as a user gives them to the environment: records, entries, or a file."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from gapscope.arm.errors import InputError
from gapscope.arm.nominal import NominalArm
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.catalogue import CATALOGUE
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.corrected_file import error_context, read_corrected, read_entry
from gapscope.envs.arguments import READ, record_of

Effects = (
    AppliedEffect
    | Mapping[str, Any]
    | Sequence[AppliedEffect | Mapping[str, Any]]
    | Path
    | str
    | None
)
"""Effects as records, as entries or a file of the form of ``corrected.yaml``, or none."""
GIVE = "give AppliedEffect records or entries as in a corrected.yaml, or the path of such a file"
"""What to do if something is no effect."""


def chosen_effects(effects: Effects, arm: NominalArm) -> tuple[AppliedEffect, ...]:
    """The effects as records.

    Raises:
        InputError: the file is at fault, what was given is no effect, or an effect acts on a joint that the arm lacks.
    """
    file = effects if isinstance(effects, (str, Path)) else None
    found = _records(effects) if file is None else _read(file)
    with error_context(file, found):
        CorrectedArm(arm, found).check()
    return found


def _read(file: Path | str) -> tuple[AppliedEffect, ...]:
    """The effects in a file."""
    if str(file) in CATALOGUE and not Path(file).exists():
        raise InputError(
            f"{str(file)!r} is the name of an effect, without values",
            GIVE,
            where="effects",
        )
    return read_corrected(file)


def _records(effects: Any) -> tuple[AppliedEffect, ...]:
    """Effects that are records or entries, one or several."""
    if effects is None:
        return ()
    if isinstance(effects, Mapping) and "effects" in effects:
        if effects.get("residual"):
            raise InputError(
                "a residual network is no effect",
                f"give simulated=, and {READ}",
                where="effects",
            )
        return _records(effects["effects"])
    if isinstance(effects, (AppliedEffect, Mapping)):
        effects = (effects,)
    if not isinstance(effects, Iterable):
        raise InputError(f"{effects!r} is no effect with values", GIVE, where="effects")
    return tuple(_record(item, f"effects[{i}]") for i, item in enumerate(effects))


def _record(item: object, where: str) -> AppliedEffect:
    if isinstance(item, Mapping):
        return read_entry(item, where)
    return record_of(where, item, AppliedEffect, GIVE)
