"""Training of a residual network by torch: a heteroscedastic ensemble with early stopping, bitwise repeatable."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import torch

from gapscope.effects.residual.inputs import Inputs
from gapscope.effects.residual.network import LOG_VARIANCE, Network
from gapscope.ident.residual.settings import TCN_LAYERS, ResidualSettings

BETA = 0.5
"""Weight of the likelihood's gradient by variance^beta: rows of large variance are not given up early."""
EVERY = 40
"""Steps between two looks at the rows held out."""


@contextmanager
def repeatable(seed: int) -> Iterator[torch.Generator]:
    """One thread and deterministic kernels: the same numbers on every run; the settings come back afterwards."""
    threads, strict = (
        torch.get_num_threads(),
        torch.are_deterministic_algorithms_enabled(),
    )
    torch.set_num_threads(1)
    torch.use_deterministic_algorithms(True, warn_only=True)
    try:
        yield torch.Generator().manual_seed(seed)
    finally:
        torch.set_num_threads(threads)
        torch.use_deterministic_algorithms(strict)


def device() -> torch.device:
    """The GPU, if there is one."""
    return torch.device("cuda" if torch.cuda.is_available() else "cpu")


class Ensemble(torch.nn.Module):
    """The networks of all members and joints, trained side by side; the same formulas as ``Network``.

    Args:
        settings: of the training.
        inputs: what the networks see.
        generator: of the first weights.
    """

    seen: torch.Tensor

    def __init__(
        self, settings: ResidualSettings, inputs: Inputs, generator: torch.Generator
    ) -> None:
        super().__init__()
        self.form, n = settings.form, inputs.n
        seen = (
            inputs.seen_by_mlp
            if self.form == "mlp"
            else np.arange(inputs.taps * inputs.channels)
        )
        self.register_buffer("seen", torch.as_tensor(seen))
        width = settings.hidden
        if self.form == "mlp":
            sizes = [(len(seen), width), (width, width), (width, 2)]
        else:
            sizes = [
                (2 * inputs.channels, width),
                *[(2 * width, width)] * (TCN_LAYERS - 1),
                (width, 2),
            ]
        self.weights, self.biases = torch.nn.ParameterList(), torch.nn.ParameterList()
        for k, (a, b) in enumerate(sizes):
            gain = (1.0 if k + 1 < len(sizes) else 0.1) / a**0.5
            self.weights.append(
                gain * torch.randn(settings.members, n, a, b, generator=generator)
            )
            self.biases.append(torch.zeros(settings.members, n, b))

    def forward(self, windows: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Mean and log variance, each (M, n, N), of windows (n, N, taps, C)."""
        n, count = windows.shape[:2]
        flat = windows.reshape(n, count, -1)
        h = (flat[:, :, self.seen] if self.form == "mlp" else flat)[None]
        for weight, bias in zip(self.weights[:-1], self.biases[:-1], strict=True):
            h = h.reshape(h.shape[0], n, -1, weight.shape[2])
            h = torch.tanh(h @ weight + bias[:, :, None])
        out = (
            h.reshape(h.shape[0], n, count, -1) @ self.weights[-1]
            + self.biases[-1][:, :, None]
        )
        return out[..., 0], out[..., 1].clamp(*LOG_VARIANCE)

    def arrays(self) -> Network:
        """The same networks as arrays."""
        weights, biases = (
            tuple(x.detach().cpu().double().numpy() for x in part)
            for part in (self.weights, self.biases)
        )
        return Network(self.form, self.seen.cpu().numpy(), weights, biases)


def train(
    settings: ResidualSettings,
    inputs: Inputs,
    windows: np.ndarray,
    target: np.ndarray,
    group: np.ndarray,
    near: np.ndarray,
) -> Network:
    """Train an ensemble; member m holds out group m modulo their number, and keeps what predicts it best.

    Each joint of each member stops for itself: what is kept are its weights of least error on the rows held out that
    count, the first weights included.

    Args:
        settings: of the training.
        inputs: what the networks see.
        windows: (n, M, taps, C).
        target: residual over its scale [1], (M, n).
        group: of each row, (M,); -1 is neither trained on nor held out.
        near: rows that count when held out, per joint, (M, n).
    """
    with repeatable(settings.seed) as generator:
        ensemble = Ensemble(settings, inputs, generator)
        best = [p.detach().clone() for p in ensemble.parameters()]
        where = device()
        ensemble.to(where)
        x = torch.as_tensor(windows, dtype=torch.float32, device=where)
        y = torch.as_tensor(target.T, dtype=torch.float32, device=where)
        out = torch.as_tensor(held_out(group, settings.members), device=where)
        held = (out[:, None] & torch.as_tensor(near.T, device=where)).float()
        fitted = torch.as_tensor(group >= 0, device=where) & ~out
        optimiser = torch.optim.AdamW(
            ensemble.parameters(), lr=settings.rate, weight_decay=settings.decay
        )
        least = _held_loss(ensemble, x, y, held)
        best, waited = [b.to(where) for b in best], torch.zeros_like(least)
        for step in range(1, settings.steps + 1):
            rows = torch.randint(len(group), (settings.batch,), generator=generator).to(
                where
            )
            optimiser.zero_grad(set_to_none=True)
            mask = fitted[:, None, rows].float()
            mean, log_variance = ensemble(x[:, rows])
            loss = _likelihood(mean, log_variance, y[:, rows]) * mask
            (loss.sum(dim=2) / mask.sum(dim=2).clamp(min=1.0)).sum().backward()
            optimiser.step()
            if step % EVERY:
                continue
            now = _held_loss(ensemble, x, y, held)
            better = now < least - 1e-4
            least = torch.where(better, now, least)
            waited = torch.where(better, torch.zeros_like(waited), waited + EVERY)
            for kept, parameter in zip(best, ensemble.parameters(), strict=True):
                kept[better] = parameter.detach()[better]
            if bool((waited >= settings.patience).all()):
                break
        with torch.no_grad():
            for kept, parameter in zip(best, ensemble.parameters(), strict=True):
                parameter.copy_(kept)
        return ensemble.arrays()


def held_out(group: np.ndarray, members: int) -> np.ndarray:
    """Rows that each member holds out, boolean, (members, M)."""
    count = int(group.max()) + 1
    return np.stack([group == m % count for m in range(members)])


def _likelihood(
    mean: torch.Tensor, log_variance: torch.Tensor, y: torch.Tensor
) -> torch.Tensor:
    """Negative log-likelihood times variance^beta, (M, n, N). Source: seitzer2022."""
    loss = 0.5 * (log_variance + (y - mean) ** 2 / log_variance.exp())
    return loss * log_variance.detach().exp() ** BETA


def _held_loss(
    ensemble: Ensemble, x: torch.Tensor, y: torch.Tensor, held: torch.Tensor
) -> torch.Tensor:
    """Mean squared error on the rows held out, weighed by ``held`` (M, n, N); (M, n)."""
    with torch.no_grad():
        mean = ensemble(x)[0]
        return ((y - mean) ** 2 * held).sum(dim=2) / held.sum(dim=2).clamp(min=1.0)
