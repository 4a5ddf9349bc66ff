"""The watch of an arm whose normal behaviour is known: every block is tested, then the filter goes on."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from gapscope.ident.kalman.online.block import Block, Equations, summed
from gapscope.ident.kalman.online.estimate import ParameterState
from gapscope.watching.alarm import Event
from gapscope.watching.detection.change_test import ANYTHING, Findings, find_changes
from gapscope.watching.detection.decision import Decision, decide, threshold
from gapscope.watching.detection.hypotheses import watched_changes
from gapscope.watching.detection.learning import Moment, Normal
from gapscope.watching.detection.noise_rise import NoiseRise
from gapscope.watching.detection.slow_drift import SlowDrift
from gapscope.watching.detection.usual import UsualSize
from gapscope.watching.detection.watched_arm import WatchedArm
from gapscope.watching.detection.wording import (
    drift_note,
    is_sure,
    misfit,
    named_alarm,
    noise_alarm,
    sizes_of,
)
from gapscope.watching.thresholds import GUARD, ONSETS, USUAL_DELAY, USUAL_LEAST

RING = ONSETS[-1] + GUARD + 1
"""Blocks that are kept."""


@dataclass
class MonitorState:
    """All that a monitor remembers, of p parameters and n joints.

    Attributes:
        normal: what is normal for the arm.
        base: the filter's estimate before the ring.
        rise: noise that rises.
        drift: friction that drifts.
        ring: the last blocks, ``RING`` at most.
        since: blocks at its end among which a change may lie.
        beyond: blocks in a row in which something exceeded the threshold.
        suspected: blocks after the moment that exceeded it first.
        usual: sizes of the statistics so far, by hypothesis.
        pending: statistics that are too recent to be called usual, (statistic, degrees of freedom) by hypothesis.
    """

    normal: Normal
    base: ParameterState
    rise: NoiseRise
    drift: SlowDrift
    ring: list[Block] = field(default_factory=list)
    since: int = 0
    beyond: int = 0
    suspected: int = 0
    usual: dict[str, UsualSize] = field(default_factory=dict)
    pending: deque[Mapping[str, tuple[float, float]]] = field(default_factory=deque)


class Monitor:
    """Tests block by block.

    Args:
        arm: that is watched.
        state: what is remembered; the monitor changes it.
        false_alarms: wanted per 24 h of motion at most.
    """

    def __init__(
        self, arm: WatchedArm, state: MonitorState, false_alarms: float
    ) -> None:
        self.arm, self.state = arm, state
        self.changes = watched_changes(arm)
        self.limit = threshold(false_alarms, len(self.changes) + 1)
        for key in self._keys:
            state.usual.setdefault(key, UsualSize())

    @property
    def _keys(self) -> tuple[str, ...]:
        """Names of the statistics."""
        return (ANYTHING, *(change.hypothesis.name for change in self.changes))

    @classmethod
    def begun(
        cls,
        arm: WatchedArm,
        normal: Normal,
        start: ParameterState,
        false_alarms: float,
    ) -> Monitor:
        """After learning."""
        places = np.stack([arm.places("b"), arm.places("c")], axis=1)
        n = arm.arm.n_joints
        drift = SlowDrift(places, start.value[places], np.zeros(n))
        state = MonitorState(normal, start, NoiseRise.of(n), drift)
        return cls(arm, state, false_alarms)

    def add(
        self, moment: Moment, equations: Equations, duration: float
    ) -> Iterator[Event]:
        """Events of a block in which some joint moves, which counts for a duration [s]."""
        state = self.state
        block, power = state.normal.reduced(moment, equations, duration)
        state.ring.append(block)
        state.since += 1
        self._advance()
        yield from self._tested()
        noisy = state.rise.add(power)
        if noisy:
            yield self._noise_alarm(noisy)

    def _advance(self) -> None:
        """Hand the oldest block of a full ring over to the filter."""
        state = self.state
        while len(state.ring) > RING:
            oldest = state.ring.pop(0)
            walk = state.normal.scales.walk
            wandered = state.base.wandered(walk, oldest.duration)
            state.base = wandered.assimilated(oldest.information, oldest.score)
        state.since = min(state.since, len(state.ring))

    def _tested(self) -> Iterator[Event]:
        """Events of the test for a change of parameters."""
        state = self.state
        findings = find_changes(
            state.base,
            state.ring,
            state.since,
            state.normal.scales,
            self.changes,
            state.usual,
        )
        if findings is None:
            return
        # nothing is an alarm before it is known how large a statistic usually is
        known = len(state.usual[ANYTHING].values) >= USUAL_LEAST
        self._count(findings)
        decision = None
        if known:
            decision = decide(findings, self.limit, state.beyond, state.suspected)
            decision = self._with_a_sure_name(decision)
        if decision is not None:
            yield self._found(decision)
            self._restart(decision)
            return
        if not known or not state.beyond:
            self._remember(findings)
        if not state.beyond:
            for joint, size, share in state.drift.look(state.base, state.normal.scales):
                yield drift_note(joint, size, share, _moment(state.ring[-1]))

    def _count(self, findings: Findings) -> None:
        """Count the blocks in a row in which something exceeded the threshold, and those since it began."""
        state = self.state
        beyond = findings.beyond(self.limit)
        if not beyond:
            state.beyond = 0
            return
        state.suspected = state.suspected + 1 if state.beyond else beyond[0].onset
        state.suspected = min(state.suspected, len(state.ring) - GUARD)
        state.beyond += 1

    def _remember(self, findings: Findings) -> None:
        """Count statistics as usual once no alarm followed them for a while."""
        pending = self.state.pending
        largest = findings.largest()
        pending.append({key: (c.raw, c.freedom) for key, c in largest.items()})
        while len(pending) > USUAL_DELAY:
            for key, (statistic, freedom) in pending.popleft().items():
                self.state.usual[key].add(statistic, freedom)

    def _with_a_sure_name(self, decision: Decision | None) -> Decision | None:
        """The decision without its name if the size of what is named may as well be zero."""
        if decision is None or decision.named is None:
            return decision
        if is_sure(sizes_of(decision.named, self.arm, self.state.normal)):
            return decision
        return replace(decision, named=None, alternatives=())

    def _found(self, decision: Decision) -> Event:
        """The alarm of a named change, or else a misfit."""
        ring = self.state.ring
        cut = len(ring) - decision.onset
        low = max(cut - GUARD - 1, 0)
        when = _moment(ring[low]), _moment(ring[cut]), _moment(ring[-1])
        strongest = decision.strongest
        evidence = {
            "ln_chance": -strongest.evidence,
            "ln_chance_limit": -self.limit,
            "statistic": strongest.statistic,
            "degrees_of_freedom": strongest.freedom,
            "share_explained": min(strongest.share, 1.0),
        }
        named = decision.named
        if named is None:
            return misfit(when, evidence)
        sizes = sizes_of(named, self.arm, self.state.normal)
        return named_alarm(named, sizes, when, evidence, decision.alternatives)

    def _restart(self, decision: Decision) -> None:
        """Go on from the estimate before the change, with the change, and the blocks after it."""
        state, prior = self.state, self.state.normal.scales.prior
        older = state.ring[: -decision.onset - GUARD]
        A, s, _ = summed(older, len(prior))
        before = state.base.assimilated(A, s)
        # what changed is learnt anew: anything, or the parameters of the change
        D, size = np.eye(len(prior)), np.zeros_like(prior)
        fit = None if decision.named is None else decision.named.fit
        if fit is not None:
            D, size = fit.hypothesis.directions, fit.size
            added = D @ size
            state.drift.reference = state.drift.reference + added[state.drift.places]
        else:
            # what the parameters cannot express stays: how large statistics are now is learnt before the next alarm
            state.usual = {key: UsualSize() for key in self._keys}
        state.base = before.changed(D, size, np.diag(D.T**2 @ prior**2))
        state.ring = state.ring[-decision.onset :]
        state.since, state.beyond = 0, 0
        state.pending.clear()

    def _noise_alarm(self, joints: Iterable[int]) -> Event:
        """The alarm of noise that has risen, which is normal from now on."""
        state = self.state
        own = tuple(joints)
        growth = state.rise.growth()
        blocks = int(max(state.rise.blocks[j - 1] for j in own))
        ring = state.ring
        first = max(len(ring) - blocks, 0)
        when = _moment(ring[max(first - 1, 0)]), _moment(ring[first]), _moment(ring[-1])
        noise = state.normal.noise.copy()
        parts = []
        for joint in own:
            old, place = noise[joint - 1], joint - 1
            noise[place] = old * growth[place]
            parts.append(
                f"joint {joint} leaves {growth[place]:.1f} times its usual torque"
            )
        state.normal = replace(state.normal, noise=noise)
        state.rise = NoiseRise.of(len(noise))
        evidence = {f"growth_{joint}": float(growth[joint - 1]) for joint in own}
        return noise_alarm(own, ", ".join(parts), when, evidence)


def _moment(block: Block) -> Moment:
    return Moment(block.recording, block.start, block.end)
