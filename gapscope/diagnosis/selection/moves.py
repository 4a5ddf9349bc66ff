"""Moves of the search: sets of terms one step away from another."""

from __future__ import annotations

from gapscope.diagnosis.model.terms import Term, Terms
from gapscope.effects.catalogue import explained


def contests() -> list[tuple[str, str]]:
    """Pairs of effects that are equal to first order, the more common one first."""
    return [(e.near_equivalent, e.name) for e in explained() if e.near_equivalent]


def neighbours(chosen: frozenset[Term], terms: Terms) -> list[frozenset[Term]]:
    """Sets one move away: a term or an effect removed, a term swapped on its joint, an effect renamed.

    Joints that ring or play stay: a model around their values says nothing of their absence.
    """
    settled = {t for t in chosen if t.definition.locally_linear}
    moves = [chosen - {t} for t in settled]
    of_joints = {t.effect for t in terms.open if t.definition.scope == "joint"}
    for name in {t.effect for t in settled}:
        mine = frozenset(t for t in chosen if t.effect == name)
        moves.append(chosen - mine)
        joints = {t.joint for t in mine}
        for other in (
            of_joints - {t.effect for t in chosen} - {near_equivalent(t) for t in mine}
        ):
            moves.append(
                (chosen - mine)
                | {t for t in terms.open if t.effect == other and t.joint in joints}
            )
    for term in settled:
        rivals = [
            t
            for t in terms.open
            if t not in chosen
            and t.joint in (term.joint, 0)
            and t.effect != near_equivalent(term)
        ]
        moves += [(chosen - {term}) | {rival} for rival in rivals]
        if term.joint == 0:
            moves += [(chosen - {term}) | {t} for t in terms.of("link_inertia")]
    return list(dict.fromkeys(moves))


def clashes(term: Term, chosen: frozenset[Term], terms: Terms) -> bool:
    """Whether a term is chosen already, or one that says the same of the same joint."""
    return term in chosen or any(
        t.effect == near_equivalent(term) and t.joint == term.joint for t in chosen
    )


def near_equivalent(term: Term) -> str | None:
    """The effect that looks like a term's to first order, with which it is contested."""
    return next(
        (b if term.effect == a else a for a, b in contests() if term.effect in (a, b)),
        None,
    )


def by_finding(terms: frozenset[Term]) -> list[frozenset[Term]]:
    """The terms of each finding."""
    return [
        frozenset(t for t in terms if t.finding == name)
        for name in sorted({t.finding for t in terms})
    ]


def by_term(terms: frozenset[Term]) -> list[frozenset[Term]]:
    """Each term on its own."""
    return [frozenset({t}) for t in sorted(terms, key=lambda t: (t.effect, t.joint))]
