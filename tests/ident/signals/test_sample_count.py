"""What is said of recordings that hold little information."""

from __future__ import annotations

import numpy as np

from gapscope.ident.signals.sample_count import SampleCount

FEW = SampleCount(
    seconds=4.0, bandwidth=np.array([1.0, 2.0]), independent=24.0, parameters=24
)


def test_faster_motion_is_advised_unless_the_model_lacks_an_effect() -> None:
    """Faster motion holds more information per second, and more of what the model lacks."""
    (noise_alone,) = FEW.warnings(model_error=False)
    (with_model_error,) = FEW.warnings(model_error=True)
    assert noise_alone == with_model_error + ", or move faster"
