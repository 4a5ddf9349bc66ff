"""What looks wrong in a log, before any physics."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from gapscope.arm.io.channel_entry import UNITS
from gapscope.arm.io.formats.lerobot_calibration import STEPS_PER_TURN
from gapscope.arm.io.plausibility import gap_notes, repeated_rows
from gapscope.arm.recording import STILL
from gapscope.diagnosis.set_up import Remark
from gapscope.inspection.channels import ChannelGuess
from gapscope.inspection.time_column import TimeGuess

CLIPPED = 0.02
"""Share of rows at exactly the largest or least value from which a column counts as clipped [1]."""
SPIKE = 20.0
"""Step of one row and back over that of all but one in a hundred from which it counts as a spike [1]."""
TURN = {"rad": 2 * np.pi, "deg": 360.0, "rev": 1.0, "step": STEPS_PER_TURN}
"""A turn in each unit of positions."""
HELD = 0.5
"""Share of rows in which a moving reference stands still from which it counts as held [1]."""


def _odd(where: str, what: str, remedy: str) -> Remark:
    """What looks wrong: file, channel and joint; what was seen, with figures; what to do."""
    return Remark("warn", "log", where, what, remedy)


def oddities_of(
    where: str, time: TimeGuess, channels: Sequence[ChannelGuess]
) -> list[Remark]:
    """What looks wrong in one table.

    Args:
        where: name of the table, for messages.
        time: its time.
        channels: the columns taken for channels, one of each.
    """
    found = [*_time(where, time)]
    by_name = {guess.channel: guess for guess in channels}
    for guess in channels:
        found += _column(where, guess, time)
    found += _pairs(where, by_name)
    if "q" in by_name:
        found += _still(where, by_name["q"])
    return found


def _time(where: str, time: TimeGuess) -> Iterator[Remark]:
    if not time.certain:
        yield _odd(
            where,
            f"nothing in it tells the rate; {time.rate:g} Hz is assumed",
            "correct rate: in the case",
        )
    step = np.diff(time.seconds)
    if not len(step):
        return
    if (step < 0).any():
        row = int(np.flatnonzero(step < 0)[0]) + 1
        yield _odd(
            where,
            f"time jumps back at row {row}",
            "split the log there, or sort its rows",
        )
    # in the words of the reader, which says the same of the drafted case
    for note in repeated_rows(time.seconds, {})[1]:
        yield _odd(where, note, "nothing: they are dropped on reading")
    for note in gap_notes(time.seconds):
        yield _odd(
            where,
            note,
            "the recording is cut there; if nobody stopped it, look why samples were lost",
        )


def _column(where: str, guess: ChannelGuess, time: TimeGuess) -> Iterator[Remark]:
    """Cells that are missing, clipped values and spikes."""
    values = guess.group.values
    missing = int((~np.isfinite(values)).sum())
    if missing:
        yield _odd(
            where,
            f"{guess.group.pattern}: {missing} cells are empty or no numbers",
            "leave the channel out (null); a missing value is never guessed",
        )
        return
    if guess.channel in ("tau", "tau_sensor"):
        for j, column in enumerate(guess.group.values.T):
            if np.ptp(column) == 0:
                continue
            for limit in (column.min(), column.max()):
                share = float((column == limit).mean())
                if limit != 0 and share > CLIPPED and len(np.unique(column)) > 50:
                    yield _odd(
                        f"{where}, joint {j + 1}",
                        f"{guess.group.pattern} stands at {limit:.4g} in {share:.0%} of the rows: a limit was reached",
                        "state torque_limit in the case's nominal section",
                    )
    if guess.channel in ("q", "tau", "tau_sensor"):
        yield from _spikes(where, guess, time)


def _spikes(where: str, guess: ChannelGuess, time: TimeGuess) -> Iterator[Remark]:
    """Values that leave their neighbours for one row."""
    values = guess.group.values
    if len(values) < 100:
        return
    if guess.channel == "q":
        # a position that restarts after a turn is taken back on reading
        values = np.unwrap(values, period=TURN.get(guess.unit, TURN["rad"]), axis=0)
    bend = np.abs(values[1:-1] - 0.5 * (values[:-2] + values[2:]))
    # over rows that were lost a motion goes on
    step = np.diff(time.seconds)
    lost = step > 1.5 * np.median(step)
    bend[lost[1:] | lost[:-1]] = 0.0
    usual = np.quantile(bend, 0.99, axis=0)
    for j in range(values.shape[1]):
        far = bend[:, j] > SPIKE * max(usual[j], 1e-12)
        if usual[j] > 0 and far.any():
            row = int(np.argmax(bend[:, j])) + 2
            yield _odd(
                f"{where}, joint {j + 1}",
                f"{guess.group.pattern} leaves its neighbours in {far.sum()} rows, the worst is row {row}",
                "drop those rows",
            )


def _pairs(where: str, by_name: dict[str, ChannelGuess]) -> Iterator[Remark]:
    """Channels that are copies of others, or references that stand."""
    for measured, asked in (("q", "q_ref"), ("dq", "dq_ref")):
        if measured not in by_name or asked not in by_name:
            continue
        one, other = by_name[measured].group, by_name[asked].group
        moves = np.ptp(one.values, axis=0).any()
        if moves and np.array_equal(one.values, other.values):
            yield _odd(
                where,
                f"{one.pattern} and {other.pattern} are the same numbers: one of them is a copy",
                "a copied reference says nothing of the arm; leave it out (null)",
            )
    for name in ("dq", "dq_ref"):
        position = by_name.get(name[1:])
        velocity = by_name.get(name)
        if position is None or velocity is None:
            continue
        moves = np.ptp(position.group.values, axis=0).any()
        if moves and np.ptp(velocity.group.values) == 0:
            yield _odd(
                where,
                f"{velocity.group.pattern} never changes while {position.group.pattern} moves",
                "it is no velocity; leave it out (null)",
            )
    reference = by_name.get("q_ref")
    if reference is not None:
        step = np.abs(np.diff(reference.group.values, axis=0)).max(axis=1)
        held = float((step == 0).mean())
        # at rest the reference may stand
        if (step > 0).mean() > 0.05 and HELD < held < 0.98 and _evenly_held(step):
            yield _odd(
                where,
                f"{reference.group.pattern} stands still in {held:.0%} of the rows and jumps between: set points "
                f"come at about 1/{round(1 / (1 - held))} of the rate of the log",
                "the controller may interpolate them; what it follows is not in the log",
            )


def _evenly_held(step: np.ndarray) -> bool:
    """Whether jumps come at even distances, as set points at a lower rate do."""
    apart = np.diff(np.flatnonzero(step > 0))
    return bool(
        len(apart) > 10
        and np.median(apart) > 1
        and (apart == np.median(apart)).mean() > 0.5
    )


def _still(where: str, guess: ChannelGuess) -> Iterator[Remark]:
    travel = np.ptp(guess.group.values, axis=0) * UNITS.get(guess.unit, 1.0)
    still = travel < STILL
    if still.all():
        yield _odd(
            where,
            f"the arm stands still: no joint moves by {STILL:g} rad",
            "record a motion of all joints",
        )
    elif still.any():
        numbers = ", ".join(str(j + 1) for j in np.flatnonzero(still))
        yield _odd(
            where,
            f"joint {numbers} does not move: its friction, armature and zero cannot be told",
            "move every joint, slowly and fast, in both directions",
        )
