"""What can be odd about a model file, one function each, with the remedy."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product

import numpy as np
from scipy.stats import f as fisher

from gapscope.arm.display import figures
from gapscope.arm.dynamics.description import (
    Description,
    Inertial,
    Joint,
    Link,
    tree_faults,
)
from gapscope.arm.dynamics.inertials import TRIANGLE_EXCESS, box_edges
from gapscope.model_audit.description import Finding, Geometry, distance_outside

# All thresholds of the audit, each with its meaning, its unit in brackets and where it comes from in parentheses.
#
# ``physical`` follows from what bodies and arms are made of; ``hand`` was set on the models named in
# ``experiments/35_audit.py`` as training, and is judged on the others.


# fmt: off

# --- inertials
MIN_MASS = 1e-3  # A link below is a frame with a dummy inertial, not a body [kg]. (physical)

POINT_MASS = 0.1  # Lighter parts may be points, as sensors and tools often are [kg]. (hand)
# Links lighter than this share of the robot hardly change its torque: what is odd about them is a note [1]. (hand)
LIGHT_SHARE = 0.005

# --- mass and moments against the shapes of the link
# Densest bodies are steel and copper, 7850 and 8960; beyond, shapes or mass are wrong [kg/m^3]. (physical)
LARGEST_DENSITY = 9000.0
# Mass over the volume of a closed casing; the lightest arms, of carbon and air, stay above [kg/m^3]. (hand)
MIN_DENSITY = 100.0
# The homogeneous box of the same mass and moments is as dense as this at least; rods and frames are light [kg/m^3].
MIN_BOX_DENSITY = 40.0  # (hand)
LARGEST_BOX_DENSITY = 20_000.0  # And at most: mass in the middle of a casing makes a small box [kg/m^3]. (hand)
# No body has a variance along an axis above (b - c)(c - a) for a hull from a to b and a centre c (Bhatia and Davis);
# lengths may be off by this share, since casings are drawn simplified [1]. (hand)
HULL_TOLERANCE = 0.25
# Moments are to be at least this share of those of a homogeneous body of the same shape [1]. (hand)
MIN_MOMENT_SHARE = 0.1
# The centre of mass may lie outside the hull by this share of its largest edge [1]. (hand)
OUTSIDE = 0.15

# Products of inertia tell a sign if they are this share of the trace of the variance at least [1]. (hand)
SKEW = 0.05
OPPOSITE_PRODUCTS = -0.7  # Cosine between the products of body and shape below which they are opposite [1]. (hand)
OPPOSITE_LINKS = 2  # Fewest such links [1]. (hand)
OPPOSITE_SHARE = 0.75  # Share of the links that tell a sign [1]. (hand)

# --- inertials of neighbours
# By how much another assignment has to fit better, mean over links of the logarithm of the misfit [1]. (hand)
SHIFT_GAIN = 0.25
SHIFT_LINKS = 3  # Fewest links on which shifted inertials can be told [1]. (physical)
SHIFT_SHARE = 0.6  # Share of links that have to fit better [1]. (hand)
# Level of the F test by which masses alone are said to be shifted [1]. (statistics)
MASS_SHIFT_LEVEL = 0.02
# Healthy arms have moments per mass and size that differ by this at least: a smaller spread after a shift is what
# the arm had before it, standard deviation of the logarithm [1]. (hand)
MASS_SHIFT_SPREAD = 0.2

# --- placeholders
REPEATED_MOMENTS = 3  # So many links with the very same moments are a placeholder [1]. (hand)
SAME_ON_JOINTS = 4  # From so many joints on, the same value on all of them was not measured [1]. (hand)

# --- joints
AXIS_LENGTH = 1e-3  # Axes differ from length one by less, after rounding [1]. (physical)
STANDARD_GRAVITY = 9.80665  # [m/s^2]. (physical)
GRAVITY_TOLERANCE = 0.05  # On Earth gravity is within 0.3 % of it; rounding to 10 is 2 % [m/s^2]. (physical)

# --- static poses
REST_SPEED = 0.02  # A joint slower than this over a whole pose is at rest [rad/s]. (physical)
MIN_POSE = 0.3  # Shortest rest that counts as a pose [s]. (hand)
MIN_POSES = 5  # Fewest poses from which gravity torque is judged [1]. (hand)
GRAVITY_MISFIT = 0.1  # Gravity torque off by less than this share of its spread is as it should be [1]. (hand)
OPPOSITE = -0.5  # A joint's torque is of the other sign if it correlates with the model's below this [1]. (hand)



# Signs of the products of inertia: a URDF has minus the integral of x y, some CAD programs write plus.


ABOVE = np.triu_indices(3, 1)
"""Places of the products in a matrix of moments."""


def check_products(
    description: Description, geometries: Mapping[str, Geometry]
) -> Iterator[Finding]:
    """Links that lie askew in their frames, and whose products of inertia have the opposite sign of their shapes'."""
    cosines = {}
    for link in description.links:
        inertial, geometry = link.inertial, geometries.get(link.name)
        if inertial is None or not inertial.is_body or geometry is None:
            continue
        spreads = (inertial.variance, geometry.variance)
        own, shape = (spread[ABOVE] for spread in spreads)
        sizes = np.array([np.linalg.norm(own), np.linalg.norm(shape)])
        # one that hardly lies askew tells no sign
        if (sizes >= SKEW * np.trace(spreads, axis1=1, axis2=2)).all():
            cosines[link.name] = float(own @ shape / sizes.prod())
    opposite = [name for name, cosine in cosines.items() if cosine < OPPOSITE_PRODUCTS]
    if len(opposite) < max(OPPOSITE_LINKS, OPPOSITE_SHARE * len(cosines)):
        return
    yield Finding(
        "implausible",
        "products_of_inertia",
        *description.by_name[opposite[0]].where,
        f"ixy, ixz, iyz of {len(opposite)} of {len(cosines)} links have the opposite sign of those of their shapes: "
        f"{', '.join(opposite)}",
        "products of inertia as in a matrix of moments, ixy = - integral of x y dm",
        "change their signs: the CAD program writes them with positive signs (SolidWorks calls it the positive tensor "
        "notation)",
        size=1.0,
    )


