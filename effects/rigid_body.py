"""The rigid-body family: effects that change the inertia of the model."""

from __future__ import annotations

import numpy as np

from effects.effect import Inertial, Parameter


def point_mass_parameters(mass: float, com: np.ndarray) -> np.ndarray:
    """Ten inertial parameters of a point mass, in the frame of ``com``; shape (10,).

    m [kg], m c [kg m], and I = m (c.c E - c c^T) [kg m^2] in the order of ``arm.dynamics.INERTIAL_PARAMETERS``.
    """
    c = np.asarray(com, dtype=float)
    inertia = mass * (c @ c * np.eye(3) - np.outer(c, c))
    return np.concatenate([[mass], mass * c, inertia[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]])


ARMATURE = Inertial(
    name="armature",
    family="rigid_body",
    scope="joint",
    equation="I a",
    parameters=(Parameter("inertia", "I", "kg m^2", (-10.0, 50.0), (0.02, 1.3), increment=True),),
    looks_like="a torque proportional to the joint's own acceleration only",
    reference="swevers2007",
    confused_with=(
        ("actuator_delay", "a chirp above 10 Hz"),
        ("payload", "fast motion of this joint alone, arm stretched and folded"),
    ),
)

PAYLOAD = Inertial(
    name="payload",
    family="rigid_body",
    scope="arm",
    equation="Y_last(q, dq, ddq) pi(m, c), a point mass m at c on the last link",
    parameters=(
        Parameter("mass", "m", "kg", (-50.0, 200.0), (0.2, 10.0), increment=True),
        Parameter("com", "c", "m", (-1.0, 1.0), (-0.1, 0.1), size=3),
    ),
    looks_like="coherent gravity and inertia torque on all joints",
    reference="hollerbach2008",
    confused_with=(
        ("torque_scale", "the same motion with a known payload"),
        ("encoder_offset", "static poses over the whole range of every joint"),
    ),
)
