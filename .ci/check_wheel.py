"""Check that wheel and source distribution hold every tracked file of the package, and no other code."""

import subprocess
import sys
import tarfile
import zipfile

PACKAGE = "gapscope/"
BESIDE = {
    "LICENSE",
    "MANIFEST.in",
    "PKG-INFO",
    "README.md",
    "pyproject.toml",
    "setup.cfg",
}
"""Files of the source distribution outside the package."""


def tracked_files() -> set[str]:
    """Tracked files of the package."""
    command = ["git", "ls-files", "-z", PACKAGE]
    listed = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    return set(listed.split("\0")) - {""}


def wheel_files(path: str) -> set[str]:
    """Files of a wheel without its metadata."""
    names = zipfile.ZipFile(path).namelist()
    return {name for name in names if ".dist-info/" not in name}


def source_files(path: str) -> set[str]:
    """Files of a source distribution without its metadata, below its one folder."""
    with tarfile.open(path) as archive:
        members = [member.name for member in archive if member.isfile()]
    names = {name.split("/", 1)[1] for name in members}
    return {name for name in names if ".egg-info/" not in name} - BESIDE


def check(path: str, held: set[str], tracked: set[str]) -> bool:
    """Whether a distribution holds the tracked files and nothing else; prints what differs."""
    for name in sorted(tracked - held):
        print(
            f"{path}: missing: {name} (package-data in pyproject.toml, or an __init__.py)"
        )
    for name in sorted(held - tracked):
        print(f"{path}: not tracked: {name} (git add it, or remove it)")
    print(
        f"{path}: {len(held & tracked)} of {len(tracked)} tracked files of the package"
    )
    return bool(tracked) and held == tracked


def main(wheel: str, source: str) -> None:
    """Exit with 1 if a distribution differs from what is tracked."""
    tracked = tracked_files()
    right = [
        check(wheel, wheel_files(wheel), tracked),
        check(source, source_files(source), tracked),
    ]
    sys.exit(not all(right))


if __name__ == "__main__":
    main(*sys.argv[1:])
