"""Friction and inertia of one joint by ``mujoco.sysid``; runs in its own environment, apart from the project.

    PYTHON experiments/benchmarks/children/sysid_joint.py RECORDING.npz default|stiff

The recorded torque is rolled out from the recorded start, and the position compared, with the package's own residual,
optimiser and intervals. Free are the rotor's inertia, viscous and dry friction, the place of the centre of mass across
and along the link, and a constant torque, as in a fit of base parameters. Printed as JSON: values and half widths of
95 % intervals, with the inertia about the axis, which is what a motion tells; processor time [s]. MuJoCo's dry friction
is a soft constraint: *stiff* has it closer to Coulomb's law than the default.
"""

from __future__ import annotations

import json
import sys
import time

import mujoco
import numpy as np
from mujoco import sysid

XML = """
<mujoco>
  <option timestep="{step}" integrator="implicitfast"><flag contact="disable" limit="disable"/></option>
  <worldbody>
    <body name="bob">
      <inertial pos="0 0 {lever}" mass="{mass}" diaginertia="{across} {across} {along}"/>
      <joint name="joint" type="hinge" axis="0 1 0" {friction}/>
    </body>
  </worldbody>
  <actuator>
    <general name="motor" joint="joint" gainprm="1 0 0" biastype="affine" biasprm="0 0 0"/>
  </actuator>
  <sensor><jointpos name="position" joint="joint"/></sensor>
</mujoco>
"""

FRICTION = {
    "default": "",
    "stiff": 'solreffriction="0.002 1" solimpfriction="0.99 0.999 0.001"',
}
"""The constraint of dry friction: its time constant [s], damping ratio and impedance."""


def set_rotor(spec: mujoco.MjSpec, value: sysid.Parameter) -> None:
    """Inertia of the rotor [kg m^2]."""
    spec.joint("joint").armature = value.value[0]


def set_viscous(spec: mujoco.MjSpec, value: sysid.Parameter) -> None:
    """Viscous friction [N m s/rad]."""
    damping = spec.joint("joint").damping
    if np.ndim(damping):
        damping[0] = value.value[0]
    else:
        spec.joint("joint").damping = value.value[0]


def set_coulomb(spec: mujoco.MjSpec, value: sysid.Parameter) -> None:
    """Dry friction [N m]."""
    spec.joint("joint").frictionloss = value.value[0]


def set_centre(spec: mujoco.MjSpec, value: sysid.Parameter) -> None:
    """Centre of mass across and along the link [m]."""
    spec.body("bob").ipos = [value.value[0], 0.0, value.value[1]]


def set_offset(spec: mujoco.MjSpec, value: sysid.Parameter) -> None:
    """Torque that is commanded and not felt [N m]."""
    spec.actuator("motor").biasprm[0] = -value.value[0]


def parameters(lever: float) -> sysid.ParameterDict:
    """What is free, from values of a data sheet that knows no friction."""
    found = sysid.ParameterDict()
    for name, start, low, high, modifier in (
        ("rotor", 0.02, 0.0, 1.0, set_rotor),
        ("viscous", 0.1, 0.0, 5.0, set_viscous),
        ("coulomb", 0.1, 0.0, 5.0, set_coulomb),
        ("centre", [0.0, lever], [-0.1, lever - 0.1], [0.1, lever + 0.1], set_centre),
        ("offset", 0.0, -2.0, 2.0, set_offset),
    ):
        found.add(sysid.Parameter(name, start, low, high, modifier=modifier))
    return found


def main() -> None:
    """Fit and print."""
    data = np.load(sys.argv[1])
    mass, lever, across = (float(data[key]) for key in ("mass", "lever", "across"))
    step = float(data["t"][1] - data["t"][0])
    spec = mujoco.MjSpec.from_string(
        XML.format(
            step=step,
            friction=FRICTION[sys.argv[2]],
            mass=mass,
            lever=-lever,
            across=across,
            along=across / 10,
        )
    )
    model = spec.compile()
    start = sysid.create_initial_state(model, data["q"][:1], np.zeros(1))
    control = sysid.TimeSeries(data["t"], data["tau"][:, None])
    # a roll-out's first sample is that after its first step
    position = sysid.TimeSeries.from_names(data["t"][1:], data["q"][1:, None], model)
    sequence = sysid.ModelSequences(
        "pendulum", spec, "recording", start, control, position
    )
    residual = sysid.build_residual_fn(models_sequences=[sequence], n_threads=1)
    begun = time.process_time()
    found, result = sysid.optimize(parameters(-lever), residual, verbose=False)
    errors, _, _ = residual(result.x, found)
    covariance, half = sysid.calculate_intervals(errors, np.asarray(result.jac))
    seconds = time.process_time() - begun
    rotor, viscous, coulomb, x, z, _ = (float(value) for value in result.x)
    # the quantile that the package uses, for what follows from several parameters
    quantile = half[0] / np.sqrt(covariance[0, 0])
    gradient = np.array([1.0, 0.0, 0.0, 2 * mass * x, 2 * mass * z, 0.0])
    inertia = across + mass * (x**2 + z**2) + rotor
    values = {"inertia": inertia, "viscous": viscous, "coulomb": coulomb}
    spread = quantile * np.sqrt(gradient @ covariance @ gradient)
    halves = {
        "inertia": float(spread),
        "viscous": float(half[1]),
        "coulomb": float(half[2]),
    }
    print(json.dumps({"cpu": seconds, "values": values, "half": halves}))


if __name__ == "__main__":
    main()
