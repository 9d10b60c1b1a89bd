"""Work on many rays, block by block on all cores: numpy and Embree release the interpreter lock, so threads serve."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import numpy as np

Item = TypeVar("Item")
Made = TypeVar("Made")

BLOCK = 1 << 17
"""Rays, or whatever else is counted, of one block: smaller and the threads wait for the interpreter, larger and the
temporaries leave the cache."""


def cores() -> int:
    """Cores this process may run on."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def blocks(n: int, size: int) -> list[slice]:
    """``range(n)`` cut into slices of ``size`` (at least 1), the last one shorter."""
    step = max(1, size)
    return [slice(start, min(start + step, n)) for start in range(0, n, step)]


def over_blocks(
    n: int, size: int, work: Callable[[slice], None], done: Callable[[float], None] = lambda share: None
) -> None:
    """Call ``work`` on every block of ``range(n)``.

    Args:
        done: told the share that is done, on the calling thread. What it raises (a cancel), or what a block raises, is
            raised here at once; blocks not begun are dropped.
    """
    parts = blocks(n, size)
    if len(parts) == 1:
        work(parts[0])
        done(1.0)
        return
    with ThreadPoolExecutor(cores()) as threads:
        try:
            for part, _ in zip(parts, threads.map(work, parts), strict=True):
                done(part.stop / n)
        except BaseException:
            threads.shutdown(wait=False, cancel_futures=True)
            raise


def over_each(
    items: Sequence[Item], work: Callable[[Item], Made], done: Callable[[float], None] = lambda share: None
) -> list[Made]:
    """``work`` of every item, in their order, on all cores; ``done`` as for :func:`over_blocks`."""
    made: dict[int, Made] = {}

    def one(part: slice) -> None:
        made[part.start] = work(items[part.start])

    over_blocks(len(items), 1, one, done)
    return [made[index] for index in range(len(items))]


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
