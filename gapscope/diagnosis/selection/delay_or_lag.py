"""Delay or lag: what the path from the recorded torque to the joint does beyond its first order in time.

Both make the torque late by T; they differ in the second order. With n the torque that the joint needs, recorded is

    delay         n + T n' + T^2 / 2 n'' + T^3 / 6 n'''
    lag           n + T n'
    lag in two    n + T n' + T^2 / 4 n''

the last for a lag that is spread over two equal stages, as that of a current loop behind a filter. A lag is one or the
other; each form is compared with the delay around the delay's own values, the time T free on every joint.
"""

from __future__ import annotations

import numpy as np

from gapscope.diagnosis.selection.fitted_model import Model
from gapscope.diagnosis.thresholds import LONGEST_COMPARED_DELAY
from gapscope.effects.corrected import CorrectedArm

DELAY = "actuator_delay"
LAG_FORMS = (0.0, 0.25)
"""Coefficient of T^2 n'' of a lag in one stage, and of one in two."""


def lag_over_delay(delayed: Model) -> float | None:
    """Evidence of the better form of a lag less that of a model's delay [nats]; ``None`` if that is too long."""
    delays = np.zeros(delayed.data.arm.n_joints)
    for term in delayed.fit.terms:
        if term.effect == DELAY:
            delays[term.joint - 1] = delayed.fit.theta[term.columns[0]]
    if not delays.any() or delays.max() > LONGEST_COMPARED_DELAY:
        return None
    first, second, third = _rates(delayed)
    gains = []
    for coefficient in LAG_FORMS:
        change = (coefficient - 0.5) * delays**2 * second - delays**3 / 6 * third
        gains.append(delayed.linear.scan_residual.gain(change, free=first))
    return max(gains)


def _rates(delayed: Model) -> list[np.ndarray]:
    """First to third derivative by time of the torque that a model without its delay needs, on the rows, (M, n)."""
    data, others = delayed.data, [t for t in delayed.fit.terms if t.effect != DELAY]
    arm = CorrectedArm(data.arm, delayed.terms.effects(delayed.fit.theta, others))
    rates: list[list[np.ndarray]] = [[], [], []]
    for segment in data.segments:
        series = arm.unlimited.predict(segment.bodies(data.body), segment.motion)
        for rows in rates:
            series = np.gradient(series, segment.motion.t, axis=0)
            rows.append(data.thin(series, segment))
    return [np.vstack(rows) for rows in rates]
