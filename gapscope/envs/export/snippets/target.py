"""A simulator for which a snippet is written, and how its text comes about."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import jinja2
import numpy as np

from gapscope.envs.export.heading import effects_line, xml_comment
from gapscope.envs.export.left_out import described, holds
from gapscope.envs.export.snippets.arm_values import SnippetArm

BODIES = frozenset({"body", "load", "gravity", "zero"})
"""Quantities of bodies and where they are: in the file of the arm that a snippet belongs to."""
JOINTS = frozenset({"friction", "damping", "rotor", "limit"})
"""Quantities that most snippets hold."""

LONGEST = 100
"""Characters of a line of Python, beyond which a dict takes several."""


@dataclass(frozen=True)
class Target:
    """A simulator.

    Attributes:
        name: of the format.
        title: its name and the versions whose words are used.
        template: of the text below the head, in Jinja.
        held: quantities that the snippet holds, as far as ``hints`` says; see ``gapscope.effects.effect.QUANTITIES``.
        hints: what else there is to say on a quantity.
        notes: what to know of the simulator, a sentence each.
        model: format of the file of bodies that it belongs to; empty if the snippet has none.
        comment: how a line of comment begins; ``<!--`` stands for one comment in XML.
        needs_ranges: whether there is nothing to write without ranges.
        draws: whether ranges can be written.
    """

    name: str
    title: str
    template: str
    held: frozenset[str]
    hints: Mapping[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    model: str = "urdf"
    comment: str = "#"
    needs_ranges: bool = False
    draws: bool = True

    def text(self, arm: SnippetArm) -> str:
        """The snippet."""
        body = _jinja().from_string(self.template)
        rendered = body.render(arm=arm, joints=arm.joints, inf=np.inf)
        return self.head(arm) + rendered.lstrip("\n")

    def head(self, arm: SnippetArm) -> str:
        """The comment at its head: what it is, what it leaves out, what to know."""
        plain = arm.plain
        lines = [
            f"Corrected arm of {plain.body.file.name} for {self.title}, written by gapscope export;",
            f"SI units, joint side. {effects_line(plain)}",
        ]
        if arm.ranges is not None:
            lines.append(
                "Ranges are 95 % intervals of the diagnosis, from the lowest to the highest end of its units."
            )
        missing = self.left_out(arm)
        lines.append(
            "Left out, or held in part:" if missing else "Nothing is left out."
        )
        lines += [f"  {line}" for line in missing]
        if self.notes:
            lines.append("To know:")
        lines += [f"  {note}" for note in self.notes]
        if self.comment == "<!--":
            return f"<!--{xml_comment(lines)}-->\n"
        return "".join(f"{self.comment} {line}\n" for line in lines) + "\n"

    def left_out(self, arm: SnippetArm) -> tuple[str, ...]:
        """What the snippet does not hold, or not as it is, in words and figures."""
        corrected = arm.plain.corrected
        lines = []
        for applied in corrected.effects:
            effect = applied.effect
            said = (
                self.hints[x] for x in effect.quantities.values() if x in self.hints
            )
            hint = next(said, None)
            if hint is None and holds(self.held, effect):
                continue
            if hint is None and self.model and holds(BODIES, effect):
                hint = f"in the file of gapscope export --format {self.model}, which this belongs to"
            lines.append(described(applied, corrected.arm, hint))
        distances = {n: d.presliding for n, d in arm.plain.drives.items()}
        if any(distances.values()):
            figures = ", ".join(f"{n} {x:.3g}" for n, x in distances.items() if x)
            lines.append(
                f"presliding, {figures} rad: dry friction sets in at once, not over this distance"
            )
        if corrected.residual is not None:
            lines.append(
                "residual network: residual.onnx of gapscope residual --onnx predicts torque; nothing here calls it"
            )
        return tuple(lines)


def number(value: float) -> str:
    """A number as Python and YAML read it, with six digits; infinity as ``float("inf")``."""
    if not np.isfinite(value):
        return 'float("inf")'
    return repr(float(f"{value:.6g}"))


def pair(ends: tuple[float, float]) -> str:
    """Two numbers in parentheses."""
    return f"({number(ends[0])}, {number(ends[1])})"


def quoted(name: str) -> str:
    """A name as Python and YAML read it."""
    return json.dumps(name, ensure_ascii=False)


def table(values: Mapping[str, Any], indent: int = 0) -> str:
    """A dict in Python with a number or pair for each name, a line each if it is long.

    Args:
        values: the numbers or pairs.
        indent: of the line on which it begins.
    """
    items = [
        f"{quoted(name)}: {pair(value) if isinstance(value, tuple) else number(value)}"
        for name, value in values.items()
    ]
    line = "{" + ", ".join(items) + "}"
    if len(line) + indent <= LONGEST:
        return line
    rows = "".join(f"{' ' * (indent + 4)}{item},\n" for item in items)
    return "{\n" + rows + " " * indent + "}"


@cache
def _jinja() -> jinja2.Environment:
    made = jinja2.Environment(
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        autoescape=False,
    )
    made.filters |= {"number": number, "pair": pair, "table": table, "quoted": quoted}
    return made
