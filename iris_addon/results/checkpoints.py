"""Finished stages on disk, so that a solve that was stopped goes on where it was.

A stage's file holds plain arrays and is only believed if it was written by the same solve: same photos, poses, mesh,
settings and version of the format. Files appear whole or not at all.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

import numpy as np
from filelock import FileLock, Timeout
from numpy.typing import NDArray

from ..base.errors import BadInput, IrisError
from ..base.files import abandoned, is_own_folder, read_arrays, write_arrays
from ..config import SolveConfig
from ..model.capture import Capture
from .files import KINDS, preview_path

FORMAT = 5
Stage = Literal["response", "lights", "materials"]
Arrays = Mapping[str, NDArray]


def fingerprint(capture: Capture, config: SolveConfig) -> str:
    """Hash of everything a solve depends on; files by name, size and time of change."""
    digest = hashlib.sha256(repr((FORMAT, config)).encode())
    mesh = capture.mesh
    for array in (mesh.vertices, mesh.faces, mesh.uv, mesh.regions):
        digest.update(b"none" if array is None else repr(array.shape).encode() + np.ascontiguousarray(array).tobytes())
    for view in capture.views:
        camera = view.camera
        lens = (camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy, view.distortion)
        digest.update(repr((view.name, view.exposure, lens)).encode())
        digest.update(camera.c2w.tobytes())
    files = [view.photo for view in capture.views] + [config.response, config.emitters]
    for path in files:
        if isinstance(path, Path) and path.is_file():
            stat = path.stat()
            digest.update(repr((str(path), stat.st_size, stat.st_mtime_ns)).encode())
    return digest.hexdigest()


@dataclass(frozen=True)
class Checkpoints:
    """Stage files of one solve in ``folder``.

    Attributes:
        key: fingerprint of the solve.
        resume: whether files of an earlier run may be used.
    """

    folder: Path
    key: str
    resume: bool

    def stage(self, name: Stage, compute: Callable[[], Arrays]) -> dict[str, NDArray]:
        """The arrays of stage ``name``: read back if the stage was finished before, else computed and written."""
        path = self.folder / f"{name}.npz"
        if self.resume:
            known = self._read(path)
            if known is not None:
                return known
        arrays = dict(compute())
        write_arrays(path, {"key": np.array(self.key), **arrays})
        # What the next stage sees must not depend on whether this run was resumed.
        return arrays

    def clear(self) -> None:
        """Remove the stage files and the previews beside them: the result stands."""
        if not is_own_folder(self.folder):  # a link that came with the result of somebody else
            return
        stages = [self.folder / f"{name}.npz" for name in get_args(Stage)]
        for path in (*stages, *(preview_path(self.folder.parent, kind) for kind in KINDS)):
            for mine in (path, *abandoned(path)):
                mine.unlink(missing_ok=True)
        if not any(self.folder.iterdir()):
            self.folder.rmdir()

    def _read(self, path: Path) -> dict[str, NDArray] | None:
        arrays = read_arrays(path)
        if arrays is None or str(arrays.pop("key", None)) != self.key:
            return None
        return arrays


# ---- One solve per folder: a second one, of another Blender or another shell, is told so and mixes no files in ------


LOCK = ".lock"


@contextmanager
def sole_writer(folder: Path) -> Iterator[None]:
    """Hold ``folder`` for this process, which makes it where it is missing.

    The system lets go of the lock when the process ends, however it ends. The empty file stays: to remove it would let
    in two who wait for it.

    Raises:
        BadInput: another process holds it.
        IrisError: it cannot be made or written.
    """
    lock = FileLock(folder / LOCK)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock.acquire(timeout=0)
    except Timeout as error:
        fix = "wait until it is done, cancel it, or choose another folder"
        raise BadInput("is being solved by another program", fix, folder) from error
    except OSError as error:
        message = f"cannot be written ({error.strerror or error})"
        raise IrisError(message, "check the folder and its permissions", folder) from error
    try:
        yield
    finally:
        lock.release()
