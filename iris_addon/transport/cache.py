"""Transport cached on disk, under a hash of what it depends on: mesh, regions, patches and sampling."""

from __future__ import annotations

import hashlib
import os
import time
from contextlib import suppress
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..base.errors import IrisError
from ..base.files import user_cache, write_arrays
from ..base.progress import Progress
from ..base.untrusted import read_arrays
from ..config import SolveConfig
from ..rays.sampling import Origins
from ..surface.patches import PatchGrid
from ..surface.traced_room import TracedRoom
from .gather import GatherRays
from .transport import Transport, build_transport

FORMAT = 5
MAX_ENTRIES, MAX_BYTES = 6, 4 << 30
"""Files kept, and bytes of all of them."""
ABANDONED_SECONDS = 3600
"""Age from which on an unfinished file is that of a process that was killed."""


def cache_folder() -> Path:
    """The folder of the cache: $IRIS_CACHE, else the user's cache folder."""
    chosen = os.environ.get("IRIS_CACHE")
    return Path(chosen) if chosen else user_cache()


def cached_transport(room: TracedRoom, config: SolveConfig, rng: np.random.Generator, progress: Progress) -> Transport:
    """The transport of ``room``, read back where the same was traced before.

    Args:
        rng: a generator that follows from ``config.seed``, which stands for it in the key of the cache.
    """
    path = cache_folder() / f"transport-{_key(room, config)}.npz"
    known = _read(path)
    if known is not None:
        with suppress(OSError):  # the cache may be read-only
            os.utime(path)
        return known
    transport = build_transport(room.tracer, room.patches, room.regions.of_face, config.gather_rays, rng, progress)
    try:
        write_arrays(path, _arrays(transport))
    except IrisError as error:
        # A cache that cannot be written costs time in the next run; it must not cost this one.
        progress.update(1.0, f"transport is not cached: {error}")
    with suppress(OSError):  # another solve may prune at the same time
        _prune(path.parent)
    return transport


def _key(room: TracedRoom, config: SolveConfig) -> str:
    tracer, patches = room.tracer, room.patches
    numbers = FORMAT, tracer.engine.name, config.gather_rays, config.seed, len(patches.region), patches.pixels_per_patch
    digest = hashlib.sha256(repr(numbers).encode())
    arrays = tracer.corners, tracer.normals, room.regions.of_face, patches.grid.cell_keys, patches.origins.position
    for array in arrays:
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()[:32]


def _prune(folder: Path) -> None:
    """Keep the entries used last; remove unfinished files of processes that were killed."""
    entries = sorted(folder.glob("transport-*.npz"), key=lambda path: path.stat().st_mtime, reverse=True)
    begun = [path for path in folder.glob(".transport-*.npz") if time.time() - path.stat().st_mtime > ABANDONED_SECONDS]
    total = np.cumsum([path.stat().st_size for path in entries])
    old = [path for k, path in enumerate(entries) if k >= MAX_ENTRIES or (k and total[k] > MAX_BYTES)]
    for path in old + begun:
        path.unlink(missing_ok=True)


_RAYS = ("face", "direction", "distance", "schlick_start", "schlick_end")
_GRID = ("origin", "block_keys", "block_levels", "cell_keys", "cell_patches")


def _arrays(t: Transport) -> dict[str, NDArray]:
    arrays = {"n_seen": np.array(t.n_seen), "target": t.target, "unseen_target": t.unseen_target, "region": t.region}
    for name, origins in (("origins", t.origins), ("unseen_origins", t.unseen_origins)):
        arrays |= {f"{name}.position": origins.position, f"{name}.normal": origins.normal}
    for name, rays in (("rays", t.rays), ("unseen_rays", t.unseen_rays)):
        arrays |= {f"{name}.{field}": getattr(rays, field) for field in _RAYS}
    arrays |= {f"grid.{field}": getattr(t.grid, field) for field in _GRID}
    return {**arrays, "grid.scale": np.array(t.grid.scale)}


def _read(path: Path) -> Transport | None:
    a = read_arrays(path)
    if a is None:
        return None
    try:
        return Transport(
            n_seen=int(a["n_seen"]),
            origins=Origins(a["origins.position"], a["origins.normal"]),
            unseen_origins=Origins(a["unseen_origins.position"], a["unseen_origins.normal"]),
            rays=GatherRays(*(a[f"rays.{field}"] for field in _RAYS)),
            unseen_rays=GatherRays(*(a[f"unseen_rays.{field}"] for field in _RAYS)),
            target=a["target"],
            unseen_target=a["unseen_target"],
            region=a["region"],
            grid=PatchGrid(a["grid.origin"], float(a["grid.scale"]), *(a[f"grid.{field}"] for field in _GRID[1:])),
            kappa=np.zeros(len(a["region"])),
        )
    except (KeyError, ValueError, TypeError):
        # A foreign file: traced again and overwritten.
        return None
