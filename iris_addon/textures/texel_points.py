"""The surface under the texels of an atlas."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from ..rays.tracer import Tracer, points_on_faces
from .atlas import covered_texels, plane_areas, texel_index


@dataclass(frozen=True)
class TexelPoints:
    """One surface point for each of T texels.

    Attributes:
        texel: (T,) int64 flat index in the atlas, ascending.
        face: (T,) int32.
        position: (T, 3) float32 metres.
        normal: (T, 3) float32 unit, of the face.
        size: (T,) float32 metres, side of the texel on the surface.
    """

    texel: NDArray[np.int64]
    face: NDArray[np.int32]
    position: NDArray[np.float32]
    normal: NDArray[np.float32]
    size: NDArray[np.float32]

    @staticmethod
    def of(tracer: Tracer, uv: NDArray[np.floating], size: int) -> TexelPoints:
        """The points of all texels whose centre lies on a face, and one of each face that covers no texel's centre.

        Args:
            tracer: of the mesh.
            uv: (F, 3, 2) per corner.
            size: side of the atlas in texels.
        """
        covered = covered_texels(uv, size)
        shown = np.bincount(covered.face, minlength=len(uv)) > 0
        missed = np.flatnonzero(~shown & (tracer.areas > 0)).astype(np.int32)
        middle = np.full((len(missed), 2), 1 / 3, np.float32)
        texel = np.concatenate([covered.texel, texel_index(uv, missed, middle, size)])
        face, barycentric = np.concatenate([covered.face, missed]), np.concatenate([covered.barycentric, middle])
        order = np.argsort(texel, kind="stable")  # of several faces, the first: those that cover its centre
        order = order[np.concatenate([[True], texel[order][1:] != texel[order][:-1]])] if len(order) else order
        face, barycentric = face[order], barycentric[order]
        side = np.sqrt(tracer.areas / np.maximum(plane_areas(uv), 1e-12)) / size
        return TexelPoints(
            texel=texel[order],
            face=face,
            position=points_on_faces(tracer.corners, face, barycentric).astype(np.float32),
            normal=tracer.normals[face],
            size=side[face].astype(np.float32),
        )

    def take(self, rows: NDArray[np.integer]) -> TexelPoints:
        """Some of the points."""
        return TexelPoints(*(getattr(self, column.name)[rows] for column in fields(self)))
