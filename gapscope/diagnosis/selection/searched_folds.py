"""What the search looks at of each fold: fewer samples per second, and of long logs blocks spread over them.

The values of effects are settled by minutes of motion: a longer log is looked at all over, but not all of it, so that
its length costs neither time nor memory. What is found is judged on all of it.
"""

from __future__ import annotations

import numpy as np

from gapscope.diagnosis.thresholds import SEARCH_BLOCK, SEARCH_DURATION, SEARCH_RATE
from gapscope.ident.signals.conditioning import Segment, blocks, thinned


def searched_folds(folds: list[list[Segment]]) -> list[list[Segment]]:
    """Segments of each fold, decimated to no less than ``SEARCH_RATE``.

    Folds of more than ``SEARCH_DURATION`` in all are cut into blocks of about ``SEARCH_BLOCK``, of which evenly spaced
    ones are taken, in number of each fold in proportion to its length.
    """
    duration = sum(_seconds(segment) for fold in folds for segment in fold)
    share = SEARCH_DURATION / duration
    if share < 1.0:
        folds = [_spread(fold, share) for fold in folds]
    return [[thinned(s, SEARCH_RATE) for s in fold] for fold in folds]


def _spread(fold: list[Segment], share: float) -> list[Segment]:
    """A share of a fold in blocks spread evenly over it, as many of its first as of its second half."""
    cut = [block for segment in fold for block in _blocks(segment)]
    pairs = max(1, round(share * len(cut) / 2))
    if 2 * pairs >= len(cut):
        return cut
    places = (np.arange(2 * pairs) + 0.5) * len(cut) / (2 * pairs)
    return [cut[place] for place in places.astype(int)]


def _blocks(segment: Segment) -> list[Segment]:
    count = int(_seconds(segment) / SEARCH_BLOCK)
    return blocks(segment, count) if count > 1 else [segment]


def _seconds(segment: Segment) -> float:
    return float(segment.motion.t[-1] - segment.motion.t[0])
