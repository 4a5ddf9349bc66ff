"""The tables and pages of the documentation that follow from the code.

    .venv/bin/python experiments/20_pages.py catalogue [FAMILY]
    .venv/bin/python experiments/20_pages.py reference [--check]
    .venv/bin/python experiments/20_pages.py scripts

``catalogue`` prints the catalogue of effects as tables, one per family, as the pages of ``docs/effects/`` hold them.
``reference`` writes the pages of ``docs/reference/``: every key of a case file, from
``gapscope/schemas/case.schema.json``; ``--check`` writes nothing, and ends with 1 if a page is not up to date.
``scripts`` writes ``experiments/README.md``: which page quotes which script.
"""

from __future__ import annotations

import ast
import json
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from common import command_line, run_part

from gapscope.effects.catalogue import CATALOGUE
from gapscope.effects.effect import Effect
from gapscope.effects.parameter import Parameter
from gapscope.effects.setup_faults import FAULTS, Fault

EFFECT_HEAD = (
    "| effect | scope | law | parameter | symbol | unit | bounds | met on real arms | source |\n"
    + "|---" * 9
    + "|"
)
FAULT_HEAD = (
    "| fault | scope | variants | parameter | unit | bounds | met | source |\n"
    + "|---" * 8
    + "|"
)

SCRIPTS_HEAD = """# Experiments

Scripts that produce the tables and figures of the documentation; `common.py`, `generator_arms.py`, `real_*.py`
and `metamorphic.py` are what several of them share. This page is written by `20_pages.py scripts`.

| script | what it shows | quoted by |
|---|---|---|"""
GONE_HEAD = """## Scripts that are gone

Their figures stay in their pages. `git show COMMIT:experiments/NAME` shows a script.

| script | commit | quoted by |
|---|---|---|"""
GONE = re.compile(
    r"`(?:experiments/)?([\w/]+\.py)[^`]*`,?\s\(?(?:at\s)?commit\s([0-9a-f]{7})\b"
)
"""A script named with a commit."""


def rows(
    start: list[str], parameters: Sequence[Parameter], symbols: bool, reference: str
) -> list[str]:
    """A row of the table per parameter, one where there is none; what they are of stands in the first."""
    cells = []
    for p in parameters:
        name = f"`{p.name}`{' (3)' if symbols and p.size == 3 else ''}"
        ranges = [f"{low:g} .. {high:g}" for low, high in (p.bounds, p.typical)]
        cells.append([name, *[p.symbol] * symbols, p.unit, *ranges])
    out = []
    for own in cells or [["-"] * 4]:
        out.append(f"| {' | '.join([*start, *own, reference])} |")
        start = [""] * len(start)
    return out


def effect_rows(effect: Effect) -> list[str]:
    """Rows of an effect."""
    law = effect.equation.replace("|", "\\|")
    start = [f"`{effect.name}`", effect.scope, f"`{law}`"]
    return rows(start, effect.parameters, True, effect.reference)


def fault_rows(fault: type[Fault]) -> list[str]:
    """Rows of a fault of the set-up."""
    start = [f"`{fault.name}`", fault.scope, ", ".join(fault.variants) or "-"]
    return rows(start, fault.parameters, False, fault.reference)


def families() -> list[str]:
    """Families of the catalogue in its order."""
    return list(dict.fromkeys(effect.family for effect in CATALOGUE.values()))


def catalogue() -> None:
    """Print the tables."""
    parser = command_line(catalogue.__doc__)
    parser.add_argument("family", nargs="?", choices=[*families(), "faults"])
    wanted = parser.parse_args().family
    tables = {name: [EFFECT_HEAD] for name in families()} | {"faults": [FAULT_HEAD]}
    for effect in CATALOGUE.values():
        tables[effect.family] += effect_rows(effect)
    for fault in FAULTS.values():
        tables["faults"] += fault_rows(fault)
    for family, lines in tables.items():
        if wanted in (None, family):
            print(f"\n{family}", "", *lines, sep="\n")


