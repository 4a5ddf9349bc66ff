"""A residual network from samples to its model: rows, physics, folds, training and what it may be trusted with."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.lib.mixins import NDArrayOperatorsMixin
from scipy.linalg import cho_solve, lapack, solve_triangular
from scipy.optimize import minimize

from gapscope.arm.case import Case
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.io.json_file import plain
from gapscope.arm.motions.motion import Motion
from gapscope.arm.nearest_name import check_known
from gapscope.arm.recording import Recording
from gapscope.arm.root_mean_square import rms
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.residual import (
    ADDITIVE,
    FORMS,
    LOG_VARIANCE,
    Inputs,
    Layout,
    Network,
    ResidualNetwork,
    Trust,
    channels,
    draw_basis,
    nearest,
    part_of_each,
)
from gapscope.ident.model.base_parameters import ROUNDING, TINY, WORTH
from gapscope.ident.model.regressor import JOINT_COLUMNS, Regressor
from gapscope.ident.samples import MOVING, PER_CUTOFF, split
from gapscope.model.conditioning import (
    BY_CHANCE,
    FEWEST_ROWS,
    TORQUE_CUTOFF,
    Segment,
    condition,
    low_pass,
    pieces,
)
from gapscope.model.effective_samples import variance_inflation

# A residual network from samples to its model: rows, physics, folds, training and what it may be trusted with.


Progress = Callable[[str], None]
"""Called with a few words."""


def silent(message: str) -> None:
    """Say nothing."""


# How a residual network is trained.


TCN_LAYERS = 3
"""Layers of the convolution; each doubles the samples that are seen."""
PAST_OF_MLP = 4
"""Samples in the window of the feed-forward network."""
SPACING = 0.02
"""Time between the samples of a window [s]."""
BATCH = 128
"""Rows in a step of the optimiser."""
RATE = 4e-3
"""Rate of learning, by AdamW [1], whose decay of the weights is 1."""
BEST = "best"
"""The form that is chosen per joint, and what it is kept apart from, by recordings held out."""
APART = ("all", "effects")
"""What a network can be kept apart from, the strictest first."""


@dataclass(frozen=True)
class ResidualSettings:
    """Settings of a training.

    Attributes:
        form: ``additive``, ``mlp`` or ``tcn``; or ``best``: additive and MLP are trained, and each joint gets the one
            that predicts best what was held out.
        apart: what the output is kept apart from: ``all`` that inertial parameters, friction, rotors, offsets and
            effects can explain, or the parameters of the ``effects`` alone; or ``best``: of the effects alone if that
            closes more of what was held out.
        members: networks in the ensemble.
        hidden: units in a hidden layer.
        steps: of the optimiser.
        seed: of weights and batches.
    """

    form: str = BEST
    apart: str = BEST
    members: int = 5
    hidden: int = 24
    steps: int = 1000
    seed: int = 0

    def __post_init__(self) -> None:
        """Check what must be one of a few, and how many there are; a member learns what another holds out."""
        check_known("form", self.form, (BEST, *FORMS), where="form")
        check_known("choice", self.apart, (BEST, *APART), where="apart")
        for name, least in (("members", 2), ("hidden", 1), ("steps", 1)):
            if getattr(self, name) < least:
                raise InputError(f"give {least} or more", where=name)

    @property
    def forms(self) -> tuple[str, ...]:
        """What is trained."""
        return (ADDITIVE, "mlp") if self.form == BEST else (self.form,)

    @property
    def taps(self) -> int:
        """Samples in a window."""
        return int(2**TCN_LAYERS if self.form == "tcn" else PAST_OF_MLP)


# Keeping a network and the physics apart: projections on the columns of the physics, in weighted torque.


def basis(columns: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """Orthonormal basis Q of the columns, (M, n, p), each joint's rows divided by its scale [N m]; (M, n, r)."""
    if not columns.any():
        return np.zeros((*columns.shape[:2], 0))
    stacked = (columns / scale[None, :, None]).reshape(-1, columns.shape[2])
    norms = np.linalg.norm(stacked, axis=0)
    unit = stacked[:, norms > 0] / norms[norms > 0]
    u, size, _ = np.linalg.svd(unit, full_matrices=False)
    if size.size:
        u = u[:, size > ROUNDING * size[0]]
    return u.reshape(*columns.shape[:2], -1)


def share_explained(q: np.ndarray, torque: np.ndarray) -> float:
    """Share of the squares of a weighted torque, (M, n), that lies in the span of the columns."""
    inside = np.einsum("mnr,mn->r", q, torque)
    return float((inside**2).sum() / ((torque**2).sum() + TINY))


STIFFNESS = 0.1
"""Penalty of a change of a weight in the head, over the squares of what it sees: keeps the change small elsewhere."""


class Head(NamedTuple):
    """A joint's output as one linear head, f = Phi w over M rows, and how it can change; r directions of the physics.

    What it sees, Phi, (M, K), and its weights, (K,); L of the metric L L^T = Phi^T Phi + penalty of a change, (K, K);
    the part of the output in the physics, Q^T Phi, (r, K); and L^-1 (Q^T Phi)^T, (K, r).
    """

    seen: np.ndarray
    weight: np.ndarray
    root: np.ndarray
    inside: np.ndarray
    turned: np.ndarray


def heads_of(
    networks: Sequence[Network],
    hidden: Sequence[np.ndarray],
    chosen: np.ndarray,
    members: Sequence[int],
    q: np.ndarray,
    fitted: np.ndarray,
) -> dict[int, Head]:
    """The mean of some members of the network that speaks on each joint as one linear head, by joint from 0.

    Args:
        networks: one per form.
        hidden: what the heads of the members of each see, (members, n, M, .), or (1, n, M, .) if all see the same:
            these have one mean weight, the others share the mean of their outputs.
        chosen: number of the network of each joint, -1 for none, (n,).
        members: that count.
        q: orthonormal columns of the physics in weighted torque on the rows that are fitted.
        fitted: these rows, (M,).
    """
    heads = {}
    for j, k in enumerate(chosen.tolist()):
        if k < 0:
            continue
        weight = networks[k].weights[-1][members, j, :, 0]
        own = hidden[k][:, j] if len(hidden[k]) == 1 else hidden[k][members, j]
        if len(own) == 1:
            weight = weight.mean(axis=0)
        count = own.shape[1]
        flat = own.transpose(1, 0, 2).reshape(count, -1) / len(own)
        seen = np.hstack([flat, np.ones((count, 1))])
        offset = networks[k].biases[-1][members, j, 0].mean()
        phi = seen[fitted]
        spread = np.append(phi[:, :-1].var(axis=0), 1.0)
        metric = phi.T @ phi + np.diag(STIFFNESS * len(phi) * spread)
        # regular even if hidden units saturate
        metric += 1e-9 * np.trace(metric) / len(metric) * np.eye(len(metric))
        root, inside = np.linalg.cholesky(metric), q[:, j].T @ phi
        turned = solve_triangular(root, inside.T, lower=True)
        heads[j] = Head(seen, np.append(weight, offset), root, inside, turned)
    return heads


