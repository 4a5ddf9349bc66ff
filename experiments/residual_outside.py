"""A residual network on the way out of its training range; used by ``14_residual_network.py``.

From the rows it was trained on, one group of signals at a time is moved out of the range: all joints by a distance
along random signs, 1 being the largest value that the joint reached in training, or an eighth of half a turn for
positions, which are moved by half a turn at most. The other signals stay, the load among them, so that each group is
seen alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from gapscope.arm.motions.motion import Motion
from gapscope.effects.residual.model import ResidualNetwork
from gapscope.ident.residual.trajectory import Trajectory

GROUPS = ("position", "speed", "acceleration")
STEPS = np.concatenate([np.linspace(0.0, 8.0, 81), np.geomspace(8.5, 100.0, 20)])
"""How far a group is moved, in parts of its largest value in training; 0 is the training."""
SHOWN = 8.0
"""How far the figure goes."""
ROWS = 100
"""Rows of training from which each way out begins."""
WAYS = 4
"""Draws of the signs."""
SILENT = 0.05
"""A torque below this share of that in training counts as silence."""
NOTHING = 1e-9
"""A torque below this in training is none [N m]."""
COLOURS = {
    "said": "#0072b2",
    "raw": "#d55e00",
    "spread": "#009e73",
    "bound": "#555555",
    "trust": "#0072b2",
}


@dataclass(frozen=True)
class WayOut:
    """One network, one group of signals; arrays over F steps and n joints, torque in N m.

    Attributes:
        group: one of ``GROUPS``.
        said: RMS over rows of the torque that the network predicts, (F, n).
        raw: the same without trust and bound, (F, n).
        spread: RMS over rows of the members' standard deviation about their mean, (F, n).
        trust: mean over rows, (F, n).
        largest: largest torque over its bound outside the training [1], (n,).
        distance: mean distance from the nearest landmark over the radius of trust [1], (F, n).
    """

    group: str
    said: np.ndarray
    raw: np.ndarray
    spread: np.ndarray
    trust: np.ndarray
    largest: np.ndarray
    distance: np.ndarray

    @property
    def inside(self) -> np.ndarray:
        """RMS torque in training [N m], (n,)."""
        return np.asarray(self.said[0])

    def silent_from(self, joint: int) -> tuple[float, float]:
        """Step from which the torque of a joint stays below ``SILENT`` of that in training, with its distance."""
        loud = np.flatnonzero(self.said[:, joint] >= SILENT * self.inside[joint])
        last = loud[-1] + 1
        if last == len(STEPS):
            return np.inf, np.inf
        return float(STEPS[last]), float(self.distance[last, joint])


def moved(x: Trajectory, group: str, step: float, signs: np.ndarray) -> Motion:
    """A motion with one group of signals moved out; signs of shape (n,)."""
    motion, away = x.motion, step * signs
    q = (
        motion.q + signs * min(step, SHOWN) / SHOWN * np.pi
        if group == "position"
        else motion.q
    )
    dq = (
        motion.dq + away * np.abs(motion.dq[x.rows]).max(axis=0)
        if group == "speed"
        else motion.dq
    )
    ddq = (
        motion.ddq + away * np.abs(motion.ddq[x.rows]).max(axis=0)
        if group == "acceleration"
        else motion.ddq
    )
    return Motion(motion.t, q, dq, ddq)


def way_out(residual: ResidualNetwork, trajectory: Trajectory, group: str) -> WayOut:
    """Torque, spread and trust of a network from inside its training to far outside."""
    rows = trajectory.rows[:: max(1, len(trajectory.rows) // ROWS)]
    signs = np.random.default_rng(14).choice([-1.0, 1.0], (WAYS, residual.inputs.n))
    found: dict[str, list[np.ndarray]] = {
        name: [] for name in ("said", "raw", "spread", "trust", "distance")
    }
    largest = np.zeros(residual.inputs.n)
    for step in STEPS:
        motions = [moved(trajectory, group, step, sign) for sign in signs]
        windows = np.concatenate(
            [residual.inputs.windows(m, trajectory.load, rows) for m in motions], axis=1
        )
        prediction = residual.of_windows(windows)
        mean, _, apart = residual.outputs(windows)
        found["said"].append(rms(prediction.torque))
        found["raw"].append(rms(mean * residual.scale))
        found["spread"].append(rms(apart * residual.scale))
        found["trust"].append(prediction.trust.mean(axis=0))
        distance = (
            residual.trust.distance(
                windows[:, :, -1, residual.inputs.layout.neighbourhood]
            )
            / residual.trust.radius[:, None]
        )
        found["distance"].append(distance.mean(axis=1))
        if step > 0:
            largest = np.maximum(
                largest, (np.abs(prediction.torque) / residual.bound).max(axis=0)
            )
    return WayOut(
        group,
        **{name: np.array(values) for name, values in found.items()},
        largest=largest,
    )


def rms(torque: np.ndarray) -> np.ndarray:
    """RMS over rows, (n,)."""
    return np.asarray(np.sqrt((torque**2).mean(axis=0)))


def report(
    name: str, residual: ResidualNetwork, trajectory: Trajectory, out: Path
) -> str:
    """Print where a network falls silent, and draw the way out of the joint that it says most of.

    Returns:
        What was written, in words.
    """
    ways = [way_out(residual, trajectory, group) for group in GROUPS]
    if ways[0].inside.max() <= NOTHING:
        return f"{name}: the network says nothing, inside and outside"
    print(f"### {name}: on the way out\n")
    heads = (
        "joint",
        "in training [N m]",
        "bound [N m]",
        "silent from, position",
        "speed",
        "acceleration",
        "largest outside over bound",
        "without trust and bound, 100 times the speed [N m]",
    )
    print(f"| {' | '.join(heads)} |\n|{'---|' * len(heads)}")
    for joint in np.flatnonzero(ways[0].inside > NOTHING):
        cells = [
            f"J{joint + 1}",
            f"{ways[0].inside[joint]:.3g}",
            f"{residual.bound[joint]:.3g}",
            *(silence(way, joint) for way in ways),
            f"{max(way.largest[joint] for way in ways):.2f}",
            f"{ways[1].raw[-1, joint]:.3g}",
        ]
        print(f"| {' | '.join(cells)} |")
    print(
        f"\nSilent: below {SILENT:.0%} of the RMS in training, from there on; in brackets the mean distance by then.\n"
    )
    path = out / f"outside_{name}.html"
    draw(name, residual, ways).write_html(path, include_plotlyjs=True)
    return f"wrote {path}"


def silence(way: WayOut, joint: int) -> str:
    """From where a joint is silent, or how much it says at least."""
    step, distance = way.silent_from(joint)
    if np.isfinite(step):
        return f"{step:.2g} ({distance:.2g} r)"
    least = way.said[:, joint].min() / way.inside[joint]
    return f"never: {least:.0%} at least ({way.distance[:, joint].max():.2g} r)"


def draw(name: str, residual: ResidualNetwork, ways: Sequence[WayOut]) -> go.Figure:
    """A row of torque and a row of trust, a column per group."""
    joint = int(ways[0].inside.argmax())
    titles = [f"J{joint + 1}, {group}: torque [N m]" for group in GROUPS]
    titles += [f"J{joint + 1}, {group}: trust" for group in GROUPS]
    figure = make_subplots(
        rows=2, cols=3, subplot_titles=titles, vertical_spacing=0.14, row_heights=[2, 1]
    )
    for column, way in enumerate(ways, 1):
        curves = {
            "said": ("predicted, RMS", way.said[:, joint], "solid"),
            "raw": ("without trust and bound, RMS", way.raw[:, joint], "dash"),
            "spread": ("spread of the members", way.spread[:, joint], "dot"),
            "bound": ("bound", np.full(len(STEPS), residual.bound[joint]), "dashdot"),
        }
        for key, (label, values, dash) in curves.items():
            width = 2.5 if key == "said" else 1.5
            line = {"color": COLOURS[key], "dash": dash, "width": width}
            shown = np.maximum(values, 1e-12)
            curve = go.Scatter(
                x=STEPS, y=shown, name=label, line=line, showlegend=column == 1
            )
            figure.add_trace(curve, 1, column)
        line = {"color": COLOURS["trust"]}
        trust = go.Scatter(x=STEPS, y=way.trust[:, joint], line=line, showlegend=False)
        figure.add_trace(trust, 2, column)
        low, high = 0.003 * way.inside[joint], 30 * residual.bound[joint]
        limits = np.log10([low, high]).tolist()
        figure.update_yaxes(type="log", range=limits, row=1, col=column)
        figure.update_yaxes(range=[-0.05, 1.05], row=2, col=column)
    figure.update_xaxes(range=[0, SHOWN])
    units = ("eighths of half a turn", "largest speed", "largest acceleration")
    for column, unit in enumerate(units, 1):
        figure.update_xaxes(title_text=f"moved by [{unit}]", row=2, col=column)
    title = f"{name}: a residual network on the way out of its training range"
    figure.update_layout(title=title, height=550, template="plotly_white")
    return figure