# Inertials that no body has, whatever its shape.


MIN_EDGE_SHARE = 0.2
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
        mass, moments = inertial.mass, np.linalg.eigvalsh(inertial.moments)
        said = f"principal moments {figures(moments, 3)} kg m^2"
        if mass == 0 and not moments.any():
            continue  # a frame: the same as no inertial
        if mass <= 0:
            yield Finding(
                "impossible",
                "mass",
                *link.where,
                f"mass {mass:g} kg with moments {figures(moments, 3)} kg m^2",
                "a mass above zero",
                "give the mass of the data sheet or the drawing",
                size=1e3,
            )
        elif not moments.any():
            yield Finding(
                "implausible" if mass > POINT_MASS else "note",
                "no_moments",
                *link.where,
                f"{mass:g} kg without moments of inertia",
                "the moments of the link's shape",
                "give them; a simulator may refuse a body of zero inertia, or make up its own",
                size=mass,
            )
        elif moments[0] <= 0:
            yield Finding(
                "impossible",
                "inertia_not_positive",
                *link.where,
                said,
                "all above zero",
                "check the signs of ixx, iyy, izz and the size of ixy, ixz, iyz; they refer to the centre of mass",
                size=100.0,
            )
        elif (excess := moments[2] / (moments[0] + moments[1])) > 1 + TRIANGLE_EXCESS:
            yield Finding(
                "impossible",
                "triangle_inequality",
                *link.where,
                f"{said}: the largest is {excess:.3g} times the sum of the others",
                "no moment above the sum of the other two",
                slipped_digit(inertial) or "take the moments from the CAD model again",
                size=float((mass + 1) * (excess - 1)),
            )
        elif inertial.is_body and link.name not in with_shape:
            yield from _check_box(link, inertial)
    yield from _massless(description)


