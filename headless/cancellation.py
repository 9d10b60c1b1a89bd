"""How a command is told to stop: by a signal, or by the end of the program that started it.

Ctrl-C takes effect within a second, whatever the program is doing. At first the work is asked to stop at its next
progress update. Python runs its signal handlers between two of its own instructions, though, and one call into numpy,
Embree or Blender can last longer than a person waits. A thread therefore hears of the signal as well, and ends a
process that has not stopped by then. Files on disk do not suffer: each one is moved into place whole.
"""

from __future__ import annotations

import os
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from types import FrameType

from iris_addon.base.errors import Cancelled
from iris_addon.base.progress import Progress

SIGNAL_GRACE_SECONDS = 0.5
"""Maximum cancellation latency after a signal, seconds."""
STDIN_GRACE_SECONDS = 10.0
"""Maximum cancellation latency after stdin has closed, seconds: nobody waits, so the work may end cleanly."""
SIGNALS = [
    getattr(signal, name)
    for name in ("SIGINT", "SIGTERM", "SIGBREAK")  # the last is how a process is asked to stop on Windows
    if hasattr(signal, name)
]


Handler = Callable[[int, FrameType | None], object] | int | None


def restore_handlers(handlers: Mapping[signal.Signals, Handler]) -> None:
    """Set signal handlers as :func:`signal.signal` returned them.

    A handler that Python did not set, such as Blender's for Ctrl-C, is returned as None and cannot be restored: the
    default takes its place.
    """
    for number, handler in handlers.items():
        signal.signal(number, signal.SIG_DFL if handler is None else handler)


@contextmanager
def cancelled_by_signals(progress: Progress, last_words: Callable[[], int]) -> Iterator[None]:
    """Let SIGINT and SIGTERM cancel ``progress``; call from the main thread.

    Args:
        last_words: called if the work has not ended SIGNAL_GRACE_SECONDS after the signal; tells the user and returns
            the exit code, with which the process then ends at once.
    """
    ended = threading.Event()
    hearing, telling = socket.socketpair()
    telling.setblocking(False)

    def watch() -> None:
        for number in iter(lambda: hearing.recv(1), b""):
            if number[0] in SIGNALS:
                progress.cancel()
                if not ended.wait(SIGNAL_GRACE_SECONDS):
                    os._exit(last_words())

    thread = threading.Thread(target=watch, daemon=True)
    thread.start()
    told = signal.set_wakeup_fd(telling.fileno(), warn_on_full_buffer=False)
    before = {number: signal.signal(number, lambda *_: progress.cancel()) for number in SIGNALS}
    try:
        yield
    finally:
        ended.set()
        restore_handlers(before)
        signal.set_wakeup_fd(told)
        telling.close()
        thread.join()
        hearing.close()


def stop_with_stdin(progress: Progress) -> None:
    """Cancel ``progress`` once stdin closes, which it does however the calling program ended.

    A worker must not outlive that program: the process ends STDIN_GRACE_SECONDS later if the work goes on.
    """

    def wait() -> None:
        # The descriptor itself: a thread inside sys.stdin's buffer would hold its lock while the interpreter ends.
        while os.read(0, 4096):
            pass
        progress.cancel()
        time.sleep(STDIN_GRACE_SECONDS)
        sys.stderr.flush()
        os._exit(Cancelled.exit_code)

    threading.Thread(target=wait, name="caller", daemon=True).start()
