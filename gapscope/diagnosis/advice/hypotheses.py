"""From open questions to hypotheses, each with its own values."""

from __future__ import annotations

import numpy as np

from gapscope.arm.nominal import NominalArm
from gapscope.diagnosis.advice.hypothesis import Hypothesis
from gapscope.diagnosis.advice.questions import Question
from gapscope.diagnosis.advice.recorded_data import RecordedData, fitted, with_unknown
from gapscope.effects.applied import AppliedEffect


def hypotheses(
    arm: NominalArm,
    effects: tuple[AppliedEffect, ...],
    questions: list[Question],
    present: RecordedData,
) -> list[Hypothesis]:
    """What was found, then for each question the same with the rival in place; all fitted to the recordings at hand.

    Args:
        arm: the nominal arm.
        effects: those found, with values.
        questions: what is open.
        present: the recordings.
    """
    rng = np.random.default_rng(0)
    out = [fitted(present, Hypothesis("what was found", arm, effects))[0]]
    for question in questions:
        rest = tuple(e for e in out[0].effects if not _asked(e, question))
        with_rival = Hypothesis(question.other, arm, rest)
        if question.rival == "none":
            out.append(fitted(present, with_rival)[0])
        else:
            out.append(
                with_unknown(
                    present, with_rival, question.rival, question.rival_joints, rng
                )
            )
    return out


def _asked(applied: AppliedEffect, question: Question) -> bool:
    """Whether a question is about this effect."""
    link = int(applied.parameters["link"]) if "link" in applied.parameters else 0
    return applied.name == question.effect and link == question.link
