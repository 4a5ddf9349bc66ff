"""The file of a case: its keys, the files it names, its controller."""

from __future__ import annotations

import math
import os
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import accumulate
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from gapscope.arm.control import LAWS
from gapscope.arm.controller import Controller, Integrator
from gapscope.arm.errors import LONGEST_SHOWN, InputError
from gapscope.arm.input_file import is_file, is_folder, read_text, real_path
from gapscope.arm.io.formats.lerobot import dataset_files, is_dataset
from gapscope.arm.io.json_file import LARGEST_WHOLE, field, plain, schema, schema_fault
from gapscope.arm.known_load import KnownLoad
from gapscope.arm.nearest_name import nearest

# The text of a case file: YAML checked against ``case.schema.json``, faults reported in plain sentences.


LARGEST_YAML = 5_000_000
"""Size of the largest YAML file that is read [bytes]; that of a case has some kB. Nor may it stand for more
values, aliases written out."""

_KINDS = {
    "object": "a mapping (key: value)",
    "array": "a list",
    "string": "a text",
    "number": "a number",
    "integer": "a whole number",
    "null": "nothing",
}


_RULES = {
    "type": "expected {listed}, got {shown}",
    "enum": "expected one of {listed}; got {value!r}",
    "minItems": "expected at least {expected} entries, got {count}",
    "maxItems": "expected at most {expected} entries, got {count}",
    "minimum": "expected a number of at least {expected}, got {value!r}",
    "maximum": "expected a number of at most {expected}, got {value!r}",
    "exclusiveMinimum": "expected a number above {expected}, got {value!r}",
    "uniqueItems": "has an entry twice: {shown}",
    "required": "lacks the key {missing!r}",
}
"""What is said of a fault, by the rule of the schema, unless the schema itself has ``fault`` and ``remedy`` for it."""


class _Loader(yaml.SafeLoader):
    """YAML 1.1 as PyYAML reads it, but ``1e-3`` is a number and a key given twice is a fault."""

    def construct_mapping(
        self, node: yaml.MappingNode, deep: bool = False
    ) -> dict[Any, Any]:
        """Mapping of a YAML node, each key once."""
        seen = set()
        for key, _ in node.value if isinstance(node, yaml.MappingNode) else ():
            # a key may be a list or a mapping, which no case has: the schema says so
            if not isinstance(key, yaml.ScalarNode):
                continue
            # PyYAML takes the last of two equal keys without a word
            if key.value in seen:
                raise yaml.MarkedYAMLError(
                    problem=f"key {key.value!r} is given twice",
                    problem_mark=key.start_mark,
                )
            seen.add(key.value)
        return super().construct_mapping(node, deep)

    def construct_whole(self, node: yaml.ScalarNode) -> int:
        """A whole number that a float can hold too."""
        number = int(self.construct_yaml_int(node))
        if abs(number) > LARGEST_WHOLE:
            raise yaml.MarkedYAMLError(
                problem="a whole number beyond any that counts something",
                problem_mark=node.start_mark,
            )
        return number


_Loader.add_constructor("tag:yaml.org,2002:int", _Loader.construct_whole)
# YAML 1.1 asks for a point in a number with an exponent
_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(r"[-+]?\d+(\.\d*)?[eE][-+]?\d+$"),
    list("-+0123456789"),
)


def is_case(path: Path) -> bool:
    """Whether a path names a case: a folder, or a YAML file."""
    return is_folder(path) or path.suffix in (".yaml", ".yml")


def read_case_file(path: Path) -> dict[str, Any]:
    """Content of a case file, as plain data.

    Raises:
        InputError: there is no such file, it is not YAML, or it does not follow the case format; the error names the
            line or the field.
    """
    remedy, folder = "give a case folder, or its case.yaml", path.parent
    if not os.path.lexists(path) and any(folder.glob(f"*/{path.name}")):
        remedy = f"folders in it are cases: give {folder}/*, or gapscope fleet {folder}"
    content = read_yaml(path, remedy)
    check(content, path)
    return content


def read_yaml(path: Path, remedy: str) -> Any:
    """Content of a YAML file, as plain data.

    Args:
        path: the file.
        remedy: what to do if there is no such file.

    Raises:
        InputError: there is no such file, or it is not YAML; the error names the line.
    """
    text = read_text(path, remedy, LARGEST_YAML)
    try:
        return _loaded(text)
    except yaml.MarkedYAMLError as error:
        # a fault that has no mark is of the whole file
        mark = error.problem_mark
        where = f"line {mark.line + 1}, column {mark.column + 1}" if mark else ""
        raise InputError(
            f"is not valid YAML: {error.problem}", file=path, where=where
        ) from None
    # dates and numbers that YAML allows and Python does not have; a text that is tagged as a date and is none
    except (yaml.YAMLError, ValueError, OverflowError, AttributeError) as error:
        raise InputError(f"is not valid YAML: {error}", file=path) from None
    except RecursionError:
        raise InputError("is nested too deeply", remedy, file=path) from None


