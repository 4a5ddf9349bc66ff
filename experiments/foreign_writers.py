"""Writers of logs by other programs than Gapscope, for 33_formats.py; imports nothing of Gapscope.

Writers whose library is not among Gapscope's dependencies run in an environment of their own:

    PYTHON experiments/foreign_writers.py lerobot MOTION.npz OUT

The motion is an NPZ with t (N,), q, dq, q_ref, dq_ref and tau (N, n) in SI units, and names (n,).
"""

from __future__ import annotations

import csv
import json
import sqlite3
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

Motion = Mapping[str, np.ndarray]

EPOCH = 1_700_000_000
"""Start of the motion [s since 1970]."""
CONSTANT, GEAR = 0.12, 101.0
"""Motor constant [N m/A] and gear ratio [1] by which torques become currents."""

CONTROLLER_STATE = "control_msgs/msg/JointTrajectoryControllerState"
_POINT = "trajectory_msgs/JointTrajectoryPoint"
_MULTI = "trajectory_msgs/MultiDOFJointTrajectoryPoint"
_HEADER = "std_msgs/Header header\nstring[] joint_names\n"
_NEW = ("reference", "feedback", "error", "output")
JAZZY = (
    _HEADER
    + "".join(f"{_POINT} {name}\n" for name in _NEW)
    + "string[] multi_dof_joint_names\n"
    + "".join(f"{_MULTI} multi_dof_{name}\n" for name in _NEW)
    + "float64 speed_scaling_factor\n"
)
FOXY = _HEADER + "".join(
    f"{_POINT} {name}\n" for name in ("desired", "actual", "error")
)


def write_table(
    path: Path, columns: Mapping[str, np.ndarray], delimiter: str = ","
) -> None:
    """Text table with one column per joint: ``name{}`` stands for the joint's number from 0 or, with {1}, from 1."""
    names = []
    series = []
    for pattern, values in columns.items():
        array = values[:, None] if values.ndim == 1 else values
        for j in range(array.shape[1]):
            names.append(pattern.format(j, j + 1))
            series.append(array[:, j])
    with path.open("w", newline="") as file:
        writer = csv.writer(file, delimiter=delimiter)
        writer.writerow(names)
        writer.writerows(np.column_stack(series).tolist())


def rtde(motion: Motion, path: Path) -> None:
    """Columns and spaces of the recorder of Universal Robots' RTDE client library."""
    current = motion["tau"] / CONSTANT / GEAR
    columns = {
        "timestamp": motion["t"] + 5000,
        "target_q_{}": motion["q_ref"],
        "target_qd_{}": motion["dq_ref"],
        "actual_q_{}": motion["q"],
        "actual_qd_{}": motion["dq"],
        "actual_current_{}": current,
        "joint_temperatures_{}": 30 + 0 * current,
    }
    write_table(path, columns, " ")


def nist(motion: Motion, path: Path) -> None:
    """Columns of the UR5 degradation measurements."""
    current = motion["tau"] / CONSTANT / GEAR
    degrees = {
        name: np.rad2deg(motion[name]) for name in ("q", "dq", "q_ref", "dq_ref")
    }
    columns = {
        "ROBOT_TIME": motion["t"],
        "ROBOT_TARGET_JOINT_POSITIONS (J{1})": degrees["q_ref"],
        "ROBOT_ACTUAL_JOINT_POSITIONS (J{1})": degrees["q"],
        "ROBOT_TARGET_JOINT_VELOCITIES (J{1})": degrees["dq_ref"],
        "ROBOT_ACTUAL_JOINT_VELOCITIES (J{1})": degrees["dq"],
        "ROBOT_ACTUAL_JOINT_CURRENTS (J{1})": current,
        "ROBOT_JOINT_TEMP (J{1})": 28 + 0 * current,
    }
    write_table(path, columns)


def libfranka(motion: Motion, path: Path) -> None:
    """Columns of franka::logToCSV."""
    columns = {
        "time": np.round(motion["t"] * 1000),
        " success_rate": 1 + 0 * motion["t"],
        " state.q[{}]": motion["q"],
        "state.q_d[{}]": motion["q_ref"],
        "state.dq[{}]": motion["dq"],
        "state.dq_d[{}]": motion["dq_ref"],
        "state.tau_J[{}]": motion["tau"],
        "state.tau_ext_hat_filtered[{}]": 0 * motion["tau"],
        "cmd.tau_J_d[{}]": 0 * motion["tau"],
    }
    write_table(path, columns)


def kortex(motion: Motion, path: Path) -> None:
    """Fields of the cyclic feedback of Kinova's Kortex, positions from 0 to 360 degrees."""
    columns = {
        "timestamp": motion["t"],
        "position_{}": np.mod(np.rad2deg(motion["q"]), 360),
        "velocity_{}": np.rad2deg(motion["dq"]),
        "torque_{}": motion["tau"],
        "current_motor_{}": motion["tau"] / CONSTANT / GEAR,
        "temperature_motor_{}": 40 + 0 * motion["tau"],
    }
    write_table(path, columns)


