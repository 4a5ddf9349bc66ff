"""A residual network for other programs: one ONNX graph from windows to torque.

The graph is what numpy computes: the network is evaluated once on a value that, by numpy's protocols for other arrays,
notes what is done with it.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin

from gapscope.arm.errors import GapscopeError
from gapscope.arm.io.atomic_write import atomic_write
from gapscope.effects.residual import ResidualNetwork

OPSET = 17
"""Operators of the graph."""
OPERATORS = {
    np.add: "Add",
    np.subtract: "Sub",
    np.multiply: "Mul",
    np.divide: "Div",
    np.power: "Pow",
    np.matmul: "MatMul",
    np.absolute: "Abs",
    np.sqrt: "Sqrt",
    np.cos: "Cos",
    np.sin: "Sin",
    np.tanh: "Tanh",
}
"""Operator of the graph of each of numpy's functions."""


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
        """A constant."""
        name = f"c{len(self._constants)}"
        array = np.asarray(value)
        self._constants.append(self._onnx.numpy_helper.from_array(array, name))
        return name

    def node(self, kind: str, *inputs: str, **attributes: Any) -> str:
        """An operator; the name of its output."""
        name = f"v{len(self._nodes)}"
        node = self._onnx.helper.make_node(kind, list(inputs), [name], **attributes)
        self._nodes.append(node)
        return name

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


class Traced(NDArrayOperatorsMixin):
    """A value of a graph: what numpy computes of it becomes a node.

    Args:
        graph: it is a value of.
        name: of the value.
        shape: with 0 for the number of samples, which the graph leaves open.
    """

    def __init__(self, graph: Graph, name: str, shape: tuple[int, ...]) -> None:
        self.graph, self.name, self.shape = graph, name, shape

    def _value(self, x: Any) -> str:
        """Name of a value, or of a constant in double precision."""
        if isinstance(x, Traced):
            return x.name
        return self.graph.constant(np.asarray(x, dtype=float))

    def _then(
        self, kind: str, *inputs: str, shape: Sequence[int], **attributes: Any
    ) -> Traced:
        """What an operator makes of this value and others."""
        name = self.graph.node(kind, self.name, *inputs, **attributes)
        return Traced(self.graph, name, tuple(shape))

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any) -> Traced:
        """One of ``OPERATORS``."""
        shapes: list[Any] = [getattr(x, "shape", ()) for x in inputs]
        shape: tuple[int, ...]
        if ufunc is np.matmul:
            first, second = shapes
            rows = np.broadcast_shapes(first[:-2], second[:-2])
            shape = (*rows, first[-2], second[-1])
        else:
            shape = np.broadcast_shapes(*shapes)
        names = map(self._value, inputs)
        return Traced(self.graph, self.graph.node(OPERATORS[ufunc], *names), shape)

    def __array_function__(
        self, function: Any, types: Any, args: Any, kwargs: Any
    ) -> Any:
        """``clip`` between bounds; ``concatenate`` and ``split`` along an axis."""
        if function is np.clip:
            out, *bounds = args
            for kind, bound in zip(("Max", "Min"), bounds, strict=True):
                if bound is not None:
                    out = out._then(kind, self._value(bound), shape=out.shape)
            return out
        axis = kwargs["axis"]
        if function is np.concatenate:
            (first, *others), shape = args[0], list(self.shape)
            shape[axis] = sum(part.shape[axis] for part in args[0])
            names = [part.name for part in others]
            return first._then("Concat", *names, shape=shape, axis=axis)
        whole, count = args
        width, parts = whole.shape[axis] // count, []
        for k in range(count):
            own = slice(k * width, (k + 1) * width)
            parts.append(whole[(slice(None),) * axis + (own,)])
        return parts

    def __getitem__(self, key: Any) -> Traced:
        """Slices, places, new axes, and the dots that stand for whole axes."""
        keys = list(key) if isinstance(key, tuple) else [key]
        for at, own in enumerate(keys):
            if own is Ellipsis:
                missing = len(self.shape) - (len(keys) - 1)
                keys[at : at + 1] = [slice(None)] * missing
                break
        out, axis = self, 0
        for own in keys:
            shape, constant = list(out.shape), self.graph.constant
            if own is None:
                shape.insert(axis, 1)
                out = out._then("Unsqueeze", constant([axis]), shape=shape)
            elif not isinstance(own, slice):
                # one place leaves no axis, several leave one
                shape[axis : axis + 1] = np.shape(own)
                out = out._then("Gather", constant(own), shape=shape, axis=axis)
                axis -= np.ndim(own) == 0
            elif own != slice(None):
                start, stop, _ = own.indices(shape[axis])
                shape[axis] = stop - start
                ends = [constant([k]) for k in (start, stop, axis)]
                out = out._then("Slice", *ends, shape=shape)
            axis += 1
        return out

    def reshape(self, *shape: int) -> Traced:
        """In another shape: 0 is the number of samples, and if it is not given, -1 counts samples too."""
        sizes = list(shape)
        if -1 in sizes:
            sizes[sizes.index(-1)] = 0
            if 0 in shape:
                known = np.prod([k for k in self.shape if k])
                sizes[shape.index(-1)] = int(known / np.prod([k for k in sizes if k]))
        return self._then("Reshape", self.graph.constant(shape), shape=sizes)

    def transpose(self, *axes: int) -> Traced:
        """With its axes in another order."""
        shape = [self.shape[axis] for axis in axes]
        return self._then("Transpose", shape=shape, perm=list(axes))

    def sum(self, axis: int) -> Traced:
        """Sum over an axis."""
        places = self.graph.constant([axis])
        shape = np.delete(self.shape, axis).tolist()
        return self._then("ReduceSum", places, shape=shape, keepdims=0)

    def min(self, axis: int) -> Traced:
        """Least value along an axis."""
        shape = np.delete(self.shape, axis).tolist()
        return self._then("ReduceMin", shape=shape, axes=[axis], keepdims=0)


def onnx_model(residual: ResidualNetwork, path: Path | str | None = None) -> Any:
    """The network as an ONNX model in double precision; written to ``path`` if one is given.

    Its input ``windows``, (n, N, taps, C), are the normalised windows of ``Inputs``; its output ``torque`` is the
    residual torque [N m], (N, n), with trust and bound. The property ``metadata`` of the model says as JSON what a
    program needs to make the windows, see ``metadata``.

    Raises:
        GapscopeError: the package onnx is not installed, or the file cannot be written.
    """
    graph, inputs = Graph(), residual.inputs
    taps, n, channels = inputs.taps, inputs.n, inputs.channels
    windows = Traced(graph, "windows", (n, 0, taps, channels))
    near = windows[:, :, -1, inputs.layout.neighbourhood]
    torque: Any = np.zeros((n, 1))
    for k, network in enumerate(residual.networks):
        head, bias = network.weights[-1][..., :1], network.biases[-1][:, :, None, :1]
        hidden: Any = network.hidden(windows)  # type: ignore[arg-type]
        members = (hidden @ head + bias)[..., 0]
        mean = members.sum(axis=0) / network.members
        torque = torque + mean * (residual.chosen == k)[:, None]
    torque = torque * residual.trust.factor(near) * residual.scale[:, None]  # type: ignore[arg-type]
    bound = residual.bound[:, None]
    limited = np.clip(torque, -bound, bound).transpose(1, 0)
    shapes = (n, "N", taps, channels), ("N", n)
    model = graph.model(limited.name, *shapes)
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