def box_density(inertial: Inertial) -> float:
    """Density [kg/m^3] of the homogeneous box with the body's mass and moments, no edge thinner than a fifth."""
    edges = box_edges(inertial.mass, np.linalg.eigvalsh(inertial.moments))
    return float(inertial.mass / np.maximum(edges, MIN_EDGE_SHARE * edges.max()).prod())


def _check_box(link: Link, inertial: Inertial) -> Iterator[Finding]:
    """The homogeneous box of the same mass and moments has a density that bodies have."""
    if inertial.mass < MIN_MASS:
        return
    density = box_density(inertial)
    bound = np.clip(density, MIN_BOX_DENSITY, LARGEST_BOX_DENSITY)
    if density == bound:
        return
    radius = np.sqrt(np.trace(inertial.variance))
    # at one mass the density of a box goes with its moments to the power -3/2
    usual = 1000.0
    factor = (density / usual) ** (2 / 3)
    yield Finding(
        "implausible",
        "moments_for_mass",
        *link.where,
        f"a body of {inertial.mass:.3g} kg with these moments has a radius of gyration of {radius:.3g} m, as a box of "
        f"{density:.2g} kg/m^3",
        f"{MIN_BOX_DENSITY:g} to {LARGEST_BOX_DENSITY:g} kg/m^3; at {usual:g} kg/m^3 the moments are some "
        f"{_factor(factor)}",
        "check the unit of the moments (kg m^2, not kg mm^2 or g mm^2) and the point that they refer to: the centre of "
        "mass, not the link's origin",
        size=float(abs(np.log(density / bound))),
    )


def slipped_digit(inertial: Inertial) -> str:
    """Which of the three moments, ten times larger or smaller, would be possible; empty if none or many would be."""
    fits = []
    for axis, name in enumerate(AXES):
        # ixx, iyy, izz are those of the file, one digit off at a time
        for factor in (0.1, 10.0):
            diagonal = inertial.diagonal.copy()
            diagonal[axis] *= factor
            if diagonal.max() <= (diagonal.sum() - diagonal.max()) * 1.02:
                fits.append(f"{name} = {diagonal[axis]:g}")
    # one or two ways to mend it are a hint, more are none
    if not 1 <= len(fits) <= 2:
        return ""
    return f"a digit may have slipped: {' or '.join(fits)} would be possible; compare with the CAD model"


def _massless(description: Description) -> Iterator[Finding]:
    """Moving links that carry no mass, alone or by what is fixed to them."""
    for joint in description.moving:
        child = description.by_name.get(joint.child)
        # between several joints of one body there is nothing
        if child is None or not child.line:
            continue
        # what is fixed to a link weighs with it
        parts = [link for link, _ in description.rigid_part(joint.child)]
        if any(part.inertial and part.inertial.mass > 0 for part in parts):
            continue
        # MuJoCo computes the inertial from the shapes
        if description.form == "MJCF" and any(part.shapes for part in parts):
            continue
        # half of a joint may be without mass as long as what it carries has some
        last = all(
            below.kind == "fixed"
            for part in parts
            for below in description.below(part.name)
        )
        yield Finding(
            "impossible" if last else "implausible",
            "no_mass",
            f"link {joint.child}",
            child.line,
            f"moved by {joint.name}, and has no mass",
            "each moved link with mass and inertia",
            "give it an <inertial>; a simulator cannot move it otherwise"
            if last
            else "give it an <inertial>, unless it is half of a joint",
            size=1.0,
        )


def _factor(factor: float) -> str:
    return (
        f"{factor:.3g} times as large" if factor > 1 else f"1/{1 / factor:.3g} of these"
    )