def hdf5(motion: Motion, path: Path) -> None:
    """Arrays in a group, the joints along the first axis, by h5py."""
    import h5py

    with h5py.File(path, "w") as file:
        file["robot/t"] = motion["t"]
        file["robot/q"] = motion["q"].T
        file["robot/tau"] = motion["tau"].T
        file["robot/command"] = motion["q_ref"].T
        file["robot/name"] = "arm"


def matlab(motion: Motion, path: Path) -> None:
    """Nested structures by scipy.io.savemat."""
    import scipy.io

    joints = {name: motion[name] for name in ("q", "tau", "q_ref")}
    log = {"t": motion["t"], "joints": joints, "rate": 250.0}
    scipy.io.savemat(path, {"log": log}, do_compression=True)


def _point(store: Any, **fields: np.ndarray) -> Any:
    types = store.types
    names = ("positions", "velocities", "accelerations", "effort")
    arrays = {name: np.asarray(fields.get(name, []), dtype=float) for name in names}
    due = types["builtin_interfaces/msg/Duration"](sec=0, nanosec=0)
    kind = types["trajectory_msgs/msg/JointTrajectoryPoint"]
    return kind(**arrays, time_from_start=due)


def rosbag(motion: Motion, folder: Path, mcap: bool) -> None:
    """Joint states, and at half the rate the state of a controller, by the writer of rosbags.

    MCAP with the newest definition of the controller's state; SQLite with the oldest, and without definitions.
    """
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg(JAZZY if mcap else FOXY, CONTROLLER_STATE))
    types, names = store.types, [str(name) for name in motion["names"]]
    plugin = StoragePlugin.MCAP if mcap else StoragePlugin.SQLITE3
    multi = types["trajectory_msgs/msg/MultiDOFJointTrajectoryPoint"]
    due = types["builtin_interfaces/msg/Duration"](sec=0, nanosec=0)
    empty = multi(transforms=[], velocities=[], accelerations=[], time_from_start=due)
    with Writer(folder, version=9, storage_plugin=plugin) as writer:
        joint_states = writer.add_connection(
            "/joint_states", "sensor_msgs/msg/JointState", typestore=store
        )
        controller = writer.add_connection(
            "/arm_controller/state", CONTROLLER_STATE, typestore=store
        )
        for i, t in enumerate(motion["t"]):
            whole = EPOCH * 10**9 + round(t * 1e9)
            stamp = types["builtin_interfaces/msg/Time"](
                sec=whole // 10**9, nanosec=whole % 10**9
            )
            header = types["std_msgs/msg/Header"](stamp=stamp, frame_id="")
            state = types["sensor_msgs/msg/JointState"](
                header=header,
                # drivers sort joints by name
                name=names[::-1],
                position=motion["q"][i, ::-1].copy(),
                velocity=motion["dq"][i, ::-1].copy(),
                effort=motion["tau"][i, ::-1].copy(),
            )
            raw = store.serialize_cdr(state, "sensor_msgs/msg/JointState")
            writer.write(joint_states, whole + 300_000, raw)
            if i % 2:
                continue
            asked = _point(
                store, positions=motion["q_ref"][i], velocities=motion["dq_ref"][i]
            )
            got = _point(store, positions=motion["q"][i], velocities=motion["dq"][i])
            points = {"error": _point(store)}
            if mcap:
                points |= {"reference": asked, "feedback": got, "output": _point(store)}
                points |= {f"multi_dof_{name}": empty for name in _NEW}
                points |= {"multi_dof_joint_names": [], "speed_scaling_factor": 1.0}
            else:
                points |= {"desired": asked, "actual": got}
            message = types[CONTROLLER_STATE](
                header=header, joint_names=names, **points
            )
            raw = store.serialize_cdr(message, CONTROLLER_STATE)
            writer.write(controller, whole + 500_000, raw)
    if not mcap:
        # what ROS 2 before Iron stores: no definitions of messages
        with sqlite3.connect(next(folder.glob("*.db3"))) as content:
            content.execute("DELETE FROM message_definitions")


