"""XML with the line on which each element begins."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path
from xml.parsers import expat

from gapscope.arm.errors import InputError
from gapscope.arm.input_file import read_bytes

Lines = dict[ET.Element, int]
"""Line, counted from 1, on which an element begins."""


def read_xml(path: Path) -> tuple[ET.Element, Lines]:
    """Root element of a file, and the lines of all elements.

    Raises:
        InputError: there is no such file, or it is not XML; names the line.
    """
    builder, lines = ET.TreeBuilder(), Lines()
    parser = expat.ParserCreate()
    parser.buffer_text = True

    def start(tag: str, attributes: dict[str, str]) -> None:
        lines[builder.start(tag, attributes)] = parser.CurrentLineNumber

    parser.StartElementHandler = start
    parser.EndElementHandler = builder.end
    parser.CharacterDataHandler = builder.data
    content = read_bytes(path, "give a URDF or MJCF file")
    try:
        parser.Parse(content, True)
    except expat.ExpatError as error:
        raise InputError(
            f"is not valid XML ({expat.ErrorString(error.code)})",
            "give a complete URDF or MJCF file; was it cut short?",
            file=path,
            where=f"line {error.lineno}",
        ) from None
    return builder.close(), lines
