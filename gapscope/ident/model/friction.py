"""Laws of friction of an identification: their columns, trials, and the choice between them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from gapscope.arm.root_mean_square import rms
from gapscope.ident.model.linear_problem import (
    PRESLIDING_DISTANCES,
    SATURATION_SHARES,
    STRIBECK_SPEEDS,
    FrictionLaw,
)
from gapscope.ident.samples import Samples
from gapscope.model.effective_samples import group_slices

# How well laws of friction predict stretches of time that were held out; laws differ in the dry columns alone.


FOLDS = 5
"""Least number of stretches of time, each predicted from all others."""
LOOSE = 1e-8
"""Pull on parameters that the nominal arm does not give, in units of their columns [1]."""


class FrictionTrials:
    """Samples on which laws of friction are tried; what all laws share is summed once.

    Args:
        samples: what may be fitted.
        noise: RMS residual per joint [N m], shape (n,).
    """

    def __init__(self, samples: Samples, noise: np.ndarray) -> None:
        self.samples, self.noise = samples, noise
        self.stretches = stretches(samples.group)
        torque = samples.torque[:, :, None]
        self._shared = np.concatenate([samples.smooth, torque], axis=2)
        self._shared /= noise[:, None]
        self._grams: dict[tuple[int, int], np.ndarray] = {}

    def held_out(self, law: FrictionLaw) -> HeldOutStretches:
        """The stretches under a law."""
        dry = self._dry(law)
        grams = [self._gram(dry, rows) for rows in self.stretches]
        return HeldOutStretches(self, law, dry, grams)

    def fitted(self, law: FrictionLaw, pull: float) -> np.ndarray:
        """x under a law and a pull, fitted to all samples, shape (p,)."""
        dry = self._dry(law)
        gram = self._gram(dry, slice(0, len(dry)))
        penalty = pull * self.penalty(law, dry)
        nominal = self.samples.columns.nominal(law)
        return pulled_solution(gram, self.samples.torque.size, penalty, nominal)

    def penalty(self, law: FrictionLaw, dry: np.ndarray) -> np.ndarray:
        """As ``penalties``, of the columns of dry friction at unit noise, (M, n, d)."""
        squares = [(x**2).sum(axis=(0, 1)) for x in (self._shared[:, :, :-1], dry)]
        return _penalties(self.samples, law, np.concatenate(squares))

    def residual(self, rows: slice, dry: np.ndarray, x: np.ndarray) -> np.ndarray:
        """What x leaves of the torque of some samples at unit noise [1], (K, n)."""
        smooth = self.samples.smooth.shape[2]
        z = np.append(-x[:smooth], 1.0)
        return np.asarray(self._shared[rows] @ z - dry[rows] @ x[smooth:])

    def _dry(self, law: FrictionLaw) -> np.ndarray:
        """Columns of dry friction at unit noise, (M, n, d)."""
        columns = self.samples.columns
        dry = self.samples.filtered_each(lambda motion: columns.dry(motion, law))
        return np.asarray(dry / self.noise[:, None])

    def _gram(self, dry: np.ndarray, rows: slice) -> np.ndarray:
        """Gram matrix of [W, y] of some samples at unit noise, (p + 1, p + 1)."""
        shared = self._shared[rows].reshape(-1, self._shared.shape[2])
        key = (rows.start, rows.stop)
        if key not in self._grams:
            self._grams[key] = shared.T @ shared
        own = dry[rows].reshape(len(shared), -1)
        smooth = shared.shape[1] - 1
        count = smooth + own.shape[1]
        # the columns of dry friction stand between the smooth ones and the torque
        places = np.append(np.arange(smooth), count)
        friction = np.arange(smooth, count)
        gram = np.empty((count + 1, count + 1))
        gram[np.ix_(places, places)] = self._grams[key]
        cross = shared.T @ own
        gram[np.ix_(places, friction)] = cross
        gram[np.ix_(friction, places)] = cross.T
        gram[np.ix_(friction, friction)] = own.T @ own
        return gram


class HeldOutStretches:
    """Stretches of time, each predicted from all others under a law of friction, with pulls of any strength.

    Args:
        trials: the samples.
        law: form of the dry friction.
        dry: its columns at unit noise, (M, n, d).
        grams: Gram matrix of [W, y] of each stretch at unit noise.
    """

    def __init__(
        self,
        trials: FrictionTrials,
        law: FrictionLaw,
        dry: np.ndarray,
        grams: list[np.ndarray],
    ) -> None:
        self._trials, self._dry, self._grams = trials, dry, grams
        self._penalty = trials.penalty(law, dry)
        self._nominal = trials.samples.columns.nominal(law)

    def error(self, pull: float) -> float:
        """RMS of residual over noise [1]."""
        return float(np.sqrt(self.mse(pull).mean()))

    def mse(self, pull: float) -> np.ndarray:
        """Mean square of residual over noise, per joint [1], (n,)."""
        trials, joints = self._trials, self._trials.samples.torque.shape[1]
        total, squares = np.sum(self._grams, axis=0), np.zeros(joints)
        sizes = [joints * (rows.stop - rows.start) for rows in trials.stretches]
        for rows, gram, size in zip(trials.stretches, self._grams, sizes, strict=True):
            # the Gram matrix of all other stretches, without forming their equations again
            others, count = total - gram, sum(sizes) - size
            x = pulled_solution(others, count, pull * self._penalty, self._nominal)
            squares += (trials.residual(rows, self._dry, x) ** 2).sum(axis=0)
        return np.asarray(squares * joints / sum(sizes))


def penalties(
    samples: Samples, law: FrictionLaw, matrix: np.ndarray, noise: np.ndarray
) -> np.ndarray:
    """Diagonal of the pull's quadratic form for pull 1 [1/x^2], shape (p,): 1 / scale^2, a trace elsewhere."""
    squares = np.linalg.norm(matrix, axis=0) ** 2 / noise[:, None] ** 2
    return _penalties(samples, law, squares.sum(axis=0))


