"""Base parameters of known arms against known counts, and the closed form of the regressor against pinocchio's.

    .venv/bin/python experiments/21_base_parameters.py [--states 300]

Counts are those of the inertial parameters alone, of random states within the arm's limits; *gap* is the smallest kept
over the largest dropped pivot. *With rotors* adds a column of rotor inertia per joint, *with friction* those of viscous
and Coulomb friction and offset too. Arms of which there are recordings are read from the folder GAPSCOPE_DATA.

Second table: the largest difference between the closed form and pinocchio over the largest entry, on random states of
chains with oblique placements and axes.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np
import sympy as sp
from common import DATA, command_line
from pinocchio import SE3

from gapscope.arm.dynamics.description import (
    SINGLE,
    Joint,
    read_description,
)
from gapscope.arm.dynamics.rigid_body import INERTIAL_PARAMETERS, RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.nominal import NominalArm
from gapscope.arm.robots import load_nominal_arm
from gapscope.ident.model.base_parameters import structural_base
from gapscope.ident.model.regressor import JOINT_COLUMNS, Regressor

# The regressor in closed form

MAX_JOINTS = 3
"""Expressions of longer arms fill pages and take minutes."""
_EXACT = 1e-15


class SymbolicRegressor(NamedTuple):
    """Y(q, dq, ddq) in closed form, tau = Y pi, of an arm of n joints.

    pi stacks the links' inertial parameters in joint order and in the order of
    ``gapscope.arm.dynamics.rigid_body.INERTIAL_PARAMETERS``.

    Attributes:
        matrix: Y, shape (n, 10 n), of the symbols below.
        q, dq, ddq: symbols of position [rad or m], velocity and acceleration of the joints, n each.
        names: of the columns, ``m1``, ``mx1``, ...
    """

    matrix: sp.Matrix
    q: tuple[sp.Symbol, ...]
    dq: tuple[sp.Symbol, ...]
    ddq: tuple[sp.Symbol, ...]
    names: tuple[str, ...]

    def evaluate(self, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray) -> np.ndarray:
        """Y of N samples, shape (N, n, 10 n); q [rad], dq [rad/s], ddq [rad/s^2] of shape (N, n)."""
        filled = np.argwhere(np.array(self.matrix) != 0)
        entries = [self.matrix[place] for place in map(tuple, filled)]
        symbols = [*self.q, *self.dq, *self.ddq]
        function = sp.lambdify(symbols, entries, modules="numpy", cse=True)
        out = np.zeros((len(q), *self.matrix.shape))
        values = function(*q.T, *dq.T, *ddq.T)
        for (row, column), value in zip(filled, values, strict=True):
            out[:, row, column] = value
        return out


def symbolic_regressor(arm: NominalArm) -> SymbolicRegressor:
    """Derive the regressor of an arm of up to ``MAX_JOINTS`` revolute or prismatic joints by Lagrange's equation.

    Kinetic and potential energy of a link are linear in its inertial parameters,
    T = m v.v / 2 + v.(w x s) + w.J w / 2 and U = -g.(m p + R s), with the velocity v and rate w of its joint's frame,
    the frame's place p and orientation R, first moment s and inertia J about its origin. The column of a parameter is
    d/dt dL/d(dq) - dL/dq of its share of L = T - U. The way there shares nothing with pinocchio's recursion.

    Joints of the file that the arm does not name are held at zero.

    Raises:
        InputError: more joints than that, or a joint of another type.

    Source: siciliano2009.
    """
    n = arm.n_joints
    if n > MAX_JOINTS:
        raise InputError(
            f"a closed form is derived for up to {MAX_JOINTS} joints, the arm has {n}",
            "name up to three of them in joints:, or use gapscope.ident.model.regressor",
        )
    q, dq, ddq = (
        sp.symbols(f"{name}1:{n + 1}", real=True) for name in ("q", "dq", "ddq")
    )
    description = read_description(arm.urdf, shapes=False)
    joints = {joint.name: joint for joint in description.joints}
    columns = []
    for name in arm.joints:
        chain = [*description.upwards(joints[name].child)][::-1]
        for kinetic, potential in _energies(arm, chain, q, dq):
            momenta = [sp.diff(kinetic, rate) for rate in dq]
            rows = []
            for i, p in enumerate(momenta):
                row = sp.diff(potential - kinetic, q[i])
                for x, v, a in zip(q, dq, ddq, strict=True):
                    row += sp.diff(p, v) * a + sp.diff(p, x) * v
                rows.append(row)
            columns.append(sp.Matrix(rows))
    links = range(1, n + 1)
    names = tuple(f"{name}{link}" for link in links for name in INERTIAL_PARAMETERS)
    return SymbolicRegressor(sp.Matrix.hstack(*columns), q, dq, ddq, names)


def _energies(
    arm: NominalArm,
    chain: list[Joint],
    q: tuple[sp.Symbol, ...],
    dq: tuple[sp.Symbol, ...],
) -> Iterator[tuple[sp.Expr, sp.Expr]]:
    """Kinetic and potential energy per unit of each of a link's ten parameters; ``chain`` leads to it from the root."""
    place, turn = sp.zeros(3, 1), sp.eye(3)
    v, w, still = sp.zeros(3, 1), sp.zeros(3, 1), SE3.Identity()
    for joint in chain:
        still = still * joint.place
        if joint.name not in arm.joints:
            continue
        if joint.kind not in SINGLE:
            raise InputError(
                f"joint {joint.name} is {joint.kind}",
                "name revolute or prismatic joints",
                file=arm.urdf,
            )
        k = arm.joints.index(joint.name)
        axis, slides = (
            _exact(joint.axis / np.linalg.norm(joint.axis)),
            joint.kind == "prismatic",
        )
        own, shift = _exact(still.rotation), _exact(still.translation)
        still = SE3.Identity()
        if slides:
            shift = shift + own * axis * q[k]
        else:
            own = own * _turn(axis, q[k])
        place, turn = place + turn * shift, turn * own
        v, w = own.T * (v + w.cross(shift)), own.T * w
        if slides:
            v = v + axis * dq[k]
        else:
            w = w + axis * dq[k]
    half, gravity = sp.Rational(1, 2), _exact(arm.gravity)
    # v . (w x s) = s . (v x w)
    yield half * v.dot(v), -gravity.dot(place)
    yield from zip(v.cross(w), -(turn.T * gravity), strict=True)
    for i, j in ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2)):
        yield w[i] * w[j] * (half if i == j else 1), sp.Integer(0)


def _turn(axis: sp.Matrix, angle: sp.Symbol) -> sp.Matrix:
    """Rotation about a unit axis (Rodrigues)."""
    x, y, z = axis
    cross = sp.Matrix([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return sp.eye(3) + sp.sin(angle) * cross + (1 - sp.cos(angle)) * cross * cross


def _exact(values: np.ndarray) -> sp.Matrix:
    """Numbers of the file, (3,) or (3, 3), integers where they are so to the last bit."""
    return sp.Matrix(values.tolist()).applyfunc(
        lambda x: sp.Integer(round(x)) if abs(x - round(x)) < _EXACT else x
    )


# Counts and differences

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


def counts() -> None:
    """Print the numbers of base parameters."""
    print("arm            links  known  found      gap  with rotors  with friction")
    for name, known in KNOWN.items():
        arm = load(name)
        if arm is None:
            print(f"{name:14} left out: no {name} in GAPSCOPE_DATA")
            continue
        inertial, rotors, everything = (
            structural_base(
                Regressor(arm, quantities=quantities), np.random.default_rng(0)
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
    states = (
        command_line(__doc__, states=(300, "random states of each arm"))
        .parse_args()
        .states
    )
    counts()
    symbolic(states)


if __name__ == "__main__":
    main()
