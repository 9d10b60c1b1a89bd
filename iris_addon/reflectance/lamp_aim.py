"""Rays aimed at lamps, beside those that a lobe reflects.

A wide lobe meets a small lamp with one ray in hundreds, which then stands for all of its light: a matte wall and a
varnished one look alike in such noise. Rays aimed at the lamps always know of them, and are in turn useless for sharp
lobes. Both are weighted by the balance heuristic (Veach 1997, eq. 9.8), as light at patches is
(:mod:`iris_addon.transport.gather`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..response.curve import LUMINANCE
from ..transport.gather import emitter_of_face
from ..transport.sampling import dot
from ..transport.tracer import Hits, Tracer


@dataclass(frozen=True)
class LampAim:
    """Where to look for lamps from each of P patches.

    Attributes:
        tracer: of the mesh.
        faces: (K,) faces of all E lamps, one lamp after the other.
        cumulative: (K,) area of ``faces`` up to and with each, square metres.
        end: (E,) of ``cumulative`` at the last face of each lamp.
        label: (F + 1,) lamp of every face, -1 for none; the last entry is that of no face at all.
        chance: (P, E) that a ray is aimed at each lamp: its share of the light there. Rows of patches that no lamp
            lights are zero.
    """

    tracer: Tracer
    faces: NDArray[np.int64]
    cumulative: NDArray[np.float64]
    end: NDArray[np.float64]
    label: NDArray[np.int64]
    chance: NDArray[np.float32]

    @staticmethod
    def at(
        tracer: Tracer,
        emitters: Sequence[NDArray[np.integer]],
        radiance: NDArray[np.floating],
        form_factors: NDArray[np.floating],
    ) -> LampAim | None:
        """Aim by what lamps of ``radiance`` (E, 3) with ``form_factors`` (P, E) send; None without a lamp."""
        if not len(emitters):
            return None
        power = form_factors * np.maximum(radiance @ LUMINANCE, 0.0)
        faces = np.concatenate(emitters).astype(np.int64)
        cumulative = np.cumsum(tracer.areas[faces], dtype=np.float64)
        return LampAim(
            tracer,
            faces,
            cumulative,
            cumulative[np.cumsum([len(piece) for piece in emitters]) - 1],
            emitter_of_face(emitters, len(tracer.areas)),
            (power / np.maximum(power.sum(1, keepdims=True), 1e-12)).astype(np.float32),
        )

    def points(
        self, patch: NDArray[np.integer], n_rays: int, rng: np.random.Generator
    ) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
        """Points on lamps to aim at from ``patch`` (n,): (n · n_rays, 3) metres, and the face that each lies on, -1 for
        patches that no lamp lights."""
        n = len(patch)
        share = np.cumsum(self.chance[patch], axis=1)
        strata = (np.arange(n_rays) + rng.random((n, n_rays), np.float32)) / n_rays * share[:, -1:]
        lamp = np.minimum((strata[..., None] >= share[:, None]).sum(-1), len(self.end) - 1).ravel()
        area = self._areas[lamp]
        along = self.end[lamp] - area * rng.random(n * n_rays)
        face = self.faces[np.minimum(np.searchsorted(self.cumulative, along), len(self.faces) - 1)]
        u = rng.random((n * n_rays, 2), np.float32)
        fold = u.sum(1) > 1
        u[fold] = 1 - u[fold]
        corner, second, third = self.tracer.corners[face].astype(np.float32).transpose(1, 0, 2)
        point = corner + u[:, :1] * (second - corner) + u[:, 1:] * (third - corner)
        return point, np.where(np.repeat(share[:, -1] > 0, n_rays), face, -1)

    def density(self, patch: NDArray[np.integer], hits: Hits, direction: NDArray[np.floating]) -> NDArray[np.float64]:
        """(n,) probability per steradian with which one ray is aimed at what rays from ``patch`` (n,) hit; zero where
        that is no lamp."""
        lamp = self.label[hits.face]
        on = np.flatnonzero(lamp >= 0)
        density = np.zeros(len(lamp))
        cosine = np.abs(dot(self.tracer.normals[hits.face[on]], direction[on]))
        per_area = self.chance[patch[on], lamp[on]] / self._areas[lamp[on]]
        density[on] = per_area * hits.distance[on] ** 2 / np.maximum(cosine, 1e-6)
        return density

    @property
    def _areas(self) -> NDArray[np.float64]:
        """(E,) square metres of each lamp."""
        return np.diff(self.end, prepend=0.0)