# Keys of a case file

ROOT = Path(__file__).parents[1]
SCHEMA = ROOT / "gapscope/schemas/case.schema.json"
PAGES = ROOT / "docs/reference"
Schema = Mapping[str, Any]

KINDS = {
    "string": "text",
    "number": "number",
    "integer": "whole number",
    "object": "mapping",
    "null": "nothing",
}
BOUNDS = {
    "minimum": "at least {}",
    "exclusiveMinimum": "above {}",
    "maximum": "at most {}",
}
CHANNELS = ("angle", "velocity", "torque", "temperature")
"""Definitions of the schema that say where a channel of a log stands."""
KEY_HEAD = "| key | value | meaning |\n|---|---|---|"
NOTE = (
    "Generated from `gapscope/schemas/case.schema.json` by `experiments/20_pages.py`. A key in bold must be "
    "there if\nits mapping is; `[]` stands for each entry of a list, `NAME` for a name."
)


def pages(schema: Schema) -> dict[str, str]:
    """Text of each page by its name."""
    top = dict(schema["properties"])
    controller, importing = top["controller"], top["import"]
    # these have pages of their own
    top["controller"] = {**controller, "properties": {}}
    top["import"] = {**importing, "properties": {}}
    case = {**schema, "properties": top}
    return {
        "case.md": _page("Keys of `case.yaml`", "case.md", _rows(case, schema)),
        "controller.md": _page(
            "Keys of `controller:`",
            "case.md",
            _rows({"properties": {"controller": controller}}, schema),
        ),
        "import.md": _import_page(importing, schema),
    }


def _import_page(importing: Schema, schema: Schema) -> str:
    """Keys of the import section, then those of a channel."""
    text = _page(
        "Keys of `import:`",
        "case.md",
        _rows({"properties": {"import": importing}}, schema),
    )
    tables = {name: list(_rows(schema["$defs"][name], schema)) for name in CHANNELS}
    first, *others = tables.values()
    common = [row for row in first if all(row in rows for rows in others)]
    parts = [text, _section("Keys of every channel", common)]
    for name, rows in tables.items():
        uses = [
            f"`{key}`"
            for key, value in importing["properties"].items()
            if value.get("$ref") == f"#/$defs/{name}"
        ]
        own = [row for row in rows if row not in common]
        parts.append(_section(f"Further keys of {', '.join(uses)}", own))
    return "\n".join(parts)


def _section(title: str, rows: Sequence[str]) -> str:
    """A table with a heading."""
    return "\n".join([f"## {title}\n\n{KEY_HEAD}", *rows, ""])


def _page(title: str, explained: str, rows: Iterator[str]) -> str:
    lines = "\n".join(rows)
    return (
        f"# {title}\n\n{NOTE}\n[{explained}](../{explained}) explains the keys with examples.\n\n"
        f"{KEY_HEAD}\n{lines}\n"
    )


def _rows(mapping: Schema, schema: Schema, above: str = "") -> Iterator[str]:
    """A row for each key of a mapping and of the mappings in it."""
    required = mapping.get("required", ())
    for key, given in mapping["properties"].items():
        value = _resolved(given, schema)
        path = f"{above}{key}"
        name = f"**`{path}`**" if key in required else f"`{path}`"
        cells = (name, _kind(value, schema), value["description"] + _example(value))
        yield "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"
        if given.get("$ref", "").rpartition("/")[2] in CHANNELS:
            continue  # their keys stand in tables of their own
        inner, mark = _inner(value)
        if inner.get("properties"):
            yield from _rows(inner, schema, f"{path}{mark}.")


def _inner(value: Schema) -> tuple[Schema, str]:
    """The mapping inside a value, and how its place is marked: in a list, under any name, or at once."""
    if "properties" in value:
        return value, ""
    for key, mark in (("items", "[]"), ("additionalProperties", ".NAME")):
        inside = value.get(key)
        if isinstance(inside, dict) and "properties" in inside:
            return inside, mark
    return {}, ""


