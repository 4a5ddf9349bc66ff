"""The ``controller:`` section of a case, in the case file or in a file of its own."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from gapscope.arm.controller import Controller
from gapscope.arm.errors import InputError
from gapscope.arm.io.case_file import check, read_yaml

EXAMPLE = "{kind: pd, rate: 1000, kp: [...], kd: [...], feedforward: nominal, velocity_filter: {cutoff: 80}}"
"""What a controller file may hold."""


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
        InputError: the gains are not one finite number per joint.
    """
    if section is None:
        return None
    gains = {name: np.array(section[name], dtype=float) for name in ("kp", "kd")}
    for name, values in gains.items():
        if values.shape != (n_joints,) or not np.isfinite(values).all():
            got = len(values) if len(values) != n_joints else section[name]
            raise InputError(
                f"expected {n_joints} numbers, one per joint, got {got}",
                f"give {name} in {'N m/rad' if name == 'kp' else 'N m s/rad'}, in the order of the joints",
                file=source,
                where=f"field {prefix}{name}",
            )
    velocity = section.get("velocity_filter") or {}
    return Controller(
        rate=float(section["rate"]),
        **gains,
        feedforward=section.get("feedforward", "none"),
        velocity_cutoff=velocity.get("cutoff"),
        velocity_damping=velocity.get("damping", 0.9),
    )
