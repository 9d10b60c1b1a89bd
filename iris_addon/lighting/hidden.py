"""Light whose source no photo shows: hidden emitters inside the mesh, and light from outside it.

Hidden emitters are lamps like others, on which photos give no evidence. Light from outside enters the light balance by
the rays that escape the mesh, in one of two ways: as further emitters, soft lobes around twelve directions,
equation (21); or as the radiance that photos show through the holes, where these are gaps in a scan of walls. Parts of
the backdrop that no photo shows are then further emitters where the light balance asks for them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, vstack

from ..base.group_by import counts, group_sums
from ..base.parallel import BLOCK, over_blocks, over_random_blocks
from ..brdf.diffuse import under_lobe
from ..model.sphere import dodecahedron, sh_basis
from ..rays.sampling import Origins
from ..rays.tracer import Tracer
from ..transport.form_factors import with_schlick
from ..transport.gather import ESCAPED, GatherRays
from ..transport.openings import AIMED_RAYS, Openings
from ..transport.transport import Transport
from .backdrop import SeenBackdrop
from .sun import Sun

OUTSIDE_MIN_SHARE = 2e-3
"""Share of the gather rays that must escape for light from outside to be considered."""
SURFACE_MIN_SHARE, SURFACE_MAX_COUNT = 2e-5, 64
"""Share of the gather rays that must meet an unseen surface for it to be tried as a lamp, low because a shade hides a
lamp from most of the room; and the number of such surfaces at most."""
OUTSIDE_AIMED_MAX_SHARE = 0.8
"""Share of escaping rays up to which rays are aimed at the openings; where nearly all rays escape, these know the light
without noise."""
OUTSIDE_DIRECTIONAL_SHARE = 0.02
"""Share of escaping rays above which light from outside may depend on direction."""
LOBE_BANDS = np.repeat([np.pi / 3, np.pi / 6, np.pi / 30], [1, 3, 5])
"""Factor per spherical harmonic, (9,), that turns the harmonics at the centre of a lobe into those of the lobe.

A lobe is (1 + cos)² / 16 = (4/3 P0 + 2 P1 + 2/3 P2) / 16 in Legendre polynomials. By the addition theorem each
coefficient is multiplied by 4π / (2 l + 1)."""


@dataclass(frozen=True)
class ThroughHoles:
    """Light that escaping rays bring: each the radiance of the texel of the backdrop that it meets.

    Attributes:
        share: (N, T) share of each patch's rays that end on each texel.
        schlick: (N, T) the same times Schlick's S.
        radiance: (T, 3) of the texels, scene-linear Rec.709.
        unseen: (T,) part that each texel lies in which no photo shows, -1 where one does.
    """

    share: csr_array
    schlick: csr_array
    radiance: NDArray[np.floating]
    unseen: NDArray[np.integer]

    def irradiance(self, kappa: NDArray[np.floating]) -> NDArray[np.float32]:
        """(N, 3) irradiance / pi of surfaces whose lobe has the grazing gain ``kappa`` (N,)."""
        light = self.share @ self.radiance + kappa[:, None] * (self.schlick @ self.radiance)
        return light.astype(np.float32)

    def raised(self, g: float) -> ThroughHoles:
        """The same with all radiance raised to the power ``g``."""
        return replace(self, radiance=self.radiance**g)

    def shown(self) -> ThroughHoles:
        """The same without the light of what no photo shows."""
        return replace(self, radiance=np.where(self.unseen[:, None] < 0, self.radiance, 0))

    def form_factors_of_unseen(self) -> NDArray[np.float32]:
        """(N, K, 2) irradiance / pi of each patch by each part that no photo shows, plain and times Schlick's S."""
        part = (self.unseen[:, None] == np.arange(self.unseen.max(initial=-1) + 1)).astype(np.float32)
        return np.stack([self.share @ part, self.schlick @ part], -1)


