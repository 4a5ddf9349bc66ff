"""Snippets of ``gapscope export`` in the simulators themselves, and their names in the simulators' own sources.

    .venv/bin/python experiments/41_snippets.py write --out out/snippets
    python experiments/41_snippets.py torque drake --out out/snippets
    python experiments/41_snippets.py names isaac_lab --source FOLDER --out out/snippets

``write`` exports a KUKA iiwa with a payload, a tilted base, friction, rotors, a parallel spring and encoder offsets,
and the torque that it needs at random states. The other two need no Gapscope and run in any Python. ``torque`` runs in
one with numpy and the simulator (drake, newton with its extra sim, or mjlab), which loads the exported arm and the
snippet and is asked for the inverse dynamics at these states; printed is the largest difference. Dry friction is a
constraint in MuJoCo, of which mjlab and Newton's solver are made, so its full size is added there. In Newton a command
is also sent through the actuators, and the step at which it arrives is printed, with its size. ``names`` looks up
every method, every keyword and every parameter of an event in the classes and functions of an unpacked wheel or a
checkout, and prints what is missing.
The same formula is on both sides: this checks units, signs and names, no accuracy.
"""

from __future__ import annotations

import argparse
import ast
import importlib
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

FORMATS = ("isaac_lab", "mjlab", "newton", "genesis", "drake")
STATES = 50
"""Random states of the arm."""
SMOOTHING = 0.005
"""Velocity scale of dry friction tanh(v / v0) [rad/s]."""
Torque = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]


def write(out: Path) -> None:
    """The arm, its snippets with and without ranges, and the torque that it needs."""
    from gapscope.arm.control import PD
    from gapscope.arm.dynamics.rigid_body import RigidBody
    from gapscope.arm.motions.motion import Motion
    from gapscope.arm.robots import load_nominal_arm
    from gapscope.effects.applied import AppliedEffect as Effect
    from gapscope.effects.corrected import CorrectedArm
    from gapscope.envs.effect_ranges import effect_range, within_nominal
    from gapscope.envs.export.formats import export

    effects = (
        Effect("payload", (), {"mass": 1.3, "com": [0.02, -0.01, 0.05]}),
        Effect("base_tilt", (), {"roll": 0.1, "pitch": -0.2}),
        Effect("coulomb_friction", (2, 4), {"torque": [4.0, 1.0]}),
        Effect("viscous_friction", (1, 2), {"coefficient": [2.0, 3.0]}),
        Effect("armature", (1, 2), {"inertia": [0.4, 0.3]}),
        Effect("parallel_spring", (2,), {"stiffness": [12.0], "rest": [0.3]}),
        Effect("encoder_offset", (2, 4), {"offset": [0.05, -0.03]}),
        Effect("actuator_delay", (4,), {"delay": [0.0088]}),
        Effect("torque_scale", (3,), {"scale": [0.2]}),
        Effect("torque_offset", (5,), {"torque": [0.7]}),
        Effect("torque_saturation", (6,), {"limit": [20.0]}),
    )
    arm = CorrectedArm(load_nominal_arm("kuka_iiwa"), effects)
    out.mkdir(parents=True, exist_ok=True)
    export(arm, "urdf", out / "arm.urdf")
    export(arm, "mjcf", out / "arm.xml")
    tenth = [
        effect_range(e, {k: 0.1 * abs(v) for k, v in e.parameters.items()})
        for e in effects
    ]
    ranges = within_nominal(tenth, arm.arm)
    n = arm.arm.n_joints
    pd = PD(rate=500.0, kp=np.full(n, 100.0), kd=np.full(n, 10.0))
    for form in FORMATS:
        export(arm, form, out / f"on_{form}.py", controller=pd)
        file = out / f"drawn_on_{form}.py"
        export(arm, form, file, controller=pd, ranges=ranges)
    rng = np.random.default_rng(0)
    motion = Motion(
        np.arange(STATES) / 250,
        rng.uniform(-1.5, 1.5, (STATES, n)),
        rng.normal(size=(STATES, n)),
        3 * rng.normal(size=(STATES, n)),
    )
    torque = arm.needed_torque(arm.rigid_torque(RigidBody(arm.arm), motion), motion)
    states = {"q": motion.q, "dq": motion.dq, "ddq": motion.ddq, "torque": torque}
    gravity = np.linalg.norm(arm.arm.gravity)
    np.savez(out / "states.npz", gravity=gravity, joints=arm.arm.joints, **states)


