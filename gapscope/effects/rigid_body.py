"""The rigid-body family: effects that change the inertia of the model."""

from __future__ import annotations

import numpy as np

from gapscope.arm.known_load import point_mass_parameters
from gapscope.effects.arm_scale import ArmScale
from gapscope.effects.effect import Inertial, LinkChange, derivative
from gapscope.effects.parameter import Parameter
from gapscope.effects.parametrisation import (
    Parametrisation,
    Values,
    linear_in,
    nonzero,
)
from gapscope.effects.signals import Drawn, drawn


def link_change(
    own: np.ndarray, link: np.ndarray, mass: np.ndarray, com: np.ndarray
) -> np.ndarray:
    """Ten parameters that a link with ``own`` gains when its mass is off by dm [kg] and its centre by dc [m].

    m' = m + dm, c' = c + dc, and the inertia about the centre of mass scales with the mass, I' = I m' / m; one of a
    massless link stays. Frame of the joint that moves the link.
    """
    old = float(own[0])
    # a massless link has neither a centre nor inertia that scales with mass
    centre = own[1:4] / old if old != 0 else np.zeros(3)
    # inertia about the centre of mass: what is beside a point mass there
    about_centre = own - point_mass_parameters(old, centre)
    new = old + float(mass)
    moved = point_mass_parameters(new, centre + com)
    # a link of another mass keeps its shape: inertia goes with the mass
    moved[4:] += about_centre[4:] * (new / old if old != 0 else 1.0)
    return moved - own


def payload_tangent(x: np.ndarray) -> np.ndarray:
    """Derivative of the payload's ten inertial parameters by mass and first moment, (10, 4)."""
    mass = float(x[0])
    # around nothing only mass and first moment count, whose squares the moments of inertia are
    if abs(mass) < 1e-3:
        return np.eye(10, 4)

    def change(x: np.ndarray) -> np.ndarray:
        return point_mass_parameters(x[0], x[1:] / x[0])

    # a step of the mass for all: first moments are of its order
    return derivative(change, x, 1e-4 * abs(mass))


def clip_payload(x: np.ndarray) -> np.ndarray:
    """Mass moved into its bounds, first moment to where the centre of mass lies within its own."""
    mass = np.clip(x[0], *LOAD_MASS.bounds)
    # the centre of mass is first moment over mass: its bounds grow with the mass
    farthest = np.abs(mass) * LOAD_COM.bounds[1]
    return np.vstack([mass, np.clip(x[1:], -farthest, farthest)])


def clip_link(x: np.ndarray) -> np.ndarray:
    """dm and dc moved into their bounds."""
    return np.vstack(
        [np.clip(x[0], *LINK_MASS.bounds), np.clip(x[1:], *LINK_COM.bounds)]
    )


def draw_payload(rng: np.random.Generator, scale: ArmScale, j: np.ndarray) -> Values:
    """10 to 60 % of what the arm may carry, within 12 cm of the last joint's frame."""
    # a tool lies beyond the flange, not within the arm
    com = np.array([*rng.uniform(-0.05, 0.05, 2), rng.uniform(0.0, 0.1)])
    return {"mass": np.array(scale.lift * rng.uniform(0.1, 0.6)), "com": com}


def draw_link(rng: np.random.Generator, scale: ArmScale, j: np.ndarray) -> Values:
    """10 to 40 % of the mass of a link that has one, more or less, and up to 2 cm along each axis."""
    # a massless link has nothing of which a share could be missing
    link = int(rng.choice(np.flatnonzero(scale.mass > 0)))
    return {
        "link": np.array(link + 1.0),
        "mass": rng.choice([-1.0, 1.0]) * rng.uniform(0.1, 0.4) * scale.mass[link],
        "com": rng.uniform(-0.02, 0.02, 3),
    }


MIN_LINK_MASS = 0.05
"""Share of its nominal mass that a changed link keeps at least [1]. (physical)"""
ROTOR_INERTIA = Parameter(
    "inertia", "I", "kg m^2", (-1e3, 5e3), (0.02, 1.3), increment=True
)
LOAD_MASS = Parameter("mass", "m", "kg", (-50.0, 200.0), (0.2, 10.0), increment=True)
LOAD_COM = Parameter("com", "c", "m", (-1.0, 1.0), (-0.1, 0.1), size=3, severity=0)
LINK_MASS = Parameter("mass", "dm", "kg", (-100.0, 100.0), (-2.0, 2.0), increment=True)
LINK_COM = Parameter(
    "com", "dc", "m", (-1.0, 1.0), (-0.03, 0.03), size=3, increment=True
)


ARMATURE = Inertial(
    name="armature",
    family="rigid_body",
    scope="joint",
    equation="I a",
    parameters=(ROTOR_INERTIA,),
    looks_like="a torque proportional to the joint's own acceleration only",
    reference="swevers2007",
    confused_with=(
        ("actuator_delay", "a chirp above 10 Hz"),
        ("payload", "fast motion of this joint alone, arm stretched and folded"),
    ),
    parametrisation=linear_in(ROTOR_INERTIA, data_sheet="armature"),
    built_in=True,
    severity=drawn(inertia=Drawn(0.2, 1.0, of="rotor", each=False)),
    side="actuator",
    reach="joint",
    plotted_against="acceleration",
    quantities={"inertia": "rotor"},
)

PAYLOAD = LinkChange(
    name="payload",
    family="rigid_body",
    scope="arm",
    equation="Y_last(q, dq, ddq) pi(m, c), a point mass m at c on the last link",
    parameters=(LOAD_MASS, LOAD_COM),
    looks_like="coherent gravity and inertia torque on all joints",
    reference="hollerbach2008",
    confused_with=(
        ("torque_scale", "the same motion with a known payload"),
        ("encoder_offset", "static poses over the whole range of every joint"),
    ),
    change=lambda own, mass, com: point_mass_parameters(float(mass), com),
    tangent_at=payload_tangent,
    parametrisation=Parametrisation(
        lambda x, _: {"mass": x[0], "com": x[1:] / nonzero(x[0])},
        linear=4,
        # no more can be missing than the last link's own mass
        lowest=lambda masses, last: -float(masses[last]),
        proportions=(1.0, *[LOAD_COM.typical[1]] * 3),
        clip=clip_payload,
    ),
    severity=draw_payload,
    quantities={"mass": "load", "com": "load"},
)

LINK_INERTIA = LinkChange(
    name="link_inertia",
    family="rigid_body",
    scope="link",
    equation="Y_link(q, dq, ddq) (pi(m + dm, c + dc, I (m + dm) / m) - pi(m, c, I))",
    parameters=(
        Parameter("link", "l", "1", (1.0, 100.0), (1.0, 7.0), severity=0),
        LINK_MASS,
        LINK_COM,
    ),
    looks_like="gravity and inertia torque on the joints that carry this link, and on none beyond it",
    reference="hollerbach2008",
    confused_with=(
        ("payload", "fast motion of the last joints alone"),
        ("armature", "the same motion with the other joints in another posture"),
    ),
    change=link_change,
    parametrisation=Parametrisation(
        lambda x, _: {"mass": x[0], "com": x[1:]},
        linear=4,
        lowest=lambda masses, last: (MIN_LINK_MASS - 1.0) * masses,
        clip=clip_link,
    ),
    built_in=True,
    severity=draw_link,
    quantities={"link": "body", "mass": "body", "com": "body"},
)
