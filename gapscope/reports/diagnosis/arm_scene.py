"""The arm in 3D, as the page draws it: bodies, joints, and the motions that were recorded and replayed."""

from __future__ import annotations

import base64
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from gapscope.arm.dynamics.link_hulls import Hull, link_hulls, reach
from gapscope.arm.dynamics.plain_urdf import moving_links
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.diagnosis.result import Diagnosis, Trace
from gapscope.reports.diagnosis.encoding import encode

FRAMES_PER_SECOND = 40.0
"""Samples of a motion that are kept per second."""
MOST_FRAMES = 2400
"""Most samples of a motion: a minute."""


def arm_scene(diagnosis: Diagnosis) -> dict[str, Any] | None:
    """Bodies, joints and motion as JSON-ready values; ``None`` if the arm or its motion is not known.

    The motion is the one that was replayed, with the simulated arms beside the recorded one; without a replay the first
    recording alone.
    """
    if diagnosis.arm is None or not diagnosis.traces:
        return None
    body = RigidBody(diagnosis.arm)
    links = moving_links(body, movable=False)
    names = [link.joint for link in links]
    joints = []
    for link in links:
        xyz, rpy = link.origin
        turn = Rotation.from_euler("xyz", rpy).as_quat()
        joints.append(
            {
                "parent": names.index(link.parent) if link.parent else -1,
                "place": xyz.tolist(),
                "turn": turn.tolist(),
                "axis": link.axis.tolist(),
                "slides": link.kind == "prismatic",
                "column": diagnosis.arm.joints.index(link.joint),
            }
        )
    return {
        "joints": joints,
        "reach": reach(body),
        "hulls": [_hull(hull) for hull in link_hulls(body)],
        "motion": _motion(diagnosis),
    }


def _hull(hull: Hull) -> dict[str, Any]:
    faces = np.ascontiguousarray(hull.faces, dtype="<u2").tobytes()
    return {
        "joint": hull.body - 1,
        "vertices": encode(hull.vertices.ravel()),
        "faces": base64.b64encode(faces).decode("ascii"),
    }


def _motion(diagnosis: Diagnosis) -> dict[str, Any]:
    """Times, positions of each arm, and the gap of each joint over its recorded torque's deviation."""
    replayed = diagnosis.replayed
    if replayed is None or (replayed.nominal is None and replayed.corrected is None):
        trace = diagnosis.traces[0]
        arms = {"recorded": trace.q}
        name, t = trace.recording, trace.t
    else:
        name, t = replayed.recording, replayed.t
        arms = {"recorded": replayed.recorded}
        if replayed.nominal is not None:
            arms["nominal"] = replayed.nominal
        if replayed.corrected is not None:
            arms["corrected"] = replayed.corrected
    rate = 1.0 / float(np.median(np.diff(t)))
    kept = slice(0, None, max(1, round(rate / FRAMES_PER_SECOND)))
    times = t[kept][:MOST_FRAMES]
    trace = next(
        (x for x in diagnosis.traces if x.recording == name), diagnosis.traces[0]
    )
    return {
        "recording": name,
        "t": encode(times),
        "arms": {arm: encode(q[kept][:MOST_FRAMES].ravel()) for arm, q in arms.items()},
        "gaps": {
            stage: encode(_gap(trace, stage, times).ravel())
            for stage in ("before", "after")
        },
    }


def _gap(trace: Trace, stage: str, times: np.ndarray) -> np.ndarray:
    """Size of the gap at given times over the largest recorded deviation of each joint, (M, n)."""
    predicted = trace.nominal if stage == "before" else trace.corrected
    error = np.abs(trace.measured - predicted)
    deviation = trace.measured.std(axis=0)
    scale = np.maximum(deviation, 0.05 * deviation.max())
    columns = [np.interp(times, trace.t, column) for column in error.T]
    return np.column_stack(columns) / np.maximum(scale, 1e-12)