def _loaded(text: str) -> Any:
    """Content of a YAML text, in which aliases may stand for little more than what is written.

    Raises:
        yaml.YAMLError: it is no YAML, or its aliases stand for themselves or for too much.
        RecursionError: it is nested too deeply.
    """
    # brackets that are open at once, those in quotes and comments among them
    steps = [1 if bracket in "[{" else -1 for bracket in re.findall(r"[\[\]{}]", text)]
    # counted before parsing: PyYAML looks at all that are open at each word, and recurses
    if max(accumulate(steps), default=0) > sys.getrecursionlimit():
        raise RecursionError
    loader = _Loader(text)
    try:
        # the tree of nodes has each alias once: measured before it is written out
        root = loader.get_single_node()
        if root is None:
            return None
        if _expanded_size(root, {}) > LARGEST_YAML:
            raise yaml.YAMLError(
                f"its aliases stand for more than {LARGEST_YAML} values"
            )
        return loader.construct_document(root)
    finally:
        loader.dispose()


def _expanded_size(node: yaml.Node, known: dict[int, int]) -> int:
    """Number of values of a node with every alias written out.

    A few lines of aliases of aliases can stand for more values than a memory holds.
    """
    if id(node) in known:
        if not known[id(node)]:
            raise yaml.YAMLError("an alias stands for what it is part of")
        return known[id(node)]
    # 0 while its parts are counted: met again, it is a part of itself
    known[id(node)] = 0
    parts = node.value if isinstance(node, yaml.CollectionNode) else []
    # a mapping's keys count as well as what they stand for
    if isinstance(node, yaml.MappingNode):
        parts = [part for pair in parts for part in pair]
    known[id(node)] = 1 + sum(_expanded_size(part, known) for part in parts)
    return known[id(node)]


def check(
    content: Any,
    path: Path | None,
    section: str = "",
    prefix: str = "",
    n_joints: int | None = None,
) -> None:
    """Compare ``content`` with the case schema, or with what it says about one section of a case.

    ``prefix`` is what fields are named with. Lists of a section have one value per joint if their number is given.

    Raises:
        InputError: the first fault, with its field.
    """
    content = plain(content)

    def fault(message: str, remedy: str, place: Iterable[str | int]) -> InputError:
        # list entries count from 1 as joints do
        said = field([*filter(None, [prefix]), *place], first=1)
        return InputError(
            message, remedy, file=path, where=f"field {said}" if said else ""
        )

    # NaN and infinity are numbers of a schema, but only a drive may have no limit
    for place, number in _not_finite(content):
        if "torque_limit" not in place:
            raise fault(f"expected a number, got {number}", "correct it", place)
    of_the_arm = _of_joints(n_joints) if n_joints else {}
    error = schema_fault(content, "case", section, **of_the_arm)
    if error is not None:
        said = error.validator, error.validator_value, error.instance, error.schema
        message, remedy = _sentence(*said)
        place = error.absolute_path
        raise fault(message, remedy or _meaning(section, *place), place)


def _of_joints(n: int) -> dict[str, Any]:
    """Definitions of the case schema for an arm with n joints."""
    per_joint = {
        "minItems": n,
        "maxItems": n,
        "fault": f"expected {n} entries, one per joint, got {{count}}",
    }
    joint_number = {
        "maximum": n,
        "fault": f"expected each of the numbers 1 to {n} once, got {{value}}",
        "remedy": "give for each joint the number of the joint whose column holds it",
    }
    return {"per_joint": per_joint, "joint_number": joint_number}


def _meaning(*place: str | int) -> str:
    """What to give at a place in a case, in the words of the schema; nothing if a definition says it."""
    form = schema("case")
    for step in place:
        # entries of a list are described with it
        if isinstance(step, str) and step:
            form = form.get("properties", {}).get(step, {})
    meaning = form.get("description", "")
    return meaning and f"give what the key stands for: {meaning}"


