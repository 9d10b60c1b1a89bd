"""Work on many rays, block by block on all cores: numpy and Embree release the interpreter lock, so threads serve."""

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
"""Rays, or whatever else is counted, of one block: smaller and the threads wait for the interpreter, larger and the
temporaries leave the cache."""

SECONDS_UNCHECKED = 0.1
"""For so long a wish to stop may go unheard while other threads work."""


def cores() -> int:
    """Cores this process may run on."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


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

    A block may call this again: its thread then takes what no other is free for, so that none waits for itself.

    Args:
        done: told the share that is done, on the calling thread. What it raises (a cancel) is raised here at once, what
            a block raises as soon as the caller is through with its own; blocks not begun are dropped.
        at_once: fewer blocks than there are cores, where each takes much memory.
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

    helpers = [_helpers().submit(take) for _ in range(min(at_once or cores(), cores(), len(parts)) - 1)]
    try:
        take(done)
    finally:
        begun = [helper for helper in helpers if not helper.cancel()]
    for helper in begun:
        helper.result()
    if begun:
        done(1.0)


def filled(values: NDArray[Number], work: Callable[[slice], NDArray]) -> NDArray[Number]:
    """``values`` (n, ...), written over with what ``work`` gives for every :data:`BLOCK` of rows."""

    def fill(rows: slice) -> None:
        values[rows] = work(rows)

    over_blocks(len(values), BLOCK, fill)
    return values


def over_shares(n: int, work: Callable[[slice], None]) -> None:
    """:func:`over_blocks` with one block for each core: for work that goes through all its input for each of them."""
    over_blocks(n, -(-n // cores()), work)


def over_each(
    items: Sequence[Item],
    work: Callable[[Item], Made],
    done: Callable[[float], None] = lambda share: None,
    at_once: int | None = None,
) -> list[Made]:
    """``work`` of every item, in their order, on all cores; ``done`` and ``at_once`` as for :func:`over_blocks`."""
    made: dict[int, Made] = {}

    def one(part: slice) -> None:
        made[part.start] = work(items[part.start])

    over_blocks(len(items), 1, one, done, at_once)
    return [made[index] for index in range(len(items))]


def aside(work: Callable[[], Made]) -> Future[Made]:
    """``work`` begun on a thread of its own; whoever asks for what it returns uses :func:`waited_for`."""
    thread = _threads(1, "iris aside")
    begun = thread.submit(work)
    thread.shutdown(wait=False)
    return begun


def waited_for(begun: Future[Made], check: Callable[[], None]) -> Made:
    """What work that was begun returns, or raises.

    ``check`` is called ten times a second meanwhile; what it raises (a cancel) is raised here at once, and the work
    then comes to its end unheeded.
    """
    while not wait([begun], SECONDS_UNCHECKED).done:
        check()
    return begun.result()


def over_random_blocks(
    n: int,
    size: int,
    work: Callable[[slice, np.random.Generator], None],
    rng: np.random.Generator,
    done: Callable[[float], None] = lambda share: None,
) -> None:
    """:func:`over_blocks` with a generator per block, so that the numbers drawn do not depend on who runs first."""
    generators = {part.start: generator for part, generator in random_blocks(n, size, rng)}
    over_blocks(n, size, lambda part: work(part, generators[part.start]), done)


def random_blocks(n: int, size: int, rng: np.random.Generator) -> list[tuple[slice, np.random.Generator]]:
    """:func:`blocks` with a generator each."""
    parts = blocks(n, size)
    return list(zip(parts, rng.spawn(len(parts)), strict=True))


# ---- Memory of this process: what it keeps, and how much it has taken -----------------------------------------------


_TRIM_THRESHOLD, _MMAP_THRESHOLD, _ARENA_MAX = -1, -3, -8
"""Of malloc.h: free memory at the end of a heap above which, and arrays as of which, all is given back; heaps."""


@cache
def keep_freed_memory() -> None:
    """Let this process keep the memory of arrays that are gone for the next ones, where the C library is GNU's.

    Given back it would come again page by page, each cleared by the system: a twentieth of a solve. One heap serves all
    threads that begin after this: those of single threads have 64 MB at most, and are given back whole once empty.
    """
    if sys.platform != "linux":
        return
    # Where the C library is another one (musl), it has no such switch.
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(_MMAP_THRESHOLD, 1 << 25)  # the most it takes
        mallopt(_TRIM_THRESHOLD, (1 << 31) - 1)
        mallopt(_ARENA_MAX, 1)


def peak_memory_bytes() -> int | None:
    """Largest resident size of this process so far; None where the system does not tell (Windows)."""
    if sys.platform == "win32":
        return None
    import resource

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return int(peak if sys.platform == "darwin" else peak * 1024)
