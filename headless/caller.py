"""A worker must not outlive the program that started it."""

from __future__ import annotations

import os
import sys
import threading
import time

from iris_addon.base.errors import Cancelled
from iris_addon.base.progress import Progress

GRACE_SECONDS = 10.0


def stop_with_stdin(progress: Progress) -> None:
    """Cancel ``progress`` once stdin closes, which it does however the caller ended; leave if nobody listens."""

    def wait() -> None:
        # The descriptor itself: a thread inside sys.stdin's buffer would hold its lock while the interpreter ends.
        while os.read(0, 4096):
            pass
        progress.cancel()
        time.sleep(GRACE_SECONDS)
        sys.stderr.flush()
        os._exit(Cancelled.exit_code)

    threading.Thread(target=wait, name="caller", daemon=True).start()
