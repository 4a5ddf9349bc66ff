"""Laws of friction of an identification: their columns, trials, and the choice between them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from gapscope.arm.root_mean_square import rms
from gapscope.ident.model.base_parameters import WORTH
from gapscope.ident.samples import (
    PRESLIDING_DISTANCES,
    SATURATION_SHARES,
    STRIBECK_SPEEDS,
    FrictionLaw,
    Samples,
    equal_parts,
)
from gapscope.model.effective_samples import group_slices

# How well laws of friction predict stretches of time that were held out; laws differ in the dry columns alone.


FOLDS = 5
"""Least number of stretches of time, each predicted from all others."""
SHORTEST = 20
"""Samples of a stretch, about, at least."""
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
        # the columns of dry friction stand between these
        self._shared = np.concatenate([samples.smooth, torque], axis=2)
        self._shared /= noise[:, None]
        spans = [*self.stretches, slice(0, len(torque))]
        flat = [self._shared[k].reshape(-1, self._shared.shape[2]) for k in spans]
        self._grams = [(k, x.T @ x) for k, x in zip(spans, flat, strict=True)]

    def held_out(self, law: FrictionLaw) -> Callable[[float], np.ndarray]:
        """Mean square of residual over noise, per joint [1], (n,), by the pull: of each stretch from all others."""
        dry, grams, penalty, nominal = self._under(law)
        total, joints = np.sum(grams[:-1], axis=0), len(self.noise)
        sizes = [joints * (rows.stop - rows.start) for rows in self.stretches]
        smooth = self.samples.smooth.shape[2]

        def mse(pull: float) -> np.ndarray:
            squares = np.zeros(joints)
            for rows, gram, size in zip(self.stretches, grams, sizes, strict=False):
                # the Gram matrix of all other stretches, without forming their equations again
                count = sum(sizes) - size
                x = pulled_solution(total - gram, count, pull * penalty, nominal)
                z = np.append(-x[:smooth], 1.0)
                left = self._shared[rows] @ z - dry[rows] @ x[smooth:]
                squares += (left**2).sum(axis=0)
            return np.asarray(squares * joints / sum(sizes))

        return mse

    def fitted(self, law: FrictionLaw, pull: float) -> np.ndarray:
        """x under a law and a pull, fitted to all samples, shape (p,)."""
        _, grams, penalty, nominal = self._under(law)
        count = self.samples.torque.size
        return pulled_solution(grams[-1], count, pull * penalty, nominal)

    def _under(
        self, law: FrictionLaw
    ) -> tuple[np.ndarray, list[np.ndarray], np.ndarray, np.ndarray]:
        """Dry columns at unit noise, (M, n, d); Gram matrices of [W, y] of stretches and all; pull; nominal x."""
        columns = self.samples.columns
        dry = self.samples.filtered_each(lambda motion: columns.dry(motion, law))
        dry /= self.noise[:, None]
        shared, own = self._shared.shape[2], dry.shape[2]
        # the torque comes last
        order = [*range(shared - 1), *range(shared, shared + own), shared - 1]
        grams = []
        for rows, gram in self._grams:
            friction = dry[rows].reshape(-1, own)
            cross = self._shared[rows].reshape(-1, shared).T @ friction
            whole = np.block([[gram, cross], [cross.T, friction.T @ friction]])
            grams.append(whole[np.ix_(order, order)])
        squares = np.diag(grams[-1])[:-1]
        penalty = penalties(self.samples, law, squares)
        return dry, grams, penalty, columns.nominal(law)


def penalties(samples: Samples, law: FrictionLaw, squares: np.ndarray) -> np.ndarray:
    """Diagonal of the pull's quadratic form for pull 1 [1/x^2], shape (p,): 1 / scale^2, a trace elsewhere.

    ``squares`` are the sums of squares of the columns at unit noise, (p,).
    """
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
    length = max(SHORTEST, len(group) // max(FOLDS, len(segments)))
    out = []
    for segment in segments:
        count = max(1, round((segment.stop - segment.start) / length))
        parts = equal_parts(segment, count)
        # of a part of four samples two would be left
        out += [slice(p.start + 1, p.stop - 1) for p in parts if p.stop - p.start > 4]
    return out


# Form of the friction and strength of the pull to the nominal arm, chosen by validation inside the fitted samples.


EXCEEDED = 3.0
"""Every moving drive must be faster at times than a Stribeck speed by this factor."""
PULLS = np.logspace(-4, 4, 9)
"""Strengths of the pull to the nominal arm that are tried [1]."""


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
    law, pull = FrictionLaw(), float(PULLS[1])
    noise = joint_noise(samples, law, pull)
    trials = FrictionTrials(samples, noise)
    best = _error(trials, law, pull)
    tried = [(f"{law}; pull {pull:g}", best)]
    # the simpler law stays unless the richer one is worth its parameters
    richer = _nonlinear_laws(trials, pull) if nonlinear else []
    for candidate in richer:
        error = _error(trials, candidate, pull)
        tried.append((f"{candidate}; pull {pull:g}", error))
    if richer:
        least = int(np.argmin([error for _, error in tried[1:]]))
        if tried[1 + least][1] < (1 - WORTH) * best:
            law, best = richer[least], tried[1 + least][1]
    distances = _presliding_distances(trials, law, pull) if presliding else ()
    if any(distances):
        candidate = replace(law, presliding=distances)
        error = _error(trials, candidate, pull)
        tried.append((f"{candidate}; pull {pull:g}", error))
        law = candidate if error < best else law
    # the pull is chosen last: it depends little on the form of the friction
    noise = joint_noise(samples, law, pull)
    mse = FrictionTrials(samples, noise).held_out(law)
    errors = [float(np.sqrt(mse(value).mean())) for value in PULLS]
    pairs = zip(PULLS, errors, strict=True)
    tried += [(f"{law}; pull {value:g}", error) for value, error in pairs]
    pull = float(PULLS[np.argmin(errors)])
    noise = joint_noise(samples, law, pull)
    return Choice(law=law, pull=pull, noise=noise, tried=tuple(tried))


def _error(trials: FrictionTrials, law: FrictionLaw, pull: float) -> float:
    """RMS of residual over noise on held-out stretches [1]."""
    return float(np.sqrt(trials.held_out(law)(pull).mean()))


def _nonlinear_laws(trials: FrictionTrials, pull: float) -> list[FrictionLaw]:
    """Laws with a Stribeck term, or one that saturates with speed, as far as the recorded speeds can show them.

    A term is positive on the whole; a negative one stands for another law.
    """
    columns = trials.samples.columns
    speeds = np.abs(trials.samples.velocity @ columns.drives.T) / columns.per_radian
    fastest = speeds.max(axis=0)
    moving = fastest[fastest > STRIBECK_SPEEDS[0]]
    if not len(moving):
        return []
    # every moving drive exceeds a Stribeck speed by far: beyond the recorded speeds the law is extrapolated
    laws = [
        FrictionLaw(stribeck_speed=speed)
        for speed in STRIBECK_SPEEDS
        if EXCEEDED * speed <= moving.min()
    ]
    scaled = np.maximum(fastest, STRIBECK_SPEEDS[0])
    for share in SATURATION_SHARES:
        laws.append(FrictionLaw(saturation_speeds=tuple((share * scaled).tolist())))
    drives = len(columns.labels)
    return [law for law in laws if trials.fitted(law, pull)[-drives:].sum() > 0]


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
        errors.append(trials.held_out(same)(pull))
    turned = np.abs(drives) / np.abs(drives).sum(axis=1, keepdims=True)
    by_drive = np.array(errors) @ turned.T
    by_drive[0] *= (1.0 + WORTH) ** 2
    return tuple(distances[k] for k in by_drive.argmin(axis=0))


def joint_noise(samples: Samples, law: FrictionLaw, pull: float) -> np.ndarray:
    """RMS residual per joint of the pulled weighted fit [N m], shape (n,); never zero."""
    torque = samples.torque
    matrix, nominal = samples.matrix(law), samples.columns.nominal(law)
    both = np.concatenate([matrix, torque[:, :, None]], axis=2).transpose(1, 2, 0)
    by_joint = both @ both.transpose(0, 2, 1)
    # weights and fit depend on each other: a few rounds suffice
    noise = np.maximum(torque.std(axis=0), 1e-6 * np.abs(torque).max() + 1e-12)
    least = 1e-4 * rms(torque) + 1e-12
    for _ in range(3):
        gram = np.tensordot(noise**-2.0, by_joint, axes=1)
        penalty = pull * penalties(samples, law, np.diag(gram)[:-1])
        x = pulled_solution(gram, torque.size, penalty, nominal)
        noise = np.maximum(rms(torque - matrix @ x), least)
    return noise
