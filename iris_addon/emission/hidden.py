"""Light whose source no photo shows: surfaces behind a corner that glow, and light from beyond the mesh.

The former are lamps like others, of which photos say nothing. The latter enters the light balance as further emitters,
directions in which rays escape the mesh, with form factors read off the gather rays.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..grouping import counts
from ..result.sh import fit_sh, sh_basis
from ..transport.form_factors import with_schlick
from ..transport.gather import GatherRays, Origins
from ..transport.patch_hits import ESCAPED
from ..transport.sampling import dot
from ..transport.transport import Transport

MIN_SHARE = 2e-3
"""Of the mean hemisphere: light through less of it is not looked for."""
MIN_PIECE_SHARE, MAX_PIECES = 2e-5, 64
"""The same for a surface, which a shade may hide from most of the room, and how many are asked for."""
DIRECTIONAL_SHARE = 0.02
"""From this share of escaping rays on, light from outside may depend on direction."""


@dataclass(frozen=True)
class HiddenSources:
    """Sources that no photo shows.

    Attributes:
        pieces: faces of each surface that no photo sees and many gather rays meet, most of them first. The search tries
            them as lamps.
        directions: (D, 3) unit centres of the direction bins of outside light; D in {0, 1, 12}. Their radiance is an
            unknown of the light balance.
        form_factors: (N, D, 2) share of each patch's hemisphere, plain and times Schlick's S.
    """

    pieces: tuple[NDArray[np.int64], ...]
    directions: NDArray[np.float64]
    form_factors: NDArray[np.float32]

    def with_directions(self, count: int) -> HiddenSources:
        """The same sources with 0, 1 (constant) or all direction bins of outside light."""
        if count == len(self.directions):
            return self
        outside = self.form_factors.sum(1, keepdims=True)[:, :count]
        return replace(self, directions=np.array([[0.0, 0.0, 1.0]])[:count], form_factors=outside)

    def outside_sh(self, radiance: NDArray[np.floating]) -> NDArray[np.float64] | None:
        """(1, 3) or (9, 3) spherical harmonics of the outside radiance (D, 3) per bin, None without bins."""
        if len(self.directions) == 0:
            return None
        if len(self.directions) == 1:
            return radiance / sh_basis(np.array([[0.0, 0.0, 1.0]]), 1)
        # Twelve bins and nine functions: few rays escape through some of them.
        return fit_sh(self.directions, radiance, np.ones(len(radiance)), ridge=0.05)


def dodecahedron() -> NDArray[np.float64]:
    """(12, 3) unit normals of a dodecahedron's faces: evenly spread directions."""
    golden = (1 + 5**0.5) / 2
    corners = [(0, s, t * golden) for s in (-1, 1) for t in (-1, 1)]
    points = np.array([np.roll(c, k) for c in corners for k in range(3)])
    return points / np.linalg.norm(points[0])


def nothing_hidden(transport: Transport) -> HiddenSources:
    """No light but that of surfaces the photos show."""
    return HiddenSources((), np.zeros((0, 3)), np.zeros((transport.n_patches, 0, 2), np.float32))


def find_hidden(
    transport: Transport, parts: NDArray[np.int32], pieces: NDArray[np.int32], seen: NDArray[np.bool_]
) -> HiddenSources:
    """Surfaces never seen, and directions of escape, that reach the seen surfaces.

    Args:
        parts: (F,) part of each face.
        pieces: (F,) piece of its part between sharp edges.
        seen: (F,) faces that a photo shows.
    """
    escaped = float((transport.target == ESCAPED).mean())
    directions = np.zeros((0, 3))
    if escaped > MIN_SHARE:
        directions = dodecahedron() if escaped > DIRECTIONAL_SHARE else np.array([[0.0, 0.0, 1.0]])
    blocks = [
        _form_factors(target, origins, rays, directions)
        for target, origins, rays in (
            (transport.target, transport.origins, transport.rays),
            (transport.unseen_target, transport.unseen_origins, transport.unseen_rays),
        )
    ]
    return HiddenSources(_unseen_pieces(transport.rays, parts, pieces, seen), directions, np.concatenate(blocks))


def _unseen_pieces(
    rays: GatherRays, parts: NDArray[np.int32], pieces: NDArray[np.int32], seen: NDArray[np.bool_]
) -> tuple[NDArray[np.int64], ...]:
    """Faces of parts, and of pieces of other parts, that no photo sees and rays of the seen patches meet."""
    seen_part = np.bincount(parts, seen) > 0
    label = np.where(seen_part[parts], len(seen_part) + pieces, parts)
    met = counts(rays.face, len(parts))
    share = np.where(np.bincount(label, seen) > 0, 0.0, np.bincount(label, met)) / rays.face.size
    ids = np.argsort(-share, kind="stable")[:MAX_PIECES]
    return tuple(np.flatnonzero(label == k) for k in ids if share[k] > MIN_PIECE_SHARE)


def _form_factors(
    target: NDArray[np.int32], origins: Origins, rays: GatherRays, directions: NDArray[np.float64]
) -> NDArray[np.float32]:
    """(rows, D, 2) share of each row's rays that leave in a direction's bin."""
    n_rows, n_rays = target.shape
    result = np.zeros((n_rows, len(directions), 2), np.float32)
    if len(directions) == 0:
        return result
    row, column = np.nonzero(target == ESCAPED)
    direction = rays.direction[row, column].astype(np.float32)
    cosine = dot(origins.normal[row, column % origins.normal.shape[1]], direction)
    bins = (direction @ directions.T.astype(np.float32)).argmax(1)
    np.add.at(result, (row, bins), with_schlick(cosine) / n_rays)
    return result
