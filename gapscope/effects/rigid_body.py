"""The rigid-body family: effects that change the inertia of the model."""

from __future__ import annotations

import numpy as np

from gapscope.arm.known_load import point_mass_parameters
from gapscope.effects.effect import Inertial, LinkChange, Parameter


def payload_change(own: np.ndarray, mass: np.ndarray, com: np.ndarray) -> np.ndarray:
    """A point mass m [kg] at c [m] in the frame of the joint that moves the last link; shape (10,)."""
    return point_mass_parameters(float(mass), com)


def link_change(
    own: np.ndarray, link: np.ndarray, mass: np.ndarray, com: np.ndarray
) -> np.ndarray:
    """Ten parameters that a link with ``own`` gains when its mass is off by dm [kg] and its centre by dc [m].

    m' = m + dm, c' = c + dc, and the inertia about the centre of mass scales with the mass, I' = I m' / m; one of a
    massless link stays. Frame of the joint that moves the link.
    """
    old = float(own[0])
    centre = own[1:4] / old if old != 0 else np.zeros(3)
    about_centre = own - point_mass_parameters(old, centre)
    new = old + float(mass)
    moved = point_mass_parameters(new, centre + com)
    moved[4:] += about_centre[4:] * (new / old if old != 0 else 1.0)
    return moved - own


ARMATURE = Inertial(
    name="armature",
    family="rigid_body",
    scope="joint",
    equation="I a",
    parameters=(
        Parameter("inertia", "I", "kg m^2", (-10.0, 50.0), (0.02, 1.3), increment=True),
    ),
    looks_like="a torque proportional to the joint's own acceleration only",
    reference="swevers2007",
    confused_with=(
        ("actuator_delay", "a chirp above 10 Hz"),
        ("payload", "fast motion of this joint alone, arm stretched and folded"),
    ),
)

PAYLOAD = LinkChange(
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
    change=payload_change,
)

LINK_INERTIA = LinkChange(
    name="link_inertia",
    family="rigid_body",
    scope="link",
    equation="Y_link(q, dq, ddq) (pi(m + dm, c + dc, I (m + dm) / m) - pi(m, c, I))",
    parameters=(
        Parameter("link", "l", "1", (1.0, 100.0), (1.0, 7.0)),
        Parameter("mass", "dm", "kg", (-100.0, 100.0), (-2.0, 2.0), increment=True),
        Parameter("com", "dc", "m", (-1.0, 1.0), (-0.03, 0.03), size=3, increment=True),
    ),
    looks_like="gravity and inertia torque on the joints that carry this link, and on none beyond it",
    reference="hollerbach2008",
    confused_with=(
        ("payload", "fast motion of the last joints alone"),
        ("armature", "the same motion with the other joints in another posture"),
    ),
    change=link_change,
)
