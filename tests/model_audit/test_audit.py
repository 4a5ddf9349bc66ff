"""What the audit says of a good model, of one fault each, and of files that cannot be built."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Callable
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from arms import YAW_PITCH, Link, changed, urdf, written
from cases import valid_document
from scipy.spatial import ConvexHull

import gapscope
from gapscope.arm.dynamics.description import read_description
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.io.table import numbered
from gapscope.arm.io.write_case import write_columns
from gapscope.arm.nominal import NominalArm
from gapscope.arm.robots import load_nominal_arm, shifted_arm, shifted_root
from gapscope.model_audit.audit import audit_model, check_static, static_poses

Audited = Callable[..., dict[str, Any]]

LENGTHS = (0.15, 0.4, 0.35, 0.2, 0.12, 0.1)
"""Of the links [m]."""
WIDTHS = (0.14, 0.12, 0.1, 0.09, 0.08, 0.07)
DENSITIES = (2000.0, 1500.0, 1800.0, 2200.0, 1700.0, 2500.0)


def arm_text(shapes: bool = True) -> str:
    """A plausible arm of homogeneous boxes along x or z in turn, as URDF, with shapes or without."""
    links, place = [], "0 0 0"
    sizes = zip(LENGTHS, WIDTHS, DENSITIES, strict=True)
    for k, (length, width, density) in enumerate(sizes):
        end = np.zeros(3)
        end[0 if k % 2 else 2] = length
        edges = np.maximum(end, width)
        mass = density * edges.prod()
        moments = mass / 12 * ((edges**2).sum() - edges**2)
        com, size, tip = (
            " ".join(f"{x:.4f}" for x in xyz) for xyz in (end / 2, edges, end)
        )
        box = f'<origin xyz="{com}"/><geometry><box size="{size}"/></geometry>'
        links.append(
            Link(
                f"joint_{k + 1}",
                f"link_{k}",
                f"0 {k % 2} {1 - k % 2}",
                place,
                round(mass, 4),
                com,
                " ".join(f"{x:.6f}" for x in moments),
                f"-2 2 {100 - 10 * k} {2 + k}",
                more=f'<dynamics damping="{3 - 0.3 * k:.1f}" friction="{5 - 0.5 * k:.1f}"/>',
                shape=f"<collision>{box}</collision>" * shapes,
            )
        )
        place = tip
    return urdf("boxes", *links)


@pytest.fixture
def audited(tmp_path: Path) -> Audited:
    """Audits text as a file, a URDF or what its ending says."""

    def audit(text: str, name: str = "arm.urdf") -> dict[str, Any]:
        (tmp_path / name).write_text(text, encoding="utf-8")
        return audit_model(tmp_path / name)

    return audit


def found(audit: dict[str, Any]) -> dict[str, str]:
    """Place of the worst finding of each kind that is more than a note."""
    kinds: dict[str, str] = {}
    for one in audit["findings"]:
        if one["severity"] != "note":
            kinds.setdefault(one["kind"], one["place"])
    return kinds


def line_of(text: str, link: str, tag: str) -> int:
    """Line of the first such element after a link begins."""
    lines = text.splitlines()
    start = next(k for k, line in enumerate(lines) if f'<link name="{link}"' in line)
    return next(k + 1 for k in range(start, len(lines)) if f"<{tag}" in lines[k])


def spoilt(text: str, link: str, pattern: str, change: Callable[[float], float]) -> str:
    """The text with the numbers of an attribute of one link changed."""
    head, tail = text.split(f'<link name="{link}"')
    body, rest = tail.split("</link>", 1)

    def replaced(match: re.Match[str]) -> str:
        return f'{match[1]}="{change(float(match[2])):.8g}"'

    body = re.sub(rf'\b({pattern})="([^"]*)"', replaced, body)
    return f'{head}<link name="{link}"{body}</link>{rest}'


@pytest.mark.parametrize("shapes", [True, False])
def test_a_plausible_arm_lacks_only_rotors(audited: Audited, shapes: bool) -> None:
    audit = audited(arm_text(shapes))
    assert set(found(audit)) == {"no_drive"}
    assert "rotor" in audit["findings"][0]["found"] and not audit["refused"]


def test_what_the_data_sheet_of_a_case_gives_is_not_missing(tmp_path: Path) -> None:
    """Of all three nothing is missing, of one the others are."""
    (tmp_path / "arm.urdf").write_text(re.sub("<dynamics.*?/>", "", arm_text()))
    for given in ((), ("viscous",), ("armature", "coulomb", "viscous")):
        sheet = ", ".join(f"{name}: [1, 1, 1, 1, 1, 1]" for name in given)
        text = f"name: a\nrobot: arm.urdf\nrecordings: [a.csv]\nnominal: {{{sheet}}}\n"
        (tmp_path / "case.yaml").write_text(text)
        odd = [
            one
            for one in audit_model(tmp_path)["findings"]
            if one["kind"] == "no_drive"
        ]
        assert ("armature: " in str(odd)) == (len(given) < 3)
        assert ("viscous: " in str(odd)) == (not given)


@pytest.mark.parametrize(
    ("shapes", "kind"), [(True, "moments_too_large"), (False, "moments_for_mass")]
)
def test_the_worst_finding_stands_first_with_its_line_wherever_it_is_said(
    tmp_path: Path, shapes: bool, kind: str
) -> None:
    text, path = arm_text(shapes), tmp_path / "arm.urdf"
    path.write_text(spoilt(text, "link_2", "ixx|iyy|izz", lambda x: 30 * x))
    result = gapscope.audit(path)
    page, document = result.save(tmp_path / "out")
    content = valid_document(document)
    worst = content["findings"][0]
    assert (worst["kind"], worst["place"]) == (kind, "link link_2")
    assert worst["line"] == line_of(text, "link_2", "inertial")
    said = f"link link_2, line {worst['line']}"
    assert said in page.read_text(encoding="utf-8")
    assert f"{kind.replace('_', ' ')}, {said}" in result.summary()
    assert result.to_frame()["kind"].iloc[0] == kind


@pytest.mark.parametrize("by", [1, -1])
@pytest.mark.parametrize("moved_only", [True, False])
@pytest.mark.parametrize("shapes", [True, False])
def test_shifted_inertials_are_found_and_the_way_back(
    audited: Audited, tmp_path: Path, by: int, moved_only: bool, shapes: bool
) -> None:
    right = tmp_path / "right.urdf"
    right.write_text(arm_text(shapes))
    root = shifted_root(read_description(right), by, moved_only)
    audit = audited(ET.tostring(root, encoding="unicode"))
    shift = next(one for one in audit["findings"] if one["kind"] == "shifted_inertials")
    assert ("next" if by > 0 else "previous") in shift["remedy"]
    assert ("less certain" in shift["found"]) is not shapes


@pytest.mark.parametrize(
    ("pattern", "change", "kind"),
    [
        ("value", lambda x: 1000 * x, "density"),
        ("value", lambda x: -x, "mass"),
        ("izz", lambda x: 10 * x, "triangle_inequality"),
        ("ixx", lambda x: -x, "inertia_not_positive"),
        ("ixx|iyy|izz", lambda x: 1e-3 * x, "moments_too_small"),
        ("ixx|iyy|izz", lambda x: 0.0, "no_moments"),
        ("value", lambda x: float("nan"), "unreadable_number"),
    ],
)
def test_one_fault_of_an_inertial_is_named_at_its_link(
    audited: Audited,
    pattern: str,
    change: Callable[[float], float],
    kind: str,
) -> None:
    text = spoilt(arm_text(), "link_1", pattern, change)
    audit = audited(text)
    assert found(audit)[kind] == "link link_1"
    if kind == "mass":
        # a model that cannot be built is audited all the same
        assert audit["findings"][0]["kind"] == "refused"
        assert "expected zero or above" in audit["refused"]
    if kind == "triangle_inequality":
        # a slipped digit is guessed
        (remedy,) = (x["remedy"] for x in audit["findings"] if x["kind"] == kind)
        right = re.search(r'izz="([\d.]+)"', arm_text().split('<link name="link_1"')[1])
        assert right is not None and f"izz = {float(right[1]):g}" in remedy


@pytest.mark.parametrize(
    ("old", "new", "kind", "place"),
    [
        ('xyz="0.2000 0.0000 0.0000"', 'xyz="200 0 0"', "com_outside", "link link_1"),
        ('axis xyz="0 1 0"', 'axis xyz="0 0 0"', "axis", "joint joint_2"),
        ('lower="-2" upper="2"', 'lower="2" upper="-2"', "limits", "joint joint_1"),
        ('effort="90"', 'effort="0"', "effort", "joint joint_2"),
        ('velocity="3"', 'velocity="0"', "velocity", "joint joint_2"),
        ('child link="link_3"', 'child link="nowhere"', "no_such_link", "joint joint_4"),
        ('parent link="link_0"', 'parent link="link_4"', "loop", "joint joint_2"),
    ],
)  # fmt: skip
def test_one_fault_of_the_file_is_named_at_its_place(
    audited: Audited, old: str, new: str, kind: str, place: str
) -> None:
    text = arm_text()
    assert old in text
    audit = audited(text.replace(old, new, 1))
    assert found(audit)[kind] == place


def test_the_same_values_everywhere_are_placeholders(audited: Audited) -> None:
    text = re.sub(r'(ixx|iyy|izz)="[^"]*"', r'\1="0.01"', arm_text())
    text = re.sub(r'damping="[^"]*"', 'damping="0.5"', text)
    kinds = found(audited(text))
    assert {"placeholder", "same_damping"} <= set(kinds)


def test_a_link_that_is_no_mirror_image_is_named(audited: Audited) -> None:
    def arm(side: str, y: float, product: float) -> str:
        return f"""<link name="{side}_arm"><inertial><origin xyz="0.1 {y} 0.2"/><mass value="2"/>
          <inertia ixx="0.02" ixy="{product}" ixz="0" iyy="0.03" iyz="0" izz="0.025"/></inertial></link>
        <joint name="{side}" type="revolute"><parent link="base"/><child link="{side}_arm"/>
          <limit lower="-1" upper="1" effort="1" velocity="1"/></joint>"""

    head, tail = '<robot name="two"><link name="base"/>', "</robot>"
    right = head + arm("left", 0.1, 0.004) + arm("right", -0.1, -0.004) + tail
    wrong = head + arm("left", 0.1, 0.004) + arm("right", -0.1, 0.004) + tail
    assert "mirror_image" not in found(audited(right))
    assert found(audited(wrong))["mirror_image"] == "link right_arm"


@pytest.mark.parametrize("sign", [1, -1])
def test_products_of_inertia_of_the_opposite_sign_are_found(
    audited: Audited, sign: int
) -> None:
    """Boxes that lie askew: turned by 0.5 rad about z, with ixy of the CAD program's sign."""
    sides, mass, turn = np.array([0.4, 0.1, 0.1]), 4.0, 0.5
    along = mass / 12 * ((sides**2).sum() - sides**2)
    c, s = np.cos(turn), np.sin(turn)
    rotation = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    moments = rotation @ np.diag(along) @ rotation.T

    (xx, xy, _), (_, yy, _), (_, _, zz) = moments
    box = '<geometry><box size="0.4 0.1 0.1"/></geometry>'
    askew = Link(
        *("", "", "1 0 0", "0.3 0 0", mass, "0 0 0"),
        inertia=f"{xx} {yy} {zz} {sign * xy}",
        limit="-1 1 1 1",
        shape=f'<visual><origin rpy="0 0 {turn}"/>{box}</visual>',
    )
    links = [askew._replace(joint=f"j{k}", name=f"link_{k}") for k in range(3)]
    audit = audited(urdf("x", *links))
    assert ("products_of_inertia" in found(audit)) == (sign < 0)