def mcap_ros2(motion: Motion, path: Path) -> None:
    """The state of a controller alone, with the torque as its output, by the package mcap-ros2-support."""
    from mcap_ros2.writer import Writer

    separator = "=" * 80
    parts = {
        "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id",
        "builtin_interfaces/Time": "int32 sec\nuint32 nanosec",
        "builtin_interfaces/Duration": "int32 sec\nuint32 nanosec",
        _POINT: "float64[] positions\nfloat64[] velocities\nfloat64[] accelerations\nfloat64[] effort\n"
        "builtin_interfaces/Duration time_from_start",
        _MULTI: "geometry_msgs/Transform[] transforms\ngeometry_msgs/Twist[] velocities\n"
        "geometry_msgs/Twist[] accelerations\nbuiltin_interfaces/Duration time_from_start",
        "geometry_msgs/Transform": "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation",
        "geometry_msgs/Twist": "geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular",
        "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z",
        "geometry_msgs/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w",
    }
    text = JAZZY + "".join(
        f"{separator}\nMSG: {name}\n{body}\n" for name, body in parts.items()
    )
    names = [str(name) for name in motion["names"]]
    zero = {"sec": 0, "nanosec": 0}
    nothing = {"time_from_start": zero}
    nothing |= {"transforms": [], "velocities": [], "accelerations": []}

    def point(**fields: Sequence[float]) -> dict[str, Any]:
        kinds = ("positions", "velocities", "accelerations", "effort")
        return {kind: list(fields.get(kind, [])) for kind in kinds} | {
            "time_from_start": zero
        }

    with path.open("wb") as file:
        writer = Writer(file)
        schema = writer.register_msgdef(CONTROLLER_STATE, text)
        for i, t in enumerate(motion["t"]):
            whole = EPOCH * 10**9 + round(t * 1e9)
            stamp = {"sec": whole // 10**9, "nanosec": whole % 10**9}
            message = {
                "header": {"stamp": stamp, "frame_id": ""},
                "joint_names": names,
                "reference": point(
                    positions=motion["q_ref"][i], velocities=motion["dq_ref"][i]
                ),
                "feedback": point(positions=motion["q"][i], velocities=motion["dq"][i]),
                "error": point(),
                "output": point(effort=motion["tau"][i]),
                "multi_dof_joint_names": [],
                "speed_scaling_factor": 1.0,
            } | {f"multi_dof_{name}": nothing for name in _NEW}
            writer.write_message(
                "/arm_controller/controller_state", schema, message, whole, whole
            )
        writer.finish()


def lerobot(motion: Motion, folder: Path) -> None:
    """A dataset of two episodes in degrees, with effort, by LeRobotDataset itself."""
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    names = [f"{name}.pos" for name in motion["names"]]
    feature = {"dtype": "float32", "shape": (len(names),), "names": names}
    keys = ("observation.state", "action", "observation.effort")
    dataset = LeRobotDataset.create(
        repo_id="formats/motion",
        fps=round(1 / float(np.median(np.diff(motion["t"])))),
        root=folder,
        features={key: dict(feature) for key in keys},
        robot_type="arm",
        use_videos=False,
    )
    half = len(motion["t"]) // 2
    for rows in (slice(0, half), slice(half, 2 * half)):
        state, action = np.rad2deg(motion["q"][rows]), np.rad2deg(motion["q_ref"][rows])
        for values in zip(state, action, motion["tau"][rows], strict=True):
            frame = {
                key: value.astype(np.float32)
                for key, value in zip(keys, values, strict=True)
            }
            dataset.add_frame({**frame, "task": "move"})
        dataset.save_episode()
    dataset.finalize()


def lerobot_normalised(motion: Motion, folder: Path) -> None:
    """A dataset laid out as version 2.1, normalised, with the arm's calibration beside it; by PyArrow."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    names = [str(name) for name in motion["names"]]
    n, count = len(names), len(motion["t"])
    low, high = 500.0, 3700.0
    to_normalised = 100 / ((high - low) / 2 / 4096 * 2 * np.pi)
    series = {
        "observation.state": motion["q"] * to_normalised,
        "action": motion["q_ref"] * to_normalised,
        "observation.effort": motion["tau"],
    }
    feature = {"dtype": "float32", "shape": [n], "names": {"motors": names}}
    info = {
        "codebase_version": "v2.1",
        "fps": round(1 / float(np.median(np.diff(motion["t"])))),
        "features": {key: feature for key in series},
    }
    (folder / "meta").mkdir(parents=True)
    (folder / "meta" / "info.json").write_text(json.dumps(info))
    chunk = folder / "data" / "chunk-000"
    chunk.mkdir(parents=True)
    columns = {
        key: pa.array(list(x.astype(np.float32)), type=pa.list_(pa.float32(), n))
        for key, x in series.items()
    }
    columns["timestamp"] = pa.array(motion["t"].astype(np.float32))
    columns["frame_index"] = pa.array(np.arange(count))
    columns["episode_index"] = pa.array(np.zeros(count, dtype=int))
    pq.write_table(pa.table(columns), chunk / "episode_000000.parquet")
    motor = {"id": 1, "drive_mode": 0, "homing_offset": 0}
    motor |= {"range_min": low, "range_max": high}
    calibration = folder.parent / "my_arm.json"
    calibration.write_text(json.dumps({name: motor for name in names}))


FOREIGN = {
    "lerobot": lerobot,
    "mcap_ros2": mcap_ros2,
}
"""Writers that run in an environment of their own."""


def main() -> None:
    """Write a motion in one format."""
    name, source, out = sys.argv[1:]
    with np.load(source) as motion:
        FOREIGN[name](dict(motion), Path(out))


if __name__ == "__main__":
    main()
