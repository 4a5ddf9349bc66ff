"""Gazebo: the ``<dynamics>`` and ``<limit>`` of each joint, for a model of one's own in SDF."""

from __future__ import annotations

from gapscope.envs.export.snippets.target import JOINTS, Target

TEMPLATE = """
<joints>
{% for joint in joints %}
  <joint name="{{ joint.name | e }}"><axis>
    <limit>
{% if joint.applied_effort < inf %}
      <effort>{{ joint.applied_effort | number }}</effort>
{% endif %}
{% if joint.velocity < inf %}
      <velocity>{{ joint.velocity | number }}</velocity>
{% endif %}
    </limit>
    <dynamics>
      <damping>{{ joint.damping | number }}</damping>
      <friction>{{ joint.friction | number }}</friction>
      <spring_reference>{{ joint.rest | number }}</spring_reference>
      <spring_stiffness>{{ joint.stiffness | number }}</spring_stiffness>
    </dynamics>
  </axis></joint>
{% endfor %}
</joints>
"""

GAZEBO = Target(
    name="gazebo",
    title="Gazebo (SDF 1.12)",
    template=TEMPLATE,
    held=(JOINTS - {"rotor"}) | {"scale", "stiffness", "rest"},
    hints={
        "scale": "in the limits; multiply the efforts that you command by 1 + scale",
        "rotor": "SDF has no rotors; adding it about the axis to the inertia of the link that the joint moves "
        "is exact for that joint alone",
    },
    notes=(
        "Copy <limit> and <dynamics> into <axis> of your joints; positions limits stay yours. "
        "The whole arm is what gapscope export --format sdf writes.",
        "SDF has no ranges: write the model once for each draw.",
    ),
    model="sdf",
    comment="<!--",
    draws=False,
)
"""The target."""
