"""How well laws of friction predict stretches of time that were held out; laws differ in the dry columns alone."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from gapscope.ident.model.friction_law import FrictionLaw
from gapscope.ident.signals.samples import Samples
from gapscope.model.effective_samples import group_slices

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
    rms = np.sqrt(squares / len(samples.torque))
    # a weak prior on parameters that the nominal arm need not have keeps the system regular
    trace = LOOSE * np.where(rms > 0, rms, 1.0) ** 2
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
