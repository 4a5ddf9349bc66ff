"""A trained residual network: the torque that no effect explains, near its training data."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gapscope.arm.errors import InputError
from gapscope.arm.motions.motion import Motion
from gapscope.effects.residual.inputs import Inputs, channels
from gapscope.effects.residual.network import Network
from gapscope.effects.residual.trust import Trust

CHUNK = 1000
"""Samples that are evaluated at once."""


@dataclass(frozen=True)
class NetworkPrediction:
    """What the network says of N samples of n joints.

    Attributes:
        torque: to be added to the torque that the corrected arm predicts [N m], (N, n).
        std: standard deviation of the residual then, noise and the members' disagreement together [N m], (N, n).
        trust: factor by which the torque was shrunk [1], (N, n).
    """

    torque: np.ndarray
    std: np.ndarray
    trust: np.ndarray


@dataclass(frozen=True, eq=False)
class ResidualNetwork:
    """Residual torque of an arm with n joints: trust(x) times the mean of the members, within bounds.

    Attributes:
        inputs: what it sees.
        networks: the members, in one or several forms.
        chosen: which of them speaks on each joint, -1 if none does, (n,).
        trust: its factor of trust.
        scale: torque of an output of 1 [N m], (n,).
        bound: the torque never exceeds it [N m], (n,).
        cutoff: of the low-pass that the residual had passed when it was learnt [Hz].
    """

    inputs: Inputs
    networks: tuple[Network, ...]
    chosen: np.ndarray
    trust: Trust
    scale: np.ndarray
    bound: np.ndarray
    cutoff: float

    def check(self, n_joints: int) -> None:
        """Check that it is of an arm with so many joints; raises ``InputError`` otherwise."""
        if self.inputs.n != n_joints:
            raise InputError(
                f"the residual network is of an arm with {self.inputs.n} joints, this one has {n_joints}",
                "train one for this arm, or remove the line residual:",
                where="residual",
            )

    def torque(self, motion: Motion, load: np.ndarray) -> np.ndarray:
        """Residual torque [N m], (N, n); ``load`` is the torque that the corrected arm predicts [N m], (N, n)."""
        return self.predict(motion, load).torque

    def predict(self, motion: Motion, load: np.ndarray) -> NetworkPrediction:
        """Residual torque with its standard deviation and trust."""
        self.check(motion.q.shape[1])
        count = len(motion.t)
        rows = np.array_split(np.arange(count), max(1, -(-count // CHUNK)))
        # the memory of a motion is followed from its beginning, once
        series = channels(motion, load)
        parts = [
            self.of_windows(self.inputs.windows_of(series, motion.rate, chunk))
            for chunk in rows
        ]
        return NetworkPrediction(
            *(
                np.concatenate([getattr(p, k) for p in parts])
                for k in ("torque", "std", "trust")
            )
        )

    def of_windows(self, windows: np.ndarray) -> NetworkPrediction:
        """The same of normalised windows (n, N, taps, C); one sample of a running arm is N = 1."""
        mean, spread, _ = self.outputs(windows)
        near = windows[:, :, -1, self.inputs.layout.neighbourhood]
        trust = self.trust.factor(near).T
        torque = np.clip(trust * self.scale * mean, -self.bound, self.bound)
        return NetworkPrediction(torque, spread * self.scale, trust)

    def outputs(self, windows: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Mean, standard deviation and disagreement of the members over the joint's scale, each (N, n).

        Without trust and bound; on a joint on which none speaks 0, 1 and 0.
        """
        shape = windows.shape[1::-1]
        mean, spread, apart = np.zeros(shape), np.ones(shape), np.zeros(shape)
        for k, network in enumerate(self.networks):
            joints = self.chosen == k
            if not joints.any():
                continue
            output, log_variance = (x[:, joints] for x in network.outputs(windows))
            mean[:, joints] = output.mean(axis=0).T
            variance = output.var(axis=0) + np.exp(log_variance).mean(axis=0)
            spread[:, joints] = np.sqrt(variance).T
            apart[:, joints] = output.std(axis=0).T
        return mean, spread, apart
