"""Advice in words."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from gapscope.arm.display import percent, significant
from gapscope.diagnosis.advice.contrast import HypothesisContrast
from gapscope.diagnosis.advice.next_recording import Advice
from gapscope.diagnosis.document.wording import listing
from gapscope.diagnosis.thresholds import MAY_SETTLE, SETTLES


def lines(advice: Advice, document: Mapping[str, Any]) -> list[str]:
    """What is open, how far the predictions differ on the present and on the new recording, and what was chosen."""
    if not advice.questions:
        return list(_nothing_between(advice, document))
    out = list(_questions(advice))
    return [*out, *_verdict(advice), *_choice(advice)]


def _nothing_between(advice: Advice, document: Mapping[str, Any]) -> Iterable[str]:
    named = (
        f" The diagnosis asks for: {document['next_recording']}."
        if document["next_recording"]
        else ""
    )
    if advice.excitation is None:
        yield f"Nothing is open that another motion would settle: nothing was written.{named}"
        return
    joints = list(
        dict.fromkeys(
            str(region["joint"]) for region in document["unexplained"]["where"]
        )
    )
    place = (
        f", most of it on joint{'s' if len(joints) > 1 else ''} {listing(joints)}"
        if joints
        else ""
    )
    yield (
        "No two explanations are left to tell apart, but "
        f"{percent(document['unexplained']['share'])} of the gap is unexplained{place}."
    )
    yield "The new recording excites all that a model of the arm may hold; what no effect explains shows on it as well."


def _questions(advice: Advice) -> Iterable[str]:
    for k, question in enumerate(advice.questions, 1):
        pair = next(p for p in advice.pairs if (p.first, p.second) == (0, k))
        yield (
            f"Still open: {question.found}, or {question.other}, which has a probability of "
            f"{percent(question.probability)}."
        )
        yield f"  {_compared(pair)}"
    names = ["what was found", *(question.other for question in advice.questions)]
    for pair in advice.pairs:
        if pair.first > 0:
            yield f"Between {names[pair.first]} and {names[pair.second]}:"
            yield f"  {_compared(pair)}"


def _compared(pair: HypothesisContrast) -> str:
    times = pair.new / max(pair.present, 1e-9)
    more = f", {significant(times, 2)} times as much" if 1.0 < times < 1e3 else ""
    return (
        f"their predictions differ by {significant(pair.present, 2)} times the floor on the present recordings, and by "
        f"{significant(pair.new, 2)} times the floor on the new one{more}; most on joint {pair.joint}."
    )


def _verdict(advice: Advice) -> Iterable[str]:
    least = min(pair.new for pair in advice.pairs)
    if least >= SETTLES:
        yield "That should settle it: record it, add it to the case, and diagnose again."
    elif least >= MAY_SETTLE:
        yield "That may settle it: record it two or three times, add it to the case, and diagnose again."
    else:
        yield (
            "That will hardly settle it: within these limits no motion was found on which they differ by more. Wider "
            "limits, a known payload (--payload), a joint torque sensor or an encoder behind the gears may."
        )


def _choice(advice: Advice) -> Iterable[str]:
    assert advice.option is not None
    known = [
        (option.words, "breaks the limits" if d is None else significant(d, 2))
        for option, d in advice.tried
    ]
    yield f"Chosen: {advice.option.words}. Reached in a short search, in floors:"
    yield from (f"  {words}: {reached}" for words, reached in known)
    if advice.option.payload is not None:
        x, y, z = (f"{number:g}" for number in advice.option.payload.com)
        yield f"Mount {advice.option.payload.words}, and say so in case.yaml, under the name of the new recording:"
        yield "  payloads:"
        yield f"    recording.csv: {{mass: {advice.option.payload.mass:g}, com: [{x}, {y}, {z}]}}"
    elif any(option.payload is not None for option, _ in advice.tried):
        yield "The payload does not separate them enough better to be worth mounting."
