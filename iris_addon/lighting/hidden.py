"""Light whose source no photo shows: surfaces behind a corner that glow, and light from beyond the mesh.

The former are lamps like others, of which photos say nothing. The latter enters the light balance by the gather rays
that escape the mesh, in one of two ways: as further emitters, soft lobes around twelve directions; or as what photos
show through the holes, where these are gaps in a scan of walls that reflect like all others.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, vstack

from ..base.group_by import counts
from ..base.parallel import BLOCK, over_blocks
from ..brdf.diffuse import under_lobe
from ..model.sphere import sh_basis
from ..rays.sampling import Origins
from ..transport.form_factors import with_schlick
from ..transport.gather import ESCAPED, GatherRays
from ..transport.transport import Transport
from .backdrop import Beyond

MIN_SHARE = 2e-3
"""Of the mean hemisphere: light through less of it is not looked for."""
MIN_PIECE_SHARE, MAX_PIECES = 2e-5, 64
"""The same for a surface, which a shade may hide from most of the room, and how many are asked for."""
DIRECTIONAL_SHARE = 0.02
"""From this share of escaping rays on, light from outside may depend on direction."""
LOBE_BANDS = np.repeat([np.pi / 3, np.pi / 6, np.pi / 30], [1, 3, 5])
"""(1 + cos)² / 16 in Legendre polynomials, (4/3 P0 + 2 P1 + 2/3 P2) / 16, each times 4π / (2 l + 1): by the addition
theorem, times the harmonics at a lobe's middle, these are the harmonics of the lobe."""


@dataclass(frozen=True)
class ThroughHoles:
    """Light by the rays that escape, each of which brings what the backdrop shows where it meets it.

    Attributes:
        share: (N, T) share of each patch's rays that end on each texel; ``schlick`` the same times Schlick's S.
        radiance: (T, 3) of the texels.
    """

    share: csr_array
    schlick: csr_array
    radiance: NDArray[np.floating]

    def irradiance(self, kappa: NDArray[np.floating]) -> NDArray[np.float32]:
        """(N, 3) irradiance / pi of surfaces whose lobe has the grazing gain ``kappa`` (N,)."""
        light = self.share @ self.radiance + kappa[:, None] * (self.schlick @ self.radiance)
        return light.astype(np.float32)

    def raised(self, g: float) -> ThroughHoles:
        """The same if radiance is what photos say to the power ``g``."""
        return replace(self, radiance=self.radiance**g)


@dataclass(frozen=True)
class HiddenSources:
    """Sources that no photo shows, and what photos show through holes of the mesh.

    Attributes:
        pieces: faces of each surface that no photo sees and many gather rays meet, most of them first. The search tries
            them as lamps.
        directions: (D, 3) unit middles of the lobes of outside light; D in {0, 1, 12}. How bright each is is unknown to
            the light balance. A single one is the same from everywhere.
        form_factors: (N, D, 2) irradiance / pi of each patch by each lobe, plain and times Schlick's S.
        holes: what escaping rays meet where it is the light from outside, in place of lobes.
    """

    pieces: tuple[NDArray[np.int64], ...]
    directions: NDArray[np.float64]
    form_factors: NDArray[np.float32]
    holes: ThroughHoles | None = None

    def with_directions(self, count: int) -> HiddenSources:
        """The same sources with 0, 1 (constant) or all lobes of outside light, in place of what photos show of it."""
        if count == len(self.directions):
            return replace(self, holes=None)
        outside = self.form_factors.sum(1, keepdims=True)[:, :count]
        return replace(self, directions=np.array([[0.0, 0.0, 1.0]])[:count], form_factors=outside, holes=None)

    def as_shown(self) -> HiddenSources:
        """The same sources with what photos show through the holes in place of lobes."""
        return replace(self.with_directions(0), holes=self.holes)

    def irradiance(self, radiance: NDArray[np.floating], kappa: NDArray[np.floating]) -> NDArray[np.floating]:
        """(N, 3) irradiance / pi from outside, of lobes as bright as ``radiance`` (D, 3) or through holes, at surfaces
        whose lobe has the grazing gain ``kappa`` (N,)."""
        light = under_lobe(self.form_factors, kappa) @ radiance
        return light if self.holes is None else light + self.holes.irradiance(kappa)

    def outside_sh(self, radiance: NDArray[np.floating]) -> NDArray[np.float64] | None:
        """(1, 3) or (9, 3) spherical harmonics of outside light whose lobes are as bright as ``radiance`` (D, 3), None
        without lobes."""
        if len(self.directions) == 0:
            return None
        if len(self.directions) == 1:
            return radiance / sh_basis(np.array([[0.0, 0.0, 1.0]]), 1)
        return (sh_basis(self.directions) * LOBE_BANDS).T @ radiance


