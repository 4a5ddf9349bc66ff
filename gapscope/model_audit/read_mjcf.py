"""An MJCF file as it stands; bodies whose inertial MuJoCo computes from shapes have none here."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from gapscope.arm.dynamics.mjcf import NAMELESS, Attributes, default_classes
from gapscope.arm.input_file import is_file
from gapscope.model_audit.description import (
    Description,
    Inertial,
    Joint,
    Link,
    Shape,
)
from gapscope.model_audit.numbers import NumberReader
from gapscope.model_audit.place import Place, along
from gapscope.model_audit.xml_lines import Lines

KINDS = {"hinge": "revolute", "slide": "prismatic"}
ZERO = (0.0, 0.0, 0.0)


def read_mjcf(root: ET.Element, lines: Lines, path: Path) -> Description:
    """An MJCF file as it stands; the world is the first link."""
    reader = MjcfReader(root, lines, path)
    for world in root.findall("worldbody"):
        reader.visit(world, "world", "main")
    return Description(
        path,
        "MJCF",
        root.get("model") or path.stem,
        (Link("world", 0, None), *reader.links),
        tuple(reader.joints),
        tuple(reader.numbers.findings),
    )


class MjcfReader:
    """Reads bodies, joints and shapes of an MJCF file, with what default classes give them.

    Args:
        root: of the file.
        lines: line of each element.
        path: the file, from whose folder meshes are searched.

    Attributes:
        links, joints: found so far, in the order of the file.
    """

    def __init__(self, root: ET.Element, lines: Lines, path: Path) -> None:
        self.links: list[Link] = []
        self.joints: list[Joint] = []
        self.numbers = NumberReader(lines)
        self._lines, self._classes = lines, default_classes(root)
        compiler = root.find("compiler")
        settings: Mapping[str, str] = {} if compiler is None else compiler.attrib
        degrees = settings.get("angle", "degree") == "degree"
        self._angle = np.pi / 180 if degrees else 1.0
        self._euler = settings.get("eulerseq", "xyz")
        folder = settings.get("meshdir") or settings.get("assetdir") or ""
        self._meshes = {
            mesh.get("name") or Path(mesh.get("file", "")).stem: mesh
            for mesh in root.findall("asset/mesh")
        }
        self._folder = path.parent / folder

    def visit(self, element: ET.Element, parent: str, inherited: str) -> None:
        """Read the bodies in an element."""
        for body in element.findall("body"):
            name = body.get("name") or f"{NAMELESS}_{len(self.links)}"
            below = body.get("childclass", inherited)
            self._body(body, name, parent, below)
            self.visit(body, name, below)

    def _body(self, body: ET.Element, name: str, parent: str, inherited: str) -> None:
        place = self._place(body, body.attrib, f"body {name}")
        joints = [x for x in body if x.tag in ("joint", "freejoint")]
        if not joints:
            fixed = Joint(
                f"{name} (fixed)",
                self._lines[body],
                "fixed",
                parent,
                name,
                place,
                np.zeros(3),
            )
            self.joints.append(fixed)
        # a body with several joints hangs on the last of them
        for element in joints[-1:]:
            self.joints.append(self._joint(element, name, parent, place, inherited))
        inertial = body.find("inertial")
        shapes, lost = [], []
        for geom in body.findall("geom"):
            shape, missing = self._shape(geom, f"body {name}", inherited)
            shapes += [shape] if shape else []
            lost += [missing] if missing else []
        self.links.append(
            Link(
                name,
                self._lines[body],
                None if inertial is None else self._inertial(inertial, f"body {name}"),
                tuple(shapes),
                tuple(dict.fromkeys(lost)),
            )
        )

    def _joint(
        self,
        element: ET.Element,
        body: str,
        parent: str,
        place: Place,
        inherited: str,
    ) -> Joint:
        values = self._values(element, inherited)
        name = element.get("name", f"joint of {body}")
        where = f"joint {name}"
        written = "free" if element.tag == "freejoint" else values.get("type", "hinge")
        kind = KINDS.get(written, written)
        limits = self.numbers.several(element, "range", (0.0, 0.0), where, values)
        given = "range" in values and values.get("limited") != "false"
        scale = self._angle if kind == "revolute" else 1.0
        force = self.numbers.several(
            element, "actuatorfrcrange", (0.0, 0.0), where, values
        )
        return Joint(
            name,
            self._lines[element],
            kind,
            parent,
            body,
            place,
            self.numbers.several(element, "axis", (0.0, 0.0, 1.0), where, values),
            not given,
            float(limits[0]) * scale if given else None,
            float(limits[1]) * scale if given else None,
            float(np.abs(force).min()) or None,
            None,
            self.numbers.one(element, "damping", where, values),
            self.numbers.one(element, "frictionloss", where, values),
            self.numbers.one(element, "armature", where, values),
        )

    def _inertial(self, element: ET.Element, place: str) -> Inertial:
        pose = self._place(element, element.attrib, place)
        if element.get("fullinertia") is not None:
            six = self.numbers.several(element, "fullinertia", (0.0,) * 6, place)
            xx, yy, zz, xy, xz, yz = six
            own = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        else:
            own = np.diag(self.numbers.several(element, "diaginertia", ZERO, place))
        return Inertial(
            self._lines[element],
            self.numbers.one(element, "mass", place) or 0.0,
            pose.translation,
            pose.rotation @ own @ pose.rotation.T,
            np.diag(own),
        )

    def _shape(
        self, element: ET.Element, place: str, inherited: str
    ) -> tuple[Shape | None, str]:
        """A shape, or the mesh that was not found."""
        values = self._values(element, inherited)
        kind = values.get("type", "mesh" if "mesh" in values else "sphere")
        # shapes that touch nothing are there to be seen
        seen = values.get("contype") == "0" and values.get("conaffinity") == "0"
        use = "visual" if seen else "collision"
        pose = self._place(element, values, place)
        if kind == "mesh":
            asset = self._meshes.get(values.get("mesh", ""))
            if asset is None:
                return None, values.get("mesh", "")
            file = self._folder / asset.get("file", "")
            scale = self.numbers.several(asset, "scale", (1.0, 1.0, 1.0), place)
            if not is_file(file):
                return None, asset.get("file", "")
            return Shape(use, "mesh", tuple(scale), pose, file.resolve()), ""
        text = values.get("size", "").split()
        numbers = self.numbers.several(
            element, "size", (0.0,) * max(len(text), 1), place, values
        )
        if "fromto" in values:
            ends = self.numbers.several(element, "fromto", (0.0,) * 6, place, values)
            first, second = ends[:3], ends[3:]
            pose = along(first, second)
            numbers = np.array([numbers[0], np.linalg.norm(second - first) / 2])
        if kind in ("cylinder", "capsule") and len(numbers) >= 2:
            size: tuple[float, ...] = (numbers[0], 2 * numbers[1])
        elif kind == "box" and len(numbers) == 3:
            size = tuple(2 * numbers)
        elif kind in ("sphere", "ellipsoid"):
            size = tuple(numbers[: 1 if kind == "sphere" else 3])
        else:
            return None, ""
        return Shape(use, kind, size, pose), ""

    def _values(self, element: ET.Element, inherited: str) -> Attributes:
        """Attributes of an element, with those of its class."""
        of_class = self._classes.get(element.get("class", inherited), {})
        return {**of_class.get(element.tag, {}), **element.attrib}

    def _place(
        self, element: ET.Element, values: Mapping[str, str], place: str
    ) -> Place:
        position = self.numbers.several(element, "pos", ZERO, place, values)
        turn = np.eye(3)
        if "quat" in values:
            found = self.numbers.several(
                element, "quat", (1.0, 0.0, 0.0, 0.0), place, values
            )
            if np.linalg.norm(found) > 0:
                w, x, y, z = found
                turn = Rotation.from_quat([x, y, z, w]).as_matrix()
            else:
                wanted = "a quaternion other than zero"
                self.numbers.add(element, "quat", values["quat"], place, wanted)
        elif "euler" in values:
            angles = self.numbers.several(element, "euler", ZERO, place, values)
            turn = self._of_euler(angles * self._angle)
        elif "axisangle" in values:
            *axis, angle = self.numbers.several(
                element, "axisangle", (0.0, 0.0, 1.0, 0.0), place, values
            )
            unit = np.array(axis) / (np.linalg.norm(axis) or 1.0)
            turn = Rotation.from_rotvec(unit * angle * self._angle).as_matrix()
        return Place(turn, position)

    def _of_euler(self, angles: np.ndarray) -> np.ndarray:
        """Rotation by three angles [rad]; axes in lower case turn with the body, in upper case they stay."""
        turn = np.eye(3)
        for letter, angle in zip(self._euler, angles, strict=True):
            one = Rotation.from_euler(letter.lower(), angle).as_matrix()
            turn = turn @ one if letter.islower() else one @ turn
        return turn
