"""The table of joint values that snippets for simulators without configuration classes begin with."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from gapscope.envs.export.snippets.arm_values import SnippetArm
from gapscope.envs.export.snippets.target import finite

TABLE = """
JOINTS = {
{% for name, values in table.items() %}
    {{ name | quoted }}: {{ values | table(4) }},
{% endfor %}
}
{% if arm.ranges %}
RANGES = {
{% for name, ends in ends.items() %}
    {{ name | quoted }}: {{ ends | table(4) }},
{% endfor %}
}
{% endif %}


def values_of(name, rng=None):
    \"\"\"Values of a joint: those found{{ ", or each drawn evenly from its range" if arm.ranges else "" }}.\"\"\"
{% if arm.ranges %}
    if rng is not None:
        drawn = {key: rng.uniform(low, high) for key, (low, high) in RANGES.get(name, {}).items()}
        return {**JOINTS[name], **drawn}
{% endif %}
    return dict(JOINTS[name])
"""
"""Text of the table, in Jinja; ``rng`` is a generator of numpy."""


def table_values(arm: SnippetArm, names: Sequence[str]) -> Mapping[str, Any]:
    """What the table needs.

    Args:
        arm: the arm.
        names: of the values, each as ``JointValues`` has it.
    """
    ends: dict[str, dict[str, tuple[float, float]]] = {}
    for name in names:
        for joint, (low, high) in arm.ends(name).items():
            if low < high:
                ends.setdefault(joint, {})[name] = (low, high)
    rows = {j.name: finite({n: getattr(j, n) for n in names}) for j in arm.joints}
    return {"table": rows, "ends": ends}
