"""Files that somebody else made: opened in one place, decoded in one place, their numbers checked in one place.

A capture, a result or a job may come from anybody, by mistake or on purpose: a pipe or a device under the name of a
photo, a header that announces a terabyte, a number of four thousand digits, a link to another folder. Every reader of
the package takes its bytes from :func:`open_file`, wraps its decoder in :func:`decoding` and lets :func:`finite` look
at its numbers; a test of the architecture finds those that do not. Needs numpy alone, as Blender's Python has no more.
"""

from __future__ import annotations

import io
import json
import math
import os
import re
import stat
import tomllib
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any, BinaryIO, TextIO

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from .errors import BadInput, IrisError

MEND = "restore the file or solve again"
"""Advice for a damaged file of a result."""
RESTORE = "correct or restore the file"
MAX_JSON_BYTES = 256 << 20
MAX_DEPTH = 64
"""Containers within containers of a JSON or TOML file; those of the project need ten."""
MAX_SQUARED_DOTS = 30_000_000
"""Of the lines of a TOML file, summed: dots part the names of tables in tables."""
MAX_INTEGER_DIGITS = 18
"""Longer integers of JSON are read as floats, which numpy can look at whatever their size."""
MAX_NUMBER = 1e30
"""Largest magnitude of a number in a file. Its square is finite in double precision, itself in single precision."""
READ_BYTES = 1 << 20
MAX_ARCHIVE_BYTES = 16 << 30
MAX_COMPRESSION, FREE_BYTES = 64, 64 << 20
"""An archive may decompress to this multiple of its size, or to this many bytes."""


# ---- Opening --------------------------------------------------------------------------------------------------------


def open_file(path: Path, largest: int, *, mend: str = RESTORE) -> BinaryIO:
    """Open ``path`` for reading bytes.

    A pipe would block for ever, and a device have no end, whatever size they report, so only regular files are opened.

    Args:
        largest: bytes that the file may have.
        mend: advice if it is damaged or too large.

    Raises:
        BadInput: missing, no regular file, larger than ``largest``, or not readable.
    """
    try:
        _require_regular(path, path.stat())
        file = open(path, "rb", opener=_without_waiting)  # noqa: SIM115 -- returned; Path.open has no opener
    except FileNotFoundError as error:
        raise BadInput("no such file", "check the path, or restore the file", path) from error
    except OSError as error:
        raise BadInput(f"cannot be read ({error.strerror})", "check the path, or restore the file", path) from error
    except (ValueError, RuntimeError) as error:  # a NUL byte in the name, a loop of links
        raise BadInput("is not a usable path", "correct the path", path) from error
    try:
        found = os.fstat(file.fileno())
        _require_regular(path, found)
        if found.st_size > largest:
            raise _too_large(path, largest, mend)
    except BaseException:
        file.close()
        raise
    return file


def _without_waiting(path: str, flags: int) -> int:
    """Open, but do not wait for the writer of a pipe that has just taken the place of a file."""
    return os.open(path, flags | getattr(os, "O_NONBLOCK", 0))


def require_inside(path: Path, folder: Path) -> None:
    """Raise BadInput where ``path`` is a link that leads out of ``folder``; ``folder`` itself may be one."""
    try:
        inside = path.resolve().is_relative_to(folder.resolve())
    except (OSError, ValueError, RuntimeError) as error:  # a loop of links, a NUL byte
        raise BadInput("is not a usable path", "correct the path", path) from error
    if not inside:
        raise BadInput("is a link that leads out of its folder", "put the file itself there", path)


def _require_regular(path: Path, found: os.stat_result) -> None:
    if not stat.S_ISREG(found.st_mode):
        raise BadInput("is a folder, pipe or device, not a file", "put the file itself there", path)


def _too_large(path: Path, largest: int, mend: str) -> BadInput:
    size = f"{largest >> 30} GiB" if largest >= 1 << 30 else f"{largest >> 20} MiB"
    return BadInput(f"is larger than {size}", mend, path)


def read_bytes(path: Path, largest: int, *, mend: str = RESTORE) -> bytes:
    """All bytes of a file, at most ``largest``; arguments and errors are those of :func:`open_file`."""
    with open_file(path, largest, mend=mend) as file, decoding(path, mend=mend):
        # As many as its size says, and one more: a file may grow, and those of /proc report no size. The space for what
        # is asked for is allocated first.
        content = file.read(min(os.fstat(file.fileno()).st_size, largest) + 1)
        while len(content) <= largest and (more := file.read(min(READ_BYTES, largest + 1 - len(content)))):
            content += more
        if len(content) > largest:
            raise _too_large(path, largest, mend)
        return content


