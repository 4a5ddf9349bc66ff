"""FIGAROH's regressor and base parameters on stored states, timed.

It runs in FIGAROH's own environment, and so imports nothing of the project. Give the URDF and an NPZ file with q, dq
and ddq of shape (N, n); it prints wall and processor times [s] as JSON.
"""

from __future__ import annotations

import json
import sys
import time
import warnings
from types import SimpleNamespace

import numpy as np
import pinocchio as pin

warnings.simplefilter("ignore")
from figaroh.tools.qrdecomposition import get_baseParams  # noqa: E402
from figaroh.tools.regressor import (  # noqa: E402
    build_regressor_basic,
    build_regressor_reduced,
    get_index_eliminate,
)


def clock() -> np.ndarray:
    """Wall time, and processor time of this process [s], shape (2,)."""
    return np.array([time.perf_counter(), time.process_time()])


def main() -> None:
    """Time the three calls that FIGAROH's own examples make."""
    model = pin.buildModelFromUrdf(sys.argv[1])
    states = np.load(sys.argv[2])
    robot = SimpleNamespace(model=model, data=model.createData())
    settings = {
        "has_friction": True,
        "has_actuator_inertia": True,
        "has_joint_offset": True,
        "is_joint_torques": True,
        "act_idxv": list(range(model.nv)),
    }
    ticks = [clock()]
    W = build_regressor_basic(robot, states["q"], states["dq"], states["ddq"], settings)
    ticks.append(clock())
    names = {f"p{k:03d}": 0.0 for k in range(W.shape[1])}
    empty, left = get_index_eliminate(W, names)
    reduced = build_regressor_reduced(W, empty)
    ticks.append(clock())
    base = get_baseParams(reduced, left)
    ticks.append(clock())
    regressor, reduction, decomposition = np.diff(ticks, axis=0)
    result = {"shape": W.shape, "count": len(base[2]), "regressor": regressor.tolist()}
    result["base"] = (reduction + decomposition).tolist()
    print(json.dumps(result))


if __name__ == "__main__":
    main()
