"""The command line: ``gapscope COMMAND``."""

from __future__ import annotations

import itertools
import signal
import sys
import warnings
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

import gapscope
from gapscope.arm.errors import (
    EngineWarning,
    GapscopeError,
    InputError,
    ModelWarning,
)
from gapscope.commands.agents import evaluate, identify, matter, residual, train
from gapscope.commands.blind import blind
from gapscope.commands.diagnose import diagnose
from gapscope.commands.logs import agree, audit, check, inspect
from gapscope.commands.many import fleet, rehearse, serve, watch
from gapscope.commands.models import export, gap, predict, replay, view
from gapscope.commands.options import as_command
from gapscope.commands.project import demo, doctor
from gapscope.commands.recordings import advise, excite, record
from gapscope.terminal import note

PROJECT = "The project"
SECTIONS = {
    "Your log": (inspect, check, audit, agree),
    "The gap": (diagnose, rehearse, predict, replay, gap, view, export),
    "Recordings to make": (record, excite, advise),
    "Many arms": (fleet, watch, serve),
    "Models and agents": (identify, residual, matter, train, evaluate),
    PROJECT: (demo, doctor),
}
"""Commands by what a person wants, as ``--help`` lists them; those of the sealed check come last."""
WITHOUT_EFFECTS = (inspect, audit, check, serve, demo, doctor)
"""Commands that deal with no effect, or with those of the package alone: the others take ``--effects-from``."""
INTERRUPTED = 130
"""Exit code after Ctrl-C."""


class CommandGroup(TyperGroup):
    """Commands in sections, each with a whole sentence."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the sections."""
        for title, commands in SECTIONS.items():
            names = [command.__name__ for command in commands]
            # the sealed check is an app of its own: its section is told here
            names += ["blind"] if title == PROJECT else []
            helps = [self.commands[name].help or "" for name in names]
            firsts = [" ".join(text.split()).split(". ")[0] for text in helps]
            sentences = [f"{first.rstrip('.')}." for first in firsts]
            with formatter.section(title):
                formatter.write_dl(list(zip(names, sentences, strict=True)))


app = typer.Typer(
    cls=CommandGroup,
    no_args_is_help=True,
    add_completion=True,
    rich_markup_mode=None,  # markup would swallow the units, [m]
    pretty_exceptions_enable=False,
)
# what a command needs it imports itself: ``--help`` waits for none of it
for command in itertools.chain.from_iterable(SECTIONS.values()):
    app.command()(as_command(command, own_effects=command not in WITHOUT_EFFECTS))
app.add_typer(blind, name="blind")


def _say_version(asked: bool) -> None:
    if asked:
        typer.echo(f"gapscope {gapscope.__version__}")
        raise typer.Exit


@app.callback()
def _gapscope(
    version: Annotated[
        bool,
        typer.Option("--version", help="Print the version.", callback=_say_version),
    ] = False,
) -> None:
    """Finds out why a simulated robot arm and a real one disagree."""


# the handler that others had set before, for their warnings
_python_warning = warnings.showwarning


def _show_warning(
    message: Warning | str, category: type[Warning], *place: Any, **more: Any
) -> None:
    """Show warnings about a model or engine as notes, and other warnings as Python does."""
    if issubclass(category, (ModelWarning, EngineWarning)):
        note(f"note: {message}")
    else:
        _python_warning(message, category, *place, **more)


def _check_none_empty(arguments: list[str]) -> None:
    """Check that no argument is empty: as a path that would be the folder one is in.

    Raises:
        InputError: one is.
    """
    if "" in arguments:
        place = arguments.index("")
        after = f"after {arguments[place - 1]}" if place else "the first"
        raise InputError(
            f"an argument is empty ({after})",
            "is a variable of the shell not set? give a value, or leave the option out",
        )


def main(arguments: list[str] | None = None) -> Any:
    """Run a command; the process ends with 0, 1 (the work failed, said why) or 2 (bad input)."""
    warnings.showwarning = _show_warning
    if arguments is None:
        # asked to end it cleans up as it does when it is interrupted
        signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        _check_none_empty(sys.argv[1:] if arguments is None else arguments)
        app(args=arguments)
    # an error that was foreseen says what to do: no traceback
    except GapscopeError as error:
        note(f"gapscope: {error}", style="red")
        sys.exit(error.exit_code)
    except SystemExit as end:
        if end.code == INTERRUPTED:  # typer itself prints nothing
            note(
                "gapscope: interrupted; every file that was written is complete. "
                "Run the command again for the rest"
            )
        raise
