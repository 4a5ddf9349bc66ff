"""A fleet in words: its headline, places of effects, values and changes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from gapscope.arm.display import display_unit, effect_name, percent, uncertain
from gapscope.diagnosis.document.wording import capital

Entry = Mapping[str, Any]


def headline(content: Entry) -> str:
    """What a fleet's document says, in one sentence."""
    units = _count(content["units"], "unit")
    cases = _count(content["cases"], "case")
    changed = len({change["unit"] for change in content["changes"]})
    what = f"{_count(changed, 'unit')} changed" if changed else "no unit changed"
    failed = (
        f"; {_count(content['failed'], 'case')} failed" if content["failed"] else ""
    )
    return f"{units} in {cases}: {what}{failed}"


def place_words(entry: Entry) -> str:
    """Where an effect acts."""
    if entry["joint"]:
        return f"joint {entry['joint']}"
    return f"link {entry['link']}" if entry["link"] else "the whole arm"


def value_words(value: float, std: float | None, unit: str) -> str:
    """A value with its deviation in a readable unit."""
    factor, shown = display_unit(unit, abs(value))
    text = uncertain(factor * value, None if std is None else factor * std)
    return f"{text} {shown}".strip()


def change_words(change: Entry) -> str:
    """What changed, from what to what."""
    before, after = change["before"], change["after"]
    if change["kind"] != "value":
        shares = f"{percent(before['value'])} to {percent(after['value'])}"
        return f"{change['kind']}: named in {shares} of the diagnoses"
    name = f"{change['parameter'].replace('_', ' ')} {change['component']}".strip()
    values = [
        value_words(v["value"], v["std"], change["si_unit"]) for v in (before, after)
    ]
    return f"{name} from {values[0]} to {values[1]}"


def change_line(change: Entry) -> str:
    """A change as a line of the terminal."""
    effect = capital(effect_name(change["effect"]))
    dates = f"between {change['last_before']} and {change['first_after']}"
    where = place_words(change)
    return f"{change['unit']}: {effect}, {where}, {change_words(change)}, {dates}"


def _count(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"
