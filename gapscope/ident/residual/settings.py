"""How a residual network is trained."""

from __future__ import annotations

from dataclasses import dataclass

from gapscope.arm.errors import InputError
from gapscope.effects.residual.network import FORMS

TCN_LAYERS = 3
"""Layers of the convolution; each doubles the samples that are seen."""
PAST_OF_MLP = 4
"""Samples in the window of the feed-forward network."""


@dataclass(frozen=True)
class ResidualSettings:
    """Settings of a training.

    Attributes:
        form: ``mlp`` or ``tcn``.
        members: networks in the ensemble, 3 to 5.
        hidden: units in a hidden layer.
        spacing: time between the samples of a window [s].
        steps: of the optimiser, at most.
        patience: steps without a smaller held-out error after which training ends.
        batch: rows in a step.
        rate: of learning, by AdamW [1].
        decay: of the weights [1].
        bound: largest torque, over the largest residual seen in training [1].
        seed: of weights and batches.
    """

    form: str = "mlp"
    members: int = 4
    hidden: int = 24
    spacing: float = 0.02
    steps: int = 2000
    patience: int = 600
    batch: int = 128
    rate: float = 4e-3
    decay: float = 1.0
    bound: float = 1.0
    seed: int = 0

    def __post_init__(self) -> None:
        """Check what must be one of a few."""
        if self.form not in FORMS:
            raise InputError(
                f"{self.form!r} is no form of network",
                f"choose {' or '.join(FORMS)}",
                where="form",
            )
        if not 3 <= self.members <= 5:
            raise InputError(
                f"an ensemble of {self.members} members",
                "choose 3 to 5",
                where="members",
            )

    @property
    def taps(self) -> int:
        """Samples in a window."""
        return int(2**TCN_LAYERS if self.form == "tcn" else PAST_OF_MLP)
