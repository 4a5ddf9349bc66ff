"""Kinematics of an arm by pinocchio: if its joints and its tool are, and how the tool moves."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from gapscope.arm.dynamics.rigid_body import RigidBody


class Pose(NamedTuple):
    """A pose in the base frame: position [m], shape (3,), and rotation matrix, shape (3, 3)."""

    position: np.ndarray
    rotation: np.ndarray


class Kinematics:
    """Forward kinematics of an arm; q is of shape (n,) in the arm's joint order, poses are in the base frame.

    The tool is the last body of the URDF that the arm's last joint carries: flange, hand or grasp target.
    """

    def __init__(self, body: RigidBody) -> None:
        self._model = body.model
        self._data = body.model.createData()
        columns = np.array([body.model.joints[int(link)].idx_v for link in body.links])
        self._to_model = np.argsort(columns)
        self._to_arm = columns
        last = body.model.njoints - 1
        for index, frame in enumerate(body.model.frames):
            if frame.parentJoint == last and frame.type == pin.FrameType.BODY:
                self._tool = index
        self.n_joints = body.n_joints

    def tool(self, q: np.ndarray) -> Pose:
        """Pose of the tool."""
        pin.framesForwardKinematics(self._model, self._data, q[self._to_model])
        placement = self._data.oMf[self._tool]
        return Pose(placement.translation.copy(), placement.rotation.copy())

    def tool_jacobian(self, q: np.ndarray) -> np.ndarray:
        """J with [velocity [m/s]; angular velocity [rad/s]] = J dq of the tool, along the base's axes; (6, n)."""
        frame = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        jacobian = pin.computeFrameJacobian(
            self._model, self._data, q[self._to_model], self._tool, frame
        )
        # of one joint pinocchio returns a vector
        return jacobian.reshape(6, -1)[:, self._to_arm]

    def skeleton(self, q: np.ndarray) -> np.ndarray:
        """Base, origins of the joints from the base on, and tip [m], shape (n + 2, 3).

        The tip is the tool, or the centre of mass of the last link if the tool lies on the last joint.
        """
        pin.framesForwardKinematics(self._model, self._data, q[self._to_model])
        placements = list(self._data.oMi)[1:]
        joints = [placement.translation for placement in placements]
        tip = self._data.oMf[self._tool].translation
        if np.abs(tip - joints[-1]).max() < 1e-3:
            centre_of_mass = self._model.inertias[len(joints)].lever
            tip = placements[-1].act(centre_of_mass)
        return np.array([np.zeros(3), *joints, tip])
