"""A residual network for other programs: one ONNX graph from windows to torque."""

from __future__ import annotations

import itertools
import json
from pathlib import Path
from typing import Any

import numpy as np

from gapscope.arm.errors import GapscopeError
from gapscope.arm.io.atomic_write import atomic_write
from gapscope.effects.residual import (
    BANDS,
    BEYOND,
    FRICTION,
    LENGTHS,
    REACHES,
    Basis,
    Layout,
    Network,
    ResidualNetwork,
)

OPSET = 17
"""Operators of the graph."""


class Graph:
    """A graph in the making; values are named as it goes."""

    def __init__(self) -> None:
        try:
            import onnx
        except ImportError:
            raise GapscopeError(
                "the export to ONNX needs the package onnx",
                "pip install 'gapscope[learn]'",
            ) from None
        self._onnx = onnx
        self._nodes: list[Any] = []
        self._constants: list[Any] = []

    def constant(self, value: Any) -> str:
        """A constant, in double precision unless it is of integers."""
        array = np.asarray(value)
        if array.dtype.kind == "f":
            array = array.astype(np.float64)
        name = f"c{len(self._constants)}"
        self._constants.append(self._onnx.numpy_helper.from_array(array, name))
        return name

    def node(self, kind: str, *inputs: str, **attributes: Any) -> str:
        """An operator; the name of its output."""
        name = f"v{len(self._nodes)}"
        node = self._onnx.helper.make_node(kind, list(inputs), [name], **attributes)
        self._nodes.append(node)
        return name

    def slice(self, x: str, start: int, stop: int, axis: int) -> str:
        """Part of a value along an axis."""
        ends = (self.constant(np.array([k])) for k in (start, stop, axis))
        return self.node("Slice", x, *ends)

    def reshape(self, x: str, *shape: int) -> str:
        """The value in another shape; 0 keeps a dimension."""
        return self.node("Reshape", x, self.constant(np.array(shape)))

    def times(self, *factors: str) -> str:
        """Product of values."""
        product = factors[0]
        for factor in factors[1:]:
            product = self.node("Mul", product, factor)
        return product

    def model(
        self, output: str, windows: tuple[Any, ...], torque: tuple[Any, ...]
    ) -> Any:
        """The model with the input ``windows`` and the output ``torque``."""
        helper, double = self._onnx.helper, self._onnx.TensorProto.DOUBLE
        self._nodes.append(helper.make_node("Identity", [output], ["torque"]))
        graph = helper.make_graph(
            self._nodes,
            "residual",
            [helper.make_tensor_value_info("windows", double, windows)],
            [helper.make_tensor_value_info("torque", double, torque)],
            self._constants,
        )
        model = helper.make_model(
            graph, opset_imports=[helper.make_opsetid("", OPSET)], ir_version=8
        )
        self._onnx.checker.check_model(model)
        return model


def onnx_model(residual: ResidualNetwork, path: Path | str | None = None) -> Any:
    """The network as an ONNX model in double precision; written to ``path`` if one is given.

    Its input ``windows``, (n, N, taps, C), are the normalised windows of ``Inputs``; its output ``torque`` is the
    residual torque [N m], (N, n), with trust and bound. The property ``metadata`` of the model says as JSON what a
    program needs to make the windows, see ``metadata``.

    Raises:
        GapscopeError: the package onnx is not installed, or the file cannot be written.
    """
    graph, inputs = Graph(), residual.inputs
    taps, n = inputs.taps, inputs.n
    now = graph.slice("windows", taps - 1, taps, 2)
    now = graph.reshape(now, n, -1, inputs.channels)
    total = graph.constant(np.zeros((n, 1)))
    for k, network in enumerate(residual.networks):
        joints = residual.chosen == k
        if not joints.any():
            continue
        mean = _mean(graph, network, now, n, inputs.layout)
        chosen = graph.constant(joints[:, None].astype(float))
        total = graph.node("Add", total, graph.times(mean, chosen))
    trusted = graph.times(total, _trust(graph, residual, now))
    scaled = graph.times(trusted, graph.constant(residual.scale[:, None]))
    bound = residual.bound[:, None]
    limited = graph.node("Min", scaled, graph.constant(bound))
    limited = graph.node("Max", limited, graph.constant(-bound))
    torque = graph.node("Transpose", limited, perm=[1, 0])
    model = graph.model(torque, (n, "N", taps, inputs.channels), ("N", n))
    entry = model.metadata_props.add()
    entry.key, entry.value = "metadata", json.dumps(metadata(residual))
    if path is not None:
        with atomic_write(path) as aside:
            aside.write_bytes(model.SerializeToString())
    return model


