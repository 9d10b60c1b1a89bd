"""Compiled loops over rays, patches, pixels or texels: one pass where array operations would take a dozen.

A :func:`kernel` is Python that Numba compiles when it is first called, a second or so each, and keeps in the user's
cache folder for every later process. It releases the interpreter lock, so that blocks of rays run on all cores
(:mod:`iris_addon.base.parallel`).
"""

from __future__ import annotations

import hashlib
import os
import stat
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from .files import user_cache


@contextmanager
def _without_yaml() -> Iterator[None]:
    """Numba, imported in here, does not read ``.numba_config.yaml`` of the current folder.

    That is often the folder of a file from an untrusted source, and the configuration can name a folder of compiled
    functions: pickles, which run what they say.
    """
    kept = {name: sys.modules.pop(name) for name in ("yaml",) if name in sys.modules}
    sys.modules["yaml"] = None  # type: ignore[assignment] - Python's way to say that a module cannot be imported
    try:
        with warnings.catch_warnings(action="ignore"):  # that the file is there
            yield
    finally:
        del sys.modules["yaml"]
        sys.modules.update(kept)


with _without_yaml():
    import numba
    from numba.core import config as numba_config
    from numba.core.caching import FunctionCache

numba_config._config_fname = ""  # type: ignore[attr-defined] - it is looked for again whenever something is compiled

Function = TypeVar("Function", bound=Callable[..., Any])
Real = Any
"""A real number in a kernel: Python's, or that of an array of any precision."""
Integer = Any
"""A whole number in a kernel."""

Columns = TypeVar("Columns", bound=tuple)


def kernel(function: Function) -> Function:
    """``function``, compiled. It makes no arrays of its own, only fills those it is given."""
    return _compiled(function)


def inlined(function: Function) -> Function:
    """``function``, compiled into the kernels that call it for every ray."""
    return _compiled(function, forceinline=True)


def _compiled(function: Function, **options: bool) -> Function:
    # Unless _nrt=False, every call counts references to its arrays by atomic operations, which takes as long as the
    # work itself: 135 instead of 61 ns to look up the patch of a ray.
    compiled: Any = numba.njit(function, nogil=True, error_model="numpy", _nrt=False, **options)  # type: ignore
    if _kept():
        compiled._cache = KernelCache(function)  # what cache=True does, with a cache of our own
    return compiled


class KernelCache(FunctionCache):
    """Compiled functions on disk. A damaged file is compiled again, and a full disk costs time alone."""

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """The compiled function for the signature ``sig``; None if it is not there or cannot be read."""
        try:
            return super().load_overload(sig, target_context)
        except Exception:  # the files are pickles: whatever a damaged one raises, the function is compiled again
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep ``data``, what was compiled for ``sig``, if the disk allows it."""
        try:
            super().save_overload(sig, data)
        except Exception:
            with suppress(Exception):  # a damaged index is replaced by an empty one; on a full disk that fails too
                self.flush()
                super().save_overload(sig, data)


def rows_of(columns: Columns, rows: slice | NDArray[np.bool_]) -> Columns:
    """A named tuple of arrays with some of their rows."""
    return type(columns)(*(values[rows] for values in columns))  # type: ignore[call-arg]


@lru_cache(maxsize=1)
def _kept() -> bool:
    """Whether compiled kernels can be kept on disk; without, each process compiles them again, in seconds.

    Numba does not see that a kernel called from another file has changed, so the folder is named after all sources.
    """
    # The variable is the user's own choice; Numba's own setting may come from a file of the current folder.
    chosen = os.environ.get("NUMBA_CACHE_DIR")
    folder = Path(chosen) if chosen else user_cache() / "kernels" / _digest()
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
        if not _only_ours(folder):
            return False
    except OSError:
        return False
    numba_config.CACHE_DIR = os.fspath(folder)
    return True


def _only_ours(folder: Path) -> bool:
    """Whether nobody else can write into ``folder``: its files are pickles, and reading one runs what it says."""
    if os.name == "nt":  # folders of a user are closed to others
        return True
    found = folder.stat()
    return found.st_uid == os.geteuid() and not stat.S_IMODE(found.st_mode) & (stat.S_IWGRP | stat.S_IWOTH)


def _digest() -> str:
    """Hash of the sources of all kernels."""
    root, digest = Path(__file__).parents[1], hashlib.sha256()
    for path in sorted(root.rglob("*.py")):
        source = path.read_bytes()
        if b"@kernel" in source or b"@inlined" in source:
            digest.update(source)
    return digest.hexdigest()[:16]
