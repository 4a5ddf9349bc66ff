"""Count the structure of a checkout: files per folder, levels and cycles of imports, nodes per line, comments, lengths.

    .venv/bin/python experiments/25_structure.py [CHECKOUT] [--within gapscope/diagnosis]

A level is the length of the longest chain of imports below a module, the modules of a cycle counted as one. Nodes per
line are the syntax nodes of all function bodies, without docstrings, over their lines. Imports for type checking count.
"""

from __future__ import annotations

import argparse
import ast
from collections import Counter
from functools import cache
from pathlib import Path

PACKAGES = (
    "agents",
    "arm",
    "diagnosis",
    "effects",
    "envs",
    "gapscope",
    "ident",
)
"""Top-level folders that may hold the code; links are left out."""


def modules(root: Path) -> dict[str, Path]:
    """Path of each module by its dotted name."""
    folders = [root / name for name in PACKAGES]
    found = {}
    for folder in folders:
        if folder.is_symlink() or not folder.is_dir():
            continue
        for path in sorted(folder.rglob("*.py")):
            name = ".".join(path.relative_to(root).with_suffix("").parts)
            found[name.removesuffix(".__init__")] = path
    return found


def imports(path: Path, known: set[str]) -> set[str]:
    """Modules of the project that a file imports."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            parts = {f"{node.module}.{alias.name}" for alias in node.names}
            names |= parts & known if parts <= known else {node.module}
    return names & known


def cycles(graph: dict[str, set[str]]) -> list[set[str]]:
    """Sets of modules that import each other by way of others."""

    @cache
    def reached(module: str) -> frozenset[str]:
        seen: set[str] = set()
        waiting = list(graph[module])
        while waiting:
            name = waiting.pop()
            if name not in seen:
                seen.add(name)
                waiting += graph[name]
        return frozenset(seen)

    groups = {
        frozenset(other for other in reached(name) if name in reached(other))
        for name in graph
    }
    return [set(group) for group in groups if len(group) > 1]


def levels(graph: dict[str, set[str]], knots: list[set[str]]) -> int:
    """Number of modules in the longest chain of imports."""
    knot_of = {name: index for index, knot in enumerate(knots) for name in knot}

    def same(one: str, other: str) -> bool:
        return one in knot_of and knot_of.get(one) == knot_of.get(other)

    @cache
    def level(module: str) -> int:
        names = [module, *(n for n in graph if same(n, module))]
        below = {b for n in names for b in graph[n] if b not in names}
        return 1 + max((level(name) for name in below), default=0)

    return max(map(level, graph), default=0)


def bodies(paths: list[Path]) -> tuple[float, list[tuple[int, str]]]:
    """Nodes per line of all function bodies, and the lengths of the functions with their places."""
    nodes, lines = 0, 0
    lengths = []
    for path in paths:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
                continue
            body = node.body[1:] if ast.get_docstring(node) else node.body
            for part in body:
                nodes += sum(1 for _ in ast.walk(part))
                lines += part.end_lineno - part.lineno + 1
            length = body[-1].end_lineno - body[0].lineno + 1 if body else 0
            lengths.append((length, f"{path.name} {node.name}"))
    return nodes / max(lines, 1), sorted(lengths, reverse=True)


def comment_share(paths: list[Path]) -> float:
    """Share of the lines that hold a comment alone."""
    texts = [path.read_text(encoding="utf-8").splitlines() for path in paths]
    lines = [line.strip() for text in texts for line in text if line.strip()]
    return sum(line.startswith("#") for line in lines) / len(lines)


def main(root: Path, within: str) -> None:
    """Print the figures."""
    known = modules(root)
    graph = {name: imports(path, set(known)) - {name} for name, path in known.items()}
    inside = within.replace("/", ".")
    graph = {
        name: {n for n in needed if n.startswith(inside)}
        for name, needed in graph.items()
        if name.startswith(inside)
    }
    paths = [known[name] for name in graph]
    folders = Counter(path.parent.relative_to(root).as_posix() for path in paths)
    knots = cycles(graph)
    density, lengths = bodies(paths)
    print(f"{len(paths)} files; largest folders: {folders.most_common(5)}")
    print(f"import levels {levels(graph, knots)}, cycles {len(knots)}", *knots)
    print(f"nodes per line {density:.1f}, comments {comment_share(paths):.1%}")
    print(f"longest function bodies: {lengths[:5]}")
    names = Counter(path.name for path in paths if path.name != "__init__.py")
    print(f"file names twice or more: {sum(count > 1 for count in names.values())}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("root", type=Path, nargs="?", default=Path())
    parser.add_argument("--within", default="")
    main(**vars(parser.parse_args()))
