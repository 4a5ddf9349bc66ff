"""Values that stand on several links, and mirror images that are none."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterator
from itertools import product

import numpy as np

from gapscope.model_audit.description import Description, Inertial, Link
from gapscope.model_audit.finding import Finding
from gapscope.model_audit.thresholds import LEAST_MASS, REPEATED_MOMENTS

SIDES = (
    ("left", "right"),
    ("l", "r"),
    ("fl", "fr"),
    ("lf", "rf"),
    ("hl", "hr"),
    ("lh", "rh"),
    ("rl", "rr"),
)
"""Parts of names by which links of the two sides differ."""


def check_repeats(description: Description) -> Iterator[Finding]:
    """Placeholders, the same inertial on different links, and mirrored links whose products of inertia are not."""
    bodies = [
        link
        for link in description.links
        if link.inertial is not None
        and link.inertial.is_body
        and link.inertial.mass >= LEAST_MASS
    ]
    yield from _placeholders(bodies)
    yield from _mirrored(bodies)


def _placeholders(bodies: list[Link]) -> Iterator[Finding]:
    """The same moments on links of other masses, or three equal moments with round numbers on several."""
    same: dict[tuple[float, ...], list[Link]] = defaultdict(list)
    for link in bodies:
        assert link.inertial is not None
        same[tuple(link.inertial.moments.ravel().round(12))].append(link)
    for links in same.values():
        inertials = [link.inertial for link in links if link.inertial is not None]
        first = inertials[0]
        masses = {inertial.mass for inertial in inertials}
        ball = np.ptp(first.diagonal) == 0 and np.allclose(
            first.moments, np.diag(first.diagonal)
        )
        several = len(links) >= REPEATED_MOMENTS
        if not (several and (ball or len(masses) > 1)):
            continue
        names = ", ".join(link.name for link in links)
        yield Finding(
            "implausible",
            "placeholder",
            f"link {links[0].name}",
            first.line,
            f"the same moments ({first.diagonal[0]:g}, {first.diagonal[1]:g}, {first.diagonal[2]:g} kg m^2) on "
            f"{len(links)} links of {min(masses):g} to {max(masses):g} kg: {names}",
            "moments of each link's own mass and shape",
            "these are placeholders: take the values from CAD, or identify the arm (gapscope identify)",
            size=float(np.log(len(links))),
        )


def _mirrored(bodies: list[Link]) -> Iterator[Finding]:
    """Left and right links of which one is no mirror image of the other."""
    by_name = {link.name.lower(): link for link in bodies}
    for name, left in by_name.items():
        right = next((by_name[x] for x in _others(name) if x in by_name), None)
        if right is None or left.inertial is None or right.inertial is None:
            continue
        wrong = _wrong_image(left.inertial, right.inertial)
        if wrong:
            yield Finding(
                "implausible",
                "mirror_image",
                f"link {right.name}",
                right.inertial.line,
                f"{wrong} of {left.name} on the other side",
                "the mirror image: the same mass and principal moments, the signs of two products of inertia changed",
                "mirror the inertial of one side, or take both from CAD",
                size=0.2,
            )


def _others(name: str) -> Iterator[str]:
    """The name with one part for the left side replaced by that for the right."""
    parts = re.split(r"([_\-. ])", name)
    for left, right in SIDES:
        if left in parts:
            yield "".join(right if part == left else part for part in parts)


def _wrong_image(left: Inertial, right: Inertial) -> str:
    """What is not that of a mirror image; empty if all is."""
    if not np.isclose(left.mass, right.mass, rtol=0.02):
        return f"mass {right.mass:g} kg, not {left.mass:g} kg as that"
    scale = np.trace(left.moments)
    own, other = (np.linalg.eigvalsh(one.moments) for one in (left, right))
    if not np.allclose(own, other, atol=0.02 * scale):
        return ""  # other parts, or other moments: not said by the name alone
    images = [
        np.diag(signs)
        for signs in product((1.0, -1.0), repeat=3)
        if np.allclose(np.array(signs) * left.com, right.com, atol=2e-3)
    ]
    mirrored = [image @ left.moments @ image for image in images]
    if not images or any(
        np.allclose(x, right.moments, atol=0.02 * scale) for x in mirrored
    ):
        return ""
    turned = [2 * np.diag(np.diag(x)) - x for x in mirrored]
    if any(np.allclose(x, right.moments, atol=0.02 * scale) for x in turned):
        return "the products of inertia have the opposite sign of the mirror image"
    return ""
