"""The actions: a joint torque, a torque added to a PD with feedforward, or factors of feedforward and gains."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.motions.named_motions import Workspace
from gapscope.arm.nearest_name import check_known
from gapscope.arm.nominal import NominalArm

ACTION_KINDS = ("residual", "scale", "gains", "torque")
"""``torque``: the action is the commanded torque. ``residual``: it is added to PD and feedforward. ``scale``: it
multiplies feedforward and gains. ``gains``: one number multiplies the gains of all joints, so that it does nothing
where there is nothing to correct."""
SHARES = {"residual": 0.2, "scale": 0.0, "gains": 0.0, "torque": 1.0}
"""Torque of an action of 1 over the rated torque, by default; factors have none."""
FEEDFORWARD_SPAN = 0.5
"""With ``scale``, share by which an action of 1 raises the feedforward [1]."""
GENEROUS = 2.0
"""Rated torque over what motions need at the working posture, if the torque limit allows it [1]."""
BRISK = 50.0
"""Acceleration that the rated torque gives a joint's own inertia, if the torque limit allows it [rad/s^2]."""
DAMPING = 0.7
"""Damping ratio of the PD loop [1]."""


class Gains(NamedTuple):
    """Gains of the PD law, each of shape (n,): N m/rad, N m s/rad."""

    kp: np.ndarray
    kd: np.ndarray


class Control(NamedTuple):
    """How actions become torque.

    Attributes:
        kind: one of ``ACTION_KINDS``.
        scale: torque of an action of 1 [N m], shape (n,).
        rated: rated torque, see ``rated_torque`` [N m], shape (n,).
        limit: at which the commanded torque is clipped [N m], shape (n,).
        gains: of the PD loop with feedforward, or ``None`` if the action is the whole torque.
    """

    kind: str
    scale: np.ndarray
    rated: np.ndarray
    limit: np.ndarray
    gains: Gains | None

    @property
    def size(self) -> int:
        """Numbers in an action: one per joint, with ``scale`` two, with ``gains`` one in all."""
        sizes = {"scale": 2 * len(self.rated), "gains": 1}
        return sizes.get(self.kind, len(self.rated))

    @property
    def multiplies(self) -> bool:
        """Whether actions are factors."""
        return self.kind in ("scale", "gains")


def scaled(gains: Gains, action: np.ndarray) -> tuple[np.ndarray | float, Gains]:
    """Factor of the feedforward [1], shape (..., n) or 1, and gains, of an action a, shape (..., 2 n) or (..., 1).

    kp of joint i is multiplied by 2^a_i and kd by its square root, so that the damping ratio stays. One number a is for
    all joints. Of 2 n numbers the last are for the gains; with the first n the feedforward of joint i is multiplied by
    1 + a_i / 2.
    """
    n = len(gains.kp)
    # 2 n numbers: the first are for the feedforward, the last for the gains
    both = action.shape[-1] == 2 * n
    factor = 2.0 ** (action[..., n:] if both else action)
    feedforward = 1.0 + FEEDFORWARD_SPAN * action[..., :n] if both else 1.0
    return feedforward, Gains(gains.kp * factor, gains.kd * np.sqrt(factor))


def torque_limit(arm: NominalArm, body: RigidBody) -> np.ndarray:
    """Torque that the arm is clipped at [N m], shape (n,): data sheet, else URDF, else none (infinite)."""
    if arm.torque_limit is not None:
        return arm.torque_limit
    # many files give no effort limit, or one of zero
    effort = body.effort_limits()
    return np.where(effort > 0, effort, np.inf)


def rated_torque(arm: NominalArm, body: RigidBody, space: Workspace) -> np.ndarray:
    """Torque of an action of 1 before its share [N m], shape (n,).

    The torque limit, but no more than the joint bears: ``GENEROUS`` times what motions need, |g| + sum_j |M_ij| a_j +
    I_i a_i + c + b v at the working posture with the largest acceleration a and velocity v of motions, or what gives
    its own inertia M_ii + I_i ``BRISK``. Limits of a URDF are often placeholders, at which a wrist diverges at once.
    """
    posture, limits = space.posture, space.limits
    mass = body.mass_matrix(posture) + np.diag(arm.armature)
    gravity = np.abs(body.bias(posture, np.zeros(len(posture))))
    friction = arm.coulomb + arm.viscous * limits.velocity
    # M, all of it: a joint also carries what the others' accelerations ask of it
    needed = gravity + np.abs(mass) @ limits.acceleration + friction
    return np.minimum(
        torque_limit(arm, body), np.maximum(GENEROUS * needed, BRISK * np.diag(mass))
    )


def pd_gains(inertia: np.ndarray, bandwidth: float, damping: float = DAMPING) -> Gains:
    """kp = w^2 M [N m/rad] and kd = 2 zeta w M [N m s/rad], on inertias M [kg m^2], w = 2 pi ``bandwidth``; (n,)."""
    w = 2 * np.pi * bandwidth
    return Gains(w**2 * inertia, 2 * damping * w * inertia)


def control(
    arm: NominalArm,
    body: RigidBody,
    space: Workspace,
    kind: str,
    share: float | None,
    bandwidth: float,
    reach: float | None = None,
) -> Control:
    """How actions of a kind become torque.

    Args:
        arm: the nominal arm.
        body: its rigid-body model.
        space: where it moves.
        kind: one of ``ACTION_KINDS``.
        share: torque of an action of 1 over the rated torque; that of ``SHARES`` if ``None``.
        bandwidth: of the PD loop [Hz].
        reach: with ``residual``, tracking error at which kp alone commands as much as an action of 1 [rad]; then
            ``share`` must be ``None``.

    Raises:
        InputError: unknown kind, or a reach beside a share or without ``residual``.
    """
    check_known("action", kind, ACTION_KINDS, where="action")
    limit, rated = torque_limit(arm, body), rated_torque(arm, body, space)
    gains = None
    # the torque itself as the action leaves nothing for a loop to do
    if kind != "torque":
        # nominal viscous friction damps the loop already: the stiffness makes good what it takes
        inertia = np.diag(body.mass_matrix(space.posture)) + arm.armature
        kp, kd = pd_gains(inertia, bandwidth)
        gains = Gains(kp + 2 * np.pi * bandwidth * arm.viscous, kd)
    if reach is None:
        return Control(
            kind,
            (SHARES[kind] if share is None else share) * rated,
            rated,
            limit,
            gains,
        )
    if share is not None or gains is None or kind != "residual":
        raise InputError(
            "is for residual actions, and not beside action_share",
            "leave it out",
            where="action_reach",
        )
    return Control(kind, reach * gains.kp, rated, limit, gains)