# Values that stand on several links, and mirror images that are none.


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
        (link, own)
        for link in description.links
        if (own := link.inertial) and own.is_body and own.mass >= MIN_MASS
    ]
    # the same moments on links of other masses, or three equal moments with round numbers on several
    same = defaultdict(list)
    for link, own in bodies:
        same[tuple(own.moments.ravel().round(12))].append((link, own))
    for alike in same.values():
        links, masses = [link for link, _ in alike], {own.mass for _, own in alike}
        _, first = alike[0]
        x, y, z = first.diagonal
        ball = x == y == z and np.allclose(first.moments, np.diag(first.diagonal))
        # equal moments on equal masses may be the same part, used several times
        if len(links) < REPEATED_MOMENTS or not (ball or len(masses) > 1):
            continue
        names = ", ".join(link.name for link in links)
        yield Finding(
            "implausible",
            "placeholder",
            *links[0].where,
            f"the same moments ({x:g}, {y:g}, {z:g} kg m^2) on {len(links)} links of {min(masses):g} to "
            f"{max(masses):g} kg: {names}",
            "moments of each link's own mass and shape",
            "these are placeholders: take the values from CAD, or identify the arm (gapscope identify)",
            size=float(np.log(len(links))),
        )
    yield from _mirrored(bodies)


def _mirrored(bodies: Sequence[tuple[Link, Inertial]]) -> Iterator[Finding]:
    """Left and right links of which one is no mirror image of the other."""
    by_name = {link.name.lower(): (link, own) for link, own in bodies}
    for name, (left, own) in by_name.items():
        # the name with one part for the left side replaced by that for the right
        parts = re.split(r"([_\-. ])", name)
        others = [
            "".join(right if part == side else part for part in parts)
            for side, right in SIDES
            if side in parts
        ]
        images = (by_name[x] for x in others if x in by_name)
        right, other = next(images, (left, own))
        if right is not left and (wrong := _wrong_image(own, other)):
            yield Finding(
                "implausible",
                "mirror_image",
                *right.where,
                f"{wrong} of {left.name} on the other side",
                "the mirror image: the same mass and principal moments, the signs of two products of inertia changed",
                "mirror the inertial of one side, or take both from CAD",
                size=0.2,
            )


def _wrong_image(left: Inertial, right: Inertial) -> str:
    """What is not that of a mirror image; empty if all is."""
    if not np.isclose(left.mass, right.mass, rtol=0.02):
        return f"mass {right.mass:g} kg, not {left.mass:g} kg as that"
    near = partial(np.allclose, atol=0.02 * np.trace(left.moments))
    # other parts, or other moments: not said by the name alone
    if not near(*(np.linalg.eigvalsh(one.moments) for one in (left, right))):
        return ""
    # centres say about which planes the two sides are mirrored
    mirrored = [
        np.diag(signs) @ left.moments @ np.diag(signs)
        for signs in product((1.0, -1.0), repeat=3)
        if np.allclose(np.array(signs) * left.com, right.com, atol=2e-3)
    ]
    # products of the other sign: the matrix with its off-diagonals turned
    turned = [2 * np.diag(np.diag(x)) - x for x in mirrored]
    right_way, wrong_way = (
        any(near(x, right.moments) for x in each) for each in (mirrored, turned)
    )
    if wrong_way and not right_way:
        return "the products of inertia have the opposite sign of the mirror image"
    return ""



# Tree, axes, limits, friction and rotors of the joints.


LIMITS = {"effort": "torque limit", "velocity": "velocity limit"}
DRIVE = {
    "damping": "viscous friction",
    "friction": "dry friction",
    "armature": "rotor inertia",
}

FIELDS = {"damping": "viscous", "friction": "coulomb", "armature": "armature"}
"""Entries of a case's data sheet for these."""


