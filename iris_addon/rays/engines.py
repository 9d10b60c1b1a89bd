"""What rays run on: Embree on the CPU, or NVIDIA Warp on the GPU where a solve has one and Warp is installed.

An engine makes an :class:`Intersector` of triangles. All that does not depend on it is in
:class:`~iris_addon.rays.tracer.Tracer`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from .embree import EmbreeTriangles


class Intersector(Protocol):
    """Rays against fixed triangles. Called from several threads at once, with float32 arrays that are finite.

    A ray meets both sides of a triangle, and the one in which it starts.
    """

    @property
    def chunk(self) -> int:
        """Most rays of one call."""
        ...

    @property
    def at_once(self) -> int | None:
        """Calls worth making at the same time; None for one per core."""
        ...

    def primitives(self, origins: NDArray[np.float32], directions: NDArray[np.float32]) -> NDArray[np.int32]:
        """(n,) triangle of the closest hit along rays (n, 3), -1 for none."""
        ...

    def closest(
        self, origins: NDArray[np.float32], directions: NDArray[np.float32]
    ) -> tuple[NDArray[np.int32], NDArray[np.float32], NDArray[np.float32]]:
        """The closest hit along rays (n, 3) of unit directions.

        Returns:
            (n,) triangle, -1 for none; (n,) distance in metres, of any value where there is none; (n, 2) barycentric
            weights of the triangle's second and third corner, 0 where there is none.
        """
        ...

    def occluded(
        self, origins: NDArray[np.float32], directions: NDArray[np.float32], lengths: NDArray[np.float32]
    ) -> NDArray[np.bool_]:
        """(n,) whether a triangle lies on each ray (n, 3) within its length (n,), metres."""
        ...


@dataclass(frozen=True)
class RayEngine:
    """What the rays of a solve run on.

    Attributes:
        name: as the report has it. The last digits of a hit depend on the engine, and so does everything that is kept
            on disk under a hash.
        intersector: makes an intersector of triangles (F, 3, 3), float32 metres.
        warning: what a user with a GPU should know, "" for nothing.
    """

    name: str
    intersector: Callable[[NDArray[np.float32]], Intersector]
    warning: str = ""


EMBREE = RayEngine("embree", EmbreeTriangles)


def choose_engine(device: str) -> RayEngine:
    """What rays run on in a solve whose torch runs on ``device``: Warp with "cuda" if it works there, else Embree."""
    return EMBREE if device == "cpu" else warp_engine(device)


def warp_engine(device: str) -> RayEngine:
    """Warp on ``device``, "cuda" or "cpu"; Embree, with a warning that says why, where Warp does not work."""

    def instead(why: str) -> RayEngine:
        return RayEngine(EMBREE.name, EMBREE.intersector, f"rays run on the CPU: {why}")

    try:
        from .warp_mesh import WarpTriangles, prepare
    except Exception as error:  # missing, another version, another package of its name, a library that does not load
        return instead(f"Warp cannot be imported ({error}); install warp-lang 1.19.0 into the solver's Python")
    problem = prepare(device)
    if problem is not None:
        return instead(problem)
    return RayEngine(f"warp-{device}", partial(WarpTriangles, device=device))
