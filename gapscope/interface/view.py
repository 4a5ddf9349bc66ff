"""What a recording, the model's prediction and a replay look like together."""

from __future__ import annotations

from pathlib import Path

from gapscope.arm.case import Case
from gapscope.arm.errors import GapscopeError
from gapscope.arm.recording import Recording
from gapscope.interface.models import Model, case_of, recording_of
from gapscope.interface.predict import predict
from gapscope.interface.replay import replay
from gapscope.reports.scene import Scene


def view(
    case: Case | str | Path, recording: Recording | int | str = 0, model: Model = None
) -> tuple[Scene, str]:
    """The scene of a recording, and why it was not replayed, or an empty text.

    Args:
        case: the case, or its folder.
        recording: a recording, or its number from 0 or its name in the case.
        model: what corrects the nominal arm; see ``Model``.

    Raises:
        InputError: the case or the model cannot be used.
    """
    loaded = case_of(case)
    chosen = recording_of(loaded, recording)
    torque = predict(loaded, chosen, model).tau
    scene = Scene(loaded.arm, chosen.t, chosen.q, chosen.tau, torque)
    try:
        moved = replay(loaded, chosen, model).replay
    except GapscopeError as error:
        return scene, str(error)
    return Scene(
        loaded.arm, chosen.t, chosen.q, chosen.tau, torque, chosen.t, moved.q
    ), ""
