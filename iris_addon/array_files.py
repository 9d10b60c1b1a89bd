"""Files of plain arrays that only save time: whatever is wrong with one, it is computed again."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray


def read_arrays(path: Path) -> dict[str, NDArray] | None:
    """The arrays of an .npz by name; None where the file is missing, damaged or holds more than plain arrays."""
    if not path.is_file():
        return None
    try:
        with np.load(path, allow_pickle=False) as file:
            return {name: file[name] for name in file.files}
    except (ValueError, TypeError, OSError, EOFError, zipfile.BadZipFile):
        # TypeError: an .npy under this name is no archive to open.
        return None