def test_masses_of_the_next_link_are_found_in_the_kinova_file(data_root: Path) -> None:
    audit = audit_model(data_root / "kinova_gen3" / "gen3.urdf")
    shift = next(one for one in audit["findings"] if one["kind"] == "shifted_masses")
    assert "previous" in shift["remedy"]


def mjcf(name: str, bodies: str, defaults: str = "") -> str:
    world = f"<worldbody>{bodies}</worldbody>"
    return f'<mujoco model="{name}">{defaults}{world}</mujoco>'


TWO = """
<body name="upper"><joint name="a" axis="0 0 1" range="-90 90"/>
  <inertial pos="0 0 0.1" mass="1" diaginertia="0.004 0.004 0.001"/>
  <geom fromto="0 0 0 0 0 0.2" size="0.04"/>
  <body name="lower" pos="0 0 0.2"><joint name="b" axis="0 1 0" range="-45 45"/>
    <inertial pos="0 0 0.1" mass="1" diaginertia="0.4 0.4 0.1"/>
    <geom fromto="0 0 0 0 0 0.2" size="0.04"/></body></body>"""
DEFAULTS = (
    '<default><joint damping="0.5" armature="0.1"/><geom type="capsule"/></default>'
)


def test_mjcf_is_read_with_its_defaults_and_degrees(audited: Audited) -> None:
    audit = audited(mjcf("two", TWO, DEFAULTS), "arm.xml")
    assert found(audit) == {"moments_too_large": "link lower", "no_drive": ""}
    upper = next(one for one in audit["joints"] if one["name"] == "a")
    assert upper["upper"] == pytest.approx(1.5707963)
    assert (upper["damping"], upper["armature"]) == (0.5, 0.1)


