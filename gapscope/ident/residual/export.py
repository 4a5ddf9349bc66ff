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
        for name, value in (
            ("landmarks", residual.trust.landmarks),
            ("radius", residual.trust.radius),
            ("scale", residual.scale),
            ("bound", residual.bound),
        ):
            self.register_buffer(name, _tensor(value))

    def forward(self, windows: torch.Tensor) -> torch.Tensor:
        """The torque."""
        n = windows.shape[0]
        flat = windows.reshape(n, windows.shape[1], -1)
        h = (flat[:, :, self.seen] if self.form == "mlp" else flat)[None]
        for k in range(len(self.weights) - 1):
            h = h.reshape(h.shape[0], n, -1, self.weights[k].shape[2])
            h = torch.tanh(h @ self.weights[k] + self.biases[k][:, :, None])
        h = h.reshape(h.shape[0], n, -1, self.weights[-1].shape[2])
        mean = (h @ self.weights[-1][..., :1])[..., 0] + self.biases[-1][:, :, :1]
        now = windows[:, :, -1]
        square = ((now[:, :, None] - self.landmarks[:, None]) ** 2).sum(dim=3)
        u = (square.amin(dim=2).sqrt() / self.radius[:, None] - 1.0).clamp(0.0, 1.0)
        torque = ((1.0 - u * u * (3.0 - 2.0 * u)) * mean.mean(dim=0)).T * self.scale
        return torch.minimum(torch.maximum(torque, -self.bound), self.bound)


def torchscript(
    residual: ResidualNetwork, path: Path | str | None = None
) -> torch.jit.ScriptModule:
    """The network as TorchScript, in double precision; written to ``path`` if one is given.

    Raises:
        GapscopeError: the file cannot be written.
    """
    n, taps, c = residual.inputs.n, residual.inputs.taps, residual.inputs.channels
    example = torch.zeros((n, 1, taps, c), dtype=torch.float64)
    with torch.no_grad(), warnings.catch_warnings():
        warnings.simplefilter(
            "ignore", DeprecationWarning
        )  # torch.export needs torch to run; TorchScript does not
        module = torch.jit.freeze(torch.jit.trace(Deployed(residual).eval(), example))
    if path is not None:
        with atomic_write(path) as aside:
            module.save(str(aside))
    return module


def _tensor(value: np.ndarray) -> torch.Tensor:
    return torch.as_tensor(value, dtype=torch.float64)