def _not_finite(
    content: Any, place: tuple[str | int, ...] = ()
) -> Iterator[tuple[tuple[str | int, ...], float]]:
    """NaN and infinity, and where they stand."""
    if isinstance(content, float) and not math.isfinite(content):
        yield place, content
    parts = content.items() if isinstance(content, dict) else ()
    for key, part in enumerate(content) if isinstance(content, list) else parts:
        yield from _not_finite(part, (*place, key))


def _sentence(rule: str, expected: Any, value: Any, form: Any) -> tuple[str, str]:
    """What is wrong, and what to do."""
    if rule == "additionalProperties":
        known = list(form["properties"])
        # one key at a time: the first that is unknown
        unknown = next(key for key in value if key not in known)
        # the nearest, else all
        remedy = nearest(str(unknown), known) or f"known keys: {', '.join(known)}"
        return f"unknown key {unknown!r}", remedy.strip()
    listed, shown, missing, remedy = "", repr(value), "", ""
    if rule == "required":
        missing = next(key for key in expected if key not in value)
        remedy = "add {missing}: to it"
    elif rule == "enum":
        listed = ", ".join(map(str, expected))
    elif rule == "type":
        kinds = [expected] if isinstance(expected, str) else expected
        listed = " or ".join(_KINDS[kind] for kind in kinds)
    # of a long value its beginning
    if len(shown) > LONGEST_SHOWN:
        shown = f"{shown[:LONGEST_SHOWN]} ..."
    words = {
        "expected": expected,
        "value": value,
        "shown": shown,
        "count": len(value) if hasattr(value, "__len__") else 0,
        "listed": listed,
        "missing": missing,
    }
    usual = _RULES.get(rule, "must not be empty, got {shown}")
    said = form.get("fault", usual).format(**words)
    return said, form.get("remedy", remedy).format(**words)


# The ``controller:`` section of a case, in the case file or in a file of its own.


EXAMPLE = "{kind: pd, rate: 1000, kp: [...], kd: [...], feedforward: nominal, velocity_filter: {cutoff: 80}}"
"""What a controller file may hold."""


def read_controller(path: Path, n_joints: int) -> Controller:
    """Controller of an arm with n joints, from a YAML file that holds the section, or has it under ``controller:``.

    Raises:
        InputError: there is no such file, it is not YAML, or it is no controller of this arm; names the field.
    """
    content = read_yaml(path, f"give a YAML file with {EXAMPLE}")
    # a file may hold the section alone, or a case may be given
    if isinstance(content, dict) and "controller" in content:
        content = content["controller"]
    if content is None:
        raise InputError("holds no controller", f"write {EXAMPLE} into it", file=path)
    controller = parse_controller(content, n_joints, path, "")
    assert controller is not None
    return controller


def parse_controller(
    section: Mapping[str, Any] | None,
    n_joints: int,
    source: Path,
    prefix: str = "controller",
) -> Controller | None:
    """Controller of an arm with n joints from the section, which follows the case format; ``None`` for none.

    Args:
        section: content of ``controller:``, checked here.
        n_joints: of the arm.
        source: the file, for messages.
        prefix: of its fields, for messages.

    Raises:
        InputError: a key is missing or of another law, the gains are not one finite number per joint, or keys
            contradict.
    """
    if section is None:
        return None
    check(section, source, "controller", prefix, n_joints)
    law = LAWS[section.get("kind", "pd")]
    given: dict[str, Any] = {
        gain.name: np.array(section[gain.name], dtype=float) for gain in law.gains
    }
    if section.get("integrator"):
        bounds = dict(section["integrator"])
        if "limit" in bounds:
            bounds["limit"] = np.array(bounds["limit"], dtype=float)
        given["integrator"] = Integrator(**bounds)
    velocity = section.get("velocity_filter") or {}
    return law(
        rate=float(section["rate"]),
        feedforward=section.get("feedforward", "none"),
        velocity_cutoff=velocity.get("cutoff"),
        velocity_damping=velocity.get("damping", Controller.velocity_damping),
        **given,
    )


def controller_section(controller: Controller) -> dict[str, Any]:
    """The ``controller:`` section of a controller, as plain data."""
    section: dict[str, Any] = {"kind": controller.kind, "rate": controller.rate}
    for gain in controller.gains:
        section[gain.name] = getattr(controller, gain.name).tolist()
    if controller.integrator is not None:
        bounds = plain(controller.integrator).items()
        section["integrator"] = {k: x for k, x in bounds if x is not None}
    if not controller.through_model:
        section["feedforward"] = controller.feedforward
    if controller.velocity_cutoff is not None:
        section["velocity_filter"] = {
            "cutoff": controller.velocity_cutoff,
            "damping": controller.velocity_damping,
        }
    return section


