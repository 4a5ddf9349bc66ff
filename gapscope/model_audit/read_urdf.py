"""A URDF as it stands."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np

from gapscope.arm.dynamics.link_shapes import find_mesh
from gapscope.model_audit.description import (
    Description,
    Inertial,
    Joint,
    Link,
    Shape,
)
from gapscope.model_audit.finding import Finding
from gapscope.model_audit.numbers import NumberReader
from gapscope.model_audit.place import Place, of_rpy
from gapscope.model_audit.xml_lines import Lines

MOMENTS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
ZERO = (0.0, 0.0, 0.0)
SIZES = {
    "box": (("size", ZERO),),
    "cylinder": (("radius", (0.0,)), ("length", (0.0,))),
    "sphere": (("radius", (0.0,)),),
}
"""Attributes of the primitives, with as many zeros as they have numbers."""


def read_urdf(root: ET.Element, lines: Lines, path: Path) -> Description:
    """A URDF as it stands."""
    reader = UrdfReader(lines, path)
    links = tuple(reader.link(element) for element in root.findall("link"))
    joints = tuple(reader.joint(element) for element in root.findall("joint"))
    return Description(
        path,
        "URDF",
        root.get("name") or path.stem,
        links,
        joints,
        tuple(reader.numbers.findings),
    )


class UrdfReader:
    """Reads links and joints of a URDF.

    Args:
        lines: line of each element.
        path: the file, from whose folder meshes are searched.
    """

    def __init__(self, lines: Lines, path: Path) -> None:
        self.numbers = NumberReader(lines)
        self._lines, self._path = lines, path

    def link(self, element: ET.Element) -> Link:
        """A link with its inertial and shapes."""
        name = element.get("name", "").strip()
        shapes, lost = [], []
        for drawn in (*element.findall("visual"), *element.findall("collision")):
            shape = self._shape(drawn, f"link {name}")
            if shape is not None and (shape.kind != "mesh" or shape.mesh):
                shapes.append(shape)
            elif shape is not None:
                mesh = drawn.find("geometry/mesh")
                assert mesh is not None  # its kind is mesh
                lost.append(mesh.get("filename", ""))
        inertial = element.find("inertial")
        return Link(
            name,
            self._lines[element],
            None if inertial is None else self._inertial(inertial, f"link {name}"),
            tuple(shapes),
            tuple(dict.fromkeys(lost)),
        )

    def joint(self, element: ET.Element) -> Joint:
        """A joint with its limits and dynamics."""
        name = element.get("name", "").strip()
        place, written = f"joint {name}", element.get("type", "")
        limit, dynamics = element.find("limit"), element.find("dynamics")
        axis = element.find("axis")
        parent, child = element.find("parent"), element.find("child")

        def limited(attribute: str) -> float | None:
            return self.numbers.one(limit, attribute, place)

        return Joint(
            name,
            self._lines[element],
            "revolute" if written == "continuous" else written,
            "" if parent is None else parent.get("link", "").strip(),
            "" if child is None else child.get("link", "").strip(),
            self._place(element.find("origin"), place),
            self.numbers.several(axis, "xyz", (1.0, 0.0, 0.0), place),
            written == "continuous",
            limited("lower"),
            limited("upper"),
            limited("effort"),
            limited("velocity"),
            self.numbers.one(dynamics, "damping", place),
            self.numbers.one(dynamics, "friction", place),
        )

    def _inertial(self, element: ET.Element, place: str) -> Inertial:
        mass, inertia = element.find("mass"), element.find("inertia")
        for tag, found in (("mass", mass), ("inertia", inertia)):
            if found is None:
                self._add_missing(element, tag, place)
        values = [self.numbers.one(inertia, name, place) or 0.0 for name in MOMENTS]
        xx, xy, xz, yy, yz, zz = values
        own = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        pose = self._place(element.find("origin"), place)
        return Inertial(
            self._lines[element],
            self.numbers.one(mass, "value", place) or 0.0,
            pose.translation,
            pose.rotation @ own @ pose.rotation.T,
            np.diag(own),
        )

    def _add_missing(self, element: ET.Element, tag: str, place: str) -> None:
        self.numbers.findings.append(
            Finding(
                "impossible",
                "incomplete_inertial",
                place,
                self._lines[element],
                f"<inertial> without <{tag}>",
                "mass and inertia",
                "give both, or leave <inertial> out of a link that has no mass",
                size=1e6,
            )
        )

    def _place(self, origin: ET.Element | None, place: str) -> Place:
        xyz = self.numbers.several(origin, "xyz", ZERO, place)
        rpy = self.numbers.several(origin, "rpy", ZERO, place)
        return of_rpy(xyz, rpy)

    def _shape(self, element: ET.Element, place: str) -> Shape | None:
        geometry = element.find("geometry")
        if geometry is None or not len(geometry):
            return None
        form, pose = geometry[0], self._place(element.find("origin"), place)
        if form.tag == "mesh":
            scale = self.numbers.several(form, "scale", (1.0, 1.0, 1.0), place)
            mesh = find_mesh(form.get("filename", ""), self._path)
            return Shape(element.tag, "mesh", tuple(scale), pose, mesh)
        if form.tag not in SIZES:
            return None
        size = [
            self.numbers.several(form, key, zero, place)
            for key, zero in SIZES[form.tag]
        ]
        return Shape(element.tag, form.tag, tuple(np.concatenate(size)), pose)
