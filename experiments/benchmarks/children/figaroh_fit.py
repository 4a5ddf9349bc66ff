"""FIGAROH's base-parameter fit on given arrays; runs in FIGAROH's own environment, apart from the project.

    PYTHON experiments/benchmarks/children/figaroh_fit.py ARRAYS.npz OUT.npz

What is called of FIGAROH: ``Robot``; ``RegressorBuilder.build_basic_regressor`` with friction, actuator inertia and
joint offset; ``get_standard_parameters``, ``add_standard_additional_parameters``, ``get_index_eliminate``,
``build_regressor_reduced``; ``QRDecomposer.double_decomposition`` (pivoted QR, then least squares on the base columns)
with its own tolerance; ``get_baseIndex``, ``build_baseRegressor``. FIGAROH's TX40 example appends three columns for
rotor, viscous and Coulomb friction of motor 6, which the package leaves to the example; they are appended here too.
Regressor and torque pass the filter that the arrays name.
"""

from __future__ import annotations

import json
import sys
from time import perf_counter, process_time

import numpy as np
from figaroh.identification.parameter import (
    add_standard_additional_parameters,
    get_standard_parameters,
)
from figaroh.tools.qrdecomposition import (
    QRDecomposer,
    build_baseRegressor,
    get_baseIndex,
)
from figaroh.tools.regressor import (
    RegressorBuilder,
    RegressorConfig,
    build_regressor_reduced,
    get_index_eliminate,
)
from figaroh.tools.robot import Robot
from scipy.signal import butter, sosfiltfilt


def filtered(series: np.ndarray, rate: float, cutoff: float) -> np.ndarray:
    """Butterworth of order 4, forward and backward, with the padding of the project's filter; axis 0 is time."""
    sos = butter(4, min(cutoff, 0.95 * rate / 2), output="sos", fs=rate)
    return sosfiltfilt(
        sos,
        series,
        axis=0,
        padlen=min(len(series) - 1, int(3 * rate / min(cutoff, rate / 2))),
    )


def regressor(
    robot: Robot, config: dict, motion: np.ndarray, rate: float, cutoff: float
) -> np.ndarray:
    """FIGAROH's regressor with the columns of the coupled wrist, filtered; joint after joint, shape (6 N, p)."""
    q, dq, ddq = motion
    builder = RegressorBuilder(
        robot,
        RegressorConfig(
            has_friction=True, has_actuator_inertia=True, has_joint_offset=True
        ),
    )
    plain = builder.build_basic_regressor(q, dq, ddq, config)
    n, together = len(q), np.sign(dq[:, 4] + dq[:, 5])
    wrist = np.zeros((len(plain), 3))
    wrist[4 * n : 5 * n] = np.column_stack([ddq[:, 5], dq[:, 5], together])
    wrist[5 * n : 6 * n] = np.column_stack([ddq[:, 4], dq[:, 4], together])
    stacked = np.hstack([plain, wrist]).reshape(6, n, -1)
    return np.concatenate([filtered(block, rate, cutoff) for block in stacked])


def main() -> None:
    """Fit on the arrays for fitting, predict on those for judging."""
    arrays = np.load(sys.argv[1])
    rate, cutoff, urdf = (
        float(arrays["rate"]),
        float(arrays["cutoff"]),
        str(arrays["urdf"]),
    )
    robot = Robot(urdf, package_dirs=[urdf.rsplit("/", 1)[0]])
    options = (
        "has_friction",
        "has_actuator_inertia",
        "has_joint_offset",
        "is_joint_torques",
    )
    config = {key: True for key in options} | {
        key: [0.0] * 6 for key in ("fv", "fs", "Ia", "off")
    }
    config |= {
        "act_idxv": list(range(6)),
        "is_external_wrench": False,
        "force_torque": None,
    }
    start, work = perf_counter(), process_time()
    fit = regressor(robot, config, arrays["fit"], rate, cutoff)
    torque = np.concatenate(list(filtered(arrays["torque"], rate, cutoff).T))
    standard = get_standard_parameters(
        robot.model, config
    ) | add_standard_additional_parameters(robot.model, config)
    standard |= dict.fromkeys(("Iam6", "fvm6", "fsm6"), 0.0)
    dropped, kept = get_index_eliminate(fit, standard, 1e-6)
    reduced = build_regressor_reduced(fit, dropped)
    found = QRDecomposer().double_decomposition(torque, reduced, kept, standard)
    values, places = np.asarray(found[3], dtype=float), get_baseIndex(reduced, kept)
    seconds, work = perf_counter() - start, process_time() - work
    judged = build_regressor_reduced(
        regressor(robot, config, arrays["judged"], rate, cutoff), dropped
    )
    np.savez(
        sys.argv[2],
        fit=(build_baseRegressor(reduced, places) @ values).reshape(6, -1).T,
        judged=(build_baseRegressor(judged, places) @ values).reshape(6, -1).T,
    )
    print(json.dumps({"count": len(values), "seconds": seconds, "work": work}))


if __name__ == "__main__":
    main()
