"""The control laws by name: what ``controller.kind`` of a case may be."""

from __future__ import annotations

from typing import Any

from gapscope.arm.control.cascade import Cascade
from gapscope.arm.control.computed_torque import ComputedTorque
from gapscope.arm.control.pd import PD
from gapscope.arm.control.pid import PID
from gapscope.arm.controller import Controller
from gapscope.arm.nearest_name import check_known

LAWS: dict[str, type[Controller]] = {
    law.kind: law for law in (PD, PID, Cascade, ComputedTorque)
}
"""The control laws by name, the first by default."""

INTEGRATOR_SHARE = 0.1
"""Corner of an integrator over the bandwidth of the loop [1]: slow enough to cost little of the phase margin."""


def like_pd(pd: PD, kind: str, damping: float) -> Controller:
    """A controller of another law with about the bandwidth and damping of a PD controller.

    With w = 2 damping kp / kd: ``pid`` adds ki = 0.1 w kp; ``cascade`` has the gains kp / kd and kd, and ki = 0.1 w kd;
    ``computed_torque`` has w^2 and 2 damping w, and no feedforward beside it.

    Args:
        pd: the PD controller.
        kind: a key of ``LAWS``.
        damping: of the loop [1].

    Raises:
        InputError: there is no such law.
    """
    check_known("control law", kind, LAWS, where="controller.kind")
    common: dict[str, Any] = {
        name: getattr(pd, name)
        for name in ("rate", "feedforward", "velocity_cutoff", "velocity_damping")
    }
    w = 2 * damping * pd.kp / pd.kd
    slow = INTEGRATOR_SHARE * w
    if kind == PID.kind:
        return PID(kp=pd.kp, ki=slow * pd.kp, kd=pd.kd, **common)
    if kind == Cascade.kind:
        return Cascade(kp=pd.kp / pd.kd, kv=pd.kd, ki=slow * pd.kd, **common)
    if kind == ComputedTorque.kind:
        common["feedforward"] = "none"
        return ComputedTorque(kp=w**2, kd=2 * damping * w, **common)
    return pd
