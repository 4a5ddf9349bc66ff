"""Groups: for each effect the joints, or the link, to add it on."""

from __future__ import annotations

from gapscope.diagnosis.selection.evidence import Fit
from gapscope.diagnosis.selection.fitted_model import Model
from gapscope.diagnosis.selection.moves import clashes
from gapscope.effects.effect import Effect


def best_groups(model: Model) -> list[Fit]:
    """For each effect that can be added, the model with it on its best group of joints."""
    chosen = model.fit.terms
    added = [term for term in model.terms.open if not clashes(term, chosen)]
    fits = model.evidence.fits([chosen | {term} for term in added])
    groups = []
    for effect in model.terms.definitions:
        pairs = zip(added, fits, strict=True)
        singles = [fit for term, fit in pairs if term.effect == effect.name]
        if singles:
            groups.append(_best_group(model, effect, singles))
    return groups


def _best_group(model: Model, effect: Effect, singles: list[Fit]) -> Fit:
    """The best group of joints for one effect, from the fits of the model with it on one joint, or link, each.

    Joints are added in the order of their own gain, links one at a time.
    """
    evidence = model.evidence
    singles = sorted(singles, key=lambda fit: -fit.score)
    if effect.scope != "joint":
        return model.best(singles[0].terms)
    group = model.fit
    for single in singles:
        extended = evidence.fit(group.terms | single.terms)
        if extended.score > group.score:
            group = extended
    # an effect that helps on no joint may still be half of a pair
    return model.best(singles[0].terms if group is model.fit else group.terms)
