"""Diagnose one case and print as JSON what it cost; imports nothing of the benchmarks, so any checkout can be measured.

    python experiments/benchmarks/children/diagnose_case.py CASE [--reference CASE]

Printed are processor time [s] from reading the case to the finished diagnosis, peak memory [MB], and what was named.
"""

from __future__ import annotations

import argparse
import json
import re
import resource
import time
from pathlib import Path


def peak_mb() -> float:
    """The most memory that this process has held [MB].

    Linux counts it anew for each program; ``getrusage`` would begin with the peak of the process that started this one.
    """
    try:
        text = Path("/proc/self/status").read_text(encoding="ascii")
    except OSError:
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    found = re.search(r"^VmHWM:\s*(\d+) kB", text, re.MULTILINE)
    assert found is not None
    return int(found[1]) / 1024


def main() -> None:
    """Diagnose and print."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("case", type=Path)
    parser.add_argument("--reference", type=Path)
    options = parser.parse_args()
    import gapscope.interface.diagnose

    cpu = time.process_time()
    case = gapscope.load_case(options.case, any_unit=True)
    document = gapscope.diagnose(case, against=options.reference).document
    found = {
        "cpu": time.process_time() - cpu,
        "memory_mb": peak_mb(),
        "named": [[e["effect"], e["joints"]] for e in document["effects"]],
    }
    print(json.dumps(found))


if __name__ == "__main__":
    main()
