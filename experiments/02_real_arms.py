"""Diagnose the recordings of real arms, and set what is found beside published values.

    .venv/bin/python experiments/02_real_arms.py [--out out/real_arms]

Reference friction and rotor inertia of the Stäubli TX40 come from the file published with the data.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import yaml
from common import CASES, command_line

from gapscope.arm.case import load_case
from gapscope.arm.errors import GapscopeError
from gapscope.effects.corrected import CorrectedArm
from gapscope.many.batch import diagnose_path


def main() -> None:
    """Diagnose each real arm and print what was found."""
    out = command_line(__doc__, out=Path("out/real_arms")).parse_args().out
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
            # friction and rotor inertia beside the published values
            path = case.arm.urdf.parent / "TX40_config.yaml"
            content = yaml.safe_load(path.read_text(encoding="utf-8"))
            published = content["identification"]["robot_params"][0]
            arm = CorrectedArm(case.arm, found.effects)
            for name, parameter, key in (
                ("viscous_friction", "coefficient", "fv"),
                ("coulomb_friction", "torque", "fs"),
                ("armature", "inertia", "Ia"),
            ):
                values = np.round(arm.value(name, parameter), 3).tolist()
                print(f"  {name:17} found {values}  published {published[key]}")
        print()


if __name__ == "__main__":
    main()
