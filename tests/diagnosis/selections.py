"""Hand-made results of a search: an evidence of tables in place of one of normal equations."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import numpy as np

from gapscope.diagnosis.selection.fitted_model import Selection
from gapscope.model.terms import Term, Terms

JOINTS = 2
TERMS = Terms(JOINTS)
"""The terms of an arm with two joints."""
DATA_SHEET_ARM = SimpleNamespace(
    arm=SimpleNamespace(n_joints=JOINTS), data=SimpleNamespace(reference=None)
)
Sets = Callable[[frozenset[Term]], Any]


def term(effect: str, joint: int = 0) -> Term:
    """The term of an effect on a joint, or on the arm."""
    return next(t for t in TERMS.of(effect) if t.joint == joint)


@dataclass(frozen=True)
class TableFit:
    """What is read of a fit."""

    terms: frozenset[Term]
    score: float = 0.0
    theta: np.ndarray = field(default_factory=lambda: np.zeros(TERMS.size))
    scored_mse: np.ndarray = field(default_factory=lambda: np.ones((1, JOINTS)))


@dataclass(frozen=True)
class TableEvidence:
    """Evidence whose answers are given, F folds of two joints.

    Attributes:
        score: of a set of terms [nats].
        mse: held-out mean square of a set of terms, (F, n).
        rows: weight of the rows, (F, n).
        floor2: mean square of a healthy arm, (F, n).
        inertial_error: relative error of the nominal inertials.
        samples: independent samples of each joint.
        expected2: mean square that a healthy arm leaves of every model, (F, n).
        linear: the arm, compared with its data sheet.
    """

    score: Sets = lambda terms: 0.0
    mse: Sets = lambda terms: np.ones((1, JOINTS))
    rows: np.ndarray = field(default_factory=lambda: np.ones((1, JOINTS)))
    floor2: np.ndarray = field(default_factory=lambda: np.ones((1, JOINTS)))
    expected2: np.ndarray = field(default_factory=lambda: np.ones((1, JOINTS)))
    terms: Terms = TERMS
    inertial_error: float = 0.01
    samples: float = 1e3
    linear: Any = field(default_factory=lambda: DATA_SHEET_ARM)

    @property
    def scored(self) -> Any:
        """Rows that are scored: one fold of two joints."""
        return SimpleNamespace(independent=np.full((1, JOINTS), self.samples))

    def fit(self, terms: frozenset[Term]) -> TableFit:
        """A fit with the given score."""
        return TableFit(terms, self.score(terms))

    fit_possible = fit

    def held_out_mse(
        self, terms: frozenset[Term], *, corrected: bool = True
    ) -> np.ndarray:
        """The given mean squares."""
        return np.asarray(self.mse(terms))

    def mse_plausible_inertials(self, terms: frozenset[Term]) -> np.ndarray:
        """The same: all errors of the arm are likely."""
        return self.held_out_mse(terms)


def selection(
    *terms: Term,
    evidence: Any = None,
    competing: Mapping[frozenset[Term], float] | None = None,
    nominal_mse: np.ndarray | None = None,
    scale: float = 1.0,
) -> Selection:
    """A search that ended with some terms."""
    evidence = evidence or TableEvidence()
    return Selection(
        scale=np.full(JOINTS, scale),
        fit=evidence.fit(frozenset(terms)),
        evidence=evidence,
        nominal_mse=np.ones((1, JOINTS)) if nominal_mse is None else nominal_mse,
        last_link=JOINTS,
        presliding=np.zeros(JOINTS),
        competing=competing or {},
    )
