"""What a torque column can be, by the nominal arm: gravity in or out, newton metres or amperes, which sign."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.nominal import NominalArm, smooth_sign
from gapscope.arm.recording import Recording
from gapscope.effects.setup_faults.torque_faults import TorqueUnit
from gapscope.model.conditioning import Segment, condition

READINGS = ("with gravity", "without gravity")
STRETCHES = 20
"""Stretches into which the samples are cut, to fit on half of them."""
CLEARLY_BETTER = 0.05
"""Share of the torque's variance by which one reading has to explain more than the other [1]."""
EXPLAINED = 0.5
"""Share of the variance that a reading has to explain on a joint, for its factor to count [1]."""
BODIES = 0.1
"""Share of it that the bodies' torque has to explain beyond rotor and friction, for the same [1]."""


@dataclass(frozen=True)
class TorqueFit:
    """How the nominal arm explains a column as torque, n joints.

    Per joint, column = factor x (torque of the bodies) + rotor + Coulomb + viscous + offset, fitted on every second
    stretch of the samples and judged on those between.

    Attributes:
        reading: an entry of ``READINGS``.
        explained: share of the variance of the stretches between, (n,) [1].
        by_bodies: share that is lost without the torque of the bodies, (n,) [1].
        factor: column over torque of the nominal bodies, (n,), in the column's unit per N m.
    """

    reading: str
    explained: np.ndarray
    by_bodies: np.ndarray
    factor: np.ndarray

    @property
    def overall(self) -> float:
        """Median over the joints of what is explained [1]."""
        return float(np.median(np.clip(self.explained, 0.0, 1.0)))

    @property
    def counted(self) -> np.ndarray:
        """Joints of which the factor counts, mask (n,)."""
        return (self.explained > EXPLAINED) & (self.by_bodies > BODIES)


def fits_of(arm: NominalArm, recordings: Sequence[Recording]) -> list[TorqueFit]:
    """Both readings of the torque of recordings, the better first; none if nothing is left of them."""
    segments = [s for r in recordings for s in condition(r)]
    if not segments:
        return []
    body = RigidBody(arm)
    motion = [_inner(s) for s in segments]
    q, dq, ddq, tau = (np.concatenate(parts) for parts in zip(*motion, strict=True))
    still = np.zeros_like(q)
    gravity = body.inverse_dynamics(q, still, still)
    full = body.inverse_dynamics(q, dq, ddq) + arm.armature * ddq
    found = [
        _fit(reading, bodies, dq, ddq, tau)
        for reading, bodies in zip(READINGS, (full, full - gravity), strict=True)
    ]
    return sorted(found, key=lambda fit: -fit.overall)


def what_it_is(fits: Sequence[TorqueFit]) -> str:
    """The better reading in a sentence, with its figures."""
    best, other = fits
    if best.overall < EXPLAINED:
        return (
            f"the nominal arm explains {best.overall:.0%} of it at best (median over the joints): "
            "a wrong model, order of joints or unit, or no measurement"
        )
    told = best.overall - other.overall >= CLEARLY_BETTER
    gravity = (
        f"torque {best.reading}"
        if told
        else "torque; gravity in or out cannot be told from this motion"
    )
    if not best.counted.any():
        return f"{gravity}: the nominal arm explains {best.overall:.0%}, most of it by rotors and friction"
    factors = best.factor[best.counted]
    spread = (
        f"{factors.min():.2g} to {factors.max():.2g}"
        if np.ptp(factors) > 0
        else f"{factors[0]:.2g}"
    )
    return (
        f"{gravity}, {_unit(factors)}: the nominal arm explains {best.overall:.0%} of what was not fitted "
        f"({other.overall:.0%} {other.reading}), at {spread} per N m of the nominal arm"
    )


def _unit(factors: np.ndarray) -> str:
    """What factors between a column and the nominal torque say of its unit."""
    size = np.abs(factors)
    turned = int((factors < 0).sum())
    sign = ""
    if turned:
        sign = ", its sign turned" + (
            "" if turned == len(factors) else f" on {turned} of {len(factors)} joints"
        )
    if TorqueUnit("current", factor=tuple(size.tolist())).is_ordinary:
        return "in N m of the joint" + sign
    return (
        "not in N m of the joint: amperes, the motor's side, or a share of a limit"
        + sign
    )


def _inner(segment: Segment) -> tuple[np.ndarray, ...]:
    """q, dq, ddq and torque of a segment without its ends."""
    m, rows = segment.motion, segment.inner
    assert segment.torque is not None
    return m.q[rows], m.dq[rows], m.ddq[rows], segment.torque[rows]


def _fit(
    reading: str,
    bodies: np.ndarray,
    dq: np.ndarray,
    ddq: np.ndarray,
    tau: np.ndarray,
) -> TorqueFit:
    """Fit on every second stretch, judged on those between."""
    stretches = np.arange(len(tau)) // max(1, len(tau) // STRETCHES)
    fitted = stretches % 2 == 0
    explained, by_bodies, factors = [], [], []
    for j in range(tau.shape[1]):
        direction = smooth_sign(dq[:, j], 0.02)
        others = [ddq[:, j], direction, dq[:, j], np.ones(len(tau))]
        design = np.column_stack([bodies[:, j], *others])
        with_bodies, found = _explained(design, tau[:, j], fitted)
        without, _ = _explained(design[:, 1:], tau[:, j], fitted)
        explained.append(with_bodies)
        by_bodies.append(with_bodies - max(without, 0.0))
        factors.append(found[0])
    return TorqueFit(
        reading, np.array(explained), np.array(by_bodies), np.array(factors)
    )


def _explained(
    design: np.ndarray, torque: np.ndarray, fitted: np.ndarray
) -> tuple[float, np.ndarray]:
    """Share of the variance that is explained where it was not fitted, and the coefficients."""
    found, *_ = np.linalg.lstsq(design[fitted], torque[fitted], rcond=None)
    asked = torque[~fitted]
    left = asked - design[~fitted] @ found
    return float(1.0 - left.var() / max(asked.var(), 1e-12)), found
