"""The controller's velocity filter, as ``arm.velocity_filter`` has it: roll-outs without an engine need it too."""

from arm.velocity_filter import (
    RULES,
    SETTLING,
    Gains,
    VelocityFilter,
    backward,
    bilinear,
    rule_of,
    semi_implicit,
    stable,
)

__all__ = [
    "RULES",
    "SETTLING",
    "Gains",
    "VelocityFilter",
    "backward",
    "bilinear",
    "rule_of",
    "semi_implicit",
    "stable",
]
