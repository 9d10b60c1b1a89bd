"""Progress of long work and its cancellation: one object that every stage reports to.

A stage calls ``progress.update(fraction)`` often; the call is cheap, passes an event to the sink at most ten times a
second and raises :class:`~iris_addon.base.errors.Cancelled` once somebody has called :meth:`Progress.cancel`.
"""

from __future__ import annotations

import json
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from typing import TextIO

from .errors import Cancelled


@dataclass(frozen=True)
class ProgressEvent:
    """One progress report.

    ``fraction`` is that of the stage, ``overall`` that of the whole job (both in [0, 1]), ``seconds_left`` an estimate
    for the whole job or None while there is nothing to extrapolate from.
    """

    stage: str
    fraction: float
    overall: float
    seconds_left: float | None
    message: str = ""


Sink = Callable[[ProgressEvent], None]


def discard(_event: ProgressEvent) -> None:
    """Sink that ignores every event, for tests and nested calls."""


class Progress:
    """Stage-wise progress with cancellation.

    Args:
        sink: receives :class:`ProgressEvent`.
        weights: expected share of the total time per stage name; stages not named here get the mean weight.
    """

    INTERVAL_SECONDS = 0.1

    def __init__(self, sink: Sink = discard, weights: Mapping[str, float] | None = None) -> None:
        self._sink = sink
        self._weights = dict(weights or {})
        self._done_weight = 0.0
        self._stage = ""
        self._cancelled = threading.Event()
        self._start = time.monotonic()
        self._last = 0.0
        self.seconds: dict[str, float] = {}

    def cancel(self) -> None:
        """Ask the work to stop at its next :meth:`update`. Safe from signal handlers and other threads."""
        self._cancelled.set()

    def expect(self, weights: Mapping[str, float]) -> None:
        """Name the stages to come and their expected seconds, beside those already named."""
        self._weights.update(weights)

    def check(self) -> None:
        """Raise :class:`Cancelled` if somebody asked to stop."""
        if self._cancelled.is_set():
            raise Cancelled

    def _weight(self, stage: str) -> float:
        if not self._weights:
            return 1.0
        return self._weights.get(stage, sum(self._weights.values()) / len(self._weights))

    @contextmanager
    def stage(self, name: str) -> Iterator[Progress]:
        """Time everything inside as the stage ``name``."""
        self._stage, begin = name, time.monotonic()
        self.update(0.0, force=True)
        yield self
        self.seconds[name] = self.seconds.get(name, 0.0) + time.monotonic() - begin
        self.update(1.0, force=True)
        self._done_weight += self._weight(name)

    def update(self, fraction: float, message: str = "", *, force: bool = False) -> None:
        """Report that ``fraction`` of the current stage is done; raises :class:`Cancelled`."""
        self.check()
        now = time.monotonic()
        if not (force or message) and now - self._last < self.INTERVAL_SECONDS:
            return
        self._last = now
        total = max(sum(self._weights.values()), self._done_weight + self._weight(self._stage))
        overall = min(1.0, (self._done_weight + fraction * self._weight(self._stage)) / total)
        elapsed = now - self._start
        left = elapsed * (1 - overall) / overall if overall > 0.02 else None
        self._sink(
            ProgressEvent(stage=self._stage, fraction=fraction, overall=overall, seconds_left=left, message=message)
        )


def json_lines(stream: TextIO = sys.stdout) -> Sink:
    """Sink that writes newline-delimited JSON: the protocol between the worker process and Blender."""

    def write(event: ProgressEvent) -> None:
        stream.write(json.dumps({"type": "progress", **asdict(event)}) + "\n")
        stream.flush()

    return write


def console(stream: TextIO = sys.stderr) -> Sink:
    """Sink that draws one updating line on a terminal, or one line per stage where the stream is not a terminal."""
    seen: set[str] = set()

    def write(event: ProgressEvent) -> None:
        left = "" if event.seconds_left is None else f"  about {event.seconds_left:.0f} s left"
        text = f"{event.overall:6.1%}  {event.stage} {event.fraction:4.0%}{left}  {event.message}"
        if stream.isatty():
            stream.write("\r\x1b[2K" + text)
            if event.overall >= 1.0:
                stream.write("\n")
        elif event.stage not in seen or event.message:
            stream.write(f"{event.stage}{': ' + event.message if event.message else ''}\n")
        seen.add(event.stage)
        stream.flush()

    return write
