"""A fault of the nominal arm's file: inertials on the neighbouring link."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import dataclass

import numpy as np

from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording
from gapscope.effects.parameter import Parameter
from gapscope.effects.setup_faults.fault import Fault


@dataclass(frozen=True)
class ShiftedInertials(Fault):
    """The inertials of the nominal arm's URDF assigned to the neighbouring link.

    Attributes:
        by: how many links further [1].
        moved_only: whether links that no joint moves, such as the base, kept theirs.
    """

    name = "shifted_inertials"
    scope = "arm"
    looks_like = "gravity torque of every joint off by that of a link"
    reference = "hollerbach2008"
    parameters = (Parameter("by", "k", "1", (-6.0, 6.0), (-1.0, 1.0)),)
    by: int = 1
    moved_only: bool = False

    @classmethod
    def draw(cls, rng: np.random.Generator, n_joints: int) -> ShiftedInertials:
        """One link up or down the chain."""
        return cls(int(rng.choice([-1, 1])), bool(rng.integers(2)))

    def apply(
        self, recording: Recording, rng: np.random.Generator, arm: NominalArm
    ) -> Recording:
        """The recording, which is right; see ``urdf``."""
        return recording

    def urdf(self, text: str) -> str:
        """URDF text with the ``<inertial>`` of each link that has one moved to the next such link, in file order."""
        root = ET.fromstring(text)
        links = self._links(root)
        inertials = [link.find("inertial") for link in links]
        givers = np.roll(np.arange(len(links)), self.by)
        for link, own, giver in zip(links, inertials, givers, strict=True):
            given = inertials[int(giver)]
            assert own is not None and given is not None
            link.remove(own)
            link.append(given)
        return ET.tostring(root, encoding="unicode")

    def _links(self, root: ET.Element) -> list[ET.Element]:
        """Links whose inertials are exchanged, in file order."""
        moved = {
            child.get("link")
            for joint in root.iter("joint")
            if joint.get("type") in ("revolute", "continuous", "prismatic")
            for child in joint.iter("child")
        }
        return [
            link
            for link in root.iter("link")
            if link.find("inertial") is not None
            and (not self.moved_only or link.get("name") in moved)
        ]
