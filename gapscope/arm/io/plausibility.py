"""Checks that separate a recording that cannot be right from one that is merely unusual."""

from __future__ import annotations

import numpy as np

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.io.channel_entry import UNITS
from gapscope.arm.io.table import Table
from gapscope.arm.joint_units import joint_unit
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording

PLAUSIBLE_RATES = (10.0, 20_000.0)
"""Sampling rates of robot logs [Hz]; below, no motion is resolved."""

SHORTEST_LOG = 1.0
"""A log that lasts less holds no motion that can be diagnosed [s]."""

LONGEST_GAP = 1e6
"""Periods that a gap in a log may last [1]: a quarter of an hour at 1 kHz, a day at 10 Hz."""

TURN_TOLERANCE = 0.5
"""A step between two samples that differs from a turn by less is a count that starts again [rad]."""

UNSIGNED = "torque is unsigned: only commands and positions can be trusted"
"""Note on a recording whose torque had to be set aside."""

DIAGNOSE_FIRST = "or let gapscope diagnose find out, and go on with the mended_case.yaml that it writes"
"""What to do with a log whose units are unknown."""

REPEATED = "rows dropped that repeat the measurement before them: "
"""Note on rows that a logger stored twice; their number and share follow."""


def check_runs_forward(t: np.ndarray, table: Table, column: str) -> None:
    """Time [s], (N,), has to run forward.

    Raises:
        InputError: t jumps back, leaps, or is constant.
    """
    step = np.diff(t)
    back = np.flatnonzero(step < 0)
    if len(back):
        row = int(back[0]) + 1
        raise InputError(
            f"time jumps back, from {t[row - 1]:.6g} s to {t[row]:.6g} s",
            "split the log there into two recordings, or sort its rows",
            file=table.path,
            where=table.where(row, column),
        )
    if not (step > 0).any():
        raise InputError(
            f"time stands still in all of its rows ({len(t)}), expected a motion",
            "give a longer recording",
            file=table.path,
        )
    usual = float(np.median(step[step > 0]))
    wide = int(step.argmax())
    if step[wide] > LONGEST_GAP * usual:
        raise InputError(
            f"time leaps from {t[wide]:.6g} s to {t[wide + 1]:.6g} s, where a step usually takes {usual:.3g} s",
            "correct the stamp, or split the log there into two recordings",
            file=table.path,
            where=table.where(wide + 1, column),
        )


def check_rate(t: np.ndarray, table: Table, column: str, *, any_unit: bool) -> None:
    """Time [s], (N,), has to have a rate at which a robot is logged; in other units too if ``any_unit``.

    Raises:
        InputError: it has an implausible rate.
    """
    step = np.diff(t)
    rate = 1 / float(np.median(step[step > 0]))
    low, high = PLAUSIBLE_RATES
    unit = unit_of_stamps(rate, float(t[-1] - t[0]))
    if not unit:
        remedy = "correct the unit or rate of import: time"
        raise InputError(
            f"the rate is {rate:.3g} Hz, expected {low:g} to {high:g} Hz",
            f"log at a higher rate, or {remedy}" if rate < low else remedy,
            file=table.path,
            where=f"column {column}",
        )
    if unit != "s" and not any_unit:
        raise InputError(
            f"looks like {unit}: taken as s the rate is {rate:.3g} Hz, expected {low:g} to {high:g} Hz",
            f"say in the case: import: {{time: {{column: {column}, unit: {unit}}}}}, or rate: where it counts samples; "
            + DIAGNOSE_FIRST,
            file=table.path,
            where=f"column {column}",
        )


def unit_of_stamps(rate: float, duration: float) -> str:
    """Unit of stamps: s if robots are logged at that rate, else the first in which they are; empty if none is.

    In ms, us or ns the log has to last as well: one at 5 Hz is not over in 60 ms.

    Args:
        rate: of the stamps, taken as s [Hz].
        duration: from the first to the last, taken as s [s].
    """
    low, high = PLAUSIBLE_RATES
    for unit in ("s", "ms", "us", "ns"):
        factor = UNITS[unit]
        lasts = unit == "s" or duration * factor >= SHORTEST_LOG
        # stamps of 0.1 s round to a little more
        if 0.99 * low <= rate / factor <= 1.01 * high and lasts:
            return unit
    return ""


