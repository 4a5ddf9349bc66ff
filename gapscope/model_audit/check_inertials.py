"""Inertials that no body has, whatever its shape."""

from __future__ import annotations

from collections.abc import Collection, Iterator

import numpy as np

from gapscope.model_audit.description import Description, Inertial, Link
from gapscope.model_audit.finding import Finding
from gapscope.model_audit.thresholds import (
    LARGEST_BOX_DENSITY,
    LEAST_BOX_DENSITY,
    LEAST_MASS,
    POINT_MASS,
    TRIANGLE_EXCESS,
)

LEAST_EDGE_SHARE = 0.2
"""Least edge of the box of a body, as share of its largest: thinner bodies count as plates of this thickness."""
AXES = ("ixx", "iyy", "izz")


def check_inertials(
    description: Description, with_shape: Collection[str]
) -> Iterator[Finding]:
    """Masses, moments and the triangle inequality of each link, and moved links without mass.

    Args:
        description: the file.
        with_shape: names of links whose size is known; their moments are compared with that elsewhere.
    """
    for link in description.links:
        inertial = link.inertial
        if inertial is None:
            continue
        found = list(_check_body(link, inertial))
        yield from found
        if not found and inertial.is_body and link.name not in with_shape:
            yield from _check_box(f"link {link.name}", inertial)
    yield from _massless(description)


def box_density(inertial: Inertial) -> float:
    """Density [kg/m^3] of the homogeneous box with the body's mass and moments, no edge thinner than a fifth.

    With the variances v_i of the mass along the principal axes, the edges are a_i = sqrt(12 v_i).
    """
    variances = np.maximum(np.linalg.eigvalsh(inertial.variance), 0)
    edges = np.sqrt(12 * variances)
    edges = np.maximum(edges, LEAST_EDGE_SHARE * edges.max())
    return float(inertial.mass / edges.prod())


def _check_body(link: Link, inertial: Inertial) -> Iterator[Finding]:
    place = f"link {link.name}"
    moments = np.linalg.eigvalsh(inertial.moments)
    if inertial.mass <= 0 and not moments.any() and inertial.mass == 0:
        return  # a frame: the same as no inertial
    if inertial.mass <= 0:
        yield Finding(
            "impossible",
            "mass",
            place,
            inertial.line,
            f"mass {inertial.mass:g} kg with moments {_listed(moments)} kg m^2",
            "a mass above zero",
            "give the mass of the data sheet or the drawing",
            size=1e3,
        )
    elif moments.any():
        yield from _check_moments(place, inertial, moments)
    else:
        yield Finding(
            "implausible" if inertial.mass > POINT_MASS else "note",
            "no_moments",
            place,
            inertial.line,
            f"{inertial.mass:g} kg without moments of inertia",
            "the moments of the link's shape",
            "give them; a simulator may refuse a body of zero inertia, or make up its own",
            size=inertial.mass,
        )


def _check_moments(
    place: str, inertial: Inertial, moments: np.ndarray
) -> Iterator[Finding]:
    """Principal moments [kg m^2], (3,), in rising order: above zero, and none above the sum of the others."""
    if moments[0] <= 0:
        yield Finding(
            "impossible",
            "inertia_not_positive",
            place,
            inertial.line,
            f"principal moments {_listed(moments)} kg m^2",
            "all above zero",
            "check the signs of ixx, iyy, izz and the size of ixy, ixz, iyz; they refer to the centre of mass",
            size=100.0,
        )
        return
    excess = moments[2] / (moments[0] + moments[1])
    if excess > 1 + TRIANGLE_EXCESS:
        yield Finding(
            "impossible",
            "triangle_inequality",
            place,
            inertial.line,
            f"principal moments {_listed(moments)} kg m^2: the largest is {excess:.3g} times the sum of the others",
            "no moment above the sum of the other two",
            slipped_digit(inertial) or "take the moments from the CAD model again",
            size=float(inertial.mass * (excess - 1) + (excess - 1)),
        )


def _check_box(place: str, inertial: Inertial) -> Iterator[Finding]:
    """The homogeneous box of the same mass and moments has a density that bodies have."""
    if inertial.mass < LEAST_MASS:
        return
    density = box_density(inertial)
    if LEAST_BOX_DENSITY <= density <= LARGEST_BOX_DENSITY:
        return
    light = density < LEAST_BOX_DENSITY
    bound = LEAST_BOX_DENSITY if light else LARGEST_BOX_DENSITY
    radius = np.sqrt(np.trace(inertial.variance))
    # at one mass the density of a box goes with its moments to the power -3/2
    usual = 1000.0
    factor = (density / usual) ** (2 / 3)
    yield Finding(
        "implausible",
        "moments_for_mass",
        place,
        inertial.line,
        f"a body of {inertial.mass:.3g} kg with these moments has a radius of gyration of {radius:.3g} m, as a box of "
        f"{density:.2g} kg/m^3",
        f"{LEAST_BOX_DENSITY:g} to {LARGEST_BOX_DENSITY:g} kg/m^3; at {usual:g} kg/m^3 the moments are some "
        f"{_factor(factor)}",
        "check the unit of the moments (kg m^2, not kg mm^2 or g mm^2) and the point that they refer to: the centre of "
        "mass, not the link's origin",
        size=float(abs(np.log(density / bound))),
    )


def slipped_digit(inertial: Inertial) -> str:
    """Which of the three moments, ten times larger or smaller, would be possible; empty if none or many would be."""
    fits = []
    for axis, name in enumerate(AXES):
        for factor in (0.1, 10.0):
            diagonal = inertial.diagonal.copy()
            diagonal[axis] *= factor
            if diagonal.max() <= (diagonal.sum() - diagonal.max()) * 1.02:
                fits.append(f"{name} = {diagonal[axis]:g}")
    if not 1 <= len(fits) <= 2:
        return ""
    return f"a digit may have slipped: {' or '.join(fits)} would be possible; compare with the CAD model"


def _massless(description: Description) -> Iterator[Finding]:
    """Moving links that carry no mass, alone or by what is fixed to them."""
    for joint in description.moving:
        known = {link.name for link in description.links}
        if joint.child not in known:
            continue
        parts = [link for link, _ in description.rigid_part(joint.child)]
        if any(part.inertial and part.inertial.mass > 0 for part in parts):
            continue
        # MuJoCo computes the inertial from the shapes
        if description.form == "MJCF" and any(part.shapes for part in parts):
            continue
        last = not any(
            below.kind != "fixed"
            for part in parts
            for below in description.joints_below(part.name)
        )
        line = description.link(joint.child).line
        yield Finding(
            "impossible" if last else "implausible",
            "no_mass",
            f"link {joint.child}",
            line,
            f"moved by {joint.name}, and has no mass",
            "each moved link with mass and inertia",
            "give it an <inertial>"
            + (
                "; a simulator cannot move it otherwise"
                if last
                else ", unless it is half of a joint"
            ),
            size=1.0,
        )


def _listed(moments: np.ndarray) -> str:
    return ", ".join(f"{moment:.3g}" for moment in moments)


def _factor(factor: float) -> str:
    return (
        f"{factor:.2g} times as large" if factor > 1 else f"1/{1 / factor:.2g} of these"
    )
