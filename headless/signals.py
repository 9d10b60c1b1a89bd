"""Ctrl-C is obeyed within a second, whatever the program is in the middle of.

The first way is the polite one: the work stops at its next progress update. Python runs its signal handlers between
two of its own instructions, though, and one call into numpy, Embree or Blender can last longer than a person waits.
So a thread hears of the signal as well, and ends a process that has not stopped by then. Nothing on disk minds: every
file is moved in place whole, as it has to be for a process that is killed.
"""

from __future__ import annotations

import os
import signal
import socket
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from types import FrameType

from iris_addon.base.progress import Progress

GRACE_SECONDS = 0.5
SIGNALS = [
    getattr(signal, name)
    for name in ("SIGINT", "SIGTERM", "SIGBREAK")  # the last is how a process is asked to stop on Windows
    if hasattr(signal, name)
]


Handler = Callable[[int, FrameType | None], object] | int | None


def put_back(handlers: Mapping[signal.Signals, Handler]) -> None:
    """Set signal handlers as :func:`signal.signal` returned them.

    One that was not set by Python, as Blender's for Ctrl-C, is called None and cannot be had back: the default it is.
    """
    for number, handler in handlers.items():
        signal.signal(number, signal.SIG_DFL if handler is None else handler)


@contextmanager
def cancelled_by_signals(progress: Progress, last_words: Callable[[], int]) -> Iterator[None]:
    """Let SIGINT and SIGTERM cancel ``progress``; call from the main thread.

    Args:
        last_words: called if the work has not ended GRACE_SECONDS after the signal; tells the user and returns the
            exit code, with which the process then ends at once.
    """
    ended = threading.Event()
    hearing, telling = socket.socketpair()
    telling.setblocking(False)

    def obey() -> None:
        for number in iter(lambda: hearing.recv(1), b""):
            if number[0] in SIGNALS:
                progress.cancel()
                if not ended.wait(GRACE_SECONDS):
                    os._exit(last_words())

    thread = threading.Thread(target=obey, daemon=True)
    thread.start()
    told = signal.set_wakeup_fd(telling.fileno(), warn_on_full_buffer=False)
    before = {number: signal.signal(number, lambda *_: progress.cancel()) for number in SIGNALS}
    try:
        yield
    finally:
        ended.set()
        put_back(before)
        signal.set_wakeup_fd(told)
        telling.close()
        thread.join()
        hearing.close()
