"""What every reader owes for a damaged file: one line that names it, in little time and memory."""

from __future__ import annotations

import contextlib
import signal
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from iris_addon.base.errors import BadInput

SLOW_SECONDS = 10.0
LARGE_BYTES = 1 << 30
"""Of memory that a reader may take for a damaged file, beyond what the process has."""


@dataclass(frozen=True)
class Target:
    """A file to damage and what reads it.

    Attributes:
        path: the file, within ``root``.
        good: its content before it is damaged.
    """

    name: str
    root: Path
    path: Path
    read: Callable[[], object]
    good: bytes


class Hang(BaseException):
    """A reader took longer than SLOW_SECONDS, of the processor: other programs take their share of the clock's."""


def check(target: Target, data: bytes) -> str | None:
    """What is wrong with how the reader of ``target`` took ``data``; None if it read it or refused it as it should."""
    target.path.write_bytes(data)
    forget_peak()
    before, begin = peak(), time.process_time()
    wrong: str | None = None
    if sys.platform != "win32":
        signal.signal(signal.SIGPROF, _too_slow)
        signal.setitimer(signal.ITIMER_PROF, SLOW_SECONDS)
    try:
        with warnings.catch_warnings(record=True) as warned:
            warnings.simplefilter("always")
            target.read()
        ours = [warning for warning in warned if "iris_addon" in warning.filename or "headless" in warning.filename]
        wrong = f"warns: {ours[0].message}"[:300] if ours else None
    except BadInput as error:
        wrong = unfit(str(error), target)
    except Hang:
        wrong = "hangs"
    except Exception as error:
        wrong = f"raises {type(error).__name__}: {error}"[:300]
    finally:
        if sys.platform != "win32":
            signal.setitimer(signal.ITIMER_PROF, 0)
        target.path.write_bytes(target.good)
    if wrong is None and time.process_time() - begin > SLOW_SECONDS:
        wrong = f"takes {time.process_time() - begin:.0f} s"
    if wrong is None and peak() - before > LARGE_BYTES:
        wrong = f"takes {(peak() - before) >> 20} MiB"
    return wrong


def unfit(message: str, target: Target) -> str | None:
    """Why ``message`` is not what a person should see; None if it is."""
    if not message.isprintable():
        return f"says more than a line: {message!r}"[:300]
    if " — " not in message or str(target.root) not in message:
        return f"names no file, or no way out: {message}"[:300]
    return None


def _too_slow(*_: object) -> None:
    raise Hang


def forget_peak() -> None:
    """Begin a new measurement of the most memory that this process has."""
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")


def peak() -> int:
    """The most memory that this process had since :func:`forget_peak`, bytes; 0 where it cannot be told."""
    with contextlib.suppress(OSError):
        for line in Path("/proc/self/status").read_text().splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) << 10
    return 0


def files(name: str, folder: Path, read: Callable[[], object], *names: str) -> Iterator[Target]:
    """A target for each of ``names`` in ``folder``, all read by ``read``."""
    for file in names:
        path = folder / file
        label = f"{name}-{file.replace('/', '-')}"
        yield Target(name=label, root=folder, path=path, read=read, good=path.read_bytes())