def check_joints(
    description: Description, sheet: Collection[str] = ()
) -> Iterator[Finding]:
    """What is odd about the joints, each one and all together, beside what a data sheet gives."""
    for kind, joint, problem in tree_faults(description, description.joints):
        yield Finding(
            "impossible",
            kind,
            *joint.where,
            problem,
            "links of the file in a tree from one base, each with a name of its own",
            "correct the names, <parent> and <child>",
            1e3,
        )
    for joint in description.moving:
        yield from _axis(joint)
        yield from _limits(joint, description.form)
    yield from _values_of_all(description, sheet)


def _axis(joint: Joint) -> Iterator[Finding]:
    length = float(np.linalg.norm(joint.axis))
    if length < AXIS_LENGTH:
        yield Finding(
            "impossible",
            "axis",
            *joint.where,
            "its axis has length zero",
            "an axis of length one",
            "correct <axis>",
            1e2,
        )
    elif abs(length - 1) > AXIS_LENGTH:
        yield Finding(
            "note",
            "axis",
            *joint.where,
            f"its axis has the length {length:.6g}",
            "length one; readers scale it, or do not",
            "divide it by its length",
            abs(length - 1),
        )


def _limits(joint: Joint, form: str) -> Iterator[Finding]:
    lower, upper = joint.lower, joint.upper
    if not joint.turns_freely and form == "URDF":
        if {lower, upper, joint.effort} == {None}:
            yield Finding(
                "missing",
                "limits",
                *joint.where,
                "has no <limit>, which a URDF requires",
                "lower, upper, effort and velocity",
                'give them, or type="continuous" if it turns without end',
                0.5,
            )
        elif (lower or 0.0) >= (upper or 0.0):
            yield Finding(
                "implausible",
                "limits",
                *joint.where,
                f"lower limit {lower or 0:g}, upper limit {upper or 0:g}: some readers lock it, others free it",
                "lower below upper",
                'give the range of the data sheet, or type="continuous" if it turns without end',
                0.5,
            )
    for name, meaning in LIMITS.items():
        value = getattr(joint, name)
        if value is not None and value <= 0:
            yield Finding(
                "implausible",
                name,
                *joint.where,
                f"{meaning} {value:g}",
                "a limit above zero",
                f"give the {meaning} of the data sheet; simulators clip at it",
                0.3,
            )


def _values_of_all(
    description: Description, sheet: Collection[str]
) -> Iterator[Finding]:
    """Limits, friction and rotors that no joint has, or all have alike."""
    joints = description.moving
    if not joints:
        return
    absent = []
    for name, meaning in {**LIMITS, **DRIVE}.items():
        # zero counts as not given
        given = [value for joint in joints if (value := getattr(joint, name))]
        if not given and name in DRIVE:
            if FIELDS[name] not in sheet:
                absent.append(name)
        elif len(given) >= SAME_ON_JOINTS and len(set(given)) == 1:
            identify = ", or identify it (gapscope identify)" if name in DRIVE else ""
            yield Finding(
                "missing" if name in DRIVE else "note",
                f"same_{name}",
                "",
                joints[0].line,
                f"{meaning} {given[0]:g} on {len(given)} of {len(joints)} joints",
                "a value of each joint's own drive",
                f"looks like a placeholder: give the data sheet's{identify}",
                0.2,
            )
    if not absent:
        return
    found = f"no joint has {' or '.join(DRIVE[name] for name in absent)}"
    if description.form == "URDF" and "armature" in absent:
        found += "; a URDF has no place for rotors"
    fields = ", ".join(f"{FIELDS[name]}: [...]" for name in absent)
    yield Finding(
        "missing",
        "no_drive",
        "",
        0,
        found,
        "friction and rotors of the gears make up much of the torque of most arms",
        f"give nominal: {{{fields}}} in case.yaml from the data sheet, or identify the arm (gapscope identify)",
        0.1,
    )


# Mass, centre of mass and moments of each link against its shapes.