class OutsideKind(NamedTuple):
    """How light from outside the mesh is modelled.

    Attributes:
        directions: number of lobes.
        shown: whether it is the radiance that photos show through the holes, in place of lobes.
        unseen: whether that of parts of the backdrop which no photo shows is unknown.
    """

    directions: int
    shown: bool = False
    unseen: bool = False


@dataclass(frozen=True)
class HiddenSources:
    """Sources that no photo shows, and what photos show through holes of the mesh.

    Attributes:
        surfaces: faces of each surface that no photo sees and many gather rays meet, in descending order of these rays.
            The search tries them as lamps.
        directions: (D, 3) unit vectors to the centres of the lobes of outside light, D in {0, 1, 12}. A single lobe is
            constant over the sphere. The radiance of each lobe is an unknown of the light balance.
        form_factors: (N, D, 2) irradiance / pi of each patch by each lobe, plain and times Schlick's S; (N, K, 2) by
            each part of the backdrop that no photo shows, where these are unknowns in place of lobes.
        holes: light through holes in place of lobes, None where lobes are used.
        sun: parallel light through openings, beside lobes or light through holes; its irradiance is an unknown too.
    """

    surfaces: tuple[NDArray[np.int64], ...]
    directions: NDArray[np.float64]
    form_factors: NDArray[np.float32]
    holes: ThroughHoles | None = None
    sun: Sun | None = None

    @property
    def columns(self) -> NDArray[np.float32]:
        """(N, H, 2) irradiance / pi of each patch by each unknown: lobes or parts, then the sun if there is one."""
        return self.form_factors if self.sun is None else np.concatenate([self.form_factors, self.sun.form_factors], 1)

    def start(self, outside: NDArray[np.floating], sunlight: NDArray[np.floating] | None = None) -> NDArray[np.float64]:
        """(H, 3) unknowns to start from: lobes or parts of radiance ``outside`` (3,), and the sun's irradiance, by
        default as its search knows it."""
        lobes = np.tile(outside, (self.form_factors.shape[1], 1))
        if self.sun is None:
            return lobes
        return np.concatenate([lobes, (self.sun.irradiance if sunlight is None else sunlight)[None]])

    def sunlight(self, radiance: NDArray[np.floating], kappa: NDArray[np.floating]) -> NDArray[np.floating]:
        """(N, 3) irradiance / pi by the sun alone, of the unknowns ``radiance`` (H, 3); 0 without one."""
        if self.sun is None:
            return np.zeros((len(kappa), 3), np.float32)
        return under_lobe(self.sun.form_factors, kappa) @ radiance[-1:]

    @property
    def kind(self) -> OutsideKind:
        """How light from outside is modelled."""
        shown = self.holes is not None
        return OutsideKind(len(self.directions), shown, shown and self.form_factors.shape[1] > 0)

    def of_kind(self, kind: OutsideKind) -> HiddenSources:
        """The same sources, all lobes and light through holes among them, with light from outside of that ``kind``."""
        return self.as_shown(kind.unseen) if kind.shown else self.with_directions(kind.directions)

    def with_directions(self, count: int) -> HiddenSources:
        """The same sources with 0, 1 (constant) or all lobes of outside light, and none through holes."""
        if count == len(self.directions):
            return replace(self, holes=None)
        outside = self.form_factors.sum(1, keepdims=True)[:, :count]
        return replace(self, directions=np.array([[0.0, 0.0, 1.0]])[:count], form_factors=outside, holes=None)

    def as_shown(self, unseen: bool = False) -> HiddenSources:
        """The same sources with the light that photos show through the holes in place of lobes.

        Args:
            unseen: whether the light of what no photo shows is unknown, in place of that of its surroundings.
        """
        if not unseen or self.holes is None:
            return replace(self.with_directions(0), holes=self.holes)
        factors = self.holes.form_factors_of_unseen()
        return replace(self, directions=np.zeros((0, 3)), form_factors=factors, holes=self.holes.shown())

    def completed(self, backdrop: SeenBackdrop, radiance: NDArray[np.floating]) -> SeenBackdrop:
        """``backdrop`` under the unknowns ``radiance`` (H, 3), of which those of its unseen parts come first."""
        parts = 0 if self.holes is None else self.form_factors.shape[1]
        return backdrop.with_unseen(radiance[:parts]) if parts else backdrop

    def irradiance(self, radiance: NDArray[np.floating], kappa: NDArray[np.floating]) -> NDArray[np.floating]:
        """(N, 3) irradiance / pi from outside, by lobes or through holes, and by the sun.

        Args:
            radiance: (H, 3) of the lobes, and the sun's irradiance.
            kappa: (N,) grazing gain of each patch's diffuse lobe.
        """
        light = under_lobe(self.columns, kappa) @ radiance
        return light if self.holes is None else light + self.holes.irradiance(kappa)

    def outside_sh(self, radiance: NDArray[np.floating]) -> NDArray[np.float64] | None:
        """(1, 3) or (9, 3) spherical harmonics of lobes of outside light of ``radiance`` (H, 3), None without lobes."""
        radiance = radiance[: len(self.directions)]
        if len(self.directions) == 0:
            return None
        if len(self.directions) == 1:
            return radiance / sh_basis(np.array([[0.0, 0.0, 1.0]]), 1)
        return (sh_basis(self.directions) * LOBE_BANDS).T @ radiance