def project_heads(
    heads: dict[int, Head], weights: dict[int, np.ndarray]
) -> dict[int, np.ndarray]:
    """Weights of linear heads, changed as little as can be, whose output is orthogonal to the columns.

    Minimises the sum over joints of |Phi dw|^2 + dw^T penalty dw subject to Q^T Phi (w + dw) = 0: one constraint
    per direction of the physics. If there are fewer weights than constraints, the constraints hold as nearly as
    possible (least squares).

    Args:
        heads: by joint, from 0.
        weights: of the joints that speak, w, each (K,).

    Returns:
        The weights by joint, each (K,).
    """
    if not weights:
        return {}
    turned = np.concatenate([heads[joint].turned for joint in weights])
    inside = sum(heads[joint].inside @ w for joint, w in weights.items())
    # in z = L^T dw the least change is the solution of least norm
    z = np.linalg.lstsq(turned.T, -inside, rcond=1e-12)[0]
    cuts = np.cumsum([len(w) for w in weights.values()])[:-1]
    changes = zip(weights, np.split(z, cuts), strict=True)
    return {
        joint: weights[joint]
        + solve_triangular(heads[joint].root, part, lower=True, trans="T")
        for joint, part in changes
    }


def parameter_moves(
    columns: np.ndarray, torque: np.ndarray, residual: np.ndarray, group: np.ndarray
) -> np.ndarray:
    """By how many standard deviations parameters would move if refitted with a torque in place; shape (k,).

    The move is (T^T T)^+ T^T f, its standard deviation that of a fit to the data, the noise counted by its
    autocorrelation.

    Args:
        columns: T of the parameters, in weighted torque, (M, n, k).
        torque: f in weighted torque, (M, n).
        residual: of the data without f, in weighted torque, (M, n).
        group: trajectory of each row, (M,).
    """
    if columns.shape[2] == 0:
        return np.zeros(0)
    stacked = columns.reshape(-1, columns.shape[2])
    norms = np.maximum(np.linalg.norm(stacked, axis=0), TINY)
    unit = stacked / norms
    gram = np.linalg.pinv(unit.T @ unit, rcond=1e-10, hermitian=True)
    noise = (residual**2).mean(axis=0) * variance_inflation(residual, group)
    by_joint = unit.reshape(columns.shape)
    spread = np.einsum("mnk,mnl,n->kl", by_joint, by_joint, noise)
    variance = np.diag(gram @ spread @ gram)
    move = gram @ (unit.T @ torque.ravel())
    return np.abs(move) / np.sqrt(np.clip(variance, TINY, None))


# Columns of the physics: what effects and inertial parameters can explain, which a network must not learn.


NOT_LINEAR = ("link", "start", "end", "cycles")
"""Parameters that the torque has no useful derivative by."""
STEP = np.sqrt(ROUNDING)
"""Step of the differences, over the parameter's typical size."""


def effect_columns(
    corrected: CorrectedArm, body: RigidBody, motion: Motion
) -> np.ndarray:
    """Derivatives of the predicted torque by the parameters of the effects, (N, n, k).

    Central differences, one-sided at a parameter's bound.
    """
    physical = replace(corrected.unlimited, residual=None)
    columns = [np.zeros((*motion.q.shape, 0))]
    for k, applied in enumerate(physical.effects):
        before, after = physical.effects[:k], physical.effects[k + 1 :]
        for parameter in map(applied.effect.parameter, applied.given):
            if parameter.name in NOT_LINEAR:
                continue
            value = np.array(applied.parameters[parameter.name], dtype=float)
            size = np.maximum(np.abs(value), abs(parameter.typical[1]))
            for i in np.ndindex(value.shape):
                torques, places = [], []
                for side in (-STEP, STEP):
                    moved = value.copy()
                    moved[i] = np.clip(value[i] + side * size[i], *parameter.bounds)
                    parameters = {**applied.parameters, parameter.name: moved}
                    one = AppliedEffect(applied.name, applied.joints, parameters)
                    arm = replace(physical, effects=(*before, one, *after))
                    torques.append(arm.predict(body, motion))
                    places.append(moved[i])
                slope = (torques[1] - torques[0]) / (places[1] - places[0])
                columns.append(slope[:, :, None])
    return np.concatenate(columns, axis=2)


# What a residual network is trained on: trajectories with the residual of their torque, and their rows.


EDGE = 0.2
"""Time left out at both ends of a block [s], so that what lies in one is no neighbour of what lies in another."""


@dataclass(frozen=True)
class Trajectory:
    """One trajectory, N samples of n joints on a uniform grid, M rows that count.

    Attributes:
        name: of the recording.
        motion: its motion.
        load: torque that is predicted without a network [N m], (N, n).
        residual: recorded minus predicted torque, low-passed [N m], (N, n).
        columns: of the physics, low-passed, at the rows only, (M, n, p).
        parameters: columns of the effects' parameters alone, likewise, (M, n, k).
        rows: samples that count, (M,).
    """

    name: str
    motion: Motion
    load: np.ndarray
    residual: np.ndarray
    columns: np.ndarray
    parameters: np.ndarray
    rows: np.ndarray


def from_segment(
    corrected: CorrectedArm, body: RigidBody, segment: Segment
) -> Trajectory:
    """A segment with torque, and the residual of a corrected arm."""
    assert segment.torque is not None
    physical = replace(corrected, residual=None)
    motion, body = segment.motion, segment.bodies(body)
    # trimmed samples, as many as the band of the torque gap holds
    step = max(1, int(motion.rate / (PER_CUTOFF * TORQUE_CUTOFF) + 1e-6))
    rows = np.arange(segment.inner.start, segment.inner.stop, step)

    def smooth(series: np.ndarray) -> np.ndarray:
        return low_pass(series, motion.rate, TORQUE_CUTOFF)

    load = physical.unlimited.predict(body, motion)
    recorded = smooth(physical.delivered(segment.torque, motion))
    parameters = smooth(effect_columns(physical, body, motion))[rows]
    linear = Regressor(physical.arm, body, JOINT_COLUMNS).matrix(motion)
    return Trajectory(
        name=segment.recording,
        motion=motion,
        load=load,
        residual=recorded - smooth(load),
        # they depend on each other; what counts is what they span together
        columns=np.concatenate([smooth(linear)[rows], parameters], axis=2),
        parameters=parameters,
        rows=rows,
    )


