"""What ``gapscope audit`` finds in robot models as they are, and in the same models with a fault put in.

    .venv/bin/python experiments/35_audit.py [--models FOLDER]

Models: those that may be given by name, the URDF and MJCF files of ``${GAPSCOPE_DATA}``, and every URDF below FOLDER,
such as the robots of example-robot-data. Faults: the moments of one link ten times larger, for each moved link above
2 % of the robot's mass whose moments are not said to be odd as they are; all inertials one link further and one link
back, with the base and without; the masses alone likewise. Models in which a shift is found as they are count as false
alarms, and are listed; faults go into the others.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from common import DATA, command_line

from gapscope.arm.dynamics.description import (
    Description,
    Inertial,
    Link,
    read_description,
)
from gapscope.arm.robots import KNOWN_ROBOTS
from gapscope.model_audit.audit import check_description, total_mass
from gapscope.model_audit.description import Geometry, find_robot, link_geometries

SHIFTS = ("shifted_inertials", "shifted_masses")
SIZES = (
    "moments_too_large",
    "moments_for_mass",
    "triangle_inequality",
    "inertia_not_positive",
)
FEWEST = 4
"""Moved links with mass that a model has at least, to be given faults."""
HEAVY = 0.02
"""Links lighter than this share of the robot are not given ten times their moments."""


def models(folder: Path | None) -> Iterator[tuple[str, Path]]:
    """Name and file of each model."""
    for name in KNOWN_ROBOTS:
        yield name, find_robot(name)[0]
    for file in [*sorted(DATA.glob("*/*.urdf")), *sorted(DATA.glob("*/*.xml"))]:
        yield f"data/{file.parent.name}", file
    for file in sorted(folder.rglob("*.urdf")) if folder else []:
        yield f"{file.parent.parent.name}/{file.stem}".removeprefix("robots/"), file


def kinds(description: Description, sizes: dict[str, Geometry]) -> Counter[str]:
    """How many findings of each kind are more than notes."""
    found = check_description(description, sizes)
    return Counter(one.kind for one in found if one.severity != "note")


def with_inertials(
    description: Description, changed: dict[str, Inertial]
) -> Description:
    """The same file with other inertials of some links."""
    links = [
        replace(link, inertial=changed.get(link.name, link.inertial))
        for link in description.links
    ]
    return replace(description, links=tuple(links))


def heavier(description: Description) -> Iterator[tuple[str, Description]]:
    """Each moved link in turn with ten times its moments."""
    for link in moved(description):
        own = link.inertial
        if own is None or own.mass < HEAVY * total_mass(description):
            continue
        worse = replace(own, moments=10 * own.moments, own=10 * own.own)
        yield link.name, with_inertials(description, {link.name: worse})


def shifted(description: Description, masses_alone: bool) -> Iterator[Description]:
    """Inertials, or masses, of the next and of the previous link, with the base and without."""
    every = [link for link in description.links if link.inertial is not None]
    ways = {tuple(link.name for link in x): x for x in (every, moved(description))}
    for links in ways.values():
        for step in (1, -1):
            changed = {}
            givers = np.roll(np.arange(len(links)), step)
            for link, giver in zip(links, givers, strict=True):
                own, given = link.inertial, links[int(giver)].inertial
                changed[link.name] = (
                    replace(own, mass=given.mass) if masses_alone else given
                )
            yield with_inertials(description, changed)


def moved(description: Description) -> list[Link]:
    """Links with an inertial that a joint moves."""
    return [
        link
        for link in description.links
        if link.inertial is not None and description.is_moved(link.name)
    ]


def oversized(description: Description, sizes: dict[str, Geometry]) -> set[str]:
    """Links whose moments are said to be impossible or implausible."""
    found = check_description(description, sizes)
    return {one.place.removeprefix("link ") for one in found if one.kind in SIZES}


def tried(description: Description) -> dict[str, tuple[int, int]]:
    """Of each fault: how often found, how often put in."""
    sizes = link_geometries(description)
    larger = []
    odd = oversized(description, sizes)
    for name, worse in heavier(description):
        # a link whose moments are said to be odd as they are shows nothing
        if name not in odd:
            larger.append(name in oversized(worse, sizes))
    result = {"moments x 10": (sum(larger), len(larger))}
    for alone, kind in ((False, SHIFTS[0]), (True, SHIFTS[1])):
        hits = [kinds(x, sizes)[kind] > 0 for x in shifted(description, alone)]
        result[kind] = (sum(hits), len(hits))
    return result


def main() -> None:
    """Print a row for each model, and the sums."""
    arguments = command_line(
        __doc__, models=(Path, "folder with URDF files")
    ).parse_args()
    sums = Counter()
    faults = ("moments x 10", *SHIFTS)
    print(f"| model | shapes | as it is | {' | '.join(faults)} |")
    print("|---" * (3 + len(faults)) + "|")
    for name, file in models(arguments.models):
        description = read_description(file)
        sizes = link_geometries(description)
        found = kinds(description, sizes)
        said = ", ".join(f"{kind} {count}" for kind, count in found.most_common())
        cells = ["-"] * len(faults)
        sums["models"] += 1
        sums["with a shift as they are"] += any(found[kind] for kind in SHIFTS)
        enough = len(moved(description)) >= FEWEST
        if enough and not any(found[kind] for kind in SHIFTS):
            for place, (hits, count) in enumerate(tried(description).values()):
                cells[place] = f"{hits} of {count}"
                sums[f"{faults[place]}, found"] += hits
                sums[f"{faults[place]}, put in"] += count
        shapes = f"{len(sizes)} of {len(description.links)}"
        print(f"| {name} | {shapes} | {said} | {' | '.join(cells)} |", flush=True)
    print("\n" + "\n".join(f"{name}: {count}" for name, count in sums.items()))


if __name__ == "__main__":
    main()
