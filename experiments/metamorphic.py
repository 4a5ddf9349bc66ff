"""Twins of a case: the same arm and recordings written down otherwise, so that the diagnosis has to be the same.

A relation changes the files of a case, held in memory, as another user would have written them, and says how joints,
parameters and units of the twin's diagnosis go back to those of the case. ``compare`` sets the two diagnoses beside
each other: names, values, shares.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterator, Mapping
from copy import deepcopy
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import yaml


class CaseFiles(NamedTuple):
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


CHANNELS = ("q", "dq", "tau", "q_ref", "dq_ref", "tau_sensor")
PER_JOINT = {
    "nominal": ("armature", "coulomb", "viscous", "torque_limit"),
    "controller": ("kp", "kd"),
}
"""Lists of ``case.yaml`` with one number per joint."""
ODD = {
    ("torque_offset", "torque"),
    ("encoder_offset", "offset"),
    ("parallel_spring", "rest"),
    ("torque_ripple", "phase"),
}
"""Parameters that change their sign with that of the joint."""
HEAVIER = 7.3
"""Factor on all masses and torques of the heavier twin [1]."""
TURN = 0.7
"""Angle by which the base is turned about the vertical [rad]."""
SHIFT, EPOCH = 1e5, 1.79e9
"""Times that are added to all stamps [s]: a day of running, and the age of the Unix clock, told to 0.2 us."""
ROUNDING = 1e-9
"""Relative size of the changes of all numbers [1]: less than what files round."""


EXACT, STAMPS, ROWS = 1e-3, 0.1, 3.0
"""Tolerances of values, over their standard deviation [1]."""


@dataclass(frozen=True)
class Twin:
    """A case written down otherwise.

    Attributes:
        files: its files.
        order: number of the case's joint, from 1, that each of its joints is.
        mirrored: joints whose sense of rotation is turned, by the numbers of the case.
        heavier: factor on all that has the unit of a mass or a torque [1].
        turned: angle by which the base frame is turned about the vertical [rad].
    """

    files: CaseFiles
    order: Mapping[int, int] = field(default_factory=dict)
    mirrored: tuple[int, ...] = ()
    heavier: float = 1.0
    turned: float = 0.0

    def joints(self, numbers: list[int]) -> list[int]:
        """Joints of the twin by their numbers in the case."""
        return [self.order.get(j, j) for j in numbers]

    def size(self, unit: str) -> float:
        """Factor on what has this unit [1]."""
        has_mass = "N" in unit.split("/")[0] or "kg" in unit
        return self.heavier if has_mass else 1.0

    def value(self, effect: str, name: str, unit: str, joint: int, x: float) -> float:
        """A parameter of the twin as the case has it, but for the turned base."""
        is_odd = (effect, name) in ODD and joint in self.mirrored
        return (-x if is_odd else x) / self.size(unit)


class Relation(NamedTuple):
    """A relation between two cases that have the same diagnosis.

    Attributes:
        name: key.
        what: what is changed, in words.
        tolerance: largest difference of a value over its standard deviation [1]: ``EXACT`` if both hold the same
            numbers, ``STAMPS`` if stamps are moved by up to 0.1 us, ``ROWS`` if other rows are looked at.
        twin: makes the twin; a generator draws what is not given.
    """

    name: str
    what: str
    tolerance: float
    twin: Callable[[CaseFiles, np.random.Generator], Twin]


def joints_permuted(case: CaseFiles, rng: np.random.Generator) -> Twin:
    """``joints:`` in another order, with the columns and the lists that follow it."""
    names = [str(joint.get("name")) for joint in case.moving]
    order = rng.permutation(len(names))
    while np.array_equal(order, np.arange(len(names))):
        order = rng.permutation(len(names))
    content = deepcopy(case.content)
    content["joints"] = [names[k] for k in order]
    for section, keys in PER_JOINT.items():
        for key in keys:
            if key in content.get(section, {}):
                values = content[section][key]
                content[section][key] = [values[k] for k in order]
    new_name = {
        f"{channel}{old + 1}": f"{channel}{new + 1}"
        for channel in CHANNELS
        for new, old in enumerate(order)
    }
    tables = {
        name: table.rename(columns=new_name) for name, table in case.recordings.items()
    }
    numbers = {new + 1: int(old) + 1 for new, old in enumerate(order)}
    return Twin(CaseFiles(content, case.urdf, tables), order=numbers)


def files_shuffled(case: CaseFiles, rng: np.random.Generator) -> Twin:
    """Elements of the URDF and columns of the recordings in another order; the order of the joints is said."""
    content = deepcopy(case.content)
    content["joints"] = [str(joint.get("name")) for joint in case.moving]
    urdf = ET.Element(case.urdf.tag, case.urdf.attrib)
    elements = list(case.urdf)
    urdf.extend([elements[k] for k in rng.permutation(len(elements))])
    tables = {}
    for name, table in case.recordings.items():
        tables[name] = table.iloc[:, rng.permutation(table.shape[1])]
    return Twin(CaseFiles(content, urdf, tables))


def rounded(case: CaseFiles, rng: np.random.Generator) -> Twin:
    """All numbers of the recordings changed by about ``ROUNDING`` of themselves."""
    return _each_table(
        case,
        lambda table: table * (1 + ROUNDING * rng.uniform(-1, 1, table.shape)),
    )


def other_units(case: CaseFiles, rng: np.random.Generator) -> Twin:
    """Time in ms, positions in degrees, torque in mN m, and an ``import:`` section that says so."""
    units = {"q": "deg", "dq": "deg/s", "tau": "mN m"}
    units |= {"q_ref": "deg", "dq_ref": "deg/s"}
    present = set(next(iter(case.recordings.values())).columns)
    content = deepcopy(case.content)
    content["import"] = {"time": {"column": "t", "unit": "ms"}}
    for channel, unit in units.items():
        if f"{channel}1" in present:
            content["import"][channel] = {"column": channel + "{j}", "unit": unit}

    factors = {"t": 1e3, "tau": 1e3}
    tables = _scaled(case, lambda name: factors.get(_channel(name), 180 / np.pi))
    return Twin(CaseFiles(content, case.urdf, tables))


def heavier(case: CaseFiles, rng: np.random.Generator) -> Twin:
    """Every mass, torque, gain and entry of the data sheet times one factor: the same motion."""
    content, urdf = deepcopy(case.content), deepcopy(case.urdf)
    for section, keys in PER_JOINT.items():
        for key in keys:
            if key in content.get(section, {}):
                content[section][key] = [HEAVIER * x for x in content[section][key]]
    for element in [*urdf.iter("mass"), *urdf.iter("inertia")]:
        for key, text in element.attrib.items():
            element.set(key, repr(HEAVIER * float(text)))
    tables = _scaled(case, lambda name: HEAVIER if _channel(name) == "tau" else 1.0)
    return Twin(CaseFiles(content, urdf, tables), heavier=HEAVIER)


def later(
    seconds: float,
) -> Callable[[CaseFiles, np.random.Generator], Twin]:
    """Stamps that count from another moment."""
    return lambda case, rng: _each_table(
        case, lambda table: table.assign(t=table["t"] + seconds)
    )


def joint_mirrored(case: CaseFiles, rng: np.random.Generator) -> Twin:
    """The axis of one joint turned round, and the signs of its columns with it."""
    urdf = deepcopy(case.urdf)
    twin = CaseFiles(case.content, urdf, case.recordings)
    number = int(rng.integers(len(twin.moving))) + 1
    joint = twin.moving[number - 1]
    axis = joint.find("axis")
    if axis is None:
        axis = ET.SubElement(joint, "axis", xyz="1 0 0")
    turned = [-float(x) for x in axis.attrib["xyz"].split()]
    axis.set("xyz", " ".join(repr(x) for x in turned))
    limit = joint.find("limit")
    if limit is not None and "lower" in limit.attrib:
        lower, upper = float(limit.attrib["lower"]), float(limit.attrib["upper"])
        limit.attrib.update(lower=repr(-upper), upper=repr(-lower))
    columns = {f"{channel}{number}" for channel in CHANNELS}
    tables = _scaled(case, lambda name: -1.0 if name in columns else 1.0)
    return Twin(CaseFiles(case.content, urdf, tables), mirrored=(number,))


def base_turned(case: CaseFiles, rng: np.random.Generator) -> Twin:
    """The arm mounted on a plate that is turned about the vertical."""
    urdf = deepcopy(case.urdf)
    children = {child.get("link") for child in urdf.iter("child")}
    links = [str(link.get("name")) for link in urdf.findall("link")]
    base = next(name for name in links if name not in children)
    ET.SubElement(urdf, "link", name="turned_plate")
    joint = ET.SubElement(urdf, "joint", name="turned_plate_joint", type="fixed")
    ET.SubElement(joint, "parent", link="turned_plate")
    ET.SubElement(joint, "child", link=base)
    ET.SubElement(joint, "origin", xyz="0 0 0", rpy=f"0 0 {TURN}")
    return Twin(CaseFiles(case.content, urdf, case.recordings), turned=TURN)


def cut_in_half(case: CaseFiles, rng: np.random.Generator) -> Twin:
    """Each recording cut into two files in its middle."""
    tables = {}
    for name, table in case.recordings.items():
        middle = len(table) // 2
        tables[f"first_{name}"] = table.iloc[:middle]
        tables[f"second_{name}"] = table.iloc[middle:]
    return _with_recordings(case._replace(recordings=tables), list(tables))


def _with_recordings(case: CaseFiles, names: list[str]) -> Twin:
    """The case with a list of its recordings."""
    return Twin(case._replace(content={**case.content, "recordings": names}))


def _each_table(
    case: CaseFiles, change: Callable[[pd.DataFrame], pd.DataFrame]
) -> Twin:
    """The case with every recording changed."""
    tables = {name: change(table) for name, table in case.recordings.items()}
    return Twin(case._replace(recordings=tables))


def _scaled(case: CaseFiles, factor: Callable[[str], float]) -> dict[str, pd.DataFrame]:
    """The recordings, each column times a factor."""
    tables = case.recordings.items()
    return {name: table * [factor(c) for c in table.columns] for name, table in tables}


def _channel(column: str) -> str:
    """A column's name without the number of its joint."""
    return column.rstrip("0123456789")


