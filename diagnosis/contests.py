"""Contests: effects that look alike to first order, each judged around its own values."""

from __future__ import annotations

import numpy as np

from diagnosis.evidence import Evidence, Fit
from diagnosis.moves import CONTESTS
from diagnosis.state import State, nrmse

RARE = 20.0
"""Evidence by which a change of the last link has to beat a payload [nats]."""
RINGING = ("joint_elasticity", "backlash")
"""Effects that make a joint ring."""
DECISIVE = 8.0
"""Evidence that decides between effects that look alike [nats]..."""
DECISIVE_NRMSE = 0.002
"""...if the unseen torque NRMSE of some joint differs by this much, more than the form of the model explains."""


def contest(state: State) -> None:
    """Give effects that look alike to first order the place of each other, each around its own values.

    The second of a pair is named only where it is decisively better; where neither is, both stay open.
    """
    for first, second in CONTESTS:
        held = {t.effect for t in state.fit.terms} & {first, second}
        if len(held) != 1:
            continue
        chosen = held.pop()
        joints = {t.joint for t in state.fit.terms if t.effect == chosen}
        states = {chosen: (state.linear, state.evidences, state.fit)}
        other = second if chosen == first else first
        rest = frozenset(t for t in state.fit.terms if t.effect != chosen)
        state.accept(rest | {t for t in state.terms.open if t.effect == other and t.joint in joints})
        states[other] = (state.linear, state.evidences, state.fit)
        gain = _gain(states[first][1][0], states[first][2], states[second][1][0], states[second][2])
        left = {name: nrmse(known[1][0], known[2].unseen, state.scale) for name, known in states.items()}
        decisive = abs(gain) > DECISIVE and np.abs(left[second] - left[first]).max() > DECISIVE_NRMSE
        winner, loser = (second, first) if decisive and gain > 0 else (first, second)
        state.contested[winner, loser] = -abs(gain) if decisive else -1.0
        state.linear, state.evidences, state.fit = states[winner]


def prefer_payload(state: State) -> None:
    """Take a payload in the place of a changed last link, unless the link is far better: loads are common."""
    last = state.data.body.last_link + 1
    link = frozenset(t for t in state.fit.terms if t.effect == "link_inertia" and t.joint == last)
    payload = frozenset(state.terms.of("payload"))
    if not link or payload & state.fit.terms:
        return
    before = state.linear, state.evidences, state.fit
    state.accept((state.fit.terms - link) | payload)
    gain = _gain(state.evidence, state.fit, before[1][0], before[2])
    state.contested["payload", "link_inertia"] = min(gain - RARE, 0.0)
    if gain > RARE:
        state.linear, state.evidences, state.fit = before


def doubt(state: State) -> None:
    """Try the model without each joint that bends or plays, around its own values.

    A joint that rings is so far from linear in its stiffness that the model around it says nothing of its absence.
    """
    for term in sorted((t for t in state.fit.terms if t.effect in RINGING), key=lambda t: (t.effect, t.joint)):
        if term not in state.fit.terms:
            continue
        before = state.linear, state.evidences, state.fit
        state.accept(state.fit.terms - {term})
        if _gain(before[1][0], before[2], state.evidence, state.fit) < 0:
            state.linear, state.evidences, state.fit = before


def _gain(one: Evidence, fitted: Fit, other: Evidence, rival: Fit) -> float:
    """Evidence of a rival less that of a fit, each around its own values, by the same floors and samples [nats]."""
    samples = 0.5 * (one.told.independent + other.told.independent)
    floor2 = 0.5 * (one.told.floor2 + other.told.floor2)
    missed = (np.log1p(f.missed / floor2) for f in (fitted, rival))
    mine, its = (float((samples * log).sum()) for log in missed)
    return 0.5 * (mine - its) - other.charge(rival.terms) + one.charge(fitted.terms)
