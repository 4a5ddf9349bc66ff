"""An exciting trajectory into files: CSV in the columns of the case format, and a ROS ``JointTrajectory``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import yaml

from gapscope.arm.errors import InputError
from gapscope.arm.io.atomic_write import atomic_write
from gapscope.arm.io.write_case import write_columns
from gapscope.arm.motions.motion import Motion
from gapscope.arm.motions.sampled import Sampled

ROS_RATE = 100.0
"""Points per second of a ``JointTrajectory``, about [Hz]; controllers interpolate between them."""
POINTS_PER_PERIOD = 25.0
"""Points per period of the highest frequency at least, if there are as many samples [1]."""


def write_csv(motion: Motion, path: Path) -> None:
    """Write ``t``, ``q_ref1..``, ``dq_ref1..`` and ``ddq_ref1..``, without loss.

    Raises:
        GapscopeError: the file cannot be written.
    """
    columns = {"t": motion.t}
    series = {"q_ref": motion.q, "dq_ref": motion.dq, "ddq_ref": motion.ddq}
    for name, array in series.items():
        for joint, values in enumerate(array.T, 1):
            columns[f"{name}{joint}"] = values
    write_columns(columns, path)


def write_joint_trajectory(
    motion: Motion, joints: Sequence[str], path: Path, rate: float = ROS_RATE
) -> None:
    """Write a ``trajectory_msgs/JointTrajectory`` as YAML, as ``ros2 topic pub`` and controllers take it.

    Positions, velocities and accelerations at about ``rate`` points per second, first and last sample included.

    Raises:
        InputError: the number of names is not that of the joints.
        GapscopeError: the file cannot be written.
    """
    if len(joints) != motion.q.shape[1]:
        raise InputError(
            f"{len(joints)} names for {motion.q.shape[1]} joints", where="joints"
        )
    last = len(motion.t) - 1
    step = max(1, round(motion.rate / rate))
    rows = np.unique([*range(0, last + 1, step), last])
    lines = [
        "header: {stamp: {sec: 0, nanosec: 0}, frame_id: ''}",
        f"joint_names: [{', '.join(map(_quoted, joints))}]",
        "points:",
    ]
    for i in rows:
        nanoseconds = round(float(motion.t[i]) * 1e9)
        sec, nanosec = divmod(nanoseconds, 10**9)
        lines += [
            f"- positions: {_numbers(motion.q[i])}",
            f"  velocities: {_numbers(motion.dq[i])}",
            f"  accelerations: {_numbers(motion.ddq[i])}",
            "  effort: []",
            f"  time_from_start: {{sec: {sec}, nanosec: {nanosec}}}",
        ]
    with atomic_write(path) as aside:
        aside.write_text("\n".join(lines) + "\n", encoding="utf-8")


def read_joint_trajectory(path: Path) -> Sampled:
    """The reference motion of a file that ``write_joint_trajectory`` wrote."""
    loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
    points = yaml.load(path.read_text(encoding="utf-8"), loader)["points"]
    stamps = [point["time_from_start"] for point in points]
    t = np.array([stamp["sec"] + 1e-9 * stamp["nanosec"] for stamp in stamps])
    series = (
        np.array([point[key] for point in points])
        for key in ("positions", "velocities", "accelerations")
    )
    return Sampled(Motion(t, *series))


def _numbers(values: np.ndarray) -> str:
    return "[" + ", ".join(f"{value + 0.0:.9f}" for value in values.round(9)) + "]"


def _quoted(name: str) -> str:
    return "'" + name.replace("'", "''") + "'"
