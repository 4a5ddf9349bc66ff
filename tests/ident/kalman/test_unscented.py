"""The unscented filter over state and parameters."""

from dataclasses import replace

import numpy as np
import pytest

from gapscope.arm.errors import InputError
from gapscope.arm.known_load import KnownLoad
from gapscope.ident.kalman.unscented import Unscented
from gapscope.ident.model.regressor import Regressor

PAYLOAD = ("m3", "mx3", "my3", "mz3")


def unscented(world, names=PAYLOAD, spread=(0.3, 0.02, 0.02, 0.02)):
    spread = np.array(spread)
    return Unscented(world.regressor, names, spread, spread, 3e-5, np.full(3, 0.5))


@pytest.mark.slow
def test_a_payload_shows_in_the_parameters_soon_after_it_was_picked_up(world):
    recording = world.recorded(3, pickup=(3.0, 2.0), duration=5.0)
    track = unscented(world).follow(recording, every=2)
    mass, deviation = track.of("m3")
    assert np.abs(mass[(track.t > 1) & (track.t < 3.0)]).max() < 0.5
    assert mass[track.t > 3.5] == pytest.approx(2.0, abs=0.5)
    assert abs(mass[-1] - 2.0) < 4 * deviation[-1]
    assert track.value[:, :3] == pytest.approx(recording.q[::2], abs=5e-4)


@pytest.mark.slow
def test_velocity_follows_without_differentiating(world):
    recording = world.recorded(4, duration=3.0)
    track = unscented(world, ("b2",), (0.5,)).follow(recording)
    late = track.t > 0.5
    smooth = np.gradient(recording.q, recording.t, axis=0)
    assert track.value[late, 3:6] == pytest.approx(smooth[late], abs=0.05)
    assert track.of("b2")[0][-1] == pytest.approx(0.0, abs=3 * track.of("b2")[1][-1])


def test_what_does_not_fit_is_named(world):
    with pytest.raises(InputError, match="m9 is no parameter"):
        unscented(world, ("m9",), (1.0,))
    with pytest.raises(InputError, match="one per name"):
        unscented(world, ("m3", "b1"), (1.0,))
    with pytest.raises(InputError, match="columns of all quantities"):
        Unscented(
            Regressor(world.arm, quantities=()),
            ("m3",),
            np.ones(1),
            np.ones(1),
            1e-5,
            np.ones(3),
        )
    with pytest.raises(InputError, match="no torque"):
        unscented(world).follow(replace(world.recorded(1, duration=2.5), tau=None))
    with pytest.raises(InputError, match="known payload"):
        unscented(world).follow(
            replace(world.recorded(1, duration=2.5), payload=KnownLoad(1.0))
        )
