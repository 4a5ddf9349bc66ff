"""Base parameters of known arms against known counts, and the closed form of the regressor against pinocchio's.

    .venv/bin/python experiments/21_base_parameters.py [--states 300]

Counts are those of the inertial parameters alone, of random states within the arm's limits; *gap* is the smallest kept
over the largest dropped pivot. *With rotors* adds a column of rotor inertia per joint, *with friction* those of viscous
and Coulomb friction and offset too. Arms of which there are recordings are read from the folder GAPSCOPE_DATA.

Second table: the largest difference between the closed form and pinocchio over the largest entry, on random states of
chains with oblique placements and axes.
"""

from __future__ import annotations

import argparse
import os
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from symbolic_regressor import symbolic_regressor

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.nominal import NominalArm
from gapscope.arm.robots import load_nominal_arm
from gapscope.ident.model.base_parameters import structural_base
from gapscope.ident.model.regressor import JOINT_COLUMNS, Regressor

DATA = Path(
    os.environ.get("GAPSCOPE_DATA")
    or Path(__file__).resolve().parents[2] / "shared" / "data"
)
KNOWN = {
    "kuka_iiwa": "43-44",
    "franka_panda": "43",
    "xarm6": "-",
    "ur10": "36",
    "staubli_tx40": "-",
}
"""Known numbers of inertial base parameters, if there is one; that of the Panda by [gaz2019]."""
JOINT = """
  <joint name="j{i}" type="revolute"><parent link="l{before}"/><child link="l{i}"/>
    <origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="{axis}"/><limit lower="-3" upper="3" effort="9" velocity="3"/></joint>
  <link name="l{i}"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
  </link>"""


def load(name: str) -> NominalArm | None:
    """An arm by name, or of the recordings; ``None`` if these are absent."""
    if name in ("kuka_iiwa", "franka_panda", "xarm6"):
        return load_nominal_arm(name)
    urdf = next((DATA / name).glob("*.urdf"), None)
    return None if urdf is None else load_nominal_arm(urdf)


def counts(states: int) -> None:
    """Print the numbers of base parameters."""
    print("arm            links  known  found      gap  with rotors  with friction")
    for name, known in KNOWN.items():
        arm = load(name)
        if arm is None:
            print(f"{name:14} left out: no {name} in GAPSCOPE_DATA")
            continue
        inertial, rotors, everything = (
            structural_base(
                Regressor(arm, quantities=quantities), np.random.default_rng(0), states
            )
            for quantities in ((), ("rotor",), JOINT_COLUMNS)
        )
        print(
            f"{name:14} {arm.n_joints:5d} {known:>6} {inertial.count:6d} {inertial.gap:8.1e} {rotors.count:12d} "
            f"{everything.count:14d}"
        )


def chain(n: int, folder: Path, rng: np.random.Generator) -> NominalArm:
    """A chain of n joints, each placed, turned and pointing at random."""

    def text() -> str:
        return " ".join(repr(float(x)) for x in rng.uniform(-1, 1, 3))

    joints = [
        JOINT.format(i=i, before=i - 1, xyz=text(), rpy=text(), axis=text())
        for i in range(1, n + 1)
    ]
    urdf = folder / "chain.urdf"
    urdf.write_text(f'<robot name="chain"><link name="l0"/>{"".join(joints)}</robot>')
    return NominalArm(
        "chain",
        urdf,
        tuple(f"j{i}" for i in range(1, n + 1)),
        gravity=np.array([0.3, -0.2, -9.81]),
    )


def symbolic(states: int) -> None:
    """Print how far the closed form is from pinocchio's regressor."""
    print("\njoints  entries  derived in [s]  largest difference")
    for n in (1, 2, 3):
        rng = np.random.default_rng(n)
        with TemporaryDirectory() as folder:
            arm = chain(n, Path(folder), rng)
            begun = time.process_time()
            closed = symbolic_regressor(arm)
            taken = time.process_time() - begun
            state = rng.standard_normal((3, states, n))
            numeric = RigidBody(arm).regressor(*state)
            off = (
                np.abs(closed.evaluate(*state) - numeric).max() / np.abs(numeric).max()
            )
        filled = sum(entry != 0 for entry in closed.matrix)
        print(f"{n:6d} {filled:8d} {taken:15.1f} {off:19.1e}", flush=True)


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--states", type=int, default=300, help="random states of each arm"
    )
    states = parser.parse_args().states
    counts(states)
    symbolic(states)


if __name__ == "__main__":
    main()
