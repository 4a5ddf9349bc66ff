"""Arguments of the environment from a YAML file or its registered name, for ``gapscope evaluate --env``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gapscope.arm.case import load_case
from gapscope.arm.errors import InputError
from gapscope.arm.io.case_file import read_yaml
from gapscope.arm.nearest_name import check_known, nearest
from gapscope.arm.nominal import NominalArm
from gapscope.arm.robots import load_nominal_arm
from gapscope.commands.inputs import is_case
from gapscope.envs.registration import NAME

if TYPE_CHECKING:
    from typer import Context

ALIASES = {"motion": "motions", "engines": "engine", "episode_length": "duration"}
"""Names of the environment's arguments, by those of the command."""
TEXTS = ("robot", "case", "effects", "law")
LISTS = ("engine", "motions", "disturbances")
NUMBERS = ("duration", "bandwidth", "damping")
KNOWN = (*TEXTS, *LISTS, *NUMBERS, "seeds", "sheet", *ALIASES)
"""Keys that a file may have."""
UNUSED = (
    "action",
    "action_share",
    "action_reach",
    "encoder_noise",
    "feedforward",
    "look_ahead",
    "sub_steps",
    "time_step",
    "posture",
    "limits",
    "reward",
    "debug",
    "render_mode",
)
"""Arguments of the environment that an evaluation ignores."""


@dataclass(frozen=True)
class EnvironmentFile:
    """What a file says.

    Attributes:
        path: the file, or ``None`` for the registered name.
        values: by option of ``gapscope evaluate``: texts, numbers, and lists with commas between their names.
        sheet: data sheet of the nominal arm, as ``nominal:`` in a case, or ``None``.
        unused: keys that an evaluation ignores.
    """

    path: Path | None
    values: dict[str, Any]
    sheet: dict[str, Any] | None
    unused: tuple[str, ...]

    def arm(self) -> NominalArm | None:
        """The nominal arm, with the data sheet of the file; ``None`` if the file names none.

        Raises:
            InputError: it cannot be used.
        """
        folder = Path() if self.path is None else self.path.parent
        if "case" in self.values:
            return load_case(folder / self.values["case"], read_recordings=False).arm
        if "robot" not in self.values and self.sheet is None:
            return None
        robot = self.values.get("robot", "kuka_iiwa")
        place = folder / robot
        if is_case(place):
            if self.sheet is not None:
                raise InputError(
                    "a case has its own data sheet",
                    "leave sheet: out",
                    file=self.path,
                    where="sheet",
                )
            return load_case(place, read_recordings=False).arm
        return load_nominal_arm(
            robot, folder=folder, sheet=self.sheet, source=self.path
        )

    def effects(self) -> Path | None:
        """File with the effects, relative to that of the environment."""
        if "effects" not in self.values or self.path is None:
            return None
        return self.path.parent / str(self.values["effects"])


def read_environment(source: str) -> EnvironmentFile:
    """The environment of a file, or the one of the registered name, whose arguments are all as by default.

    Raises:
        InputError: no such file or name, an unknown key, or a value that a key cannot have.
    """
    if source == NAME:
        return EnvironmentFile(None, {}, None, ())
    path = Path(source)
    if path.suffix not in (".yaml", ".yml") and not path.exists():
        check_known("environment", source, (NAME,), where="--env")
    content = _content(path)
    for key in content:
        _check_key(key, path)
    values = _values(content, path)
    sheet = content.get("sheet")
    _check_sheet(sheet, path)
    if "case" in values and ("robot" in values or "sheet" in content):
        raise InputError(
            "a case has its own robot and data sheet",
            "leave robot: and sheet: out",
            file=path,
        )
    unused = tuple(key for key in content if key in UNUSED)
    return EnvironmentFile(path, values, sheet, unused)


def _check_key(key: object, path: Path) -> None:
    if key == "randomisation":
        raise InputError(
            "an evaluation draws no effects",
            "write those to be tried as effects: FILE",
            file=path,
            where=str(key),
        )
    if key not in (*KNOWN, *UNUSED):
        raise InputError(
            f"unknown key {key!r}",
            f"{nearest(str(key), KNOWN)}known are {', '.join(KNOWN)}",
            file=path,
        )


def _check_sheet(sheet: object, path: Path) -> None:
    if sheet is not None and not isinstance(sheet, dict):
        raise InputError(
            "expected a data sheet",
            "write it as nominal: of a case",
            file=path,
            where="sheet",
        )


def _values(content: dict[str, Any], path: Path) -> dict[str, Any]:
    """Values by option of the command, checked."""
    values: dict[str, Any] = {}
    for key, value in content.items():
        name = ALIASES.get(key, key)
        if name in values:
            raise InputError(
                f"says the same as {name}",
                "leave one of them out",
                file=path,
                where=key,
            )
        if key not in UNUSED and key != "sheet":
            values[name] = _checked(name, value, path, key)
    return values


def merge_options(
    source: str | None, context: Context
) -> tuple[NominalArm | str, dict[str, Any], tuple[str, ...]]:
    """Options of a command with what an environment says, if the user gave no option.

    Args:
        source: file or name of the environment, or ``None``.
        context: of the command, whose options are called as those of ``gapscope evaluate``.

    Returns:
        The nominal arm, or its name; the options by name; and keys of the file that are ignored.

    Raises:
        InputError: see ``read_environment``.
    """
    options = dict(context.params)
    if source is None:
        return options["robot"], options, ()
    found = read_environment(source)

    def given(name: str) -> bool:
        from_user = context.get_parameter_source(name)
        return from_user is not None and from_user.name == "COMMANDLINE"

    options |= {
        name: value
        for name, value in found.values.items()
        if name in options and not given(name)
    }
    if not given("effects"):
        options["effects"] = found.effects()
    arm = None if given("robot") else found.arm()
    return arm or options["robot"], options, found.unused


def _content(path: Path) -> dict[str, Any]:
    content = read_yaml(path, "check the path")
    content = {} if content is None else content
    if not isinstance(content, dict):
        raise InputError(
            "expected keys with values",
            "write for instance robot: kuka_iiwa",
            file=path,
        )
    return content


def _checked(name: str, value: Any, path: Path, key: str) -> Any:
    """A value as the command's option takes it."""
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    if name in TEXTS:
        expected = "a name or path"
        if isinstance(value, str):
            return value
    elif name in NUMBERS:
        expected = "a number"
        if is_number:
            return float(value)
    elif name == "seeds":
        expected = "a whole number from 1 on"
        if is_number and isinstance(value, int) and value >= 1:
            return value
    else:
        expected = "a name or a list of names"
        if isinstance(value, str):
            return value
        if _is_list_of_names(value):
            return ",".join(value)
    raise InputError(f"expected {expected}, got {value!r}", file=path, where=key)


def _is_list_of_names(value: Any) -> bool:
    if not isinstance(value, list) or not value:
        return False
    return all(isinstance(item, str) for item in value)