@contextmanager
def open_text(path: Path, largest: int, *, mend: str = RESTORE, newline: str | None = None) -> Iterator[TextIO]:
    """A file as lines of UTF-8, wrong bytes replaced; what fails inside is an error of this file.

    Arguments and errors are those of :func:`open_file`; ``newline`` is that of :func:`open`.
    """
    with open_file(path, largest, mend=mend) as file, decoding(path, mend=mend):
        yield io.TextIOWrapper(file, encoding="utf-8-sig", errors="replace", newline=newline)


@contextmanager
def decoding(path: Path, what: str = "is damaged", mend: str = RESTORE) -> Iterator[None]:
    """Inside, any failure becomes an error about ``path``: decoders fail in as many ways as a file can be damaged.

    Raises:
        BadInput: ``what`` is wrong, with the decoder's own words.
    """
    try:
        yield
    except (IrisError, ImportError):
        raise
    except Exception as error:
        raise BadInput(f"{what} ({_words(error)})", mend, path) from error


def _words(error: Exception) -> str:
    said = str(error.strerror if isinstance(error, OSError) and error.strerror else error).strip()
    kind = type(error).__name__
    if isinstance(error, MemoryError):
        return "it needs more memory than there is"
    if isinstance(error, KeyError):
        return f"no {said}"
    return said.splitlines()[0][:160] if said else kind


# ---- Numbers --------------------------------------------------------------------------------------------------------


def finite(
    value: object, shape: tuple[int | None, ...] = (), largest: float = MAX_NUMBER
) -> NDArray[np.float64] | None:
    """``value`` as float64 of ``shape`` (None: any length), magnitudes up to ``largest``; None if it is not that."""
    array = floats(value, shape)
    return array if array is not None and bool((np.abs(array) <= largest).all()) else None  # NaN compares false


def floats(value: object, shape: tuple[int | None, ...]) -> NDArray[np.float64] | None:
    """``value`` as float64 of ``shape`` (None: any length), NaN and infinity included; None if it is not that.

    Text, true and false are no numbers.
    """
    try:
        given = np.asarray(value)
        if given.dtype.kind not in "iuf" and given.size:  # object: integers of any length, lists of unequal ones
            return None
        array = given.astype(np.float64)
    except (ValueError, TypeError, OverflowError, RecursionError, MemoryError):
        return None
    fits = array.ndim == len(shape) and all(want in (None, n) for want, n in zip(shape, array.shape, strict=True))
    return array if fits else None


def numbers(value: object, shape: tuple[int | None, ...], what: str, path: Path) -> NDArray[np.float64]:
    """``value`` as finite float64 of ``shape`` (None: any length); raises BadInput naming ``what`` and ``path``."""
    array = finite(value, shape)
    if array is None:
        expected = " x ".join("n" if n is None else str(n) for n in shape) or "one"
        raise BadInput(f"'{what}' should be {expected} finite numbers", MEND, path)
    return array


def number_in_text(text: str) -> float:
    """The finite number that ``text`` spells, for use within :func:`decoding`; raises ValueError."""
    value = float(text)
    if not math.isfinite(value) or abs(value) > MAX_NUMBER:
        raise ValueError(f"{text[:40]!r} is not a usable number")
    return value


# ---- JSON and TOML --------------------------------------------------------------------------------------------------


_SURROGATE = re.compile(rb"\\u[dD][89a-fA-F]")


def read_json(path: Path, largest: int = MAX_JSON_BYTES, mend: str = RESTORE) -> dict[str, Any]:
    """The JSON object in ``path``; raises BadInput, also for more than ``largest`` bytes, which are not read."""
    content = parse_json(read_bytes(path, largest, mend=mend), path, mend)
    if not isinstance(content, dict):
        raise BadInput("is not a JSON object", mend, path)
    return content


def parse_json(data: bytes, path: Path, mend: str = RESTORE) -> Any:
    """What the JSON ``data`` from ``path`` says; raises BadInput, also for text that is no Unicode."""
    with decoding(path, "is not valid JSON", mend):
        content = json.loads(data.decode("utf-8-sig"), parse_int=_integer)
        if _SURROGATE.search(data):
            json.dumps(content, ensure_ascii=False).encode()
    _require_shallow(content, path, mend)
    return content


