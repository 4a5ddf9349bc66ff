"""A recording, its prediction and the arm as one MCAP file, read again by another reader."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from rosbags.highlevel import AnyReader

from gapscope.arm.case import load_case
from gapscope.arm.dynamics.kinematics import Kinematics, link_poses
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.robots import load_nominal_arm
from gapscope.interface.models import predict


def messages(path: Path) -> dict[str, list]:
    """Messages of a file by topic."""
    found = {}
    with AnyReader([path]) as reader:
        for connection, _, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            found.setdefault(connection.topic, []).append(message)
    return found


def test_a_scene_holds_torques_arm_and_places_and_its_layout_names_them(
    gapscope, sick, tmp_path
):
    out = tmp_path / "scene.mcap"
    assert gapscope("view", sick, "--no-open", "--out", out).code == 0
    found, case = messages(out), load_case(sick)
    recorded, predicted = case.recordings[0].tau, predict(case, 0).tau
    for topic, torque in (
        ("recorded", recorded),
        ("predicted", predicted),
        ("remaining", recorded - predicted),
    ):
        written = [message.effort for message in found[f"/{topic}/joint_states"]]
        np.testing.assert_allclose(written, torque, atol=1e-12)

    assert "<robot" in found["/robot_description"][0].data
    frames = {t.child_frame_id for message in found["/tf"] for t in message.transforms}
    assert {"base", "upper", "lower"} <= frames

    layout = json.loads(out.with_suffix(".foxglove.json").read_text())
    panels = layout["configById"].values()
    paths = [path["value"] for panel in panels for path in panel.get("paths", ())]
    # one is drawn empty without a replay
    known = {*found, "/simulated/joint_states"}
    assert paths and {path.split(".")[0] for path in paths} <= known


def test_links_stand_where_kinematics_puts_the_tool():
    arm = load_nominal_arm("kuka_iiwa")
    body = RigidBody(arm)
    q = np.random.default_rng(0).uniform(-1, 1, (3, arm.n_joints))
    tool = Kinematics(body)
    for posture, links in zip(q, link_poses(body, q), strict=True):
        *_, last = links.values()
        np.testing.assert_allclose(last[:3], tool.tool(posture).translation)