def lobes(directions: NDArray[np.floating], middles: NDArray[np.floating]) -> NDArray[np.floating]:
    """(..., D) radiance along unit ``directions`` (..., 3) of lobes with unit radiance around ``middles`` (D, 3).

    A lobe, (1 + cos)² / 16 as in equation (21), is a spherical harmonic of order 2 and never negative, so the balance
    is solved with exactly the light that Cycles is given. The faces of a dodecahedron are a spherical design of order
    5, so their lobes add up to one in every direction.
    """
    if len(middles) == 1:
        return np.ones((*directions.shape[:-1], 1), directions.dtype)
    return (1 + directions @ middles.T.astype(directions.dtype)) ** 2 / 16


def nothing_hidden(transport: Transport) -> HiddenSources:
    """No light but that of surfaces the photos show."""
    return HiddenSources((), np.zeros((0, 3)), np.zeros((transport.n_patches, 0, 2), np.float32))


def find_hidden(
    tracer: Tracer,
    transport: Transport,
    regions: NDArray[np.int32],
    components: NDArray[np.int32],
    seen: NDArray[np.bool_],
    rng: np.random.Generator,
) -> HiddenSources:
    """Unseen surfaces, and lobes of outside light, that light the seen surfaces.

    Args:
        regions: (F,) region of each face.
        components: (F,) component of its region between sharp edges.
        seen: (F,) faces that a photo shows.
        rng: of rays to the openings.
    """
    escaped = float((transport.target == ESCAPED).mean())
    directions = np.zeros((0, 3))
    if escaped > OUTSIDE_MIN_SHARE:
        directions = dodecahedron() if escaped > OUTSIDE_DIRECTIONAL_SHARE else np.array([[0.0, 0.0, 1.0]])
    surfaces = _unseen_surfaces(transport.rays, regions, components, seen)
    openings = Openings.of(tracer, transport) if len(directions) else None
    if openings is None:
        return HiddenSources(surfaces, directions[:0], np.zeros((transport.n_patches, 0, 2), np.float32))
    aimed = AIMED_RAYS / transport.target.shape[1] if escaped <= OUTSIDE_AIMED_MAX_SHARE else 0.0
    blocks = [
        _form_factors(openings, target, origins, rays, directions, round(aimed * target.shape[1]), rng)
        for target, origins, rays in (
            (transport.target, transport.origins, transport.rays),
            (transport.unseen_target, transport.unseen_origins, transport.unseen_rays),
        )
    ]
    return HiddenSources(surfaces, directions, np.concatenate(blocks))