def lobes(directions: NDArray[np.floating], middles: NDArray[np.floating]) -> NDArray[np.floating]:
    """(..., D) radiance along unit ``directions`` (..., 3) of lobes of brightness one: (1 + cos)² / 16.

    They are harmonics of order 2 and never negative: the balance is solved with just the light that Cycles is given.
    The faces of a dodecahedron are a spherical design of order 5, so their lobes add up to one in every direction.
    """
    if len(middles) == 1:
        return np.ones((*directions.shape[:-1], 1), directions.dtype)
    return (1 + directions @ middles.T.astype(directions.dtype)) ** 2 / 16


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
    transport: Transport, regions: NDArray[np.int32], pieces: NDArray[np.int32], seen: NDArray[np.bool_]
) -> HiddenSources:
    """Surfaces never seen, and directions of escape, that reach the seen surfaces.

    Args:
        regions: (F,) part of each face.
        pieces: (F,) piece of its region between sharp edges.
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
    return HiddenSources(_unseen_pieces(transport.rays, regions, pieces, seen), directions, np.concatenate(blocks))


def through_holes(transport: Transport, beyond: Beyond) -> ThroughHoles | None:
    """The light of the backdrop of ``beyond`` at all patches; None without one."""
    if beyond.backdrop is None:
        return None
    seen = _share_of_texels(transport.target, transport.origins, transport.rays, beyond)
    unseen = _share_of_texels(transport.unseen_target, transport.unseen_origins, transport.unseen_rays, beyond)
    share, schlick = (csr_array(vstack(both)) for both in zip(seen, unseen, strict=True))
    return ThroughHoles(share, schlick, beyond.radiance)


def _share_of_texels(
    target: NDArray[np.int32], origins: Origins, rays: GatherRays, beyond: Beyond
) -> tuple[csr_array, csr_array]:
    """(rows, T) share of the rays of each row that end on each texel of ``beyond``, and the same times S."""
    row, ray = np.nonzero(target == ESCAPED)
    texel = np.empty(len(row), np.int32)

    def look_up(some: slice) -> None:
        start = origins.position[row[some], ray[some] % origins.position.shape[1]]
        texel[some] = beyond.texels(start, rays.direction[row[some], ray[some]])

    over_blocks(len(row), BLOCK, look_up)
    row, ray, texel = (index[texel >= 0] for index in (row, ray, texel))
    # Rows are in order: what is summed over them need not be sorted first.
    first = np.searchsorted(row, np.arange(len(target) + 1))
    of_each = np.full(len(row), 1 / target.shape[1], np.float32)
    shape = len(target), len(beyond.radiance)
    share = csr_array((of_each, texel, first), shape)
    return share, csr_array((of_each * rays.schlick_start[row, ray], texel, first), shape)


def _unseen_pieces(
    rays: GatherRays, regions: NDArray[np.int32], pieces: NDArray[np.int32], seen: NDArray[np.bool_]
) -> tuple[NDArray[np.int64], ...]:
    """Faces of regions, and of pieces of other regions, that no photo sees and rays of the seen patches meet."""
    seen_region = np.bincount(regions, seen) > 0
    label = np.where(seen_region[regions], len(seen_region) + pieces, regions)
    met = counts(rays.face, len(regions))
    share = np.where(np.bincount(label, seen) > 0, 0.0, np.bincount(label, met)) / rays.face.size
    ids = np.argsort(-share, kind="stable")[:MAX_PIECES]
    return tuple(np.flatnonzero(label == k) for k in ids if share[k] > MIN_PIECE_SHARE)


def _form_factors(
    target: NDArray[np.int32], origins: Origins, rays: GatherRays, directions: NDArray[np.float64]
) -> NDArray[np.float32]:
    """(rows, D, 2) irradiance / pi of each row by the lobes, through the rays that escape."""
    n_rows, n_rays = target.shape
    result = np.zeros((n_rows, len(directions), 2), np.float32)
    if len(directions) == 0:
        return result
    normal = np.arange(n_rays) % origins.normal.shape[1]

    def some(rows: slice) -> None:
        direction = rays.direction[rows].astype(np.float32)
        cosine = np.einsum("prk,prk->pr", origins.normal[rows][:, normal], direction)
        escapes = with_schlick(cosine) * (target[rows] == ESCAPED)[..., None]
        result[rows] = np.moveaxis(lobes(direction, directions), 1, 2) @ escapes / n_rays

    over_blocks(n_rows, BLOCK // n_rays, some)
    return result
