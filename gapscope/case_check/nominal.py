"""The data sheet, the controller and the model of a case."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

import numpy as np

from gapscope.arm.case import Case
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.case_check.remark import Remark, numbers
from gapscope.model_audit.audit import audit_model


def check_nominal(case: Case, body: RigidBody) -> Iterator[Remark]:
    """Friction and where it comes from, rotors, limits, gravity, and what is odd about the model."""
    arm = case.arm
    yield Remark(
        "ok", "data sheet", "", f"joints in this order: {', '.join(arm.joints)}"
    )
    if arm.friction_source:
        said = (
            f"coulomb {_listed(arm.coulomb)} N m, viscous {_listed(arm.viscous)} "
            f"N m s/rad, from {arm.friction_source}"
        )
        placeholder = "data sheet" not in arm.friction_source and _alike(
            arm.coulomb, arm.viscous
        )
        yield Remark(
            "warn" if placeholder else "ok",
            "data sheet",
            "",
            f"{said}: the same on all joints" if placeholder else said,
            "a placeholder, as it seems: give nominal: {coulomb: [...], viscous: [...]}"
            if placeholder
            else "",
        )
    else:
        yield Remark(
            "warn",
            "data sheet",
            "",
            "no friction is stated: all of it will be found as an effect",
            "give nominal: {coulomb: [...], viscous: [...]}, or identify the arm (gapscope identify)",
        )
    if not arm.armature.any():
        yield Remark(
            "warn",
            "data sheet",
            "",
            "no rotor inertia is stated: it will be found as an effect",
            "give nominal: {armature: [...]}: inertia of the rotor times the gear ratio squared [kg m^2]",
        )
    if arm.torque_limit is None and not body.effort_limits().any():
        yield Remark(
            "warn",
            "data sheet",
            "",
            "no torque limits: saturation is told by the torque alone",
            "give nominal: {torque_limit: [...]}",
        )
    yield from _model(case)


def check_controller(case: Case) -> Iterator[Remark]:
    """Whether the closed loop can be simulated."""
    every = [*case.recordings, *case.judged]
    referred = [recording for recording in every if recording.q_ref is not None]
    if case.controller is None:
        yield Remark(
            "warn",
            "controller",
            "",
            "no controller: there is no replay gap",
            "give controller: if you know it; the torque gap does not need it",
        )
    elif not referred:
        yield Remark(
            "warn",
            "controller",
            "",
            f"{case.controller.kind} at {case.controller.rate:g} Hz, "
            "but no recording has its reference",
            "record q_ref1.., or name the columns in import: {q_ref: ...}",
        )
    else:
        yield Remark(
            "ok",
            "controller",
            "",
            f"{case.controller.kind} at {case.controller.rate:g} Hz; reference in {len(referred)} of {len(every)} "
            "recordings",
        )


def check_ranges(case: Case, body: RigidBody) -> Iterator[Remark]:
    """Positions within the limits of the model; what leaves them was noted as the recording was read."""
    lower, upper = body.position_limits()
    every = [*case.recordings, *case.judged]
    lowest = np.min([recording.q.min(axis=0) for recording in every], axis=0)
    highest = np.max([recording.q.max(axis=0) for recording in every], axis=0)
    outside = (lowest < lower - 0.1) | (highest > upper + 0.1)
    if not outside.any():
        yield Remark("ok", "positions", "", "within the limits of the model")
        return
    yield Remark(
        "warn",
        "positions",
        numbers((np.flatnonzero(outside) + 1).tolist()),
        "leaves the limits of the model",
        "check unit, zero and order of the joints in import:",
    )


def _model(case: Case) -> Iterator[Remark]:
    """What the audit says of the robot file, in one line."""
    found = audit_model(case.arm.urdf).findings
    odd = Counter(x.kind for x in found if x.severity in ("impossible", "implausible"))
    if not odd:
        yield Remark("ok", "model", "", "nothing implausible in the robot file")
        return
    said = ", ".join(
        f"{kind.replace('_', ' ')} ({count})" for kind, count in odd.items()
    )
    yield Remark("warn", "model", "", said, f"gapscope audit {case.arm.urdf}")


def _listed(values: np.ndarray) -> str:
    return ", ".join(f"{value:.3g}" for value in values)


def _alike(*series: np.ndarray) -> bool:
    return all(np.ptp(values) == 0 for values in series)
