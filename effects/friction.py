"""The friction family: torque laws that oppose the motion of one joint."""

from __future__ import annotations

import numpy as np

from arm.nominal import smooth_sign
from effects.effect import Parameter, TorqueLaw


def coulomb(velocity: np.ndarray, load: np.ndarray, torque: np.ndarray) -> np.ndarray:
    """c sgn v [N m]; c in N m, v in rad/s."""
    return torque * smooth_sign(velocity)


def viscous(velocity: np.ndarray, load: np.ndarray, coefficient: np.ndarray) -> np.ndarray:
    """b v [N m]; b in N m s/rad, v in rad/s."""
    return coefficient * velocity


def load_dependent(velocity: np.ndarray, load: np.ndarray, coefficient: np.ndarray) -> np.ndarray:
    r"""mu \|tau_load\| sgn v [N m], with tau_load the motor torque that itself overcomes this friction.

    With ``load`` the torque before load friction, tau = load + mu \|tau\| sgn v has the closed solution
    tau = load / (1 - mu sgn(v) sgn(load)), so that the law is tau - load. Needs \|mu\| < 1.
    """
    directed = coefficient * smooth_sign(velocity) * np.sign(load)
    return load * directed / (1.0 - directed)


COULOMB = TorqueLaw(
    name="coulomb_friction",
    family="friction",
    scope="joint",
    equation="c sgn v",
    parameters=(Parameter("torque", "c", "N m", (-200.0, 200.0), (0.1, 14.0), increment=True),),
    looks_like="an odd step of the torque at v = 0",
    reference="gaz2019",
    confused_with=(
        ("load_friction", "the same motion with two payloads"),
        ("viscous_friction", "the same path at a tenth of the speed"),
    ),
    law=coulomb,
)

VISCOUS = TorqueLaw(
    name="viscous_friction",
    family="friction",
    scope="joint",
    equation="b v",
    parameters=(Parameter("coefficient", "b", "N m s/rad", (-200.0, 200.0), (0.03, 15.0), increment=True),),
    looks_like="a torque linear and odd in velocity",
    reference="swevers2007",
    confused_with=(
        ("coulomb_friction", "the same path at a tenth of the speed"),
        ("armature", "slow and fast runs of the same path"),
    ),
    law=viscous,
)

LOAD = TorqueLaw(
    name="load_friction",
    family="friction",
    scope="joint",
    equation="mu |tau_load| sgn v",
    parameters=(Parameter("coefficient", "mu", "1", (0.0, 0.8), (0.03, 0.31)),),
    looks_like="a friction loop whose width grows with the load",
    reference="hamon2010",
    confused_with=(
        ("coulomb_friction", "the same motion with two payloads"),
        ("torque_scale", "static poses under load, then slow reversals"),
    ),
    law=load_dependent,
)
