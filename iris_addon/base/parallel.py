"""Work on many rays, block by block on all cores, with the process memory that it needs.

Threads are enough, because numpy, Embree and compiled kernels release the interpreter lock. Results do not depend on
the number of cores: random numbers are drawn from a generator per block.
"""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from functools import cache
from threading import Event, Lock
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

Item = TypeVar("Item")
Made = TypeVar("Made")
Number = TypeVar("Number", bound=np.generic)

BLOCK = 1 << 17
"""Rays, patches or pixels of one block: with fewer, threads wait for the interpreter; with more, temporaries leave the
processor's cache."""

CANCEL_LATENCY = 0.1
"""Maximum cancellation latency while another thread works, seconds."""


CORES_VARIABLE = "IRIS_CORES"
"""Environment variable: cores to use, where other work shares the machine."""


def cores() -> int:
    """Cores this process may run on, at most as many as :data:`CORES_VARIABLE` says."""
    there = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    chosen = os.environ.get(CORES_VARIABLE, "")
    return max(1, min(there, int(chosen))) if chosen.isdecimal() and len(chosen) < 6 else there


def blocks(n: int, size: int) -> list[slice]:
    """``range(n)`` cut into slices of ``size`` (at least 1), the last one shorter."""
    step = max(1, size)
    return [slice(start, min(start + step, n)) for start in range(0, n, step)]


@cache
def _helpers() -> ThreadPoolExecutor:
    """Threads beside the caller's own, started once: there are hundreds of calls in a solve."""
    return _threads(max(1, cores() - 1), "iris")


def _threads(count: int, name: str) -> ThreadPoolExecutor:
    keep_freed_memory()
    return ThreadPoolExecutor(count, name)


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_helpers.cache_clear)  # threads do not live on in a child


def over_blocks(
    n: int,
    size: int,
    work: Callable[[slice], None],
    done: Callable[[float], None] = lambda share: None,
    at_once: int | None = None,
) -> None:
    """Call ``work`` on every block of ``range(n)``, on this thread and as many more as there are cores.

    Calls nest: a thread works on blocks itself and never waits for one that has not begun.

    Args:
        done: called with the finished share, 0 to 1, on the calling thread.
        at_once: most blocks in work at a time, by default one per core; for blocks that take much memory.

    Raises:
        Exception: what ``done`` raises (a cancel), at once; what a block raises, when the calling thread has finished
            its own block. Blocks that have not begun are dropped.
    """
    parts = blocks(n, size)
    left, finished = iter(parts), 0
    lock, stopped = Lock(), Event()

    def take(after: Callable[[float], None] = lambda share: None) -> None:
        nonlocal finished
        try:
            while not stopped.is_set():
                with lock:
                    part = next(left, None)
                if part is None:
                    return
                work(part)
                with lock:
                    finished += part.stop - part.start
                    share = finished / n
                after(share)
        except BaseException:
            stopped.set()
            raise

    shared = [take]  # emptied at the end: a thread that is busy elsewhere would keep all that the work knows

    def join() -> None:
        for own in shared[:]:
            own()

    helpers = [_helpers().submit(join) for _ in range(min(at_once or cores(), cores(), len(parts)) - 1)]
    try:
        take(done)
    finally:
        begun = [helper for helper in helpers if not helper.cancel()]
        shared.clear()
    for helper in begun:
        helper.result()
    if begun:
        done(1.0)


def filled(values: NDArray[Number], work: Callable[[slice], NDArray]) -> NDArray[Number]:
    """``values`` (n, ...), overwritten by what ``work`` returns for every :data:`BLOCK` of rows."""

    def fill(rows: slice) -> None:
        values[rows] = work(rows)

    over_blocks(len(values), BLOCK, fill)
    return values


def over_shares(n: int, work: Callable[[slice], None]) -> None:
    """:func:`over_blocks` with one block per core: for work that reads all of its input for every block."""
    over_blocks(n, -(-n // cores()), work)


def over_each(
    items: Sequence[Item],
    work: Callable[[Item], Made],
    done: Callable[[float], None] = lambda share: None,
    at_once: int | None = None,
) -> list[Made]:
    """What ``work`` returns for every item, in order, on all cores.

    ``done`` and ``at_once`` are those of :func:`over_blocks`.
    """
    made: dict[int, Made] = {}

    def one(part: slice) -> None:
        made[part.start] = work(items[part.start])

    over_blocks(len(items), 1, one, done, at_once)
    return [made[index] for index in range(len(items))]


def aside(work: Callable[[], Made]) -> Future[Made]:
    """Start ``work`` on a thread of its own; :func:`waited_for` returns its result."""
    thread = _threads(1, "iris aside")
    begun = thread.submit(work)
    thread.shutdown(wait=False)
    return begun


def waited_for(begun: Future[Made], check: Callable[[], None]) -> Made:
    """The result of work that :func:`aside` began; raises what the work raises.

    ``check`` is called ten times a second meanwhile; what it raises (a cancel) is raised here at once, and the
    result of the work is dropped.
    """
    while not wait([begun], CANCEL_LATENCY).done:
        check()
    return begun.result()


def over_random_blocks(
    n: int,
    size: int,
    work: Callable[[slice, np.random.Generator], None],
    rng: np.random.Generator,
    done: Callable[[float], None] = lambda share: None,
) -> None:
    """:func:`over_blocks` with a generator per block, so that random numbers do not depend on the order of blocks."""
    generators = {part.start: generator for part, generator in random_blocks(n, size, rng)}
    over_blocks(n, size, lambda part: work(part, generators[part.start]), done)


def random_blocks(n: int, size: int, rng: np.random.Generator) -> list[tuple[slice, np.random.Generator]]:
    """:func:`blocks` with a generator each."""
    parts = blocks(n, size)
    return list(zip(parts, rng.spawn(len(parts)), strict=True))


# ---- Memory of this process -----------------------------------------------------------------------------------------


_TRIM_THRESHOLD, _MMAP_THRESHOLD, _ARENA_MAX = -1, -3, -8
"""Options of mallopt (malloc.h): M_TRIM_THRESHOLD, M_MMAP_THRESHOLD, M_ARENA_MAX."""


@cache
def keep_freed_memory() -> None:
    """Keep the memory of freed arrays for later ones, where the C library is GNU's.

    Memory returned to the system comes back page by page, each cleared first, which takes a twentieth of a solve. All
    threads started after this share one heap: a thread's own heap is 64 MB at most and returned whole once empty.
    """
    if sys.platform != "linux":
        return
    # Other C libraries (musl) have no mallopt.
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(_MMAP_THRESHOLD, 1 << 25)  # its maximum
        mallopt(_TRIM_THRESHOLD, (1 << 31) - 1)
        mallopt(_ARENA_MAX, 1)


def peak_memory_bytes() -> int | None:
    """Largest resident size of this process so far; None on Windows, which does not report it."""
    if sys.platform == "win32":
        return None
    import resource

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return int(peak if sys.platform == "darwin" else peak * 1024)
