"""The table of joint values that snippets for simulators without configuration classes begin with."""

from __future__ import annotations

NAMES = """
{% set names = {
  "damping": "damping", "friction": "friction", "armature": "rotor", "spring_stiffness": "stiffness",
  "spring_rest": "rest", "effort": "effort", "kp": "kp", "kd": "kd", "torque_gain": "gain",
} %}
"""
"""Values of the table, in Jinja: what ``JointValues`` calls them by the name in the table."""
TABLE = """
JOINTS = {
{% for joint in joints %}
    {{ joint.name | quoted }}: {{ joint.table(names) | table(4) }},
{% endfor %}
}
{% if arm.ranges %}
RANGES = {
{% for joint, ends in arm.ranges_of(names).items() %}
    {{ joint | quoted }}: {{ ends | table(4) }},
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
