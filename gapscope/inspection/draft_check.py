"""The drafted case, read: whether it can be, and what each of its torque columns shows of the set-up."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from gapscope.arm.case import Case, load_case
from gapscope.arm.errors import GapscopeError, InputError
from gapscope.arm.recording import Recording
from gapscope.diagnosis.set_up import Remark, SetUp, fault_remark, look_at_set_up
from gapscope.diagnosis.setup_faults.clocks import find_stamps
from gapscope.diagnosis.thresholds import NO_TORQUE
from gapscope.inspection.channels import AMPERES, ChannelGuess
from gapscope.inspection.draft import case_text
from gapscope.inspection.inspected_table import InspectedTable
from gapscope.inspection.inspection import TORQUES, Inspection, note, oddities_in


def check_draft(found: Inspection) -> list[Remark]:
    """Read the drafted case: why it cannot be read as it is, or what the reader noticed, and dropped."""
    place, problem, remedy = (
        "the drafted case",
        "no robot is known: the torque cannot be judged",
        "",
    )
    if found.arm is not None:
        try:
            recordings = _drafted(found).recordings
            return [note(r.name, said) for r in recordings for said in r.notes]
        except GapscopeError as error:
            problem, remedy = _said(error), error.remedy
    return [Remark("error", "case", place, problem, remedy)]


def judge_torques(found: Inspection) -> Inspection:
    """What is in logs, with what each torque column shows of the set-up if the drafted case reads it as the torque.

    Of several torques without names, the one that fits the arm best is chosen. Without an arm the stamps alone tell.
    """
    if found.arm is None:
        return replace(found, misread=tuple(_of_stamps(found)))
    looked: dict[tuple[str, str], SetUp] = {}
    torques = dict(found.torques)
    for label, table in found.sources.items():
        for guess in table.channels:
            set_up = _set_up(found, label, guess)
            if set_up is not None:
                place = label, guess.group.pattern
                looked[place] = set_up
                remarks = set_up.remarks()
                said = [remark.text for remark in remarks if remark.topic != "time"]
                torques[place] = [*torques[place], *said]
    found = _best_first(replace(found, torques=torques), looked)
    if "tau" not in found.chosen:
        return found
    label, guess = found.chosen["tau"]
    chosen = looked.get((label, guess.group.pattern))
    if chosen is None:
        return found
    misread = tuple(remark for remark in chosen.remarks() if remark.level != "ok")
    return replace(found, misread=misread)


def _of_stamps(found: Inspection) -> Iterator[Remark]:
    """What is wrong with the time stamps of logs, as a diagnosis finds it."""
    label, _ = found.chosen["q"]
    for entry in found.entries:
        table = entry[label]
        guess = table.best("q")
        if guess is None:
            continue
        t, q = table.time.seconds, guess.group.values
        # what stands still, jumps back or is no number is said of the columns
        usable = np.isfinite(q).all(axis=1)
        usable &= np.diff(np.maximum.accumulate(t), prepend=-np.inf) > 0
        for fault in find_stamps([Recording(table.label, t[usable], q[usable])]):
            yield fault_remark(fault, guess.group.width)


def _set_up(found: Inspection, label: str, guess: ChannelGuess) -> SetUp | None:
    """What the drafted case with some columns as the torque shows; ``None`` if it cannot be asked."""
    if found.arm is None or guess.channel not in TORQUES:
        return None
    if guess.role in AMPERES:
        # without motor constants the search finds what an ampere makes
        guess = replace(guess, unit="N m")
    torque = {"tau": (label, replace(guess, channel="tau"))}
    try:
        case = _drafted(replace(found, chosen=found.chosen | torque))
        return look_at_set_up(case)
    except GapscopeError:
        # it cannot be read, which is said of the draft, or is too short to be differentiated
        return None


def _drafted(found: Inspection) -> Case:
    """The drafted case.

    Raises:
        GapscopeError: it cannot be read.
    """
    assert found.arm is not None
    with TemporaryDirectory(prefix="gapscope_") as folder:
        file = Path(folder) / "case.yaml"
        text = case_text(found, Path(folder), str(found.arm.urdf.resolve()))
        file.write_text(text, encoding="utf-8")
        return load_case(file, any_unit=True)


def _said(error: GapscopeError) -> str:
    """An error on the draft, which lies in a folder that is gone: names of files alone."""
    if not isinstance(error, InputError):
        return error.message
    file = error.file.name if error.file is not None else ""
    place = ", ".join(filter(None, (file, error.where)))
    return f"{place}: {error.problem}" if place else error.problem


def _best_first(found: Inspection, looked: dict[tuple[str, str], SetUp]) -> Inspection:
    """The torques of a table without names of columns in the order in which they fit the arm."""

    def rank(guess: ChannelGuess) -> tuple[float, ...]:
        set_up = looked.get((label, guess.group.pattern))
        if guess.channel != "tau" or set_up is None or set_up.off is None:
            return (1.0,)
        # of a torque and the current that it was made from, the one in N m
        return (set_up.off > NO_TORQUE, len(set_up.faults), set_up.off)

    def ordered(table: InspectedTable) -> InspectedTable:
        return replace(table, channels=tuple(sorted(table.channels, key=rank)))

    for label, table in found.sources.items():
        torque = found.chosen.get("tau", ("",))[0]
        if label == torque and table.by_values:
            entries = tuple(
                {**entry, label: ordered(entry[label])} for entry in found.entries
            )
            sources = {**found.sources, label: ordered(table)}
            best = sources[label].best("tau")
            assert best is not None
            chosen = {**found.chosen, "tau": (label, best)}
            return replace(
                found,
                entries=entries,
                sources=sources,
                chosen=chosen,
                oddities=oddities_in(entries, chosen),
            )
    return found
