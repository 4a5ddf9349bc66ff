"""A pair of the blind check's generator: a healthy reference, and the same arm with a load on another day."""

from __future__ import annotations

from importlib import import_module

import pytest

pairs = import_module("experiments.12_against")


@pytest.mark.nightly
def test_a_load_alone_is_named_though_the_controller_feeds_the_vendors_arm_forward() -> (
    None
):
    # judged with the identified arm, the declared feedforward would leave what looks like other gains
    found = pairs.judged("small", True, (4, 152))
    assert found["effects"] == ["payload"]
    assert found["error"] == pytest.approx(0.0, abs=0.05)
