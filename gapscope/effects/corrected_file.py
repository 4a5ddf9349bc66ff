"""The file ``corrected.yaml``: effects with their values, what adds to their torque, and the arm that they correct."""

from __future__ import annotations

import warnings
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from gapscope.arm.errors import InputError, ModelWarning
from gapscope.arm.input_file import file_beside
from gapscope.arm.io.atomic_write import atomic_write
from gapscope.arm.io.case_file import read_yaml
from gapscope.arm.nominal import NominalArm
from gapscope.effects.applied import AppliedEffect, Entry, Place, State, states_of
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.residual import ResidualNetwork, read_residual
from gapscope.effects.setup_faults import FAULTS, Fault

_KEYS = {
    "schema",
    "case",
    "effects",
    "residual",
    "presliding",
    "corrects",
    "remainder",
    "recordings",
}
_PLACE = {"recordings", "from", "to"}


def write_corrected(
    case: str,
    effects: tuple[AppliedEffect, ...],
    path: Path,
    residual: str | None = None,
    faults: tuple[Fault, ...] = (),
    presliding: Iterable[float] = (),
    corrects: str | None = None,
    remainder: np.ndarray | None = None,
    states: Sequence[State] = (),
) -> None:
    """Write effects as ``corrected.yaml``; ``path`` never holds half of one.

    Args:
        case: name of the case.
        effects: the effects.
        path: the file.
        residual: file of a residual network, relative to the folder of ``path``; it is not written here.
        faults: setup faults, if the file describes how a case was recorded.
        presliding: distance over which the dry friction of each joint builds up after a reversal [rad]; nothing or
            zeros if it follows the velocity at once.
        corrects: file of the case whose nominal arm is corrected, relative to the folder of ``path``; ``None`` if it is
            that of the case.
        remainder: inertial parameters that the links lack to predict best, (n, 10).
        states: what the arm has in some recordings, or spans of them, in place of ``effects``; the last one last.

    Raises:
        GapscopeError: the file cannot be written.
    """
    content: dict[str, Any] = {
        "schema": 1,
        "case": case,
        "effects": [
            *(_with_states(states) if states else map(described, effects)),
            *map(described_fault, faults),
        ],
    }
    if states:
        # in their order: a recording that is not among them has the state of the last
        names = (name for state in states for name in state.place.recordings)
        content["recordings"] = list(dict.fromkeys(names))
    distances = [float(distance) for distance in presliding]
    if any(distances):
        content["presliding"] = distances
    if residual is not None:
        content["residual"] = residual
    if corrects is not None:
        content["corrects"] = corrects
    if remainder is not None:
        content["remainder"] = remainder.tolist()
    with atomic_write(path) as aside:
        aside.write_text(
            yaml.safe_dump(content, sort_keys=False, default_flow_style=None),
            encoding="utf-8",
        )


def described(applied: AppliedEffect) -> dict[str, Any]:
    """An effect as an entry of the file."""
    values = {name: value.tolist() for name, value in applied.parameters.items()}
    return {
        "effect": applied.name,
        "joints": list(applied.joints),
        "parameters": values,
    }


def _with_states(states: Sequence[State]) -> list[dict[str, Any]]:
    """Entries of all states, what all of them have without a place, first."""
    each = [(state.place, list(map(described, state.effects))) for state in states]
    every = [entry for _, entries in each for entry in entries]
    common = [
        entry
        for k, entry in enumerate(every)
        if entry not in every[:k] and all(entry in entries for _, entries in each)
    ]
    placed: list[dict[str, Any]] = []
    for place, entries in each:
        times = {"from": place.start, "to": place.end}
        times = {name: t for name, t in times.items() if np.isfinite(t)}
        for entry in entries:
            if entry in common:
                continue
            mine = {**entry, "recordings": list(place.recordings), **times}
            same = [x for x in placed if {**mine, "recordings": x["recordings"]} == x]
            if same:
                same[0]["recordings"] += place.recordings
            else:
                placed.append(mine)
    return common + placed


def read_corrected(path: Path | str) -> tuple[AppliedEffect, ...]:
    """Effects from a file of the form of ``corrected.yaml``, for a simulator: a residual network is left out.

    Raises:
        InputError: the file is missing, not YAML, or an entry is not an effect of the catalogue; names the entry.
    """
    content, path = _content(Path(path)), Path(path)
    if content.get("residual"):
        warnings.warn(
            f"{path}: the residual network is left out, it is no effect; to simulate it too, give the environment "
            "simulated=gapscope.effects.corrected_file.read_corrected_arm(arm, path) in place of effects",
            ModelWarning,
            stacklevel=2,
        )
    if content.get("remainder"):
        warnings.warn(
            f"{path}: the remainder of the bodies is left out: links with it need not be possible, so that it adds to "
            "predicted torque alone",
            ModelWarning,
            stacklevel=2,
        )
    return _effects(content, path)


