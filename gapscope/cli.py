"""The command line: ``gapscope COMMAND``."""

from __future__ import annotations

import sys
import warnings
from typing import Any

import typer

from gapscope.arm.errors import EngineWarning, GapscopeError, ModelWarning
from gapscope.commands.blind import blind
from gapscope.commands.diagnosing import advise, diagnose, gap, predict, replay
from gapscope.commands.identifying import excite, identify
from gapscope.commands.simulating import demo, export, record
from gapscope.commands.tracking import evaluate, train
from gapscope.terminal import log

app = typer.Typer(
    help="Finds out why a simulated robot arm and a real one disagree.",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,  # markup would swallow the units, [m]
    pretty_exceptions_enable=False,
)
for command in (
    diagnose,
    predict,
    replay,
    gap,
    identify,
    record,
    excite,
    advise,
    evaluate,
    train,
    export,
    demo,
):
    app.command()(command)
app.add_typer(blind, name="blind")
INTERRUPTED = 130
"""Exit code after Ctrl-C."""
_python_warning = warnings.showwarning


def _show_warning(
    message: Warning | str, category: type[Warning], *place: Any, **more: Any
) -> None:
    """What is odd about a model as a note; other warnings as Python shows them."""
    if issubclass(category, (ModelWarning, EngineWarning)):
        log.print(f"note: {message}", highlight=False, markup=False, soft_wrap=True)
    else:
        _python_warning(message, category, *place, **more)


def main(arguments: list[str] | None = None) -> Any:
    """Run a command; the process ends with 0, 1 (the work failed, said why) or 2 (bad input)."""
    warnings.showwarning = _show_warning
    try:
        app(args=arguments)
    except GapscopeError as error:
        log.print(
            f"gapscope: {error}",
            style="red",
            highlight=False,
            markup=False,
            soft_wrap=True,
        )
        sys.exit(error.exit_code)
    except SystemExit as end:
        if end.code == INTERRUPTED:  # typer ends the process so, without a word
            log.print(
                "gapscope: interrupted; what was written is whole, run the command again for the rest"
            )
        raise