def without_shapes(out: Path) -> Path:
    """The URDF without shapes, whose meshes not every simulator reads."""
    text = (out / "arm.urdf").read_text(encoding="utf-8")
    bare = out / "bare.urdf"
    bare.write_text(re.sub(r"<(visual|collision)\b.*?</\1>", "", text, flags=re.S))
    return bare


def drake(out: Path, states: Any) -> Torque:
    """Inverse dynamics of Drake's plant with the snippet."""
    from pydrake.multibody.parsing import Parser
    from pydrake.multibody.plant import MultibodyPlant
    from pydrake.multibody.tree import MultibodyForces

    plant = MultibodyPlant(0.0)
    Parser(plant).AddModels(str(without_shapes(out)))
    importlib.import_module("on_drake").set_joints(plant)
    field = plant.mutable_gravity_field()
    field.set_gravity_vector([0.0, 0.0, -float(states["gravity"])])
    plant.Finalize()
    context = plant.CreateDefaultContext()
    names = [str(name) for name in states["joints"]]
    at = [plant.GetJointByName(name).velocity_start() for name in names]

    def torque(q: np.ndarray, dq: np.ndarray, ddq: np.ndarray) -> np.ndarray:
        full = np.zeros((3, plant.num_velocities()))
        full[:, at] = q, dq, ddq
        plant.SetPositions(context, full[0])
        plant.SetVelocities(context, full[1])
        forces = MultibodyForces(plant)
        plant.CalcForceElementsContribution(context, forces)
        return plant.CalcInverseDynamics(context, full[2], forces)[at]

    return torque


def newton(out: Path, states: Any) -> Torque:
    """Inverse dynamics of the MuJoCo model that Newton's solver makes of the snippet."""
    import newton

    builder = newton.ModelBuilder()
    builder.add_urdf(str(without_shapes(out)), floating=False)
    importlib.import_module("on_newton").add_actuators(builder)
    model = builder.finalize(device="cpu")
    arrivals(model, [label.rsplit("/", 1)[-1] for label in builder.joint_label[-7:]])
    solver = newton.solvers.SolverMuJoCo(model, use_mujoco_cpu=True)
    return of_mujoco(solver.mj_model)


def arrivals(model: Any, names: list[str]) -> None:
    """Print what reaches the joints of a model in Newton when each is sent 1 rad away, and after how many steps."""
    state, control = model.state(), model.control()
    buffers = [(a, a.state(), a.state()) for a in model.actuators]
    efforts = []
    for step in range(10):
        control.joint_target_q.assign(np.full(len(names), float(step > 0), np.float32))
        control.joint_f.zero_()
        for i, (actuator, now, after) in enumerate(buffers):
            actuator.step(state, control, now, after, dt=0.002)
            buffers[i] = (actuator, after, now)
        efforts.append(control.joint_f.numpy().copy())
    changed = np.argmax(np.array(efforts) != efforts[0], axis=0) - 1
    for name, steps, effort in zip(names, changed, efforts[-1], strict=True):
        print(f"  {name}: {effort:.4g} N m after {steps} steps")


def mjlab(out: Path, states: Any) -> Torque:
    """Inverse dynamics of the MuJoCo model that mjlab makes of the exported file and the snippet."""
    import mujoco
    from mjlab.entity import Entity, EntityCfg
    from mjlab.entity.entity import EntityArticulationInfoCfg

    def spec() -> Any:
        found = mujoco.MjSpec.from_file(str(out / "arm.xml"))
        for actuator in list(found.actuators):
            found.delete(actuator)
        return found

    actuators = importlib.import_module("on_mjlab").ACTUATORS
    articulation = EntityArticulationInfoCfg(actuators=actuators)
    entity = Entity(EntityCfg(spec_fn=spec, articulation=articulation))
    return of_mujoco(entity.spec.compile())


def of_mujoco(model: Any) -> Torque:
    """Inverse dynamics of a MuJoCo model, dry friction in full, without limits and contacts."""
    import mujoco

    bits = mujoco.mjtDisableBit
    model.opt.disableflags |= bits.mjDSBL_CONTACT | bits.mjDSBL_LIMIT
    dry = np.array(model.dof_frictionloss)
    model.dof_frictionloss[:] = 0.0
    data = mujoco.MjData(model)

    def torque(q: np.ndarray, dq: np.ndarray, ddq: np.ndarray) -> np.ndarray:
        data.qpos[:], data.qvel[:], data.qacc[:] = q, dq, ddq
        mujoco.mj_inverse(model, data)
        return data.qfrc_inverse + dry * np.tanh(dq / SMOOTHING)

    return torque


