"""Delay or lag: how the way from the recorded torque to the joint bends beyond its first order in time.

Both make the torque late by T; they part in the second order. With n the torque that the joint needs, recorded is

    delay         n + T n' + T^2 / 2 n'' + T^3 / 6 n'''
    lag           n + T n'
    lag in two    n + T n' + T^2 / 4 n''

the last for a lag that is spread over two equal stages, as that of a current loop behind a filter. A lag is one or the
other; each form is compared with the delay around the delay's own values, the time T free on every joint.
"""

from __future__ import annotations

import numpy as np

from gapscope.diagnosis.selection.state import Model, State
from gapscope.diagnosis.thresholds import LONGEST_COMPARED_DELAY
from gapscope.effects.corrected import CorrectedArm

DELAY = "actuator_delay"


def lag_over_delay(state: State, delayed: Model) -> float | None:
    """Evidence of the better form of a lag less that of the delay of a model [nats]; ``None`` where it is too long."""
    times = {
        t.joint - 1: float(delayed.fit.theta[t.columns[0]])
        for t in delayed.fit.terms
        if t.effect == DELAY
    }
    if not times or max(times.values()) > LONGEST_COMPARED_DELAY:
        return None
    late = np.zeros(state.data.arm.n_joints)
    late[list(times)] = list(times.values())
    rates = _rates(state, delayed)
    gains = [_gain(delayed, rates, late, second) for second in (0.0, 0.25)]
    return max(gains)


def _rates(state: State, delayed: Model) -> list[np.ndarray]:
    """First to third derivative by time of the torque that a model without its delay needs, on the rows, (M, n)."""
    effects = delayed.linear.terms.effects(
        delayed.fit.theta, [t for t in delayed.fit.terms if t.effect != DELAY]
    )
    arm = CorrectedArm(state.data.arm, effects)
    out: list[list[np.ndarray]] = [[], [], []]
    for segment in state.data.segments:
        series = arm.unlimited.predict(segment.bodies(state.data.body), segment.motion)
        for order in range(3):
            series = np.gradient(series, segment.motion.t, axis=0)
            out[order].append(state.data.thin(series, segment))
    return [np.vstack(rows) for rows in out]


def _gain(
    delayed: Model, rates: list[np.ndarray], late: np.ndarray, second: float
) -> float:
    """Evidence of n + T n' + second T^2 n'' less that of the delay [nats]."""
    left = delayed.linear.scan_residual
    change = (second - 0.5) * late**2 * rates[1] - late**3 / 6 * rates[2]
    return left.gain(change, free=rates[0])