def read_with_faults(
    path: Path | str,
) -> tuple[tuple[AppliedEffect, ...], tuple[Fault, ...]]:
    """Effects and setup faults from a file of the form of ``corrected.yaml``, for recording a simulated arm.

    Raises:
        InputError: as ``read_corrected``; or an entry is not a fault as ``gapscope.effects.setup_faults`` has it.
    """
    content, path = _content(Path(path)), Path(path)
    entries = content["effects"]
    faults = {
        i: x
        for i, x in enumerate(entries)
        if isinstance(x, dict) and str(x.get("effect")) in FAULTS
    }
    effects = _effects(content, path, leave_out=faults)
    return effects, tuple(_fault(x, f"effects[{i}]", path) for i, x in faults.items())


def described_fault(fault: Fault) -> dict[str, Any]:
    """A setup fault as an entry of the file; what is not given there is as by default."""
    values = {field.name: getattr(fault, field.name) for field in fields(fault)}
    joints, variant = values.pop("joints", ()), values.pop("variant", None)
    return {
        "effect": fault.name,
        "joints": list(joints),
        **({"variant": variant} if variant else {}),
        "parameters": {
            name: list(value) if isinstance(value, tuple) else value
            for name, value in values.items()
        },
    }


def _fault(entry: dict[str, Any], where: str, path: Path) -> Fault:
    """A setup fault from its entry."""
    kind = FAULTS[entry["effect"]]
    known = {field.name for field in fields(kind)}
    given = {
        "joints": tuple(entry.get("joints") or ()),
        "variant": entry.get("variant"),
        **entry.get("parameters", {}),
    }
    given = {name: value for name, value in given.items() if value not in ((), None)}
    if unknown := sorted(
        set(given) - known | set(entry) - {"effect", "joints", "variant", "parameters"}
    ):
        raise InputError(
            f"{kind.name} has no {unknown[0]!r}",
            f"it has {', '.join(sorted(known))}",
            file=path,
            where=where,
        )
    try:
        fault = kind(**given)
        fault.check()
    except InputError as error:
        raise error.at(path, where) from None
    except (TypeError, ValueError) as error:
        raise InputError(
            f"{kind.name} is not complete, or not of numbers ({error})",
            f"give {', '.join(sorted(known))}; variants are {', '.join(kind.variants) or 'none'}",
            file=path,
            where=where,
        ) from None
    return fault


def read_corrected_arm(arm: NominalArm, path: Path | str) -> CorrectedArm:
    """The corrected arm from a nominal one and a file of the form of ``corrected.yaml``, residual network included.

    Raises:
        InputError: as ``read_corrected``; or the network cannot be read, or is of another arm; a joint does not exist.
    """
    content, path = _content(Path(path)), Path(path)
    effects = _effects(content, path)
    states = _states(_entries(content, path), content, path)
    arm = _with_presliding(arm, content, path)
    residual, remainder = _residual(content, path), _remainder(content, path)
    corrected = CorrectedArm(arm, effects, residual, remainder, states)
    with error_context(path, effects):
        corrected.check()
    return corrected


def _with_presliding(
    arm: NominalArm, content: dict[str, Any], path: Path
) -> NominalArm:
    """The arm with the presliding of its dry friction that a file gives, if any."""
    distances = content.get("presliding")
    if distances is None:
        return arm
    try:
        bent = replace(arm, presliding=distances)
    except InputError as error:
        raise InputError(error.problem, file=path, where="presliding") from None
    if (bent.presliding < 0).any():
        raise InputError("a distance is below zero", file=path, where="presliding")
    return bent


def _residual(content: dict[str, Any], path: Path) -> ResidualNetwork | None:
    """The residual network that a file names, if any."""
    name = content.get("residual")
    if name is None:
        return None
    return read_residual(file_beside(path.parent, name, path, "residual"))


def _remainder(content: dict[str, Any], path: Path) -> np.ndarray | None:
    """What the links lack to predict best, (n, 10), if a file says so."""
    given = content.get("remainder")
    if given is None:
        return None
    try:
        value = np.array(given, dtype=float)
    except (TypeError, ValueError):
        value = np.array(np.nan)
    if value.ndim != 2 or not np.isfinite(value).all():
        raise InputError(
            "expected ten numbers for each link",
            "see corrected.yaml of a comparison with a reference",
            file=path,
            where="remainder",
        )
    return value


