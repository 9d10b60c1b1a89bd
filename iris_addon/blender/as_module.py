"""Blender as a module of another Python: how it is imported safely."""

from __future__ import annotations

import sys
from contextlib import chdir
from pathlib import Path


def import_blender() -> None:
    """Import ``bpy`` in the folder of this program, unless this is Blender or it is there already.

    Its sound library loads every library in a folder ``plugins`` of the current folder, which may be that of a file
    from an untrusted source. Changes the current folder meanwhile, so no other thread may use relative paths.
    """
    if "bpy" not in sys.modules:
        with chdir(Path(__file__).parent):
            import bpy  # noqa: F401 - the modules that use it import it again
