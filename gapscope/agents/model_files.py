"""Models by the names and files that a user gives."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from gapscope.agents.agent_controller import AgentModel, Candidate
from gapscope.agents.torque_model import ArmModel, Gravity, TorqueModel
from gapscope.arm.case import load_case
from gapscope.arm.errors import InputError
from gapscope.arm.input_file import file_beside, is_folder
from gapscope.arm.io.json_file import read_json
from gapscope.arm.nearest_name import nearest
from gapscope.arm.nominal import NominalArm
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.corrected_file import read_corrected_arm

NAMES = ("pd", "gravity", "nominal")
"""Models that need no file."""


def named(entry: str) -> tuple[str, str]:
    """Name and source of ``SOURCE`` or ``NAME=SOURCE``.

    A file is called after itself; a ``corrected.yaml`` and an ``identification.json`` after their folder. The folder of
    an agent is called after itself.
    """
    name, equals, source = entry.partition("=")
    if equals:
        return name, source
    path = Path(entry)
    if is_folder(path):
        return path.resolve().name, entry
    if entry in NAMES or not path.suffix:
        return entry, entry
    usual = path.stem in ("corrected", "identification") and path.resolve().parent.name
    return (usual or path.stem), entry


def read_models(
    entries: list[str],
    arm: NominalArm,
    read_agent: Callable[[Path, NominalArm], AgentModel],
) -> dict[str, Candidate]:
    """Models and agents by name, in their order; ``None`` is PD alone.

    Args:
        entries: each one of ``NAMES``, the path of a ``corrected.yaml`` or of an ``identification.json``, or the folder
            of a trained agent; or any of these behind ``NAME=``.
        arm: the nominal arm that a ``corrected.yaml`` belongs to, and whose joints an identified one must have.
        read_agent: reads an agent's folder; given by the caller, so that models need no learning libraries.

    Raises:
        InputError: a file is missing or no model, is of an arm with other joints, or two models have one name.
    """
    models: dict[str, Candidate] = {}
    for entry in entries:
        name, source = named(entry)
        if not name or name in models:
            raise InputError(
                f"two models are called {name!r}", f"write NAME={source}", where="MODEL"
            )
        is_agent = is_folder(Path(source))
        models[name] = (
            read_agent(Path(source), arm) if is_agent else read_model(source, arm)
        )
    return models


def read_model(source: str, arm: NominalArm) -> TorqueModel | None:
    """One model; see ``read_models``."""
    if source == "pd":
        return None
    return Gravity(arm) if source == "gravity" else ArmModel(read_arm(source, arm))


def read_arm(source: str, arm: NominalArm) -> CorrectedArm:
    """The arm with effects of ``nominal`` or of a file; see ``read_models``."""
    if source == "nominal":
        return CorrectedArm(arm)
    path = Path(source)
    if path.suffix == ".json":
        return _identified(path, arm)
    if path.suffix in (".yaml", ".yml"):
        return read_corrected_arm(arm, path)
    raise InputError(
        f"unknown model {source!r}",
        f"{nearest(source, NAMES)}give {', '.join(NAMES)}, the path of a corrected.yaml or of an identification.json, "
        "or the folder of a trained agent",
        where="MODEL",
    )


def _identified(path: Path, arm: NominalArm) -> CorrectedArm:
    """The identified arm that ``gapscope identify`` wrote beside its document."""
    remedy = "give the identification.json that gapscope identify wrote, in its folder"
    content = read_json(path, remedy)
    files = content.get("files") if isinstance(content, dict) else None
    if not isinstance(files, dict) or not {"case", "effects"} <= set(files):
        raise InputError(
            "names no files of an identified arm", remedy, file=path, where="files"
        )
    case, effects = (
        file_beside(path.parent, files[name], path, f"files.{name}")
        for name in ("case", "effects")
    )
    identified = load_case(case, read_recordings=False).arm
    if identified.joints != arm.joints:
        raise InputError(
            f"is of an arm with the joints {', '.join(identified.joints)}, not {', '.join(arm.joints)}",
            "identify the arm that is tracked, or give it as --robot",
            file=path,
        )
    return read_corrected_arm(identified, effects)
