"""The simulators for which snippets are written, and the file with one."""

from __future__ import annotations

from pathlib import Path

from gapscope.arm.controller import Controller
from gapscope.arm.errors import InputError
from gapscope.arm.io.atomic_write import atomic_write
from gapscope.envs.effect_ranges import EffectRanges, write_effect_ranges
from gapscope.envs.export.plain_arm import PlainArm
from gapscope.envs.export.snippets.arm_values import snippet_arm
from gapscope.envs.export.snippets.drake import DRAKE
from gapscope.envs.export.snippets.gazebo import GAZEBO
from gapscope.envs.export.snippets.genesis import GENESIS
from gapscope.envs.export.snippets.isaac_lab import ISAAC_LAB
from gapscope.envs.export.snippets.mjlab import MJLAB
from gapscope.envs.export.snippets.newton import NEWTON
from gapscope.envs.export.snippets.playground import PLAYGROUND
from gapscope.envs.export.snippets.ros2_control import ROS2_CONTROL
from gapscope.envs.export.snippets.target import Target

ENVIRONMENT = Target(
    name="environment",
    title="the environment gapscope/ArmTracking-v0",
    template="",
    held=frozenset(),
    model="",
    needs_ranges=True,
)
"""The ranges of the effects themselves, for ``randomisation=`` of the package's own environment."""
HEAD = (
    "# Effects between two ends, drawn at every reset, written by gapscope export; SI units, joint side.\n"
    "# For gapscope/ArmTracking-v0: randomisation=gapscope.envs.effect_ranges.read_effect_ranges(FILE), no effects=.\n"
)
"""Comment of their file."""
TARGETS = {
    target.name: target
    for target in (
        *(ISAAC_LAB, MJLAB, NEWTON, GENESIS, DRAKE, GAZEBO, ROS2_CONTROL),
        *(PLAYGROUND, ENVIRONMENT),
    )
}
"""Targets by the name of their format."""


def write_snippet(
    plain: PlainArm,
    form: str,
    out: Path,
    controller: Controller | None,
    ranges: EffectRanges | None,
) -> tuple[str, ...]:
    """Write the snippet of an arm for a simulator; ``out`` never holds half of it.

    Args:
        plain: the arm.
        form: one of ``TARGETS``.
        out: the file.
        controller: that of the case, or ``None``.
        ranges: to be drawn from, or ``None``.

    Returns:
        What it leaves out, a sentence each.

    Raises:
        InputError: ranges are missing, or the simulator has no words for them.
        GapscopeError: the file cannot be written.
    """
    target = TARGETS[form]
    if ranges is None and target.needs_ranges:
        raise InputError(
            f"{form} holds ranges alone",
            "add --randomise, with diagnosis.json beside corrected.yaml",
            where="--format",
        )
    if ranges is not None and not target.draws:
        raise InputError(
            f"{form} has no words for ranges",
            f"leave it out, or choose one of {', '.join(drawing())}",
            where="--randomise",
        )
    if ranges is not None and target is ENVIRONMENT:
        write_effect_ranges(ranges, out, HEAD)
        return ()
    arm = snippet_arm(plain, controller, ranges)
    with atomic_write(out) as aside:
        aside.write_text(target.text(arm), encoding="utf-8")
    return target.left_out(arm)


def drawing() -> tuple[str, ...]:
    """Names of the targets that hold ranges."""
    return tuple(name for name, target in TARGETS.items() if target.draws)
