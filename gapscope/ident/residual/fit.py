"""From trajectories to a residual network orthogonal to the effects that fades out away from its training data."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gapscope.effects.residual.model import ResidualNetwork
from gapscope.effects.residual.network import ADDITIVE, Network
from gapscope.effects.residual.trust import Trust, nearest
from gapscope.ident.residual.additive import fit_additive
from gapscope.ident.residual.apart import joint_heads, kept_apart, scaled
from gapscope.ident.residual.folds import Folds, make_folds, shares_closed, usefulness
from gapscope.ident.residual.orthogonality import parameter_moves, share_explained
from gapscope.ident.residual.rows import ResidualRows, rows_of
from gapscope.ident.residual.settings import ResidualSettings
from gapscope.ident.residual.settling import Choice, settled
from gapscope.ident.residual.trajectory import Trajectory
from gapscope.model.conditioning import TORQUE_CUTOFF

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
        gain: factor on each joint's output [1], (n,); 0 if none was chosen.
        in_target: share of the residual's squares that lay in the span of the physics and was taken out [1].
        in_output: the same of the network's output, before and after the projection of the heads [1].
        moves: by how many standard deviations each parameter of the effects would move if it were refitted with the
            network in place, before and after the projection; each (k,).
        clipped, doubted: share of the rows on which the bound, and trust below 1, act [1].
    """

    by_form: dict[str, np.ndarray]
    form: tuple[str, ...]
    closed: np.ndarray
    gain: np.ndarray
    in_target: float
    in_output: tuple[float, float]
    moves: tuple[np.ndarray, np.ndarray]
    clipped: float
    doubted: float


@dataclass(frozen=True)
class Candidate:
    """A form that was trained.

    Attributes:
        name: of the form.
        network: its members.
        closed, gain: see ``Report``, (n,).
    """

    name: str
    network: Network
    closed: np.ndarray
    gain: np.ndarray


def fit_residual(
    trajectories: Sequence[Trajectory],
    settings: ResidualSettings,
    progress: Callable[[str], None] = lambda message: None,
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
    rows = rows_of(trajectories, settings)
    folds = make_folds(rows.group, settings.members, rows.residual, rows.q)
    candidates = [
        _candidate(form, rows, folds, settings, progress) for form in settings.forms
    ]
    progress("keeps it apart from the physics")
    networks = tuple(c.network for c in candidates)
    hidden = [network.hidden(rows.windows) for network in networks]
    chosen, gain, closed = settled(_choice(candidates), networks, hidden, rows, folds)
    networks = tuple(scaled(network, gain) for network in networks)
    free = _assembled(rows, networks, chosen, settings)
    before = free.outputs(rows.windows)[0]
    heads = joint_heads(networks, chosen, hidden, rows.q)
    residual = replace(free, networks=kept_apart(networks, chosen, heads))
    after = residual.outputs(rows.windows)[0]
    near = rows.windows[:, :, -1, rows.inputs.layout.neighbourhood]
    names = [c.name for c in candidates]
    moves = [
        parameter_moves(rows.parameters, said, rows.residual, rows.trajectory)
        for said in (before, after)
    ]
    target_share = (rows.target**2).sum() / (rows.residual**2).sum()
    report = Report(
        by_form={c.name: c.closed for c in candidates},
        form=tuple("" if k < 0 else names[k] for k in chosen),
        closed=closed,
        gain=gain,
        in_target=1.0 - float(target_share),
        in_output=(share_explained(rows.q, before), share_explained(rows.q, after)),
        moves=(moves[0], moves[1]),
        clipped=float((np.abs(after * rows.scale) > residual.bound).mean()),
        doubted=float((residual.trust.factor(near) < 1.0).mean()),
    )
    return residual, report


def _candidate(
    form: str,
    rows: ResidualRows,
    folds: Folds,
    settings: ResidualSettings,
    progress: Callable[[str], None],
) -> Candidate:
    """One form trained, and what it is worth on rows held out."""
    own = replace(settings, form=form)
    if form == ADDITIVE:
        network = fit_additive(
            rows.windows, rows.residual, rows.target, folds, own.seed, progress
        )
    else:
        from gapscope.ident.residual.training import train  # torch

        network = train(own, rows.inputs, rows.windows, folds, progress)
    outputs = network.outputs(rows.windows)[0].transpose(0, 2, 1)
    predicted = folds.held_out(outputs)
    closed, gain = usefulness(shares_closed(folds, rows.residual, predicted))
    return Candidate(form, network, closed, gain)


def _choice(candidates: Sequence[Candidate]) -> Choice:
    """The best candidate of each joint, before it is kept apart from the physics."""
    closed = np.stack([np.where(c.gain > 0, c.closed, 0.0) for c in candidates])
    best = closed.argmax(axis=0)
    joints = np.arange(closed.shape[1])
    gain = np.stack([c.gain for c in candidates])[best, joints]
    return Choice(np.where(gain > 0, best, -1), gain, closed[best, joints])


def _assembled(
    rows: ResidualRows,
    networks: tuple[Network, ...],
    chosen: np.ndarray,
    settings: ResidualSettings,
) -> ResidualNetwork:
    """The network with its trust and bound."""
    return ResidualNetwork(
        inputs=rows.inputs,
        networks=networks,
        chosen=chosen,
        trust=_trust(rows),
        scale=rows.scale,
        bound=settings.bound * np.abs(rows.residual * rows.scale).max(axis=0),
        cutoff=TORQUE_CUTOFF,
    )


def _trust(rows: ResidualRows) -> Trust:
    """Landmarks spread over the inputs seen, and the radius within which everything seen lies.

    The radius is at least ``reach``: up to there the network was shown to be of use on rows that it had not seen.
    """
    now = rows.windows[:, :, -1, rows.inputs.layout.neighbourhood]
    landmarks = np.stack([_spread(points, LANDMARKS) for points in now])
    cover = nearest(now, landmarks).max(axis=1)
    radius = np.maximum(np.maximum(cover, rows.reach), 1e-9)
    # a little more, so that rounding leaves no row outside
    return Trust(landmarks, radius * (1.0 + 1e-9))


def _spread(points: np.ndarray, count: int) -> np.ndarray:
    """Some of the points (M, C), each as far as possible from those before; (min(count, M), C)."""
    chosen = [0]
    distance = np.full(len(points), np.inf)
    for _ in range(min(count, len(points)) - 1):
        from_last = ((points - points[chosen[-1]]) ** 2).sum(axis=1)
        distance = np.minimum(distance, from_last)
        chosen.append(int(distance.argmax()))
    return points[chosen]
