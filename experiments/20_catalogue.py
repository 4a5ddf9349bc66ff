"""The catalogue of effects as tables, one per family, as the pages of ``docs/effects/`` hold them.

python experiments/20_catalogue.py [FAMILY]
"""

from __future__ import annotations

import argparse

from gapscope.effects.catalogue import CATALOGUE
from gapscope.effects.effect import Effect
from gapscope.effects.parameter import Parameter
from gapscope.effects.setup_faults.fault import Fault
from gapscope.effects.setup_faults.fault_catalogue import FAULTS

HEAD = (
    "| effect | scope | law | parameter | symbol | unit | bounds | met on real arms | source |\n"
    + "|---" * 9
    + "|"
)
FAULT_HEAD = (
    "| fault | scope | variants | parameter | unit | bounds | met | source |\n"
    + "|---" * 8
    + "|"
)


def rows(effect: Effect) -> list[str]:
    """A row of the table per parameter of an effect."""
    law = effect.equation.replace("|", "\\|")
    return [
        _row(
            [f"`{effect.name}`", effect.scope, f"`{law}`"] if i == 0 else ["", "", ""],
            _cells(p),
            effect.reference,
        )
        for i, p in enumerate(effect.parameters)
    ]


def fault_rows(fault: type[Fault]) -> list[str]:
    """A row of the table per parameter of a setup fault, one where it has none."""
    start = [f"`{fault.name}`", fault.scope, ", ".join(fault.variants) or "-"]
    cells = [
        [f"`{p.name}`", p.unit, _range(p.bounds), _range(p.typical)]
        for p in fault.parameters
    ] or [["-"] * 4]
    return [
        _row(start if i == 0 else ["", "", ""], own, fault.reference)
        for i, own in enumerate(cells)
    ]


def _cells(p: Parameter) -> list[str]:
    vector = " (3)" if p.size == 3 else ""
    return [
        f"`{p.name}`{vector}",
        p.symbol,
        p.unit,
        _range(p.bounds),
        _range(p.typical),
    ]


def _row(start: list[str], cells: list[str], reference: str) -> str:
    return f"| {' | '.join([*start, *cells, reference])} |"


def _range(bounds: tuple[float, float]) -> str:
    return f"{bounds[0]:g} .. {bounds[1]:g}"


def families() -> list[str]:
    """Families of the catalogue in its order."""
    return list(dict.fromkeys(effect.family for effect in CATALOGUE.values()))


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("family", nargs="?", choices=[*families(), "faults"])
    wanted = parser.parse_args().family
    for family in families():
        if wanted in (None, family):
            print(f"\n{family}\n\n{HEAD}")
            print(
                "\n".join(
                    row
                    for effect in CATALOGUE.values()
                    if effect.family == family
                    for row in rows(effect)
                )
            )
    if wanted in (None, "faults"):
        print(f"\nfaults\n\n{FAULT_HEAD}")
        print("\n".join(row for fault in FAULTS.values() for row in fault_rows(fault)))


if __name__ == "__main__":
    main()
