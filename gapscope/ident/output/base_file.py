"""The base parameters as matrices, both ways: ``base_parameters.npz``."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gapscope.arm.io.atomic_write import atomic_write
from gapscope.ident.identification import Identification
from gapscope.ident.model.orthonormal_base import orthonormal_base


def write_base(result: Identification, path: Path | str) -> None:
    """Write the base parameters of an identification as arrays; ``path`` never holds half a file.

    ``names`` and ``kept_names`` of the p parameters pi and of the b that represent combinations; ``combination`` C
    with beta = C pi, shape (b, p); ``back`` and ``null_space`` N with pi = back beta + N z for any z, shapes (p, b)
    and (p, p - b); ``value`` and ``covariance`` of beta, ``consistent`` and ``nominal`` pi. ``orthonormal`` V with
    gamma = V^T pi and the shortest pi = V gamma, shape (p, b), by singular value decomposition; ``from_orthonormal``
    and ``to_orthonormal`` T with beta = T gamma and gamma = T beta, shape (b, b).

    Raises:
        GapscopeError: ``path`` cannot be written.
    """
    base, names = result.base, result.base.names
    # C has full rank, so that its rows, padded to p, have the row space of the samples and no weak direction of theirs
    padding = np.zeros((len(names) - base.count, len(names)))
    other = orthonormal_base(np.vstack([base.combination, padding]), names)
    back = np.zeros((len(names), base.count))
    back[base.kept] = np.eye(base.count)
    arrays = {
        "names": np.array(names),
        "kept_names": np.array([names[k] for k in base.kept]),
        "combination": base.combination,
        "back": back,
        "null_space": base.null_space,
        "value": result.estimate.value,
        "covariance": result.uncertainty.covariance,
        "consistent": result.physical.value,
        "nominal": result.columns.nominal(result.choice.law),
        "orthonormal": other.basis,
        "from_orthonormal": other.to_base(base),
        "to_orthonormal": other.from_base(base),
    }
    with atomic_write(path) as aside, aside.open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, **arrays)