RELATIONS = (
    Relation(
        "unchanged", "nothing: diagnosed twice", EXACT, lambda case, rng: Twin(case)
    ),
    Relation(
        "recordings",
        "order of the recordings",
        EXACT,
        lambda case, rng: _with_recordings(case, case.content["recordings"][::-1]),
    ),
    Relation("joints", "order of the joints", EXACT, joints_permuted),
    Relation("files", "order in URDF and CSV", EXACT, files_shuffled),
    Relation("rounded", "numbers by 1e-9 of themselves", STAMPS, rounded),
    Relation("units", "ms, degrees, mN m", EXACT, other_units),
    Relation("heavier", f"masses and torques times {HEAVIER}", EXACT, heavier),
    Relation("time", "stamps plus 1e5 s", EXACT, later(SHIFT)),
    Relation("unix", "stamps of the Unix clock", STAMPS, later(EPOCH)),
    Relation("mirrored", "sense of one joint", EXACT, joint_mirrored),
    Relation("turned", "base turned about the vertical", EXACT, base_turned),
    Relation(
        "first_row",
        "first row left out",
        ROWS,
        lambda case, rng: _each_table(case, lambda table: table.iloc[1:]),
    ),
    Relation("cut", "each recording cut in two", ROWS, cut_in_half),
)


