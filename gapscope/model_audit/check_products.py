"""Signs of the products of inertia: a URDF has minus the integral of x y, some CAD programs write plus."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from gapscope.model_audit.description import Description, Inertial
from gapscope.model_audit.finding import Finding
from gapscope.model_audit.geometry import Geometry
from gapscope.model_audit.thresholds import (
    OPPOSITE_LINKS,
    OPPOSITE_PRODUCTS,
    OPPOSITE_SHARE,
    SKEW,
)

ABOVE = np.triu_indices(3, 1)
"""Places of the products in a matrix of moments."""


def check_products(
    description: Description, geometries: Mapping[str, Geometry]
) -> Iterator[Finding]:
    """Links that lie askew in their frames, and whose products of inertia have the opposite sign of their shapes'."""
    cosines = {}
    for link in description.links:
        if link.inertial is None or not link.inertial.is_body:
            continue
        if (geometry := geometries.get(link.name)) is not None:
            cosine = _cosine(link.inertial, geometry)
            if cosine is not None:
                cosines[link.name] = cosine
    opposite = [name for name, cosine in cosines.items() if cosine < OPPOSITE_PRODUCTS]
    if len(opposite) < max(OPPOSITE_LINKS, OPPOSITE_SHARE * len(cosines)):
        return
    first = description.link(opposite[0])
    yield Finding(
        "implausible",
        "products_of_inertia",
        f"link {first.name}",
        first.inertial.line if first.inertial else first.line,
        f"ixy, ixz, iyz of {len(opposite)} of {len(cosines)} links have the opposite sign of those of their shapes: "
        f"{', '.join(opposite)}",
        "products of inertia as in a matrix of moments, ixy = - integral of x y dm",
        "change their signs: the CAD program writes them with positive signs (SolidWorks calls it the positive tensor "
        "notation)",
        size=1.0,
    )


def _cosine(inertial: Inertial, geometry: Geometry) -> float | None:
    """Cosine between the products of a body and of its shape; ``None`` if one of them hardly has any."""
    body, shape = inertial.variance, geometry.variance
    own, expected = body[ABOVE], shape[ABOVE]
    sizes = np.linalg.norm(own), np.linalg.norm(expected)
    if sizes[0] < SKEW * np.trace(body) or sizes[1] < SKEW * np.trace(shape):
        return None
    return float(own @ expected / sizes[0] / sizes[1])
