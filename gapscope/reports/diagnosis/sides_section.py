"""Section of the report on which side of the joint torque sensors the gap lies."""

from __future__ import annotations

from typing import Any

from gapscope.arm.display import effect_name, significant
from gapscope.diagnosis.document.sentences import sides_sentence
from gapscope.diagnosis.document.wording import acts_on, joint_names, short_names
from gapscope.diagnosis.result import Diagnosis

TITLES = {"actuator": "Actuator side", "link": "Link side"}
WORDS = {
    "actuator": "recorded torque less sensor, against rotor, friction and all between the recorded torque and the gear",
    "link": "sensor, against the bodies, springs and forces behind the gear",
}


def sides(diagnosis: Diagnosis) -> dict[str, Any]:
    """Bars per joint of either side, the sensors' own errors, and the side of each effect; empty without sensors."""
    document = diagnosis.document
    if "sides" not in document:
        return {}
    told, names = document["sides"], joint_names(document)
    gaps = {name: told[name] for name in TITLES}
    values = [
        v
        for g in gaps.values()
        for part in g.values()
        for v in part["torque_nrmse"]
        if v is not None
    ]
    floors = [v for g in gaps.values() for v in g["before"]["floor"] if v is not None]
    return {
        "sentence": sides_sentence(document),
        "charts": [
            {
                "title": TITLES[name],
                "words": WORDS[name],
                "scale": max([*values, *floors], default=0.0) or 1.0,
                "joints": _joints(names, gap),
            }
            for name, gap in gaps.items()
        ],
        "sensors": [
            {
                "label": f"J{j + 1}",
                "name": name,
                "carried": told["carried_by"][j],
                **{
                    key: significant(told["sensor"][key]["value"][j], 2, signed=True)
                    for key in ("zero", "scale")
                },
                "lag": significant(
                    1e3 * told["sensor"]["lag"]["value"][j], 2, signed=True
                ),
            }
            for j, name in enumerate(names)
        ],
        "effects": [
            (effect_name(entry["effect"]), acts_on(entry), entry["side"])
            for entry in told["effects"]
        ],
        "recordings": told["recordings"],
    }


def _joints(names: list[str], gap: dict[str, Any]) -> list[dict[str, Any]]:
    """Rows of one chart."""
    columns = zip(
        names,
        short_names(names),
        gap["before"]["torque_nrmse"],
        gap["after"]["torque_nrmse"],
        gap["before"]["floor"],
        strict=True,
    )
    return [
        {
            "label": f"J{number}",
            "name": name,
            "short": short,
            "before": before,
            "after": after,
            "floor": floor,
        }
        for number, (name, short, before, after, floor) in enumerate(columns, 1)
    ]
