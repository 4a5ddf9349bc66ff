"""Findings of a case whose recordings do not share a state: what holds where."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from gapscope.diagnosis.agreement.agreement import DIFFERS, Agreement
from gapscope.diagnosis.agreement.states import OtherState, States
from gapscope.diagnosis.document.entries import numbers
from gapscope.effects.applied import AppliedEffect
from gapscope.model.terms import Terms
from gapscope.model.torque_gap import torque_scale

Finding = dict[str, Any]


def with_states(
    findings: Sequence[Finding],
    states: States,
    terms: Terms,
    theta: np.ndarray,
) -> list[Finding]:
    """Findings with the recordings in which they hold, and what other recordings have in their place.

    Args:
        findings: of the recordings in the first state.
        states: of all recordings.
        terms: terms.
        theta: coordinates of the effects found, (P,).
    """
    found, others = states.found, states.others
    if found is None or not others:
        return list(findings)
    differing = {term.effect for state in others for term in state.increments}
    here = [found.recordings[k].name for k in found.states[0]]
    out = [
        {**f, "recordings": here, "elsewhere": []} if f["effect"] in differing else f
        for f in findings
    ]
    for state in others:
        there = state.theta(terms, theta)
        for applied in terms.effects(there):
            if applied.name not in differing:
                continue
            place = {
                "recordings": list(state.place.recordings),
                "joints": list(applied.joints),
                "parameters": _parameters(applied, state, terms, there),
            }
            twins = [f for f in out if f["effect"] == applied.name]
            if twins:
                twins[0].setdefault("elsewhere", []).append(place)
            else:
                out.append(
                    {**_evidence(applied, state, found), **place, "elsewhere": []}
                )
    return sorted(out, key=lambda finding: -finding["share"])


def _parameters(
    applied: AppliedEffect, state: OtherState, terms: Terms, theta: np.ndarray
) -> dict[str, Any]:
    """Values at a place, and their deviations as far as they follow from what differs there."""
    variances = {name: np.zeros(x.shape) for name, x in applied.parameters.items()}
    mine = [t for t in terms.of(applied.name) if theta[list(t.columns)].any()]
    for term in mine:
        if term not in state.increments:
            continue
        for column, deviation in zip(
            term.columns, state.increments[term].deviation, strict=True
        ):
            step = np.zeros(len(theta))
            step[column] = deviation
            (more,) = terms.effects(terms.clipped(theta + step), mine)
            (less,) = terms.effects(terms.clipped(theta - step), mine)
            for name, variance in variances.items():
                half = (more.parameters[name] - less.parameters[name]) / 2
                variances[name] = variance + half**2
    return {
        parameter.name: {
            "unit": parameter.unit,
            "value": applied.parameters[parameter.name].tolist(),
            "std": np.sqrt(variances[parameter.name]).tolist(),
        }
        for parameter in applied.effect.parameters
    }


def _evidence(applied: AppliedEffect, state: OtherState, found: Agreement) -> Finding:
    """Probability and gaps of an effect that the first state has not, in a recording that has it."""
    assert found.found is not None
    fit, name = found.found.fit, state.place.recordings[0]
    number = next(k for k, r in enumerate(found.recordings) if r.name == name)
    rows = fit.contrast.design.rows
    mine = rows.of(number)
    left = fit.left[mine] * rows.scale
    every = state.increments.items()
    whole = left + sum(x.torque for _, x in every)
    this = sum(x.torque for term, x in every if term.effect == applied.name)

    def nrmse(gap: np.ndarray) -> np.ndarray:
        return np.sqrt((gap**2).mean(axis=0)) / torque_scale(rows.torque[mine])

    # of what it closes first and last, the mean (Shapley of two orders)
    before, after = nrmse(whole), nrmse(left)
    only, without = nrmse(whole - this), nrmse(left + this)
    closed = np.array([(before - only).sum(), (without - after).sum()])
    share = np.clip(closed / max(float(before.sum()), 1e-9), 0.0, 1.0)
    differing = [
        line
        for line in found.having(DIFFERS)
        if line.quantity.term.effect == applied.name
    ]
    return {
        "effect": applied.name,
        "probability": max(1.0 - (line.p or 0.0) for line in differing),
        "gap_with_only_this": {"torque_nrmse": numbers(only)},
        "gap_without_this": {"torque_nrmse": numbers(without)},
        "share": float(share.mean()),
        "share_interval": numbers(np.sort(share)),
        "where": [],
        "alternatives": [],
    }