def _penalties(samples: Samples, law: FrictionLaw, squares: np.ndarray) -> np.ndarray:
    """The same from the sums of squares of the columns at unit noise, (p,)."""
    scale = samples.columns.scale(law)
    size = np.sqrt(squares / len(samples.torque))
    # a weak prior on parameters that the nominal arm need not have keeps the system regular
    trace = LOOSE * np.where(size > 0, size, 1.0) ** 2
    return np.where(np.isfinite(scale), scale**-2.0, trace)


def pulled_solution(
    gram: np.ndarray, rows: int, penalty: np.ndarray, nominal: np.ndarray
) -> np.ndarray:
    """Argmin |y - W x|^2 / noise^2 + rows (x - x0)^2 penalty, from the Gram matrix of [W, y]; shape (p,)."""
    own, right = gram[:-1, :-1], gram[:-1, -1]
    weight = rows * penalty
    # columns differ by orders of magnitude: scaled to a unit diagonal
    unit = 1.0 / np.sqrt(np.diag(own) + weight)
    system = (own + np.diag(weight)) * unit[:, None] * unit
    change = np.linalg.solve(system, unit * (right - own @ nominal))
    return nominal + unit * change


def stretches(group: np.ndarray) -> list[slice]:
    """Stretches of time within segments, at least ``FOLDS`` in all, of about equal length; two samples apart."""
    segments = group_slices(group)
    length = max(20, len(group) // max(FOLDS, len(segments)))
    out = []
    for segment in segments:
        count = max(1, round((segment.stop - segment.start) / length))
        cuts = np.linspace(segment.start, segment.stop, count + 1).astype(int)
        for start, stop in pairwise(cuts.tolist()):
            if stop - start > 4:
                out.append(slice(start + 1, stop - 1))
    return out


# Form of the friction and strength of the pull to the nominal arm, chosen by validation inside the fitted samples.


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
    least = 1e-4 * rms(torque) + 1e-12
    unit = np.ones(1)
    by_joint = [
        _gram(matrix[:, j : j + 1], torque[:, j : j + 1], unit)
        for j in range(len(noise))
    ]
    for _ in range(rounds):
        penalty = pull * penalties(samples, law, matrix, noise)
        gram = np.tensordot(noise**-2.0, by_joint, axes=1)
        x = pulled_solution(gram, torque.size, penalty, nominal)
        noise = np.maximum(rms(torque - matrix @ x), least)
    return noise


def _gram(matrix: np.ndarray, torque: np.ndarray, noise: np.ndarray) -> np.ndarray:
    full = np.concatenate([matrix, torque[:, :, None]], axis=2) / noise[:, None]
    flat = full.reshape(-1, full.shape[2])
    return flat.T @ flat
