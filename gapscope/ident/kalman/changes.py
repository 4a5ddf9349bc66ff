"""Changes during the recordings of a case: a load picked up or put down, friction of a joint that changed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from gapscope.arm.errors import InputError
from gapscope.arm.recording import Recording
from gapscope.ident.kalman.change_hypothesis import (
    PAYLOAD,
    friction_hypothesis,
    payload_hypothesis,
)
from gapscope.ident.kalman.change_point import ParameterChange, find_change
from gapscope.ident.model.base_parameters import BaseParameters
from gapscope.ident.model.friction_law import FrictionLaw
from gapscope.ident.model.linear_problem import Problem
from gapscope.ident.model.model_columns import ModelColumns
from gapscope.ident.signals.samples import Band, Samples
from gapscope.ident.uncertainty.validation import MOVING
from gapscope.model.conditioning import thinned

MOST = 500
"""Samples of a recording among which a change is looked for; 10 s at a cut-off of 12 Hz."""
COLUMN_RATE = 100.0
"""Rate at which the model's columns are computed before they are filtered [Hz]: eight times a cut-off of 12 Hz."""
EDGE = 1.0
"""Time from both ends of a recording in which no change is looked for [s]: a joint that has hardly turned round there
lets any asymmetry of its friction pass for a change."""
PLAIN = 5.0
"""A change is reported if its 2 log L is this many times the threshold of a likely one [1]: models lack effects. On 75
arms of the blind generator, with effects that it lacks, errors feigned changes of up to 4.2; pick-ups of a kilogram and
more were beyond 20."""


@dataclass(frozen=True)
class RecordingChange:
    """A change during a recording.

    Attributes:
        recording: its name.
        change: what changed, when, and by how much.
    """

    recording: str
    change: ParameterChange

    def __str__(self) -> str:
        """What happened, in words."""
        change = self.change
        low, high = change.interval
        when = f"at {change.time:.2f} s ({low:.2f} .. {high:.2f} s) of {self.recording}"
        sizes = [
            f"{size:+.3g} ± {deviation:.2g}"
            for size, deviation in zip(change.size, change.deviation, strict=True)
        ]
        if change.hypothesis.name == PAYLOAD:
            done = "picked up" if change.size[0] > 0 else "put down"
            return f"a load was {done} {when}: {sizes[0]} kg"
        units = {"b": "N m s/rad", "c": "N m"}
        parts = [
            f"{name} {size} {units[name[0]]}"
            for name, size in zip(change.hypothesis.names, sizes, strict=True)
        ]
        return f"{change.hypothesis.name} changed {when}: {', '.join(parts)}"


class RecordingSamples(NamedTuple):
    """What a change is looked for in, of one recording."""

    recording: str
    samples: Samples


def samples_of_each(
    recordings: Sequence[Recording], columns: ModelColumns, band: Band
) -> list[RecordingSamples]:
    """At most about ``MOST`` samples of each recording with a torque.

    Columns are computed at no less than ``COLUMN_RATE``.

    Args:
        recordings: those without a torque are left out.
        columns: the model.
        band: that both sides are compared in.
    """
    found = []
    for recording in recordings:
        segments = [thinned(s, COLUMN_RATE) for s in band.segments([recording])]
        if segments:
            samples = Samples(columns, segments, band.bounded(segments, MOST))
            found.append(RecordingSamples(recording.name, samples))
    return found


def find_changes(
    recordings: Sequence[RecordingSamples], law: FrictionLaw, base: BaseParameters
) -> tuple[RecordingChange, ...]:
    """At most one change in each recording: of a load on the last link, or of a joint's viscous and Coulomb friction.

    Each recording is examined alone, all base parameters unknown (``gapscope.ident.kalman.change_point``).
    Recordings that are too short are skipped.

    Args:
        recordings: the samples of each.
        law: the friction law.
        base: base parameters of the fitted samples.
    """
    return tuple(_each(recordings, law, base))


def _each(
    recordings: Sequence[RecordingSamples], law: FrictionLaw, base: BaseParameters
) -> Iterator[RecordingChange]:
    names = [base.names[k] for k in base.kept]
    constants = [k for k, name in enumerate(base.names) if name.startswith("o")]
    pushes = base.combination[:, constants] if constants else None
    for name, samples in recordings:
        arm, body = samples.columns.arm, samples.columns.body
        hypotheses = [payload_hypothesis(base, body.last_link + 1)]
        hypotheses += [friction_hypothesis(base, j + 1) for j in range(arm.n_joints)]
        problem, times = _moving(samples, samples.problem(law, base.kept, names))
        if not len(times):
            continue
        try:
            change = find_change(problem, times, hypotheses, margin=EDGE, pushes=pushes)
        except InputError:  # too short
            continue
        if change is not None and change.statistic >= PLAIN:
            yield RecordingChange(name, change)


def _moving(samples: Samples, problem: Problem) -> tuple[Problem, np.ndarray]:
    """The samples at which a joint moves, a group for each stretch of them, and their times [s].

    At rest dry friction may take any value, so that coming to rest would pass for a change: the equations of a joint
    that rests are zero, and so are those whose torque was not measured.
    """
    moving = np.abs(samples.velocity) > MOVING * samples.columns.arm.per_radian
    moving &= samples.measured
    kept = np.flatnonzero(moving.any(axis=1))
    problem = replace(
        problem,
        matrix=problem.matrix * moving[..., None],
        torque=problem.torque * moving,
    )
    # a new stretch begins after a rest, and with a new segment
    rested = np.diff(kept) > 1
    new_segment = np.diff(problem.group[kept]) > 0
    first = np.zeros(min(1, len(kept)), dtype=int)
    group = np.concatenate([first, np.cumsum(rested | new_segment)])
    return replace(problem.rows(kept), group=group), samples.times[kept]
