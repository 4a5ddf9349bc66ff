"""Licences of all packages in ``requirements/``: check that none is forbidden, and list them.

    python .ci/licences.py [--write PAGE] [--path FOLDER]

A licence is what the metadata of the installed package states: its expression, else all of its classifiers, else its
field. One that is not installed here, because it is for another platform or Python, keeps its place on the page. A
licence that is neither allowed below nor read by hand stops the check: read it, then enter it. What a wheel bundles
beside its own code (compiled libraries of others) is not looked into.
"""

from __future__ import annotations

import argparse
import re
import sys
from importlib.metadata import Distribution, distributions
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "licences.md"
SETS = ("core", "learn", "docs", "test", "dev", "tools", "build")
"""Files of ``requirements/``, those that users install first."""
ALLOWED = re.compile(
    r"^(0BSD|Apache|BSD|3-Clause BSD|New BSD|BSL-1\.0|HPND|ISC|LLVM-exception|MIT|MPL-2\.0|PSF|Qhull|zlib|any-OSI"
    r"|Unlicense|Mozilla Public License 2\.0|Python Software Foundation|Public Domain)",
    re.IGNORECASE,
)
"""Licences under which an unchanged package may be used beside code under the MIT licence. MPL-2.0 binds its own files
alone; GPL, LGPL, AGPL and licences for some uses only are not here."""
READ = {
    "axe-playwright-python": "MIT",  # its metadata is silent; LICENSE in the wheel
    "cmeel-qhull": "Qhull",  # COPYING.txt in the wheel: free to use and give on with its notice
}
"""Licences that were read by hand, since the metadata does not state them."""
TORCH = "torch"
"""The one package that is installed beside the files of ``requirements/``."""
HEAD = """# Licences of the dependencies

Every package that `make` installs, by `make licences`, as its metadata states it. `make lint` refuses a package whose
licence is not in the list of `.ci/licences.py`: permissive ones, and MPL-2.0, which binds its own files alone. Wheels
may bundle compiled libraries of others, whose licences lie in the wheel; they are not looked into. Gapscope itself is
under the MIT licence and contains no code of these packages, but for the script of Plotly that reports embed (MIT).

"Needed by" is `core` for what every user installs, else the extra or the purpose. Versions are in `requirements/`, that
of torch in `constraints.txt`.

| needed by | licence | packages |
|---|---|---|
"""
ROW = re.compile(r"^\| \w+ \| ([^|]+) \| ([^|]+) \|$", re.MULTILINE)


def normalised(name: str) -> str:
    """Name of a package as ``requirements/`` has it."""
    return re.sub(r"[-_.]+", "-", name).lower()


def locked() -> dict[str, str]:
    """Set of each package."""
    found: dict[str, str] = {}
    for name in SETS:
        text = (ROOT / "requirements" / f"{name}.txt").read_text(encoding="utf-8")
        for package in re.findall(r"^([\w.-]+)==", text, re.MULTILINE):
            found.setdefault(package, name)
    return found


def listed(page: str) -> dict[str, str]:
    """Licence of each package on the page."""
    return {
        name: licence
        for licence, names in ROW.findall(page)
        for name in names.split(", ")
    }


def stated(package: Distribution) -> str:
    """What the metadata says: expression, classifiers or the first line of the field; empty if nothing."""
    meta = package.metadata
    expression = meta.get("License-Expression")
    if expression:
        return str(expression)
    classifiers = [
        entry.split(" :: ")[-1]
        for entry in meta.get_all("Classifier") or ()
        if entry.startswith("License :: ")
    ]
    if classifiers:
        return " AND ".join(classifiers)
    lines = (meta.get("License") or "").strip().splitlines()
    return lines[0] if lines else ""


def allowed(licence: str) -> bool:
    """Whether one of the alternatives consists of allowed licences."""
    alternatives = re.split(r"\s+OR\s+", licence)
    return any(
        all(
            ALLOWED.match(part) for part in re.split(r"\s+(?:AND|WITH)\s+", alternative)
        )
        for alternative in (text.strip("() ") for text in alternatives)
    )


def licences(path: list[str], page: str) -> dict[str, str]:
    """Licence of each package: read by hand, of its metadata, or of the page."""
    installed = {
        normalised(package.metadata["Name"]): stated(package)
        for package in distributions(path=path)
    }
    known = listed(page) | installed | READ
    return {name: known.get(name, "") for name in (*locked(), TORCH)}


def problems(found: dict[str, str]) -> list[str]:
    """What is wrong with the licences, in words."""
    said = []
    for name, licence in found.items():
        if not licence:
            said.append(f"{name}: states no licence; read it, enter it in READ")
        elif not allowed(licence):
            said.append(f"{name}: {licence}: not among the licences that are allowed")
    return said


def page_text(found: dict[str, str]) -> str:
    """The page: packages by purpose and licence."""
    packages = locked() | {TORCH: "learn"}
    groups: dict[tuple[int, str], list[str]] = {}
    for name in sorted(packages):
        place = SETS.index(packages[name]), found[name]
        groups.setdefault(place, []).append(name)
    rows = [
        f"| {SETS[place]} | {licence} | {', '.join(names)} |"
        for (place, licence), names in sorted(groups.items())
    ]
    return HEAD + "\n".join(rows) + "\n"


def main() -> None:
    """Check, or write the page; exit with 1 if a licence is forbidden or unknown, or the page is out of date."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", type=Path)
    parser.add_argument("--path", action="append", default=[])
    given = parser.parse_args()
    page = PAGE.read_text(encoding="utf-8") if PAGE.exists() else ""
    found = licences([*given.path, *sys.path], page)
    said = problems(found)
    if given.write:
        given.write.write_text(page_text(found), encoding="utf-8")
    elif set(listed(page)) != {*locked(), TORCH}:
        said.append(f"{PAGE.relative_to(ROOT)}: is out of date; make licences")
    print(*said, sep="\n" if said else "")
    print(f"{len(found)} packages, {len(said)} problems")
    sys.exit(bool(said))


if __name__ == "__main__":
    main()
