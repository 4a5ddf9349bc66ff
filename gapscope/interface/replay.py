"""Replay a recording: the simulated arm, nominal or corrected, under the same commands."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gapscope.arm.case import Case
from gapscope.arm.recording import Recording
from gapscope.diagnosis.prepare import Progress, silent
from gapscope.effects.corrected_file import error_context
from gapscope.envs.engines import check_engine
from gapscope.envs.replay import Replay
from gapscope.envs.replay import replay as replay_recording
from gapscope.interface.models import (
    Model,
    case_of,
    corrected_arm,
    recording_of,
    say_state,
)
from gapscope.interface.result import TableResult, channel_columns
from gapscope.reports.gap import replay_line


@dataclass(frozen=True, repr=False)
class ReplayResult(TableResult):
    """A replayed motion.

    Attributes:
        recording: name of the recording.
        replay: time, position, torque and replay gap.
    """

    FILE = "replay.csv"

    recording: str
    replay: Replay

    @property
    def rmse(self) -> np.ndarray:
        """Replay gap per joint: RMS of replayed minus recorded position [rad], shape (n,)."""
        return self.replay.rmse

    def shown(self) -> str:
        """The replay gap per joint, and what moved the arm."""
        return replay_line(self.replay)

    def table(self) -> dict[str, np.ndarray]:
        """The columns t, q1..qn, tau1..taun."""
        return channel_columns(self.replay.t, q=self.replay.q, tau=self.replay.tau)


def replay(
    case: Case | str | Path,
    recording: Recording | int | str = 0,
    model: Model = None,
    *,
    engine: str | None = None,
    progress: Progress = silent,
) -> ReplayResult:
    """Move the simulated arm under the same commands as a recording.

    The torque of a model's residual network is taken off the command.

    Args:
        case: the case, or its folder.
        recording: a recording, or its number from 0 or its name in the case.
        model: what corrects the nominal arm; see ``Model``.
        engine: ``pybullet`` or ``mujoco``; by default PyBullet if it is installed, else MuJoCo.
        progress: called with a few words at each step.

    Raises:
        InputError: the case or the model cannot be used.
        GapscopeError: the arm cannot be simulated, or diverges.

    Examples:
        >>> import gapscope
        >>> gapscope.replay("my_arm", 0, "out/corrected.yaml").rmse  # doctest: +SKIP
    """
    loaded = case_of(case)
    chosen = recording_of(loaded, recording)
    corrected = corrected_arm(loaded.arm, model)
    say_state(corrected, chosen)
    source = Path(model) if isinstance(model, (str, Path)) else None
    with error_context(source, corrected.effects):
        engine = check_engine(engine)
        progress(f"replays {chosen.duration:.3g} s in {engine}")
        result = replay_recording(
            loaded.arm,
            corrected.effects,
            chosen,
            loaded.controller,
            engine=engine,
            residual=corrected.residual,
            states=corrected.states,
        )
    return ReplayResult(chosen.name, result._replace(t=chosen.stamps))
