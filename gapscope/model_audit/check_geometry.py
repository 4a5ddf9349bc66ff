"""Mass, centre of mass and moments of each link against its shapes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from gapscope.model_audit.description import Description, Inertial, Link
from gapscope.model_audit.finding import Finding
from gapscope.model_audit.geometry import Geometry, distance_outside
from gapscope.model_audit.thresholds import (
    HULL_TOLERANCE,
    LARGEST_DENSITY,
    LEAST_DENSITY,
    LEAST_MASS,
    LEAST_MOMENT_SHARE,
    OUTSIDE,
)


def check_geometry(
    description: Description, geometries: Mapping[str, Geometry]
) -> Iterator[Finding]:
    """Density, centre and moments of each link that has a shape."""
    for link in description.links:
        inertial, geometry = link.inertial, geometries.get(link.name)
        if inertial is None or geometry is None or not inertial.is_body:
            continue
        if inertial.mass >= LEAST_MASS:
            yield from _density(link, inertial, geometry)
            yield from _centre(link, inertial, geometry)
            yield from _size(link, inertial, geometry)


def _density(link: Link, inertial: Inertial, geometry: Geometry) -> Iterator[Finding]:
    density = inertial.mass / geometry.volume
    if LEAST_DENSITY <= density <= LARGEST_DENSITY:
        return
    bound = LEAST_DENSITY if density < LEAST_DENSITY else LARGEST_DENSITY
    yield Finding(
        "implausible",
        "density",
        f"link {link.name}",
        inertial.line,
        f"{inertial.mass:.3g} kg in shapes of {1e3 * geometry.volume:.3g} dm^3: {density:.2g} kg/m^3",
        f"{LEAST_DENSITY:g} to {LARGEST_DENSITY:g} kg/m^3",
        "check the mass, its unit, and the scale of the meshes",
        size=float(abs(np.log(density / bound))),
    )


def _centre(link: Link, inertial: Inertial, geometry: Geometry) -> Iterator[Finding]:
    outside = distance_outside(geometry, inertial.com)
    if outside <= OUTSIDE * geometry.edge:
        return
    yield Finding(
        "implausible",
        "com_outside",
        f"link {link.name}",
        inertial.line,
        f"centre of mass {_vector(inertial.com)} m is {outside:.3g} m outside the link's shapes",
        f"inside, near {_vector(geometry.centre)} m, the middle of the shapes",
        "check the unit and the frame of <origin>: it is given in the link's frame, not in that of the base or the CAD "
        "assembly",
        size=outside / geometry.edge,
    )


def _size(link: Link, inertial: Inertial, geometry: Geometry) -> Iterator[Finding]:
    """Moments larger than the hull allows, or next to nothing."""
    variances, axes = np.linalg.eigh(inertial.variance)
    along = geometry.points @ axes
    low, high = along.min(axis=0), along.max(axis=0)
    middle, half = (low + high) / 2, (high - low) / 2 * (1 + HULL_TOLERANCE)
    offset = np.minimum(np.abs(inertial.com @ axes - middle), half)
    # Bhatia and Davis: no mass within [a, b] around a mean c varies by more than (b - c)(c - a)
    bound = (half - offset) * (half + offset)
    # a centre beyond the hull is another finding, and leaves no bound
    bound = np.where(offset < half, bound, half**2)
    worst = int((variances / bound).argmax())
    ratio = float(variances[worst] / bound[worst])
    solid = float(np.trace(inertial.variance) / np.trace(geometry.variance))
    if ratio > 1:
        yield Finding(
            "impossible",
            "moments_too_large",
            f"link {link.name}",
            inertial.line,
            f"the mass spreads {np.sqrt(variances[worst]):.3g} m about its centre (standard deviation along "
            f"{_vector(axes[:, worst])}), and the shapes have room for {np.sqrt(bound[worst]):.3g} m; the moments are "
            f"{solid:.3g} times those of a solid of that shape",
            "no more than with all mass on the surface of the shapes",
            f"check the moments, their unit, and that they refer to the centre of mass; a solid has {1 / solid:.2g} "
            "times these",
            size=float(np.log(ratio)),
        )
    elif solid < LEAST_MOMENT_SHARE:
        yield Finding(
            "implausible",
            "moments_too_small",
            f"link {link.name}",
            inertial.line,
            f"the moments are {solid:.2g} times those of a solid of the link's shapes",
            f"at least {LEAST_MOMENT_SHARE:g} times: casing and motor do not sit in one point",
            f"check the moments and their unit; a solid has {1 / solid:.2g} times these",
            size=float(-np.log(solid / LEAST_MOMENT_SHARE)),
        )


def _vector(values: np.ndarray) -> str:
    return "(" + ", ".join(f"{value:.3g}" for value in values) + ")"
