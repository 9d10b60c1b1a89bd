"""JSON as this project writes and checks it: numpy values out, validated arrays in."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .atomic_files import atomic_write
from .errors import BadInput

MAX_JSON_BYTES = 256 << 20
MEND = "restore the file or solve again"


def write_json(path: Path, content: object) -> None:
    """Write ``content`` as JSON in one step; numpy values are welcome, what is not finite becomes null.

    Raises:
        IrisError: the file cannot be written.
    """
    atomic_write(path, lambda temporary: dump_json(temporary, content))


def dump_json(path: Path, content: object) -> None:
    """Write ``content`` to ``path`` as it is, for folders that are moved in place as a whole; raises OSError."""
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


def read_json(path: Path, largest: int = MAX_JSON_BYTES, mend: str = "correct or restore the file") -> dict[str, Any]:
    """The JSON object in ``path``; raises BadInput, also for more than ``largest`` bytes, which are not read."""
    try:
        if path.stat().st_size > largest:
            raise BadInput(f"is larger than {largest >> 20} MiB", mend, path)
        content = json.loads(path.read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise BadInput(f"cannot be read ({error.strerror})", "check the path, or restore the file", path) from error
    except (ValueError, RecursionError) as error:
        raise BadInput(f"is not valid JSON ({error})", mend, path) from error
    if not isinstance(content, dict):
        raise BadInput("is not a JSON object", mend, path)
    return content


def numbers(value: object, shape: tuple[int | None, ...], what: str, path: Path) -> NDArray[np.float64]:
    """``value`` as finite float64 of ``shape`` (None: any length); raises BadInput naming ``what`` and ``path``."""
    try:
        array = np.asarray(value, dtype=np.float64)
    except (ValueError, TypeError) as error:
        raise BadInput(f"'{what}' is not numbers", MEND, path) from error
    fits = array.ndim == len(shape) and all(n in (None, m) for n, m in zip(shape, array.shape, strict=True))
    if not fits or not np.isfinite(array).all():
        expected = " x ".join("n" if n is None else str(n) for n in shape) or "one"
        raise BadInput(f"'{what}' should be {expected} finite numbers", MEND, path)
    return array


def json_object(value: object, what: str, path: Path) -> dict[str, Any]:
    """``value`` if it is a JSON object; raises BadInput naming ``what`` and ``path``."""
    if not isinstance(value, dict):
        raise BadInput(f"'{what}' is missing or not a JSON object", MEND, path)
    return value


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