def read_toml(path: Path, largest: int, mend: str = "correct the line") -> dict[str, Any]:
    """The content of a TOML file; raises BadInput."""
    data = read_bytes(path, largest, mend=mend)
    # The time that tomllib takes for a name rises with the square of its parts.
    if sum(line.count(b".") ** 2 for line in data.splitlines()) > MAX_SQUARED_DOTS:
        raise BadInput("has names of too many parts, or too many dots in a line", mend, path)
    with decoding(path, "is not valid TOML", mend):
        content = tomllib.loads(data.decode("utf-8-sig"))
    _require_shallow(content, path, mend)
    return content


def _integer(digits: str) -> int | float:
    return int(digits) if len(digits) <= MAX_INTEGER_DIGITS else float(digits)


def _require_shallow(content: object, path: Path, mend: str) -> None:
    level = [content]
    for _ in range(MAX_DEPTH):
        level = [
            item
            for box in level
            for item in (box.values() if isinstance(box, dict) else box if isinstance(box, list) else ())
            if isinstance(item, dict | list)
        ]
        if not level:
            return
    raise BadInput(f"is nested more than {MAX_DEPTH} deep", mend, path)


def json_object(value: object, what: str, path: Path) -> dict[str, Any]:
    """``value`` if it is a JSON object; raises BadInput naming ``what`` and ``path``."""
    if not isinstance(value, dict):
        raise BadInput(f"'{what}' is missing or not a JSON object", MEND, path)
    return value


# ---- Arrays (.npy, .npz) --------------------------------------------------------------------------------------------


def read_npy(path: Path, largest: int, mend: str = RESTORE) -> NDArray[Any]:
    """The array of numbers in a .npy file; raises BadInput for anything else."""
    with (
        open_file(path, largest, mend=mend) as file,
        decoding(path, "is not a .npy file of numbers", mend),
    ):
        return _npy(file, os.fstat(file.fileno()).st_size, kinds="iuf")


def read_arrays(path: Path) -> dict[str, NDArray[Any]] | None:
    """The arrays of an archive (.npz) that can be made again; None where it is missing, damaged or holds more.

    Whatever is wrong with the file, the answer is to make it again.
    """
    try:
        with open_file(path, MAX_ARCHIVE_BYTES) as file, decoding(path), zipfile.ZipFile(file) as archive:
            members = archive.infolist()
            size = os.fstat(file.fileno()).st_size
            if sum(member.file_size for member in members) > max(FREE_BYTES, MAX_COMPRESSION * size):
                return None
            arrays = {}
            for member in members:
                with archive.open(member) as content:
                    arrays[member.filename.removesuffix(".npy")] = _npy(content, member.file_size, kinds="biufU")
            return arrays
    except BadInput:
        return None


def read_curves(path: Path, largest: int, mend: str = RESTORE) -> NDArray[np.float64]:
    """Curves of finite numbers, one per row: "samples" of a .json, a .npy, or the columns of a text table.

    Raises:
        BadInput: missing, empty, too large, or none of these.
    """
    kind = path.suffix.lower()
    if kind == ".npy":
        given: object = read_npy(path, largest, mend)
    elif kind == ".json":
        given = read_json(path, largest, mend).get("samples")
    else:
        with open_text(path, largest, mend=mend) as file:  # opened here: by name numpy would decompress it
            rows = [[number_in_text(word) for word in line.partition("#")[0].split()] for line in file]
            given = np.array([row for row in rows if row]).T
    table = floats(given, (None, None))
    table = floats([given], (1, None)) if table is None else table
    if table is None or not table.size or finite(table, table.shape) is None:
        raise BadInput("holds no curves of finite numbers", mend, path)
    return table


def _npy(file: IO[bytes], size: int, kinds: str) -> NDArray[Any]:
    """The array of ``file``, allocated only once its header agrees with the ``size`` of the file in bytes.

    Raises:
        ValueError: no .npy file, of another kind (letters of ``numpy.dtype.kind``), or of another size.
    """
    version = npy.read_magic(file)
    headers = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}
    if version not in headers:
        raise ValueError(f"version {version} of the format")
    shape, fortran, dtype = headers[version](file)
    if dtype.kind not in kinds or dtype.names is not None or dtype.subdtype is not None:
        raise ValueError(f"it holds {str(dtype)[:40]}")
    count = math.prod(shape)
    if any(side < 0 for side in shape) or count * dtype.itemsize != size - file.tell():
        raise ValueError("its header announces another size than it has")
    flat = np.empty(count, dtype)
    if count and dtype.itemsize:
        space = flat.view(np.uint8).data
        filled = 0
        while filled < len(space):
            read = file.readinto(space[filled:])  # type: ignore[attr-defined]
            if not read:
                raise ValueError("it ends too early")
            filled += read
    return flat.reshape(shape, order="F" if fortran else "C")
