"""What the torque columns are: computed, scaled, of the motor; compared with the nominal arm."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import GapscopeError
from gapscope.arm.io.damaged_rows import BEYOND
from gapscope.arm.io.import_section import UNITS
from gapscope.arm.io.load_recording import recording_of_columns
from gapscope.arm.nominal import NominalArm, smooth_sign
from gapscope.arm.reading import Columns
from gapscope.arm.recording import Recording
from gapscope.arm.robots import load_nominal_arm
from gapscope.effects.setup_faults import TorqueUnit
from gapscope.inspection.channels import ChannelGuess
from gapscope.inspection.columns import ColumnGroup
from gapscope.inspection.inspected_table import InspectedTable
from gapscope.inspection.time_column import TimeGuess
from gapscope.inspection.words import LARGEST
from gapscope.model.conditioning import Segment, condition

# What a torque column can be, by the log alone: silent, unsigned, computed, or another column times a factor.


EXACT = 1e-3
"""Share of a column's deviation that rounding leaves if it is computed from others [1]; a measurement leaves more."""
SAMPLES = 20_000
"""Rows that are looked at, evenly taken."""


def torque_facts(torque: ChannelGuess, others: Sequence[ChannelGuess]) -> list[str]:
    """Sentences on one torque column, each with its figures; empty if nothing strikes.

    Args:
        torque: the columns in question.
        others: all channels of the same table.
    """
    values = _thinned(torque.group.values)
    if not _usable(values):
        return ["it holds cells that are no numbers, or beyond any torque"]
    others = [other for other in others if _usable(other.group.values)]
    silent = np.ptp(values, axis=0) == 0
    if silent.all():
        constant = float(values[0, 0])
        return [f"it is {constant:g} throughout: nothing was measured"]
    facts = []
    if silent.any():
        facts.append(f"it never changes on joint {_numbers(silent)}")
    if (values >= 0).all():
        facts.append("it is never negative: a magnitude, whose sign is lost")
    facts += _quantised(values[:, ~silent])
    facts += _multiples(torque, others)
    facts += _controllers(torque, others)
    return facts