def through_holes(transport: Transport, backdrop: SeenBackdrop) -> ThroughHoles | None:
    """The light of the backdrop at all patches; None without one."""
    if backdrop.recovered is None:
        return None
    seen = _share_of_texels(transport.target, transport.origins, transport.rays, backdrop)
    unseen = _share_of_texels(transport.unseen_target, transport.unseen_origins, transport.unseen_rays, backdrop)
    share, schlick = (csr_array(vstack(both)) for both in zip(seen, unseen, strict=True))
    return ThroughHoles(share, schlick, backdrop.radiance, backdrop.unseen)


def _share_of_texels(
    target: NDArray[np.int32], origins: Origins, rays: GatherRays, backdrop: SeenBackdrop
) -> tuple[csr_array, csr_array]:
    """(rows, T) share of the rays of each row that end on each texel of ``backdrop``, and the same times S."""
    row, ray = np.nonzero(target == ESCAPED)
    texel = np.empty(len(row), np.int32)

    def look_up(some: slice) -> None:
        start = origins.position[row[some], ray[some] % origins.position.shape[1]]
        texel[some] = backdrop.texels(start, rays.direction[row[some], ray[some]])

    over_blocks(len(row), BLOCK, look_up)
    row, ray, texel = (index[texel >= 0] for index in (row, ray, texel))
    # Rows are in ascending order, so the sparse matrix can be built without sorting.
    first = np.searchsorted(row, np.arange(len(target) + 1))
    of_each = np.full(len(row), 1 / target.shape[1], np.float32)
    shape = len(target), len(backdrop.radiance)
    share = csr_array((of_each, texel, first), shape)
    return share, csr_array((of_each * rays.schlick_start[row, ray], texel, first), shape)


def _unseen_surfaces(
    rays: GatherRays, regions: NDArray[np.int32], components: NDArray[np.int32], seen: NDArray[np.bool_]
) -> tuple[NDArray[np.int64], ...]:
    """Faces of each unseen region, and unseen component of a seen region, that rays of the seen patches meet."""
    seen_region = np.bincount(regions, seen) > 0
    label = np.where(seen_region[regions], len(seen_region) + components, regions)
    met = counts(rays.face, len(regions))
    share = np.where(np.bincount(label, seen) > 0, 0.0, np.bincount(label, met)) / rays.face.size
    ids = np.argsort(-share, kind="stable")[:SURFACE_MAX_COUNT]
    return tuple(np.flatnonzero(label == k) for k in ids if share[k] > SURFACE_MIN_SHARE)


def _form_factors(
    openings: Openings,
    target: NDArray[np.int32],
    origins: Origins,
    rays: GatherRays,
    directions: NDArray[np.float64],
    aimed: int,
    rng: np.random.Generator,
) -> NDArray[np.float32]:
    """(rows, D, 2) irradiance / pi of each row by the lobes through escaping rays, equation (21); plain and times S.

    Args:
        aimed: rays from each row to the openings, beside the gather rays.
    """
    n_rows, n_rays = target.shape
    result = np.zeros((n_rows, len(directions), 2), np.float32)

    def some(rows: slice, rng: np.random.Generator) -> None:
        found = [openings.gathered(target, rays.direction, origins, rows, aimed)]
        if aimed:
            found.append(openings.aimed(origins, rows, n_rays, aimed, rng))
        for escaping in found:
            light = lobes(escaping.direction, directions)[..., None] * with_schlick(escaping.cosine)[:, None]
            light = (light * escaping.weight[:, None, None]).reshape(len(light), 2 * len(directions))
            sums = group_sums(light, escaping.row - rows.start, rows.stop - rows.start)
            result[rows] += sums.reshape(-1, len(directions), 2)

    over_random_blocks(n_rows, BLOCK // n_rays, some, rng)
    return result
