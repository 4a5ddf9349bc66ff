"""Kinematics: poses of links, their inverse, and singular postures."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pinocchio as pin

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import GapscopeError

LEAST_JOINTS = 3
"""Joints with which a tool can reach any place: it has three coordinates."""
POSTURES = 1000
"""Postures that stand for all of an arm's."""

# Poses of all links of an arm along a motion, for pictures and logs.


def link_poses(body: RigidBody, q: np.ndarray) -> Iterator[dict[str, np.ndarray]]:
    """Poses of all links in the base frame, fixed ones included, by their names in the robot's file, sample by sample.

    Each is x, y, z [m], then the quaternion x, y, z, w [1], shape (7,).

    Args:
        body: the arm.
        q: positions in the order of the arm's joints [rad or m], shape (N, n).
    """
    model, data = body.model, body.model.createData()
    for state in np.ascontiguousarray(q[:, body.order]):
        pin.framesForwardKinematics(model, data, state)
        yield {
            frame.name: pin.SE3ToXYZQUAT(data.oMf[k])
            for k, frame in enumerate(model.frames)
            if frame.type == pin.FrameType.BODY
        }


# Kinematics of an arm by pinocchio: if its joints and its tool are, and how the tool moves.


class Kinematics:
    """Forward kinematics of an arm; q is of shape (n,) in the arm's joint order, poses are in the base frame.

    The tool is the last body of the URDF that the arm's last joint carries: flange, hand or grasp target.
    """

    def __init__(self, body: RigidBody) -> None:
        self._model = body.model
        self._data = body.model.createData()
        self._order, self._places = body.order, body.places
        last = body.model.njoints - 1
        # a frame of the last body: later ones are farther out, so that the last counts
        for index, frame in enumerate(body.model.frames):
            if frame.parentJoint == last and frame.type == pin.FrameType.BODY:
                self._tool = index
        self.n_joints = body.n_joints

    def tool(self, q: np.ndarray) -> pin.SE3:
        """Pose of the tool."""
        pin.framesForwardKinematics(self._model, self._data, q[self._order])
        return self._data.oMf[self._tool].copy()

    def tool_jacobian(self, q: np.ndarray) -> np.ndarray:
        """J with [velocity [m/s]; angular velocity [rad/s]] = J dq of the tool, along the base's axes; (6, n)."""
        frame = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        jacobian = pin.computeFrameJacobian(
            self._model, self._data, q[self._order], self._tool, frame
        )
        # of one joint pinocchio returns a vector
        return jacobian.reshape(6, -1)[:, self._places]

    def skeleton(self, q: np.ndarray) -> np.ndarray:
        """Base, origins of the joints from the base on, and tip [m], shape (n + 2, 3).

        The tip is the tool, or the centre of mass of the last link if the tool lies on the last joint.
        """
        pin.framesForwardKinematics(self._model, self._data, q[self._order])
        # the universe comes first: its place is the base
        *_, last = placements = list(self._data.oMi)
        tip = self._data.oMf[self._tool].translation
        # a tool on the joint's own axis would leave the last link without length
        if np.allclose(tip, last.translation):
            tip = last.act(self._model.inertias[len(placements) - 1].lever)
        return np.array([*(place.translation for place in placements), tip])


# How far a posture is from a singular one.


def smallest_singular_value(kinematics: Kinematics, q: np.ndarray) -> np.ndarray:
    """Smallest of the min(6, n) singular values of the tool's Jacobian, rows in m/rad and in rad/rad; shape (N,).

    Zero in a singular posture, where the tool cannot move in some direction [nakamura1986].

    Args:
        kinematics: of the arm.
        q: joint positions [rad], shape (N, n).
    """
    jacobians = np.array([kinematics.tool_jacobian(posture) for posture in q])
    turned = jacobians.transpose(0, 2, 1)
    wide = jacobians.shape[2] >= jacobians.shape[1]
    # squares of the singular values, from the smaller of the two products
    gram = jacobians @ turned if wide else turned @ jacobians
    return np.sqrt(np.linalg.eigvalsh(gram)[:, 0].clip(0.0))


# Inverse kinematics: the joint positions that bring the tool to a pose.


TURN = 0.3
"""Length that weighs a turn against a shift: 1 rad counts as much as this many metres [m]."""
TOLERANCE = np.sqrt(np.finfo(float).eps)
"""Largest error of the tool that counts as reached [m]: half the digits of a number."""
DAMPING = 1e-4
"""lambda over e^T e [1]; larger is safer near a singularity, and slower."""
ITERATIONS = 30
"""Before giving up; close to the target each doubles the digits that are right."""
LONGEST_STEP = 0.2
"""Joints move by at most this per iteration [rad]."""


def inverse_kinematics(
    kinematics: Kinematics, target: pin.SE3, start: np.ndarray
) -> np.ndarray:
    """Joint positions [rad], shape (n,), by damped least squares: dq = J^T (J J^T + lambda E)^-1 e [nakamura1986].

    e stacks the shift to the target and the turn to it times ``TURN`` [m]; lambda falls with the error, as
    ``DAMPING`` times e^T e [sugihara2011], so that the last steps are those of Newton. The orientation of the tool is
    left free if the arm has fewer joints than rows, and cannot choose it.

    Args:
        kinematics: of the arm.
        target: pose of the tool in the base frame.
        start: joint positions to start from [rad], shape (n,); of several solutions a near one is found.

    Raises:
        GapscopeError: the target was not reached.
    """
    q = np.array(start, dtype=float)
    weight = np.repeat([1.0, TURN], LEAST_JOINTS)
    # fewer joints than six cannot choose an orientation: three rows are left
    if kinematics.n_joints < len(weight):
        weight = weight[:LEAST_JOINTS]
    rows = len(weight)
    for _ in range(ITERATIONS):
        error = _error(kinematics.tool(q), target)[:rows] * weight
        if np.abs(error).max() < TOLERANCE:
            return q
        jacobian = kinematics.tool_jacobian(q)[:rows] * weight[:, None]
        # vanishes with the error, so that the last steps are those of Newton
        lambda_ = DAMPING * error @ error + 1e-12
        regularised = jacobian @ jacobian.T + lambda_ * np.eye(rows)
        step = jacobian.T @ np.linalg.solve(regularised, error)
        # far from the target the linear step may be anything: its direction is kept
        longest = max(float(np.abs(step).max()), np.finfo(float).eps)
        q += step * min(1.0, LONGEST_STEP / longest)
    raise GapscopeError(
        f"the tool cannot reach {np.round(target.translation, 3).tolist()} m: {np.linalg.norm(error):.2g} m away",
        "choose a target nearer to the base, or start from another posture",
    )


def _error(pose: pin.SE3, target: pin.SE3) -> np.ndarray:
    """Shift [m] and turn [rad] from a pose to the target along the base's axes, shape (6,)."""
    turn = pin.log3(target.rotation @ pose.rotation.T)
    return np.concatenate([target.translation - pose.translation, turn])
