"""A law whose operations are noted once and repeated gives what it gives when it is called."""

import numpy as np
import pytest

from gapscope.envs.drive.rows import repeated

CONSTANT = np.array([0.5, 2.0, 3.0])


def _unsaid(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return x if x[0] > 0 else y


@pytest.mark.parametrize(
    "law",
    [
        lambda x, y: CONSTANT * np.exp(-((x / np.where(CONSTANT > 1, 2.0, 1.0)) ** 2)),
        lambda x, y: np.abs(y) * np.tanh(x) + 1.0 - x,
        lambda x, y: (x > 0) * y + (~(x > 0)) * 2.0,
        lambda x, y: x,
        lambda x, y: CONSTANT,
        lambda x, y: np.where(x > 0, x, y),
        lambda x, y: np.clip(x, -CONSTANT, CONSTANT) + y.max(),
        lambda x, y: np.divmod(x, y)[1] + np.asarray(y) + float(y[0]),
        lambda x, y: np.add(x, y, where=y > -9.0),
        _unsaid,
    ],
)
def test_equal_to_the_law_on_any_arguments(law) -> None:
    calls = []
    noted = repeated(lambda *both: calls.append(0) or law(*both), 2, 3)
    rng = np.random.default_rng(0)
    for _ in range(5):
        x, y = rng.normal(size=(2, 3))
        before = x.copy(), y.copy()
        np.testing.assert_array_equal(noted(x, y), law(x, y))
        np.testing.assert_array_equal((x, y), before)