def groups(trajectories: Sequence[Trajectory], members: int) -> np.ndarray:
    """Group of each row of all trajectories, for a split by trajectory, (M,); -1 if a row belongs to none.

    With three trajectories or more each is a group; fewer are cut into blocks of time, at least one per member.

    Raises:
        InputError: there is no trajectory.
    """
    if not trajectories:
        raise InputError("no trajectory to train on", "give recordings with a torque")
    # held out by trajectory, which is stricter than by time
    if len(trajectories) > 2:
        lengths = [len(x.rows) for x in trajectories]
        return np.repeat(np.arange(len(trajectories)), lengths)
    blocks = -(-members // len(trajectories))  # rounded up
    out = []
    for k, trajectory in enumerate(trajectories):
        t = trajectory.motion.t[trajectory.rows]
        cuts = np.linspace(t[0], t[-1], blocks + 1)
        block = np.clip(np.searchsorted(cuts, t, side="right") - 1, 0, blocks - 1)
        # rows near a cut have neighbours in the next block: they belong to none
        to_cut = np.abs(t[:, None] - cuts[None, 1:-1]).min(axis=1, initial=np.inf)
        out.append(np.where(to_cut > EDGE, k * blocks + block, -1))
    return np.concatenate(out)


# Rows of all trajectories as a residual network sees them.


REACH = 1.0 - BY_CHANCE
"""Quantile of the distance of held-out rows from the others up to which a network is tested, and trusted in full."""
QUIET = 0.1
"""A recording weighs as if its RMS were at least this share of the loudest one's."""


@dataclass(frozen=True)
class ResidualRows:
    """Rows of all trajectories, N of n joints, in weighted torque, over ``scale``; M members hold some out.

    What counts is the share of its own squares that is left of each group: a group with a large residual would
    otherwise outvote those in which the same function does harm.

    Attributes:
        inputs: what a network sees.
        windows: of the rows, (n, N, taps, C).
        residual: of the corrected arm [1], (N, n).
        target: what the columns of the physics do not explain of it [1], (N, n).
        q: orthonormal columns of the physics, (N, n, r).
        parameters: columns of the effects' parameters, (N, n, k).
        group: for a split by trajectory, (N,); -1 is neither fitted nor held out.
        trajectory: of each row, (N,).
        reach: distance of an input up to which a network is tested on rows that it has not seen [1], (n,).
        scale: RMS of the residual [N m], (n,).
        held: rows that each member holds out, the groups m, m + members, ..., (M, N).
        targets: residual without what the physics explains of it in the rows that the member is fitted to, (M, N, n).
        weight: one over the RMS of the row's group, per joint, over its RMS over all rows, (N, n).
    """

    inputs: Inputs
    windows: np.ndarray
    residual: np.ndarray
    target: np.ndarray
    q: np.ndarray
    parameters: np.ndarray
    group: np.ndarray
    trajectory: np.ndarray
    reach: np.ndarray
    scale: np.ndarray
    held: np.ndarray
    targets: np.ndarray
    weight: np.ndarray

    @property
    def fitted(self) -> np.ndarray:
        """Rows that each member is fitted to, (M, N)."""
        return (self.group >= 0) & ~self.held

    def held_out(self, outputs: np.ndarray) -> np.ndarray:
        """Each row as the members that held it out predict it, from the outputs of all, (M, N, ...); (N, ...)."""
        held = self.held.reshape(*self.held.shape, *[1] * (outputs.ndim - 2))
        total = np.maximum(held.sum(axis=0), 1)
        return (outputs * held).sum(axis=0) / total


def rows_of(
    trajectories: Sequence[Trajectory], settings: ResidualSettings
) -> ResidualRows:
    """Rows of trajectories as a network sees them, and the groups that each member of an ensemble holds out."""
    members = settings.members
    group = groups(trajectories, members)
    residual = np.concatenate([x.residual[x.rows] for x in trajectories])
    scale = rms(residual) + TINY
    weighted = residual / scale
    inputs = _inputs(trajectories, settings)
    windows = np.concatenate(
        [inputs.windows(x.motion, x.load, x.rows) for x in trajectories], axis=1
    )
    every = settings.apart == "all"
    apart = [x.columns if every else x.parameters for x in trajectories]
    q = basis(np.concatenate(apart), scale)
    parameters = np.concatenate([x.parameters for x in trajectories])
    lengths = [len(x.rows) for x in trajectories]
    near = windows[:, :, -1, inputs.layout.neighbourhood]
    counted = group >= 0
    held = np.stack([(group % members == m) & counted for m in range(members)])
    held = held[held.any(axis=1)]
    targets = []
    for fitted in counted & ~held:
        gram = np.einsum("mnr,mns->rs", q[fitted], q[fitted])
        moment = np.einsum("mnr,mn->r", q[fitted], weighted[fitted])
        explaining = np.linalg.pinv(gram, rcond=1e-10, hermitian=True) @ moment
        targets.append(weighted - q @ explaining)
    # one over the RMS of each row's group, per joint
    each, place = np.unique(group, return_inverse=True)
    square = np.stack([(weighted[group == g] ** 2).mean(axis=0) for g in each])
    square = np.maximum(square, QUIET**2 * square.max(axis=0))
    weight = 1.0 / np.sqrt(np.maximum(square, TINY))[place]
    return ResidualRows(
        inputs=inputs,
        windows=windows,
        residual=weighted,
        target=weighted - q @ np.einsum("mnr,mn->r", q, weighted),
        q=q,
        parameters=parameters / scale[None, :, None],
        group=group,
        trajectory=np.repeat(np.arange(len(trajectories)), lengths),
        reach=_reach(near, group),
        scale=scale,
        held=held,
        targets=np.stack(targets),
        weight=weight / rms(weight),
    )


def _inputs(trajectories: Sequence[Trajectory], settings: ResidualSettings) -> Inputs:
    """Inputs of the network, with their scales over the rows."""
    series = [channels(x.motion, x.load)[:, x.rows] for x in trajectories]
    seen = np.concatenate(series, axis=1)
    n = len(seen)
    layout = Layout(n)
    mean, std = seen.mean(axis=1), rms(seen, axis=1)
    # signals keep their zero, at which friction and load turn; postures have none
    mean[:, : layout.angle] = 0.0
    posture = slice(layout.angle, None)
    std[:, posture] = seen[:, :, posture].std(axis=1)
    # a joint that hardly moved must not be blown up
    least = 0.1 * std.max(axis=0)
    least[layout.direction] = least[posture] = 0.2
    least[layout.memory] = 0.0
    return Inputs(
        n=n,
        taps=settings.taps,
        spacing=SPACING,
        mean=mean,
        std=np.maximum(std, least) + TINY,
    )


def _reach(now: np.ndarray, group: np.ndarray) -> np.ndarray:
    """Quantile ``REACH`` of the distance of each row's input, of (n, M, C), from the nearest of another group, (n,)."""
    distances = [np.zeros((len(now), 0))]
    for g in np.unique(group[group >= 0]):
        others = now[:, (group != g) & (group >= 0)]
        if others.shape[1]:
            # a thousand of them show the distance well enough
            thinned = others[:, :: max(1, others.shape[1] // 1000)]
            distances.append(nearest(now[:, group == g], thinned))
    every = np.concatenate(distances, axis=1)
    return np.quantile(every, REACH, axis=1) if every.size else np.zeros(len(now))


# Weights of a sum of functions whose sizes, part by part, are chosen by the evidence of the data.


ITERATIONS = 25
"""Iterations of the search."""


class Equations(NamedTuple):
    """Normal equations of a weighted fit to N rows of F functions: X^T X, X^T y, y^T y and N."""

    gram: np.ndarray
    moment: np.ndarray
    square: float
    rows: float


def _posterior(
    equations: Equations, part: np.ndarray, logs: np.ndarray, share: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """With D the deviations of the weights and s / v share over noise, for s |y - X w|^2 / v + |D^-1 w|^2.

    Args:
        equations: of the fit.
        part: number of the part that each function belongs to, (F,).
        logs: logarithm of each part's variance, shared evenly by its functions, and of the noise variance, (P + 1,).
        share: share of the rows that count as independent [1].

    Returns:
        Cholesky factor of 1 + D X^T X D s / v, D X^T y s / v, the mean of the weights over D, and D; (F, F) and (F,).
    """
    variance = np.exp(logs[:-1]) / np.bincount(part)
    d = np.sqrt(variance[part])
    precision = share / np.exp(logs[-1])
    matrix = (d[:, None] * equations.gram * d) * precision
    matrix[np.diag_indices_from(matrix)] += 1.0
    factor, scaled = np.linalg.cholesky(matrix), d * equations.moment * precision
    return factor, scaled, cho_solve((factor, True), scaled), d


def _evidence_cost(
    logs: np.ndarray, equations: Equations, part: np.ndarray, share: float
) -> tuple[float, np.ndarray]:
    """Negative logarithm of the evidence, and its gradient by the logarithms, (P + 1,). Source: mackay1992."""
    factor, scaled, unit, d = _posterior(equations, part, logs, share)
    w, noise = d * unit, np.exp(logs[-1])
    inverse = lapack.dtrtri(factor, lower=1)[0]
    posterior = (inverse**2).sum(axis=0)
    count = share * equations.rows
    cost = 0.5 * (share * equations.square / noise - scaled @ unit)
    cost += np.log(np.diag(factor)).sum() + 0.5 * count * logs[-1]
    by_size = 0.5 * np.bincount(part, 1.0 - posterior - unit**2)
    left = equations.square - 2 * w @ equations.moment + w @ equations.gram @ w
    determined = len(w) - posterior.sum()
    by_noise = 0.5 * (count - share * left / noise - determined)
    return float(cost), np.append(by_size, by_noise)


# How good each member is on the rows that it holds out.


GAINS = np.linspace(0.05, 1.0, 20)
"""Factors tried on a joint's output."""


def shares_closed(
    group: np.ndarray, residual: np.ndarray, predicted: np.ndarray
) -> np.ndarray:
    """Share of each group's squares that a prediction closes at each factor of ``GAINS``, (groups, n, factors).

    Args:
        group: of each row, (N,); -1 does not count.
        residual: over its scale [1], (N, n).
        predicted: by the members that held each row out, (N, n).
    """
    shares = []
    for g in np.unique(group[group >= 0]):
        y, f = residual[group == g], predicted[group == g]
        size = np.maximum((y**2).sum(axis=0), TINY)
        agreement, square = (y * f).sum(axis=0) / size, (f**2).sum(axis=0) / size
        shares.append(np.outer(agreement, 2 * GAINS) - np.outer(square, GAINS**2))
    return np.stack(shares)


def usefulness(
    shares: np.ndarray, strict: bool = False
) -> tuple[np.ndarray, np.ndarray]:
    """Share of the squares closed on rows held out, mean over the groups, and the factor for it; each (n,).

    The factor on a joint's output is the one of ``GAINS`` with the largest share, less its standard error over the
    groups, at which no group is left with more than ``WORTH`` above its squares. It is 0 if that share less its
    error is below ``WORTH``.

    Args:
        shares: of each group, at each factor, see ``shares_closed``.
        strict: every group by itself must close ``WORTH`` after that error is taken off: a motion that is in none
            of the groups is then likely to gain as well.
    """
    worst, mean = shares.min(axis=0), shares.mean(axis=0)
    error = shares.std(axis=0, ddof=1) / np.sqrt(len(shares))
    harmless = worst - error >= WORTH if strict else worst >= -WORTH
    certain = np.where(harmless, mean - error, 0.0)
    best = certain.argmax(axis=1)
    joints = np.arange(len(best))
    of_use = certain[joints, best] >= WORTH
    return (
        np.where(of_use, mean[joints, best], 0.0),
        np.where(of_use, GAINS[best], 0.0),
    )


# Fit of the additive form: per joint a sum of fixed functions, its parts sized by the evidence.


SHARES = (1.0, 0.2, 0.03)
"""Shares of the rows tried as independent; the one that predicts held-out rows best is kept."""


def fit_additive(rows: ResidualRows, seed: int, progress: Progress = silent) -> Network:
    """Fit an ensemble; each member is fitted without the rows that it holds out.

    Args:
        rows: all rows.
        seed: of the random waves.
        progress: called with a few words at each joint.
    """
    now = rows.windows[:, :, -1]
    basis = draw_basis(now.min(axis=1), now.max(axis=1), seed)
    part = part_of_each(basis)
    # the constant is a part of its own
    parts = np.append(part, part.max() + 1)
    members, n, judged = len(rows.held), len(now), rows.held.any(axis=0)
    heads = np.zeros((members, n, len(part), 2))
    bias = np.zeros((members, n, 2))
    for joint, functions in enumerate(basis.features(now)):
        progress(f"fits the additive form: joint {joint + 1} of {n}")
        centre, spread = functions.mean(axis=0), functions.std(axis=0) + 1e-9
        x = np.column_stack([(functions - centre) / spread, np.ones(len(functions))])
        target, weight = rows.target[:, joint], rows.weight[:, joint]
        size = float(rms(target)) or 1.0
        each = []
        # of all rows, and of those that each member is fitted to
        for y, chosen in (
            (target, rows.group >= 0),
            *zip(rows.targets[..., joint], rows.fitted, strict=True),
        ):
            wx = weight[chosen, None] * x[chosen]
            wy = weight[chosen] * y[chosen] / size
            each.append(Equations(wx.T @ wx, wx.T @ wy, float(wy @ wy), len(wy)))
        # at first each part, and the noise, may be all of the target
        logs, least = np.zeros(int(parts.max()) + 2), np.inf
        for share in SHARES:
            # sizes under which the data are most probable, from those of the share before
            logs = minimize(
                _evidence_cost,
                logs,
                args=(each[0], parts, share),
                jac=True,
                method="L-BFGS-B",
                bounds=[LOG_VARIANCE] * len(logs),
                options={"maxiter": ITERATIONS},
            ).x
            means = []
            for own in each[1:]:
                *_, unit, d = _posterior(own, parts, logs, share)
                means.append(d * unit)
            found = size * np.stack(means)
            left = rows.residual[:, joint] - rows.held_out(found @ x.T)
            error = float(np.mean((weight * left)[judged] ** 2))
            if error < least:
                least, kept, noise = error, found, np.mean(left[judged] ** 2)
        # the head sees the functions as they are
        by_function = kept[:, :-1] / spread
        heads[:, joint, :, 0] = by_function
        bias[:, joint, 0] = kept[:, -1] - by_function @ centre
        bias[:, joint, 1] = np.clip(np.log(noise), *LOG_VARIANCE)
    return Network(ADDITIVE, np.zeros(0, int), (heads,), (bias,), basis)


# Training of a residual network by torch: a heteroscedastic ensemble, bitwise repeatable.


EVERY = 250
"""Steps between two reports of progress."""


@contextmanager
def repeatable(seed: int) -> Iterator[torch.Generator]:
    """One thread and deterministic kernels: the same numbers on every run; the settings come back afterwards."""
    threads, strict = (
        torch.get_num_threads(),
        torch.are_deterministic_algorithms_enabled(),
    )
    torch.set_num_threads(1)
    torch.use_deterministic_algorithms(True, warn_only=True)
    try:
        yield torch.Generator().manual_seed(seed)
    finally:
        torch.set_num_threads(threads)
        torch.use_deterministic_algorithms(strict)


class Tensor(NDArrayOperatorsMixin):
    """A tensor on which numpy's functions work: what they compute torch computes, and can differentiate and export."""

    def __init__(self, tensor: torch.Tensor) -> None:
        self.tensor = tensor

    @property
    def shape(self) -> torch.Size:
        """Its shape."""
        return self.tensor.shape

    def _plain(self, x: Any) -> Any:
        """A tensor out of numbers or a ``Tensor``; what is no number as it is."""
        if isinstance(x, Tensor):
            return x.tensor
        if isinstance(x, (list, tuple)):
            return [self._plain(part) for part in x]
        own = self.tensor
        return (
            x if x is None else torch.as_tensor(x, dtype=own.dtype, device=own.device)
        )

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any) -> Tensor:
        """Arithmetic and elementary functions: torch calls them as numpy does."""
        function = torch.pow if ufunc is np.power else getattr(torch, ufunc.__name__)
        return Tensor(function(*map(self._plain, inputs)))

    def __array_function__(
        self, function: Any, types: Any, args: Any, kwargs: Any
    ) -> Any:
        """``clip``, ``concatenate``; ``split`` into a number of parts."""
        if function is np.split:
            parts = torch.tensor_split(self.tensor, args[1], kwargs["axis"])
            return [Tensor(part) for part in parts]
        called = getattr(torch, function.__name__)
        return Tensor(called(*map(self._plain, args), **kwargs))

    def __getitem__(self, key: Any) -> Tensor:
        """Slices, places and new axes."""
        return Tensor(self.tensor[key])

    def reshape(self, *shape: int) -> Tensor:
        """In another shape."""
        return Tensor(self.tensor.reshape(*shape))

    def transpose(self, *axes: int) -> Tensor:
        """With its axes in another order."""
        return Tensor(self.tensor.permute(*axes))

    def sum(self, axis: int) -> Tensor:
        """Sum over an axis."""
        return Tensor(self.tensor.sum(dim=axis))

    def min(self, axis: int) -> Tensor:
        """Least value along an axis."""
        return Tensor(self.tensor.amin(dim=axis))


def begun(
    settings: ResidualSettings,
    inputs: Inputs,
    generator: torch.Generator,
    where: torch.device | str = "cpu",
) -> Network:
    """A network whose weights are tensors to be trained, of all members and joints.

    Args:
        settings: of the training.
        inputs: what the networks see.
        generator: of the first weights.
        where: the device.
    """
    width, n = settings.hidden, inputs.n
    if settings.form == "mlp":
        seen = inputs.seen_by_mlp
        sizes = [(len(seen), width), (width, width), (width, 2)]
    else:
        # each layer joins two neighbours of the layer before
        seen = np.arange(inputs.taps * inputs.channels)
        first, last = (2 * inputs.channels, width), (width, 2)
        sizes = [first, *[(2 * width, width)] * (TCN_LAYERS - 1), last]
    weights: list[Any] = []
    biases: list[Any] = []
    for k, (fan_in, fan_out) in enumerate(sizes):
        # the head begins near zero: no torque before there is a reason
        gain = (1.0 if k + 1 < len(sizes) else 0.1) / fan_in**0.5
        shape = (settings.members, n, fan_in, fan_out)
        weight = gain * torch.randn(shape, generator=generator)
        bias = torch.zeros(settings.members, n, fan_out)
        for parts, part in ((weights, weight), (biases, bias)):
            parts.append(Tensor(part.to(where).requires_grad_()))
    return Network(settings.form, seen, tuple(weights), tuple(biases))


def as_arrays(network: Network) -> Network:
    """A network of tensors as one of arrays."""
    weights, biases = (
        tuple(x.tensor.detach().cpu().double().numpy() for x in parts)  # type: ignore[attr-defined]
        for parts in (network.weights, network.biases)
    )
    return replace(network, weights=weights, biases=biases)


def train(
    settings: ResidualSettings, rows: ResidualRows, progress: Progress
) -> Network:
    """Train an ensemble for a fixed number of steps, each member without the rows that it holds out.

    What is held out chooses neither weights nor the end, so that it can judge the members after.

    Args:
        settings: of the training.
        rows: all rows.
        progress: called with a few words at times.

    Source: seitzer2022.
    """
    with repeatable(settings.seed) as generator:
        where = torch.device("cuda" if torch.cuda.is_available() else "cpu")
        network = begun(settings, rows.inputs, generator, where)

        def tensor(array: np.ndarray) -> torch.Tensor:
            return torch.as_tensor(array, dtype=torch.float32, device=where)

        x = tensor(rows.windows)
        y = tensor(rows.targets.transpose(0, 2, 1))
        square = tensor(rows.weight.T**2)
        fitted = tensor(rows.fitted)[:, None] * square
        trained = [x.tensor for x in (*network.weights, *network.biases)]  # type: ignore[attr-defined]
        optimiser = torch.optim.AdamW(trained, lr=RATE, weight_decay=1.0)
        schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, settings.steps)
        for step in range(1, settings.steps + 1):
            chosen = torch.randint(x.shape[1], (BATCH,), generator=generator)
            chosen = chosen.to(where)
            optimiser.zero_grad(set_to_none=True)
            mask = fitted[:, :, chosen]
            said: Any = network.outputs(Tensor(x[:, chosen]))  # type: ignore[arg-type]
            mean, log_variance = (own.tensor for own in said)
            # the likelihood times the deviation, so that rows of large variance are not given up early (seitzer2022)
            missed = 0.5 * (
                log_variance + (y[:, :, chosen] - mean) ** 2 / log_variance.exp()
            )
            loss = missed * log_variance.detach().exp().sqrt() * mask
            # mean over the rows that a member is fitted to, sum over members and joints
            mean_loss = loss.sum(dim=2) / mask.sum(dim=2).clamp(min=1e-9)
            mean_loss.sum().backward()
            optimiser.step()
            schedule.step()
            if step % EVERY == 0:
                progress(
                    f"trains the {settings.form.upper()}: step {step} of {settings.steps}"
                )
        return as_arrays(network)


# Which joints a network speaks on, and how loud: judged after the projection, on what members had held out.


def settled(
    chosen: np.ndarray,
    gain: np.ndarray,
    networks: Sequence[Network],
    hidden: Sequence[np.ndarray],
    rows: ResidualRows,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The choice scaled and silenced until what the projection leaves of it stands the strict ``usefulness`` as it is.

    All joints share the constraints of the projection, so that a joint that is silenced or scaled changes the others:
    each round silences one joint or scales some, and judges all again. A joint whose factor would fall below the least
    of ``GAINS`` counts as failing, so that it ends.

    Args:
        chosen: number of the network of each joint before the projection, -1 for none, (n,).
        gain: factor on its output [1], (n,).
        networks: one per form, not scaled.
        hidden: what the heads of each see on all rows, (members or 1, n, N, K).
        rows: all rows.

    Returns:
        The same two after it, and the share of the squares held out that is closed [1], (n,).
    """
    members = []
    for member, fitted in enumerate(rows.fitted):
        q = basis(rows.q[fitted], np.ones(rows.q.shape[1]))
        members.append(heads_of(networks, hidden, chosen, [member], q, fitted))
    while True:
        predicted = np.zeros((len(members), *rows.residual.shape))
        for output, heads in zip(predicted, members, strict=True):
            speaking = {j: head for j, head in heads.items() if chosen[j] >= 0}
            weights = {j: gain[j] * head.weight for j, head in speaking.items()}
            for j, weight in project_heads(speaking, weights).items():
                output[:, j] = heads[j].seen @ weight
        held_out = rows.held_out(predicted)
        shares = shares_closed(rows.group, rows.residual, held_out)
        closed, again = usefulness(shares, strict=True)
        if (again[chosen >= 0] == 1.0).all():
            return chosen, np.where(chosen >= 0, gain, 0.0), closed
        failing = np.flatnonzero((chosen >= 0) & (gain * again < GAINS[0]))
        if failing.size:
            # the others may stand once the one that harms a group most is silent
            as_it_is = shares[:, failing, -1].min(axis=0)
            silent = failing[as_it_is.argmin()]
            chosen = np.where(np.arange(len(chosen)) == silent, -1, chosen)
        else:
            gain = gain * again


# From trajectories to a residual network orthogonal to the effects that fades out away from its training data.


LANDMARKS = 200
"""Number of training inputs kept as landmarks, from which the distance of an input is measured."""


@dataclass(frozen=True)
class Report:
    """Results of a training, on the rows that it was trained on; n joints.

    Attributes:
        by_form: share of the squares that each form closes on groups that its members had held out, mean over the
            groups, at the best factor [1], each (n,).
        form: what was chosen on each joint, empty if nothing is better.
        closed: that share of the chosen form, kept apart from the physics [1], (n,); 0 if none was chosen.
        apart: what the network is kept apart from, ``all`` or ``effects``.
        closed_apart: mean of ``closed`` by what a network was kept apart from, of all that were tried [1].
        gain: factor on each joint's output [1], (n,); 0 if none was chosen.
        in_target: share of the residual's squares that lay in the span of the physics and was taken out [1].
        in_output: the same of the network's output, before and after the projection of the heads [1].
        moves: by how many standard deviations each parameter of the effects would move if it were refitted with the
            network in place, before and after the projection; each (k,).
    """

    by_form: dict[str, np.ndarray]
    form: tuple[str, ...]
    closed: np.ndarray
    apart: str
    closed_apart: dict[str, float]
    gain: np.ndarray
    in_target: float
    in_output: tuple[float, float]
    moves: tuple[np.ndarray, np.ndarray]


def fit_residual(
    trajectories: Sequence[Trajectory],
    settings: ResidualSettings,
    progress: Progress = silent,
) -> tuple[ResidualNetwork, Report]:
    """Train a residual network on the residual of the corrected arm on some trajectories.

    The columns of the physics are taken out of the target and the members of each form are trained. Each joint gets
    the form that closes most of the groups that its members had held out, scaled to what harms none of them, or none.
    The heads are then changed as little as can be so that the output is orthogonal to the columns over the rows; that
    is done for each member by itself first, and what it closes of the groups that it held out decides again, until no
    joint is scaled or silenced any more (``settled``).

    Raises:
        InputError: there is no trajectory.
    """
    if settings.apart == BEST:
        # apart from all, unless that from the effects alone closes more, by as much as gives a say
        strict, free = (
            fit_residual(trajectories, replace(settings, apart=apart), progress)
            for apart in APART
        )
        by_apart = strict[1].closed_apart | free[1].closed_apart
        better = by_apart[free[1].apart] - by_apart[strict[1].apart] >= WORTH
        network, report = free if better else strict
        return network, replace(report, closed_apart=by_apart)
    rows = rows_of(trajectories, settings)
    # a member for each group that is held out: few recordings make few
    settings = replace(settings, members=len(rows.held))
    networks = []
    closed = []
    gain = []
    for form in settings.forms:
        if form == ADDITIVE:
            trained = fit_additive(rows, settings.seed, progress)
        else:
            trained = train(replace(settings, form=form), rows, progress)
        # what it is worth on rows held out
        outputs = trained.outputs(rows.windows)[0].transpose(0, 2, 1)
        held_out = rows.held_out(outputs)
        worth = usefulness(shares_closed(rows.group, rows.residual, held_out))
        networks.append(trained)
        closed.append(worth[0])
        gain.append(worth[1])
    progress("keeps it apart from the physics")
    # the best of each joint, before it is kept apart
    best, joints = np.argmax(closed, axis=0), np.arange(len(rows.scale))
    first = np.array(gain)[best, joints]
    hidden = [own.hidden(rows.windows) for own in networks]
    chosen, final, left = settled(
        np.where(first > 0, best, -1), first, networks, hidden, rows
    )
    members, everywhere = list(range(settings.members)), np.ones(len(rows.q), bool)
    heads = heads_of(networks, hidden, chosen, members, rows.q, everywhere)
    weights = {j: final[j] * head.weight for j, head in heads.items()}
    projected = project_heads(heads, weights)
    before, after = np.zeros_like(rows.residual), np.zeros_like(rows.residual)
    kept = [_scaled(own, final) for own in networks]
    for j, weight in projected.items():
        before[:, j], after[:, j] = heads[j].seen @ weights[j], heads[j].seen @ weight
        own, change = kept[chosen[j]], weight - weights[j]
        # members that see the same share one change
        width = own.weights[-1].shape[2]
        own.weights[-1][:, j, :, 0] += change[:-1].reshape(-1, width)
        own.biases[-1][:, j, 0] += change[-1]
    # landmarks spread over the inputs seen, and the radius within which everything seen lies
    near = rows.windows[:, :, -1, rows.inputs.layout.neighbourhood]
    landmarks = np.stack([_spread(points, LANDMARKS) for points in near])
    # up to the reach the network was shown to be of use on rows that it had not seen
    radius = np.maximum(nearest(near, landmarks).max(axis=1), rows.reach) + 1e-9
    residual = ResidualNetwork(
        inputs=rows.inputs,
        networks=tuple(kept),
        chosen=chosen,
        # a little more, so that rounding leaves no row outside
        trust=Trust(landmarks, radius * (1.0 + 1e-9)),
        scale=rows.scale,
        bound=np.abs(rows.residual * rows.scale).max(axis=0),
        cutoff=TORQUE_CUTOFF,
    )
    moves = [
        parameter_moves(rows.parameters, said, rows.residual, rows.trajectory)
        for said in (before, after)
    ]
    target_share = (rows.target**2).sum() / (rows.residual**2).sum()
    report = Report(
        by_form=dict(zip(settings.forms, closed, strict=True)),
        form=tuple("" if k < 0 else settings.forms[k] for k in chosen),
        closed=left,
        apart=settings.apart,
        closed_apart={settings.apart: float(left.mean())},
        gain=final,
        in_target=1.0 - float(target_share),
        in_output=(share_explained(rows.q, before), share_explained(rows.q, after)),
        moves=(moves[0], moves[1]),
    )
    return residual, report


def _scaled(network: Network, gain: np.ndarray) -> Network:
    """The network with the means of each joint multiplied by its gain, (n,), in arrays of its own."""
    weight, bias = network.weights[-1].copy(), network.biases[-1].copy()
    weight[..., 0] *= gain[:, None]
    bias[..., 0] *= gain
    weights, biases = network.weights[:-1], network.biases[:-1]
    return replace(network, weights=(*weights, weight), biases=(*biases, bias))


def _spread(points: np.ndarray, count: int) -> np.ndarray:
    """Some of the points (M, C), each as far as possible from those before; (min(count, M), C)."""
    chosen = [0]
    distance = np.full(len(points), np.inf)
    for _ in range(min(count, len(points)) - 1):
        from_last = ((points - points[chosen[-1]]) ** 2).sum(axis=1)
        distance = np.minimum(distance, from_last)
        chosen.append(int(distance.argmax()))
    return points[chosen]


# A residual network learnt from a case and judged on recordings set aside, joint by joint.


Predict = Callable[[Motion, np.ndarray], np.ndarray]
"""Torque [N m], (N, n), on a motion with the load that the corrected arm predicts [N m], (N, n)."""


@dataclass(frozen=True)
class LearntResidual:
    """What was learnt of a case with n joints.

    Attributes:
        case: the case.
        settings: of the training.
        corrected: the corrected arm with the network.
        report: of the training.
        fitted, judged: trajectories trained on, and set aside.
        nothing, network, trees: RMS of the torque left on those set aside [N m], (n,): by the corrected arm, with the
            network, with boosted trees.
    """

    case: Case
    settings: ResidualSettings
    corrected: CorrectedArm
    report: Report
    fitted: list[Trajectory]
    judged: list[Trajectory]
    nothing: np.ndarray
    network: np.ndarray
    trees: np.ndarray

    @property
    def residual(self) -> ResidualNetwork:
        """The network."""
        assert self.corrected.residual is not None
        return self.corrected.residual


def learn_residual(
    case: Case,
    corrected: CorrectedArm,
    settings: ResidualSettings,
    judge: Sequence[str] = (),
    progress: Progress = silent,
) -> LearntResidual:
    """Train a network on what a corrected arm leaves of some recordings, and judge it on the others.

    Args:
        case: the case.
        corrected: the corrected arm; a network that it has is left out.
        settings: of the training.
        judge: names of the recordings to set aside; by default those of the case, else the last, else the last third
            of the only one.
        progress: called with a few words at each step.

    Raises:
        InputError: a recording has no torque, or a name is not that of a recording.
    """
    progress("reads the residual of the corrected arm")
    plain = replace(corrected, residual=None, remainder=None)
    fitted, judged = (_trajectories(plain, own) for own in split(case, judge))
    residual, report = fit_residual(fitted, settings, progress)
    settings = replace(settings, apart=report.apart)
    progress("fits boosted trees to compare with")
    rows = rows_of(fitted, settings)
    return LearntResidual(
        case=case,
        settings=settings,
        corrected=replace(plain, residual=residual),
        report=report,
        fitted=fitted,
        judged=judged,
        nothing=torque_left(judged, None),
        network=torque_left(judged, residual.torque),
        trees=torque_left(judged, boosted_trees(rows)),
    )


def _trajectories(
    corrected: CorrectedArm, recordings: Sequence[Recording]
) -> list[Trajectory]:
    """Trajectories of recordings with a torque: of each part of theirs that shares a state, long enough if several."""
    body, found = RigidBody(corrected.arm), []
    for recording in recordings:
        if recording.tau is None:
            raise InputError(
                "has no torque that a network could learn from",
                "give recordings with tau1.., or leave this one out of the case",
                file=recording.name,
            )
        spans = corrected.spans(recording.name, recording.t)
        for inside, arm in spans:
            part = recording.part(inside)
            if len(spans) == 1 or pieces(part):
                found += [from_segment(arm, body, s) for s in condition(part)]
    return found


def torque_left(
    trajectories: Sequence[Trajectory], predict: Predict | None
) -> np.ndarray:
    """RMS of what a model leaves of the residual, below 12 Hz [N m], (n,); ``None`` for no model."""
    left = []
    for x in trajectories:
        said = np.zeros_like(x.residual)
        if predict is not None:
            said = low_pass(predict(x.motion, x.load), x.motion.rate, TORQUE_CUTOFF)
        left.append((x.residual - said)[x.rows])
    return rms(np.concatenate(left))


def boosted_trees(rows: ResidualRows) -> Predict:
    """Boosted trees per joint, fitted to the same rows as a network, along a motion: what a network has to beat.

    They see all channels now, and the joint's dq and direction before.
    """
    from sklearn.ensemble import HistGradientBoostingRegressor

    def seen(windows: np.ndarray) -> np.ndarray:
        past = windows[:, :, :-1, rows.inputs.layout.past]
        flat = past.reshape(*past.shape[:2], -1)
        return np.concatenate([flat, windows[:, :, -1]], axis=2)

    models = [
        HistGradientBoostingRegressor(
            max_iter=150,
            learning_rate=0.08,
            max_leaf_nodes=15,
            l2_regularization=1.0,
            random_state=0,
        ).fit(x, y)
        for x, y in zip(seen(rows.windows), rows.target.T, strict=True)
    ]

    def predict(motion: Motion, load: np.ndarray) -> np.ndarray:
        # what they say is low-passed after
        step = max(1, int(motion.rate * SPACING))
        at = np.arange(0, len(motion.t), step)
        inputs = seen(rows.inputs.windows(motion, load, at))
        said = [model.predict(x) for model, x in zip(models, inputs, strict=True)]
        between = [np.interp(motion.t, motion.t[at], x) for x in said]
        return np.column_stack(between) * rows.scale

    return predict


# What a residual network learnt: its curves and its document.


# What a network learnt, as curves: mean residual and mean output over position, velocity and load of a joint.


BINS = 30
"""Bins of a curve, each with as many samples."""


def learnt_curves(found: LearntResidual, joint: int) -> list[dict[str, Any]]:
    """Curves of a joint, from 0, set aside: over position and load by direction, over velocity as a whole.

    Each has ``over``, ``position`` [rad], ``velocity`` [rad/s] or ``load`` [N m]; ``direction``, ``forward``,
    ``backward`` or ``both``; and means over K bins: ``x`` of the signal, ``residual`` of what the corrected arm leaves
    and ``network`` of what the network says [N m], (K,).
    """
    parts = []
    for x in found.judged:
        said = found.residual.torque(x.motion, x.load)
        network = low_pass(said, x.motion.rate, TORQUE_CUTOFF)
        series = (x.motion.q, x.motion.dq, x.load, x.residual, network)
        parts.append(np.array([values[x.rows, joint] for values in series]))
    position, velocity, load, residual, network = np.concatenate(parts, axis=1)
    every = np.ones(len(velocity), dtype=bool)
    forward, backward = velocity > MOVING, velocity < -MOVING
    curves = []
    for over, signal, direction, rows in (
        ("position", position, "forward", forward),
        ("position", position, "backward", backward),
        ("velocity", velocity, "both", every),
        ("load", load, "forward", forward),
        ("load", load, "backward", backward),
    ):
        # with few samples fewer bins
        count = min(BINS, int(rows.sum()) // FEWEST_ROWS)
        if count:
            own = np.stack([signal, residual, network])[:, rows]
            bins = np.array_split(own[:, np.argsort(own[0])], count, axis=1)
            means = np.array([part.mean(axis=1) for part in bins]).T
            of_bins = zip(("x", "residual", "network"), means, strict=True)
            curves.append({"over": over, "direction": direction, **dict(of_bins)})
    return curves


# A learnt residual network as plain data, and its schema.


SCHEMA = 1


def document(found: LearntResidual, files: Mapping[str, str]) -> dict[str, Any]:
    """What was learnt, as plain data in the form of ``residual.schema.json``.

    Args:
        found: what was learnt.
        files: names of the files beside it, by purpose.
    """
    report, settings = found.report, found.settings
    joints = [
        {
            "name": name,
            "form": report.form[j] or None,
            "gain": report.gain[j],
            "closed_in_validation": {
                form: closed[j] for form, closed in report.by_form.items()
            },
            "rmse": {
                "nothing": found.nothing[j],
                "network": found.network[j],
                "trees": found.trees[j],
            },
            "bound": found.residual.bound[j],
            "curves": learnt_curves(found, j),
        }
        for j, name in enumerate(found.case.arm.joints)
    ]
    physics = {
        "kept_apart_from": report.apart,
        "closed_by_apart": report.closed_apart,
        "share_of_residual": report.in_target,
        "share_of_output_before": report.in_output[0],
        "share_of_output": report.in_output[1],
        "largest_move_before": float(report.moves[0].max(initial=0.0)),
        "largest_move": float(report.moves[1].max(initial=0.0)),
    }
    content = {
        "schema": SCHEMA,
        "case": found.case.name,
        "fitted": _recordings(found.fitted),
        "judged": _recordings(found.judged),
        "settings": {"form": settings.form, "seed": settings.seed},
        "joints": joints,
        "physics": physics,
        "files": dict(files),
    }
    return dict(plain(content))


def _recordings(trajectories: Sequence[Trajectory]) -> list[dict[str, Any]]:
    """Names and lengths; a recording with gaps occurs once per piece."""
    return [
        {"recording": x.name, "seconds": x.motion.t[-1] - x.motion.t[0]}
        for x in trajectories
    ]
