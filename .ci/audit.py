"""Look for known vulnerabilities of the pinned versions, and say clearly if that was not possible.

    python .ci/audit.py PIP_AUDIT

Asks PyPI's database, by pip-audit. Where the database is not reached pip-audit skips the packages and ends well; here
that is no success. Exit code 0: none known; 1: some known, or packages that could not be looked up; 2: nothing could be
looked up.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
SETS = ("build", "core", "test", "dev", "docs", "learn")


def audited(pip_audit: str, name: str) -> list[dict[str, Any]] | None:
    """What is known of each package of a file of ``requirements/``; ``None`` if it could not be asked."""
    file = ROOT / "requirements" / f"{name}.txt"
    command = [pip_audit, "--requirement", str(file), "--no-deps", "--disable-pip"]
    command += ["--format", "json", "--progress-spinner", "off"]
    done = subprocess.run(command, capture_output=True, text=True)
    try:
        found: list[dict[str, Any]] = json.loads(done.stdout)["dependencies"]
    except (json.JSONDecodeError, KeyError):
        print(f"{name}: {(done.stderr.strip().splitlines() or ['no answer'])[-1]}")
        return None
    return found


def main(pip_audit: str) -> int:
    """Print what is known, and the exit code."""
    asked, skipped, known = 0, [], 0
    for name in SETS:
        for package in audited(pip_audit, name) or []:
            if "skip_reason" in package:
                skipped.append(package["name"])
                continue
            asked += 1
            for flaw in package["vulns"]:
                known += 1
                mended = ", ".join(flaw["fix_versions"]) or "none yet"
                print(
                    f"{package['name']} {package['version']}: {flaw['id']}, mended in: {mended}"
                )
    if not asked:
        print(
            "NOT AUDITED: the database of vulnerabilities cannot be reached from here"
        )
        return 2
    print(f"{asked} packages looked up, {known} known vulnerabilities")
    if skipped:
        print(f"NOT AUDITED, could not be looked up: {', '.join(skipped)}")
    return 1 if known or skipped else 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
