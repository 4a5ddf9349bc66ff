"""The exceptions that Gapscope raises: one root, each error with its data and a remedy."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

LONGEST_SHOWN = 200
"""Characters of a value in a message, of which the beginning is shown if it is longer."""
LONGEST = 10 * LONGEST_SHOWN
"""Characters of a message; of more, as of a value that is a whole file, the middle is left out."""


class GapscopeError(Exception):
    """Root of all errors that Gapscope raises on purpose.

    Attributes:
        message: what went wrong.
        remedy: what the user can do about it, or an empty string.
        exit_code: what the command line returns: 1, the work failed.
    """

    exit_code = 1

    def __init__(self, message: str, remedy: str = "") -> None:
        message = _shortened(message)
        self.message = message
        self.remedy = remedy
        super().__init__(message if not remedy else f"{message}\n  remedy: {remedy}")


def _shortened(message: str) -> str:
    """A message of at most ``LONGEST`` characters and a note in its middle."""
    if len(message) <= LONGEST:
        return message
    # more of the beginning than of the end: it says what is wrong
    end = LONGEST // 4
    left_out = len(message) - LONGEST
    return (
        f"{message[: LONGEST - end]} ... ({left_out} characters) ... {message[-end:]}"
    )


class InputError(GapscopeError):
    """Something that the user gave cannot be used.

    Attributes:
        file: the file at fault, or ``None`` when the input is no file.
        where: the line, column or field at fault.
        problem: what is wrong, without the place.
        exit_code: 2, bad input.
    """

    exit_code = 2

    def __init__(
        self,
        message: str,
        remedy: str = "",
        *,
        file: Path | str | None = None,
        where: str = "",
    ) -> None:
        self.file = None if file is None else Path(file)
        self.where = where
        self.problem = message
        # the place first, as compilers write it
        place = ", ".join(map(str, filter(None, (file, where))))
        super().__init__(f"{place}: {message}" if place else message, remedy)

    def at(self, file: Path | None, where: str = "") -> InputError:
        """The same error with the file at fault, and the place in it before what it says itself."""
        place = ", ".join(filter(None, (where, self.where)))
        return InputError(self.problem, self.remedy, file=file, where=place)


@contextmanager
def extra(name: str, what: str, file: Path | None = None) -> Iterator[None]:
    """What the block imports comes with an extra of the package, for what needs it.

    Raises:
        InputError: it is not installed.
    """
    try:
        yield
    except ImportError as error:
        raise InputError(
            f"{what} needs {error.name}, which is not installed",
            f"pip install 'gapscope[{name}]'",
            file=file,
        ) from None


class InterruptedRunError(GapscopeError):
    """The run was stopped from outside."""

    exit_code = 130


class ModelWarning(UserWarning):
    """Something odd in a model, which is used all the same; says how."""


class EngineWarning(UserWarning):
    """Another physics engine than usual simulates; says which and why."""
