"""What is wrong with the URDF that is published with the Kinova Gen3 recordings, link by link, and what that explains.

    .venv/bin/python experiments/19_kinova_urdf.py [--out out/kinova]

Sets its inertials beside those of the maker's own description (Kinovarobotics/ros2_kortex, kortex_description,
arms/gen3/7dof/urdf/gen3_macro.xacro, with the vision module), and diagnoses both recordings against three arms: as
published with the data, with the maker's masses, and with all of the maker's inertials.
"""

from __future__ import annotations

import argparse
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import numpy as np

from gapscope.arm.case import Case, load_case
from gapscope.diagnosis.diagnose import diagnose

CASES = Path(__file__).parent / "cases"
AXES = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
MAKER = {
    "base_link": (1.697, (0.004622, 9e-06, 6e-05, 0.004495, 9e-06, 0.002079)),
    "shoulder_link": (1.3773, (0.00457, 1e-06, 2e-06, 0.004831, 0.000448, 0.001409)),
    "half_arm_1_link": (1.1636, (0.011088, 5e-06, 0.0, 0.001072, -0.000691, 0.011255)),
    "half_arm_2_link": (1.1636, (0.010932, 0.0, -7e-06, 0.011127, 0.000606, 0.001043)),
    "forearm_link": (0.9302, (0.008147, -1e-06, 0.0, 0.000631, -0.0005, 0.008316)),
    "spherical_wrist_1_link": (
        0.6781,
        (0.001596, 0.0, 0.0, 0.001607, 0.000256, 0.000399),
    ),
    "spherical_wrist_2_link": (
        0.6781,
        (0.001641, 0.0, 0.0, 0.00041, -0.000278, 0.001641),
    ),
    "bracelet_link": (0.5, (0.000587, 3e-06, 3e-06, 0.000369, -0.000118, 0.000609)),
}
"""Mass [kg] and inertia about the centre of mass [kg m^2] by link, as the maker states them; centres agree."""


def inertials(urdf: Path) -> dict[str, ET.Element]:
    """Inertial elements of a URDF by link."""
    links = ET.parse(urdf).getroot().findall("link")
    return {
        x.get("name", "").strip(): found
        for x in links
        if (found := x.find("inertial")) is not None
    }


def compare(urdf: Path) -> None:
    """Print masses beside the maker's, and the inertias that differ."""
    print(
        f"{'link':24} {'file':>7} {'maker':>7}   inertias that differ, file against maker [kg m^2]"
    )
    for name, (mass, inertia) in MAKER.items():
        element = inertials(urdf)[name]
        own = float(element.find("mass").get("value"))  # type: ignore[union-attr,arg-type]
        values = [float(element.find("inertia").get(axis)) for axis in AXES]  # type: ignore[union-attr,arg-type]
        odd = [
            f"{a} {x:g} ({y:g})"
            for a, x, y in zip(AXES, values, inertia, strict=True)
            if not np.isclose(x, y)
        ]
        print(f"{name:24} {own:7.4f} {mass:7.4f}   {', '.join(odd)}")


def changed(case: Case, out: Path, every: bool) -> Case:
    """The case with the maker's masses, and where ``every`` with the maker's inertias too."""
    tree = ET.parse(case.arm.urdf)
    for link in tree.getroot().findall("link"):
        if (name := link.get("name", "").strip()) not in MAKER:
            continue
        mass, inertia = MAKER[name]
        link.find("inertial/mass").set("value", str(mass))  # type: ignore[union-attr]
        if every:
            for axis, value in zip(AXES, inertia, strict=True):
                link.find("inertial/inertia").set(axis, str(value))  # type: ignore[union-attr]
    path = out / ("maker.urdf" if every else "masses.urdf")
    tree.write(path)
    return replace(case, arm=replace(case.arm, urdf=path))


def main() -> None:
    """Compare the file with the maker's, then diagnose."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--out", type=Path, default=Path("out/kinova"))
    out = parser.parse_args().out
    out.mkdir(parents=True, exist_ok=True)
    for path in sorted(CASES.glob("kinova*.yaml")):
        case = load_case(path)
        if path.stem.endswith("current"):
            compare(case.arm.urdf)
        arms = {
            "as published": case,
            "maker's masses": changed(case, out, False),
            "maker": changed(case, out, True),
        }
        for label, of in arms.items():
            document = diagnose(of).document
            gaps = {
                stage: np.array(document["gap"][stage]["torque_nrmse"])
                for stage in ("before", "after")
            }
            print(f"\n{case.name}, {label}: {document['verdict']}")
            for stage, gap in gaps.items():
                print(f"  {stage:6} {np.round(gap, 3).tolist()}, mean {gap.mean():.3f}")
            for effect in document["effects"]:
                values = {
                    name: np.round(p["value"], 3).tolist()
                    for name, p in effect["parameters"].items()
                }
                print(
                    f"  {effect['effect']} {effect['joints']} {effect['probability']:.2f} {values}",
                    flush=True,
                )


if __name__ == "__main__":
    main()
