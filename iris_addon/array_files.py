"""Files of plain arrays by name, .npz."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from io import BytesIO
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .atomic_files import atomic_write


def write_arrays(path: Path, arrays: Mapping[str, NDArray], *, compressed: bool = False) -> None:
    """Write ``arrays``; raises IrisError where they cannot be written, and ``path`` is then what it was before.

    The archive is made in memory: one that cannot be closed, because the disk is full, complains long after.
    """
    archive = BytesIO()
    (np.savez_compressed if compressed else np.savez)(archive, **arrays)
    atomic_write(path, lambda temporary: temporary.write_bytes(archive.getbuffer()))


def read_arrays(path: Path) -> dict[str, NDArray] | None:
    """The arrays of a file that only saves time; None where it is missing, damaged or holds more than plain arrays."""
    if not path.is_file():
        return None
    try:
        with np.load(path, allow_pickle=False) as file:
            return {name: file[name] for name in file.files}
    except (ValueError, TypeError, OSError, EOFError, zipfile.BadZipFile):
        # TypeError: an .npy under this name is no archive to open.
        return None
