"""The watch: what a source gives goes through the detector, and what that says to the terminal and to a file."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from gapscope.arm.case import Case
from gapscope.arm.known_load import KnownLoad
from gapscope.arm.recording import Recording
from gapscope.effects.corrected import CorrectedArm
from gapscope.watching.detector import (
    STATE,
    Detector,
    Saved,
    WatchSettings,
    fingerprint,
    load_state,
    save_state,
)
from gapscope.watching.events import ALARM, EVENTS, MISFIT, NOTE, Event, EventFile
from gapscope.watching.sources import (
    Folder,
    GrowingFile,
    Reading,
    Source,
    check_readable,
    is_text,
)

SAVE_EVERY = 30.0
"""Time after which a state is saved that changed [s]; after every alarm and misfit as well."""


class Watch:
    """A source that is watched with an arm.

    Args:
        corrected: the arm with its effects.
        settings: what the user chooses.
        case: how files are read, and known bodies they had mounted; ``None``: in the columns of the case format.

    Attributes:
        read: names of the recordings that were read.
        resumed: whether it goes on with what an earlier run learnt.

    Raises:
        InputError: source, settings or state cannot be used.
    """

    def __init__(
        self,
        corrected: CorrectedArm,
        settings: WatchSettings,
        case: Case | None = None,
    ) -> None:
        check_readable(settings.source)
        self.settings = settings
        self.detector = Detector(corrected, settings.false_alarms, settings.learning)
        self.alarms = self.misfits = 0
        self.read: set[str] = set()
        self.resumed = False
        self._arm = fingerprint(corrected, settings.learning)
        earlier = self._earlier()
        importing = case.importing if case else None
        self._reading = Reading(corrected.arm, importing)
        self._first: list[Event] = []
        if not (settings.learning or self.resumed):
            recordings = case.recordings if case else ()
            told = [one for one in recordings if one.tau is not None]
            self._first.append(self.detector.learn_from(told))
        position = earlier.position if earlier else None
        self.source = self._source(position, case)
        self._events = None
        if settings.out is not None:
            count = earlier.count if earlier else 0
            self._events = EventFile(settings.out / EVENTS, count)

    def run(self, stopped: Callable[[], bool] = lambda: False) -> Iterator[Event]:
        """Events as they happen, until the source has rested for ``until_idle`` or ``stopped`` says so.

        For the first ``rest`` seconds it does not end while a file is there that may not be whole yet.

        Raises:
            InputError: the source ended, and nothing of it could be used.
        """
        yield from self._said(iter(self._first))
        begun = idle_since = saved = time.monotonic()
        until_idle = self.settings.until_idle
        while not stopped():
            new = False
            for item in self.source.poll():
                new, before = True, self.alarms + self.misfits
                yield from self._said(self._events_of(item))
                late = time.monotonic() - saved > SAVE_EVERY
                if late or self.alarms + self.misfits > before:
                    self._save()
                    saved = time.monotonic()
                if stopped():
                    break
            now = time.monotonic()
            idle_since = now if new else idle_since
            waits = self.source.unfinished and now - begun < self.settings.rest
            idle = until_idle is not None and now - idle_since >= until_idle
            if idle and not waits:
                break
            if not new:
                time.sleep(self.settings.poll)
        self._save()
        failure = self._reading.failure
        if failure is not None and not self._reading.succeeded:
            raise failure

    def _events_of(self, item: Recording | Event) -> Iterator[Event]:
        if isinstance(item, Event):
            yield item
            return
        self.read.add(item.name)
        if item.tau is None:
            yield Event(event=NOTE, sentence=f"{item.name}: has no torque, left out")
        yield from self.detector.add(item)

    def _said(self, events: Iterator[Event]) -> Iterator[Event]:
        """The events, written to the file before they are passed on."""
        for event in events:
            if self._events is not None:
                self._events.write(event)
            if event.event == ALARM:
                self.alarms += 1
            if event.event == MISFIT:
                self.misfits += 1
            yield event

    def _source(self, position: dict[str, Any] | None, case: Case | None) -> Source:
        path = self.settings.source
        if path.is_file() and is_text(path):
            return GrowingFile(path, self._reading, position)

        def no_load(_: Path) -> KnownLoad | None:
            return None

        return Folder(
            path,
            self._reading,
            self.settings.rest,
            position,
            without=self.settings.out,
            payload_of=case.payload_of if case else no_load,
        )

    def _earlier(self) -> Saved | None:
        """What an earlier run left, if it watched the same arm."""
        out = self.settings.out
        if out is None or not (out / STATE).is_file():
            return None
        earlier = load_state(out / STATE, self.detector, self._arm)
        self.resumed = earlier is not None and bool(self.detector.state.blocks)
        return earlier

    def _save(self) -> None:
        out = self.settings.out
        if out is None or self._events is None:
            return
        place, count = self.source.position(), self._events.count
        save_state(out / STATE, self.detector, self._arm, place, count)
