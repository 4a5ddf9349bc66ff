"""The verdict as a truth table over all sixteen combinations of its four facts."""

from __future__ import annotations

import itertools

import pytest

from gapscope.diagnosis.document.verdict import verdict

# found, explained, significant, rejected
TABLE = {
    (True, True, True, True): "effects_found",
    (True, True, True, False): "effects_found",
    (True, True, False, True): "effects_found",
    (True, True, False, False): "effects_found",
    (True, False, True, True): "unexplained",
    (True, False, True, False): "unexplained",
    (True, False, False, True): "effects_found",
    (True, False, False, False): "effects_found",
    (False, True, True, True): "unexplained",
    (False, True, True, False): "unexplained",
    (False, True, False, True): "unexplained",
    (False, True, False, False): "no_gap",
    (False, False, True, True): "unexplained",
    (False, False, True, False): "unexplained",
    (False, False, False, True): "unexplained",
    (False, False, False, False): "no_gap",
}


def test_the_table_is_complete() -> None:
    assert set(TABLE) == set(itertools.product((True, False), repeat=4))


@pytest.mark.parametrize(("facts", "expected"), TABLE.items())
def test_verdict(facts: tuple[bool, bool, bool, bool], expected: str) -> None:
    found, explained, significant, rejected = facts
    assert (
        verdict(
            found=found,
            explained=explained,
            significant=significant,
            rejected=rejected,
        )
        == expected
    )