def metadata(residual: ResidualNetwork) -> dict[str, Any]:
    """What the graph expects and gives, by the keys that Newton's neural drives use.

    ``input_columns`` names the C channels; ``sample_dt_s`` is the time between the taps of a window [s], the oldest
    first; ``normalization.inputs`` holds mean and std by channel, a number for each joint, to make the windows with.
    Torque comes out in N m, so that ``torque_mean`` is 0 and ``torque_std`` 1.
    """
    inputs, n = residual.inputs, residual.inputs.n
    names = inputs.layout.names

    def by_channel(values: np.ndarray) -> dict[str, list[float]]:
        return dict(zip(names, values.T.tolist(), strict=True))

    mean, std = [0.0] * n, [1.0] * n
    return {
        "input_columns": list(names),
        "taps": inputs.taps,
        "sample_dt_s": inputs.spacing,
        "normalization": {
            "inputs": {"mean": by_channel(inputs.mean), "std": by_channel(inputs.std)},
            "targets": {"mean": {"torque": mean}, "std": {"torque": std}},
        },
        "torque_mean": mean,
        "torque_std": std,
    }


def _mean(graph: Graph, network: Network, now: str, n: int, layout: Layout) -> str:
    """Mean of the members over the joint's scale, (n, N)."""
    head = graph.constant(network.weights[-1][..., :1])
    bias = graph.constant(network.biases[-1][:, :, None, :1])
    basis = network.basis
    hidden = _basis(graph, basis, now, layout) if basis else _layers(graph, network, n)
    output = graph.node("Add", graph.node("MatMul", hidden, head), bias)
    mean = graph.node("ReduceMean", output, axes=[0], keepdims=0)
    return graph.reshape(mean, n, -1)


def _layers(graph: Graph, network: Network, n: int) -> str:
    """Last hidden layer, (members, n, N, K)."""
    members, last = network.members, network.weights[-1].shape[2]
    hidden = graph.reshape("windows", 0, 0, -1)
    if network.form == "mlp":
        seen = graph.constant(network.seen)
        hidden = graph.node("Gather", hidden, seen, axis=2)
    shape = graph.constant(np.array([members, 1, 1, 1]))
    hidden = graph.node("Expand", hidden, shape)
    for weight, bias in zip(network.weights[:-1], network.biases[:-1], strict=True):
        # a layer of the convolutional form halves the number of instants
        hidden = graph.reshape(hidden, members, n, -1, weight.shape[2])
        moved = graph.node("MatMul", hidden, graph.constant(weight))
        hidden = graph.node("Add", moved, graph.constant(bias[:, :, None]))
        hidden = graph.node("Tanh", hidden)
    return graph.reshape(hidden, members, n, -1, last)


