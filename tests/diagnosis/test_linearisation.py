"""The linearised torque against finite differences of the corrected arm, through the normal equations it hands out.

With X' the columns found here, every entry of X^T W X must equal that of X'^T W X': norms and angles of all columns,
those with the gap included.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
import synthetic

from diagnosis.data import Data
from diagnosis.gap import healthy
from diagnosis.linear import Linearisation, effective_samples
from diagnosis.terms import EXPLAINED, Terms
from effects.applied import AppliedEffect
from effects.catalogue import CATALOGUE
from effects.corrected import CorrectedArm
from ident.conditioning import Segment, condition

TERMS = Terms(synthetic.N)
CUTOFF = 12.0
AWAY = {
    "coulomb_friction": [0.5, -1.0, 0.3],
    "viscous_friction": [1.0, 0.5, -0.4],
    "load_friction": [0.1, 0.05, 0.15],
    "armature": [0.2, -0.3, 0.1],
    "torque_scale": [0.15, -0.2, 0.1],
    "torque_offset": [1.0, -2.0, 0.5],
    "actuator_delay": [0.004, 0.008, 0.006],
    "encoder_offset": [0.03, -0.05, 0.04],
}


def theta(*names: str) -> np.ndarray:
    """Parameter vector with some of the values of ``AWAY``; ``payload`` is 1.5 kg at (0.2, -0.05, 0.1) m."""
    out = np.zeros(TERMS.size)
    for name in names:
        if name == "payload":
            out[TERMS.payload] = 1.5 * np.array([1.0, 0.2, -0.05, 0.1])
        else:
            out[TERMS.block(CATALOGUE[name])] = AWAY[name]
    return out


@cache
def segment() -> Segment:
    recording = synthetic.recordings(synthetic.Truth(coulomb=(1.0, 0.0, 0.0)), duration=6.0)[2]
    return condition(recording, 20.0)[0]


def predict(effects: tuple[AppliedEffect, ...]) -> np.ndarray:
    return CorrectedArm(synthetic.arm(), effects).predict(synthetic.body(), segment().motion)


def by_differences(around: np.ndarray) -> np.ndarray:
    """Derivatives of the predicted torque by theta, (N, n, P), by central differences."""
    columns = []
    for k in range(TERMS.size):
        h = 1e-4
        up, down = around + h * np.eye(TERMS.size)[k], around - h * np.eye(TERMS.size)[k]
        if k in TERMS.payload and around[TERMS.payload[0]] == 0.0:
            columns.append(massless(k, around))
        elif (k in range_of("actuator_delay") and around[k] < h) or (k in range_of("load_friction") and around[k] < h):
            columns.append((predict(TERMS.effects(up)) - predict(TERMS.effects(around))) / h)
        else:
            columns.append((predict(TERMS.effects(up)) - predict(TERMS.effects(down))) / (2 * h))
    return np.stack(columns, axis=2)


def massless(k: int, around: np.ndarray) -> np.ndarray:
    """By mass: a mass at the joint's centre. By first moment: the odd part in c, as inertia is even in it."""
    others, axis = TERMS.effects(around), k - TERMS.payload[0] - 1

    def with_load(mass: float, com: np.ndarray) -> np.ndarray:
        return predict((*others, AppliedEffect("payload", (), {"mass": mass, "com": com})))

    if axis < 0:
        return with_load(1.0, np.zeros(3)) - predict(others)
    c = 0.1 * np.eye(3)[axis]
    return (with_load(1.0, c) - with_load(1.0, -c)) / 0.2


def range_of(name: str) -> np.ndarray:
    places = TERMS.payload if name == "payload" else np.arange(TERMS.size)[TERMS.block(CATALOGUE[name])]
    return np.asarray(places)


AROUND = {
    "nothing": (),
    **{name: (name,) for name in EXPLAINED},
    "the way to the joint": ("torque_scale", "torque_offset", "actuator_delay"),
    "friction": ("coulomb_friction", "viscous_friction", "load_friction"),
    "a payload on an arm that is off": ("payload", "encoder_offset", "torque_scale"),
}


@pytest.mark.parametrize("names", AROUND.values(), ids=AROUND)
def test_columns_equal_finite_differences(names: tuple[str, ...]) -> None:
    compare(names, [name for name in EXPLAINED if "payload" not in names or name != "encoder_offset"])


@pytest.mark.parametrize("names", [("payload",), ("payload", "encoder_offset")])
def test_columns_of_encoder_offset_beside_a_payload(names: tuple[str, ...]) -> None:
    compare(names, list(EXPLAINED))


def compare(names: tuple[str, ...], effects: list[str]) -> None:
    around = theta(*names)
    data = Data(synthetic.arm(), synthetic.body(), [[segment()]], CUTOFF)
    (fold,) = Linearisation(data, TERMS, around).folds
    columns = data.thin(by_differences(around), segment())
    torque = segment().torque
    assert torque is not None
    gap = data.thin(torque - predict(TERMS.effects(around)), segment())
    full = np.concatenate([columns, gap[:, :, None]], axis=2)
    doubt = healthy(CorrectedArm(synthetic.arm(), TERMS.effects(around)), synthetic.body(), segment())
    friction = doubt.sticking[:: data.step(segment())]
    weight = 1.0 / (1.0 + (friction / doubt.steady) ** 2)
    expected = np.einsum("tja,tj,tjb->jab", full, weight, full)

    places = np.concatenate([range_of(name) for name in effects])
    chosen = [*places, TERMS.size]
    to = np.eye(fold.gram.shape[-1])[:, [*range(TERMS.size), -1]]
    to[: TERMS.size, -1] = -around  # the gap at theta_0 is y - A theta_0
    found = (to.T @ fold.gram.sum(axis=0) @ to)[:, chosen][:, :, chosen]
    expected = expected[:, chosen][:, :, chosen]

    size = np.sqrt(np.einsum("jaa->ja", expected))
    for j in range(synthetic.N):
        there = size[j] > 1e-6 * size.max()
        scale = np.where(there, size[j], size.max())
        difference = (found[j] - expected[j]) / np.outer(scale, scale)
        worst = np.unravel_index(np.abs(difference).argmax(), difference.shape)
        owners = [name for w in worst for name in effects if w < len(places) and places[w] in range_of(name)]
        assert np.abs(difference).max() < 0.05, f"joint {j + 1}, columns of {owners}: {difference[worst]:.3g}"


def test_rows_add_up_whatever_the_pieces() -> None:
    data = Data(synthetic.arm(), synthetic.body(), [[segment()], [segment(), segment()]], CUTOFF)
    one, two = Linearisation(data, TERMS, np.zeros(TERMS.size)).folds
    np.testing.assert_allclose(two.gram.sum(axis=0), 2 * one.gram.sum(axis=0), rtol=1e-6, atol=1e-6 * two.gram.max())
    np.testing.assert_allclose(two.rows.sum(axis=0), 2 * one.rows.sum(axis=0))
    assert len(two.gram) > len(one.gram)


@pytest.mark.parametrize(("rho", "share"), [(0.0, 1.0), (0.5, 1 / 3), (0.9, 1 / 19)])
def test_effective_samples_of_an_autoregressive_series(rho: float, share: float) -> None:
    rng = np.random.default_rng(0)
    x = np.zeros((20000, 1))
    for i in range(1, len(x)):
        x[i] = rho * x[i - 1] + rng.standard_normal()
    assert effective_samples(x)[0] == pytest.approx(share * len(x), rel=0.1)
