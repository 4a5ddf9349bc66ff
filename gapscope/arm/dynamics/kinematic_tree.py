"""Joints of a URDF or MJCF file as a tree: chains in it, what moves with an arm, and what follows another joint."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from gapscope.arm.dynamics.mjcf import joint_attributes, numbers
from gapscope.arm.errors import InputError
from gapscope.arm.nearest_name import nearest

SINGLE = ("revolute", "continuous", "prismatic")
"""Types of joints with one degree of freedom."""
SEVERAL = ("floating", "planar", "ball")
"""Types of joints with more."""


@dataclass(frozen=True)
class Mimic:
    """q = multiplier * q_master + offset, as ``<mimic>`` of a URDF has it.

    Attributes:
        master: name of the joint that is followed.
        multiplier: [1], or [m/rad] if one of the joints slides.
        offset: [rad or m].
    """

    master: str
    multiplier: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True)
class TreeJoint:
    """A joint between two links: its name, type in the words of URDF, and the joint that it follows, if any."""

    name: str
    kind: str
    parent: str
    child: str
    mimic: Mimic | None = None

    @property
    def moves(self) -> bool:
        """Whether it has one degree of freedom of its own."""
        return self.kind in SINGLE and self.mimic is None


@dataclass(frozen=True)
class KinematicTree:
    """All joints of a file, fixed ones included; each link is the child of one joint at most."""

    joints: tuple[TreeJoint, ...]
    path: Path

    @cached_property
    def _above(self) -> dict[str, TreeJoint]:
        """Joint above each link."""
        return {joint.child: joint for joint in self.joints}

    @property
    def single(self) -> dict[str, TreeJoint]:
        """Joints with one degree of freedom by name, those that follow another included."""
        return {joint.name: joint for joint in self.joints if joint.kind in SINGLE}

    def upwards(self, link: str) -> Iterator[TreeJoint]:
        """Joints from a link to the root.

        Raises:
            InputError: there is none, the joints close a loop.
        """
        passed: set[str] = set()
        while (joint := self._above.get(link)) is not None:
            if link in passed:
                raise InputError(
                    f"its joints close a loop at the link {link!r}",
                    "correct <parent> and <child>: the links of an arm hang on one base",
                    file=self.path,
                )
            passed.add(link)
            yield joint
            link = joint.parent

    def chain(self, base: str, tip: str) -> tuple[str, ...]:
        """Joints that move the tip against the base, from the base on.

        Raises:
            InputError: no such link, the tip does not hang on the base, or nothing moves between them.
        """
        links = {end for joint in self.joints for end in (joint.parent, joint.child)}
        for link in (base, tip):
            if link not in links:
                raise InputError(
                    f"has no link {link!r}",
                    f"{nearest(link, links)}name links of the file in chain: [base, tip]",
                    file=self.path,
                )
        found: list[TreeJoint] = []
        for joint in self.upwards(tip):
            if joint.child == base:
                break
            found.append(joint)
        if not found or found[-1].parent != base:
            carriers = " <- ".join(joint.parent for joint in self.upwards(tip))
            raise InputError(
                f"the link {tip!r} does not hang on {base!r}, but on {carriers or 'nothing'}",
                "give the base first, then the tip, in chain: [base, tip]",
                file=self.path,
            )
        names = tuple(joint.name for joint in reversed(found) if joint.moves)
        if not names:
            raise InputError(f"no joint moves {tip!r} against {base!r}", file=self.path)
        return names

    def moved(self, joints: Collection[str]) -> frozenset[str]:
        """Links that any of these joints moves."""
        links = [joint.child for joint in self.joints]
        return frozenset(
            link
            for link in links
            if any(joint.name in joints for joint in self.upwards(link))
        )

    def around(self, joints: Collection[str]) -> frozenset[str]:
        """Links whose joints concern an arm: that it moves, that carry it, and those of joints that follow its own."""
        own = set(joints)
        for _ in self.joints:
            own |= {j.name for j in self.joints if j.mimic and j.mimic.master in own}
        names = own | self.carriers(own)
        links = {joint.child for joint in self.joints if joint.name in names}
        return self.moved(own) | links

    def carriers(self, joints: Collection[str]) -> frozenset[str]:
        """Joints between the root and these joints, which decide how the arm is mounted."""
        parents = [joint.parent for joint in self.joints if joint.name in joints]
        return frozenset(
            joint.name for parent in parents for joint in self.upwards(parent)
        )


def read_tree(root: ET.Element, path: Path) -> KinematicTree:
    """The joints of a URDF, or of an MJCF file whose bodies all have a name."""
    joints = _of_urdf(root, path) if root.tag == "robot" else _of_mjcf(root, path)
    return KinematicTree(tuple(joints), path)


def _of_urdf(root: ET.Element, path: Path) -> Iterator[TreeJoint]:
    for joint in root.findall("joint"):
        parent, child = joint.find("parent"), joint.find("child")
        if parent is None or child is None:
            continue  # the reader of the URDF says so
        follows = joint.find("mimic")
        yield TreeJoint(
            joint.get("name", ""),
            joint.get("type", ""),
            parent.get("link", ""),
            child.get("link", ""),
            None if follows is None else _mimic(follows, joint, path),
        )


def _mimic(element: ET.Element, joint: ET.Element, path: Path) -> Mimic:
    place = f"joint {joint.get('name', '')}, <mimic>"
    multiplier, offset = (
        float(numbers(element.get(key, default), 1, path, f"{place}, {key}")[0])
        for key, default in (("multiplier", "1"), ("offset", "0"))
    )
    return Mimic(element.get("joint", ""), multiplier, offset)


def _of_mjcf(root: ET.Element, path: Path) -> Iterator[TreeJoint]:
    """Several joints of one body are a chain of links, as many less one without a name."""
    follows, attributes = equality_mimics(root, path), joint_attributes(root)
    kinds = {"slide": "prismatic", "free": "floating", "ball": "ball"}

    def visit(body: ET.Element, parent: str) -> Iterator[TreeJoint]:
        name = body.get("name", "")
        own = [child for child in body if child.tag in ("joint", "freejoint")]
        for number, joint in enumerate(own, 1):
            called = joint.get("name", "")
            kind = attributes.get(called, joint.attrib).get("type", "hinge")
            kind = "free" if joint.tag == "freejoint" else kind
            child = name if number == len(own) else f"{name} after joint {number}"
            yield TreeJoint(
                called,
                kinds.get(kind, "revolute"),
                parent,
                child,
                follows.get(called),
            )
            parent = child
        if not own:
            yield TreeJoint("", "fixed", parent, name)
        for child_body in body.findall("body"):
            yield from visit(child_body, name)

    for body in root.findall("worldbody/body"):
        yield from visit(body, "world")


def equality_mimics(root: ET.Element, path: Path) -> dict[str, Mimic]:
    """Joints of an MJCF file that ``<equality>`` lets follow another one in proportion."""
    found = {}
    for element in root.findall("equality/joint"):
        coefficients = np.zeros(5)
        text = element.get("polycoef") or "0 1 0 0 0"
        given = numbers(text, None, path, "<equality><joint>, polycoef")[:5]
        coefficients[: len(given)] = given
        linear = not coefficients[2:].any() and element.get("joint2") is not None
        if linear and element.get("active") != "false":
            found[element.get("joint1", "")] = Mimic(
                element.get("joint2", ""), *coefficients[[1, 0]].tolist()
            )
    return found
