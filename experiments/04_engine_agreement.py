"""How far the engines differ on the same case: RMSE between joint positions over 10 s of a tracked Fourier motion.

One table with effects off and on, for steps of 1 ms and 0.5 ms, each engine against PyBullet; and PyBullet at these
steps against itself at 0.125 ms, which is what the step size alone explains. The controller ticks at 1 kHz throughout.
A second table, of free swing: the arm without effects, friction and joint limits hangs, is let go and swings for 10 s;
how far the total energy strays, and what it has gained at the end, over the greatest kinetic energy.
"""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pinocchio as pin

from gapscope.arm.dynamics.feedforward import feedforward
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.motions.trajectory import Fourier, urdf_limits
from gapscope.arm.nominal import NominalArm
from gapscope.effects.applied import AppliedEffect
from gapscope.envs.engines import ENGINES, installed
from gapscope.envs.mystery_arm import POSTURE, iiwa
from gapscope.envs.position_controller import position_controller
from gapscope.envs.simulated_arm import SimulatedArm

DURATION, RATE = 10.0, 1000.0
SWING = np.array([0.075, 0.1, 0.05, -0.125, 0.025, 0.1, 0.0])
"""Where the hanging arm is let go [rad]; from twice as far it swings chaotically."""
CASES: dict[str, tuple[AppliedEffect, ...]] = {
    "none": (),
    "Stribeck and load friction, joints 2 and 4": (
        AppliedEffect(
            "stribeck_friction", (2, 4), {"torque": [2.0, 1.5], "velocity": [0.1, 0.1]}
        ),
        AppliedEffect("load_friction", (2, 4), {"coefficient": [0.15, 0.1]}),
    ),
    "payload 2 kg, base tilt 3 deg": (
        AppliedEffect("payload", (), {"mass": 2.0, "com": [0.03, -0.02, 0.08]}),
        AppliedEffect("base_tilt", (), {"roll": 0.05, "pitch": -0.03}),
    ),
    "delay 8 ms and lag 10 ms, joints 1 and 4": (
        AppliedEffect("actuator_delay", (1, 4), {"delay": [0.008, 0.008]}),
        AppliedEffect("actuator_lag", (1, 4), {"time_constant": [0.01, 0.01]}),
    ),
    "elasticity 1e4 N m/rad, joint 2": (
        AppliedEffect(
            "joint_elasticity", (2,), {"stiffness": [1e4], "damping": [20.0]}
        ),
    ),
    "backlash 0.3 deg, joint 4": (AppliedEffect("backlash", (4,), {"width": [0.005]}),),
}


def follow(
    arm: NominalArm,
    effects: tuple[AppliedEffect, ...],
    engine: str,
    parts: int,
    duration: float = DURATION,
) -> np.ndarray:
    """True positions [rad] at every tick of the controller, shape (N, n), with ``parts`` steps per tick."""
    limits = urdf_limits(RigidBody(arm), 5.0)._replace(
        velocity=np.full(arm.n_joints, 1.2)
    )
    motion = Fourier.random(
        np.random.default_rng(1),
        limits,
        duration=DURATION,
        centre=POSTURE,
        frequency=0.15,
    )
    t = np.arange(0.0, duration, 1.0 / RATE)
    q, dq, ddq = motion.position(t), motion.velocity(t), motion.acceleration(t)
    torque = feedforward(arm, RigidBody(arm), "nominal", q, dq, ddq)
    controller = position_controller(arm, POSTURE)
    out = np.empty_like(q)
    with SimulatedArm(arm, effects, 1.0 / RATE / parts, engine=engine) as simulated:
        simulated.start(q[0], dq[0])
        last = simulated.encoders()
        for i in range(len(t)):
            seen, out[i] = simulated.encoders(), simulated.q
            velocity, last = (seen - last) * RATE, seen
            simulated.step(
                torque[i]
                + controller.kp * (q[i] - seen)
                + controller.kd * (dq[i] - velocity),
                parts,
            )
    return out


def rmse(first: np.ndarray, second: np.ndarray) -> float:
    """Largest RMSE of a joint [rad]."""
    return float(np.sqrt(np.mean((first - second) ** 2, axis=0)).max())


def hanging_arm(folder: Path) -> NominalArm:
    """A bare KUKA iiwa upside down, whose joints have no limits."""
    arm = iiwa()
    file = folder / "free.urdf"
    file.write_text(
        arm.urdf.read_text().replace('type="revolute"', 'type="continuous"')
    )
    return NominalArm("free", file, arm.joints, gravity=np.array([0.0, 0.0, 9.81]))


def swing(arm: NominalArm, engine: str, dt: float) -> tuple[float, float]:
    """Range of the total energy in free swing and its gain at the end, over the greatest kinetic energy [1]."""
    kinetic, total = np.empty((2, round(DURATION / dt)))
    with SimulatedArm(arm, (), dt, engine=engine) as simulated:
        simulated.reset(SWING)
        model = simulated.body.model
        data = model.createData()
        for i in range(len(total)):
            q, dq = simulated.q, simulated.dq
            kinetic[i] = pin.computeKineticEnergy(model, data, q, dq)
            total[i] = kinetic[i] + pin.computePotentialEnergy(model, data, q)
            simulated.step(np.zeros(arm.n_joints))
    return float(np.ptp(total) / kinetic.max()), float(
        (total[-1] - total[0]) / kinetic.max()
    )


def print_agreement() -> None:
    """Print the table of the engines against each other."""
    arm = iiwa()
    others = [name for name in ENGINES if name != "pybullet" and installed(name)]
    print(
        "largest RMSE of a joint [rad]".ljust(46),
        *(f"{name:>20}" for name in others),
        f"{'step size alone':>20}",
    )
    for label, effects in CASES.items():
        fine = follow(arm, effects, "pybullet", 8)
        for parts in (1, 2):
            base = follow(arm, effects, "pybullet", parts)
            row = [rmse(base, follow(arm, effects, name, parts)) for name in others] + [
                rmse(base, fine)
            ]
            print(
                f"{label:42} {1 / parts:3g}",
                *(f"{value:20.2e}" for value in row),
                flush=True,
            )


def print_swing() -> None:
    """Print the table of free swing."""
    print(
        "\nfree swing of 10 s".ljust(20),
        f"{'step [ms]':>10}{'range':>10}{'at the end':>12}",
    )
    with TemporaryDirectory() as folder:
        arm = hanging_arm(Path(folder))
        for engine in filter(installed, ENGINES):
            for dt in (1e-3, 5e-4, 2.5e-4):
                strays, gained = swing(arm, engine, dt)
                print(
                    f"{engine:19} {1e3 * dt:10g}{strays:10.3%}{gained:12.3%}",
                    flush=True,
                )


def main() -> None:
    """Print both tables."""
    print_agreement()
    print_swing()


if __name__ == "__main__":
    main()
