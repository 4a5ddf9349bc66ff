"""What a residual network needs to learn: inputs, capacity, weights, length, projection and trust, one at a time.

    .venv/bin/python experiments/residual_causes.py [--out out/residual]

Needs the extras `learn` and `blind`. The torque A_j sin(3 q_j) tanh(dq_j / 0.1) is added to the recordings of a healthy
Panda of the blind check's generator: six recordings of 10 s to fit, two to judge (``residual_arms.py``). Printed is a
Markdown table: RMS left on each joint, and its geometric mean over the joints, over that without a network.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from residual_arms import waved

from gapscope.effects.residual.inputs import Inputs
from gapscope.effects.residual.model import ResidualNetwork
from gapscope.effects.residual.network import Network
from gapscope.effects.residual.trust import Trust, nearest
from gapscope.ident.residual.fit import fit_residual
from gapscope.ident.residual.folds import Folds, make_folds
from gapscope.ident.residual.learnt import boosted_trees, torque_left
from gapscope.ident.residual.rows import ResidualRows, rows_of
from gapscope.ident.residual.settings import ResidualSettings
from gapscope.ident.residual.training import train
from gapscope.ident.residual.trajectory import Trajectory

SETTINGS = ResidualSettings(form="mlp")


@dataclass(frozen=True)
class FewInputs(Inputs):
    """Inputs without memory, with one direction, and with positions by sine and cosine alone."""

    @property
    def seen_by_mlp(self) -> np.ndarray:
        """Places in a flat window."""
        places = np.arange(self.taps * self.channels).reshape(self.taps, self.channels)
        now = places[-1, self.layout.neighbourhood]
        return np.concatenate([places[:-1, self.layout.past].ravel(), now])


@dataclass(frozen=True)
class AllInputs(Inputs):
    """All channels of all joints."""

    @property
    def seen_by_mlp(self) -> np.ndarray:
        """Places in a flat window."""
        places = np.arange(self.taps * self.channels).reshape(self.taps, self.channels)
        return np.concatenate([places[:-1, self.layout.past].ravel(), places[-1]])


def unbound(rows: ResidualRows, network: Network) -> ResidualNetwork:
    """A network on all joints, as trained: without projection, trust and bound."""
    n = len(rows.scale)
    near = len(rows.inputs.layout.neighbourhood)
    endless = Trust(np.zeros((n, 1, near)), np.full(n, 1e9))
    chosen, bound = np.zeros(n, dtype=int), np.full(n, 1e9)
    return ResidualNetwork(
        rows.inputs, (network,), chosen, endless, rows.scale, bound, 12.0
    )


def trained(
    rows: ResidualRows, folds: Folds, settings: ResidualSettings, kind: type[Inputs]
) -> ResidualNetwork:
    """An MLP with inputs of a kind."""
    inputs = kind(**vars(rows.inputs))
    rows = replace(rows, inputs=inputs)
    return unbound(rows, train(settings, inputs, rows.windows, folds))


def variants(
    fit: list[Trajectory],
) -> Iterator[tuple[str, ResidualNetwork]]:
    """Networks by what is changed."""
    rows = rows_of(fit, SETTINGS)
    folds = make_folds(rows.group, SETTINGS.members, rows.residual, rows.q)
    even = replace(folds, weight=np.ones_like(folds.weight))
    wide, long = replace(SETTINGS, hidden=64), replace(SETTINGS, steps=4000)
    strict = replace(SETTINGS, decay=20.0)
    yield "MLP, few inputs", trained(rows, folds, SETTINGS, FewInputs)
    yield "64 units", trained(rows, folds, wide, FewInputs)
    yield "4000 steps", trained(rows, folds, long, FewInputs)
    yield "weights decay 20 times as fast", trained(rows, folds, strict, FewInputs)
    yield (
        "recordings weighed by their squares",
        trained(rows, even, SETTINGS, FewInputs),
    )
    yield "all inputs", trained(rows, folds, SETTINGS, AllInputs)
    yield "the joint's inputs alone", trained(rows, folds, SETTINGS, Inputs)
    additive, _ = fit_residual(fit, replace(SETTINGS, form="additive"))
    free, _ = fit_residual(fit, ResidualSettings(form="additive", apart="effects"))
    endless = replace(additive.trust, radius=np.full(len(rows.scale), 1e9))
    yield "additive", additive
    yield "additive, not kept apart from inertial parameters", free
    yield "additive, trusted everywhere", replace(additive, trust=endless)
    yield "additive, trusted within the median distance", near(additive, rows)


def near(residual: ResidualNetwork, rows: ResidualRows) -> ResidualNetwork:
    """The network with trust as far as half of the held-out rows lay from the others."""
    reach = np.array([np.median(d[np.isfinite(d)]) for d in rows.distance.T])
    now = rows.windows[:, :, -1, rows.inputs.layout.neighbourhood]
    cover = nearest(now, residual.trust.landmarks).max(axis=1)
    return replace(
        residual, trust=replace(residual.trust, radius=np.maximum(reach, cover))
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--out", type=Path, default=Path("out/residual"))
    fit, judge = waved("franka_panda", 0, parser.parse_args().out / "wave")
    nothing = torque_left(judge, None)

    def row(name: str, left: np.ndarray) -> None:
        ratio = float(np.exp(np.log(left / nothing).mean()))
        cells = " | ".join(f"{x:.3g}" for x in left)
        print(f"| {name} | {cells} | {ratio:.2f} |", flush=True)

    heads = " | ".join(f"J{joint + 1}" for joint in range(len(nothing)))
    print(f"| | {heads} | over nothing |\n|{'---|' * (len(nothing) + 2)}")
    row("nothing", nothing)
    row("boosted trees", torque_left(judge, boosted_trees(rows_of(fit, SETTINGS))))
    for name, network in variants(fit):
        row(name, torque_left(judge, network.torque))


if __name__ == "__main__":
    main()
