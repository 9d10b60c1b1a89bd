"""Files written atomically: arrays, JSON, the user's cache folder, and protection from links.

Everything the project writes goes through here, so that an interrupted or failed write never harms the file that was
there before. Imports nothing that Blender lacks.

A result may come from a stranger, as an archive or a repository that holds links. Whatever is written, moved or deleted
below a link would be written, moved or deleted where it leads, so folders are checked by :func:`require_own_folder`.
"""

from __future__ import annotations

import errno
import glob
import hashlib
import json
import os
import re
import stat
import sys
import time
import uuid
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .errors import BadInput, IrisError
from .untrusted import MEND, numbers

REPLACE_SECONDS, REPLACE_PAUSE = 1.0, 0.02
"""How long a file that another program holds is waited for, and how long between two attempts."""


def atomic_write(path: Path, write: Callable[[Path], object]) -> None:
    """Let ``write`` fill a temporary file beside ``path``, then move it there in one step, which a power loss keeps.

    Missing folders are made. The temporary name has the suffix of ``path``, because writers choose the format by it.

    Raises:
        IrisError: the file cannot be written (full disk, no permission); ``path`` is what it was before.
    """
    temporary = path.with_name(f".{path.stem}-{uuid.uuid4().hex[:8]}{path.suffix}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write(temporary)
        flush_to_disk(temporary)
        replace_when_free(temporary, path)
        flush_to_disk(path.parent)
    except ValueError as error:
        if "\0" not in str(path):
            raise
        raise IrisError("is not a usable path", "give a name without control characters", str(path)) from error
    except OSError as error:
        fix = "free some space and run again" if error.errno == errno.ENOSPC else "check the folder and its permissions"
        raise IrisError(f"cannot be written ({error.strerror or error})", fix, path) from error
    finally:
        # A second failure while tidying up must not hide the first one.
        with suppress(OSError, ValueError):
            temporary.unlink(missing_ok=True)


def files_beside(blend: Path) -> Path:
    """The folder of the files that a .blend for other machines links to."""
    return blend.with_suffix(".files")


def digest_of(path: Path) -> str:
    """SHA-256 of a file of any size, as hexadecimal digits; raises OSError."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def flush_to_disk(path: Path) -> None:
    """Wait until the content of a file, or the names in a folder, survive a power loss.

    A move counts as done only afterwards: file systems may write it before the content of what is moved.

    Raises:
        OSError: the disk is full, or ``path`` cannot be opened.
    """
    if path.is_dir() and os.name == "nt":  # has no such thing for folders
        return
    # Windows flushes what is open for writing alone.
    descriptor = os.open(path, os.O_RDWR if os.name == "nt" else os.O_RDONLY)
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.ENOTSUP):  # network file systems that cannot
            raise
    finally:
        os.close(descriptor)


def replace_when_free(source: Path, target: Path) -> None:
    """:func:`os.replace`, tried again for a second while another program holds the target.

    On Windows a virus scanner, OneDrive, or a viewer that reads the file makes it fail for milliseconds.

    Raises:
        OSError: as :func:`os.replace`.
    """
    end = time.monotonic() + REPLACE_SECONDS
    while True:
        try:
            os.replace(source, target)
            return
        except PermissionError:
            if time.monotonic() > end:
                raise
            time.sleep(REPLACE_PAUSE)


def abandoned(path: Path) -> Iterator[Path]:
    """Temporary files of writes to ``path`` that were killed."""
    yield from path.parent.glob(f".{glob.escape(path.stem)}-{'[0-9a-f]' * 8}{glob.escape(path.suffix)}")


_TEMPORARY = re.compile(r"\.[^/\\]+-[0-9a-f]{8}(\.[^./\\]+)?")
ABANDONED_SECONDS = 24 * 3600.0
"""Age from which on a temporary file is that of a process that was killed."""


def remove_abandoned(folder: Path, seconds: float = ABANDONED_SECONDS) -> None:
    """Remove the temporary files in ``folder`` of writes that were killed, older than ``seconds``.

    Nothing is removed through a link. What cannot be removed stays.
    """
    if not is_own_folder(folder):
        return
    with suppress(OSError):
        for path in folder.iterdir():
            if _TEMPORARY.fullmatch(path.name) and is_own_file(path):
                with suppress(OSError):
                    if time.time() - path.stat().st_mtime >= seconds:
                        path.unlink()


# ---- Arrays by name (.npz) ------------------------------------------------------------------------------------------


def write_arrays(path: Path, arrays: Mapping[str, NDArray], *, compressed: bool = False) -> None:
    """Write ``arrays`` as one archive, built in memory: zipfile reports a full disk only when it is closed.

    Raises:
        IrisError: the file cannot be written; ``path`` is what it was before.
    """
    archive = BytesIO()
    (np.savez_compressed if compressed else np.savez)(archive, **arrays)
    atomic_write(path, lambda temporary: temporary.write_bytes(archive.getbuffer()))


# ---- JSON: numpy values out --------------------------------------------------------------------


def write_json(path: Path, content: object) -> None:
    """Write ``content`` as JSON in one step; numpy values are converted, numbers that are not finite become null.

    Raises:
        IrisError: the file cannot be written.
    """
    atomic_write(path, lambda temporary: dump_json(temporary, content))


def dump_json(path: Path, content: object) -> None:
    """Write ``content`` to ``path`` directly, for folders that are moved in place as a whole; raises OSError."""
    path.write_text(json.dumps(plain(content), indent=1, allow_nan=False) + "\n", encoding="utf-8")


def plain(value: object) -> Any:
    """``value`` with numpy arrays, numpy numbers, tuples and paths as JSON has them; NaN and infinity become None."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, list | tuple | set | frozenset):
        return [plain(item) for item in value]
    if isinstance(value, float):
        return value if np.isfinite(value) else None
    return str(value) if isinstance(value, Path) else value


def to_ranges(indices: NDArray[np.integer]) -> list[list[int]]:
    """Sorted unique ``indices`` as [first, last + 1] pairs."""
    indices = np.unique(indices)
    if not len(indices):
        return []
    breaks = np.flatnonzero(np.diff(indices) > 1)
    return np.column_stack([indices[np.r_[0, breaks + 1]], indices[np.r_[breaks, -1]] + 1]).tolist()


def from_ranges(value: object, n_faces: int, what: str, path: Path) -> NDArray[np.int64]:
    """Face indices from the pairs of :func:`to_ranges`; raises BadInput if they leave [0, n_faces) or repeat."""
    ranges = numbers(value if value else np.empty((0, 2)), (None, 2), what, path).astype(np.int64)
    if len(ranges) and (ranges.min() < 0 or ranges.max() > n_faces or (ranges[:, 0] >= ranges[:, 1]).any()):
        raise BadInput(f"'{what}' names faces beyond the {n_faces} of the mesh", MEND, path)
    if len(ranges) > 1 and (ranges[1:, 0] < ranges[:-1, 1]).any():
        raise BadInput(f"'{what}' names a face twice", MEND, path)
    return np.concatenate([np.arange(a, b) for a, b in ranges] or [np.empty(0, np.int64)]).astype(np.int64)


# ---- Cache folder ---------------------------------------------------------------------------------------------------


def user_folder() -> Path:
    """Folder of this program in the user's own files that stay on one computer, on Windows."""
    return Path(os.environ.get("LOCALAPPDATA", Path.home())) / "iris"


def user_cache() -> Path:
    """Folder for files that can be made again, by the convention of each system."""
    if sys.platform == "win32":
        return user_folder() / "cache"
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches" / "iris"
    return Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "iris"


# ---- Protection from links ------------------------------------------------------------------------------------------


WINDOWS_JUNCTION = 0xA0000003
"""``st_reparse_tag`` of a junction, which ``lstat`` shows as a plain folder."""


def is_own_folder(path: Path) -> bool:
    """Whether ``path`` is a folder and no link to one."""
    found = _lstat(path)
    return found is not None and stat.S_ISDIR(found.st_mode) and not _is_junction(found)


def is_own_file(path: Path) -> bool:
    """Whether ``path`` is a regular file and no link to one."""
    found = _lstat(path)
    return found is not None and stat.S_ISREG(found.st_mode)


def require_own_folder(path: Path) -> None:
    """Require that ``path`` does not exist or is a folder and no link.

    Raises:
        BadInput: a link or a file has its name.
    """
    if _lstat(path) is not None and not is_own_folder(path):
        raise BadInput("is a link or a file where a folder is written", "delete it, or choose another folder", path)


def require_only_name(path: Path) -> None:
    """Require that ``path`` does not exist or is a regular file without a second name, which an archive can give it.

    Raises:
        BadInput: a link, a pipe or a folder has its name, or the file lies elsewhere as well.
    """
    found = _lstat(path)
    if found is not None and not (stat.S_ISREG(found.st_mode) and found.st_nlink == 1):
        raise BadInput("is a link, or no file of this folder alone", "delete it, or choose another folder", path)


def _lstat(path: Path) -> os.stat_result | None:
    try:
        return path.lstat()
    except (OSError, ValueError):
        return None


def _is_junction(found: os.stat_result) -> bool:
    return getattr(found, "st_reparse_tag", 0) == WINDOWS_JUNCTION