def check_geometry(
    description: Description, geometries: Mapping[str, Geometry]
) -> Iterator[Finding]:
    """Density, centre and moments of each link that has a shape."""
    for link in description.links:
        inertial, geometry = link.inertial, geometries.get(link.name)
        if inertial is None or geometry is None or not inertial.is_body:
            continue
        if inertial.mass < MIN_MASS:
            continue
        density = inertial.mass / geometry.volume
        bound = np.clip(density, MIN_DENSITY, LARGEST_DENSITY)
        if density != bound:
            yield Finding(
                "implausible",
                "density",
                *link.where,
                f"{inertial.mass:.3g} kg in shapes of {1e3 * geometry.volume:.3g} dm^3: {density:.2g} kg/m^3",
                f"{MIN_DENSITY:g} to {LARGEST_DENSITY:g} kg/m^3",
                "check the mass, its unit, and the scale of the meshes",
                size=float(abs(np.log(density / bound))),
            )
        outside = distance_outside(geometry, inertial.com)
        if outside > OUTSIDE * geometry.edge:
            yield Finding(
                "implausible",
                "com_outside",
                *link.where,
                f"centre of mass ({figures(inertial.com, 3)}) m is {outside:.3g} m outside the link's shapes",
                f"inside, near ({figures(geometry.centre, 3)}) m, the middle of the shapes",
                "check the unit and the frame of <origin>: it is given in the link's frame, not in that of the base or "
                "the CAD assembly",
                size=outside / geometry.edge,
            )
        yield from _size(link, inertial, geometry)


def _size(link: Link, inertial: Inertial, geometry: Geometry) -> Iterator[Finding]:
    """Moments larger than the hull allows, or next to nothing."""
    variances, axes = np.linalg.eigh(inertial.variance)
    along = geometry.points @ axes
    # b and a of the hull along each principal axis, about the middle
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
            *link.where,
            f"the mass spreads {np.sqrt(variances[worst]):.3g} m about its centre (standard deviation along "
            f"({figures(axes[:, worst], 3)})), and the shapes have room for {np.sqrt(bound[worst]):.3g} m; the moments "
            f"are {solid:.3g} times those of a solid of that shape",
            "no more than with all mass on the surface of the shapes",
            f"check the moments, their unit, and that they refer to the centre of mass; a solid has {1 / solid:.2g} "
            "times these",
            size=float(np.log(ratio)),
        )
    elif solid < MIN_MOMENT_SHARE:
        yield Finding(
            "implausible",
            "moments_too_small",
            *link.where,
            f"the moments are {solid:.2g} times those of a solid of the link's shapes",
            f"at least {MIN_MOMENT_SHARE:g} times: casing and motor do not sit in one point",
            f"check the moments and their unit; a solid has {1 / solid:.2g} times these",
            size=float(-np.log(solid / MIN_MOMENT_SHARE)),
        )


# Whether inertials, or masses alone, belong to the neighbouring links.
#
# An inertial is compared with the link that carries it and with the links before and behind it, as normal distributions
# of the same centre and variance: the squared Wasserstein distance is
#
#     d^2 = |c - g|^2 + tr(S) + tr(G) - 2 tr((S^1/2 G S^1/2)^1/2)
#
# with the body's centre c and variance S and the shape's g and G [m^2]; d^2 / tr(G) is the misfit. A link without
# usable shapes is taken as a rod from its frame to the next joints, which says less.


ROD_THICKNESS = 0.2
"""Standard deviation of a rod's mass across it, as share of the median length of the arm's links."""
FLOOR = 0.05
"""Added to misfits before their logarithm, so that a perfect fit of one link does not decide [1]."""

TIED = 0.01
"""Gains below this are none: neighbours are the same part."""
MIN_TOLD = 2
"""Fewest links on which the neighbour's inertial has to make a difference."""
ROUNDING = 0.02
"""Spread of logarithms that numbers of two digits have by rounding [1]."""


@dataclass(frozen=True)
class Extent:
    """Where a link is.

    Attributes:
        centre: [m], shape (3,).
        variance: [m^2], shape (3, 3).
        by_shape: from shapes; else from the joints' frames.
        size: trace of the variance without a rod's thickness [m^2]; 0 of a last link without shapes, whose flange says
            nothing of its size.
    """

    centre: np.ndarray
    variance: np.ndarray
    by_shape: bool
    size: float


