"""Files that Blender writes itself, whole or not at all."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from pathlib import Path

from ..errors import IrisError


def write_whole(path: Path, write: Callable[[Path], object]) -> None:
    """Let ``write`` make a file (and what lies beside it, textures) in a folder of its own, then move it to ``path``.

    Raises:
        IrisError: it cannot be written.
    """
    path = Path(path).absolute()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=".iris-", dir=path.parent) as folder:
            write(Path(folder) / path.name)
            made = sorted(thing for thing in Path(folder).rglob("*") if thing.is_file())
            for thing in sorted(made, key=lambda thing: thing.name == path.name):  # the file itself last
                target = path.parent / thing.relative_to(folder)
                target.parent.mkdir(exist_ok=True)
                os.replace(thing, target)
    except (RuntimeError, OSError) as error:
        what = f"cannot be written ({str(error).strip()})"
        raise IrisError(what, "free disk space or choose another place", path) from error