METHODS = ""
"""Under which the names of all functions are looked up."""
SIMULATORS = {"drake": drake, "newton": newton, "mjlab": mjlab}


def compare(simulator: str, out: Path) -> None:
    """Print the largest difference of torque."""
    sys.path.insert(0, str(out))
    states = np.load(out / "states.npz")
    torque = SIMULATORS[simulator](out, states)
    rows = zip(states["q"], states["dq"], states["ddq"], strict=True)
    found = np.array([torque(*row) for row in rows])
    worst = np.abs(found - states["torque"]).max()
    most = np.abs(states["torque"]).max()
    print(f"{simulator}: largest difference {worst:.2g} N m of {most:.3g} N m")


def definitions(source: Path) -> dict[str, set[str]]:
    """Names that a class or function of a source tree takes, fields of its bases included; overloads together."""
    known = {}
    bases = {}
    for file in (*source.rglob("*.py"), *source.rglob("*.pyi")):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.FunctionDef):
                known.setdefault(node.name, set()).update(parameters(node))
            if isinstance(node, ast.ClassDef):
                names = known.setdefault(node.name, set())
                bases.setdefault(node.name, set()).update(map(ast.unparse, node.bases))
                for part in node.body:
                    if isinstance(part, ast.AnnAssign):
                        names.add(ast.unparse(part.target))
                    if isinstance(part, ast.FunctionDef):
                        names.update(parameters(part) | {part.name})

    def inherited(name: str, seen: frozenset[str] = frozenset()) -> set[str]:
        found = set(known.get(name, set()))
        for base in bases.get(name, set()):
            short = base.split("[")[0].split(".")[-1]
            if short not in seen:
                found |= inherited(short, seen | {name})
        return found

    return {name: inherited(name) for name in known}


def parameters(function: ast.FunctionDef) -> set[str]:
    """Names of a function's parameters."""
    return {a.arg for a in (*function.args.args, *function.args.kwonlyargs)}


def look_up(form: str, source: Path, out: Path) -> None:
    """Print names of a snippet that its simulator's sources do not define."""
    known, missing, count = definitions(source), [], 0
    known[METHODS] = set(known)
    text = (out / f"drawn_on_{form}.py").read_text(encoding="utf-8")
    tree = ast.parse(text)
    own = {n.name for n in ast.walk(tree) if isinstance(n, ast.FunctionDef)}
    for node in ast.walk(tree):
        if not isinstance(node, ast.Call) or ast.unparse(node.func) in own:
            continue
        called = ast.unparse(node.func).split(".")[-1]
        # what a function passes on belongs to the class that it is given
        takers = [called, *(a.id for a in node.args if isinstance(a, ast.Name))]
        given = {k.arg: k.value for k in node.keywords if k.arg}
        wanted = [(takers, name) for name in given]
        if ast.unparse(node.func).split(".")[0] in ("robot", "plant", "actuator"):
            wanted.append(([METHODS], called))
        if "func" in given and isinstance(given.get("params"), ast.Dict):
            term = ast.unparse(given["func"]).split(".")[-1]
            keys = (ast.literal_eval(key) for key in given["params"].keys if key)
            wanted += [([term], key) for key in keys]
        count += len(wanted)
        for owners, name in wanted:
            if not any(name in known.get(owner, set()) for owner in owners):
                missing.append((owners[0], name))
    print(f"{form}: {count} names looked up; missing: {sorted(set(missing)) or 'none'}")


def main() -> None:
    """Run one of the three."""
    parser = argparse.ArgumentParser(description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    commands.add_parser("write")
    commands.add_parser("torque").add_argument("simulator", choices=SIMULATORS)
    names = commands.add_parser("names")
    names.add_argument("form", choices=FORMATS)
    names.add_argument("--source", type=Path, required=True)
    for command in commands.choices.values():
        command.add_argument("--out", type=Path, required=True)
    given = parser.parse_args()
    if given.command == "write":
        write(given.out)
    elif given.command == "torque":
        compare(given.simulator, given.out)
    else:
        look_up(given.form, given.source, given.out)


if __name__ == "__main__":
    main()
