"""The test for a change of parameters at some moment of the last blocks, and which one it is."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from gapscope.ident.kalman.online.before_after import BeforeAfter, HypothesisFit
from gapscope.ident.kalman.online.block import Block, summed
from gapscope.ident.kalman.online.estimate import ParameterState
from gapscope.ident.kalman.tail import log_chance
from gapscope.watching.detection.hypotheses import WatchedChange
from gapscope.watching.detection.scales import Scales
from gapscope.watching.detection.usual import UsualSize
from gapscope.watching.thresholds import GUARD, ONSETS

ANYTHING = "anything"
"""Key of the statistic of a change of any parameters."""


@dataclass(frozen=True)
class Candidate:
    """A change at one moment.

    Attributes:
        change: what; ``None`` for any parameters.
        fit: its size and statistic; ``None`` for any parameters.
        onset: blocks after the moment.
        statistic: 2 log L over its usual size [1].
        freedom: degrees of freedom [1].
        raw: 2 log L [1].
        share: of what any change of the parameters explains at the same moment beyond what is usual, the part that this
            one does [1].
    """

    change: WatchedChange | None
    fit: HypothesisFit | None
    onset: int
    statistic: float
    freedom: float
    raw: float
    share: float

    @property
    def key(self) -> str:
        """Name of the hypothesis, or ``ANYTHING``."""
        return ANYTHING if self.change is None else self.change.hypothesis.name

    @property
    def evidence(self) -> float:
        """Minus ln of the probability of a statistic so large [1]."""
        return log_chance(self.statistic, self.freedom)


@dataclass(frozen=True)
class Findings:
    """All hypotheses at all moments that are tried, at the end of a block."""

    candidates: tuple[Candidate, ...]

    def beyond(self, limit: float) -> list[Candidate]:
        """Those whose evidence exceeds a threshold, the latest moment first."""
        found = [entry for entry in self.candidates if entry.evidence > limit]
        return sorted(found, key=lambda entry: entry.onset)

    def largest(self) -> dict[str, Candidate]:
        """By key, the candidate with the largest statistic over all moments."""
        found: dict[str, Candidate] = {}
        for entry in self.candidates:
            if entry.key not in found or entry.raw > found[entry.key].raw:
                found[entry.key] = entry
        return found


def find_changes(
    base: ParameterState,
    ring: Sequence[Block],
    since: int,
    scales: Scales,
    changes: Sequence[WatchedChange],
    usual: Mapping[str, UsualSize],
) -> Findings | None:
    """All hypotheses at the moments of the last blocks, or ``None`` if there are too few.

    Args:
        base: the filter's estimate before the ring.
        ring: the last blocks, the oldest first.
        since: blocks at its end among which a change may lie.
        scales: of the parameters.
        changes: hypotheses.
        usual: sizes of their statistics so far, by name.
    """
    found: list[Candidate] = []
    for onset in ONSETS:
        if onset + GUARD > min(since, len(ring)):
            break
        compared = _compared(base, ring, onset, scales)
        found += _at_moment(compared, onset, scales, changes, usual)
    return Findings(tuple(found)) if found else None


def _at_moment(
    compared: BeforeAfter,
    onset: int,
    scales: Scales,
    changes: Sequence[WatchedChange],
    usual: Mapping[str, UsualSize],
) -> Iterator[Candidate]:
    """All hypotheses at one moment; statistics are divided, errors widened, by how large they usually are."""
    total, freedom = compared.of_anything(scales.prior)
    factor = usual[ANYTHING].factor(freedom)
    yield Candidate(None, None, onset, total / factor, freedom, total, 1.0)
    # what any change explains without one: chance, and errors of the model as usual
    background = factor * freedom
    for change in changes:
        fit = compared.fit(change.hypothesis)
        factor = usual[change.hypothesis.name].factor(len(fit.size))
        yield Candidate(
            change=change,
            fit=replace(fit, covariance=factor * fit.covariance),
            onset=onset,
            statistic=fit.statistic / factor,
            freedom=float(len(fit.size)),
            raw=fit.statistic,
            share=fit.statistic / max(total - background, fit.statistic, 1e-12),
        )


def _compared(
    base: ParameterState, ring: Sequence[Block], onset: int, scales: Scales
) -> BeforeAfter:
    """What the blocks after a moment say beside the estimate before it."""
    count = len(scales.prior)
    cut = len(ring) - onset
    A, s, _ = summed(ring[: cut - GUARD], count)
    before = base.assimilated(A, s)
    A, s, _ = summed(ring[cut:], count)
    elapsed = sum(block.duration for block in ring)
    allowed = scales.form**2 + scales.walk**2 * elapsed
    return BeforeAfter.of(before, allowed, A, s)
