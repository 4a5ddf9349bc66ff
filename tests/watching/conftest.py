"""A small arm at work, whose samples the tests hand to a watch."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.io.table import numbered
from gapscope.arm.io.write_case import write_columns
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording
from gapscope.arm.robots import load_nominal_arm
from gapscope.blind_check.generator.arms import draw_arm

RATE = 100.0
WARMS_UP = 300.0
"""Time constant with which friction falls on a cold arm at work [s]."""


@dataclass(frozen=True)
class AtWork:
    """Recordings of a small arm whose true friction is arctan-shaped."""

    arm: NominalArm
    change: float = 46.0
    """When something changes [s]."""

    def coldness(self, t: np.ndarray) -> np.ndarray:
        """How cold the joints are at times [s], if they have cooled down before the change [1]."""
        since = np.maximum(t - self.change, 0.0)
        return np.exp(-since / WARMS_UP) * (t >= self.change)

    def recording(
        self,
        seconds: float,
        *,
        load: float = 0.0,
        friction: float = 1.0,
        shaking: float = 0.0,
        late: float = 0.0,
        start: float = 0.0,
        rising: float = 0.0,
        cold: float = 0.0,
    ) -> Recording:
        """A recording in which something sets in.

        Args:
            seconds: it lasts.
            load: on the last link [kg].
            friction: factor on that of joint 2 [1].
            shaking: noise of joint 1 [N m].
            late: delay of the torque [s].
            start: of its time [s].
            rising: time that the friction of joint 2 takes to have that factor [s].
            cold: share by which all friction is higher from the change on, until the joints have warmed up [1].
        """
        rng = np.random.default_rng(3)
        n = self.arm.n_joints
        t = start + np.arange(round(seconds * RATE)) / RATE
        rate = 2 * np.pi * rng.uniform(0.08, 0.35, (n, 3))
        size = rng.uniform(0.15, 0.35, (n, 3))
        angle = t[:, None, None] * rate + rng.uniform(0, 6, (n, 3))
        q = (size * np.sin(angle)).sum(axis=2)
        dq = (size * rate * np.cos(angle)).sum(axis=2)
        ddq = -(size * rate**2 * np.sin(angle)).sum(axis=2)
        body = RigidBody(self.arm)
        after = t >= self.change
        tau = body.inverse_dynamics(q, dq, ddq) + self.arm.armature * ddq
        columns = body.link_regressor(body.last_link, q, dq, ddq)
        one = np.r_[load, 0.0, 0.0, 0.08 * load, np.zeros(6)]
        tau[after] += columns[after] @ one
        dry = 1.1 * self.arm.coulomb * 2 / np.pi * np.arctan(dq / 0.004)
        rubbing = dry + self.arm.viscous * dq
        risen = np.clip((t - self.change) / max(rising, 1e-9), 0.0, 1.0)
        rubbing[:, 1] *= 1.0 + (friction - 1.0) * risen
        rubbing *= 1.0 + cold * self.coldness(t)[:, None]
        noise = 0.03 * self.arm.coulomb * rng.standard_normal(tau.shape)
        wild = np.random.default_rng(4).standard_normal(len(t))
        noise[after, 0] += shaking * wild[after]
        q = q + 1e-5 * rng.standard_normal(q.shape)
        tau = tau + rubbing + noise
        tau[after] = np.roll(tau, round(late * RATE), axis=0)[after]
        return Recording("shift.csv", t, q, tau=tau)


@pytest.fixture(scope="session")
def at_work(tmp_path_factory: pytest.TempPathFactory) -> AtWork:
    drawn = draw_arm("small", np.random.default_rng(1))
    urdf = tmp_path_factory.mktemp("small_arm") / "robot.urdf"
    urdf.write_text(drawn.urdf, encoding="utf-8")
    keys = ("armature", "coulomb", "viscous")
    sheet = {key: getattr(drawn, key).tolist() for key in keys}
    return AtWork(load_nominal_arm(urdf, sheet=sheet))


@pytest.fixture(scope="session")
def write_csv() -> Callable[[Recording, Path], Path]:
    """Writes a recording in the columns of the case format."""

    def write(recording: Recording, file: Path) -> Path:
        series = {"t": recording.t, "q": recording.q, "tau": np.asarray(recording.tau)}
        write_columns(numbered(series), file)
        return file

    return write
