"""Diagnose the recordings of real arms, and set what is found beside published values.

    .venv/bin/python experiments/02_real_arms.py [--out out/real_arms]

Stäubli TX40: the reference friction and rotor inertia come from the file published with the data. The relative error is
the RMS residual over the RMS torque, stacked over joints, on the rows set aside for judging, both sides filtered at 10
and at 100 Hz, on all rows and on those where the joint moves faster than 0.05 rad/s; beside it a plain least-squares
fit of all inertial parameters, friction and offset, the coupled wrist included, to the fitting rows (minimum norm).
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import yaml

from gapscope.arm.case import Case, load_case
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import GapscopeError
from gapscope.arm.nominal import smooth_sign
from gapscope.commands.diagnose_path import diagnose_path
from gapscope.diagnosis.result import Diagnosis
from gapscope.effects.corrected import CorrectedArm
from gapscope.model.conditioning import Segment, condition, low_pass

CASES = Path(__file__).parent / "cases"
MOVING = 0.05
"""A joint moves when it is faster than this [rad/s]."""


def features(body: RigidBody, segment: Segment) -> np.ndarray:
    """Columns of a plain least-squares fit, (N, n, 14 n + 3): inertials, rotor, viscous, Coulomb, offset of each joint.

    The last three are rotor, viscous and Coulomb friction of motor 6, which turns with joints 5 and 6 together.
    """
    m, n = segment.motion, body.n_joints
    own = [m.ddq, m.dq, smooth_sign(m.dq), np.ones_like(m.q)]
    wrist = np.zeros((len(m.t), n, 3))
    for k, x in enumerate((m.ddq, m.dq)):
        wrist[:, 4, k], wrist[:, 5, k] = x[:, 5], x[:, 4]
    wrist[:, 4:, 2] = smooth_sign(m.dq[:, 4] + m.dq[:, 5])[:, None]
    joints = [x[:, :, None] * np.eye(n) for x in own]
    return np.concatenate([body.regressor(m.q, m.dq, m.ddq), *joints, wrist], axis=2)


def relative(error: np.ndarray, torque: np.ndarray, rows: np.ndarray) -> float:
    """RMS residual over RMS torque, stacked over joints, on the chosen samples."""
    return float(np.sqrt((error[rows] ** 2).mean() / (torque[rows] ** 2).mean()))


def tx40_errors(case: Case, found: Diagnosis, cutoff: float) -> None:
    """Print the relative errors of the nominal arm, the corrected arm and plain least squares at one cut-off [Hz]."""
    body = RigidBody(case.arm)
    fit, judged = (
        condition(r, cutoff)[0] for r in (case.recordings[0], case.judged[0])
    )
    x, y = (
        low_pass(z, fit.motion.rate, cutoff)[fit.inner]
        for z in (features(body, fit), fit.torque)
    )
    parameters = np.linalg.lstsq(x.reshape(-1, x.shape[2]), y.ravel(), rcond=1e-9)[0]
    in_sample = relative(y - x @ parameters, y, np.full(y.shape, True))
    print(f"  both sides at {cutoff:g} Hz: in-sample least squares {in_sample:.1%}")
    models = {
        "nominal": CorrectedArm(case.arm).predict(body, judged.motion),
        "with the effects found": CorrectedArm(case.arm, found.effects).predict(
            body, judged.motion
        ),
        "plain least squares": features(body, judged) @ parameters,
    }
    torque = low_pass(judged.torque, judged.motion.rate, cutoff)[judged.inner]
    moving = np.abs(judged.motion.dq[judged.inner]) > MOVING
    for name, prediction in models.items():
        error = torque - low_pass(prediction, judged.motion.rate, cutoff)[judged.inner]
        every = np.full(torque.shape, True)
        first = np.zeros_like(every)
        first[:, :4] = True
        figures = [
            relative(error, torque, rows) for rows in (every, moving, moving & first)
        ]
        row = "  ".join(f"{figure:6.1%}" for figure in figures)
        print(f"    {name:23} all judged rows, moving, moving joints 1-4: {row}")


def tx40_parameters(case: Case, found: Diagnosis) -> None:
    """Print friction and rotor inertia beside the published values."""
    path = case.arm.urdf.parent / "TX40_config.yaml"
    published = yaml.safe_load(path.read_text(encoding="utf-8"))["identification"][
        "robot_params"
    ][0]
    for name, parameter, key in (
        ("viscous_friction", "coefficient", "fv"),
        ("coulomb_friction", "torque", "fs"),
        ("armature", "inertia", "Ia"),
    ):
        values = CorrectedArm(case.arm, found.effects).value(name, parameter)
        print(
            f"  {name:17} found {np.round(values, 3).tolist()}  published {published[key]}"
        )


def main() -> None:
    """Diagnose each real arm and print what was found."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--out", type=Path, default=Path("out/real_arms"))
    out = parser.parse_args().out
    for path in sorted(CASES.glob("*.yaml")):
        try:
            case = load_case(path)
            found, _ = diagnose_path(path, out / case.name)
        except GapscopeError as error:
            print(f"{path.stem}: {error}\n")
            continue
        document = found.document
        print(f"{case.name}: {document['verdict']}")
        for stage in ("before", "after"):
            print(
                f"  torque NRMSE {stage:6} {np.round(document['gap'][stage]['torque_nrmse'], 3).tolist()}"
            )
        print(
            f"  floor               {np.round(document['gap']['before']['floor'], 3).tolist()}"
        )
        for applied in found.effects:
            values = {
                name: np.round(value, 3).tolist()
                for name, value in applied.parameters.items()
            }
            print(f"  {applied.name} {list(applied.joints)} {values}")
        if case.name == "staubli_tx40":
            tx40_parameters(case, found)
            for cutoff in (10.0, 100.0):
                tx40_errors(case, found, cutoff)
        print()


if __name__ == "__main__":
    main()
