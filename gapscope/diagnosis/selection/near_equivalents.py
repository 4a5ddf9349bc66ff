"""Contests: effects that look alike to first order, each judged around its own values."""

from __future__ import annotations

import numpy as np

from gapscope.diagnosis.selection.delay_or_lag import DELAY, lag_over_delay
from gapscope.diagnosis.selection.moves import contests
from gapscope.diagnosis.selection.state import State, nrmse
from gapscope.diagnosis.thresholds import (
    DECISIVE_EVIDENCE,
    DECISIVE_NRMSE,
    LINK_OVER_PAYLOAD,
    VISIBLE_EFFECT,
)


def compare_near_equivalents(state: State) -> None:
    """Give effects that look alike to first order the place of each other, each around its own values.

    The second of a pair is named only where it is decisively better; where neither is, both stay open.
    """
    for first, second in contests():
        held = {t.effect for t in state.fit.terms} & {first, second}
        if len(held) != 1:
            continue
        chosen = held.pop()
        joints = {t.joint for t in state.fit.terms if t.effect == chosen}
        states = {chosen: state.model}
        other = second if chosen == first else first
        rest = frozenset(t for t in state.fit.terms if t.effect != chosen)
        state.fit_terms(
            rest
            | {t for t in state.terms.open if t.effect == other and t.joint in joints}
        )
        states[other] = state.model
        # the two can be told apart by their second order in time, which needs no threshold
        gained = lag_over_delay(state, states[first]) if first == DELAY else None
        if gained is not None:
            winner, loser = (second, first) if gained > 0 else (first, second)
            state.contested[winner, loser] = -abs(gained)
            state.model = states[winner]
            continue
        gained = states[first].gain(states[second])
        left = {
            name: nrmse(known.evidences[0], known.fit.held_out_mse, state.scale)
            for name, known in states.items()
        }
        decisive = (
            abs(gained) > DECISIVE_EVIDENCE
            and np.abs(left[second] - left[first]).max() > DECISIVE_NRMSE
        )
        winner, loser = (second, first) if decisive and gained > 0 else (first, second)
        state.contested[winner, loser] = -abs(gained) if decisive else -1.0
        state.model = states[winner]


def prefer_payload(state: State) -> None:
    """Take a payload in the place of a changed last link, unless the link is far better: loads are common."""
    last = state.data.body.last_link + 1
    link = frozenset(
        t for t in state.fit.terms if t.effect == "link_inertia" and t.joint == last
    )
    payload = frozenset(state.terms.of("payload"))
    if not link or payload & state.fit.terms:
        return
    before = state.model
    state.fit_terms((state.fit.terms - link) | payload)
    gained = state.model.gain(before)
    state.contested["payload", "link_inertia"] = min(gained - LINK_OVER_PAYLOAD, 0.0)
    if gained > LINK_OVER_PAYLOAD:
        state.model = before


def drop_unneeded_compliance(state: State) -> None:
    """Try the model without each joint that bends or plays, around its own values; keep those that a person can see."""
    for term in sorted(
        (t for t in state.fit.terms if not t.definition.locally_linear),
        key=lambda t: (t.effect, t.joint),
    ):
        if term not in state.fit.terms:
            continue
        before = state.model
        state.fit_terms(state.fit.terms - {term})
        gained, without = before.gain(state.model), state.model
        state.model = before
        if gained > 0 or state.closed(without) < VISIBLE_EFFECT:
            state.model = without
        else:
            known = state.contested.get((term.effect, "none"), 0.0)
            state.contested[term.effect, "none"] = min(gained, known)
