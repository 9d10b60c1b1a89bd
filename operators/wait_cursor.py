"""The mouse pointer that asks to wait, for work that takes seconds and cannot be told how far it is."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import bpy


@contextmanager
def wait_cursor(context: bpy.types.Context) -> Iterator[None]:
    """Inside, the pointer over the window of ``context`` is that of waiting; nothing happens in background."""
    if context.window is not None:
        context.window.cursor_set("WAIT")
    try:
        yield
    finally:
        if context.window is not None:
            context.window.cursor_set("DEFAULT")
