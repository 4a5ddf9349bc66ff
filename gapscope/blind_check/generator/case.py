"""One case of the blind check: drawn, simulated, measured, and written in the project's case format."""

from __future__ import annotations

import csv
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from gapscope.arm.errors import GapscopeError
from gapscope.blind_check.generator.case_setup import CaseSetup, draw_setup
from gapscope.blind_check.generator.conditions import STRONG, WEAK, CaseSpec
from gapscope.blind_check.generator.law import Cause
from gapscope.blind_check.generator.laws import LAWS
from gapscope.blind_check.generator.measure import rms
from gapscope.blind_check.generator.sizing import draw_cause
from gapscope.blind_check.generator.true_arm import Columns, TrueArm
from gapscope.blind_check.generator.urdf import text_of

ATTEMPTS = 120
"""Draws of a case before giving up."""
EASED = (8, 16, 24)
"""Draws after which less is asked of a case: the lowest class; nearly true inertials; another arm without extra noise,
whose other recordings need not show the cause."""
DRAWS = 3
"""Draws of a cause on one arm with its motions, before another is taken."""
VISIBLE = 3.0
"""Least ratio of the gap to the floor in a case of a strong class."""
MIN_VISIBLE_NRMSE = 0.02
"""Torque NRMSE that a strong cause reaches in some recording that may be fitted."""


@dataclass(frozen=True)
class MadeCase:
    """A case before it is written.

    Attributes:
        bench: arm, controller and motions.
        plant: the true arm.
        causes: what is at work.
        rows: the recordings, the last of them the held-out one.
        label: the truth, as JSON data.
    """

    setup: CaseSetup
    plant: TrueArm
    causes: tuple[Cause, ...]
    rows: list[Columns]
    label: dict[str, Any]


def make_case(spec: CaseSpec, seed: tuple[int, ...]) -> MadeCase:
    """Draw until a case runs well; the same seed gives the same case.

    Raises:
        GapscopeError: no draw gave a case, or MuJoCo or numba is not installed.
    """
    for attempt in range(ATTEMPTS):
        rng = np.random.default_rng([*seed, attempt])
        made = _attempt(_eased(spec, attempt), rng, attempt)
        if made is not None:
            return made
    raise GapscopeError(
        f"no case with {' and '.join(spec.laws) or 'no effect'} came about in {ATTEMPTS} draws on {spec.conditions}",
        "leave the effect out of the plan, or draw from another seed",
    )


def _eased(spec: CaseSpec, attempt: int) -> CaseSpec:
    """The case as it is wanted; after many draws the lowest class of its kind, then nearly true inertials as well.

    Some effects cannot reach a high class on some arms: the loop becomes unstable first.
    """
    if attempt < EASED[0] or spec.severity is None:
        return spec
    severity = STRONG[0] if spec.severity[0] >= VISIBLE else spec.severity
    conditions = spec.conditions
    if attempt >= EASED[1]:
        nearly_true = min(conditions.inertials_off, 0.02)
        conditions = replace(conditions, inertials_off=nearly_true)
    if attempt >= EASED[2]:
        conditions = replace(conditions, robot="franka_panda", noise=1.0)
    return replace(spec, severity=severity, conditions=conditions)


def _attempt(spec: CaseSpec, rng: np.random.Generator, attempt: int) -> MadeCase | None:
    """One draw of a case; ``None`` if it does not run well or does not show its cause."""
    setup = draw_setup(spec.conditions, rng)
    if setup is None:
        return None
    causes = _draw_causes(spec, setup, rng)
    if causes is None:
        return None
    plant = setup.plant(causes)
    rows = _record_all(setup, plant)
    if rows is None:
        return None
    if attempt < EASED[2] and not _shown(setup, causes, rows, spec):
        return None
    gap, scale = setup.gap(rows[-1])
    ratio = rms(gap) / setup.floor
    by_torque = bool(causes) and all(cause.law.measure == "torque" for cause in causes)
    strong = spec.severity is not None and spec.severity[0] >= VISIBLE
    # together several causes may cancel
    if by_torque and strong and ratio.max() < VISIBLE:
        return None
    spoiled = [_spoiled(plant, recorded, rng) for recorded in rows]
    label = _label(spec, setup, causes, gap, scale, attempt)
    return MadeCase(setup, plant, tuple(causes), spoiled, label)


def _draw_causes(
    spec: CaseSpec, setup: CaseSetup, rng: np.random.Generator
) -> list[Cause] | None:
    """The causes of a case, each with a few tries; ``None`` if one of them finds no size."""
    causes = []
    for name in spec.laws:
        drawn = (
            draw_cause(LAWS[name], setup, spec.severity, rng) for _ in range(DRAWS)
        )
        cause = next((cause for cause in drawn if cause is not None), None)
        if cause is None:
            return None
        causes.append(cause)
    return causes


def _record_all(setup: CaseSetup, plant: TrueArm) -> list[Columns] | None:
    """All recordings, the held-out one as the last; ``None`` as soon as one cannot be used."""
    held_out = setup.run(plant, -1)
    if held_out is None:
        return None
    rows = []
    for k in range(len(setup.motions) - 1):
        recorded = setup.run(plant, k)
        if recorded is None:
            return None
        rows.append(recorded)
    return [*rows, held_out]