@pytest.mark.parametrize(
    ("quat", "mass", "said"),
    [
        ("0 0 0 0", "1", "<body>: is not valid MJCF: zero quaternion"),
        ("1e200 0 0 0", "1", "<body quat>: expected numbers, got '1e200 0 0 0'"),
        ("1 0 0 0", "1e-320", "<inertial>: .*too large in attribute 'mass'"),
    ],
)
def test_numbers_that_overflow_are_refused_with_their_line(
    quat: str, mass: str, said: str, audited: Audited
) -> None:
    body = f"""<body name="upper" quat="{quat}">
      <inertial pos="0 0 0.1" mass="{mass}" diaginertia="0.004 0.004 0.001"/></body>"""
    with pytest.raises(InputError, match=f"line [12], {said}"):
        audited(mjcf("one", body), "arm.xml")


# Gravity torque of a model against torque at rest.


POSES, HELD, RATE = 16, 40, 50
"""Poses of a recording, samples of each, and their rate [Hz]."""


def recorded(folder: Path, q: np.ndarray, tau: np.ndarray) -> Path:
    """A file in which each pose is held for a moment, with noise on the torque."""
    rng = np.random.default_rng(1)
    positions, torques = (np.repeat(x, HELD, axis=0) for x in (q, tau))
    return logged(
        folder, positions, torques + 0.05 * rng.standard_normal(torques.shape)
    )


