"""Rigid-body dynamics of the nominal arm, by pinocchio, over whole time series."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence
from copy import copy
from hashlib import blake2b
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin

from gapscope.arm.dynamics.description import (
    SINGLE,
    Joint,
    Shape,
    checked,
    read_description,
)
from gapscope.arm.errors import InputError
from gapscope.arm.known_load import KnownLoad
from gapscope.arm.nominal import LARGEST, NominalArm

# Results of recent calls, kept while they fit.


MAX_BYTES = 2**26
"""Results are kept up to this size in all [bytes]."""

Arrays = tuple[np.ndarray, ...]


class ArrayCache:
    """Arrays computed from arrays, kept by the content of their arguments; the ones not used for longest go first.

    Args:
        most_bytes: size up to which results are kept; the last one is kept whatever its size.
    """

    def __init__(self, most_bytes: int = MAX_BYTES) -> None:
        self._most_bytes = most_bytes
        self._kept: OrderedDict[bytes, Arrays] = OrderedDict()
        self._bytes = 0

    def get(
        self, name: str, arguments: Arrays, compute: Callable[[], Arrays]
    ) -> Arrays:
        """Result of ``compute``, computed or remembered; its arrays cannot be written to.

        Args:
            name: of what is computed.
            arguments: everything that the result depends on.
            compute: computes it.
        """
        digest = blake2b(name.encode())
        for argument in arguments:
            # the same numbers in another shape are another argument
            digest.update(repr(np.shape(argument)).encode())
            digest.update(np.ascontiguousarray(argument).data)
        key = digest.digest()
        if key in self._kept:
            self._kept.move_to_end(key)
            return self._kept[key]
        result = compute()
        # as one array goes to others, nobody may change what is remembered
        for array in result:
            array.flags.writeable = False
        self._kept[key] = result
        self._bytes += sum(array.nbytes for array in result)
        while self._bytes > self._most_bytes and len(self._kept) > 1:
            _, oldest = self._kept.popitem(last=False)
            self._bytes -= sum(array.nbytes for array in oldest)
        return result


UNLIMITED = LARGEST["length"][0]
"""Position limits beyond this [rad or m] are none."""

INERTIAL_PARAMETERS = ("m", "mx", "my", "mz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
"""Order of the ten inertial parameters of a link, expressed in the frame of the joint that moves it (pinocchio)."""


class RigidBody:
    """Rigid-body model of a nominal arm, without armature and friction.

    Unless they say otherwise, methods take q [rad], dq [rad/s], ddq [rad/s^2] of shape (N, n) in the arm's joint order
    and return joint-side torque [N m].

    Attributes:
        file, joints: where the bodies come from, and the names of the joints that move them.
        order: position of each model joint among the arm's joints, shape (n,): ``q[order]`` is in kinematic order.
        places: position of each of the arm's joints in kinematic order, shape (n,), the inverse of ``order``.
        per_radian: of the nominal arm, shape (n,).
        most_bytes: size of the results for whole motions that are remembered [bytes]; 0 where no motion comes again.

    Raises:
        InputError: the URDF lacks one of the arm's joints.
    """

    def __init__(self, arm: NominalArm, most_bytes: int = MAX_BYTES) -> None:
        self.file, self.joints, self.n_joints = arm.urdf, arm.joints, arm.n_joints
        self.per_radian = arm.per_radian
        self.model = arm_model(arm.urdf, arm.joints, arm.gravity, arm.locked)
        self._data = self.model.createData()
        self.links = np.array([self.model.getJointId(name) for name in arm.joints])
        # the arm's joints may be in another order than the tree's
        joints = [self.model.joints[int(link)] for link in self.links]
        # model order: idx_v of a joint is its place in kinematic order
        self.places = np.array([joint.idx_v for joint in joints])
        self.order = np.argsort(self.places)
        self.last_link = int(self.order[-1])
        self._cache = ArrayCache(most_bytes)
        self._unladen: RigidBody | None = None
        self._laden: dict[KnownLoad, RigidBody] = {}

    def _ordered(self, *series: np.ndarray) -> tuple[np.ndarray, ...]:
        """Series of the arm's joints (..., n) in the order of the model, as pinocchio wants them."""
        return tuple(np.ascontiguousarray(x[..., self.order]) for x in series)

    def inverse_dynamics(
        self, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray
    ) -> np.ndarray:
        """tau = M(q) ddq + C(q, dq) dq + g(q), shape (N, n)."""

        def computed(*motion: np.ndarray) -> tuple[np.ndarray]:
            q, dq, ddq = self._ordered(*motion)
            # one call for all samples, each computed as by pin.rnea
            out = pin.rneaInParallel(1, pin.ModelPool(self.model, 1), q.T, dq.T, ddq.T)
            # a single sample comes back as a vector
            return (out.reshape(q.shape[::-1], order="F").T[:, self.places],)

        return self._cached("inverse dynamics", computed, q, dq, ddq)[0].copy()

    def gravity_torque(self, q: np.ndarray) -> np.ndarray:
        """g(q), shape (N, n)."""
        still = np.zeros_like(q)
        return self.inverse_dynamics(q, still, still)

    def _cached(
        self,
        name: str,
        compute: Callable[..., tuple[np.ndarray, ...]],
        *motion: np.ndarray,
    ) -> tuple[np.ndarray, ...]:
        """Result of a function of a motion and of the bodies, computed or taken from the cache."""
        arguments = (*motion, self.inertial_parameters(), self.gravity)
        return self._cache.get(name, arguments, lambda: compute(*motion))

    def mass_matrix(self, q: np.ndarray) -> np.ndarray:
        """M(q) of one sample q [rad] of shape (n,); kg m^2, shape (n, n)."""
        mass = pin.crba(self.model, self._data, *self._ordered(q))
        return mass[self.places][:, self.places]

    def bias(self, q: np.ndarray, dq: np.ndarray) -> np.ndarray:
        """h = C(q, dq) dq + g(q) [N m] of one sample; q, dq and h of shape (n,)."""
        bias = pin.nonLinearEffects(self.model, self._data, *self._ordered(q, dq))
        return bias[self.places]

    def torque(self, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray) -> np.ndarray:
        """tau = M(q) ddq + C(q, dq) dq + g(q) [N m] of one sample, at once; q, dq, ddq and tau of shape (n,)."""
        return pin.rnea(self.model, self._data, *self._ordered(q, dq, ddq))[self.places]

    def changed(
        self, increments: np.ndarray, gravity: np.ndarray | None = None
    ) -> RigidBody:
        """This arm with other inertial parameters, and under another gravity.

        Args:
            increments: added to the links' parameters, shape (n, 10) in joint order, columns in the order of
                ``INERTIAL_PARAMETERS``; kg, kg m, kg m^2.
            gravity: in the base frame [m/s^2], shape (3,); unchanged if ``None``.
        """
        # shares the cache, whose keys hold bodies and gravity
        other = copy(self)
        other._laden = {}
        other.model = self.model.copy()
        other._data = other.model.createData()
        for link, increment in zip(self.links.tolist(), increments, strict=True):
            if np.any(increment):
                # first and second moments about the joint's frame add up
                total = self.model.inertias[link].toDynamicParameters() + increment
                other.model.inertias[link] = pin.Inertia.FromDynamicParameters(total)
        if gravity is not None:
            other.model.gravity = pin.Motion(np.array(gravity), np.zeros(3))
        return other

    def carrying(self, load: KnownLoad | None) -> RigidBody:
        """This arm with a known body on its last link, the same object for the same load; itself if ``None``."""
        if load is None:
            return self
        if load not in self._laden:
            added = np.zeros((self.n_joints, 10))
            added[self.last_link] = load.parameters
            laden = self.changed(added)
            # a laden arm remembers whose it is: errors of links refer to the bare one
            laden._unladen = self.unladen
            self._laden[load] = laden
        return self._laden[load]

    @property
    def unladen(self) -> RigidBody:
        """The arm without its known load: errors of its links and the place of a force refer to it."""
        return self._unladen or self

    @property
    def gravity(self) -> np.ndarray:
        """Gravity in the base frame [m/s^2], shape (3,)."""
        return np.array(self.model.gravity.linear)

    def force_regressor(self, q: np.ndarray) -> np.ndarray:
        """J^T [m], shape (N, n, 3), with joint torque J^T f of a force f on the last link's centre of mass.

        A known load does not move the place where the force acts.

        Args:
            q: joint positions [rad], shape (N, n).
        """
        (q,) = self._ordered(np.atleast_2d(q))
        model, data = self.model, self._data
        last = int(self.links[self.last_link])
        # a lever of the bare arm: what it carries does not move the place
        lever = self.unladen.model.inertias[last].lever
        jacobians, places = np.empty((len(q), 6, q.shape[1])), np.empty((len(q), 1, 3))
        for i in range(len(q)):
            # pinocchio gives a single column without its second axis
            jacobians[i] = pin.computeJointJacobians(model, data, q[i]).reshape(6, -1)
            places[i] = data.oMi[last].act(lever)
        linear, angular = jacobians[:, :3], jacobians[:, 3:]
        by_joint = (linear.transpose(0, 2, 1), angular.transpose(0, 2, 1))
        # J of a point p is J_v + J_w x p, with J about the origin of the base
        return (by_joint[0] + np.cross(by_joint[1], places))[:, self.places]

    def force_torque(self, q: np.ndarray, force: np.ndarray) -> np.ndarray:
        """J^T f [N m], shape (N, n): joint torque of a force on the arm at the last link's centre of mass.

        Args:
            q: joint positions [rad], shape (N, n).
            force: in the base frame [N], shape (3,) or (N, 3).
        """
        jacobian = self.force_regressor(q)
        forces = np.broadcast_to(force, (len(jacobian), 3))
        return np.einsum("nij,nj->ni", jacobian, forces)

    def position_limits(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper position limits of the URDF [rad or m], each of shape (n,); infinite if it sets none."""
        lower = self.model.lowerPositionLimit[self.places]
        upper = self.model.upperPositionLimit[self.places]
        # some files write a range without width, or 1e9, for no limit
        none = (lower >= upper) | (lower <= -UNLIMITED) | (upper >= UNLIMITED)
        return np.where(none, -np.inf, lower), np.where(none, np.inf, upper)

    def postures(self, count: int) -> np.ndarray:
        """The zero posture and random ones within the limits, the same at each call [rad or m], shape (count, n).

        Joints without limits are within a turn.
        """
        low, high = np.clip(self.position_limits(), -np.pi, np.pi)
        share = np.random.default_rng(0).uniform(size=(count - 1, self.n_joints))
        return np.vstack([np.zeros(self.n_joints), low + share * (high - low)])

    def velocity_limits(self) -> np.ndarray:
        """Velocity limits of the file [rad/s], shape (n,); 0 if there are none."""
        return _finite(self.model.velocityLimit[self.places])

    def effort_limits(self) -> np.ndarray:
        """Torque limits of the file [N m], shape (n,); 0 if there are none."""
        return _finite(self.model.effortLimit[self.places])

    def sensitivities(
        self, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """d tau_i / d q_j [N m/rad], d tau_i / d dq_j [N m s/rad] and M_ij [kg m^2], each of shape (N, n, n)."""
        by_position, by_velocity, mass = self._cached(
            "sensitivities", self._sensitivities, q, dq, ddq
        )
        return by_position, by_velocity, mass

    def _sensitivities(
        self, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray
    ) -> tuple[np.ndarray, ...]:
        own = self.inertial_parameters().reshape(-1, 10)
        if (own[:, 0] >= 0).all():
            return self._derivatives(q, dq, ddq)
        # pinocchio divides by the mass of all bodies beyond a joint, and takes one below zero for almost zero.
        # The derivatives are linear in the inertials: add a ballast that keeps masses positive, take its share away
        ballast = np.zeros_like(own)
        ballast[:, 0] = 2 * np.abs(own[:, 0]).sum()
        both = self.changed(ballast)._derivatives(q, dq, ddq)
        alone = self.changed(ballast - own)._derivatives(q, dq, ddq)
        return tuple(a - b for a, b in zip(both, alone, strict=True))

    def _derivatives(
        self, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray
    ) -> tuple[np.ndarray, ...]:
        """Those of ``sensitivities``, if no mass is negative."""
        by_position, by_velocity, mass = found = np.empty((3, *q.shape, self.n_joints))
        for i, state in enumerate(zip(*self._ordered(q, dq, ddq), strict=True)):
            pin.computeRNEADerivatives(self.model, self._data, *state)
            by_position[i], by_velocity[i] = self._data.dtau_dq, self._data.dtau_dv
            mass[i] = self._data.M
        # pinocchio fills the upper triangle alone
        mass[:] = np.triu(mass) + np.triu(mass, 1).transpose(0, 2, 1)
        return tuple(found[:, :, self.places[:, None], self.places])

    def gravity_regressor(self, q: np.ndarray) -> np.ndarray:
        """G(q) [kg m], shape (N, n, 3), with g(q) = G(q) g for gravity g in the base frame [m/s^2]."""
        # gravity torque is linear in gravity: one axis at a time
        turned = self.changed(np.zeros((self.n_joints, 10)), np.zeros(3))
        columns = []
        for gravity in np.eye(3):
            turned.model.gravity = pin.Motion(gravity, np.zeros(3))
            columns.append(turned.gravity_torque(q))
        return np.stack(columns, axis=2)

    def regressor(
        self,
        q: np.ndarray,
        dq: np.ndarray,
        ddq: np.ndarray,
        out: np.ndarray | None = None,
    ) -> np.ndarray:
        """Y with tau = Y pi, shape (N, n, 10 n); pi stacks ``INERTIAL_PARAMETERS`` of each link, in joint order.

        Args:
            q, dq, ddq: motion, shape (N, n) each.
            out: array that Y is written into, shape (N, n, 10 n), such as the leading columns of a wider one.
        """
        n = self.n_joints
        q, dq, ddq = self._ordered(q, dq, ddq)
        if out is None:
            out = np.empty((len(q), n, 10 * n))
        fill = pin.computeJointTorqueRegressor
        same_order = np.array_equal(self.places, np.arange(n))
        # ten columns of each link, from kinematic order into that of the arm
        columns = (10 * self.places[:, None] + np.arange(10)).ravel()
        for row, *sample in zip(out, q, dq, ddq, strict=True):
            matrix = fill(self.model, self._data, *sample)
            row[...] = matrix if same_order else matrix[self.places][:, columns]
        return out

    def link_regressor(
        self, link: int, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray
    ) -> np.ndarray:
        """The ten columns of the regressor that belong to a link, from 0 in joint order, shape (N, n, 10)."""
        own = slice(10 * link, 10 * link + 10)

        def columns() -> tuple[np.ndarray]:
            return (self.regressor(q, dq, ddq)[:, :, own].copy(),)

        # remembered link by link: the whole regressor of a long motion would not fit; whatever links weigh, it is this
        arguments = (q, dq, ddq, self.gravity)
        return self._cache.get(f"link {link}", arguments, columns)[0]

    def inertial_parameters(self) -> np.ndarray:
        """Inertial parameters pi of the links in joint order, shape (10 n,); units kg, kg m, kg m^2."""
        inertias = [self.model.inertias[link] for link in self.links.tolist()]
        return np.concatenate([inertia.toDynamicParameters() for inertia in inertias])


def _finite(limits: np.ndarray) -> np.ndarray:
    """Limits with 0 for those that are none."""
    return np.where(np.isfinite(limits), limits, 0.0)


# The bodies and joints of a robot file as pinocchio has them, all other joints locked.


def arm_model(
    path: Path,
    joints: Sequence[str],
    gravity: Sequence[float] | np.ndarray,
    locked: Mapping[str, float] | None = None,
) -> pin.Model:
    """Model of some joints of a file, without armature, under a gravity [m/s^2].

    Args:
        path: URDF or MJCF file.
        joints: those that move.
        gravity: in the base frame [m/s^2], shape (3,).
        locked: positions of other joints [rad or m]; those that are not named are locked at zero.

    Raises:
        InputError: the file lacks one of the joints, or what concerns them is no arm that can be.
    """
    description = checked(read_description(path, shapes=False), joints)
    missing = [name for name in joints if name not in description.single]
    if missing:
        raise InputError(
            f"has no movable joint {', '.join(missing)}; it has {', '.join(description.single)}",
            "name the joints of the recording's columns in joints:, or give the URDF of the recorded arm",
            file=path,
        )
    model, positions = pin.Model(), locked or {}
    held = {joint.child for joint in description.joints}
    bases = [joint.parent for joint in description.joints if joint.parent not in held]
    # link by link from the base on, each with the joint above it and the body and place that carry this joint
    waiting: list[tuple[Joint | None, str, int, pin.SE3]]
    waiting = [(None, base, 0, pin.SE3.Identity()) for base in bases[:1]]
    while waiting:
        joint, name, body, place = waiting.pop()
        if joint is not None:
            # a joint turns about its anchor: there and, behind the joint, back
            place = place * joint.place * pin.SE3(np.eye(3), joint.anchor)
            if joint.name in joints:
                body, place = _add_joint(model, joint, body, place), pin.SE3.Identity()
            # a joint that is locked elsewhere than at zero moves what it carries once
            elif joint.kind in SINGLE and positions.get(joint.name):
                at = positions[joint.name]
                place = place * joint_motion(joint.kind, joint.axis, at)
            place = place * pin.SE3(np.eye(3), -joint.anchor)
        link = description.by_name[name]
        if (own := link.inertial) is not None:
            inertia = pin.Inertia(own.mass, own.com, own.moments)
            model.appendBodyToJoint(body, inertia, place)
        # the base has no body: what is fixed to it carries nothing that moves
        elif body and link.drawn and description.form == "MJCF":
            for shape in link.shapes:
                if shape.mass != 0:
                    model.appendBodyToJoint(body, _weighed(shape), place)
        # links between several joints of one body are in no file
        if link.line:
            model.addFrame(pin.Frame(link.name, body, place, pin.FrameType.BODY), False)
        # reversed onto the stack: the first joint is taken first
        for below in reversed(description.below(name)):
            waiting.append((below, below.child, body, place))
    model.gravity = pin.Motion(np.array(gravity), np.zeros(3))
    return model


def joint_motion(kind: str, axis: np.ndarray, position: float) -> pin.SE3:
    """Motion of what a joint of a kind carries, along an axis of any length, (3,), to a position [rad or m]."""
    moved = axis / np.linalg.norm(axis) * position
    if kind == "prismatic":
        return pin.SE3(np.eye(3), moved)
    return pin.SE3(pin.exp3(moved), np.zeros(3))


def _add_joint(model: pin.Model, joint: Joint, body: int, place: pin.SE3) -> int:
    """Add a joint that moves; the number of the body that it carries."""
    axis = joint.axis / np.linalg.norm(joint.axis)
    aligned = (pin.JointModelRX, pin.JointModelRY, pin.JointModelRZ)
    free = pin.JointModelRevoluteUnaligned
    if joint.kind == "prismatic":
        aligned = (pin.JointModelPX, pin.JointModelPY, pin.JointModelPZ)
        free = pin.JointModelPrismaticUnaligned
    # axes along x, y or z have joints of their own, which compute faster
    motion = aligned[axis.argmax()]() if axis.max() == 1.0 else free(axis)
    lower, upper = joint.lower or 0.0, joint.upper or 0.0
    # a range without width means none, whatever it was meant for
    if joint.turns_freely or lower >= upper:
        lower, upper = -np.inf, np.inf
    bounds = np.array([joint.effort or 0.0, joint.velocity or 0.0, lower, upper])
    return int(model.addJoint(body, motion, place, joint.name, *bounds[:, None]))


FORMS = {
    "box": coal.Box,
    "sphere": coal.Sphere,
    "ellipsoid": coal.Ellipsoid,
    "cylinder": coal.Cylinder,
    "capsule": coal.Capsule,
}
"""Solids by the kind of a shape, each made from the sizes of one."""


def _weighed(shape: Shape) -> pin.Inertia:
    """Inertia of a homogeneous shape in its link's frame."""
    form = FORMS[shape.kind](*shape.size)
    volume = form.computeVolume()
    # MJCF may give a shape its mass, else it has a density
    mass = shape.density * volume if shape.mass is None else shape.mass
    # about its centre, as long as it has a density of 1
    moments = mass / volume * form.computeMomentofInertia()
    return shape.place.act(pin.Inertia(float(mass), np.zeros(3), moments))
