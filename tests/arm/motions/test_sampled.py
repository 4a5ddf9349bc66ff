"""A reference motion through samples of a file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gapscope.arm.errors import InputError
from gapscope.arm.io.write_case import write_columns
from gapscope.arm.motions.motion import Motion
from gapscope.arm.motions.sampled import Sampled, read_sampled
from gapscope.arm.motions.trajectory import Fourier, Limits

LIMITS = Limits(np.full(2, -1.0), np.full(2, 1.0), np.full(2, 2.0), np.full(2, 9.0))


def written(path: Path) -> Fourier:
    """A motion of two joints, written every 20 ms."""
    motion, t = (
        Fourier.random(np.random.default_rng(0), LIMITS, duration=4.0, frequency=0.25),
        np.arange(201) / 50,
    )
    series = {
        "q_ref": motion.position(t),
        "dq_ref": motion.velocity(t),
        "ddq_ref": motion.acceleration(t),
    }
    write_columns(
        {
            "t": t,
            **{f"{k}{j + 1}": x for k, a in series.items() for j, x in enumerate(a.T)},
        },
        path,
    )
    return motion


def test_motion_between_the_samples_is_that_of_the_source(tmp_path: Path) -> None:
    source, t = written(tmp_path / "a.csv"), np.linspace(0, 4, 777)
    found = read_sampled(tmp_path / "a.csv", 2)
    np.testing.assert_allclose(found.position(t), source.position(t), atol=1e-7)
    np.testing.assert_allclose(found.velocity(t), source.velocity(t), atol=1e-5)
    np.testing.assert_allclose(found.acceleration(t), source.acceleration(t), atol=1e-2)
    assert found.duration == 4.0


def test_it_rests_outside(tmp_path: Path) -> None:
    found, t = (
        Sampled(
            Motion(np.array([0.0, 1.0]), np.array([[0.0], [1.0]]), *np.ones((2, 2, 1)))
        ),
        np.array([-1.0, 2]),
    )
    np.testing.assert_array_equal(found.position(t), [[0.0], [1.0]])
    np.testing.assert_array_equal(
        [found.velocity(t), found.acceleration(t)], np.zeros((2, 2, 1))
    )


def test_bad_files_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    with pytest.raises(InputError, match="no such file"):
        read_sampled(path, 2)
    written(path)
    with pytest.raises(InputError, match="q_ref3"):
        read_sampled(path, 3)
    text = path.read_text().splitlines()
    path.write_text(
        "\n".join([*text[:5], text[5].replace(text[5].split(",")[1], "nan"), *text[6:]])
    )
    with pytest.raises(InputError, match="line 6"):
        read_sampled(path, 2)
    path.write_text("\n".join([text[0], *text[3:]]))
    with pytest.raises(InputError, match="starts at 0"):
        read_sampled(path, 2)