def logged(folder: Path, q: np.ndarray, tau: np.ndarray) -> Path:
    path, t = folder / "static.csv", np.arange(len(q)) / RATE
    write_columns(numbered({"t": t, "q": q, "tau": tau}), path)
    return path


Q = np.random.default_rng(3).uniform(-1.2, 1.2, (POSES, 7))
"""Random poses of seven joints [rad]."""


def gravity(arm: NominalArm, more: float = 0.0) -> np.ndarray:
    """What an arm needs to rest in these poses [N m], with so much more at its link 4 [kg]."""
    added = np.zeros((7, 10))
    added[3, :4] = more * np.array([1.0, 0.0, 0.1, 0.05])
    return RigidBody(arm).changed(added).inverse_dynamics(Q, 0 * Q, 0 * Q)


@pytest.mark.parametrize(
    ("more", "change", "said"),
    [
        (0.0, lambda tau: 0.8 * tau, "one scale of 0.8 on all joints"),
        (0.0, lambda tau: -tau, "torque of the opposite sign on all joints"),
        (0.0, lambda tau: tau * [1, 1, 1, -1, 1, 1, 1], "opposite sign on joint 4"),
        (0.0, lambda tau: 0 * tau + 0.1, "a torque column without gravity"),
        (2.0, lambda tau: tau, "link moved by joint 4"),
    ],
)
def test_what_is_wrong_with_the_torque_is_said(
    tmp_path: Path, more: float, change, said: str
) -> None:
    tau = change(gravity(load_nominal_arm("kuka_iiwa"), more))
    static = static_poses("kuka_iiwa", recorded(tmp_path, Q, tau))
    assert said in static["explanations"][0]["name"]
    assert said in next(check_static(static)).found


