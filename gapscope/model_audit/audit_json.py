"""The document of an audit, ``audit.json``."""

from __future__ import annotations

from dataclasses import asdict, fields
from typing import Any

import numpy as np

from gapscope.arm.io.json_file import plain
from gapscope.model_audit.audit import Audit, total_mass
from gapscope.model_audit.check_inertials import box_density
from gapscope.model_audit.description import Joint, Link
from gapscope.model_audit.finding import SEVERITIES


def document(audit: Audit) -> dict[str, Any]:
    """An audit as plain data; what is not known is null.

    Findings are in order, worst first. Moments are principal ones about the centre of mass [kg m^2]; ``density`` is
    mass over the volume of the link's shapes, ``box_density`` that of the homogeneous box with the same mass and
    moments [kg/m^3].
    """
    description = audit.description
    content = {
        "schema": 1,
        "robot": description.name,
        "file": str(description.file),
        "form": description.form,
        "refused": audit.refused or None,
        "total_mass": total_mass(description),
        "counts": {
            severity: sum(one.severity == severity for one in audit.findings)
            for severity in SEVERITIES
        },
        "findings": [asdict(one) for one in audit.findings],
        "links": [_link(audit, link) for link in description.links],
        "joints": [_joint(joint) for joint in description.joints],
        "static": None if audit.static is None else _static(audit),
    }
    result: dict[str, Any] = plain(content, null_if_not_finite=True)
    return result


def _link(audit: Audit, link: Link) -> dict[str, Any]:
    inertial, geometry = link.inertial, audit.geometries.get(link.name)
    above = audit.description.joint_above(link.name)
    content = {
        "name": link.name,
        "line": link.line,
        "joint": None if above is None else above.name,
        "moved": audit.description.is_moved(link.name),
        "volume": None if geometry is None else geometry.volume,
    }
    if inertial is None:
        nothing = ("mass", "com", "moments", "density", "box_density")
        return {**content, **dict.fromkeys(nothing)}
    density = None if geometry is None else inertial.mass / geometry.volume
    return {
        **content,
        "mass": inertial.mass,
        "com": inertial.com,
        "moments": np.linalg.eigvalsh(inertial.moments),
        "density": density,
        "box_density": box_density(inertial) if inertial.is_body else None,
    }


def _joint(joint: Joint) -> dict[str, Any]:
    # what a file may leave out
    numbers = [each.name for each in fields(joint) if each.default is None]
    return {
        "name": joint.name,
        "line": joint.line,
        "kind": joint.kind,
        "parent": joint.parent,
        "child": joint.child,
        **{name: getattr(joint, name) for name in numbers},
    }


def _static(audit: Audit) -> dict[str, Any]:
    static = audit.static
    assert static is not None
    return {
        "joints": static.joints,
        "poses": static.poses,
        "correlation": static.correlation,
        "scale": static.scale,
        "offset": static.offset,
        "rms": static.rms,
        "spread": static.spread,
        "explanations": [asdict(one) for one in static.explanations],
    }
