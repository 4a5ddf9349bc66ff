"""The case to start from: a case file in which every guess has its line and its reason, and what reading it shows."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from textwrap import wrap
from typing import Any

import numpy as np
import yaml

from gapscope.arm.case import Case, load_case
from gapscope.arm.dynamics.description import read_description
from gapscope.arm.dynamics.link_shapes import read_frames
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.dynamics.robot_file import actuated_joints
from gapscope.arm.errors import GapscopeError, InputError
from gapscope.arm.io.layouts import LEROBOT, layout_of, name_of
from gapscope.arm.known_load import KnownLoad
from gapscope.arm.nominal import SHEET_UNITS, NominalArm
from gapscope.arm.recording import CHANNELS, Recording
from gapscope.diagnosis.set_up import Remark, SetUp, fault_remark, look_at_set_up
from gapscope.diagnosis.setup_faults.clocks import find_stamps
from gapscope.diagnosis.thresholds import NO_TORQUE
from gapscope.effects.effect import SHEET
from gapscope.inspection.columns import AMPERES, LARGEST, ChannelGuess
from gapscope.inspection.inspection import (
    MAIN,
    TIME,
    TORQUES,
    InspectedTable,
    Inspection,
    columns_of_arm,
    note,
    oddities_in,
)

# The load that a robot was told to carry, by the columns of a log of a known layout.


@dataclass(frozen=True)
class ToldLoad:
    """A load as a robot was told of it.

    Attributes:
        load: as a point, in the frame of the joint that moves the last link.
        why: which columns say so, and what is uncertain.
    """

    load: KnownLoad
    why: str


def told_load(table: InspectedTable, arm: NominalArm) -> ToldLoad | None:
    """The load that a table holds; ``None`` if it holds none, or one that changes, or of no mass."""
    layout = layout_of(table.part)
    for place in () if layout is None else layout.loads:
        names = [place["mass"], *(name_of(place["com"], j, "") for j in range(3))]
        columns = table.part.columns
        if not all(name in columns for name in names):
            continue
        values = np.column_stack([columns[name] for name in names]).astype(float)
        mass, *centre = values[0]
        if mass > 0 and np.ptp(values, axis=0).max() == 0:
            return _placed(place, mass, np.array(centre), arm)
    return None


def _placed(
    place: Mapping[str, Any], mass: float, centre: np.ndarray, arm: NominalArm
) -> ToldLoad:
    """The load in the frame of the last joint."""
    frames = read_frames(RigidBody(arm)).values()
    of_last = [frame for frame in frames if frame.joint == arm.joints[-1]]
    why = f"told to the robot ({place['mass']}, {place['com']})"
    for frame in of_last:
        if frame.name.endswith(tuple(place["frames"])):
            centre = frame.position + frame.rotation @ centre
            why += f", its centre in the frame of {frame.name}"
            break
    else:
        why += ", its centre in the flange's frame, which the robot file does not have: correct com"
    x, y, z = (round(float(value), 6) for value in centre)
    return ToldLoad(KnownLoad(float(mass), (x, y, z)), why)


# The case file.


BESIDE = 70
"""Longest reason that stands beside its line; longer ones stand above."""
ABOVE = 110
"""Width of reasons above their line."""


def case_text(found: Inspection, folder: Path, robot: str | None) -> str:
    """Text of ``case.yaml``.

    Args:
        found: what is in the logs.
        folder: in which the case will stand; the logs are named relative to it.
        robot: what ``robot:`` shall say; ``None`` if no robot is known.
    """
    names = ", ".join(log.path.name for log in found.logs[:4])
    more = f" and {len(found.logs) - 4} more" if len(found.logs) > 4 else ""
    lines = [
        f"# Drafted by gapscope inspect from {names}{more}. Every entry is a guess, with its reason beside it.",
        f"name: {flow(_name(found))}",
        *_robot(found, robot),
        *_recordings(found, folder),
        *_payloads(found, folder),
        "import:",
        *_aligned(_import(found)),
        *_data_sheet(found),
    ]
    return "\n".join(lines) + "\n"


def _name(found: Inspection) -> str:
    if found.arm is not None:
        return found.arm.name
    return found.main.log.path.stem


def _robot(found: Inspection, robot: str | None) -> Iterator[str]:
    """The robot, and its joints if the log has fewer or other ones."""
    if robot is None:
        yield "robot: robot.urdf  # not known: put the URDF or MJCF of the arm here"
        return
    yield f"robot: {flow(robot)}"
    assert found.arm is not None
    listed = flow(list(found.arm.joints))
    if list(found.arm.joints) == actuated_joints(read_description(found.arm.urdf)):
        yield f"# joints: {listed}  # the order of the columns, if it is another"
    else:
        yield f"joints: {listed}  # those of the robot that the log has; all others stay where they are"


def _recordings(found: Inspection, folder: Path) -> Iterator[str]:
    yield "recordings:"
    for entry in found.entries:
        paths = {
            label: _relative(table.log.path, folder) for label, table in entry.items()
        }
        alone = len(set(paths.values())) == 1
        yield f"  - {flow(paths[MAIN]) if alone else flow(paths)}"
    if len(found.entries) > 2:
        yield "# judge: [FILE]  # name one of them here in place of above: it is held out and never fitted"


def _payloads(found: Inspection, folder: Path) -> Iterator[str]:
    """The load of each recording, if its robot was told of one."""
    told = {
        _relative(entry[label].log.path, folder): load
        for entry in found.entries
        for label in list(entry)[:1]
        if found.arm is not None
        and (load := told_load(entry[label], found.arm)) is not None
    }
    if told:
        yield "payloads:"
    for name, load in told.items():
        yield f"  {flow(name)}: {flow(load.load.entry())}  # {load.why}"


def _import(found: Inspection) -> Iterator[tuple[str, str]]:
    """Lines of the import section, each with its reason."""
    yield _time(found)
    main = found.main
    if main.part.kind == LEROBOT:
        numbers = list(range(len(main.log.tables)))
        listed = flow({"fit": numbers[:-1] or numbers, "judge": numbers[-1:]})
        yield f"# episodes: {listed}", "all are fitted; hold some out by this line"
    elif len(main.log.tables) > 1:
        yield f"topic: {flow(main.part.name)}", "holds the positions"
    if _renamed(found):
        listed = flow(list(found.chosen["q"][1].group.labels))
        yield f"joints: {listed}", "their names in the log, in the order of the robot's"
    files = {table.log.path for table in found.sources.values()}
    if len(files) > 1:
        yield _join(found)
    for channel in CHANNELS:
        if channel in found.chosen:
            label, guess = found.chosen[channel]
            yield from _channel(found, channel, label, guess)
        elif channel == "tau":
            yield "tau: null", "no column name identifies a torque"
    used = [guess for _, guess in found.chosen.values()]
    for label, table in found.sources.items():
        for guess in table.channels:
            # what else could be the torque, or the position if its vendor says what the column holds
            other = guess.channel in TORQUES or (guess.channel == "q" and guess.role)
            if other and guess not in used:
                line = f"# {guess.channel}: {_entry(found, label, guess)}"
                yield line, _reason(found, label, guess)


def _renamed(found: Inspection) -> bool:
    """Whether the log names the joints otherwise than the robot does."""
    group = found.chosen["q"][1].group
    if found.arm is None or not group.by_name:
        return False
    same_number = group.width == found.arm.n_joints
    return same_number and not set(found.arm.joints) <= set(group.labels)


def _join(found: Inspection) -> tuple[str, str]:
    """How files side by side meet."""
    rows = {len(table.part) for table in found.sources.values()}
    if len(rows) == 1:
        return "join: row", "the files have as many rows"
    return "join: hold", "the files differ in length: the last value before counts"


def _time(found: Inspection) -> tuple[str, str]:
    time = found.main.time
    column: str | int | None = time.column
    table = found.sources.get(TIME, found.main).part
    if column is not None and table.unnamed:
        column = int(column)
    if column is None:
        entry: dict[str, Any] = {"rate": _rounded(time.rate)}
    elif not time.unit:
        entry = {"column": column, "rate": _rounded(time.rate)}
    else:
        entry = {"column": column, "unit": time.unit}
    if TIME in found.sources:
        entry["file"] = TIME
    return f"time: {flow(entry)}", time.why


def _channel(
    found: Inspection, channel: str, label: str, guess: ChannelGuess
) -> Iterator[tuple[str, str]]:
    """The line of one channel; a comment if the columns cannot be read as they are."""
    line = f"{channel}: {_entry(found, label, guess)}"
    values = guess.group.values
    if not np.isfinite(values).all() or np.abs(values).max() > LARGEST:
        yield f"# {line}", "left out: it holds cells that are no numbers"
        yield f"{channel}: null", ""
    elif np.ptp(values) == 0 and channel != "q":
        yield f"# {line}", f"left out: it is {values.flat[0]:g} throughout"
        yield f"{channel}: null", ""
    elif guess.unit == "A":
        yield (
            f"# {line}",
            "give the motor constants [N m/A] and gear ratios of the data sheet, and take the # away",
        )
        yield f"{channel}: null", _reason(found, label, guess)
    else:
        yield line, _reason(found, label, guess)


def _entry(found: Inspection, label: str, guess: ChannelGuess) -> str:
    """What the import section says of some columns."""
    entry: dict[str, Any] = {"column": _column(found, guess)}
    if guess.unit not in ("", "rad", "rad/s", "N m", "degC"):
        entry["unit"] = guess.unit
    if guess.group.sign_bit is not None:
        entry["sign_bit"] = guess.group.sign_bit
    if guess.unit == "A":
        n = found.n_joints
        entry |= {"motor_constant": [0.0] * n, "gear_ratio": [0.0] * n}
    table = found.sources[label]
    if len({other.log.path for other in found.sources.values()}) > 1:
        entry["file"] = label
    elif table is not found.main:
        entry["topic"] = table.part.name
    if list(entry) == ["column"]:
        return flow(entry["column"])
    return flow(entry)


def _column(found: Inspection, guess: ChannelGuess) -> str | list[str] | list[int]:
    """The pattern, or a list of names if it does not give those of the arm's joints; numbers for lack of names."""
    group = guess.group
    if group.numbered:
        return [int(name) for name in group.names[: found.n_joints]]
    if group.seen:
        return list(group.names[: found.n_joints])
    if found.arm is None or len(group.names) != group.width:
        return group.pattern
    joints = found.arm.joints
    if "{joint}" not in group.pattern and group.width == len(joints):
        return group.pattern
    main = found.chosen["q"][1].group
    if group.by_name and (set(joints) <= set(group.labels)):
        return group.pattern
    if _renamed(found) and group.labels == main.labels:
        return group.pattern
    places = columns_of_arm(group, joints)
    return (
        list(group.names)
        if places is None
        else [group.names[place] for place in places]
    )


