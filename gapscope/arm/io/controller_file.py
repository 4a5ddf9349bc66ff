"""The ``controller:`` section of a case, in the case file or in a file of its own."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from gapscope.arm.control.computed_torque import ComputedTorque
from gapscope.arm.control.integrator import Integrator
from gapscope.arm.control.laws import LAWS
from gapscope.arm.controller import Controller
from gapscope.arm.errors import InputError
from gapscope.arm.io.case_file import check, read_yaml

EXAMPLE = "{kind: pd, rate: 1000, kp: [...], kd: [...], feedforward: nominal, velocity_filter: {cutoff: 80}}"
"""What a controller file may hold."""
COMMON = ("kind", "rate", "feedforward", "velocity_filter")
"""Keys of the section that every law has; the others are its gains, and ``integrator`` if it has one."""


def read_controller(path: Path, n_joints: int) -> Controller:
    """Controller of an arm with n joints, from a YAML file that holds the section, or has it under ``controller:``.

    Raises:
        InputError: there is no such file, it is not YAML, or it is no controller of this arm; names the field.
    """
    content = read_yaml(path, f"give a YAML file with {EXAMPLE}")
    if isinstance(content, dict) and "controller" in content:
        content = content["controller"]
    if content is None:
        raise InputError("holds no controller", f"write {EXAMPLE} into it", file=path)
    check(content, path, "controller")
    controller = parse_controller(content, n_joints, path, "")
    assert controller is not None
    return controller


def parse_controller(
    section: Mapping[str, Any] | None,
    n_joints: int,
    source: Path,
    prefix: str = "controller.",
) -> Controller | None:
    """Controller of an arm with n joints from the section, which follows the case format; ``None`` for none.

    Args:
        section: content of ``controller:``.
        n_joints: of the arm.
        source: the file, for messages.
        prefix: of its fields, for messages.

    Raises:
        InputError: a key is missing or of another law, the gains are not one finite number per joint, or keys
            contradict.
    """
    if section is None:
        return None
    law = LAWS[section.get("kind", "pd")]
    place = _Place(source, prefix, n_joints)
    _check_keys(section, law, place)
    given: dict[str, Any] = {
        gain.name: place.per_joint(gain.name, section[gain.name], gain.unit)
        for gain in law.gains
    }
    if section.get("integrator"):
        given["integrator"] = _integrator(section["integrator"], place)
    velocity = section.get("velocity_filter") or {}
    return law(
        rate=float(section["rate"]),
        feedforward=section.get("feedforward", "none"),
        velocity_cutoff=velocity.get("cutoff"),
        velocity_damping=velocity.get("damping", 0.9),
        **given,
    )


def controller_section(controller: Controller) -> dict[str, Any]:
    """The ``controller:`` section of a controller, as plain data."""
    section: dict[str, Any] = {"kind": controller.kind, "rate": controller.rate}
    for gain in controller.gains:
        section[gain.name] = getattr(controller, gain.name).tolist()
    if controller.integrator is not None:
        section["integrator"] = _integrator_section(controller.integrator)
    if not controller.through_model:
        section["feedforward"] = controller.feedforward
    if controller.velocity_cutoff is not None:
        section["velocity_filter"] = {
            "cutoff": controller.velocity_cutoff,
            "damping": controller.velocity_damping,
        }
    return section


class _Place:
    """Where a section stands, for messages: its file, the prefix of its fields, and the arm's number of joints."""

    def __init__(self, source: Path, prefix: str, n_joints: int) -> None:
        self._source, self._prefix, self._n_joints = source, prefix, n_joints

    def error(self, message: str, remedy: str, key: str) -> InputError:
        """The error on a field."""
        field = f"{self._prefix}{key}".rstrip(".")
        where = f"field {field}" if field else ""
        return InputError(message, remedy, file=self._source, where=where)

    def per_joint(self, key: str, given: list[float], unit: str) -> np.ndarray:
        """Numbers of a field, one per joint, (n,); raises ``InputError`` if they are not."""
        n_joints = self._n_joints
        values = np.array(given, dtype=float)
        if values.shape != (n_joints,) or not np.isfinite(values).all():
            got = len(values) if len(values) != n_joints else given
            raise self.error(
                f"expected {n_joints} numbers, one per joint, got {got}",
                f"give {key} in {unit}, in the order of the joints",
                key,
            )
        return values


def _check_keys(
    section: Mapping[str, Any], law: type[Controller], place: _Place
) -> None:
    """Check that the section has the gains of its law and none of another."""
    names = [gain.name for gain in law.gains]
    for name in names:
        if name not in section:
            raise place.error(
                f"lacks the key {name!r}, which {law.kind} needs",
                f"add {name}: to it, one number per joint",
                "",
            )
    known = {*COMMON, *names}
    if law.integrates:
        known.add("integrator")
    for key in section:
        if key not in known:
            raise place.error(
                f"is no key of the law {law.kind}",
                f"drop it, or give the kind that has it; {law.kind} has {', '.join(names)}",
                key,
            )
    if law is ComputedTorque and section.get("feedforward", "none") != "none":
        raise place.error(
            "computed torque contains the nominal arm's torque already",
            "drop feedforward:, or give kind: pd",
            "feedforward",
        )


def _integrator(entry: Mapping[str, Any], place: _Place) -> Integrator:
    """The integrator's bounds."""
    limit = entry.get("limit")
    anti_windup = entry.get("anti_windup", "clamping")
    tracking_time = entry.get("tracking_time")
    if (anti_windup == "back_calculation") != (tracking_time is not None):
        raise place.error(
            f"anti_windup: {anti_windup} with tracking_time: {tracking_time}",
            "give tracking_time in s with anti_windup: back_calculation, and with no other",
            "integrator.tracking_time",
        )
    return Integrator(
        None if limit is None else place.per_joint("integrator.limit", limit, "N m"),
        anti_windup,
        tracking_time,
    )


def _integrator_section(integrator: Integrator) -> dict[str, Any]:
    entry: dict[str, Any] = {"anti_windup": integrator.anti_windup}
    if integrator.limit is not None:
        entry["limit"] = integrator.limit.tolist()
    if integrator.tracking_time is not None:
        entry["tracking_time"] = integrator.tracking_time
    return entry
