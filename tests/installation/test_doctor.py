"""What is installed and whether engines agree, as the command says it."""

from __future__ import annotations

from importlib import metadata

import numpy as np

from gapscope import installation
from gapscope.envs.engines import mujoco


def test_a_machine_in_order_is_said_to_be(command):
    done = command("doctor")
    assert done.code == 0, done.out
    assert "mujoco: agrees with pinocchio" in done.out and "numpy" in done.out


def test_a_missing_extra_comes_with_its_remedy(command, monkeypatch):
    real = metadata.version

    def without_ray(name: str) -> str:
        if name == "ray":
            raise metadata.PackageNotFoundError(name)
        return real(name)

    monkeypatch.setattr(installation.metadata, "version", without_ray)
    ray = next(p for p in installation.packages() if p.name == "ray")
    assert ray.version is None and ray.remedy == "pip install 'gapscope[cluster]'"
    assert command("doctor").code == 0


def test_an_engine_that_moves_otherwise_is_told(command, monkeypatch):
    for name in ("step", "run"):
        right = getattr(mujoco.MuJoCoBodies, name)

        def wrong(self, torque: np.ndarray, *more, right=right, **named) -> None:
            right(self, 1.01 * torque, *more, **named)

        monkeypatch.setattr(mujoco.MuJoCoBodies, name, wrong)
    done = command("doctor")
    assert done.code == 1 and "mujoco: DOES NOT AGREE" in done.out
