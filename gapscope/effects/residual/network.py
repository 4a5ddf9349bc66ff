"""An ensemble of small networks, one per joint and member, evaluated by numpy."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gapscope.effects.residual.basis import Basis

ADDITIVE = "additive"
FORMS = (ADDITIVE, "mlp", "tcn")
"""A weighted sum of fixed functions, a feed-forward network, and a causal temporal convolution."""
LOG_VARIANCE = (-10.0, 4.0)
"""Bounds of the log variance that a network may state, over the square of the joint's scale."""


@dataclass(frozen=True)
class Network:
    """M members of a network for each of n joints.

    h_0 is what the form sees of a window, h_{k+1} = tanh(h_k W_k + b_k), and the head gives the mean and the logarithm
    of the variance of the residual, (mean, log variance) = h_K W_K + b_K, over the joint's scale. ``additive`` has no
    hidden layer: its head sees the functions of a basis. The ``mlp`` sees all channels now and the past of the joint's
    own dq. In the ``tcn`` each layer joins two neighbouring samples to one: a
    causal convolution of kernel 2 whose dilation doubles from layer to layer, of which only what the last sample needs
    is computed; so it has taps = 2^K samples and K layers.

    Attributes:
        form: one of ``FORMS``.
        seen: places of a flat window that the mlp sees, (I,); all of them for the tcn, none for ``additive``.
        weights: W_k, each (M, n, in, out); the last is the head, out = 2.
        biases: b_k, each (M, n, out).
        basis: of ``additive``; ``None`` for the others.

    Source: vandenoord2016, lakshminarayanan2017.
    """

    form: str
    seen: np.ndarray
    weights: tuple[np.ndarray, ...]
    biases: tuple[np.ndarray, ...]
    basis: Basis | None = None

    @property
    def members(self) -> int:
        """Number M of members."""
        return int(self.weights[0].shape[0])

    def hidden(self, windows: np.ndarray) -> np.ndarray:
        """What the head sees, h_K, (M, n, N, hidden), of windows (n, N, taps, C); one for all members of a basis."""
        if self.basis is not None:
            return self.basis.features(windows[:, :, -1])[None]
        n, count = windows.shape[:2]
        flat = windows.reshape(n, count, -1)
        h = (flat[:, :, self.seen] if self.form == "mlp" else flat)[None]
        for weight, bias in zip(self.weights[:-1], self.biases[:-1], strict=True):
            # two neighbouring samples are one row of the convolution's matrix
            h = h.reshape(*h.shape[:2], -1, weight.shape[2])
            h = np.tanh(h @ weight + bias[:, :, None])
        return h.reshape(self.members, n, count, -1)

    def heads(self, hidden: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Mean and log variance over the joint's scale, each (M, n, N)."""
        out = hidden @ self.weights[-1] + self.biases[-1][:, :, None]
        return out[..., 0], np.clip(out[..., 1], *LOG_VARIANCE)

    def outputs(self, windows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Mean and log variance of every member, each (M, n, N), of windows (n, N, taps, C)."""
        return self.heads(self.hidden(windows))
