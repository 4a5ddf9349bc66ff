"""Moves of the search: sets of terms one step away from another."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain

from gapscope.effects.catalogue import explained
from gapscope.model.terms import Term, Terms


def neighbours(chosen: frozenset[Term], terms: Terms) -> list[frozenset[Term]]:
    """Sets one move away: a term or an effect removed, a term swapped on its joint, an effect renamed.

    Compliant joints stay: a local linearisation cannot test their removal.
    """
    movable = [t for t in terms.all if t in chosen and t.definition.locally_linear]
    moves = chain(
        _without_one_term(chosen, movable),
        _without_one_effect(chosen, movable),
        _with_an_effect_renamed(chosen, movable, terms),
        _with_a_term_swapped(chosen, movable, terms),
    )
    return list(dict.fromkeys(moves))


def _without_one_term(
    chosen: frozenset[Term], movable: list[Term]
) -> Iterator[frozenset[Term]]:
    for term in movable:
        yield chosen - {term}


def _without_one_effect(
    chosen: frozenset[Term], movable: list[Term]
) -> Iterator[frozenset[Term]]:
    for effect in _effects(movable):
        yield frozenset(t for t in chosen if t.effect != effect)


def _with_an_effect_renamed(
    chosen: frozenset[Term], movable: list[Term], terms: Terms
) -> Iterator[frozenset[Term]]:
    """Another effect on the joints of one that is chosen; not its near-equivalent, which is compared at the end."""
    available = [t for t in terms.open if t.definition.scope == "joint"]
    named = {t.effect for t in chosen}
    for effect in _effects(movable):
        rest = frozenset(t for t in chosen if t.effect != effect)
        joints = {t.joint for t in chosen - rest}
        for other in _effects(available):
            if other in named or other == near_equivalent(effect):
                continue
            yield rest | {
                t for t in available if t.effect == other and t.joint in joints
            }


def _with_a_term_swapped(
    chosen: frozenset[Term], movable: list[Term], terms: Terms
) -> Iterator[frozenset[Term]]:
    """Another term on the same joint or on the arm; instead of a term on the arm also a changed link."""
    for term in movable:
        for other in terms.open:
            if other in chosen or other.effect == near_equivalent(term.effect):
                continue
            if other.joint in (term.joint, 0):
                yield (chosen - {term}) | {other}
        if term.joint == 0:
            for link in terms.all:
                if link.definition.scope == "link":
                    yield (chosen - {term}) | {link}


def _effects(terms: list[Term]) -> list[str]:
    """Names of the effects of some terms, in their order."""
    return list(dict.fromkeys(t.effect for t in terms))


def near_equivalent_pairs() -> list[tuple[str, str]]:
    """Pairs of effects that are equal to first order, the more common one first."""
    return [(e.near_equivalent, e.name) for e in explained() if e.near_equivalent]


def near_equivalent(effect: str) -> str | None:
    """The effect that looks like another one to first order."""
    for common, rare in near_equivalent_pairs():
        if effect == common:
            return rare
        if effect == rare:
            return common
    return None


def clashes(term: Term, chosen: frozenset[Term]) -> bool:
    """Whether a term is chosen already, or its near-equivalent on the same joint."""
    if term in chosen:
        return True
    other = near_equivalent(term.effect)
    return any(t.effect == other and t.joint == term.joint for t in chosen)


def consistent(terms: frozenset[Term]) -> bool:
    """Whether no two of the terms are near-equivalents on one joint."""
    return not any(clashes(term, terms - {term}) for term in terms)


def by_finding(terms: frozenset[Term]) -> list[frozenset[Term]]:
    """The terms of each finding."""
    names = sorted({t.finding for t in terms})
    return [frozenset(t for t in terms if t.finding == name) for name in names]


def by_term(terms: frozenset[Term]) -> list[frozenset[Term]]:
    """Each term on its own."""
    return [frozenset({t}) for t in sorted(terms, key=lambda t: (t.effect, t.joint))]
