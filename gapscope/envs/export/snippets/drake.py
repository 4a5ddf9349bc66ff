"""Drake: damping, actuators with rotor and gear, and dry friction as a force element of a ``MultibodyPlant``."""

from __future__ import annotations

from gapscope.arm.nominal import FRICTION_SMOOTHING
from gapscope.envs.export.snippets.joint_table import NAMES, TABLE
from gapscope.envs.export.snippets.target import JOINTS, Target

TEMPLATE = (
    NAMES
    + """
from pydrake.multibody.tree import DoorHinge, DoorHingeConfig, PdControllerGains, RevoluteJoint

GEAR_RATIO = 1.0  # rotor inertia below is that of the joint side: with the true ratio N it is divided by N^2
MOTION_THRESHOLD = """
    + repr(FRICTION_SMOOTHING)
    + """  # rad/s: friction is F tanh(v / threshold)
"""
    + TABLE
    + """

def set_joints(plant{{ ", rng=None" if arm.ranges else "" }}):
    \"\"\"Set the arm's joints in a MultibodyPlant before Finalize(); those without an actuator get one.\"\"\"
    actuated = {plant.get_joint_actuator(i).joint().name(): i for i in plant.GetJointActuatorIndices()}
    for name in JOINTS:
        values = values_of(name{{ ", rng" if arm.ranges else "" }})
        joint = plant.GetJointByName(name)
        joint.set_default_damping(values["damping"])
        if name in actuated:
            actuator = plant.get_mutable_joint_actuator(actuated[name])
        else:
            actuator = plant.AddJointActuator(name, joint)
        gain = values["torque_gain"]  # torque at the joint over the commanded one
        if "effort" in values:
            actuator.set_effort_limit(gain * values["effort"])
        actuator.set_default_gear_ratio(GEAR_RATIO)
        actuator.set_default_rotor_inertia(values["armature"] / GEAR_RATIO**2)
        if values["kp"] > 0:
            actuator.set_controller_gains(PdControllerGains(p=gain * values["kp"], d=gain * values["kd"]))
        if isinstance(joint, RevoluteJoint) and (values["friction"] or values["spring_stiffness"]):
            config = DoorHingeConfig(
                dynamic_friction_torque=values["friction"],
                static_friction_torque=0.0,
                viscous_friction=0.0,
                spring_constant=values["spring_stiffness"],
                spring_zero_angle_rad=values["spring_rest"],
                catch_torque=0.0,
                catch_width=0.0,
                motion_threshold=MOTION_THRESHOLD,
            )
            plant.AddForceElement(DoorHinge(joint, config))
"""
)

DRAKE = Target(
    name="drake",
    title="Drake 1.51",
    template=TEMPLATE,
    held=JOINTS | {"scale", "stiffness", "rest"},
    hints={
        "scale": "as torque_gain, in gains and limits; multiply what you feed into the actuation port by it",
    },
    notes=(
        "MultibodyPlant reads no <dynamics friction> of a URDF; DoorHinge adds the law here, on revolute joints. It is "
        "steep: use a continuous plant (time_step=0), or raise MOTION_THRESHOLD until a discrete one is stable.",
        "PD gains need a discrete plant: with kp > 0 and time_step=0 leave them out and close the loop outside.",
        "A delay or lag goes between controller and plant: DiscreteTimeDelay, FirstOrderLowPassFilter of "
        "pydrake.systems.primitives.",
        "The gains are those of the case, without its feedforward, if its controller is a PD law, else none.",
    ),
)
"""The target."""
