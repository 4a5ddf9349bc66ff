"""A two-joint arm with friction in its URDF, and a recording of it."""

from __future__ import annotations

import csv
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from arms import Link, written
from cases import to_and_fro

from gapscope.arm.io.load_recording import load_recording
from gapscope.arm.io.write_case import write_recording
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording
from gapscope.arm.robots import load_nominal_arm


def link(joint: str, name: str, damping: float, friction: float) -> Link:
    return Link(
        joint,
        name,
        mass=1,
        com="0 0 0.2",
        inertia="0.1 0.1 0.1",
        limit="-2 2 10 3",
        more=f'<dynamics damping="{damping}" friction="{friction}"/>',
    )


LINKS = (link("shoulder", "upper", 0.5, 0.25), link("elbow", "lower", 0.1, 0))


@pytest.fixture
def urdf(tmp_path: Path) -> Path:
    """URDF of the two-joint arm."""
    return written(tmp_path / "robot.urdf", "two", *LINKS)


@pytest.fixture(scope="session")
def arm(tmp_path_factory: pytest.TempPathFactory) -> NominalArm:
    """The two-joint arm."""
    file = tmp_path_factory.mktemp("two") / "robot.urdf"
    return load_nominal_arm(written(file, "two", *LINKS))


@pytest.fixture(scope="session")
def recording() -> Recording:
    """Two seconds at 100 Hz with every channel, both joints moving to and fro."""
    t = np.arange(200) / 100
    q, dq = to_and_fro(t)
    noise = np.random.default_rng(1).normal(size=(200, 2))
    return Recording(
        "motion.csv",
        t,
        q,
        dq + noise,
        dq,
        q + 0.01,
        dq + 0.01,
        dq + 2 * noise,
        30 + 0.1 * noise,
    )


Load = Callable[..., Recording]


@pytest.fixture
def load(arm: NominalArm, tmp_path: Path) -> Load:
    """What is read of the two-joint arm from a file of that content: a recording, columns, rows of cells, or bytes."""

    def of(content: Any, name: str = "log.csv", **how: Any) -> Recording:
        path = tmp_path / name
        if isinstance(content, Recording):
            write_recording(content, path)
        elif path.suffix == ".npz":
            np.savez(path, **content)
        elif isinstance(content, bytes):
            path.write_bytes(content)
        else:
            columns = content if isinstance(content, dict) else {}
            rows = (
                [columns, *zip(*columns.values(), strict=True)] if columns else content
            )
            with path.open("w", newline="") as file:
                csv.writer(file).writerows(rows)
        return load_recording(path, arm, **how)

    return of
