"""Checkpoints of a solve in its result folder, which one process at a time writes.

A solve that was stopped resumes after its last finished stage. The file of a stage holds plain arrays and is used only
if the same solve wrote it: same photos, poses, mesh, settings and version of the format. The size of textures alone may
differ: lights and materials do not depend on it, and tables of texels say theirs. Files appear whole or not at all.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, get_args

import numpy as np
from filelock import FileLock, Timeout
from numpy.typing import NDArray

from ..base.errors import BadInput, IrisError
from ..base.files import atomic_write, is_own_file, is_own_folder, remove_abandoned, require_only_name, write_arrays
from ..base.untrusted import read_arrays
from ..config import SolveConfig
from ..model.capture import Capture
from .files import PREVIEWS, preview_path

FORMAT = 16
"""Version of the format of checkpoints, and of what stages decide: no result is to mix two rules."""
LOCK = ".lock"
"""Name of the lock file in a result folder."""
Stage = Literal["response", "lights", "materials"]
Arrays = Mapping[str, NDArray]


def fingerprint(capture: Capture, config: SolveConfig, engine: str) -> str:
    """Hash of everything that lights and materials depend on; files by name, size and modification time.

    They do not depend on the size of textures, which names the tables instead. ``engine`` names what rays run on.
    """
    light = replace(config, atlas_size="auto", texels_per_metre="auto", max_atlas_size=0)
    digest = hashlib.sha256(repr((FORMAT, engine, light)).encode())
    mesh = capture.mesh
    for array in (mesh.vertices, mesh.faces, mesh.uv, mesh.regions):
        digest.update(b"none" if array is None else repr(array.shape).encode() + np.ascontiguousarray(array).tobytes())
    for view in capture.views:
        camera = view.camera
        lens = (camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy, view.distortion)
        digest.update(repr((view.name, view.exposure, view.device, view.light_state, lens)).encode())
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
        texels: which texels the tables are about.
    """

    folder: Path
    key: str
    resume: bool
    texels: str = ""

    def stage(self, name: Stage, compute: Callable[[], Arrays]) -> dict[str, NDArray]:
        """The arrays of stage ``name``: read back if the stage was finished before, else computed and written."""
        path = self.folder / f"{name}.npz"
        if self.resume:
            known = self._read(path)
            if known is not None:
                return known
        arrays = dict(compute())
        write_arrays(path, {"key": np.array(self.key), **arrays})
        # The arrays are returned, not what they were made from: later stages must not depend on a resumed run.
        return arrays

    def table(self, name: str, compute: Callable[[], NDArray]) -> NDArray:
        """A table (rows of plain fields) that stays on disk and is read where it is used.

        It is read back if the same solve has written it before and may be resumed.
        """
        path = self._table_path(name)
        known = _mapped(path) if self.resume else None
        if known is None:
            table = compute()
            atomic_write(path, lambda temporary: np.save(temporary, table, allow_pickle=False))
            known = _mapped(path)
        if known is None:
            raise IrisError("cannot be read back", "check the folder and its disk", path)
        return known

    def _table_path(self, name: str) -> Path:
        return self.folder / f"{name}.{self.key[:16]}{self.texels and '.'}{self.texels}.npy"

    def clear(self) -> None:
        """Remove the stage files and the previews beside them, once the result is saved."""
        if not is_own_folder(self.folder):  # a link in a result from elsewhere
            return
        stages = [self.folder / f"{name}.npz" for name in get_args(Stage)]
        tables = self.folder.glob("*.npy")  # also of other solves, and half-written ones
        for path in (*stages, *tables, *(preview_path(self.folder.parent, kind) for kind in PREVIEWS)):
            path.unlink(missing_ok=True)
        remove_abandoned(self.folder, 0.0)  # whoever holds the lock of the folder above is the only writer
        if not any(self.folder.iterdir()):
            self.folder.rmdir()

    def _read(self, path: Path) -> dict[str, NDArray] | None:
        arrays = read_arrays(path)
        if arrays is None or str(arrays.pop("key", None)) != self.key:
            return None
        return arrays


def _mapped(path: Path) -> NDArray | None:
    """The table in a file, mapped into memory; None where it is missing or damaged."""
    if not is_own_file(path):  # a pipe would block
        return None
    try:
        table = np.load(path, mmap_mode="r", allow_pickle=False)
    except ValueError:  # damaged, or without rows, which cannot be mapped
        try:
            table = np.load(path, allow_pickle=False)
        except Exception:  # whatever a damaged file makes numpy raise, the table is made again
            return None
    except Exception:
        return None
    return table if isinstance(table, np.ndarray) else None


# ---- one solve per folder ------------------------------------------------------------------------------------------


@contextmanager
def sole_writer(folder: Path) -> Iterator[None]:
    """Lock ``folder``, made if it is missing, for this process, so that no other Blender or shell can solve into it.

    The system releases the lock when the process ends, however it ends. The empty lock file stays: removing it would
    let two waiting processes in.

    Raises:
        BadInput: another process holds it, or it is no file of its own.
        IrisError: it cannot be made or written.
    """
    lock = FileLock(folder / LOCK)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        require_only_name(folder / LOCK)  # the lock empties the file that it opens
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
