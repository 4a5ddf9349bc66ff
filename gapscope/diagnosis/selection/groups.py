"""Groups: for each effect the joints, or the link, to add it on."""

from __future__ import annotations

from gapscope.diagnosis.selection.evidence import Fit
from gapscope.diagnosis.selection.fitted_model import Model
from gapscope.diagnosis.selection.moves import clashes
from gapscope.effects.effect import Effect


def best_groups(model: Model) -> list[Fit]:
    """For each effect that can be added, the model with it on its best group of joints."""
    groups = (_best_group(model, effect) for effect in model.terms.definitions)
    return [group for group in groups if group is not None]


def _best_group(model: Model, effect: Effect) -> Fit | None:
    """The best group of joints for one effect; joints are added in the order of their own gain, links one at a time."""
    evidence, chosen = model.evidence, model.fit.terms
    singles = [
        evidence.fit(chosen | {term})
        for term in model.terms.open
        if term.effect == effect.name and not clashes(term, chosen)
    ]
    if not singles:
        return None
    singles.sort(key=lambda fit: -fit.score)
    if effect.scope != "joint":
        return model.best(singles[0].terms)
    group = model.fit
    for single in singles:
        extended = evidence.fit(group.terms | single.terms)
        if extended.score > group.score:
            group = extended
    # an effect that helps on no joint may still be half of a pair
    return model.best(singles[0].terms if group is model.fit else group.terms)
