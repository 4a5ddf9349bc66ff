"""Numbers of XML attributes; what is none becomes a finding, and the default is used."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping

import numpy as np

from gapscope.model_audit.finding import Finding
from gapscope.model_audit.xml_lines import Lines

LARGEST = 1e50
"""Beyond it products of the numbers overflow; what means *unlimited* is less. What is below 1 over it is zero."""


class NumberReader:
    """Reads numbers of attributes and collects what is none.

    Args:
        lines: line of each element.

    Attributes:
        findings: what could not be read.
    """

    def __init__(self, lines: Lines) -> None:
        self._lines = lines
        self.findings: list[Finding] = []

    def one(
        self,
        element: ET.Element | None,
        attribute: str,
        place: str,
        values: Mapping[str, str] | None = None,
    ) -> float | None:
        """One number, or ``None`` if it is not given or none; ``values`` replace the element's attributes."""
        if element is None:
            return None
        text = (element.attrib if values is None else values).get(attribute)
        if text is None:
            return None
        found = self._numbers(element, attribute, text, place)
        return float(found[0]) if len(found) else None

    def several(
        self,
        element: ET.Element | None,
        attribute: str,
        default: tuple[float, ...],
        place: str,
        values: Mapping[str, str] | None = None,
    ) -> np.ndarray:
        """As many numbers as the default has."""
        if element is None:
            return np.array(default)
        text = (element.attrib if values is None else values).get(attribute)
        if text is None:
            return np.array(default)
        found = self._numbers(element, attribute, text, place)
        if len(found) == len(default):
            return found
        if len(found):
            self.add(element, attribute, text, place, f"{len(default)} numbers")
        return np.array(default)

    def _numbers(
        self, element: ET.Element, attribute: str, text: str, place: str
    ) -> np.ndarray:
        try:
            found = np.array(text.split(), dtype=float)
        except ValueError:
            found = np.array([np.nan])
        if len(found) and (np.abs(found) < LARGEST).all():
            return np.where(np.abs(found) > 1 / LARGEST, found, 0.0)
        self.add(element, attribute, text, place, f"finite numbers below {LARGEST:g}")
        return np.empty(0)

    def add(
        self, element: ET.Element, attribute: str, text: str, place: str, wanted: str
    ) -> None:
        """Note that an attribute is not what is wanted."""
        self.findings.append(
            Finding(
                "impossible",
                "unreadable_number",
                place,
                self._lines.get(element, 0),
                f'<{element.tag} {attribute}="{text}">',
                wanted,
                "correct the attribute; the audit goes on with its default",
                size=1e6,
            )
        )
