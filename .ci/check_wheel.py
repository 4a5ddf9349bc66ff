"""Check that a wheel holds every tracked file of the packages, and nothing else."""

import re
import subprocess
import sys
import zipfile

NOT_PACKAGED = ("experiments", "tests")


def tracked_files() -> set[str]:
    """Tracked files of the packages; a package is a top-level folder with an ``__init__.py``."""
    tracked = subprocess.run(
        ["git", "ls-files", "-z"], check=True, capture_output=True, text=True
    ).stdout.split("\0")
    packages = {
        path.split("/")[0]
        for path in tracked
        if re.fullmatch("[^/]+/__init__.py", path)
    }
    return {
        path
        for path in tracked
        if path.split("/")[0] in packages.difference(NOT_PACKAGED)
    }


def main(wheel: str) -> None:
    """Compare the wheel's files with the tracked ones; exit with 1 where they differ."""
    held = {
        name for name in zipfile.ZipFile(wheel).namelist() if ".dist-info/" not in name
    }
    tracked = tracked_files()
    for path in sorted(tracked - held):
        print(
            f"missing in the wheel: {path} (package-data in pyproject.toml, or an __init__.py, is missing)"
        )
    for path in sorted(held - tracked):
        print(f"in the wheel, but not tracked: {path} (git add it, or remove it)")
    if not tracked or held != tracked:
        sys.exit(1)
    print(f"{wheel}: all {len(tracked)} tracked files of the packages")


if __name__ == "__main__":
    main(*sys.argv[1:])
