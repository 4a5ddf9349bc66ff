"""An agreement in sentences: with what a difference goes, and which recording would settle it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gapscope.arm.display import percent
from gapscope.diagnosis.agreement.agreement import LOAD as LAST_LINK
from gapscope.diagnosis.agreement.agreement import ParameterAgreement
from gapscope.diagnosis.agreement.covariates import (
    LOAD,
    ORDER,
    SPEED,
    START,
    TEMPERATURE,
    Covariate,
)

QUANTITY = {
    SPEED: "mean speed",
    TEMPERATURE: "temperature",
    LOAD: "load torque",
    START: "start time",
    ORDER: "order of the recordings",
}
"""Covariates in words."""


def goes_with(line: ParameterAgreement, labels: Sequence[str]) -> str:
    """What a difference goes with; an empty string if there is none."""
    found = line.explanation
    if found is None:
        return ""
    if len(_among(line)) < 3:
        changed = [QUANTITY[name] for name in found.changed]
        return f"two recordings cannot say; they differ in {_listed(changed) or 'nothing known'}"
    names = [QUANTITY[name] for name in found.goes_with]
    if found.alone is not None:
        names.insert(0, f"{labels[found.alone]} alone")
    if not names:
        return "nothing that is known of the recordings"
    if len(names) == 1:
        shares = [found.shares[name] for name in found.goes_with]
        return f"{names[0]} ({percent(shares[0])})" if shares else names[0]
    return f"{' or '.join(names)}: not told apart"


def settles(line: ParameterAgreement, labels: Sequence[str]) -> str:
    """The recording that would settle a difference; an empty string if there is none."""
    found = line.explanation
    if found is None:
        return ""
    among = _among(line)
    if line.quantity.key == LAST_LINK:
        value = line.values.value
        heaviest = labels[among[int(np.argmax(value[among]))]]
        return (
            f"repeat {heaviest} with the empty flange; if it carried a known load, enter that under payloads: in the "
            "case"
        )
    if len(among) > 2 and found.alone is not None:
        again = f"repeat {labels[found.alone]}: if its value comes back, what is different there changes it"
        others = [QUANTITY[name] for name in found.goes_with]
        if others:
            again += f"; then vary the {others[0]} alone"
        return again
    names = found.goes_with if len(among) > 2 else found.changed
    if len(names) > 1:
        return _one_at_a_time(line, labels, names[0])
    if names:
        return _variation(line, labels, names[0])
    last = labels[among[-1]]
    return f"repeat {labels[among[0]]} and {last} one after the other: values that stay apart belong to the motion"


def _variation(line: ParameterAgreement, labels: Sequence[str], name: str) -> str:
    """The recording that tests one covariate."""
    low, high = _extremes(line, labels, name)
    if name == SPEED:
        return f"the motion of {high} at half speed: if the value follows the speed, the arm is the same"
    if name == TEMPERATURE:
        return f"the motion of {low} once more, as warm as {high}: the value should be that of {high}"
    if name == LOAD:
        return f"the motion of {low} with a known payload (payloads: in the case): does the value follow the load?"
    return f"repeat {low} now: if the value of {low} comes back, it was not the time between"


def _one_at_a_time(line: ParameterAgreement, labels: Sequence[str], name: str) -> str:
    """The recording that separates covariates that changed together."""
    low, high = _extremes(line, labels, name)
    if name in (START, ORDER):
        return f"repeat {low} now: if the value of {low} comes back, it was not the time between"
    return f"repeat {low} with the {QUANTITY[name]} of {high}, all else as it was"


def _extremes(
    line: ParameterAgreement, labels: Sequence[str], name: str
) -> tuple[str, str]:
    """Recordings with the lowest and highest value of a covariate."""
    among = _among(line)
    values = covariate(line, name).value[among]
    low, high = among[int(np.argmin(values))], among[int(np.argmax(values))]
    return labels[low], labels[high]


def covariate(line: ParameterAgreement, name: str) -> Covariate:
    """A covariate of a line by its name."""
    return next(one for one in line.covariates if one.name == name)


def _among(line: ParameterAgreement) -> list[int]:
    """Numbers of the recordings that determine the parameter."""
    return [int(r) for r in np.flatnonzero(np.isfinite(line.values.std))]


def _listed(names: Sequence[str]) -> str:
    """``a, b and c``."""
    if len(names) < 2:
        return "".join(names)
    return f"{', '.join(names[:-1])} and {names[-1]}"
