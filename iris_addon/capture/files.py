"""Reading what a capture folder names, without trusting it: sizes, types and paths are checked here."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import BadInput
from ..imaging import IMAGE_SUFFIXES
from ..json_files import read_json

MAX_JSON_BYTES = 64 * 1024 * 1024
MAX_ARRAY_BYTES = 16 * 1024 * 1024


def read_json_object(path: Path) -> dict[str, Any]:
    """The JSON object in ``path``; raises BadInput when missing, too large or anything else than an object."""
    if not path.is_file():
        raise BadInput("no such file", "check the path of the capture", path)
    return read_json(path, MAX_JSON_BYTES, "export it again, a very large capture in parts")


def frames_of(meta: Mapping[str, Any], path: Path) -> list[dict[str, Any]]:
    """The "frames" of a transforms file, at least one; raises BadInput."""
    frames = meta.get("frames")
    if not isinstance(frames, list) or not frames or not all(isinstance(frame, dict) for frame in frames):
        raise BadInput('has no list of "frames"', "export the poses again", path)
    return frames


def number(values: Mapping[str, Any], key: str, path: Path) -> float:
    """``values[key]`` as a finite float; raises BadInput."""
    value = values[key]
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not np.isfinite(value):
        raise BadInput(f'"{key}" is {value!r}', "give it a finite number", path)
    return float(value)


def inside(root: Path, named: str, source: Path) -> Path:
    """The file that ``source`` calls ``named``, relative to ``root``.

    Raises:
        BadInput: the path is absolute or leaves the capture folder, by ".." or through a symbolic link.
    """
    relative = Path(named.replace("\\", "/"))
    path = root / relative
    try:
        escapes = relative.is_absolute() or not path.resolve().is_relative_to(root.resolve())
        path.with_name(path.name + ".jpeg").is_file()  # the longest name anybody will look for
    except (OSError, ValueError, RuntimeError) as error:  # over-long name, NUL byte, loop of links
        raise BadInput(f"names {named[:80]!r}, which is not a usable path", "correct the path", source) from error
    if escapes:
        raise BadInput(f"names {named[:80]!r}, outside the capture folder", "move the file into the folder", source)
    return path


def find_image(root: Path, named: str, source: Path) -> Path | None:
    """The image called ``named`` with or without its extension, or None when there is none.

    Raises:
        BadInput: it is outside ``root``, or of a format that is not read.
    """
    path = inside(root, named, source)
    if path.suffix.lower() in IMAGE_SUFFIXES:
        return path if path.is_file() else None
    for suffix in IMAGE_SUFFIXES:
        for candidate in (suffix, suffix.upper()):
            with_suffix = path.with_name(path.name + candidate)
            if with_suffix.is_file():
                return inside(root, str(with_suffix.relative_to(root)), source)
    if path.suffix and path.is_file():
        raise BadInput("is no PNG, JPEG or EXR", "save it as one of them", path)
    return None


def load_array(path: Path, length: int, what: str) -> NDArray[np.float64]:
    """(length,) float64 from a .npy file; raises BadInput for another length or content."""
    if not path.is_file():
        raise BadInput("no such file", "check the path", path)
    if path.stat().st_size > MAX_ARRAY_BYTES:
        raise BadInput(f"is larger than {MAX_ARRAY_BYTES >> 20} MiB", f"give one number per {what}", path)
    try:
        values = np.asarray(np.load(path, allow_pickle=False), np.float64).ravel()
    except (ValueError, TypeError, OSError, EOFError) as error:
        raise BadInput(f"is not a .npy file of numbers ({error})", "write it again with numpy.save", path) from error
    if len(values) != length:
        raise BadInput(f"has {len(values)} values for {length} {what}s", f"give one number per {what}", path)
    return values