# Paths in a case file: relative to its folder, or to the folder with the data sets.


DATA_ROOT = "GAPSCOPE_DATA"
"""Environment variable with the folder that replaces ``${GAPSCOPE_DATA}`` in a path of a case."""


@dataclass(frozen=True)
class CasePaths:
    """Paths of a case file, from their text."""

    file: Path
    data_root: Path | None

    def expand(self, text: str, field: str) -> Path:
        """A path with ``${GAPSCOPE_DATA}`` filled in; relative ones stay relative to the case's folder."""
        if "\0" in text:
            raise InputError(
                f"{text!r} has a null byte, which no path has",
                "correct the path",
                file=self.file,
                where=f"field {field}",
            )
        mark = "${" + DATA_ROOT + "}"
        if mark not in text:
            return Path(text)
        beside = self.file.resolve().parent.parent.parent.parent / "shared" / "data"
        root = Path(self.data_root or os.environ.get(DATA_ROOT) or beside)
        if not is_folder(root):
            raise InputError(
                f"{mark} is replaced by {root}, which is not a folder",
                f"set the environment variable {DATA_ROOT} to the folder with the data sets",
                file=self.file,
                where=f"field {field}",
            )
        return Path(text.replace(mark, str(root.resolve())))

    def entry(
        self, entry: str | Mapping[str, str], field: str
    ) -> Path | dict[str, Path]:
        """Path of a recording, or the paths of its files by label."""
        if isinstance(entry, str):
            return self.file.parent / self.expand(entry, field)
        return {
            label: self.file.parent / self.expand(text, field)
            for label, text in entry.items()
        }


def with_files(
    content: Mapping[str, Any], change: Callable[[str, str], str]
) -> dict[str, Any]:
    """The content of a case file with each name of a file in it changed.

    Args:
        content: of the file.
        change: what becomes of the name in a field: ``change(field, name)``.
    """
    out = dict(content)

    def changed(field: str, entry: Any) -> Any:
        """A name, or several by label."""
        if isinstance(entry, Mapping):
            return {label: change(field, name) for label, name in entry.items()}
        return change(field, entry)

    out["robot"] = change("robot", str(content["robot"]))
    for key in ("recordings", "judge"):
        if key in content:
            out[key] = [changed(key, entry) for entry in content[key]]
    if content.get("payloads"):
        loads = content["payloads"].items()
        out["payloads"] = {change("payloads", name): load for name, load in loads}
    if "calibration" in (content.get("import") or {}):
        section = content["import"]
        calibration = change("import.calibration", section["calibration"])
        out["import"] = {**section, "calibration": calibration}
    return out


def moved(content: Mapping[str, Any], old: Path, new: Path) -> dict[str, Any]:
    """The content of a case file in a folder, with the paths in it as seen from another folder.

    Those that begin with ``${`` stay as they are, and so does a robot that is a name and no file.
    """

    def change(field: str, name: str) -> str:
        known = field == "robot" and not is_file(old / name)
        if known or name.startswith("${") or Path(name).is_absolute():
            return name
        return os.path.relpath(old / name, new)

    return with_files(content, change)


def files_of(place: Path) -> list[Path]:
    """A file, or every file of a bag's folder; of a dataset those with numbers."""
    if not is_folder(place):
        return [place]
    if is_dataset(place):
        return dataset_files(place)
    return sorted(path for path in place.rglob("*") if path.is_file())


def known_loads(content: Mapping[str, Any], paths: CasePaths) -> dict[Path, KnownLoad]:
    """Known bodies by the path of a recording's file; of several files side by side any may be named.

    Raises:
        InputError: no recording has a name of ``payloads:``, or a number is not finite.
    """
    section = content.get("payloads")
    if not section:
        return {}
    files = {
        text: paths.file.parent / paths.expand(text, part)
        for part in ("recordings", "judge")
        for entry in content.get(part, [])
        for text in ([entry] if isinstance(entry, str) else entry.values())
    }
    found = {}
    for name, entry in section.items():
        if name not in files:
            others = f"name one of recordings: or judge:, {', '.join(files)}"
            raise InputError(
                f"no recording is called {name!r}",
                nearest(name, files).strip() or others,
                file=paths.file,
                where="field payloads",
            )
        try:
            x, y, z = map(float, entry["com"])
            load = KnownLoad(float(entry["mass"]), (x, y, z))
        except InputError as error:
            raise error.at(paths.file, f"field payloads.{name}") from None
        # by its real path, whatever link or dots the name has
        found[real_path(files[name])] = load
    return found
