"""When a statistic is an alarm, and whether it has a name: it has to last, and one hypothesis to stand out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import log

from gapscope.watching.detection.change_test import Candidate, Findings
from gapscope.watching.thresholds import (
    BLOCK,
    CONFIRM,
    NAMED_SHARE,
    ONSETS,
    PATIENCE,
    PERSISTS,
    RIGHT_MOMENT,
    STANDS_OUT,
)


@dataclass(frozen=True)
class Decision:
    """An alarm.

    Attributes:
        named: what it is called, or ``None`` if no name fits.
        strongest: the candidate with the largest evidence since it began.
        onset: blocks after the moment at which it began.
        alternatives: others that are nearly as likely.
    """

    named: Candidate | None
    strongest: Candidate
    onset: int
    alternatives: tuple[Candidate, ...] = ()


def threshold(false_alarms: float, hypotheses: int) -> float:
    """Minus ln of the chance that a test may have [1], by Bonferroni's bound over all tests of a day.

    Args:
        false_alarms: wanted per 24 h of motion at most, if the model had no errors.
        hypotheses: number of them.
    """
    tests = 86_400 / BLOCK * len(ONSETS) * hypotheses
    return log(tests / false_alarms)


def decide(
    findings: Findings, limit: float, blocks: int, suspected: int
) -> Decision | None:
    """The alarm of findings above the threshold, or ``None`` if it is to wait for more blocks.

    A change at a moment is named if it explains at least ``NAMED_SHARE`` of what any change of the parameters would
    there: at a moment too early or too late none does. It has to be likelier than every other name at that moment by
    ``STANDS_OUT``; after ``PATIENCE`` blocks the others become alternatives.

    Args:
        findings: at the end of a block.
        limit: the threshold.
        blocks: for which something has exceeded it.
        suspected: blocks after the latest moment that exceeded it first.
    """
    beyond = findings.beyond(limit)
    if blocks < CONFIRM or not beyond:
        return None
    # a single odd block exceeds the threshold as long as it lies after the moment; a change does so in later blocks too
    if beyond[0].onset > suspected - PERSISTS:
        return None
    best = _best_named(beyond)
    if best is not None:
        rivals = tuple(
            other
            for other in findings.candidates
            if other.change is not None
            and other.onset == best.onset
            and other is not best
            and best.evidence - other.evidence < STANDS_OUT
        )
        if not rivals or blocks >= PATIENCE:
            return Decision(best, best, best.onset, rivals)
    if blocks < PATIENCE:
        return None
    strongest = max(beyond, key=lambda candidate: candidate.evidence)
    return Decision(None, strongest, suspected)


def _best_named(beyond: Sequence[Candidate]) -> Candidate | None:
    """The likeliest named change that explains enough, at a moment at which it explains almost as much as at any."""
    named = [c for c in beyond if c.change is not None and c.share >= NAMED_SHARE]
    if not named:
        return None
    likeliest = max(named, key=lambda candidate: candidate.evidence)
    own = [c for c in named if c.key == likeliest.key]
    largest = max(candidate.share for candidate in own)
    fitting = [c for c in own if c.share >= RIGHT_MOMENT * largest]
    return max(fitting, key=lambda candidate: candidate.evidence)
