"""The file ``corrected.yaml``: effects with their values, what adds to their torque, and the arm that they correct."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Iterator, Sequence
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
from gapscope.arm.io.json_file import field, plain, schema_fault
from gapscope.arm.nominal import NominalArm
from gapscope.effects.applied import AppliedEffect, Entry, Place, State, states_of
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.residual import read_residual
from gapscope.effects.setup_faults import FAULTS, Fault

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
    content = {
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
    # zeros say what a file without them says
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
    values = {name: applied.parameters[name].tolist() for name in applied.given}
    return {
        "effect": applied.name,
        "joints": list(applied.joints),
        "parameters": values,
    }


def _with_states(states: Sequence[State]) -> list[dict[str, Any]]:
    """Entries of all states, what all of them have without a place, first."""
    each = [(state.place, list(map(described, state.effects))) for state in states]
    every = [entry for _, entries in each for entry in entries]
    # what every state has needs no place, and stands once
    common = [
        entry
        for k, entry in enumerate(every)
        if entry not in every[:k] and all(entry in entries for _, entries in each)
    ]
    placed: list[dict[str, Any]] = []
    for place, entries in each:
        times = {"from": place.start, "to": place.end}
        # an open end is not written
        times = {name: t for name, t in times.items() if np.isfinite(t)}
        for entry in entries:
            if entry in common:
                continue
            mine = {**entry, "recordings": list(place.recordings), **times}
            # the same but for the recordings: one entry for all of them
            same = [x for x in placed if {**mine, "recordings": x["recordings"]} == x]
            if same:
                same[0]["recordings"] += place.recordings
            else:
                placed.append(mine)
    return common + placed


NO_REMAINDER = (
    "the remainder of the bodies is left out: links with it need not be possible, so that it adds to predicted torque "
    "alone"
)
"""What is said if an arm is to be simulated."""


def read_corrected(path: Path | str) -> tuple[AppliedEffect, ...]:
    """Effects from a file of the form of ``corrected.yaml``, for a simulator: a residual network is left out.

    Raises:
        InputError: the file is missing, not YAML, or an entry is not an effect of the catalogue; names the entry.
    """
    content, entries, _ = _parsed(Path(path))
    # an environment takes effects alone: it must not seem to have the rest
    if content.get("residual"):
        warnings.warn(
            f"{path}: the residual network is left out, it is no effect; to simulate it too, give the environment "
            "simulated=gapscope.effects.corrected_file.read_corrected_arm(arm, path) in place of effects",
            ModelWarning,
            stacklevel=2,
        )
    if content.get("remainder"):
        warnings.warn(
            f"{path}: {NO_REMAINDER}",
            ModelWarning,
            stacklevel=2,
        )
    return _last(entries, content)


def read_with_faults(
    path: Path | str,
) -> tuple[tuple[AppliedEffect, ...], tuple[Fault, ...]]:
    """Effects and setup faults from a file of the form of ``corrected.yaml``, for recording a simulated arm.

    Raises:
        InputError: as ``read_corrected``; or an entry is not a fault as ``gapscope.effects.setup_faults`` has it.
    """
    content, entries, faults = _parsed(Path(path), with_faults=True)
    return _last(entries, content), tuple(faults)


def read_corrected_arm(arm: NominalArm, path: Path | str) -> CorrectedArm:
    """The corrected arm from a nominal one and a file of the form of ``corrected.yaml``, residual network included.

    Raises:
        InputError: as ``read_corrected``; or the network cannot be read, or is of another arm; a joint does not exist.
    """
    path = Path(path)
    content, entries, _ = _parsed(path)
    if "corrects" in content:
        _check_arm(arm, path, path.parent / content["corrects"])
    effects, states = _last(entries, content), _states(entries, content)
    # part of the arm, not an effect: dry friction builds up over it
    if content.get("presliding") is not None:
        try:
            arm = replace(arm, presliding=content["presliding"])
        except InputError as error:
            raise InputError(error.problem, file=path, where="presliding") from None
    residual = remainder = None
    if content.get("residual") is not None:
        file = file_beside(path.parent, content["residual"], path, "residual")
        residual = read_residual(file)
    if content.get("remainder") is not None:
        remainder = np.array(content["remainder"], dtype=float, ndmin=2)
    corrected = CorrectedArm(arm, effects, residual, remainder, states)
    with error_context(path, effects):
        corrected.check()
    return corrected


def _check_arm(arm: NominalArm, path: Path, case: Path) -> None:
    """Warn if an arm is not the one from which the effects of a file count, that of the case beside it."""
    if not case.is_file():
        return
    robot = case.parent / str(read_yaml(case, "check the path").get("robot"))
    if robot.is_file() and robot.read_bytes() != arm.urdf.read_bytes():
        warnings.warn(
            f"{path}: its effects count from the arm of {case.name} beside it, not from {arm.urdf}: give that case",
            ModelWarning,
            stacklevel=3,
        )


def _parsed(
    path: Path, with_faults: bool = False
) -> tuple[dict[str, Any], list[Entry], list[Fault]]:
    """Content of the file, its effects with where they hold, and the faults among them if there may be any."""
    content = read_yaml(path, "check the path")
    _check(content, "file", path)
    entries, faults = [], []
    for i, entry in enumerate(content["effects"]):
        where = f"effects[{i}]"
        named = str(entry.get("effect")) if isinstance(entry, dict) else ""
        # only a file for recording may hold faults: an arm has none
        if with_faults and named in FAULTS:
            _check(entry, "entry", path, where)
            faults.append(_fault(entry, where, path))
            continue
        effect = read_entry(entry, where, path)
        place = None
        # one of the three is enough to say that it holds somewhere
        if not _PLACE.isdisjoint(entry):
            limits = (entry.get("from"), -np.inf), (entry.get("to"), np.inf)
            times = [none if t is None else float(t) for t, none in limits]
            place = Place(tuple(entry["recordings"]), *times)
            # so written that nan fails as well
            if not place.start < place.end:
                raise InputError(
                    f"holds from {place.start:g} to {place.end:g} s, which is no time",
                    "give from before to",
                    file=path,
                    where=where,
                )
        entries.append((effect, place))
    return content, entries, faults


def _check(content: Any, section: str, file: Path | None, where: str = "") -> None:
    """Check a file or an entry of it by its schema; raises ``InputError`` with what is expected."""
    # times may be infinite, which a schema does not know
    content = plain(content, null_if_not_finite=True)
    fault = schema_fault(content, "corrected", section)
    if fault is None:
        return
    problem = f"expected {fault.schema['description']}"
    remedy = "see corrected.yaml of a diagnosis"
    if fault.validator == "additionalProperties":
        known = fault.schema["properties"]
        unknown = sorted(str(name) for name in content if name not in known)
        problem = f"unknown key {unknown[0]!r}"
        remedy = f"known are {', '.join(sorted(known))}"
    places = (where, field(fault.absolute_path))
    raise InputError(problem, remedy, file=file, where=".".join(filter(None, places)))


def _states(entries: Sequence[Entry], content: dict[str, Any]) -> tuple[State, ...]:
    """The states that the entries of a file make; none if no entry says where it holds."""
    return states_of(entries, content.get("recordings") or ())


def _last(
    entries: Sequence[Entry], content: dict[str, Any]
) -> tuple[AppliedEffect, ...]:
    """The effects of a file, those of the last state if it has several."""
    states = _states(entries, content)
    return states[-1].effects if states else tuple(effect for effect, _ in entries)


def described_fault(fault: Fault) -> dict[str, Any]:
    """A setup fault as an entry of the file; what is not given there is as by default."""
    values = {field.name: getattr(fault, field.name) for field in fields(fault)}
    joints, variant = values.pop("joints", ()), values.pop("variant", None)
    return {
        "effect": fault.name,
        "joints": list(joints),
        # a fault of one kind has none
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
    # left out is the same as empty: the fault's own default
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
        # what is wrong with the whole file has no place among its effects
        whole = error.where in ("residual", "remainder")
        if path is not None and error.file is None and whole:
            raise error.at(Path(path)) from None
        # an error names an effect, its parameter, or several with commas
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
    _check(entry, "entry", path, where)
    # a diagnosis names faults too: they must not be read as effects of the arm
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
