"""Base parameters of known arms against known counts, and the closed form of the regressor against pinocchio's.

    .venv/bin/python experiments/21_base_parameters.py [--states 300]

Counts are those of the inertial parameters alone, of random states within the arm's limits; *gap* is the smallest kept
over the largest dropped pivot. *With rotors* adds a column of rotor inertia per joint, *with friction* those of viscous
and Coulomb friction and offset too. Arms of which there are recordings are read from the folder GAPSCOPE_DATA.

Second table: the largest difference between the closed form and pinocchio over the largest entry, on random states of
chains with oblique placements and axes.
"""

from __future__ import annotations

import os
import time
import xml.etree.ElementTree as ET
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import sympy as sp
from common import command_line

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


@dataclass(frozen=True)
class _Joint:
    """A movable joint of the chain: placement in the frame of the joint before it, axis, and what moves it."""

    rotation: sp.Matrix
    translation: sp.Matrix
    axis: sp.Matrix
    slides: bool
    parent: int | None


@dataclass(frozen=True)
class SymbolicRegressor:
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
        out = np.zeros((len(q), *self.matrix.shape))
        for (row, column), value in zip(
            self._filled, self.function(*q.T, *dq.T, *ddq.T), strict=True
        ):
            out[:, row, column] = value
        return out

    @cached_property
    def function(self) -> Callable[..., list[np.ndarray]]:
        """Generated NumPy function of q1, ..., dq1, ..., ddq1, ...: those entries of Y, row by row, that are not 0."""
        entries = [self.matrix[place] for place in self._filled]
        return sp.lambdify(
            [*self.q, *self.dq, *self.ddq], entries, modules="numpy", cse=True
        )

    @property
    def _filled(self) -> list[tuple[int, int]]:
        rows, columns = self.matrix.shape
        return [
            (i, j)
            for i in range(rows)
            for j in range(columns)
            if self.matrix[i, j] != 0
        ]


def symbolic_regressor(arm: NominalArm) -> SymbolicRegressor:
    """Derive the regressor of an arm of up to ``MAX_JOINTS`` revolute or prismatic joints by Lagrange's equation.

    Kinetic and potential energy of a link are linear in its inertial parameters,
    T = m v.v / 2 + v.(w x s) + w.J w / 2 and U = -g.(m p + R s), with the velocity v and rate w of its joint's frame,
    the frame's place p and orientation R, first moment s and inertia J about its origin. The column of a parameter is
    d/dt dL/d(dq) - dL/dq of its share of L = T - U. The way there shares nothing with pinocchio's recursion.

    Joints of the URDF that the arm does not name are held at zero.

    Raises:
        InputError: more joints than that, a file that is no URDF, or a joint of another type.

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
    gravity = sp.Matrix([_number(g) for g in arm.gravity])
    joints = _joints(arm)
    columns: list[sp.Matrix] = []
    for link in range(n):
        kinetic, potential = _energies(joints, link, q, dq, gravity)
        for t, u in zip(kinetic, potential, strict=True):
            columns.append(_lagrange(t, u, q, dq, ddq))
    names = tuple(
        f"{name}{joint}" for joint in range(1, n + 1) for name in INERTIAL_PARAMETERS
    )
    return SymbolicRegressor(sp.Matrix.hstack(*columns), q, dq, ddq, names)


def _lagrange(
    kinetic: sp.Expr,
    potential: sp.Expr,
    q: tuple[sp.Symbol, ...],
    dq: tuple[sp.Symbol, ...],
    ddq: tuple[sp.Symbol, ...],
) -> sp.Matrix:
    """d/dt dT/d(dq) - dT/dq + dU/dq, shape (n, 1)."""
    momenta = [sp.diff(kinetic, rate) for rate in dq]
    return sp.Matrix(
        [
            sum(
                sp.diff(p, v) * a + sp.diff(p, x) * v
                for x, v, a in zip(q, dq, ddq, strict=True)
            )
            - sp.diff(kinetic, q[i])
            + sp.diff(potential, q[i])
            for i, p in enumerate(momenta)
        ]
    )


def _energies(
    joints: list[_Joint],
    link: int,
    q: tuple[sp.Symbol, ...],
    dq: tuple[sp.Symbol, ...],
    gravity: sp.Matrix,
) -> tuple[list[sp.Expr], list[sp.Expr]]:
    """Kinetic and potential energy per unit of each of a link's ten parameters."""
    chain: list[int] = []
    at: int | None = link
    while at is not None:
        chain.insert(0, at)
        at = joints[at].parent
    place, turn = sp.zeros(3, 1), sp.eye(3)
    v, w = sp.zeros(3, 1), sp.zeros(3, 1)
    for i in chain:
        joint = joints[i]
        slide = joint.axis * q[i] if joint.slides else sp.zeros(3, 1)
        own = (
            joint.rotation if joint.slides else joint.rotation * _turn(joint.axis, q[i])
        )
        shift = joint.translation + joint.rotation * slide
        place, turn = place + turn * shift, turn * own
        v, w = own.T * (v + w.cross(shift)), own.T * w
        v, w = (
            (v + joint.axis * dq[i], w) if joint.slides else (v, w + joint.axis * dq[i])
        )
    # v . (w x s) = s . (v x w)
    half, moment, weight = sp.Rational(1, 2), v.cross(w), turn.T * gravity
    square = [
        half * w[0] ** 2,
        w[0] * w[1],
        half * w[1] ** 2,
        w[0] * w[2],
        w[1] * w[2],
        half * w[2] ** 2,
    ]
    return [half * v.dot(v), *moment, *square], [
        -gravity.dot(place),
        *(-weight),
        *[sp.Integer(0)] * 6,
    ]


