"""One solve per folder: a second one, of another Blender or another shell, is told so and mixes no files in."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from filelock import FileLock, Timeout

from .errors import BadInput, IrisError

LOCK = ".lock"


@contextmanager
def sole_writer(folder: Path) -> Iterator[None]:
    """Hold ``folder`` for this process, which makes it where it is missing.

    The system lets go of the lock when the process ends, however it ends. The empty file stays: to remove it would let
    in two who wait for it.

    Raises:
        BadInput: another process holds it.
        IrisError: it cannot be made or written.
    """
    lock = FileLock(folder / LOCK)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock.acquire(timeout=0)
    except Timeout as error:
        fix = "wait until it is done, cancel it, or choose another folder"
        raise BadInput("is being solved by another program", fix, folder) from error
    except OSError as error:
        message = f"cannot be written ({error.strerror or error})"
        raise IrisError(message, "check the folder and its permissions", folder) from error
    try:
        yield
    finally:
        lock.release()
