"""Calls side by side: bounded, given as they end, and made again if their worker dies."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from gapscope.many.workers import LOCAL, WorkerLostError, as_completed, in_order


def _fragile(marks: Path) -> Callable[[int], int]:
    """Number -> its square; a negative one ends the process, -1 only the first time that it is called."""

    def square(number: int) -> int:
        mark = marks / str(number)
        if number == -2 or (number == -1 and not mark.exists()):
            mark.touch()
            os._exit(1)
        if number == 0:
            raise ZeroDivisionError("zero")
        return number * number

    return square


def test_a_call_whose_worker_dies_is_made_again_and_the_tries_are_counted(
    tmp_path: Path,
) -> None:
    calls = [(number,) for number in (2, -1, 0, -2, 3)]
    made = as_completed(_fragile(tmp_path), calls, jobs=2, tries=2)
    ended = {call.number: call for call in made}
    assert [ended[k].result for k in range(5)] == [4, 1, None, None, 9]
    assert [ended[k].tries for k in range(5)] == [1, 2, 1, 2, 1]
    assert isinstance(ended[2].error, ZeroDivisionError)
    assert isinstance(ended[3].error, WorkerLostError)


def test_a_worker_that_is_lost_costs_its_own_call_only(tmp_path: Path) -> None:
    first, lost, last = in_order(_fragile(tmp_path), [(2,), (-2,), (3,)], 2, LOCAL)
    assert (first, last) == (4, 9)
    assert isinstance(lost, WorkerLostError)


@pytest.mark.parametrize("jobs", [1, 2])
def test_arguments_are_drawn_only_as_workers_become_free(jobs: int) -> None:
    drawn = 0

    def numbers() -> Iterator[tuple[int]]:
        nonlocal drawn
        while True:  # a listing of any length
            drawn += 1
            yield (drawn,)

    calls = as_completed(abs, numbers(), jobs=jobs)
    for ended in range(1, 6):
        next(calls)
        assert drawn <= ended + jobs
    calls.close()