def _turn(axis: sp.Matrix, angle: sp.Symbol) -> sp.Matrix:
    """Rotation about a unit axis (Rodrigues)."""
    x, y, z = axis
    cross = sp.Matrix([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return sp.eye(3) + sp.sin(angle) * cross + (1 - sp.cos(angle)) * cross * cross


def _joints(arm: NominalArm) -> list[_Joint]:
    """The arm's joints with their placements, joints that it does not name held at zero."""
    root = ET.parse(arm.urdf).getroot()
    if root.tag != "robot":
        raise InputError(
            f"root element is <{root.tag}>, expected <robot>",
            "give a URDF",
            file=arm.urdf,
        )
    above = {
        _link(joint, "child"): joint
        for joint in root.iter("joint")
        if joint.find("child") is not None
    }
    by_name = {joint.get("name"): joint for joint in above.values()}
    return [_placed(arm, by_name[name], above) for name in arm.joints]


def _placed(arm: NominalArm, joint: ET.Element, above: dict[str, ET.Element]) -> _Joint:
    kind = joint.get("type")
    if kind not in ("revolute", "continuous", "prismatic"):
        raise InputError(
            f"joint {joint.get('name')} is {kind}",
            "name revolute or prismatic joints",
            file=arm.urdf,
        )
    axis = _vector(joint.find("axis"), "xyz", "1 0 0")
    rotation, translation = _origin(joint)
    link = _link(joint, "parent")
    while link in above and above[link].get("name") not in arm.joints:
        turn, shift = _origin(above[link])
        rotation, translation = turn @ rotation, shift + turn @ translation
        link = _link(above[link], "parent")
    parent = arm.joints.index(above[link].get("name", "")) if link in above else None
    exact = [
        sp.Matrix([[_number(x) for x in row] for row in np.atleast_2d(a)])
        for a in (rotation, translation)
    ]
    unit = sp.Matrix([_number(x) for x in axis / np.linalg.norm(axis)])
    return _Joint(exact[0], exact[1].T, unit, kind == "prismatic", parent)


def _origin(joint: ET.Element) -> tuple[np.ndarray, np.ndarray]:
    """Rotation, shape (3, 3), and translation [m], shape (3,), of a joint in the frame of its parent link."""
    origin = joint.find("origin")
    roll, pitch, yaw = _vector(origin, "rpy", "0 0 0")
    turn = np.eye(3)
    for angle, (i, j) in ((yaw, (0, 1)), (pitch, (2, 0)), (roll, (1, 2))):
        step = np.eye(3)
        step[i, i] = step[j, j] = np.cos(angle)
        step[j, i] = np.sin(angle)
        step[i, j] = -step[j, i]
        turn = turn @ step
    return turn, _vector(origin, "xyz", "0 0 0")


def _vector(element: ET.Element | None, attribute: str, default: str) -> np.ndarray:
    text = default if element is None else element.get(attribute, default)
    return np.array([float(x) for x in text.split()])


def _link(joint: ET.Element, end: str) -> str:
    element = joint.find(end)
    return "" if element is None else element.get("link", "")


def _number(value: float) -> sp.Number:
    """A number of the URDF, an integer where it is one to the last bit."""
    return (
        sp.Integer(round(value))
        if abs(value - round(value)) < _EXACT
        else sp.Float(float(value))
    )


# Counts and differences

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
    parser = command_line(__doc__)
    parser.add_argument(
        "--states", type=int, default=300, help="random states of each arm"
    )
    states = parser.parse_args().states
    counts(states)
    symbolic(states)


if __name__ == "__main__":
    main()
