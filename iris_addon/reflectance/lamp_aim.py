"""Rays aimed at lamps, beside those that a lobe reflects.

A wide lobe meets a small lamp with one ray in hundreds, which then stands for all of its light: a matte wall and a
varnished one look alike in such noise. Rays aimed at the lamps always know of them, and are in turn useless for sharp
lobes. Both are weighted by the balance heuristic (Veach 1997, eq. 9.8), as light at patches is
(:mod:`iris_addon.transport.form_factors`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..kernels import Integer, Real, inlined
from ..response.curve import LUMINANCE
from ..transport.form_factors import emitter_of_face
from ..transport.tracer import Tracer


class LampAim(NamedTuple):
    """Where to look for lamps from each of P patches.

    Attributes:
        corners: (F, 3, 3) of the mesh, metres, and ``normals`` (F, 3) float32.
        faces: (K,) faces of all E lamps, one lamp after the other.
        cumulative: (K,) area of ``faces`` up to and with each, square metres.
        end: (E,) of ``cumulative`` at the last face of each lamp.
        area: (E,) square metres.
        label: (F + 1,) lamp of every face, -1 for none; the last entry is that of no face at all.
        chance: (P, E) that a ray is aimed at each lamp: its share of the light there. Rows of patches that no lamp
            lights are zero.
    """

    corners: NDArray[np.floating]
    normals: NDArray[np.float32]
    faces: NDArray[np.int64]
    cumulative: NDArray[np.float64]
    end: NDArray[np.float64]
    area: NDArray[np.float64]
    label: NDArray[np.int64]
    chance: NDArray[np.float32]

    @staticmethod
    def at(
        tracer: Tracer,
        emitters: Sequence[NDArray[np.integer]],
        radiance: NDArray[np.floating],
        form_factors: NDArray[np.floating],
    ) -> LampAim:
        """Aim by what lamps of ``radiance`` (E, 3) with ``form_factors`` (P, E) send."""
        power = form_factors * np.maximum(radiance @ LUMINANCE, 0.0)
        faces = np.concatenate([np.zeros(0, np.int64), *emitters]).astype(np.int64)
        cumulative = np.cumsum(tracer.areas[faces], dtype=np.float64)
        end = cumulative[np.cumsum([len(piece) for piece in emitters], dtype=np.int64) - 1]
        return LampAim(
            tracer.corners,
            tracer.normals,
            faces,
            cumulative,
            end,
            np.diff(end, prepend=0.0),
            emitter_of_face(emitters, len(tracer.areas)),
            (power / np.maximum(power.sum(1, keepdims=True), 1e-12)).astype(np.float32),
        )

    @staticmethod
    def nowhere(tracer: Tracer) -> LampAim:
        """Of a room without lamps, or where lobes are to find them all."""
        return LampAim.at(tracer, [], np.zeros((0, 3)), np.zeros((0, 0), np.float32))


@inlined
def lamp_after(aim: LampAim, patch: Integer, chosen: Real) -> Integer:
    """Lamp that a number in [0, 1) chooses from ``patch``, -1 if no lamp lights it."""
    last, total = -1, 0.0
    for lamp in range(len(aim.area)):
        total += aim.chance[patch, lamp]
    upto = 0.0
    for lamp in range(len(aim.area)):
        if aim.chance[patch, lamp] > 0:
            last = lamp
            upto += aim.chance[patch, lamp]
            if chosen * total < upto:
                break
    return last


@inlined
def point_on_lamp(aim: LampAim, lamp: Integer, along: Real, u: Real, v: Real) -> tuple[Integer, Real, Real, Real]:
    """Face and place of a point spread evenly over a lamp, from three numbers in [0, 1)."""
    area = aim.end[lamp] - aim.area[lamp] * along
    face = aim.faces[min(np.searchsorted(aim.cumulative, area), len(aim.faces) - 1)]
    if u + v > 1:
        u, v = 1 - u, 1 - v
    c, w = aim.corners, 1 - u - v
    return (
        face,
        w * c[face, 0, 0] + u * c[face, 1, 0] + v * c[face, 2, 0],
        w * c[face, 0, 1] + u * c[face, 1, 1] + v * c[face, 2, 1],
        w * c[face, 0, 2] + u * c[face, 1, 2] + v * c[face, 2, 2],
    )


@inlined
def aimed_density(aim: LampAim, patch: Integer, lamp: Integer, distance: Real, cosine: Real) -> Real:
    """Probability per steradian with which a ray from ``patch`` is aimed at a point of ``lamp``, which lies
    ``distance`` metres away and whose normal has ``cosine`` to the ray, either sign."""
    return aim.chance[patch, lamp] / aim.area[lamp] * distance * distance / max(abs(cosine), 1e-6)
