"""Training of a residual network by torch: a heteroscedastic ensemble, bitwise repeatable."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
import torch

from gapscope.effects.residual.inputs import Inputs
from gapscope.effects.residual.network import LOG_VARIANCE, Network
from gapscope.ident.residual.folds import Folds
from gapscope.ident.residual.settings import TCN_LAYERS, ResidualSettings

BETA = 0.5
"""Weight of the likelihood's gradient by variance^beta: rows of large variance are not given up early."""
EVERY = 250
"""Steps between two reports of progress."""


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
        width = settings.hidden
        if self.form == "mlp":
            seen = inputs.seen_by_mlp
            sizes = [(len(seen), width), (width, width), (width, 2)]
        else:
            # each layer joins two neighbours of the layer before
            seen = np.arange(inputs.taps * inputs.channels)
            first, last = (2 * inputs.channels, width), (width, 2)
            sizes = [first, *[(2 * width, width)] * (TCN_LAYERS - 1), last]
        self.register_buffer("seen", torch.as_tensor(seen))
        self.weights, self.biases = torch.nn.ParameterList(), torch.nn.ParameterList()
        for k, (fan_in, fan_out) in enumerate(sizes):
            # the head begins near zero: no torque before there is a reason
            gain = (1.0 if k + 1 < len(sizes) else 0.1) / fan_in**0.5
            shape = (settings.members, n, fan_in, fan_out)
            self.weights.append(gain * torch.randn(shape, generator=generator))
            self.biases.append(torch.zeros(settings.members, n, fan_out))

    def forward(self, windows: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Mean and log variance, each (M, n, N), of windows (n, N, taps, C)."""
        n, count = windows.shape[:2]
        flat = windows.reshape(n, count, -1)
        h = (flat[:, :, self.seen] if self.form == "mlp" else flat)[None]
        for weight, bias in zip(self.weights[:-1], self.biases[:-1], strict=True):
            h = h.reshape(h.shape[0], n, -1, weight.shape[2])
            h = torch.tanh(h @ weight + bias[:, :, None])
        h = h.reshape(h.shape[0], n, count, -1)
        outputs = h @ self.weights[-1] + self.biases[-1][:, :, None]
        return outputs[..., 0], outputs[..., 1].clamp(*LOG_VARIANCE)

    def arrays(self) -> Network:
        """The same networks as arrays."""
        weights = tuple(_array(weight) for weight in self.weights)
        biases = tuple(_array(bias) for bias in self.biases)
        return Network(
            form=self.form,
            seen=self.seen.cpu().numpy(),
            weights=weights,
            biases=biases,
        )


def _array(parameter: torch.Tensor) -> np.ndarray:
    return np.asarray(parameter.detach().cpu().double().numpy())


def train(
    settings: ResidualSettings,
    inputs: Inputs,
    windows: np.ndarray,
    folds: Folds,
    progress: Callable[[str], None] = lambda message: None,
) -> Network:
    """Train an ensemble for a fixed number of steps, each member without the rows that it holds out.

    What is held out chooses neither weights nor the end, so that it can judge the members after.

    Args:
        settings: of the training.
        inputs: what the networks see.
        windows: (n, M, taps, C).
        folds: rows and targets of each member.
        progress: called with a few words at times.
    """
    with repeatable(settings.seed) as generator:
        ensemble = Ensemble(settings, inputs, generator)
        where = device()
        ensemble.to(where)

        def tensor(array: np.ndarray) -> torch.Tensor:
            return torch.as_tensor(array, dtype=torch.float32, device=where)

        x = tensor(windows)
        y = tensor(folds.targets.transpose(0, 2, 1))
        square = tensor(folds.weight.T**2)
        fitted = tensor(folds.fitted)[:, None] * square
        optimiser = torch.optim.AdamW(
            ensemble.parameters(), lr=settings.rate, weight_decay=settings.decay
        )
        schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, settings.steps)
        for step in range(1, settings.steps + 1):
            rows = torch.randint(x.shape[1], (settings.batch,), generator=generator)
            rows = rows.to(where)
            optimiser.zero_grad(set_to_none=True)
            mask = fitted[:, :, rows]
            mean, log_variance = ensemble(x[:, rows])
            loss = _likelihood(mean, log_variance, y[:, :, rows]) * mask
            # mean over the rows that a member is fitted to, sum over members and joints
            mean_loss = loss.sum(dim=2) / mask.sum(dim=2).clamp(min=1e-9)
            mean_loss.sum().backward()
            optimiser.step()
            schedule.step()
            if step % EVERY == 0:
                progress(
                    f"trains the {settings.form.upper()}: step {step} of {settings.steps}"
                )
        return ensemble.arrays()


def _likelihood(
    mean: torch.Tensor, log_variance: torch.Tensor, y: torch.Tensor
) -> torch.Tensor:
    """Negative log-likelihood times variance^beta, (M, n, N). Source: seitzer2022."""
    loss = 0.5 * (log_variance + (y - mean) ** 2 / log_variance.exp())
    return loss * log_variance.detach().exp() ** BETA
