"""Poses of all links of an arm along a motion, for pictures and logs."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from gapscope.arm.dynamics.rigid_body import RigidBody


class LinkPoses(NamedTuple):
    """Poses in the base frame of L links at N samples.

    Attributes:
        names: of the links, as the robot's file has them.
        positions: of their frames [m], shape (N, L, 3).
        quaternions: x, y, z, w [1], shape (N, L, 4).
    """

    names: tuple[str, ...]
    positions: np.ndarray
    quaternions: np.ndarray


def link_poses(body: RigidBody, q: np.ndarray) -> LinkPoses:
    """Poses of all links, fixed ones included.

    Args:
        body: the arm.
        q: positions in the order of the arm's joints [rad or m], shape (N, n).
    """
    model, data = body.model, body.model.createData()
    links = [k for k, f in enumerate(model.frames) if f.type == pin.FrameType.BODY]
    in_order = q[:, body.order]
    positions = np.empty((len(q), len(links), 3))
    quaternions = np.empty((len(q), len(links), 4))
    for i, state in enumerate(np.ascontiguousarray(in_order)):
        pin.framesForwardKinematics(model, data, state)
        for k, link in enumerate(links):
            pose = pin.SE3ToXYZQUAT(data.oMf[link])
            positions[i, k], quaternions[i, k] = pose[:3], pose[3:]
    names = tuple(model.frames[k].name for k in links)
    return LinkPoses(names, positions, quaternions)