def check_shifted(
    description: Description, geometries: Mapping[str, Geometry]
) -> Iterator[Finding]:
    """Inertials, or masses alone, that fit better if each is taken from the neighbouring link."""
    extents = _extents(description, geometries)
    # a converter goes through the links branch by branch, or as the file lists them
    orders = {
        tuple(link.name for link in order): [x for x in order if x.inertial is not None]
        for order in (description.in_tree_order(), description.links)
    }
    shifts = [shift for links in orders.values() for shift in _whole(links, extents)]
    if shifts:
        yield max(shifts, key=lambda shift: shift.size)
        return
    for links in orders.values():
        for found in _masses(links, extents):
            yield found
            return


def misfit(inertial: Inertial, extent: Extent) -> float:
    """d^2 / tr(G) of a body and the extent of a link [1]."""
    own, shape = inertial.variance, extent.variance
    # the eigenvalues of S^1/2 G S^1/2 are those of S G
    overlap = np.sqrt(np.maximum(np.linalg.eigvals(own @ shape).real, 0.0)).sum()
    offset = float(np.sum((inertial.com - extent.centre) ** 2))
    total = np.trace(own) + np.trace(shape)
    return max(0.0, float((offset + total - 2 * overlap) / np.trace(shape)))


def _whole(links: Sequence[Link], extents: Mapping[str, Extent]) -> Iterator[Finding]:
    """The whole inertials are those of the link before or behind, in this order of the links that have one."""
    tried = []
    for step in (1, -1):
        # by how much the giver's inertial fits better than the own, as a logarithm
        gains = np.array(
            [
                np.log(FLOOR + misfit(own, extent))
                - np.log(FLOOR + misfit(giver, extent))
                for own, giver, extent in _neighbours(links, extents, step)
                if own.is_body and giver.is_body
            ]
        )
        # neighbours with the same inertial say nothing
        told = gains[np.abs(gains) > TIED]
        if len(gains) >= SHIFT_LINKS and len(told) >= MIN_TOLD:
            tried.append((gains.mean(), np.mean(told > 0), step, len(told)))
    mean, share, step, count = max(tried, default=(0.0, 0.0, 0, 0))
    # enough in the mean, and on most links: one alone decides nothing
    if mean < SHIFT_GAIN or share < SHIFT_SHARE:
        return
    beyond = "next" if step > 0 else "previous"
    finding = Finding(
        "implausible",
        "shifted_inertials",
        "",
        0,
        f"the inertials look shifted by one link: {share:.0%} of {count} links are fitted better by the inertial of "
        f"the {beyond} link, whose misfit is {np.exp(-mean):.2g} times that of their own",
        "each inertial within its own link",
        f"give each link the <inertial> of the {beyond} one (converters that lose or add the base do this), and run "
        "the audit again",
        float(mean),
    )
    yield _shifted(links, extents, finding)


def _neighbours(
    links: Sequence[Link], extents: Mapping[str, Extent], step: int
) -> Iterator[tuple[Inertial, Inertial, Extent]]:
    """Inertial of each link of known extent, that of the link ``step`` further, and the extent."""
    for own, link in enumerate(links):
        giver, extent = own + step, extents.get(link.name)
        if extent is not None and 0 <= giver < len(links):
            first, second = link.inertial, links[giver].inertial
            if first is not None and second is not None:
                yield first, second, extent