def _shown(
    setup: CaseSetup, causes: list[Cause], rows: list[Columns], spec: CaseSpec
) -> bool:
    """Whether what a strong cause does to the held-out motion can be seen in some other recording too.

    It must be ``VISIBLE`` times the floor and ``MIN_VISIBLE_NRMSE`` of torque NRMSE on the joint where it is widest.
    """
    single = len(causes) == 1 and causes[0].law.measure == "torque"
    if not single or spec.severity is None or spec.severity[0] < VISIBLE:
        return True
    gap, _ = setup.gap(rows[-1])
    joint = int(np.argmax(rms(gap - setup.twin) / setup.floor))
    for recorded in rows[:-1]:
        gap, scale = setup.gap(recorded)
        least = max(VISIBLE * setup.floor[joint], MIN_VISIBLE_NRMSE * scale[joint])
        if rms(gap)[joint] > least:
            return True
    return False


def _spoiled(plant: TrueArm, rows: Columns, rng: np.random.Generator) -> Columns:
    for spoil in plant.spoil:
        rows = spoil(rows, rng)
    return rows


def _label(
    spec: CaseSpec,
    setup: CaseSetup,
    causes: list[Cause],
    gap: np.ndarray,
    scale: np.ndarray,
    attempt: int,
) -> dict[str, Any]:
    nrmse = rms(gap) / scale
    floor = setup.floor / scale
    own = rms(gap - setup.twin) / setup.floor
    by_torque = all(cause.law.measure == "torque" for cause in causes)
    steps = [
        float(cause.values["step"].max() / setup.context.encoder_step)
        for cause in causes
        if cause.law.measure == "step"
    ]
    ratio = float((nrmse / floor).max()) if by_torque else max(steps, default=None)
    return {
        "kind": spec.kind,
        "effects": [cause.label() for cause in causes],
        "severity": _class(spec, causes, own),
        "measure": "torque" if by_torque else "step" if steps else "none",
        "ratio": None if ratio is None else round(ratio, 3),
        "signature": _rounded(own, 3),
        "gap": _rounded(nrmse, 5),
        "floor": _rounded(floor, 5),
        "conditions": asdict(spec.conditions),
        "motions": setup.kinds,
        "feedforward": setup.loop.feedforward,
        "attempts": attempt + 1,
    }


def _rounded(values: np.ndarray, digits: int) -> list[float]:
    """Numbers of a label."""
    return [round(float(x), digits) for x in values]


def _class(spec: CaseSpec, causes: list[Cause], own: np.ndarray) -> list[float] | None:
    """The severity class that a single effect has come into; that of the plan for several, none without any."""
    if spec.severity is None:
        return None
    if len(causes) != 1 or causes[0].law.measure != "torque":
        return list(spec.severity)
    for severity in (*WEAK, *STRONG):
        if own.max() <= severity[1]:
            return list(severity)
    return list(STRONG[-1])


def write_case(
    made: MadeCase, name: str, bare: bool, folder: Path, unseen: Path
) -> None:
    """Write ``case.yaml``, ``robot.urdf`` and the recordings into a folder, the held-out recording elsewhere."""
    folder.mkdir(parents=True)
    unseen.parent.mkdir(parents=True, exist_ok=True)
    root = made.setup.arm.root
    if made.plant.spoil_urdf is not None:
        made.plant.spoil_urdf(root)
    (folder / "robot.urdf").write_text(text_of(root), encoding="utf-8")
    names = [f"recording_{letter}.csv" for letter in "abcdefgh"[: len(made.rows) - 1]]
    content = _case_content(made, name, bare)
    content["recordings"] = names
    text = yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=110)
    (folder / "case.yaml").write_text(text, encoding="utf-8")
    channels = ("q", "tau") if bare else ("q", "dq", "tau", "q_ref", "dq_ref")
    paths = [*(folder / name for name in names), unseen]
    for rows, path in zip(made.rows, paths, strict=True):
        _write_rows(rows, path, channels)


def _case_content(made: MadeCase, name: str, bare: bool) -> dict[str, Any]:
    """The parts of ``case.yaml`` on arm and controller; without the controller if ``bare``."""
    arm, loop = made.setup.arm, made.setup.loop
    content: dict[str, Any] = {
        "name": name,
        "robot": "robot.urdf",
        "nominal": {
            "armature": _plain(arm.armature),
            "coulomb": _plain(arm.coulomb),
            "viscous": _plain(arm.viscous),
            "torque_limit": _plain(loop.limit),
            "encoder": "motor",
            "encoder_step": made.setup.context.encoder_step,
        },
    }
    if not bare:
        content["controller"] = {
            "kind": "pd",
            "rate": loop.rate,
            "kp": _plain(loop.kp),
            "kd": _plain(loop.kd),
            "feedforward": loop.feedforward,
            "velocity_filter": {"cutoff": loop.cutoff, "damping": loop.damping},
        }
    return content


def _plain(values: np.ndarray) -> list[float]:
    """Numbers of a case file, to eight digits."""
    return [float(f"{x:.8g}") for x in values]


def _write_rows(rows: Columns, path: Path, channels: tuple[str, ...]) -> None:
    """A recording as CSV: t, then each channel's joints."""
    n = rows["q"].shape[1]
    head = ["t"]
    for channel in channels:
        head += [f"{channel}{j}" for j in range(1, n + 1)]
    table = np.column_stack([rows["t"], *(rows[channel] for channel in channels)])
    with path.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file, lineterminator="\n").writerow(head)
        np.savetxt(file, table, fmt="%.8g", delimiter=",")
