"""Blocks on all cores, and the hash index that rays find their patches with."""

from __future__ import annotations

import sys
import threading
import time
import weakref
from pathlib import Path
from subprocess import run

import numpy as np
import pytest

from iris_addon.base.parallel import (
    _helpers,
    aside,
    blocks,
    over_blocks,
    over_each,
    over_random_blocks,
    over_shares,
    waited_for,
)
from iris_addon.base.progress import Cancelled
from iris_addon.capture.photos import photos_at_once
from iris_addon.model.capture import Camera, View
from iris_addon.surface.patches import Slots, number_of

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize(("n", "size"), [(0, 4), (3, 4), (4, 4), (10, 3), (5, 0)])
def test_blocks_cover_everything_once(n: int, size: int) -> None:
    covered = np.zeros(n, int)

    def work(block: slice) -> None:
        covered[block] += 1

    shares: list[float] = []
    over_blocks(n, size, work, shares.append)
    assert (covered == 1).all()
    assert shares == sorted(shares) and (n > 0) <= len(shares) <= len(blocks(n, size)) + 1
    assert not shares or shares[-1] == 1


def test_at_once_limits_the_blocks_in_work(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("iris_addon.base.parallel.cores", lambda: 3)
    assert set(over_each(range(6), lambda _: threading.get_ident(), at_once=1)) == {threading.get_ident()}
    camera = Camera(width=6000, height=4000, fx=5000.0, fy=5000.0, cx=3000.0, cy=2000.0, c2w=np.eye(4))
    assert photos_at_once([View("large", camera, None)]) == 2 and photos_at_once([]) > 1000


def test_shares_cover_everything_once_in_no_more_blocks_than_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("iris_addon.base.parallel.cores", lambda: 3)
    for n in (0, 1, 3, 10):
        begun: list[int] = []
        covered = np.zeros(n, int)

        def work(block: slice, begun: list[int] = begun, covered: np.ndarray = covered) -> None:
            begun.append(block.start)
            covered[block] += 1

        over_shares(n, work)
        assert (covered == 1).all() and len(begun) <= 3


def test_threads_that_are_busy_elsewhere_keep_nothing_of_work_that_is_done(monkeypatch: pytest.MonkeyPatch) -> None:
    """Calls nest, so that a helper may be busy for minutes while thousands of calls wait for it in vain."""
    monkeypatch.setattr("iris_addon.base.parallel.cores", lambda: 3)
    gate = threading.Event()
    busy = [_helpers().submit(gate.wait) for _ in range(64)]
    try:
        values = np.zeros(8)
        kept = weakref.ref(values)

        def work(rows: slice, values: np.ndarray = values) -> None:
            values[rows] += 1

        over_blocks(8, 1, work)
        assert (values == 1).all()
        del work, values
        assert kept() is None
    finally:
        gate.set()
    assert all(helper.result() for helper in busy)


MEMORY = """
import resource
from iris_addon.base.parallel import aside

def faults():
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    [bytearray(24 << 20) for _ in range(4)]
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before

print(*aside(lambda: [faults(), faults()]).result())
"""


@pytest.mark.skipif(sys.platform != "linux", reason="only GNU's C library is asked to keep memory")
def test_threads_keep_the_memory_of_freed_arrays() -> None:
    """Pages come from the system for the first four arrays and not again for the next four."""
    answer = run([sys.executable, "-c", MEMORY], capture_output=True, text=True, check=True, cwd=ROOT)
    first, second = map(int, answer.stdout.split())
    assert first > 1000 and second < 0.05 * first


def test_random_blocks_do_not_depend_on_the_order_of_execution() -> None:
    def draw(first_waits: bool) -> np.ndarray:
        values = np.empty(64)
        others = threading.Event()

        def work(block: slice, rng: np.random.Generator) -> None:
            if first_waits and block.start == 0:
                others.wait(1)
            values[block] = rng.random(block.stop - block.start)
            if block.start > 0:
                others.set()

        over_random_blocks(64, 16, work, np.random.default_rng(3))
        return values

    assert (draw(first_waits=True) == draw(first_waits=False)).all()
    assert len(np.unique(draw(first_waits=False))) == 64, "no two blocks draw the same numbers"


def test_an_error_in_a_block_is_raised() -> None:
    def work(block: slice) -> None:
        if block.start == 8:
            raise FloatingPointError("a ray is not finite")

    with pytest.raises(FloatingPointError):
        over_blocks(16, 4, work)


def test_a_cancel_drops_the_blocks_that_have_not_begun() -> None:
    begun = []

    def work(block: slice) -> None:
        begun.append(block.start)
        time.sleep(0.001)

    def cancel(share: float) -> None:
        raise Cancelled

    with pytest.raises(Cancelled):
        over_blocks(2000, 1, work, cancel)
    assert len(begun) < 1000


def test_nested_blocks_do_not_deadlock() -> None:
    covered = np.zeros((12, 40), int)

    def outer(block: slice) -> None:
        def inner(columns: slice) -> None:
            covered[block, columns] += 1
            time.sleep(0.0005)

        over_blocks(40, 3, inner)

    over_blocks(12, 1, outer)
    assert (covered == 1).all()


def test_work_aside_returns_raises_and_may_be_abandoned() -> None:
    def fail() -> None:
        raise TimeoutError("of its own")

    go_on = threading.Event()
    started = time.monotonic()
    slow = aside(lambda: go_on.wait(60))
    checks = iter([None, Cancelled()])

    def check() -> None:
        if (wish := next(checks)) is not None:
            raise wish

    assert waited_for(aside(lambda: 7), lambda: None) == 7
    with pytest.raises(TimeoutError, match="of its own"):
        waited_for(aside(fail), lambda: None)
    with pytest.raises(Cancelled):
        waited_for(slow, check)
    assert time.monotonic() - started < 30, "a cancel does not wait for the work"
    go_on.set()


@pytest.mark.parametrize("n", [0, 1, 1000])
def test_the_index_finds_its_keys_and_no_others(n: int) -> None:
    rng = np.random.default_rng(n)
    # All in the upper eighth: neighbouring slots fill up and probing has to walk.
    keys = np.unique(rng.integers(2**64 - 2**61, 2**64, 2 * n, dtype=np.uint64))
    known, foreign = keys[::2], keys[1::2]
    slots = Slots.of(known, np.arange(len(known)))
    assert [number_of(slots, key) for key in known] == list(range(len(known)))
    assert all(number_of(slots, key) == -1 for key in [*foreign, np.uint64(0)])
