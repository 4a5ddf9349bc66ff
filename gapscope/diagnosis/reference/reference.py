"""The reference: the same arm, known to be healthy and without load, identified on its recordings."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gapscope.arm.case import Case
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.diagnosis.assessment.baseline import back_in_time
from gapscope.diagnosis.gap.torque_gap import torque_scale
from gapscope.diagnosis.reference.reference_rows import Rows, stack
from gapscope.diagnosis.thresholds import (
    LEAST_REFERENCE_SKEW,
    MOST_REFERENCE_SKEW,
    SAME_JOINT_PLACE,
    VENDOR_INERTIALS,
)
from gapscope.ident.identification import (
    Identification,
    IdentificationSettings,
    identify,
)
from gapscope.ident.signals.conditioning import position_cutoff
from gapscope.ident.signals.effective_samples import ar1_samples


@dataclass(frozen=True)
class Reference:
    """An arm identified on a reference, n joints, p parameters x of the model tau = W x.

    Attributes:
        case: the reference, its torque put back by the skew.
        result: the identification on all its recordings.
        precision: inverse covariance of x, what the recordings and the vendor's URDF say together, (p, p).
        rest: RMS left on stretches of the reference predicted from the others [N m], (n,).
        scale: normalisation of the torque gap on the reference [N m], (n,).
        skew: by which torque is ahead of the motion [s].
        torque_ratio: torque of the identified bodies over that of the vendor's [1].
    """

    case: Case
    result: Identification
    precision: np.ndarray
    rest: np.ndarray
    scale: np.ndarray
    skew: float
    torque_ratio: float

    @property
    def value(self) -> np.ndarray:
        """X of the identified arm, (p,)."""
        return self.result.physical.value


def check_same_arm(case: Case, reference: Case) -> None:
    """Check that two cases are of the same arm, joint by joint.

    Raises:
        InputError: another number of joints, other names, another order, or joints in other places.
    """
    ours, theirs, name = (
        list(case.arm.joints),
        list(reference.arm.joints),
        f"--against {reference.name}",
    )
    if len(ours) != len(theirs):
        raise InputError(
            f"has {len(theirs)} joints, {case.name} has {len(ours)}: another robot",
            "give a reference of the same arm",
            where=name,
        )
    if ours != theirs:
        how = (
            "in another order" if sorted(ours) == sorted(theirs) else "with other names"
        )
        raise InputError(
            f"has its joints {how}: {', '.join(theirs)}; {case.name} has {', '.join(ours)}",
            "give a reference of the same arm, with joints: in the order of the case",
            where=name,
        )
    first, second = RigidBody(case.arm).model, RigidBody(reference.arm).model
    apart = max(
        max(
            np.abs(a.translation - b.translation).max(),
            np.abs(a.rotation - b.rotation).max(),
        )
        for a, b in zip(first.jointPlacements, second.jointPlacements, strict=True)
    )
    if apart > SAME_JOINT_PLACE:
        raise InputError(
            "has joints of the same names in other places: another robot, or another version of its URDF",
            "give a reference of the same arm, and both cases the same kinematics",
            where=name,
        )
    if not np.allclose(case.arm.gravity, reference.arm.gravity, atol=0.05):
        raise InputError(
            f"has gravity {reference.arm.gravity.tolist()}, {case.name} has {case.arm.gravity.tolist()}",
            "give a reference that was recorded in the same mounting, or correct gravity:",
            where=name,
        )


def identify_reference(
    reference: Case, progress: Callable[[str], None] = lambda message: None
) -> Reference:
    """Identify an arm on all recordings of a reference.

    Raises:
        InputError: no torque, no motion, too short, torque in another unit; says what to do.
    """
    told = tuple(
        r for r in (*reference.recordings, *reference.judged) if r.tau is not None
    )
    reference = replace(
        reference,
        recordings=told or reference.recordings,
        judged=(told or reference.recordings)[-1:],
    )
    settings = IdentificationSettings(plain=True)
    result = identify(reference, settings, progress)
    rows = stack(result.columns, result.choice.law, told, position_cutoff(told))
    skew = _skew(rows, result.physical.value)
    if abs(skew) > LEAST_REFERENCE_SKEW:
        reference = back_in_time(reference, skew)
        told, result = reference.recordings, identify(reference, settings, progress)
        rows = stack(result.columns, result.choice.law, told, position_cutoff(told))
    law, columns = result.choice.law, result.columns
    prior = vendor_precision(rows, columns.scale(law))
    rest = _held_out(rows, columns.nominal(law), prior)
    left = rows.torque - rows.matrix @ result.physical.value
    weight = ar1_samples(left) / len(left) / np.maximum(rest, 1e-9) ** 2
    precision = np.einsum(
        "mjp,j,mjq->pq", rows.matrix, weight, rows.matrix, optimize=True
    ) + np.diag(prior)
    links = columns.links
    ours, vendor = (
        rows.matrix[:, :, :links] @ x[:links]
        for x in (result.physical.value, columns.nominal(law))
    )
    ratio = float((ours * vendor).sum() / max(float((vendor**2).sum()), 1e-12))
    return Reference(
        reference, result, precision, rest, torque_scale(rows.torque), skew, ratio
    )


def vendor_precision(rows: Rows, scale: np.ndarray) -> np.ndarray:
    """Diagonal of the prior precision of x, (p,).

    Inertials within ``VENDOR_INERTIALS`` of the URDF; for all else, of which a data sheet need not know, as much
    as makes twice the torque's deviation.
    """
    size = np.sqrt((rows.matrix**2).mean(axis=0))
    deviation = torque_scale(rows.torque)[:, None]
    wide = 2.0 / np.maximum((size / deviation).max(axis=0), 1e-9)
    return (
        np.where(
            np.isfinite(scale),
            VENDOR_INERTIALS * np.where(np.isfinite(scale), scale, 1.0),
            wide,
        )
        ** -2.0
    )


def _held_out(rows: Rows, nominal: np.ndarray, prior: np.ndarray) -> np.ndarray:
    """RMS left on each stretch when it is predicted from all others [N m], (n,)."""
    variance = rows.torque.var(axis=0)
    squares = np.zeros(rows.torque.shape[1])
    for _ in range(3):
        weight = 1.0 / np.maximum(variance, 1e-12)
        grams, rights = [], []
        for s in rows.stretches:
            w = rows.matrix[s]
            grams.append(np.einsum("mjp,j,mjq->pq", w, weight, w, optimize=True))
            rights.append(
                np.einsum("mjp,j,mj->p", w, weight, rows.torque[s] - w @ nominal)
            )
        squares = np.zeros_like(variance)
        for s, gram, right in zip(rows.stretches, grams, rights, strict=True):
            normal = sum(grams) - gram + np.diag(prior)
            x = nominal + _solved(normal, sum(rights) - right)
            squares += ((rows.torque[s] - rows.matrix[s] @ x) ** 2).sum(axis=0)
        variance = squares / len(rows.torque)
    return np.asarray(np.sqrt(variance))


def _solved(normal: np.ndarray, right: np.ndarray) -> np.ndarray:
    unit = 1.0 / np.sqrt(np.diag(normal))
    return np.asarray(
        unit * np.linalg.solve(normal * unit[:, None] * unit, unit * right)
    )


def _skew(rows: Rows, x: np.ndarray) -> float:
    """By how much torque is ahead of the motion [s]: least squares of the residual on the torque's rate and W."""
    left, n = rows.torque - rows.matrix @ x, rows.torque.shape[1]
    noise = np.maximum(left.std(axis=0), 1e-9)
    flat = (rows.matrix / noise[:, None]).reshape(-1, rows.matrix.shape[2])
    used = flat[:, np.linalg.norm(flat, axis=0) > 0]
    rate, y = (z.reshape(-1) for z in (rows.rate / noise, left / noise))
    basis = np.linalg.svd(used / np.linalg.norm(used, axis=0), full_matrices=False)
    u = basis[0][:, basis[1] > 1e-4 * basis[1][0]]
    rate = rate - u @ (u.T @ rate)
    skew = float(rate @ y / max(float(rate @ rate), 1e-12 * n))
    return float(np.clip(skew, -MOST_REFERENCE_SKEW, MOST_REFERENCE_SKEW))


def names_of(result: Identification, symbols: Sequence[str]) -> np.ndarray:
    """Places in x of the joints' own parameters of these symbols, joint by joint, (len(symbols), n)."""
    names = list(result.columns.names(result.choice.law))
    n = result.columns.arm.n_joints
    return np.array(
        [
            [names.index(f"{s}{j + 1}") for j in range(n)]
            for s in symbols
            if f"{s}1" in names
        ],
        dtype=int,
    )
