"""The matrices of the base parameters, both ways."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from cases import panda_case, panda_motion

from gapscope.arm.motions.motion import Motion
from gapscope.ident.identification import IdentificationSettings, identify
from gapscope.ident.output.base_file import write_base


def test_matrices_lead_both_ways(tmp_path: Path) -> None:
    result = identify(panda_case(), IdentificationSettings(cutoff=20.0))
    write_base(result, tmp_path / "base.npz")
    found = np.load(tmp_path / "base.npz", allow_pickle=False)
    p, b = len(found["names"]), len(found["kept_names"])
    assert (p, b) == (98, 69)
    rng = np.random.default_rng(0)
    pi, z = rng.standard_normal(p), rng.standard_normal(p - b)
    beta = found["combination"] @ pi
    np.testing.assert_allclose(
        found["combination"] @ (found["back"] @ beta + found["null_space"] @ z),
        beta,
        atol=1e-9,
    )
    gamma = found["orthonormal"].T @ pi
    np.testing.assert_allclose(
        found["orthonormal"].T @ found["orthonormal"], np.eye(b), atol=1e-12
    )
    np.testing.assert_allclose(found["from_orthonormal"] @ gamma, beta, atol=1e-8)
    np.testing.assert_allclose(found["to_orthonormal"] @ beta, gamma, atol=1e-8)
    matrix = result.columns.matrix(states(), result.choice.law)
    np.testing.assert_allclose(
        matrix @ pi, matrix[:, :, result.base.kept] @ beta, atol=1e-6
    )
    np.testing.assert_allclose(
        matrix @ (found["orthonormal"] @ gamma), matrix @ pi, atol=1e-6
    )


def states() -> Motion:
    reference = panda_motion(5)
    t = np.arange(100) / 20
    return Motion(
        t, reference.position(t), reference.velocity(t), reference.acceleration(t)
    )
