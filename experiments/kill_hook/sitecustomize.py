"""Disturbs the process at a file operation below a folder; Python imports this by its name, before anything else.

Variables of the environment: ``KILL_OUT``, the folder; ``KILL_AT``, which operation; ``KILL_KIND``; ``KILL_DELAY``, how
long after it [s]; ``KILL_COUNT``, a file for the number of operations at the end.
"""

from __future__ import annotations

import atexit
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

EVENTS = ("open", "os.rename", "os.remove", "os.mkdir", "os.rmdir", "os.truncate")
DAY = 86400.0
OUT = os.environ.get("KILL_OUT", "")
COUNT = os.environ.get("KILL_COUNT")
AT = int(os.environ.get("KILL_AT", "0"))
KIND = os.environ.get("KILL_KIND", "")
DELAY = float(os.environ.get("KILL_DELAY", "0"))
PARENT = os.path.dirname(OUT)
_operations = 0


def _disturb() -> None:
    if KIND in ("SIGKILL", "SIGINT"):
        os.kill(os.getpid(), getattr(signal, KIND))
    elif KIND == "read-only":
        for folder in (OUT, PARENT):
            if not os.path.isdir(folder):
                continue
            if os.geteuid() == 0:  # whom rights do not stop
                subprocess.run(["chattr", "+i", folder], check=False)
            else:
                os.chmod(folder, 0o555)
    elif KIND == "clock":
        now = time.time
        time.time = lambda: now() - DAY
        for path in Path(OUT).rglob("*"):
            os.utime(path, (now() + DAY, now() + DAY))


def _watch(event: str, arguments: tuple[object, ...]) -> None:
    global _operations
    if event not in EVENTS or not str(arguments[0]).startswith(PARENT):
        return
    if event == "open" and not int(arguments[2] or 0) & (os.O_WRONLY | os.O_RDWR):  # type: ignore[call-overload]
        return
    _operations += 1
    if _operations == AT:
        if DELAY:
            later = threading.Timer(DELAY, _disturb)
            later.daemon = True  # a process that has ended before is left alone
            later.start()
        else:
            _disturb()


if OUT and (AT or COUNT):
    if COUNT:
        file = Path(COUNT)
        atexit.register(lambda: file.write_text(str(_operations), encoding="utf-8"))
    sys.addaudithook(_watch)
