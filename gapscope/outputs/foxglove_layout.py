"""A layout for Foxglove: the arm, real beside simulated, and torques and positions of each joint."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from gapscope.arm.io.json_file import write_json
from gapscope.outputs.scene import BASE, SIMULATED, Scene
from gapscope.reports.plot_page import COLOURS

TORQUES = ("recorded", "predicted", "remaining")
"""Topics of which the torque is drawn."""


def write_layout(scene: Scene, path: Path) -> None:
    """Write the layout of a scene.

    Raises:
        GapscopeError: the file cannot be written.
    """
    simulated = scene.simulated_q is not None
    write_json(foxglove_layout(scene.arm.joints, simulated), path)


def foxglove_layout(joints: Sequence[str], simulated: bool) -> dict[str, Any]:
    """Content of a layout file.

    Args:
        joints: names of the joints.
        simulated: whether the file holds a simulated arm too.
    """
    configuration: dict[str, Any] = {"3D!arm": _scene(simulated)}
    tabs = []
    for number, joint in enumerate(joints):
        plots = {
            f"Plot!torque{number}": _plot(TORQUES, "effort", number),
            f"Plot!position{number}": _plot(
                ("recorded", "simulated"), "position", number
            ),
        }
        configuration |= plots
        first, second = plots
        layout = {"first": first, "second": second, "direction": "column"}
        tabs.append({"title": joint, "layout": layout})
    configuration["Tab!joints"] = {"activeTabIdx": 0, "tabs": tabs}
    return {
        "configById": configuration,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": {
            "first": "3D!arm",
            "second": "Tab!joints",
            "direction": "row",
            "splitPercentage": 45,
        },
    }


def _scene(simulated: bool) -> dict[str, Any]:
    """The 3D panel: the description drawn at the frames of the recorded and of the simulated arm."""
    layers = {"recorded": _description("recorded", "")}
    if simulated:
        layers["simulated"] = _description("simulated", SIMULATED)
    return {"followTf": BASE, "followMode": "follow-none", "layers": layers}


def _description(label: str, prefix: str) -> dict[str, Any]:
    return {
        "layerId": "foxglove.Urdf",
        "instanceId": label,
        "label": label,
        "sourceType": "topic",
        "topic": "/robot_description",
        "framePrefix": prefix,
        "visible": True,
    }


def _plot(topics: Sequence[str], field: str, joint: int) -> dict[str, Any]:
    paths = []
    for k, topic in enumerate(topics):
        paths.append(
            {
                "value": f"/{topic}/joint_states.{field}[{joint}]",
                "label": topic,
                "color": COLOURS[k],
                "enabled": True,
                "timestampMethod": "headerStamp",
            }
        )
    return {"paths": paths, "showLegend": True, "xAxisVal": "timestamp"}
