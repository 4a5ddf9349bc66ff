"""The files of a case in memory: read, changed, and written as another user would have."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd
import yaml


@dataclass(frozen=True)
class CaseFiles:
    """What a case's folder holds: ``case.yaml``, the URDF, and the recordings by file name."""

    content: dict[str, Any]
    urdf: ET.Element
    recordings: dict[str, pd.DataFrame]

    @classmethod
    def read(cls, folder: Path) -> CaseFiles:
        """The files of a folder."""
        content = yaml.safe_load((folder / "case.yaml").read_text("utf-8"))
        urdf = ET.parse(folder / content["robot"]).getroot()
        names = content["recordings"]
        return cls(content, urdf, {name: pd.read_csv(folder / name) for name in names})

    def write(self, folder: Path) -> None:
        """Write them into a new folder, numbers in full."""
        folder.mkdir(parents=True)
        text = yaml.safe_dump(self.content, sort_keys=False)
        (folder / "case.yaml").write_text(text, "utf-8")
        robot = folder / self.content["robot"]
        robot.write_text(ET.tostring(self.urdf, encoding="unicode"), "utf-8")
        for name, table in self.recordings.items():
            table.to_csv(folder / name, index=False, float_format="%.17g")

    @property
    def moving(self) -> list[ET.Element]:
        """The joints that move, in the order of the columns."""
        named = {joint.get("name"): joint for joint in self.urdf.findall("joint")}
        names = self.content.get("joints")
        if names:
            return [named[name] for name in names]
        return [joint for joint in named.values() if joint.get("type") != "fixed"]
