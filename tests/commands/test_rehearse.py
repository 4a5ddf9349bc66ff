"""The command rehearse: what is put in, found or not, and what is kept of an earlier run."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from cases import valid_document

from gapscope.arm.case import load_case
from gapscope.blind_check.generator.recorded import RECORDED_LAWS
from gapscope.many.rehearse import Planned, put_in, size_of

Command = Callable[..., Any]


def test_what_is_put_in_is_found_beside_what_was_there_and_kept(
    gapscope: Command, sick: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    asked = ("--effect", "torque_scale", "--joint", 1, "--sizes", "severity")
    done = gapscope("rehearse", sick, "--out", out, *asked)
    assert done.code == 0, done.err
    content = valid_document(out / "rehearsal.json")
    assert content["as_is"] == ["viscous friction, joint 2"]
    (row,) = content["rows"]
    assert row["outcome"] == "found" and row["named"] == ["torque scale, joint 1"]
    assert row["value"] == pytest.approx(row["size"], rel=0.3)
    assert content["summary"].startswith("Effects put in: 1; found: 1, ")
    assert content["summary"] in " ".join(done.out.split())
    assert "Plotly.newPlot" in (out / "rehearsal.html").read_text(encoding="utf-8")
    diagnosis = out / row["diagnosis"] / "diagnosis.json"
    made = diagnosis.stat().st_mtime_ns
    again = gapscope("rehearse", sick, "--out", out, *asked, "--json")
    assert json.loads(again.out)["rows"] == content["rows"]
    assert diagnosis.stat().st_mtime_ns == made
    there = ("--effect", "viscous_friction", "--joint", 2)
    done = gapscope("rehearse", sick, "--out", out, *there)
    assert done.code == 2 and "is named as it is" in done.err


@pytest.mark.parametrize("name", RECORDED_LAWS)
def test_every_law_puts_in_the_size_that_is_asked_in_every_recording(
    sick: Path, name: str
) -> None:
    case, law = load_case(sick), RECORDED_LAWS[name]
    joint = 0 if law.place == "arm" else 2
    planned = Planned(law, joint, "severity", 0.02)
    changed = put_in(case, planned, 1)
    twice = put_in(case, planned._replace(size=0.04), 1)
    for before, once, more in zip(
        case.recordings, changed.recordings, twice.recordings, strict=True
    ):
        count = len(more.t)
        channel = "q" if name == "encoder_offset" else "tau"
        first, one, two = (getattr(r, channel)[:count] for r in (before, once, more))
        assert one.shape == two.shape and (one != first).any()
        ratio = abs(two - first).mean() / abs(one - first).mean()
        assert ratio == pytest.approx(2.0, rel=0.1)


def test_a_size_is_the_length_of_a_vector() -> None:
    assert size_of("base_tilt", {"roll": 3.0, "pitch": 4.0}) == 5.0
    assert math.isclose(size_of("torque_scale", {"scale": [-0.2]}), 0.2)
