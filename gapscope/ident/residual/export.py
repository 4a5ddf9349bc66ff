"""A residual network for other programs: one ONNX graph from windows to torque.

The graph is what numpy computes of a network, evaluated once on a tensor that torch follows.
"""

from __future__ import annotations

import io
import json
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import torch

from gapscope.arm.errors import extra
from gapscope.arm.io.atomic_write import atomic_write
from gapscope.effects.residual import ResidualNetwork
from gapscope.ident.residual.fit import Tensor

OPSET = 17
"""Operators of the graph, as old as other programs may be."""


class _Torque(torch.nn.Module):
    """Torque of a network with trust and bound [N m], (N, n), of normalised windows (n, N, taps, C)."""

    def __init__(self, residual: ResidualNetwork) -> None:
        super().__init__()
        self.residual = residual

    def forward(self, windows: torch.Tensor) -> torch.Tensor:
        said: Any = self.residual.of_windows(Tensor(windows))  # type: ignore[arg-type]
        return torch.as_tensor(said.tensor)


def onnx_model(residual: ResidualNetwork, path: Path | str | None = None) -> Any:
    """The network as an ONNX model in double precision; written to ``path`` if one is given.

    Its input ``windows``, (n, N, taps, C), are the normalised windows of ``Inputs``; its output ``torque`` is the
    residual torque [N m], (N, n), with trust and bound. The property ``metadata`` of the model says as JSON what a
    program needs to make the windows, see ``metadata``.

    Raises:
        GapscopeError: the package onnx is not installed, or the file cannot be written.
    """
    with extra("learn", "the export to ONNX"):
        import onnx
    inputs, graph = residual.inputs, io.BytesIO()
    shape = inputs.n, 2, inputs.taps, inputs.channels
    with warnings.catch_warnings():
        # constants of the network are constants of the graph, and the tracing exporter needs no further package
        warnings.simplefilter("ignore")
        torch.onnx.export(
            _Torque(residual),
            (torch.zeros(shape, dtype=torch.float64),),
            graph,  # type: ignore[arg-type]
            input_names=["windows"],
            output_names=["torque"],
            dynamic_axes={"windows": {1: "N"}, "torque": {0: "N"}},
            opset_version=OPSET,
            dynamo=False,
        )
    model = onnx.load_model_from_string(graph.getvalue())
    onnx.checker.check_model(model)
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