def check_positions(
    recording: Recording, arm: NominalArm, table: Table, *, any_unit: bool = False
) -> tuple[str, ...]:
    """Positions must be radians, or metres of slides, unless ``any_unit``; a note for each beyond the URDF's range.

    Raises:
        InputError: a joint with limits moves far outside them and beyond 7 rad, a slide beyond 0.7 m.
    """
    notes = []
    lowest, highest = RigidBody(arm).position_limits()
    for j, joint in enumerate(arm.joints):
        lower, upper = lowest[j], highest[j]
        low, high = recording.q[:, j].min(), recording.q[:, j].max()
        unit = joint_unit("rad", arm.sliding[j])
        range_text = (
            f"q{j + 1} goes from {low:.4g} to {high:.4g}, "
            f"{joint} is limited to {lower:.4g} to {upper:.4g} {unit}"
        )
        reach, size = max(abs(low), abs(high)), arm.per_radian[j]
        allowed = max(abs(lower), abs(upper))
        # beyond a turn and far outside the limits: another unit or side, not a bad limit
        if reach > 7 * size and reach > 1.5 * allowed and not any_unit:
            guess = "mm" if arm.sliding[j] else "deg"
            fits = reach * UNITS[guess] <= 1.2 * allowed
            raise _other_unit(range_text, guess if fits else "", table, f"q{j + 1}")
        if low < lower - 0.1 * size or high > upper + 0.1 * size:
            notes.append(f"{range_text}: check unit, offset and order of the joints")
    return tuple(notes)


def _other_unit(range_text: str, guess: str, table: Table, column: str) -> InputError:
    """The error on positions that cannot be radians, or metres, on the joint's side; the unit that fits, if any."""
    remedy = "check the unit, the order of the joints and the transmission in the case's import section"
    if guess:
        words = {"deg": "degrees", "mm": "millimetres"}[guess]
        range_text += f": looks like {words}"
        remedy = f"say in the case: import: {{q: {{column: ..., unit: {guess}}}}}"
    remedy = f"{remedy}; {DIAGNOSE_FIRST}"
    return InputError(range_text, remedy, file=table.path, where=f"column {column}")


def without_turns(
    values: dict[str, np.ndarray],
) -> tuple[dict[str, np.ndarray], tuple[str, ...]]:
    """Channels without jumps by a turn, as a robot that counts from 0 to 360 degrees makes; and a note.

    Positions and references of its joints run on, around the turn that is nearest to zero.
    """
    positions = {name: values[name] for name in ("q", "q_ref") if name in values}
    turned = np.zeros(values["q"].shape[1], dtype=bool)
    for x in positions.values():
        turned |= _restarts_after_a_turn(x)
    if not turned.any():
        return values, ()
    # where one joint starts again after a turn, those that did not get there count likewise
    q = values["q"]
    counted = turned | ((q >= 0) & (q <= 2 * np.pi)).all(axis=0)
    out = dict(values)
    for name, x in positions.items():
        steady = np.unwrap(x, axis=0)
        middle = (steady.max(axis=0) + steady.min(axis=0)) / 2
        steady = steady - 2 * np.pi * np.round(middle / (2 * np.pi))
        out[name] = np.where(counted, steady, x)
    joints = ", ".join(f"q{j + 1}" for j in np.flatnonzero(turned))
    return out, (f"jumps by a turn between two samples taken back: {joints}",)


def _restarts_after_a_turn(x: np.ndarray) -> np.ndarray:
    """Which joints' positions x [rad], (N, n), jump by a turn and make small steps else; (n,)."""
    step = np.abs(np.diff(x, axis=0))
    by_a_turn = np.abs(step - 2 * np.pi) < TURN_TOLERANCE
    # positions in another unit have steps of all sizes
    plain = (by_a_turn | (step < TURN_TOLERANCE)).all(axis=0)
    return np.asarray(by_a_turn.any(axis=0) & plain)