# A diagnosis beside that of a twin

Document = Mapping[str, Any]
Key = tuple[str, str, int]
"""Effect, parameter, and joint from 1, or minus the place of a component."""

NO_SCATTER = 1e-3
"""Least standard deviation of a value in a comparison, over the value [1]: a step of an encoder has none."""


class Difference(NamedTuple):
    """What differs between a case and its twin.

    Attributes:
        verdict, named, possible: whether they are the same; effects with their joints.
        value: largest difference of a value of a named effect over its standard deviation [1].
        share: largest difference of a share [1].
        closed: difference of the closed share of the gap [1].
        words: both lists of effects, if they differ.
    """

    verdict: bool
    named: bool
    possible: bool
    value: float
    share: float
    closed: float
    words: str = ""

    @property
    def same_names(self) -> bool:
        """Whether verdict, effects and joints are the same, possible ones too."""
        return self.verdict and self.named and self.possible


def compare(case: Document, other: Document, twin: Twin) -> Difference:
    """Compare the diagnosis of a twin, in the joints and units of its case, with that of the case."""
    shares = {entry["effect"]: entry["share"] or 0.0 for entry in other["effects"]}
    both = [entry for entry in case["effects"] if entry["effect"] in shares]
    sizes = [abs((one["share"] or 0.0) - shares[one["effect"]]) for one in both]
    lists = [_effects(case, Twin(twin.files)), _effects(other, twin)]
    (named, possible), (named_too, possible_too) = lists
    same = case["verdict"] == other["verdict"]
    words = ""
    if not same or named != named_too or possible != possible_too:
        words = f"{_described(case, *lists[0])} -> {_described(other, *lists[1])}"
    return Difference(
        verdict=same,
        named=named == named_too,
        possible=possible == possible_too,
        value=_value_difference(case, other, twin),
        share=max(sizes, default=0.0),
        closed=abs((case["closed"] or 0.0) - (other["closed"] or 0.0)),
        words=words,
    )


