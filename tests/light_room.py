"""Rooms whose radiosity is solved exactly between the engine's own patches: what the search for lamps is given.

Light, form factors and patches are those of the engine, so that an error is the search's own and not that of rays.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from iris_addon.base.group_by import group_means
from iris_addon.base.progress import Progress
from iris_addon.decide import Decisions
from iris_addon.lighting.brightness import Brightness, Cells
from iris_addon.lighting.hidden import HiddenSources, find_hidden
from iris_addon.lighting.lamp_radiance import form_factors_of, solve_lights
from iris_addon.lighting.problem import LightProblem, Lights
from iris_addon.response.radiance import GroupRadiance
from iris_addon.surface.irradiance import IrradianceField
from iris_addon.surface.mixed_pixels import MixedPixels
from iris_addon.surface.topology import edge_adjacency, smooth_components
from iris_addon.transport.form_factors import emitter_form_factors
from tests.engine_room import ALBEDO, SIZE, Patched, Room, assemble, box, cameras, patched, quad

WALLS = range(6)
Panel = tuple[list[float], list[float], list[float]]
"""Corner and two edges, metres."""
CEILING_LAMP: Panel = ([1.5, 1.0, 2.4], [1.0, 0, 0], [0, 1.0, 0])
WALL_PANEL: Panel = ([0.05, 0.8, 0.9], [0, 1.2, 0], [0, 0, 0.9])


@dataclass(frozen=True)
class LitRoom:
    """A room, what photos show of it and the problem that the search is posed.

    Attributes:
        radiance: (N, 3) that every patch sends out, lamps included.
    """

    room: Room
    problem: LightProblem
    observed: GroupRadiance
    radiance: np.ndarray

    def faces(self, region: int) -> np.ndarray:
        return np.flatnonzero(self.room.regions == region)

    def patches(self, region: int) -> np.ndarray:
        """Seen patches of a region."""
        return np.flatnonzero(self.problem.transport.region[: self.problem.transport.n_seen] == region)

    def lights(self, radiance: Mapping[int, float]) -> Lights:
        """The light of the room with lamps of a given radiance, exactly that of the patches otherwise."""
        t, emitters = self.problem.transport, [self.faces(region) for region in radiance]
        mask = np.isin(self.room.regions, list(radiance))
        factors = form_factors_of(self.problem, emitters, Progress())
        value = np.array(list(radiance.values()))[:, None].repeat(3, 1)
        cast = np.where(np.isin(t.region, list(radiance))[:, None], 0.0, self.radiance)
        irradiance = t.gather_radiance(cast, cast.mean(0), mask) + factors[..., 0] @ value
        return Lights(
            emitters=emitters,
            radiance=value,
            hidden_radiance=np.zeros((0, 3)),
            log_std=np.zeros(len(emitters)),
            form_factors=factors,
            mask=mask,
            irradiance=irradiance,
            patch_radiance=cast,
        )

    def solved(self, *regions: int) -> Lights:
        """The balance of the room with these regions for lamps."""
        emitters = [self.faces(region) for region in regions]
        before = self.lights(dict.fromkeys(regions, 1.0))
        return solve_lights(self.problem, self.observed, emitters, before, Progress())

    def borrowed(self, region: int, lender: int, share: float) -> LitRoom:
        """The same, but a share of the pixels of a region lie beside ones of ``lender`` that are as bright."""
        label = self.room.regions[self.problem.samples.face]
        own, beside = np.flatnonzero(label == region), np.flatnonzero(label == lender)[0]
        by = self.problem.mixed.brighter_neighbour.copy()
        by[own[: round(share * len(own))]] = beside
        return replace(self, problem=replace(self.problem, mixed=replace(self.problem.mixed, brighter_neighbour=by)))

    def on_edge(self, region: int, inner_share: float) -> LitRoom:
        """The same, but all pixels of a region up to a share of them lie on its edge."""
        own = np.flatnonzero(self.room.regions[self.problem.samples.face] == region)
        inner = self.problem.mixed.inner.copy()
        inner[own[round(inner_share * len(own)) :]] = False
        return replace(self, problem=replace(self.problem, mixed=replace(self.problem.mixed, inner=inner)))

    def showing(self, region: int, channel: int, value: float) -> LitRoom:
        """The same, but photos show one channel of a region at ``value``, unclipped."""
        seen = self.problem.brightness
        floor, measured, bound = seen.floor.copy(), seen.measured.copy(), seen.bound.copy()
        own = self.patches(region)
        floor[own, channel] = measured[own, channel] = value
        bound[own, channel] = 0.0
        return replace(self, problem=replace(self.problem, brightness=Brightness(floor, measured, bound)))

    def lamps(self, lights: Lights) -> set[int]:
        """Regions that have a face of any lamp."""
        return set(self.room.regions[lights.mask].tolist())


def panels(*placed: Panel, albedo: float = 0.5, cells: float = 0.25) -> tuple[list, list[int], np.ndarray]:
    """The walls and a region for each panel: pieces of a mesh, their regions and albedo (n, 3)."""
    pieces, regions = box(np.zeros(3), SIZE, cells), list(WALLS)
    pieces += [quad(*panel, cells) for panel in placed]
    regions += [6 + k for k in range(len(placed))]
    return pieces, regions, np.concatenate([ALBEDO[:6], np.full((len(placed), 3), albedo)])


def light_room(
    pieces: list,
    regions: list[int],
    albedo: np.ndarray,
    emission: Mapping[int, float | tuple[float, float, float]],
    *,
    clip: float = np.inf,
    shown: Mapping[int, float] | None = None,
    sky: float | np.ndarray = 0.0,
    join: Mapping[int, int] | None = None,
    noise: float = 0.02,
    direct: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None,
) -> LitRoom:
    """The problem of a room.

    Args:
        emission: radiance of the regions that emit, grey or of a color.
        clip: radiance from which on every photo is clipped.
        shown: what photos show of regions in place of their radiance: glare and caustics, which light nothing.
        sky: radiance that comes in where the mesh is open, of all lobes of outside light or of each of them.
        join: regions that the engine takes for others of the room.
        noise: of the radiance that photos show, relative; without any, no lamp is ever idle.
        direct: irradiance / pi (n,) of further light at points (n, 3) with normals (n, 3).
    """
    light = np.zeros_like(albedo)
    for region, radiance in emission.items():
        light[region] = radiance
    albedo = np.where(light > 0, 0.0, albedo)
    room = Room(assemble(pieces, regions), albedo, light)
    p = patched(room, cameras(10, 48, 36), max_patches=450, n_rays=32)
    t, n = p.transport, p.transport.n_seen
    adjacency, seen_faces = edge_adjacency(room.mesh), p.samples.seen_faces(len(room.regions))
    smooth = smooth_components(p.tracer.normals, adjacency, room.regions)
    hidden = find_hidden(p.tracer, t, room.regions, smooth, seen_faces, np.random.default_rng(2))
    radiance = _radiosity(room, p, hidden, np.asarray(sky), direct)
    photographed = radiance[:n] * np.exp(noise * np.random.default_rng(1).standard_normal((n, 1)))
    for region, value in (shown or {}).items():
        photographed[t.region[:n] == region] = value
    clipped, bounded = photographed >= clip, np.minimum(photographed, clip)
    bound = np.where(clipped, clip, 0.0)
    label = np.arange(len(albedo), dtype=np.int32)
    label[list(join or {})] = list((join or {}).values())
    pixels = len(p.samples.face)
    problem = LightProblem(
        tracer=p.tracer,
        samples=p.samples,
        surface=replace(p.surface, region=label[p.surface.region]),
        transport=replace(t, region=label[t.region]),
        regions=label[room.regions],
        material=np.arange(len(albedo), dtype=np.int32),
        adjacency=adjacency,
        cells=Cells.of_patches(p.surface.sample_patch, n),
        brightness=Brightness(bounded, np.where(clipped, np.nan, photographed), bound),
        scanned=np.zeros(len(room.regions), bool),
        mixed=MixedPixels(np.zeros(pixels, bool), np.ones(pixels, bool), np.full(pixels, -1, np.int32)),
        hidden=hidden,
        field=IrradianceField.build(p.surface),
        shadow_rays=64,
        seed=0,
        decisions=Decisions(),
    )
    return LitRoom(room, problem, GroupRadiance(bounded, ~clipped, bound, np.full(n, 50.0)), radiance)


def _radiosity(
    room: Room,
    p: Patched,
    hidden: HiddenSources,
    sky: np.ndarray,
    direct: Callable[[np.ndarray, np.ndarray], np.ndarray] | None,
) -> np.ndarray:
    """(N, 3) radiance of all patches, to convergence."""
    t, rng = p.transport, np.random.default_rng(2)
    lamps, lobes = room.lamps(), hidden.form_factors[..., 0].astype(np.float64)
    factors = np.concatenate(
        [
            emitter_form_factors(p.tracer, origins, rays, lamps, 64, rng, Progress())[..., 0]
            for origins, rays in ((t.origins, t.rays), (t.unseen_origins, t.unseen_rays))
        ]
    )
    emitted = np.array([room.emission[room.regions[faces[0]]] for faces in lamps]).reshape(-1, 3)
    source = factors @ emitted + (lobes @ np.broadcast_to(sky, lobes.shape[1]))[:, None]
    if direct is not None:
        seen = group_means(direct(p.samples.position, p.samples.normal)[:, None], p.surface.sample_patch, t.n_seen)
        o = t.unseen_origins
        unseen = direct(o.position.reshape(-1, 3), o.normal.reshape(-1, 3)).reshape(o.position.shape[:2])
        source = source + np.concatenate([seen, unseen.mean(1, keepdims=True)])
    albedo, mask = room.albedo[t.region], room.emission[room.regions].any(1)
    radiance = albedo * source
    for _ in range(40):
        radiance = albedo * (t.gather_radiance(radiance, radiance.mean(0), mask) + source)
    return radiance + room.emission[t.region]