def _content(path: Path) -> dict[str, Any]:
    """Content of the file, its keys checked."""
    content = read_yaml(path, "check the path")
    if (
        not isinstance(content, dict)
        or content.get("schema") != 1
        or not isinstance(content.get("effects"), list)
    ):
        raise InputError(
            "expected the keys schema: 1 and effects: [...]",
            "see corrected.yaml of a diagnosis",
            file=path,
        )
    if unknown := set(content) - _KEYS:
        raise InputError(
            f"unknown key {sorted(unknown)[0]!r}",
            f"known are {', '.join(sorted(_KEYS))}",
            file=path,
        )
    return content


def _effects(
    content: dict[str, Any], path: Path, leave_out: Collection[int] = ()
) -> tuple[AppliedEffect, ...]:
    """The effects of a file but for some entries, those of the last state if it has several."""
    entries = _entries(content, path, leave_out)
    states = _states(entries, content, path)
    return states[-1].effects if states else tuple(effect for effect, _ in entries)


def _states(
    entries: Sequence[Entry], content: dict[str, Any], path: Path
) -> tuple[State, ...]:
    """The states that the entries of a file make; none if no entry says where it holds."""
    listed = content.get("recordings") or []
    if not _are_names(listed):
        raise InputError(
            "expected names of recordings",
            "list them in the order in which they were made, recordings: [a.csv, b.csv]",
            file=path,
            where="recordings",
        )
    return states_of(entries, listed)


def _entries(
    content: dict[str, Any], path: Path, leave_out: Collection[int] = ()
) -> list[Entry]:
    """The effects of a file, each with where it holds, but for some entries."""
    out = []
    for i, entry in enumerate(content["effects"]):
        if i in leave_out:
            continue
        effect = read_entry(entry, f"effects[{i}]", path)
        out.append((effect, _place(entry, f"effects[{i}]", path)))
    return out


def _place(entry: Any, where: str, path: Path) -> Place | None:
    """Where an entry says that its effect holds; ``None`` for everywhere."""
    given = {key: entry[key] for key in _PLACE & set(entry)}
    if not given:
        return None
    names, times = given.get("recordings"), [given.get("from"), given.get("to")]
    numbers = all(t is None or isinstance(t, int | float) for t in times)
    if not (names and _are_names(names) and numbers):
        raise InputError(
            "recordings, from and to say where an effect holds: names of recordings, and times in s",
            "write for instance recordings: [b.csv], from: 3.5",
            file=path,
            where=where,
        )
    ends = zip(("start", "end"), times, strict=True)
    limits = {name: float(t) for name, t in ends if t is not None}
    place = Place(tuple(names), **limits)
    if place.start >= place.end:
        raise InputError(
            f"holds from {place.start:g} to {place.end:g} s, which is no time",
            "give from before to",
            file=path,
            where=where,
        )
    return place


def _are_names(value: Any) -> bool:
    return isinstance(value, list) and all(isinstance(x, str) for x in value)


@contextmanager
def error_context(
    path: Path | str | None, effects: Sequence[AppliedEffect]
) -> Iterator[None]:
    """Errors about one of the effects name the file that it comes from, and its place there.

    Args:
        path: the file, or ``None`` if there is none.
        effects: its effects, in their order.
    """
    try:
        yield
    except InputError as error:
        whole = error.where in ("residual", "remainder")
        if path is not None and error.file is None and whole:
            raise error.at(Path(path)) from None
        name = error.where.split(".")[0].split(",")[0]
        place = next(
            (i for i, applied in enumerate(effects) if applied.name == name), None
        )
        if path is None or error.file is not None or place is None:
            raise
        raise error.at(Path(path), f"effects[{place}]") from None


def read_entry(entry: Any, where: str, path: Path | None = None) -> AppliedEffect:
    """An effect from an entry of ``effects:``, a mapping with ``effect``, ``joints`` and ``parameters``.

    Args:
        entry: the entry.
        where: its place, for messages.
        path: the file that it comes from, or ``None``.

    Raises:
        InputError: it is not an effect of the catalogue.
    """
    if (
        not isinstance(entry, Mapping)
        or not isinstance(entry.get("parameters", {}), Mapping)
        or "effect" not in entry
    ):
        raise InputError(
            "expected effect:, joints: and parameters:",
            "write for instance {effect: coulomb_friction, joints: [2], parameters: {torque: [4.0]}}",
            file=path,
            where=where,
        )
    if str(entry["effect"]) in FAULTS:
        raise InputError(
            f"{entry['effect']!r} is a fault of the set-up: it lies in recordings, not in the arm",
            "leave it out here; gapscope record makes recordings with it",
            file=path,
            where=where,
        )
    try:
        return AppliedEffect(
            str(entry["effect"]),
            tuple(entry.get("joints") or ()),
            entry.get("parameters", {}),
        )
    except InputError as error:
        raise error.at(path, where) from None
    except (TypeError, ValueError) as error:
        raise InputError(
            f"holds a value that is not a number ({error})",
            "joints: takes a list of numbers",
            file=path,
            where=where,
        ) from None