def repeated_rows(
    t: np.ndarray, values: dict[str, np.ndarray]
) -> tuple[np.ndarray, tuple[str, ...]]:
    """Rows that repeat the time stamp or the whole measurement before them; mask of shape (N,), and notes.

    A logger faster than the robot's bus stores a measurement twice. It is treated as that if every measured
    channel, a noisy one (velocity or torque) among them, repeats for one to three rows and the position moves on
    after them; an arm at rest repeats itself for longer and keeps its rows.
    """
    notes = []
    stamp = np.r_[False, np.diff(t) == 0]
    if stamp.any():
        notes.append(
            f"rows dropped that repeat the time stamp before them: {stamp.sum()}"
        )
    stale = _stored_twice(values, len(t)) & ~stamp
    if stale.any():
        notes.append(f"{REPEATED}{stale.sum()} ({stale.mean():.2%})")
    return stamp | stale, tuple(notes)


def _stored_twice(values: dict[str, np.ndarray], count: int) -> np.ndarray:
    """Rows that repeat every measured channel of the row before them, in runs of one to three; mask (count,)."""
    stale = np.zeros(count, dtype=bool)
    if "dq" not in values and "tau" not in values:
        return stale
    same = np.r_[False, np.ones(count - 1, dtype=bool)]
    for name in ("q", "dq", "tau", "tau_sensor"):
        if name in values:
            same[1:] &= (values[name][1:] == values[name][:-1]).all(axis=1)
    # runs of repeated rows begin and end where the mask changes
    edges = np.flatnonzero(np.diff(np.r_[False, same, False].astype(int)))
    for start, stop in zip(edges[::2], edges[1::2], strict=True):
        stale[start:stop] = stop - start <= 3 and stop < count
    return stale


def untrusted_torque(
    values: dict[str, np.ndarray],
) -> tuple[dict[str, np.ndarray], tuple[str, ...]]:
    """Channels without a torque or torque sensor that cannot be a measurement, and notes why."""
    kept, notes = dict(values), []
    for name in ("tau", "tau_sensor"):
        if name not in kept:
            continue
        silent = (kept[name] == 0).all(axis=0)
        if silent.all():
            notes.append(f"{name} is zero throughout and was left out")
            del kept[name]
        elif silent.any():
            joints = ", ".join(f"{name}{j + 1}" for j in np.flatnonzero(silent))
            notes.append(f"{joints} zero throughout")
    if "tau" in kept and _is_unsigned(kept["q"], kept["tau"]):
        notes.append(UNSIGNED)
        del kept["tau"]
    return kept, tuple(notes)


def _is_unsigned(q: np.ndarray, tau: np.ndarray) -> bool:
    """Whether tau [N m] never turns negative although at least two joints move to and fro; q [rad], both (N, n).

    Gravity may hold a joint's torque on one side, but then away from zero; an absolute value touches it.
    """
    if (tau < 0).any():
        return False
    step = np.diff(q, axis=0)
    moving = np.abs(step) > 0.05 * np.abs(step).max(axis=0)
    forward = (moving & (step > 0)).sum(axis=0)
    forward_share = forward / np.maximum(moving.sum(axis=0), 1)
    both_ways = (forward_share > 0.1) & (forward_share < 0.9)
    to_and_fro = both_ways & (np.ptp(q, axis=0) > 0.02)
    touches_zero = tau.min(axis=0) < 0.05 * tau.max(axis=0)
    return bool(to_and_fro.sum() >= 2 and touches_zero[to_and_fro].all())


def gap_notes(t: np.ndarray) -> tuple[str, ...]:
    """A note if samples are missing: steps of t [s] longer than 2.5 usual ones."""
    step = np.diff(t)
    usual = np.median(step)
    wide = step > 2.5 * usual
    if not wide.any():
        return ()
    return (f"gaps in time: {wide.sum()}, the longest {step.max():.3g} s",)
