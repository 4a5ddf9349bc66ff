"""The truth of a set of cases in lines of text, to look at the generator."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from gapscope.arm.io.json_file import read_json


def truth_lines(labels: Path) -> Iterator[str]:
    """One line per case: what it is, its severity and its conditions."""
    for name, label in read_json(labels, "give the labels")["cases"].items():
        effects = (
            " + ".join(
                f"{e.get('kind', e['effect'])}{e['joints'] or ''}"
                for e in label["effects"]
            )
            or "healthy"
        )
        c = label["conditions"]
        ratio = "-" if label["ratio"] is None else f"{label['ratio']:.2f}"
        yield (
            f"{name} {label['kind']:8s} {c['robot']:12s} {c['rate']:4d} Hz {effects:60s} ratio {ratio:>6s} "
            f"floor {max(label['floor']):.4f} off {c['inertials_off']:.2f} noise x{c['noise']:.0f} "
            f"{'bare' if c['bare'] else label['feedforward']}, {label['attempts']} draws"
        )