def _quantised(values: np.ndarray) -> Iterator[str]:
    """A column of few different values."""
    counts = [len(np.unique(column)) for column in values.T]
    most = max(counts)
    if most <= min(200, len(values) // 20):
        steps = [
            np.diff(np.unique(column)).min()
            for column in values.T
            if len(np.unique(column)) > 1
        ]
        yield f"it has {most} different values at most, in steps of {min(steps):.3g}"


def _multiples(torque: ChannelGuess, others: Sequence[ChannelGuess]) -> Iterator[str]:
    """Columns that it is a multiple of, joint by joint."""
    values = _thinned(torque.group.values)
    for other in others:
        if other is torque or other.group.width != torque.group.width:
            continue
        source = _thinned(other.group.values)
        factors = _factors(values, source)
        if factors is None:
            continue
        if np.allclose(factors, 1.0, atol=1e-3):
            yield f"it equals {other.group.pattern}"
        else:
            listed = ", ".join(f"{factor:.4g}" for factor in factors)
            yield f"it is {other.group.pattern} times {listed}"


def _factors(values: np.ndarray, source: np.ndarray) -> np.ndarray | None:
    """Factor of each joint if all columns are multiples of the others', (k,), or ``None``."""
    power = (source**2).sum(axis=0)
    if (power == 0).any():
        return None
    factors = (values * source).sum(axis=0) / power
    left = np.sqrt(((values - factors * source) ** 2).mean(axis=0))
    exact = left <= EXACT * values.std(axis=0)
    return np.asarray(factors) if exact.all() else None


def _controllers(torque: ChannelGuess, others: Sequence[ChannelGuess]) -> Iterator[str]:
    """A column that is computed from reference and position by gains."""
    by_channel = {
        other.channel: _thinned(other.group.values) for other in reversed(others)
    }
    values = _thinned(torque.group.values)
    needed = [by_channel.get(name) for name in ("q", "q_ref")]
    if any(x is None or x.shape != values.shape for x in needed):
        return
    error = by_channel["q_ref"] - by_channel["q"]
    rate = np.zeros_like(error)
    for name, sign in (("dq_ref", 1.0), ("dq", -1.0)):
        if name in by_channel and by_channel[name].shape == values.shape:
            rate += sign * by_channel[name]
    gains, left = [], []
    for j in range(values.shape[1]):
        design = np.column_stack([error[:, j], rate[:, j]])
        found, *_ = np.linalg.lstsq(design, values[:, j], rcond=None)
        left.append(
            np.std(values[:, j] - design @ found) / max(values[:, j].std(), 1e-12)
        )
        gains.append(found)
    if np.median(left) <= 10 * EXACT:
        kp = ", ".join(f"{gain[0]:.4g}" for gain in gains)
        kd = ", ".join(f"{gain[1]:.4g}" for gain in gains)
        yield (
            f"it is computed, not measured: kp (q_ref - q) + kd (dq_ref - dq) with kp {kp} and kd {kd}. "
            "As a command that is what it should be; whether the arm obeyed these gains, the log does not say"
        )


def _usable(values: np.ndarray) -> bool:
    """Whether all values are numbers of a size that robots have in any unit."""
    return bool(np.isfinite(values).all() and np.abs(values).max() < LARGEST)


def _thinned(values: np.ndarray) -> np.ndarray:
    return values[:: max(1, len(values) // SAMPLES)]


def _numbers(mask: np.ndarray) -> str:
    return ", ".join(str(j + 1) for j in np.flatnonzero(mask))


# What a torque column can be, by the nominal arm: gravity in or out, newton metres or amperes, which sign.


READINGS = ("with gravity", "without gravity")
STRETCHES = 20
"""Stretches into which the samples are cut, to fit on half of them."""
CLEARLY_BETTER = 0.05
"""Share of the torque's variance by which one reading has to explain more than the other [1]."""
EXPLAINED = 0.5
"""Share of the variance that a reading has to explain on a joint, for its factor to count [1]."""
BODIES = 0.1
"""Share of it that the bodies' torque has to explain beyond rotor and friction, for the same [1]."""


@dataclass(frozen=True)
class TorqueFit:
    """How the nominal arm explains a column as torque, n joints.

    Per joint, column = factor x (torque of the bodies) + rotor + Coulomb + viscous + offset, fitted on every second
    stretch of the samples and judged on those between.

    Attributes:
        reading: an entry of ``READINGS``.
        explained: share of the variance of the stretches between, (n,) [1].
        by_bodies: share that is lost without the torque of the bodies, (n,) [1].
        factor: column over torque of the nominal bodies, (n,), in the column's unit per N m.
    """

    reading: str
    explained: np.ndarray
    by_bodies: np.ndarray
    factor: np.ndarray

    @property
    def overall(self) -> float:
        """Median over the joints of what is explained [1]."""
        return float(np.median(np.clip(self.explained, 0.0, 1.0)))

    @property
    def counted(self) -> np.ndarray:
        """Joints of which the factor counts, mask (n,)."""
        return (self.explained > EXPLAINED) & (self.by_bodies > BODIES)


def fits_of(arm: NominalArm, recordings: Sequence[Recording]) -> list[TorqueFit]:
    """Both readings of the torque of recordings, the better first; none if nothing is left of them."""
    segments = [s for r in recordings for s in condition(r)]
    if not segments:
        return []
    body = RigidBody(arm)
    motion = [_inner(s) for s in segments]
    q, dq, ddq, tau = (np.concatenate(parts) for parts in zip(*motion, strict=True))
    still = np.zeros_like(q)
    gravity = body.inverse_dynamics(q, still, still)
    full = body.inverse_dynamics(q, dq, ddq) + arm.armature * ddq
    found = [
        _fit(reading, bodies, dq, ddq, tau)
        for reading, bodies in zip(READINGS, (full, full - gravity), strict=True)
    ]
    return sorted(found, key=lambda fit: -fit.overall)


def what_it_is(fits: Sequence[TorqueFit]) -> str:
    """The better reading in a sentence, with its figures."""
    best, other = fits
    if best.overall < EXPLAINED:
        return (
            f"the nominal arm explains {best.overall:.0%} of it at best (median over the joints): "
            "a wrong model, order of joints or unit, or no measurement"
        )
    told = best.overall - other.overall >= CLEARLY_BETTER
    gravity = (
        f"torque {best.reading}"
        if told
        else "torque; gravity in or out cannot be told from this motion"
    )
    if not best.counted.any():
        return f"{gravity}: the nominal arm explains {best.overall:.0%}, most of it by rotors and friction"
    factors = best.factor[best.counted]
    spread = (
        f"{factors.min():.2g} to {factors.max():.2g}"
        if np.ptp(factors) > 0
        else f"{factors[0]:.2g}"
    )
    return (
        f"{gravity}, {_unit(factors)}: the nominal arm explains {best.overall:.0%} of what was not fitted "
        f"({other.overall:.0%} {other.reading}), at {spread} per N m of the nominal arm"
    )


def _unit(factors: np.ndarray) -> str:
    """What factors between a column and the nominal torque say of its unit."""
    size = np.abs(factors)
    turned = int((factors < 0).sum())
    sign = ""
    if turned:
        sign = ", its sign turned" + (
            "" if turned == len(factors) else f" on {turned} of {len(factors)} joints"
        )
    if TorqueUnit("current", factor=tuple(size.tolist())).is_ordinary:
        return "in N m of the joint" + sign
    return (
        "not in N m of the joint: amperes, the motor's side, or a share of a limit"
        + sign
    )


def _inner(segment: Segment) -> tuple[np.ndarray, ...]:
    """q, dq, ddq and torque of a segment without its ends."""
    m, rows = segment.motion, segment.inner
    assert segment.torque is not None
    return m.q[rows], m.dq[rows], m.ddq[rows], segment.torque[rows]


def _fit(
    reading: str,
    bodies: np.ndarray,
    dq: np.ndarray,
    ddq: np.ndarray,
    tau: np.ndarray,
) -> TorqueFit:
    """Fit on every second stretch, judged on those between."""
    stretches = np.arange(len(tau)) // max(1, len(tau) // STRETCHES)
    fitted = stretches % 2 == 0
    explained, by_bodies, factors = [], [], []
    for j in range(tau.shape[1]):
        direction = smooth_sign(dq[:, j], 0.02)
        others = [ddq[:, j], direction, dq[:, j], np.ones(len(tau))]
        design = np.column_stack([bodies[:, j], *others])
        with_bodies, found = _explained(design, tau[:, j], fitted)
        without, _ = _explained(design[:, 1:], tau[:, j], fitted)
        explained.append(with_bodies)
        by_bodies.append(with_bodies - max(without, 0.0))
        factors.append(found[0])
    return TorqueFit(
        reading, np.array(explained), np.array(by_bodies), np.array(factors)
    )


def _explained(
    design: np.ndarray, torque: np.ndarray, fitted: np.ndarray
) -> tuple[float, np.ndarray]:
    """Share of the variance that is explained where it was not fitted, and the coefficients."""
    found, *_ = np.linalg.lstsq(design[fitted], torque[fitted], rcond=None)
    asked = torque[~fitted]
    left = asked - design[~fitted] @ found
    return float(1.0 - left.var() / max(asked.var(), 1e-12)), found


# A log against the nominal arm: which columns are the arm's joints, and how it explains each torque column.


LONGEST = 60.0
"""Duration of each recording that is looked at [s]."""


def arm_of_columns(arm: NominalArm, group: ColumnGroup) -> NominalArm:
    """The arm with those of its joints that a log has: by name, or the first if it has fewer and names none."""
    named = [joint for joint in arm.joints if joint in group.labels]
    kept = named or list(arm.joints[: group.width])
    if len(kept) == arm.n_joints:
        return arm
    return load_nominal_arm(arm.urdf, joints=kept, gravity=tuple(arm.gravity))


def columns_of_arm(group: ColumnGroup, joints: Sequence[str]) -> list[int] | None:
    """Places in a group, from 0, of the joints of the arm; ``None`` if it has fewer columns.

    By name if the columns carry the names of the joints, in their order otherwise.
    """
    if set(joints) <= set(group.labels):
        return [group.labels.index(joint) for joint in joints]
    return list(range(len(joints))) if group.width >= len(joints) else None


def torque_fits(
    arm: NominalArm, entries: Sequence[dict[str, InspectedTable]], torque: ChannelGuess
) -> list[TorqueFit]:
    """How the nominal arm explains a torque column, gravity in and out, the better first; none if it cannot be asked.

    Args:
        arm: the nominal arm.
        entries: the tables of each recording.
        torque: the columns in question, by the pattern that all recordings share.
    """
    recordings = []
    for entry in entries:
        recording = _recording(arm, entry, torque)
        # a torque that is silent or unsigned is set aside on reading
        if recording is not None and recording.tau is not None:
            recordings.append(recording)
    if not recordings:
        return []
    try:
        return fits_of(arm, recordings)
    except GapscopeError:
        # too short or too coarse to differentiate: nothing can be said
        return []


def _recording(
    arm: NominalArm, entry: dict[str, InspectedTable], torque: ChannelGuess
) -> Recording | None:
    """Positions and one torque column as a recording; ``None`` if they do not stand row by row."""
    main = next(iter(entry.values()))
    position = main.best("q")
    values = _values(entry, torque)
    if position is None or values is None or len(values) != len(main.time.seconds):
        return None
    rows = main.time.seconds <= LONGEST
    columns = {"t": main.time.seconds[rows]}
    factor = UNITS[position.unit]
    for name, group, scale in (
        ("q", position.group, factor),
        ("tau", None, 1.0),
    ):
        series = values if group is None else group.values
        places = columns_of_arm(group or torque.group, arm.joints)
        if places is None:
            return None
        n = len(places)
        read = Columns(tuple(places), (scale,) * n, (0.0,) * n)(series[rows])
        columns |= {f"{name}{j}": x for j, x in enumerate(read.T, start=1)}
    if max(np.abs(column).max(initial=0.0) for column in columns.values()) > BEYOND:
        return None
    try:
        return recording_of_columns(main.label, columns, arm)
    except GapscopeError:
        # cells that are no numbers, or a clock that runs back: the oddities say so
        return None


def _values(
    entry: dict[str, InspectedTable], torque: ChannelGuess
) -> np.ndarray | None:
    """The columns of a torque in one recording, at the rows of its positions."""
    main = next(iter(entry.values()))
    for table in entry.values():
        for guess in table.channels:
            same = guess.group.pattern == torque.group.pattern
            if same and guess.channel == torque.channel:
                return _at_rows_of(main.time, table.time, guess.group.values)
    return None


def _at_rows_of(
    main: TimeGuess, own: TimeGuess, values: np.ndarray
) -> np.ndarray | None:
    """Values at the rows of another table, by its clock if it has other rows; ``None`` without a common clock."""
    if len(values) == len(main.seconds):
        return values
    if not (own.column and main.column):
        return None
    t = main.start + main.seconds
    columns = [np.interp(t, own.start + own.seconds, column) for column in values.T]
    return np.column_stack(columns)