def _trust(graph: Graph, residual: ResidualNetwork, now: str) -> str:
    """Factor of the output, (n, N); see ``Trust``."""
    places = graph.constant(residual.inputs.layout.neighbourhood)
    near = graph.node("Gather", now, places, axis=2)
    trust = residual.trust
    apart = graph.node(
        "Sub",
        graph.node("Unsqueeze", near, graph.constant(np.array([2]))),
        graph.constant(trust.landmarks[:, None]),
    )
    square = graph.node(
        "ReduceSum",
        graph.times(apart, apart),
        graph.constant(np.array([3])),
        keepdims=0,
    )
    nearest = graph.node("Sqrt", graph.node("ReduceMin", square, axes=[2], keepdims=0))
    beyond = graph.node("Div", nearest, graph.constant(trust.radius[:, None]))
    one = graph.constant(1.0)
    u = graph.node("Sub", beyond, one)
    u = graph.node("Min", graph.node("Max", u, graph.constant(0.0)), one)
    rest = graph.node("Sub", graph.constant(3.0), graph.times(u, graph.constant(2.0)))
    return graph.node("Sub", one, graph.times(u, u, rest))


def _basis(graph: Graph, basis: Basis, now: str, at: Layout) -> str:
    """The functions of ``Basis.parts``, (1, n, N, F)."""
    x = graph.node("Max", now, graph.constant(basis.low[:, None]))
    x = graph.node("Min", x, graph.constant(basis.high[:, None]))

    def part(start: int, stop: int) -> str:
        return graph.slice(x, start, stop, 2)

    def joined(*values: str) -> str:
        return graph.node("Concat", *values, axis=2)

    n, first = at.n, at.direction.start
    speed, acceleration, load = part(0, 1), part(1, 2), part(2, 3)
    direction = part(first, at.direction.stop)
    friction = part(first + FRICTION, first + FRICTION + 1)
    strain = part(at.memory.start, at.memory.start + len(REACHES))
    warmth = part(at.memory.start + len(REACHES), at.memory.stop)
    others, start = part(at.others.start, at.others.stop), at.others.start
    position = part(at.angle, at.angle + n)
    own_position = part(at.angle, at.angle + 1)
    dq, loads = (part(start + k * (n - 1), start + (k + 1) * (n - 1)) for k in (0, 2))
    own = joined(own_position, speed, acceleration, load)
    everything = joined(position, speed, dq, load, loads)
    waves = _waves(graph, basis, own_position)
    size = graph.node("Abs", load)
    functions = joined(
        *waves,
        *(graph.times(wave, friction) for wave in waves),
        joined(direction, speed, graph.times(speed, graph.node("Abs", speed))),
        strain,
        joined(load, graph.times(load, load, load)),
        graph.times(load, warmth),
        graph.times(friction, warmth),
        joined(graph.times(size, direction), graph.times(load, speed)),
        acceleration,
        others,
        *(_random_waves(graph, own, basis.own, length) for length in LENGTHS),
        _random_waves(graph, everything, basis.everything, np.sqrt(n) * 1.5),
    )
    return graph.node("Unsqueeze", functions, graph.constant(np.array([0])))


def _waves(graph: Graph, basis: Basis, position: str) -> list[str]:
    """Cosines and sines over the range of the position, by band."""
    angle = basis.layout.angle
    low, high = basis.low[:, angle], basis.high[:, angle]
    pace = np.pi / (BEYOND * np.maximum(high - low, 1e-9))
    along = graph.node("Sub", position, graph.constant(low[:, None, None]))
    base = graph.times(along, graph.constant(pace[:, None, None]))
    bands = []
    for start, stop in itertools.pairwise(BANDS):
        multiples = np.arange(start + 1, stop + 1, dtype=float)
        phase = graph.times(base, graph.constant(multiples))
        both = (graph.node("Cos", phase), graph.node("Sin", phase))
        bands.append(graph.node("Concat", *both, axis=2))
    return bands


def _random_waves(graph: Graph, x: str, waves: np.ndarray, length: float) -> str:
    """Cosines along random directions."""
    along = graph.node("MatMul", x, graph.constant(waves[:-1] / length))
    return graph.node("Cos", graph.node("Add", along, graph.constant(waves[-1])))
