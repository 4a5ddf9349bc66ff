"""Payload or changed last link: the same body, written in two ways.

With m0, c0 mass and centre of the nominal last link, a change of them by dm and dc and a load of mass m at c are equal
in mass and first moment for

    m = dm,    m c = (m0 + dm) (c0 + dc) - m0 c0

They differ in the moments of inertia that either form assumes, which a real load or link need not have. So the motion
does not tell them apart: which of them it is, is a question of what is common.
"""

from __future__ import annotations

import numpy as np

from gapscope.diagnosis.selection.fitted_model import Model, fit_terms
from gapscope.diagnosis.selection.visibility import closed_between
from gapscope.diagnosis.thresholds import LINK_OVER_PAYLOAD, VISIBLE_EFFECT
from gapscope.effects.effect import LinkChange
from gapscope.model.terms import Term


def prefer_payload(model: Model) -> Model:
    """Take a payload instead of a changed last link, unless no load is the same body or the link is far better.

    No load is the same body if mass is missing. The link is far better if the evidence says so and a person sees it.
    """
    last = model.data.body.last_link + 1
    link = next((t for t in model.fit.terms if t.changes_link(last)), None)
    payload = next((t for t in model.terms.all if t.is_load), None)
    if link is None or payload is None or payload in model.fit.terms:
        return model
    load = _as_load(model, link)
    if load[0] <= 0:
        return model
    others = model.fit.terms - {link}
    # around values of the same body: from nothing a heavy load far out is not found beside another changed link
    starts = {t: model.fit.theta[list(t.columns)] for t in others} | {payload: load}
    loaded = fit_terms(model, others | {payload}, starts)
    if payload not in loaded.fit.terms:
        return model
    far_better = loaded.gain_of(model) > LINK_OVER_PAYLOAD
    if far_better and closed_between(loaded, model) >= VISIBLE_EFFECT:
        return model
    return loaded


def _as_load(model: Model, link: Term) -> np.ndarray:
    """Mass [kg] and first moment [kg m] of the load that is the same body as a changed last link, (4,)."""
    assert isinstance(link.definition, LinkChange)
    own = model.data.body.inertial_parameters().reshape(-1, 10)[link.joint - 1]
    (effect,) = model.terms.effects(model.fit.theta, [link])
    return link.definition.change(own, *effect.parameters.values())[:4]
