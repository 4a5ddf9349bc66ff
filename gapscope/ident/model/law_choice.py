"""Form of the friction and strength of the pull to the nominal arm, chosen by validation inside the fitted samples."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from gapscope.ident.model.friction_law import (
    PRESLIDING_DISTANCES,
    SATURATION_SHARES,
    STRIBECK_SPEEDS,
    FrictionLaw,
)
from gapscope.ident.model.friction_trials import (
    FrictionTrials,
    penalties,
    pulled_solution,
)
from gapscope.ident.signals.samples import Samples

Change = dict[str, Any]
"""Attributes of a friction law, with the values to try."""
WORTH = 0.02
"""A friction law with more parameters must lower the error on held-out stretches by this share."""
EXCEEDED = 3.0
"""Every moving drive must be faster at times than a Stribeck speed by this factor."""
PULLS = (1e-4, 1e-3, 1e-2, 1e-1, 1.0, 10.0)
"""Strengths of the pull to the nominal arm that are tried [1]."""
STRONGEST = 1e4
"""If the strongest of them predicts best, tenfold ones are tried up to this [1]."""


@dataclass(frozen=True)
class Choice:
    """What validation inside the fitted samples chose.

    Attributes:
        law: form of the dry friction.
        pull: weight of ((x - x0) / scale)^2 beside the mean square of the weighted residual [1].
        noise: RMS residual per joint [N m], shape (n,), the weights' inverse.
        tried: law and pull in words, with the error on held-out stretches [1]: RMS of residual over ``noise``.
    """

    law: FrictionLaw
    pull: float
    noise: np.ndarray
    tried: tuple[tuple[str, float], ...]


def choose(
    samples: Samples, *, nonlinear: bool = True, presliding: bool = True
) -> Choice:
    """Choose the friction law, then the pull; the simpler one unless the richer one is clearly better.

    Args:
        samples: what may be fitted.
        nonlinear: whether a Stribeck term, or one that saturates with speed, may be chosen.
        presliding: whether friction that keeps its direction at rest may be chosen.
    """
    law, pull = FrictionLaw(), PULLS[1]
    noise = joint_noise(samples, law, pull)
    trials = FrictionTrials(samples, noise)
    best = trials.held_out(law).error(pull)
    tried = [(f"{law}; pull {pull:g}", best)]
    for law_of, worth in _ladder(trials, pull, nonlinear, presliding):
        errors = {
            candidate: trials.held_out(candidate).error(pull)
            for candidate in law_of(law)
        }
        tried += [(f"{each}; pull {pull:g}", error) for each, error in errors.items()]
        winner = min(errors, key=lambda c: errors[c], default=law)
        # the simpler law stays unless the richer one is worth its parameters
        if errors.get(winner, np.inf) < (1 - worth) * best:
            law, best = winner, errors[winner]
    # the pull is chosen last: it depends little on the form of the friction
    noise = joint_noise(samples, law, pull)
    by_pull = _errors_by_pull(samples, law, noise)
    tried += [(f"{law}; pull {value:g}", error) for value, error in by_pull.items()]
    pull = min(by_pull, key=lambda value: by_pull[value])
    return Choice(
        law=law,
        pull=pull,
        noise=joint_noise(samples, law, pull),
        tried=tuple(tried),
    )


def _errors_by_pull(
    samples: Samples, law: FrictionLaw, noise: np.ndarray
) -> dict[float, float]:
    """Error on held-out stretches by strength of the pull, beyond ``PULLS`` as long as a stronger one is better."""
    stretches = FrictionTrials(samples, noise).held_out(law)
    errors = {pull: stretches.error(pull) for pull in PULLS}
    while True:
        strongest = max(errors)
        best = min(errors, key=lambda pull: errors[pull])
        if best < strongest or strongest >= STRONGEST:
            return errors
        stronger = 10 * strongest
        errors[stronger] = stretches.error(stronger)


def _nonlinear_terms(samples: Samples) -> list[Change]:
    """Stribeck terms, and terms that saturate with speed, as far as the recorded speeds can show them."""
    columns = samples.columns
    speeds = np.abs(samples.velocity @ columns.drives.T) / columns.per_radian
    fastest = speeds.max(axis=0)
    moving = fastest[fastest > STRIBECK_SPEEDS[0]]
    if not len(moving):
        return []
    # every moving drive exceeds a Stribeck speed by far: beyond the recorded speeds the law is extrapolated
    slowest = moving.min()
    terms: list[Change] = [
        {"stribeck_speed": speed}
        for speed in STRIBECK_SPEEDS
        if EXCEEDED * speed <= slowest
    ]
    for share in SATURATION_SHARES:
        scaled = share * np.maximum(fastest, STRIBECK_SPEEDS[0])
        terms.append({"saturation_speeds": tuple(scaled.tolist())})
    return terms


def _takes_energy(trials: FrictionTrials, law: FrictionLaw, pull: float) -> bool:
    """Whether the terms of a law beyond c are positive on the whole; a negative one stands for another law."""
    extra = [shape for shape in law.shapes if shape != "c"]
    if not extra:
        return True
    count = len(extra) * len(trials.samples.columns.labels)
    return bool(trials.fitted(law, pull)[-count:].sum() > 0)


def _ladder(
    trials: FrictionTrials, pull: float, nonlinear: bool, presliding: bool
) -> Iterator[tuple[Callable[[FrictionLaw], list[FrictionLaw]], float]]:
    """Laws to try instead of one, and by which share they have to lower the error: 0 without further parameters."""

    def with_nonlinear_term(law: FrictionLaw) -> list[FrictionLaw]:
        laws = [replace(law, **change) for change in _nonlinear_terms(trials.samples)]
        return [each for each in laws if _takes_energy(trials, each, pull)]

    def with_presliding(law: FrictionLaw) -> list[FrictionLaw]:
        distances = _presliding_distances(trials, law, pull)
        return [replace(law, presliding=distances)] if any(distances) else []

    if nonlinear:
        yield with_nonlinear_term, WORTH
    if presliding:
        yield with_presliding, 0.0


def _presliding_distances(
    trials: FrictionTrials, law: FrictionLaw, pull: float
) -> tuple[float, ...]:
    """Per drive the distance that predicts the torque of its joints best [rad]; 0 if the smoothed sign is better.

    Friction that holds a joint at rest is the rule [dahl1976], so the smoothed sign has to be worth it.
    """
    drives = trials.samples.columns.drives
    distances = (0.0, *PRESLIDING_DISTANCES)
    errors = []
    for distance in distances:
        same = replace(law, presliding=(distance,) * len(drives))
        errors.append(trials.held_out(same).mse(pull))
    turned = np.abs(drives) / np.abs(drives).sum(axis=1, keepdims=True)
    by_drive = np.array(errors) @ turned.T
    by_drive[0] *= (1.0 + WORTH) ** 2
    return tuple(distances[k] for k in by_drive.argmin(axis=0))


def joint_noise(
    samples: Samples, law: FrictionLaw, pull: float, rounds: int = 3
) -> np.ndarray:
    """RMS residual per joint of the pulled weighted fit [N m], shape (n,); never zero."""
    torque = samples.torque
    matrix, nominal = samples.matrix(law), samples.columns.nominal(law)
    largest = np.abs(torque).max(initial=1e-9)
    # weights and fit depend on each other: a few rounds suffice
    noise = np.maximum(torque.std(axis=0), 1e-6 * largest)
    least = 1e-4 * np.sqrt((torque**2).mean(axis=0)) + 1e-12
    unit = np.ones(1)
    by_joint = [
        _gram(matrix[:, j : j + 1], torque[:, j : j + 1], unit)
        for j in range(len(noise))
    ]
    for _ in range(rounds):
        penalty = pull * penalties(samples, law, matrix, noise)
        gram = np.tensordot(noise**-2.0, by_joint, axes=1)
        x = pulled_solution(gram, torque.size, penalty, nominal)
        rms = np.sqrt(((torque - matrix @ x) ** 2).mean(axis=0))
        noise = np.maximum(rms, least)
    return noise


def _gram(matrix: np.ndarray, torque: np.ndarray, noise: np.ndarray) -> np.ndarray:
    full = np.concatenate([matrix, torque[:, :, None]], axis=2) / noise[:, None]
    flat = full.reshape(-1, full.shape[2])
    return flat.T @ flat