def _masses(links: Sequence[Link], extents: Mapping[str, Extent]) -> Iterator[Finding]:
    """Only the masses are those of the link before or behind: moments per mass then follow the links' sizes.

    With s_i = ln(tr(I_i) / L_i^2), L the links' sizes, and masses m, arms have similar s_i - ln(m_i) on all links; the
    F test compares its spread with that of s_i - ln(m_k), k the neighbour.
    """
    tried = []
    for step in (1, -1):
        rows = np.array(
            [
                (np.trace(own.moments) / extent.size, own.mass, giver.mass)
                for own, giver, extent in _neighbours(links, extents, step)
                # moments that no body has say nothing of the mass
                if extent.size and possible(own) and giver.is_body
            ]
        )
        count = len(rows)
        # masses that are all alike fit any neighbour
        if count < SHIFT_LINKS + 1 or np.ptp(rows[:, 1]) == 0:
            continue
        size, own_mass, other_mass = np.log(rows).T
        now, then = (float(np.std(size - m, ddof=1)) for m in (own_mass, other_mass))
        # numbers of two digits are no closer than their rounding
        then = max(ROUNDING, then)
        p = float(fisher.sf((now / then) ** 2, count - 1, count - 1))
        tried.append((p, then, now, count, step))
    if not tried:
        return
    p, then, now, count, step = min(tried)
    if p > MASS_SHIFT_LEVEL or then > MASS_SHIFT_SPREAD:
        return
    beyond = "next" if step > 0 else "previous"
    finding = Finding(
        "implausible",
        "shifted_masses",
        "",
        0,
        f"the masses look shifted by one link: moments over mass and size differ by {np.expm1(now):.0%} between "
        f"{count} links, with the mass of the {beyond} link each by {np.expm1(then):.0%} (p = {p:.1g}); "
        "centres and moments are in place",
        "mass and moments of the same link",
        f"give each link the <mass> of the {beyond} one, compare with the data sheet, and run the audit again",
        float(np.log(now / then)),
    )
    yield _shifted(links, extents, finding)


def possible(inertial: Inertial) -> bool:
    """Whether a body has such moments, the triangle inequality included."""
    if not inertial.is_body:
        return False
    moments = np.linalg.eigvalsh(inertial.moments)
    return bool(moments[2] <= 1.01 * (moments[0] + moments[1]))


def _shifted(
    links: Sequence[Link], extents: Mapping[str, Extent], finding: Finding
) -> Finding:
    """A finding on links in this order, with what makes it less certain."""
    known = [extents[link.name] for link in links if link.name in extents]
    said = finding.found
    if not all(extent.by_shape for extent in known):
        said += "; judged by the joints' frames where shapes are missing, which is less certain"
    _, line = links[0].where
    return replace(finding, line=line, found=said, size=10.0 + finding.size)


def _extents(
    description: Description, geometries: Mapping[str, Geometry]
) -> dict[str, Extent]:
    """Extent of each link of which something is known."""
    rods = {
        link.name: points
        for link in description.links
        if len(points := _frames(description, link)) > 1
    }
    lengths = [np.ptp(points, axis=0).max() for points in rods.values()]
    across = ROD_THICKNESS * float(np.median(lengths)) if lengths else 0.0
    found = {}
    for name, points in rods.items():
        # of a rod the variance is L^2 / 12, of its two ends L^2 / 4
        along = np.cov(points.T, bias=True) / 3
        variance = along + across**2 * np.eye(3)
        # whether the link, or what is fixed to it, holds a moving joint
        parts = {part.name for part, _ in description.rigid_part(name)}
        carries = any(joint.parent in parts for joint in description.moving)
        size = float(np.trace(along)) if carries else 0.0
        found[name] = Extent(points.mean(axis=0), variance, False, size)
    # shapes go before frames
    for name, geometry in geometries.items():
        size = float(np.trace(geometry.variance))
        found[name] = Extent(geometry.centre, geometry.variance, True, size)
    return found


def _frames(description: Description, link: Link) -> np.ndarray:
    """Places of a link's frame and of the joints that it holds, in its frame [m], shape (K, 3), each once."""
    points = [np.zeros(3)]
    for part, place in description.rigid_part(link.name):
        points += [
            (place * joint.place).translation
            for joint in description.below(part.name)
        ]
    return np.unique(np.round(points, 4), axis=0)
