"""Predict the torque that a nominal or corrected arm says would be recorded."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gapscope.arm.case import Case
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording
from gapscope.arm.root_mean_square import rms
from gapscope.diagnosis.gap.predict import predict_torque
from gapscope.interface.models import (
    Model,
    case_of,
    corrected_arm,
    make_arm,
    recording_of,
    say_state,
)
from gapscope.interface.result import TableResult, channel_columns


@dataclass(frozen=True, repr=False)
class Prediction(TableResult):
    """Predicted torque at every sample of a recording, N samples of n joints.

    Attributes:
        recording: name of the recording.
        t: time [s], shape (N,).
        tau: torque [N m], shape (N, n).
    """

    FILE = "prediction.csv"

    recording: str
    t: np.ndarray
    tau: np.ndarray

    def shown(self) -> str:
        """Name, number of samples and RMS of the torque per joint."""
        joints = ", ".join(
            f"J{j} {value:.3g}" for j, value in enumerate(rms(self.tau), 1)
        )
        return f"{self.recording}: {len(self.t)} samples, RMS torque in N m: {joints}"

    def table(self) -> dict[str, np.ndarray]:
        """The columns t, tau1..taun."""
        return channel_columns(self.t, tau=self.tau)


def predict(
    case: Case | NominalArm | str | Path,
    recording: Recording | int | str | Path = 0,
    model: Model = None,
) -> Prediction:
    """Predict the torque that would be recorded, from time, position and known payload alone.

    Args:
        case: the case; or an arm (see ``make_arm``), with a ``Recording`` beside it.
        recording: a recording, or of a case its number from 0 or its name, or the path of a file in its form.
        model: what corrects the nominal arm; see ``Model``.

    Raises:
        InputError: the arm or the model cannot be used.

    Examples:
        >>> import numpy as np, gapscope
        >>> t = np.arange(0.0, 2.0, 0.01)
        >>> q = 0.1 * np.sin(t)[:, None] * np.ones(7)
        >>> case = gapscope.Case.from_arrays("kuka_iiwa", t=t, q=q)
        >>> gapscope.predict(case).tau.shape
        (200, 7)
    """
    if isinstance(recording, Recording):
        chosen, arm = recording, make_arm(case)
    else:
        if isinstance(case, NominalArm):
            raise TypeError(
                "an arm alone has no recordings: give a Recording or a case"
            )
        loaded = case_of(case)
        chosen, arm = recording_of(loaded, recording, every_row=True), loaded.arm
    corrected = corrected_arm(arm, model)
    say_state(corrected, chosen)
    torque = predict_torque(corrected, chosen)
    return Prediction(chosen.name, chosen.stamps, torque)
