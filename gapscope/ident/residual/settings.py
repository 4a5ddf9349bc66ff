"""How a residual network is trained."""

from __future__ import annotations

from dataclasses import dataclass

from gapscope.arm.errors import InputError
from gapscope.effects.residual.network import ADDITIVE, FORMS

TCN_LAYERS = 3
"""Layers of the convolution; each doubles the samples that are seen."""
PAST_OF_MLP = 4
"""Samples in the window of the feed-forward network."""
BEST = "best"
"""The form that is chosen per joint on held-out data."""
APART = ("all", "effects")
"""What a network can be kept apart from."""


@dataclass(frozen=True)
class ResidualSettings:
    """Settings of a training.

    Attributes:
        form: ``additive``, ``mlp`` or ``tcn``; or ``best``: additive and MLP are trained, and each joint gets the one
            that predicts best what was held out.
        apart: what the output is kept apart from: ``all`` that inertial parameters, friction, rotors, offsets and
            effects can explain, or the parameters of the ``effects`` alone.
        members: networks in the ensemble, 3 to 5.
        hidden: units in a hidden layer.
        spacing: time between the samples of a window [s].
        steps: of the optimiser.
        batch: rows in a step.
        rate: of learning, by AdamW [1].
        decay: of the weights [1].
        bound: largest torque, over the largest residual seen in training [1].
        seed: of weights and batches.
    """

    form: str = BEST
    apart: str = "all"
    members: int = 5
    hidden: int = 24
    spacing: float = 0.02
    steps: int = 1000
    batch: int = 128
    rate: float = 4e-3
    decay: float = 1.0
    bound: float = 1.0
    seed: int = 0

    def __post_init__(self) -> None:
        """Check what must be one of a few."""
        for name, value, known in (
            ("form", self.form, (BEST, *FORMS)),
            ("apart", self.apart, APART),
        ):
            if value not in known:
                raise InputError(
                    f"{value!r} is not known",
                    f"choose {' or '.join(known)}",
                    where=name,
                )
        if not 3 <= self.members <= 5:
            raise InputError(
                f"an ensemble of {self.members} members",
                "choose 3 to 5",
                where="members",
            )

    @property
    def forms(self) -> tuple[str, ...]:
        """What is trained."""
        return (ADDITIVE, "mlp") if self.form == BEST else (self.form,)

    @property
    def taps(self) -> int:
        """Samples in a window."""
        return int(2**TCN_LAYERS if self.form == "tcn" else PAST_OF_MLP)
