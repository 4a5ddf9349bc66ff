"""From pieces of a recording to events: learns what is normal, then hands every block to the monitor."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from gapscope.effects.corrected import CorrectedArm
from gapscope.ident.kalman.online.block import Equations
from gapscope.model.conditioning import Segment
from gapscope.watching.alarm import NOTE, Event
from gapscope.watching.detection.learning import Moment, learn
from gapscope.watching.detection.monitor import Monitor
from gapscope.watching.detection.watched_arm import WatchedArm
from gapscope.watching.thresholds import (
    BLOCK,
    LEARN,
    LEAST_MOVING,
    LONGEST_REST,
    UNKNOWN_REST,
)


class Detector:
    """Watches an arm, segment by segment.

    Args:
        corrected: the arm with its effects.
        false_alarms: wanted per 24 h of motion at most, if the model had no errors.
        learning: motion from which normal behaviour is learnt [s].
    """

    def __init__(
        self,
        corrected: CorrectedArm,
        false_alarms: float = 0.1,
        learning: float = LEARN,
    ) -> None:
        self.arm = WatchedArm(corrected)
        self.false_alarms = false_alarms
        self._wanted = round(learning / BLOCK)
        self._learning: list[tuple[Moment, Equations, np.ndarray]] = []
        self.monitor: Monitor | None = None
        self.last: Moment | None = None

    @property
    def learnt(self) -> float:
        """Share of the motion to learn from that was seen [1]."""
        return 1.0 if self.monitor else len(self._learning) / self._wanted

    def add(self, segment: Segment) -> Iterator[Event]:
        """Events of a segment with torque, ``BLOCK`` seconds of it when it is trimmed."""
        equations = self.arm.equations(segment)
        if not _moves(equations):
            return
        t = segment.motion.t[segment.inner]
        moment = Moment(segment.recording, float(t[0]), float(t[-1]))
        duration = BLOCK + self._pause(moment)
        self.last = moment
        if self.monitor is not None:
            yield from self.monitor.add(moment, equations, duration)
            return
        self._learning.append((moment, equations, self.arm.friction(segment)))
        if len(self._learning) >= self._wanted:
            yield self._begin()

    def _begin(self) -> Event:
        """End of learning."""
        moments, blocks, friction = zip(*self._learning, strict=True)
        normal, start = learn(self.arm, moments, blocks, friction, BLOCK)
        self.monitor = Monitor.begun(self.arm, normal, start, self.false_alarms)
        self._learning = []
        noise = ", ".join(
            f"J{j} {value:.2g}" if np.isfinite(value) else f"J{j} not watched (rests)"
            for j, value in enumerate(normal.noise, start=1)
        )
        return Event(
            event=NOTE,
            sentence=f"learnt {len(blocks) * BLOCK:.0f} s of motion; what the arm leaves, RMS in N m: {noise}",
            recording=moments[-1].recording,
            detected=moments[-1].end,
        )

    def _pause(self, moment: Moment) -> float:
        """Time in which nothing was seen before a block [s]."""
        if self.last is None:
            return 0.0
        if self.last.recording != moment.recording:
            return UNKNOWN_REST
        pause = moment.start - self.last.end
        return float(np.clip(pause, 0.0, LONGEST_REST))


def _moves(equations: Equations) -> bool:
    """Whether some joint moves for long enough to say something."""
    return bool(equations.moving.mean(axis=0).max() >= LEAST_MOVING)
