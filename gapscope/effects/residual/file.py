"""The file ``residual.npz``: a residual network as arrays, without pickle."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from gapscope.arm.errors import InputError
from gapscope.arm.io.atomic_write import atomic_write
from gapscope.arm.npz_file import read_arrays
from gapscope.effects.residual.basis import Basis
from gapscope.effects.residual.inputs import Inputs
from gapscope.effects.residual.model import ResidualNetwork
from gapscope.effects.residual.network import ADDITIVE, FORMS, Network
from gapscope.effects.residual.trust import Trust

SCHEMA = 2
_KEYS = (
    "schema",
    "taps",
    "spacing",
    "mean",
    "std",
    "forms",
    "chosen",
    "landmarks",
    "radius",
    "scale",
    "bound",
    "cutoff",
)
_AXES = {
    **dict.fromkeys(("schema", "taps", "spacing", "cutoff", "layers"), 0),
    **dict.fromkeys(("scale", "bound", "radius", "chosen", "forms", "seen"), 1),
    **dict.fromkeys(("mean", "std"), 2),
    "landmarks": 3,
}
"""Axes of the arrays that are not checked by trying a window."""
LARGEST_COUNT = 1000
"""Taps of a window, or layers of a network, beyond which it is no network of Gapscope [1]."""
_OF_BASIS = ("low", "high", "own", "everything")
_REMEDY = "train it again, or remove the line residual: from corrected.yaml"


def write_residual(residual: ResidualNetwork, path: Path | str) -> None:
    """Write a network; ``path`` never holds half of one.

    Raises:
        GapscopeError: the file cannot be written.
    """
    inputs = residual.inputs
    arrays = {
        "schema": np.array(SCHEMA),
        "taps": np.array(inputs.taps),
        "spacing": np.array(inputs.spacing),
        "mean": inputs.mean,
        "std": inputs.std,
        "forms": np.array([network.form for network in residual.networks]),
        "chosen": residual.chosen,
        "landmarks": residual.trust.landmarks,
        "radius": residual.trust.radius,
        "scale": residual.scale,
        "bound": residual.bound,
        "cutoff": np.array(residual.cutoff),
    }
    for network in residual.networks:
        arrays |= _of_network(network)
    with atomic_write(path) as aside, aside.open("wb") as stream:
        np.savez_compressed(stream, allow_pickle=False, **arrays)


def _of_network(network: Network) -> dict[str, np.ndarray]:
    """Arrays of one network, their names led by its form."""
    form = network.form
    arrays = {
        f"{form}.layers": np.array(len(network.weights)),
        f"{form}.seen": network.seen,
    }
    for k, (weight, bias) in enumerate(
        zip(network.weights, network.biases, strict=True)
    ):
        arrays |= {f"{form}.weight{k}": weight, f"{form}.bias{k}": bias}
    if network.basis is not None:
        arrays |= {f"{form}.{name}": getattr(network.basis, name) for name in _OF_BASIS}
    return arrays


def read_residual(path: Path | str) -> ResidualNetwork:
    """Read a network.

    Raises:
        InputError: the file is missing, cut short, no residual network, or its arrays do not fit together.
    """
    path = Path(path)
    arrays = read_arrays(path, _REMEDY)
    _need(arrays, _KEYS, path)
    _check_kinds(arrays, path)
    forms = [str(form) for form in np.atleast_1d(arrays["forms"])]
    if int(arrays["schema"]) != SCHEMA or not set(forms) <= set(FORMS):
        raise InputError(
            f"is of schema {arrays['schema']} and forms {', '.join(forms)}; known are schema {SCHEMA} and "
            f"{', '.join(FORMS)}",
            "train it again, or use the version of Gapscope that wrote it",
            file=path,
        )
    inputs = Inputs(
        n=len(arrays["scale"]),
        taps=int(arrays["taps"]),
        spacing=float(arrays["spacing"]),
        mean=arrays["mean"],
        std=arrays["std"],
    )
    found = ResidualNetwork(
        inputs=inputs,
        networks=tuple(_network(arrays, form, path) for form in forms),
        chosen=arrays["chosen"],
        trust=Trust(arrays["landmarks"], arrays["radius"]),
        scale=arrays["scale"],
        bound=arrays["bound"],
        cutoff=float(arrays["cutoff"]),
    )
    _check_shapes(found, path)
    return found


def _check_kinds(arrays: dict[str, np.ndarray], path: Path) -> None:
    """Check that each array is of numbers, or the names of forms, with as many axes as it needs.

    Raises:
        InputError: one is not.
    """
    for key, value in arrays.items():
        name = key.rpartition(".")[2]
        axes = _AXES.get(name)
        named = name == "forms"
        kinds = "U" if named else "fiub"
        if value.dtype.kind not in kinds or (axes is not None and value.ndim != axes):
            expected = "names" if named else "numbers"
            form = "" if axes is None else f" of {axes} axes"
            raise InputError(
                f"holds {value.dtype} of shape {value.shape}, expected {expected}{form}",
                _REMEDY,
                file=path,
                where=key,
            )
        if value.dtype.kind == "f" and not np.isfinite(value).all():
            raise InputError(
                "holds values that are not finite", _REMEDY, file=path, where=key
            )
    counts = {key: arrays[key] for key in arrays if key.endswith(("taps", ".layers"))}
    for key, count in counts.items():
        if not 0 <= count <= LARGEST_COUNT:
            raise InputError(
                f"is {count}, expected 0 to {LARGEST_COUNT}",
                _REMEDY,
                file=path,
                where=key,
            )


def _need(arrays: dict[str, np.ndarray], keys: Iterable[str], path: Path) -> None:
    """Refuse a file without one of the keys."""
    if missing := [key for key in keys if key not in arrays]:
        where = f"{missing[0]} is missing"
        if "schema" in arrays and int(arrays["schema"]) != SCHEMA:
            where = f"its schema is {arrays['schema']}, known is {SCHEMA}"
        raise InputError(f"is no residual network: {where}", _REMEDY, file=path)


def _network(arrays: dict[str, np.ndarray], form: str, path: Path) -> Network:
    """The network of one form."""
    _need(arrays, (f"{form}.layers", f"{form}.seen"), path)
    layers = range(int(arrays[f"{form}.layers"]))
    weights, biases = (
        [f"{form}.{kind}{k}" for k in layers] for kind in ("weight", "bias")
    )
    of_basis = [f"{form}.{name}" for name in _OF_BASIS] if form == ADDITIVE else []
    _need(arrays, (*weights, *biases, *of_basis), path)
    return Network(
        form=form,
        seen=arrays[f"{form}.seen"],
        weights=tuple(arrays[key] for key in weights),
        biases=tuple(arrays[key] for key in biases),
        basis=Basis(*(arrays[key] for key in of_basis)) if of_basis else None,
    )


def _check_shapes(found: ResidualNetwork, path: Path) -> None:
    """Check that every array has the shape that the others ask for, by trying one window and by name."""
    n, c = found.inputs.n, found.inputs.channels
    near = len(found.inputs.layout.neighbourhood)
    for name, value, shape in (
        ("mean", found.inputs.mean, (n, c)),
        ("std", found.inputs.std, (n, c)),
        ("landmarks", found.trust.landmarks[:, :1], (n, 1, near)),
        ("radius", found.trust.radius, (n,)),
        ("bound", found.bound, (n,)),
        ("chosen", found.chosen, (n,)),
    ):
        if value.shape != shape:
            raise InputError(
                f"has shape {value.shape}, expected {shape}",
                _REMEDY,
                file=path,
                where=name,
            )
    windows = np.zeros((n, 1, found.inputs.taps, c))
    try:
        found.of_windows(windows)
        for network in found.networks:
            network.outputs(windows)
    except (ValueError, IndexError, TypeError) as error:
        raise InputError(
            f"its weights do not fit together ({error})", _REMEDY, file=path
        ) from None