def _effects(document: Document, twin: Twin) -> list[dict[str, Any]]:
    """Joints by the name of an effect, named and possible."""
    return [
        {e["effect"]: sorted(twin.joints(e["joints"])) for e in document[section]}
        for section in ("effects", "possible")
    ]


def _described(
    document: Document, named: dict[str, Any], possible: dict[str, Any]
) -> str:
    """Verdict, effects with their joints, and possible ones in brackets."""
    parts = [f"{name} {joints}" for name, joints in named.items()]
    parts += [f"({name} {joints})" for name, joints in possible.items()]
    return f"{document['verdict']}: {', '.join(parts) or 'nothing'}"


def _value_difference(case: Document, other: Document, twin: Twin) -> float:
    """Largest difference of a value that both name over its standard deviation."""
    ours, theirs = _values(case, Twin(twin.files)), _values(other, twin)
    sizes = [0.0]
    for key in ours.keys() & theirs.keys():
        one, two = ours[key], theirs[key]
        scatter = max(one[1], NO_SCATTER * abs(one[0]), 1e-12)
        difference = one[0] - two[0]
        if key[1] == "phase":
            difference = (difference + np.pi) % (2 * np.pi) - np.pi
        sizes.append(abs(difference) / scatter)
    return max(sizes)


def _values(document: Document, twin: Twin) -> dict[Key, tuple[float, float]]:
    """Values and standard deviations of the named effects, in the case's joints, units and base frame."""
    found = {}
    for entry in document["effects"]:
        effect, joints = entry["effect"], entry["joints"]
        for name, unit, values, deviations in _parameters(entry):
            at_joints = joints and len(joints) == len(values)
            places = twin.joints(joints) if at_joints else range(0, -len(values), -1)
            for place, x, std in zip(places, values, deviations, strict=True):
                of = (effect, name, unit, place)
                found[effect, name, place] = (twin.value(*of, x), std / twin.size(unit))
    if twin.turned:
        _turn_back(found, twin.turned)
    return found


def _parameters(entry: Document) -> Iterator[tuple[str, str, list[float], list[float]]]:
    """Name, unit, values and standard deviations of an effect's parameters that are numbers."""
    for name, parameter in entry["parameters"].items():
        values = np.atleast_1d(parameter["value"])
        if values.dtype.kind not in "if":
            continue
        deviations = np.zeros(len(values))
        if parameter.get("std") is not None:
            deviations = np.atleast_1d(np.array(parameter["std"], dtype=float))
        yield name, parameter["unit"], values.tolist(), deviations.tolist()


def _turn_back(found: dict[Key, tuple[float, float]], angle: float) -> None:
    """Forces and tilts in a base frame turned about the vertical as the frame before has them, in place."""
    back = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    force = [("external_force", "force", -k) for k in range(2)]
    if force[0] in found:
        turned = back @ [found[key][0] for key in force]
        found |= {key: (x, found[key][1]) for key, x in zip(force, turned, strict=True)}
    tilt = [("base_tilt", "roll", 0), ("base_tilt", "pitch", 0)]
    if tilt[0] in found:
        roll, pitch = (found[key][0] for key in tilt)
        # the vertical in the base frame, up to its sign
        x, y, z = (
            -np.sin(pitch),
            np.cos(pitch) * np.sin(roll),
            np.cos(pitch) * np.cos(roll),
        )
        x, y = back @ [x, y]
        angles = (np.arctan2(y, z), -np.arcsin(x))
        found |= {key: (a, found[key][1]) for key, a in zip(tilt, angles, strict=True)}
