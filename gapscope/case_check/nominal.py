"""The data sheet, the controller and the model of a case."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

import numpy as np

from gapscope.arm.case import Case
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.nominal import NominalArm
from gapscope.case_check.remark import Remark, numbers
from gapscope.model_audit.audit import audit_model


def check_nominal(case: Case, body: RigidBody) -> Iterator[Remark]:
    """Friction and where it comes from, rotors, limits, gravity, and what is odd about the model."""
    arm = case.arm
    yield Remark(
        "ok", "data sheet", "", f"joints in this order: {', '.join(arm.joints)}"
    )
    yield _friction(arm)
    yield from _drives(arm, body)
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
        "beyond the limits of the model",
        "check unit, zero and order of the joints in import:",
    )


def _friction(arm: NominalArm) -> Remark:
    """Nominal friction and where it comes from."""
    give = "give nominal: {coulomb: [...], viscous: [...]}"
    if not arm.friction_source:
        said = "no friction is stated: all of it will be found as an effect"
        remedy = f"{give}, or identify the arm (gapscope identify)"
        return Remark("warn", "data sheet", "", said, remedy)
    said = (
        f"coulomb {_listed(arm.coulomb)} N m, viscous {_listed(arm.viscous)} "
        f"N m s/rad, from {arm.friction_source}"
    )
    measured = "data sheet" in arm.friction_source
    if measured or np.ptp(arm.coulomb) > 0 or np.ptp(arm.viscous) > 0:
        return Remark("ok", "data sheet", "", said)
    said = f"{said}: the same on all joints"
    return Remark("warn", "data sheet", "", said, f"a placeholder, as it seems: {give}")


def _drives(arm: NominalArm, body: RigidBody) -> Iterator[Remark]:
    """Rotors and torque limits that are not stated."""
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
