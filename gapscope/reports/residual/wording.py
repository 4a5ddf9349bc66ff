"""Sentences about a learnt residual network, for the page and the terminal."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from gapscope.arm.display import percent

FORMS = {"additive": "sum of functions", "mlp": "MLP", "tcn": "TCN", None: "silent"}
"""What a form is called."""


def facts(content: Mapping[str, Any]) -> str:
    """What was trained on and what was set aside."""
    parts = []
    for key, words in (("fitted", "trained on"), ("judged", "judged on")):
        seconds = sum(one["seconds"] for one in content[key])
        names = ", ".join(dict.fromkeys(one["recording"] for one in content[key]))
        parts.append(f"{words} {seconds:.1f} s ({names})")
    return "; ".join(parts)


def joint_sentence(joint: Mapping[str, Any]) -> str:
    """What was chosen for a joint, and why."""
    tried = ", ".join(
        f"{FORMS[form]} {percent(closed)}"
        for form, closed in joint["closed_in_validation"].items()
    )
    if joint["form"] is None:
        return (
            "The network is silent here: no form closes enough of every recording that it did not see "
            f"(closed of their squares: {tried})."
        )
    return (
        f"Form: {FORMS[joint['form']]}, its output times {joint['gain']:.2g}. Closed of the squares of fitted "
        f"recordings that a member had held out: {tried}. The torque is limited to {joint['bound']:.3g} N m. Means on "
        "the recordings set aside: dots for what the effects leave, lines for what the network says."
    )


def physics_sentence(content: Mapping[str, Any]) -> str:
    """How far the network stays apart from the physics."""
    physics = content["physics"]
    of = {
        "all": "inertial parameters, rotors, friction, offsets and the effects",
        "effects": "the parameters of the effects",
    }[physics["kept_apart_from"]]
    return (
        f"{percent(physics['share_of_residual'])} of the squares of the residual can be explained by {of}, and are "
        f"left to them. Of the network's output {physics['share_of_output']:.1e} lies there; refitted with the network "
        f"in place, a parameter of the effects would move by at most {physics['largest_move']:.1e} standard deviations."
    )
