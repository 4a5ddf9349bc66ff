"""ros2_control: gains, limits and feedforward of a joint trajectory controller that commands effort."""

from __future__ import annotations

from gapscope.envs.export.snippets.target import JOINTS, Target

TEMPLATE = """
joint_trajectory_controller:
  ros__parameters:
    joints: [{{ joints | map(attribute="name") | map("quoted") | join(", ") }}]
    command_interfaces: [effort]
    state_interfaces: [position, velocity]
    gains:
{% for joint in joints %}
      {{ joint.name | quoted }}:
        p: {{ joint.kp | number }}
        d: {{ joint.kd | number }}
        ff_velocity_scale: {{ (joint.damping / joint.gain) | number }}  # N m s/rad: viscous friction
{% if joint.effort < inf %}
        u_clamp_max: {{ joint.effort | number }}
        u_clamp_min: {{ (-joint.effort) | number }}
{% endif %}
{% endfor %}

# What to add to effort of each point of a trajectory, at its velocity v and acceleration a, beside gravity and inertia:
#   effort = (armature * a + friction * tanh(v / 0.005) + spring_stiffness * (q - spring_rest) - torque_offset)
#            / torque_gain
{% for joint in joints %}
# {{ joint.name }}: armature {{ joint.rotor | number }}, friction {{ joint.friction | number }}, spring_stiffness {{
joint.stiffness | number }}, spring_rest {{
(joint.rest - joint.zero) | number }}, torque_offset {{
joint.offset | number }}, torque_gain {{ joint.gain | number }}
{% endfor %}
{% if joints | selectattr("zero") | list %}

# <offset> of the <joint> in a SimpleTransmission, by which encoders that read too much are corrected. Not with the URDF
# of gapscope export, whose joints are at what the encoders read:
{% for joint in joints if joint.zero %}
# {{ joint.name }}: {{ (-joint.zero) | number }} rad
{% endfor %}
{% endif %}
"""

ROS2_CONTROL = Target(
    name="ros2_control",
    title="ros2_control (joint_trajectory_controller of ROS 2 Kilted)",
    template=TEMPLATE,
    held=JOINTS | {"scale", "offset", "stiffness", "rest", "zero"},
    hints={
        "load": "in the file of gapscope export --format urdf, from which gravity and inertia are computed",
        "zero": "as the offset of a transmission, or by the URDF of gapscope export; not by both",
        "delay": "bounds the bandwidth: nothing in a controller undoes it",
        "lag": "bounds the bandwidth: nothing in a controller undoes it",
    },
    notes=(
        "This compensates on the real arm what a simulator would add. Start with half of friction and "
        "ff_velocity_scale: friction that is compensated in full can drive a joint into a limit cycle.",
        "Newer versions add effort of a trajectory point to the command if effort is the only command interface; those "
        "of ROS 2 Humble do not, and have no u_clamp_max.",
        "Keep integral gain small: it and compensated dry friction hunt about the target.",
    ),
    draws=False,
)
"""The target."""
