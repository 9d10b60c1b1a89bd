"""Long work in steps, between which Blender may redraw and hear the mouse; a thread does what needs no bpy.

Such work is a generator: it yields wherever it may be interrupted, each time the words for what it is doing, and
returns its result. :func:`finish` runs one to its end at once, for scripts and for Blender without a window. Closing
it, or an exception, undoes what it has made so far. Does not use bpy.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Generator
from concurrent.futures import Future, ThreadPoolExecutor, wait
from queue import Empty, SimpleQueue
from threading import Event
from typing import TypeAlias, TypeVar

from ..base.errors import Cancelled

T = TypeVar("T")
Question = TypeVar("Question")
Answer = TypeVar("Answer")
Steps: TypeAlias = Generator[str, None, T]

WAIT_SECONDS = 0.02
"""For which a step waits for a thread at most."""


def finish(steps: Steps[T]) -> T:
    """Take all ``steps`` and return their result."""
    while True:
        try:
            next(steps)
        except StopIteration as end:
            return end.value


def advance(steps: Steps[object], seconds: float) -> str:
    """Take ``steps`` until ``seconds`` have passed, at least one; returns what they are doing.

    Raises:
        StopIteration: at their end, with the result.
    """
    began = time.monotonic()
    while True:
        doing = next(steps)
        if time.monotonic() - began > seconds:
            return doing


def in_thread(work: Callable[[], T], doing: str) -> Steps[T]:
    """What ``work`` returns, which runs in a thread and so must not use bpy."""
    ended = _started(work)
    while not wait([ended], WAIT_SECONDS).done:
        yield doing
    return ended.result()


def in_thread_asking(
    work: Callable[[Callable[[Question], Answer]], T], answer: Callable[[Question], Answer], doing: str
) -> Steps[T]:
    """What ``work`` returns, which runs in a thread and is given a function that asks the thread of the steps.

    Args:
        answer: called with each question on the thread that takes the steps, so that it may use bpy. Its exceptions are
            raised where the question was asked.
    """
    asked: SimpleQueue[tuple[Question, Future[Answer]]] = SimpleQueue()
    stopped = Event()

    def ask(question: Question) -> Answer:
        reply: Future[Answer] = Future()
        asked.put((question, reply))
        while not wait([reply], WAIT_SECONDS).done:
            if stopped.is_set():
                raise Cancelled
        return reply.result()

    ended = _started(lambda: work(ask))
    try:
        while not ended.done():
            try:
                question, reply = asked.get(timeout=WAIT_SECONDS)
            except Empty:
                yield doing
                continue
            try:
                reply.set_result(answer(question))
            except Exception as error:
                reply.set_exception(error)
            yield doing
    finally:
        stopped.set()
    return ended.result()


def _started(work: Callable[[], T]) -> Future[T]:
    pool = ThreadPoolExecutor(1)
    ended = pool.submit(work)
    pool.shutdown(wait=False)  # the thread ends with its work
    return ended