@pytest.mark.parametrize(("by", "word"), [(1, "next"), (-1, "previous")])
def test_shifted_inertials_are_told_by_gravity(
    tmp_path: Path, by: int, word: str
) -> None:
    """A case with a wrong model, and one with the right one that was recorded: the wrong one is told."""
    arm = load_nominal_arm("kuka_iiwa")
    recorded(tmp_path, Q, gravity(arm) + 0.3)
    for name, robot in (("wrong", shifted_arm(arm, by).urdf), ("right", arm.urdf)):
        text = f"name: {name}\nrobot: {robot}\nrecordings: [../static.csv]\n"
        (tmp_path / name).mkdir()
        (tmp_path / name / "case.yaml").write_text(text, encoding="utf-8")
    best = static_poses(tmp_path / "wrong", tmp_path / "right")["explanations"][0]
    assert best["name"] == f"each link with the inertial of the {word} one"
    assert best["misfit"] < 0.02
    static = static_poses(tmp_path / "right", tmp_path / "wrong")
    assert static["poses"] == POSES and not list(check_static(static))
    assert static["correlation"][1] > 0.999
    assert static["scale"][1:5] == pytest.approx(np.ones(4), abs=0.03)
    assert static["offset"][1] == pytest.approx(0.3, abs=0.05)


def test_a_moving_recording_is_refused(tmp_path: Path) -> None:
    q = np.repeat(np.linspace(0, 3, 20 * HELD)[:, None], 7, axis=1)
    with pytest.raises(InputError, match="rests in 0 poses"):
        static_poses("kuka_iiwa", logged(tmp_path, q, np.sin(q)))


def test_an_arm_on_which_gravity_does_not_act_is_audited(tmp_path: Path) -> None:
    """And a torque that is the same in all poses tells nothing."""
    poses = np.random.default_rng(0).uniform(-1, 1, (POSES, 2))
    file = written(tmp_path / "r.urdf", "r", *changed(YAW_PITCH, axis="0 0 1"))
    audit = audit_model(file, recorded(tmp_path, poses, 0 * poses))
    names = [x["name"] for x in audit["static"]["explanations"]]
    assert not any("scale" in name for name in names)
    with pytest.raises(InputError, match="the same torque in all poses"):
        still = np.repeat(poses, HELD, axis=0)
        static_poses(file, logged(tmp_path, still, 0 * still + 3.1))


def test_joints_stay_locked_as_the_case_of_the_poses_has_them(tmp_path: Path) -> None:
    poses = np.random.default_rng(0).uniform(-1, 1, (POSES, 2))
    more = Link("grip", "hand", origin="0.5 0 0", mass=1)
    file = written(tmp_path / "r.urdf", "r", *YAW_PITCH, more)
    how = {"joints": ["yaw", "pitch"], "locked": {"grip": 1.5}}
    tau = RigidBody(load_nominal_arm(file, **how)).gravity_torque(poses)
    logged(tmp_path, *(np.repeat(x, HELD, axis=0) for x in (poses, tau)))
    content = {"name": "x", "robot": "r.urdf", **how, "recordings": ["static.csv"]}
    (tmp_path / "case.yaml").write_text(yaml.safe_dump(content), encoding="utf-8")
    assert not list(check_static(static_poses(file, tmp_path)))


def test_a_mesh_is_read_again_once_it_changes(tmp_path: Path) -> None:
    mesh = '<collision><geometry><mesh filename="box.stl"/></geometry></collision>'
    file = written(tmp_path / "r.urdf", "r", *changed(YAW_PITCH, shape=mesh))
    volumes = []
    for edge in (0.02, 0.2):
        corners = np.array(list(product((0, edge), repeat=3)))
        sides = [corners[side] for side in ConvexHull(corners).simplices]
        text = "".join(
            "facet normal 0 0 0\nouter loop\n"
            + "".join(f"vertex {x} {y} {z}\n" for x, y, z in side)
            + "endloop\nendfacet\n"
            for side in sides
        )
        (tmp_path / "box.stl").write_text(f"solid x\n{text}endsolid x\n")
        volumes.append(audit_model(file)["links"][1]["volume"])
    assert volumes == pytest.approx([0.02**3, 0.2**3], rel=1e-3)
