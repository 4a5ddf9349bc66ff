"""What is installed and whether engines agree, as the command says it."""

from __future__ import annotations

from importlib import metadata

import numpy as np
import pytest

from gapscope import installation
from gapscope.cli import main
from gapscope.envs.engines import mujoco


def doctor(capsys: pytest.CaptureFixture[str]) -> tuple[int, str]:
    """Exit code and output of the command."""
    with pytest.raises(SystemExit) as ended:
        main(["doctor"])
    return int(ended.value.code or 0), capsys.readouterr().out


def test_a_machine_in_order_is_said_to_be(capsys):
    code, out = doctor(capsys)
    assert code == 0, out
    assert "mujoco: agrees with pinocchio" in out and "numpy" in out


def test_a_missing_extra_comes_with_its_remedy(capsys, monkeypatch):
    real = metadata.version

    def without_ray(name: str) -> str:
        if name == "ray":
            raise metadata.PackageNotFoundError(name)
        return real(name)

    monkeypatch.setattr(installation.metadata, "version", without_ray)
    ray = next(p for p in installation.packages() if p.name == "ray")
    assert ray.version is None and ray.remedy == "pip install 'gapscope[cluster]'"
    assert doctor(capsys)[0] == 0


def test_an_engine_that_moves_otherwise_is_told(capsys, monkeypatch):
    for name in ("step", "run"):
        right = getattr(mujoco.MuJoCoBodies, name)

        def wrong(self, torque: np.ndarray, *more, right=right, **named) -> None:
            right(self, 1.01 * torque, *more, **named)

        monkeypatch.setattr(mujoco.MuJoCoBodies, name, wrong)
    code, out = doctor(capsys)
    assert code == 1 and "mujoco: DOES NOT AGREE" in out
