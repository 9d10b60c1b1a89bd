"""Files that appear whole or not at all.

Everything the project writes goes through here, so that an interrupted or failed write never harms the file that was
there before. Imports nothing that Blender lacks.
"""

from __future__ import annotations

import errno
import glob
import os
import uuid
from collections.abc import Callable, Iterator
from pathlib import Path

from .errors import IrisError


def atomic_write(path: Path, write: Callable[[Path], object]) -> None:
    """Let ``write`` fill a temporary file beside ``path``, then move it there in one step.

    Missing folders are made. The temporary name has the suffix of ``path``, because writers choose the format by it.

    Raises:
        IrisError: the file cannot be written (full disk, no permission); ``path`` is what it was before.
    """
    temporary = path.with_name(f".{path.stem}-{uuid.uuid4().hex[:8]}{path.suffix}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write(temporary)
        os.replace(temporary, path)
    except OSError as error:
        fix = "free some space and run again" if error.errno == errno.ENOSPC else "check the folder and its permissions"
        raise IrisError(f"cannot be written ({error.strerror or error})", fix, path) from error
    finally:
        # A second failure while tidying up must not hide the first one.
        try:
            temporary.unlink(missing_ok=True)
        except OSError:
            pass


def abandoned(path: Path) -> Iterator[Path]:
    """Temporary files of writes to ``path`` that were killed."""
    yield from path.parent.glob(f".{glob.escape(path.stem)}-{'[0-9a-f]' * 8}{glob.escape(path.suffix)}")
