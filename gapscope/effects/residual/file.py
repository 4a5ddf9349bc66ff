"""The file ``residual.npz``: a residual network as arrays, without pickle."""

from __future__ import annotations

import zipfile
import zlib
from pathlib import Path

import numpy as np

from gapscope.arm.errors import InputError
from gapscope.arm.io.atomic_write import atomic_write
from gapscope.effects.residual.inputs import Inputs
from gapscope.effects.residual.model import ResidualNetwork
from gapscope.effects.residual.network import FORMS, Network
from gapscope.effects.residual.trust import Trust

SCHEMA = 1
_KEYS = (
    "schema",
    "form",
    "taps",
    "spacing",
    "mean",
    "std",
    "seen",
    "layers",
    "landmarks",
    "radius",
    "scale",
    "bound",
)
_REMEDY = "train it again, or remove the line residual: from corrected.yaml"


def write_residual(residual: ResidualNetwork, path: Path | str) -> None:
    """Write a network; ``path`` never holds half of one.

    Raises:
        GapscopeError: the file cannot be written.
    """
    network, inputs = residual.network, residual.inputs
    arrays = {
        "schema": np.array(SCHEMA),
        "form": np.array(network.form),
        "taps": np.array(inputs.taps),
        "spacing": np.array(inputs.spacing),
        "mean": inputs.mean,
        "std": inputs.std,
        "seen": network.seen,
        "layers": np.array(len(network.weights)),
        "landmarks": residual.trust.landmarks,
        "radius": residual.trust.radius,
        "scale": residual.scale,
        "bound": residual.bound,
        "cutoff": np.array(residual.cutoff),
        **{f"weight{k}": weight for k, weight in enumerate(network.weights)},
        **{f"bias{k}": bias for k, bias in enumerate(network.biases)},
    }
    with atomic_write(path) as aside, aside.open("wb") as stream:
        np.savez_compressed(stream, allow_pickle=False, **arrays)


def read_residual(path: Path | str) -> ResidualNetwork:
    """Read a network.

    Raises:
        InputError: the file is missing, cut short, no residual network, or its arrays do not fit together.
    """
    path = Path(path)
    arrays = _arrays(path)
    layers = int(arrays.get("layers", 0))
    needed = (
        *_KEYS,
        "cutoff",
        *(f"{kind}{k}" for k in range(layers) for kind in ("weight", "bias")),
    )
    if missing := [key for key in needed if key not in arrays]:
        raise InputError(
            f"is no residual network: {missing[0]} is missing", _REMEDY, file=path
        )
    if int(arrays["schema"]) != SCHEMA or str(arrays["form"]) not in FORMS:
        raise InputError(
            f"is of schema {arrays['schema']} and form {str(arrays['form'])!r}; known are schema {SCHEMA} and "
            f"{', '.join(FORMS)}",
            "use the version of Gapscope that wrote it",
            file=path,
        )
    for key, value in arrays.items():
        if value.dtype.kind == "f" and not np.isfinite(value).all():
            raise InputError(
                "holds values that are not finite", _REMEDY, file=path, where=key
            )
    n = len(arrays["scale"])
    inputs = Inputs(
        n, int(arrays["taps"]), float(arrays["spacing"]), arrays["mean"], arrays["std"]
    )
    network = Network(
        str(arrays["form"]),
        arrays["seen"],
        tuple(arrays[f"weight{k}"] for k in range(layers)),
        tuple(arrays[f"bias{k}"] for k in range(layers)),
    )
    trust = Trust(arrays["landmarks"], arrays["radius"])
    found = ResidualNetwork(
        inputs,
        network,
        trust,
        arrays["scale"],
        arrays["bound"],
        float(arrays["cutoff"]),
    )
    _check_shapes(found, path)
    return found


def _arrays(path: Path) -> dict[str, np.ndarray]:
    """All arrays of the file."""
    try:
        opened = np.load(path, allow_pickle=False)
        if isinstance(opened, np.ndarray):
            raise InputError("is no NPZ file, but holds one array", _REMEDY, file=path)
        with opened as content:
            return {key: content[key] for key in content.files}
    except OSError as error:
        raise InputError(
            f"cannot be read ({error.strerror or error})", "check the path", file=path
        ) from None
    except (ValueError, EOFError, zipfile.BadZipFile, zlib.error, KeyError) as error:
        raise InputError(
            f"is no NPZ file, or was cut short ({error})", _REMEDY, file=path
        ) from None


def _check_shapes(found: ResidualNetwork, path: Path) -> None:
    """Check that every array has the shape that the others ask for, by trying one window and by name."""
    n, c = found.inputs.n, found.inputs.channels
    for name, value, shape in (
        ("mean", found.inputs.mean, (n, c)),
        ("std", found.inputs.std, (n, c)),
        ("landmarks", found.trust.landmarks[:, :1], (n, 1, c)),
        ("radius", found.trust.radius, (n,)),
        ("bound", found.bound, (n,)),
    ):
        if value.shape != shape:
            raise InputError(
                f"has shape {value.shape}, expected {shape}",
                _REMEDY,
                file=path,
                where=name,
            )
    try:
        found.of_windows(np.zeros((n, 1, found.inputs.taps, c)))
    except (ValueError, IndexError) as error:
        raise InputError(
            f"its weights do not fit together ({error})", _REMEDY, file=path
        ) from None
