"""The search ends, whatever it tries."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from gapscope.diagnosis.selection import search


def model(*terms: str) -> Any:
    return SimpleNamespace(fit=SimpleNamespace(terms=frozenset(terms)))


def test_it_ends_when_refining_takes_out_again_what_a_pair_added(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Seen on a healthy arm against its reference: the same pair was added and taken out for ever."""
    start = model()
    monkeypatch.setattr(search, "add_compliant_joint", lambda *_: None)
    monkeypatch.setattr(search, "add_pair", lambda *_: model("load_friction"))
    monkeypatch.setattr(search, "add_groups", lambda *_: (start, ()))
    assert search.add_terms(start, lambda words: None) == (start, ())
