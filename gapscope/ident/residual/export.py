"""A residual network for other programs: one TorchScript module from windows to torque."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import torch

from gapscope.arm.io.atomic_write import atomic_write
from gapscope.effects.residual.model import ResidualNetwork
from gapscope.effects.residual.network import Network


class Deployed(torch.nn.Module):
    """Residual torque [N m], (N, n), of normalised windows (n, N, taps, C): members, trust and bound.

    Args:
        residual: the network.
    """

    seen: torch.Tensor
    landmarks: torch.Tensor
    radius: torch.Tensor
    scale: torch.Tensor
    bound: torch.Tensor

    def __init__(self, residual: ResidualNetwork) -> None:
        super().__init__()
        network: Network = residual.network
        self.form = network.form
        self.weights = torch.nn.ParameterList([_tensor(w) for w in network.weights])
        self.biases = torch.nn.ParameterList([_tensor(b) for b in network.biases])
        self.register_buffer("seen", torch.as_tensor(network.seen))
        self.register_buffer("landmarks", _tensor(residual.trust.landmarks))
        self.register_buffer("radius", _tensor(residual.trust.radius))
        self.register_buffer("scale", _tensor(residual.scale))
        self.register_buffer("bound", _tensor(residual.bound))

    def forward(self, windows: torch.Tensor) -> torch.Tensor:
        """The torque."""
        mean = self._mean(windows).mean(dim=0)
        torque = (self._trusted(windows[:, :, -1]) * mean).T * self.scale
        return torch.minimum(torch.maximum(torque, -self.bound), self.bound)

    def _mean(self, windows: torch.Tensor) -> torch.Tensor:
        """Means of the members, (members, n, N)."""
        n = windows.shape[0]
        flat = windows.reshape(n, windows.shape[1], -1)
        h = (flat[:, :, self.seen] if self.form == "mlp" else flat)[None]
        last = len(self.weights) - 1
        for weight, bias in zip(self.weights[:last], self.biases[:last], strict=True):
            # a layer of the convolutional form halves the number of instants
            h = h.reshape(h.shape[0], n, -1, weight.shape[2])
            h = torch.tanh(h @ weight + bias[:, :, None])
        h = h.reshape(h.shape[0], n, -1, self.weights[last].shape[2])
        outputs = h @ self.weights[last][..., :1]
        return outputs[..., 0] + self.biases[last][:, :, :1]

    def _trusted(self, now: torch.Tensor) -> torch.Tensor:
        """Factor of the output, 1 near the inputs seen in training and 0 at twice the radius, (n, N)."""
        difference = now[:, :, None] - self.landmarks[:, None]
        nearest = (difference**2).sum(dim=3).amin(dim=2).sqrt()
        beyond = (nearest / self.radius[:, None] - 1.0).clamp(0.0, 1.0)
        return 1.0 - beyond * beyond * (3.0 - 2.0 * beyond)


def torchscript(
    residual: ResidualNetwork, path: Path | str | None = None
) -> torch.jit.ScriptModule:
    """The network as TorchScript, in double precision; written to ``path`` if one is given.

    Raises:
        GapscopeError: the file cannot be written.
    """
    inputs = residual.inputs
    shape = (inputs.n, 1, inputs.taps, inputs.channels)
    example = torch.zeros(shape, dtype=torch.float64)
    with torch.no_grad(), warnings.catch_warnings():
        # torch.export needs torch to run; TorchScript does not
        warnings.simplefilter("ignore", DeprecationWarning)
        traced = torch.jit.trace(Deployed(residual).eval(), example)
        module = torch.jit.freeze(traced)
    if path is not None:
        with atomic_write(path) as aside:
            module.save(str(aside))
    return module


def _tensor(value: np.ndarray) -> torch.Tensor:
    return torch.as_tensor(value, dtype=torch.float64)