def _resolved(value: Schema, schema: Schema) -> Schema:
    """A value with what it refers to."""
    if "$ref" not in value:
        return value
    named = schema["$defs"][value["$ref"].rpartition("/")[2]]
    return {**_resolved(named, schema), **value}


def _kind(value: Schema, schema: Schema, several: bool = False) -> str:
    """Which values are allowed, in words; in the plural if there are several."""
    if "enum" in value:
        return ", ".join(f"`{entry}`" for entry in value["enum"])
    types = value.get("type", [])
    words = []
    for one in [types] if isinstance(types, str) else types:
        if one == "array":
            words.append(_list_of(value, schema, several))
        elif one != "null":
            bounds = _bounds(value) if one in ("number", "integer") else ""
            words.append(f"{KINDS[one]}{'s' if several else ''}{bounds}")
    return " or ".join(words)


def _list_of(value: Schema, schema: Schema, several: bool) -> str:
    """What a list holds."""
    inside = _resolved(value.get("items", {}), schema)
    fixed = value.get("minItems") == value.get("maxItems", 0)
    count = f"{value['minItems']} " if fixed else ""
    return f"list{'s' if several else ''} of {count}{_kind(inside, schema, True)}"


def _bounds(value: Schema) -> str:
    found = [text.format(value[key]) for key, text in BOUNDS.items() if key in value]
    return "".join(f" {text}" for text in found)


def _example(value: Schema) -> str:
    found = ", ".join(f"`{json.dumps(one)}`" for one in value.get("examples", ()))
    return f"; e.g. {found}" if found else ""


def reference() -> None:
    """Write the pages, or compare them."""
    options = command_line(reference.__doc__, check=(False, "write nothing"))
    check = options.parse_args().check
    PAGES.mkdir(exist_ok=True)
    schema = json.loads(SCHEMA.read_text(encoding="utf-8"))
    for name, text in pages(schema).items():
        path = PAGES / name
        old = path.read_text(encoding="utf-8") if path.exists() else ""
        if old == text:
            continue
        if check:
            sys.exit(f"{path} is not up to date: run {Path(__file__).name}")
        path.write_text(text, encoding="utf-8")
        print(f"wrote {path}")


def scripts_page() -> str:
    """The table of scripts: what each shows, and the pages that quote it; then the scripts that are gone."""
    texts = {
        page.relative_to(ROOT).as_posix(): page.read_text(encoding="utf-8")
        for page in [
            *sorted((ROOT / "docs").rglob("*.md")),
            ROOT / "CONTRIBUTING.md",
        ]
    }

    def quoting(name: str) -> str:
        found = [page for page, text in texts.items() if name in text]
        return ", ".join(f"[{page}](../{page})" for page in found)

    rows = []
    for script in sorted((ROOT / "experiments").glob("[0-9]*.py")):
        module = ast.parse(script.read_text(encoding="utf-8"))
        what = str(ast.get_docstring(module)).splitlines()[0]
        rows.append(f"| `{script.name}` | {what} | {quoting(script.name)} |")
    what = "What the project costs, beside tools that others use."
    rows.append(f"| `benchmarks/` | {what} | {quoting('experiments/benchmarks')} |")
    named = {match for text in texts.values() for match in GONE.findall(text)}
    left = [
        f"| `{name}` | {commit} | {quoting(name)} |"
        for name, commit in sorted(named)
        if not (ROOT / "experiments" / name).exists()
    ]
    lines = [SCRIPTS_HEAD, *rows, "", GONE_HEAD, *left, ""]
    return "\n".join(lines).replace("``", "`")


def scripts() -> None:
    """Write the table of scripts."""
    command_line(scripts.__doc__).parse_args()
    (ROOT / "experiments/README.md").write_text(scripts_page(), encoding="utf-8")


if __name__ == "__main__":
    run_part(__doc__, catalogue, reference, scripts)
