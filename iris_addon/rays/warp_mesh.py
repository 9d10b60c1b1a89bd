"""Rays against triangles by NVIDIA Warp, on a GPU. Imported only where it is asked for: the import takes a second.

Warp compiles the kernels below when they first run on a device and keeps them in a folder of its own in the user's
cache (``WARP_CACHE_PATH`` names another). It can run them on one core of the CPU too, as the tests do.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from threading import Lock
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ..base.errors import IrisError

# Warp announces itself and what it compiles on stdout, which belongs to the JSON lines of the worker.
wp.config.log_level = max(wp.config.log_level, wp.LOG_WARNING)
# Precompiled headers do not pay for one module, and some versions of CUDA's compiler write them to the current folder.
wp.set_module_options({"enable_backward": False, "use_precompiled_headers": False})

CHUNK = 1 << 22
"""Rays of one launch, each of which takes 40 bytes of the device."""
_WORKING = Lock()


def prepare(device: str) -> str | None:
    """Start Warp and compile its kernels for ``device``, "cuda" or "cpu".

    Returns:
        None, or what does not work and how to mend it.
    """
    try:
        wp.init()
        if device == "cuda" and not wp.is_cuda_available():
            return "Warp finds no CUDA device; update the driver of the card"
        wp.load_module(__name__, device=device)
        corner = np.eye(3, dtype=np.float32)
        hit = WarpTriangles(corner[None], device).primitives(np.zeros((1, 3), np.float32), corner.sum(0)[None])
    except Exception as error:  # Warp raises plain ones: no folder for its kernels, no compiler, no memory
        return f"Warp does not start ({error}); WARP_CACHE_PATH names a folder that it may write"
    return None if hit[0] == 0 else "Warp misses a triangle on this device; update it or the driver of the card"


class WarpTriangles:
    """The :class:`~iris_addon.rays.engines.Intersector` of triangles (F, 3, 3), float32 metres, none degenerate.

    The tree is built on the CPU for either device, by the surface area heuristic, so that a GPU traverses the tree that
    the tests see.
    """

    chunk, at_once = CHUNK, 1

    def __init__(self, corners: NDArray[np.float32], device: str) -> None:
        self._device = device
        points = np.ascontiguousarray(corners.reshape(-1, 3))
        indices = np.arange(len(points), dtype=np.int32)
        with _device():
            self._mesh = wp.Mesh(
                wp.array(points, dtype=wp.vec3, device=device),
                wp.array(indices, dtype=wp.int32, device=device),
                bvh_constructor="sah",
            )

    def primitives(self, origins: NDArray[np.float32], directions: NDArray[np.float32]) -> NDArray[np.int32]:
        """(n,) triangle of the closest hit, -1 for none."""
        return self._launch(_primitives, (origins, directions), (wp.int32,))[0]

    def closest(
        self, origins: NDArray[np.float32], directions: NDArray[np.float32]
    ) -> tuple[NDArray[np.int32], NDArray[np.float32], NDArray[np.float32]]:
        """Triangle (n,), distance (n,) and barycentric weights (n, 2) of the closest hit."""
        primitive, distance, weights = self._launch(_closest, (origins, directions), (wp.int32, wp.float32, wp.vec2))
        return primitive, distance, weights

    def occluded(
        self, origins: NDArray[np.float32], directions: NDArray[np.float32], lengths: NDArray[np.float32]
    ) -> NDArray[np.bool_]:
        """(n,) whether a triangle lies on each ray within its length."""
        return self._launch(_occluded, (origins, directions, lengths), (wp.uint8,))[0] > 0

    def _launch(self, kernel: Any, rays: tuple[NDArray[np.float32], ...], types: tuple[Any, ...]) -> list[NDArray]:
        """What ``kernel`` finds for ``rays``, arrays of n rows: one array per type, likewise."""
        n, device = len(rays[0]), self._device
        with _device():
            given = [wp.array(x, dtype=wp.vec3 if x.ndim == 2 else wp.float32, device=device) for x in rays]
            found = [wp.zeros(n, dtype=kind, device=device) for kind in types]
            wp.launch(kernel, dim=n, inputs=[self._mesh.id, *given], outputs=found, device=device)
            return [values.numpy() for values in found]


@contextmanager
def _device() -> Iterator[None]:
    """Work with Warp on one thread at a time; what it raises, mostly for want of memory, as an error of ours.

    Threads would share the stream of the device, and nothing says that Warp's own state is safe from them.
    """
    try:
        with _WORKING:
            yield
    except RuntimeError as error:
        fix = "free memory of the card, or solve with --device cpu"
        raise IrisError(f"rays failed on the device ({error})", fix) from error


# ---- Kernels -------------------------------------------------------------------------------------------------------


if TYPE_CHECKING:  # what Warp compiles from the text of a kernel is not what its stubs say of Python
    Vectors = Pairs = Integers = Reals = Flags = Any
else:
    Vectors, Pairs = wp.array[wp.vec3], wp.array[wp.vec2]
    Integers, Reals, Flags = wp.array[wp.int32], wp.array[wp.float32], wp.array[wp.uint8]


@wp.kernel
def _primitives(mesh: wp.uint64, origins: Vectors, directions: Vectors, primitive: Integers) -> None:
    ray = wp.tid()
    hit = wp.mesh_query_ray(mesh, origins[ray], directions[ray], wp.inf)
    primitive[ray] = -1
    if hit.result:
        primitive[ray] = hit.face


@wp.kernel
def _closest(
    mesh: wp.uint64,
    origins: Vectors,
    directions: Vectors,
    primitive: Integers,
    distance: Reals,
    weights: Pairs,
) -> None:
    ray = wp.tid()
    hit = wp.mesh_query_ray(mesh, origins[ray], directions[ray], wp.inf)
    primitive[ray] = -1
    if hit.result:
        primitive[ray] = hit.face
        distance[ray] = hit.t
        weights[ray] = wp.vec2(hit.v, 1.0 - hit.u - hit.v)  # Warp's u and v are weights of the first two corners


@wp.kernel
def _occluded(
    mesh: wp.uint64,
    origins: Vectors,
    directions: Vectors,
    lengths: Reals,
    hidden: Flags,
) -> None:
    ray = wp.tid()
    if wp.mesh_query_ray_anyhit(mesh, origins[ray], directions[ray], lengths[ray]):
        hidden[ray] = wp.uint8(1)
