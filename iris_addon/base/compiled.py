"""Compiled loops over rays, patches, pixels or texels: one pass where array operations would take a dozen.

A :func:`kernel` is Python that Numba compiles when it is first called, a second or so each, and keeps in the user's
cache folder for every later process. It releases the interpreter lock, so that blocks of rays run on all cores
(:mod:`iris_addon.base.parallel`).
"""

from __future__ import annotations

import hashlib
import os
import tempfile
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeVar

import numba
import numpy as np
from numba.core import config as numba_config
from numpy.typing import NDArray

from .files import user_cache

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
    return numba.njit(function, nogil=True, cache=_kept(), error_model="numpy", _nrt=False, **options)  # type: ignore


def rows_of(columns: Columns, rows: slice | NDArray[np.bool_]) -> Columns:
    """A named tuple of arrays with some of their rows."""
    return type(columns)(*(values[rows] for values in columns))  # type: ignore[call-arg]


@lru_cache(maxsize=1)
def _kept() -> bool:
    """Whether compiled kernels can be kept on disk; without, each process compiles them again, in seconds.

    Numba does not see that a kernel called from another file has changed, so the folder is named after all sources.
    """
    if numba_config.CACHE_DIR:
        return True  # the user's own choice, NUMBA_CACHE_DIR
    folder = user_cache() / "kernels" / _digest()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError:
        return False
    numba_config.CACHE_DIR = os.fspath(folder)
    return True


def _digest() -> str:
    """Hash of the sources of all kernels."""
    root, digest = Path(__file__).parents[1], hashlib.sha256()
    for path in sorted(root.rglob("*.py")):
        source = path.read_bytes()
        if b"@kernel" in source or b"@inlined" in source:
            digest.update(source)
    return digest.hexdigest()[:16]