def _reason(found: Inspection, label: str, guess: ChannelGuess) -> str:
    """Why columns are taken for what they are."""
    if guess.channel not in TORQUES:
        return "; ".join(filter(None, (guess.why, guess.role)))
    facts = found.torques.get((label, guess.group.pattern), [])
    said = guess.why if guess.group.seen else guess.role or guess.why
    return "; ".join(filter(None, (said, *facts)))


def _data_sheet(found: Inspection) -> Iterator[str]:
    """What only a data sheet can say; of a known robot, what its file says."""
    yield "# nominal:  # the data sheet, one value per joint, joint side; take the # away to state it"
    for quantity, name in SHEET.items():
        unit = SHEET_UNITS[name]
        if quantity == "rotor":
            unit += ": rotor inertia times gear ratio squared"
        values = [0.0] * found.n_joints
        if found.arm is not None:
            values = [float(f"{x:.6g}") for x in getattr(found.arm, name)]
        yield f"#   {name}: {flow(values)}  # {unit}"
    yield "#   encoder: motor  # motor, or joint: the side of the gear on which the position is measured"
    yield from _controller(found)


def _controller(found: Inspection) -> Iterator[str]:
    """A controller to fill in, if the log holds what it followed."""
    if "q_ref" not in found.chosen:
        return
    zeros = flow([0.0] * found.n_joints)
    rate = _rounded(float(f"{found.main.time.rate:.4g}"))
    yield f"# controller: {{kind: pd, rate: {rate}, kp: {zeros}, kd: {zeros}}}  # for replay: N m/rad, N m s/rad"


def _aligned(lines: Iterator[tuple[str, str]]) -> Iterator[str]:
    """Lines with their reasons: beside them if short, else above."""
    for text, reason in lines:
        if len(reason) > BESIDE:
            for part in wrap(reason, ABOVE):
                yield f"  # {part}"
            yield f"  {text}"
        else:
            yield f"  {text}  # {reason}" if reason else f"  {text}"


def _relative(path: Path, folder: Path) -> str:
    return Path(os.path.relpath(path.resolve(), folder.resolve())).as_posix()


def _rounded(rate: float) -> float | int:
    return int(rate) if rate == int(rate) else rate


def flow(value: Any) -> str:
    """A value as YAML on one line."""
    text = yaml.safe_dump(value, default_flow_style=True, sort_keys=False, width=10_000)
    return text.removesuffix("\n").removesuffix("\n...")


# The drafted case, read: whether it can be, and what each of its torque columns shows of the set-up.


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
