"""A learnt residual network as plain data, and its schema."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

from gapscope.arm.errors import GapscopeError
from gapscope.arm.io.json_file import plain, write_json
from gapscope.ident.residual.curves import learnt_curves
from gapscope.ident.residual.learnt import LearntResidual
from gapscope.ident.residual.trajectory import Trajectory

SCHEMA = 1


def document(found: LearntResidual, files: Mapping[str, str]) -> dict[str, Any]:
    """What was learnt, as plain data in the form of ``residual.schema.json``.

    Args:
        found: what was learnt.
        files: names of the files beside it, by purpose.
    """
    report, settings = found.report, found.settings
    joints = [_joint(found, joint) for joint in range(found.case.arm.n_joints)]
    physics = {
        "kept_apart_from": settings.apart,
        "share_of_residual": report.in_target,
        "share_of_output_before": report.in_output[0],
        "share_of_output": report.in_output[1],
        "largest_move_before": float(report.moves[0].max(initial=0.0)),
        "largest_move": float(report.moves[1].max(initial=0.0)),
    }
    content = {
        "schema": SCHEMA,
        "case": found.case.name,
        "fitted": _recordings(found.fitted),
        "judged": _recordings(found.judged),
        "settings": {"form": settings.form, "seed": settings.seed},
        "joints": joints,
        "physics": physics,
        "files": dict(files),
    }
    return dict(plain(content))


def _joint(found: LearntResidual, joint: int) -> dict[str, Any]:
    report = found.report
    return {
        "name": found.case.arm.joints[joint],
        "form": report.form[joint] or None,
        "gain": report.gain[joint],
        "closed_in_validation": {
            form: closed[joint] for form, closed in report.by_form.items()
        },
        "rmse": {
            "nothing": found.nothing[joint],
            "network": found.network[joint],
            "trees": found.trees[joint],
        },
        "bound": found.residual.bound[joint],
        "curves": [vars(curve) for curve in learnt_curves(found, joint)],
    }


def _recordings(trajectories: Sequence[Trajectory]) -> list[dict[str, Any]]:
    """Names and lengths; a recording with gaps occurs once per piece."""
    return [
        {"recording": x.name, "seconds": x.motion.t[-1] - x.motion.t[0]}
        for x in trajectories
    ]


@cache
def _validator() -> Any:
    from jsonschema import Draft202012Validator

    folder = resources.files("gapscope.ident.residual")
    text = folder.joinpath("residual.schema.json").read_text(encoding="utf-8")
    return Draft202012Validator(json.loads(text))


def write_document(content: Mapping[str, Any], path: Path | str) -> None:
    """Check a document against ``residual.schema.json`` and write it.

    Raises:
        GapscopeError: a field is missing or has a wrong value, or the file cannot be written.
    """
    from jsonschema.exceptions import best_match

    error = best_match(_validator().iter_errors(content))
    if error is not None:
        raise GapscopeError(
            f"residual.json, {error.json_path}: {error.message}",
            "gapscope/ident/residual/residual.schema.json describes the format",
        )
    write_json(content, path)
