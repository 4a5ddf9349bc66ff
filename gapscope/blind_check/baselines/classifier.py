"""A classifier of effects from features of the gap: a network with one hidden layer, trained on separate cases."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from gapscope.arm.errors import GapscopeError
from gapscope.blind_check.baselines.columns import EFFECTS, Design
from gapscope.blind_check.baselines.methods import answer, residual_share

PENALTY = 1e-2
"""Weight of the squared coefficients beside the mean log-likelihood."""
HIDDEN = 32
"""Hidden units."""
MOST_ITERATIONS = 500
"""Iterations of the fit."""


def features(design: Design) -> np.ndarray:
    """Residual share of each effect alone, its best joint's correlation; size and concentration of the gap."""
    residual = [residual_share(design, effect) for effect in EFFECTS]
    along = np.abs(design.columns.T @ design.gap) / np.linalg.norm(design.gap)
    best = []
    for effect in EFFECTS:
        places = design.places(effect)
        best.append(float(along[places].max()) if places else 0.0)
    size = np.log(np.sort(design.nrmse)[::-1])
    spread = design.nrmse / design.nrmse.sum()
    entropy = -(spread * np.log(spread)).sum()
    return np.concatenate([residual, best, [size[0], size[1], size[-1], entropy]])


@dataclass(frozen=True)
class Classifier:
    """A trained classifier.

    Attributes:
        classes: names of the C classes.
        network: standardisation and network of scikit-learn.
    """

    classes: tuple[str, ...]
    network: Any

    def probabilities(self, x: np.ndarray) -> np.ndarray:
        """Of each class, (N, C), from features (N, F)."""
        return np.asarray(self.network.predict_proba(x))

    def diagnose(self, design: Design) -> dict[str, Any]:
        """The likeliest class as a verdict."""
        probability = self.probabilities(features(design)[None])[0]
        name = self.classes[int(probability.argmax())]
        if name == "healthy":
            return answer("no_gap", [])
        if name == "unknown":
            return answer("unexplained", [])
        return answer("effects_found", [(name, [])], float(probability.max()))


def train(x: np.ndarray, names: Sequence[str]) -> Classifier:
    """Fit to features (N, F) and class names (N,) by penalised likelihood, from fixed random weights.

    Raises:
        GapscopeError: scikit-learn is not installed, or there is one class alone.
    """
    try:
        from sklearn.exceptions import ConvergenceWarning
        from sklearn.neural_network import MLPClassifier
        from sklearn.pipeline import make_pipeline
        from sklearn.preprocessing import StandardScaler
    except ImportError:
        raise GapscopeError(
            "the classifier needs scikit-learn",
            "pip install 'gapscope[learn]', or score without --train",
        ) from None
    if len(set(names)) < 2:
        raise GapscopeError(
            "a classifier cannot be trained on cases of one class alone",
            "give training cases with several effects, or score without --train",
        )
    network = make_pipeline(
        StandardScaler(),
        MLPClassifier(
            hidden_layer_sizes=(HIDDEN,),
            activation="tanh",
            solver="lbfgs",
            # scikit-learn divides the penalty by the number of samples
            alpha=PENALTY * len(x),
            max_iter=MOST_ITERATIONS,
            random_state=0,
        ),
    )
    with warnings.catch_warnings():
        # the penalty, not the end of the search, keeps the network from overfitting
        warnings.simplefilter("ignore", ConvergenceWarning)
        network.fit(x, np.asarray(names))
    return Classifier(tuple(str(name) for name in network.classes_), network)
