"""Folders that this project made itself, told from links that lead to somebody else's.

A result may come from a stranger, as an archive or a repository that holds links. What is written, moved or deleted in
a folder below it would be written, moved or deleted wherever such a link leads.
"""

from __future__ import annotations

import os
import stat
from pathlib import Path

from .errors import BadInput

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
    """Make sure that ``path`` is free for a folder of ours, or is one.

    Raises:
        BadInput: a link or a file has its name.
    """
    if _lstat(path) is not None and not is_own_folder(path):
        raise BadInput("is a link or a file where a folder is written", "delete it, or choose another folder", path)


def _lstat(path: Path) -> os.stat_result | None:
    try:
        return path.lstat()
    except (OSError, ValueError):
        return None


def _is_junction(found: os.stat_result) -> bool:
    return getattr(found, "st_reparse_tag", 0) == WINDOWS_JUNCTION
