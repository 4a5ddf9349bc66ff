"""States and friction together: friction that differs from where the filter starts is found."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gapscope.arm.case import Case
from gapscope.arm.errors import InputError
from gapscope.effects.applied import AppliedEffect
from gapscope.ident.identification import IdentificationSettings, identify
from gapscope.ident.kalman.states_and_friction import follow_states


def test_friction_moves_to_that_of_the_recording(world) -> None:
    more = AppliedEffect("viscous_friction", (2,), {"coefficient": [1.2]})
    recording = world.recorded(3, effects=(more,), duration=4.0)
    nominal = dict(
        zip(world.regressor.names, world.regressor.nominal().tolist(), strict=True)
    )
    found = follow_states(world.arm, recording, nominal, np.full(3, 0.1))
    assert found.names == ("b1", "b2", "b3", "c1", "c2", "c3")
    b2 = found.friction[-1, 1]
    assert abs(b2 - 5.2) < 0.5


def test_what_it_cannot_follow_is_refused(world) -> None:
    recording = world.recorded(1, duration=2.5)
    with pytest.raises(InputError, match="no torque"):
        follow_states(world.arm, replace(recording, tau=None), {}, np.ones(3))
    coupled = replace(world.arm, coupling=np.array([[1.0, 0, 0], [0, 1, 0], [0, 1, 1]]))
    with pytest.raises(InputError, match="several joints"):
        follow_states(coupled, recording, {}, np.ones(3))


def test_an_unknown_filter_is_named(world, tmp_path) -> None:
    case = Case("c", tmp_path, world.arm, (world.recorded(1, duration=2.5),))
    with pytest.raises(InputError, match="unknown filter 'magic'"):
        identify(case, IdentificationSettings(filter="magic"))
