"""Gloss from view dependence, albedo per texel, and the fill of texels that no photo shows."""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from iris_addon.base.progress import Progress
from iris_addon.brdf.ggx import DIELECTRIC_F0, layered_factor, specular_integrals
from iris_addon.brdf.ggx_sampling import visible_normal_density
from iris_addon.decide import Decisions
from iris_addon.lighting.backdrop import SeenBackdrop
from iris_addon.lighting.balance import MAX_ALBEDO
from iris_addon.materials import gloss as gloss_module
from iris_addon.materials import shown_highlights
from iris_addon.materials.gloss import (
    GLOSS_LEVELS,
    GLOSS_MIN_OBSERVATIONS,
    Gloss,
    GlossObservations,
    choose_observations,
    fit_gloss,
    rough_everywhere,
)
from iris_addon.materials.lobes import LampAim, trace_lobes
from iris_addon.materials.lobes import Scene as LitScene
from iris_addon.materials.region_fits import RegionFits
from iris_addon.materials.shown_highlights import EXPECTED_SHARE, ShownHighlights, find_highlights
from iris_addon.materials.specular import SPECULAR_ROUGH, rough_lobes
from iris_addon.rays.tracer import Tracer
from iris_addon.results.maps import bilinear
from iris_addon.surface.patches import Surface
from iris_addon.surface.primary_rays import PixelSamples
from iris_addon.textures.atlas import Atlas, interpolate_uv, rasterise_atlas
from iris_addon.textures.bake import PixelAlbedo, TexelAlbedo, UsualPixel, pixel_albedo, pixel_weight
from iris_addon.textures.charts import build_atlas
from iris_addon.textures.principled import PaintedTexels, make_textures
from iris_addon.textures.texel_points import TexelPoints
from iris_addon.transport.form_factors import emitter_form_factors
from iris_addon.transport.transport import Transport
from tests.engine_room import Room, assemble, cameras, furnished_room, irradiance_at, patched, quad, radiosity

FLOOR, WALL = 4, 2


@dataclass(frozen=True)
class Scene:
    """The furnished room with its radiance on patches, and pixels of the floor and of one wall."""

    room: Room
    tracer: Tracer
    samples: PixelSamples
    surface: Surface
    transport: Transport
    patch_radiance: np.ndarray
    irradiance: np.ndarray  # (P, 3)

    @property
    def face_emission(self) -> np.ndarray:
        return self.room.emission[self.room.regions]

    def lobes(self, rows: np.ndarray, roughness: float, n_rays: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
        lit = self.lit()
        rng = np.random.default_rng(seed)
        return lit.lobes(trace_lobes(lit, self.samples, rows, np.full(len(rows), roughness), n_rays, rng))

    def lit(self, aim: LampAim | None = None) -> LitScene:
        """The room under its lamps."""
        return LitScene(
            self.tracer,
            self.transport,
            self.room.regions,
            self.surface.sample_patch,
            self.patch_radiance,
            self.face_emission,
            np.full(3, 0.1),
            SeenBackdrop(None),
            aim or LampAim.nowhere(self.tracer),
        )

    def aim(self) -> LampAim:
        """At the room's lamps, by what they send to each patch."""
        lamps, t = self.room.lamps(), self.transport
        rng = np.random.default_rng(0)
        factors = emitter_form_factors(self.tracer, t.origins, t.rays, lamps, 16, rng, Progress())[..., 0]
        radiance = np.array([self.room.emission[self.room.regions[faces[0]]] for faces in lamps])
        return LampAim.at(self.tracer, lamps, radiance, factors)


@pytest.fixture(scope="module")
def scene() -> Scene:
    room = furnished_room()
    seen = patched(room, cameras(12), 4000, 64)
    tracer, surface, transport = seen.tracer, seen.surface, seen.transport
    irradiance = irradiance_at(room, tracer, radiosity(room, tracer, 128), surface.origins, 128, 1)
    radiance = np.zeros((transport.n_patches, 3))
    radiance[: transport.n_seen] = room.albedo[surface.region] * irradiance
    return Scene(
        room=room,
        tracer=tracer,
        samples=seen.samples,
        surface=surface,
        transport=transport,
        patch_radiance=radiance,
        irradiance=irradiance,
    )


# Gloss ---------------------------------------------------------------------------------------------------------------


def fit_floor(scene: Scene, radiance: np.ndarray, rows: np.ndarray, layer: np.ndarray | None = None) -> Gloss:
    patch = scene.surface.sample_patch[rows]
    irradiance = scene.irradiance[patch]
    lobes = [
        [scene.lobes(rows, level, 16, 5 + 2 * k + half) for half in (0, 1)] for k, level in enumerate(GLOSS_LEVELS[:-1])
    ]
    lobes.append([rough_lobes(np.ones(len(rows)), scene.samples.cosine[rows], irradiance)] * 2)
    region = scene.room.regions[scene.samples.face[rows]]
    observed = GlossObservations(
        region=region,
        patch=patch,
        weight=np.ones(len(rows)),
        position=scene.samples.position[rows],
        radiance=radiance,
        irradiance=irradiance,
        diffuse=np.ones((len(GLOSS_LEVELS), len(rows))),
        lobes=lobes,
        layer=layer,
    )
    return fit_gloss(observed, len(scene.room.albedo), Decisions())


def rows_on(scene: Scene, region: int) -> np.ndarray:
    on = np.flatnonzero(scene.room.regions[scene.samples.face] == region)
    return on[np.random.default_rng(2).permutation(len(on))[:600]]


def seen(scene: Scene, rows: np.ndarray, color: np.ndarray, roughness: float, metallic: float) -> np.ndarray:
    """Radiance of pixels under the reflectance model, lobes by many rays of their own."""
    irradiance = scene.irradiance[scene.surface.sample_patch[rows]]
    if roughness < SPECULAR_ROUGH:
        s0, s1 = scene.lobes(rows, roughness, 256, 99)
    else:
        s0, s1 = rough_lobes(np.full(len(rows), roughness), scene.samples.cosine[rows], irradiance)
    kd = color * (1 - metallic)
    ks = color * metallic + DIELECTRIC_F0 * (1 - metallic)
    noise = np.random.default_rng(3).normal(1, 0.01, (len(rows), 1))
    return (kd * irradiance + ks * s0 + s1) * noise


@pytest.mark.parametrize("roughness", [0.1, 0.2])
def test_a_polished_floor_is_glossy(scene: Scene, roughness: float) -> None:
    rows = rows_on(scene, FLOOR)
    gloss = fit_floor(scene, seen(scene, rows, scene.room.albedo[FLOOR], roughness, 0.0), rows)
    assert gloss.decided[FLOOR]
    assert gloss.roughness[FLOOR] == pytest.approx(roughness, abs=0.08)
    assert gloss.metallic[FLOOR] == 0


@pytest.mark.parametrize("region", [FLOOR, WALL])
def test_a_matte_region_stays_matte(scene: Scene, region: int) -> None:
    rows = rows_on(scene, region)
    gloss = fit_floor(scene, seen(scene, rows, scene.room.albedo[region], 1.0, 0.0), rows)
    assert gloss.roughness[region] > 0.6
    assert gloss.metallic[region] == 0


@pytest.mark.parametrize("roughness", [0.1, 0.32])
def test_a_metal_wall_is_metal(scene: Scene, roughness: float) -> None:
    rows = rows_on(scene, WALL)
    gloss = fit_floor(scene, seen(scene, rows, np.array([0.9, 0.7, 0.4]), roughness, 1.0), rows)
    assert gloss.metallic[WALL] == 1
    np.testing.assert_allclose(gloss.specular[WALL], [0.9, 0.7, 0.4], rtol=0.1)
    assert (np.delete(gloss.specular, WALL, 0) == DIELECTRIC_F0).all()
    assert gloss.roughness[WALL] == pytest.approx(roughness, abs=0.12)


def mirrored_light(rng: np.random.Generator, n: int) -> np.ndarray:
    """(n, 3) what n views of a mirror meet: a room of dim walls and a bright window."""
    return np.where(rng.random((n, 1)) < 0.2, 2.0, 0.1 + 0.4 * rng.random((n, 1))) * np.ones(3)


def test_a_mirror_is_not_outvoted_by_its_frame() -> None:
    """The room in a mirror passes for a texture like the grain of the wood around it, so that the costs of the frame
    count as much as its own."""
    rng = np.random.default_rng(14)
    patches, views = 40, 5
    region, patch = np.repeat([0, 1, 1, 1], patches * views), np.repeat(np.arange(4 * patches), views)
    n = len(region)
    mirror = (region == 0)[:, None]
    light = mirrored_light(rng, n)
    wood = np.exp(rng.normal(np.log(0.35), 0.4, 4 * patches))[patch, None]
    observed = GlossObservations(
        region=region,
        patch=patch,
        weight=np.ones(n),
        position=np.zeros((n, 3)),
        radiance=np.where(mirror, 0.85 * light, wood) * (1 + 0.02 * rng.normal(size=(n, 1))),
        irradiance=np.ones((n, 3)),
        diffuse=np.ones((len(GLOSS_LEVELS), n)),
        lobes=[[(light, 0.0 * light)] * 2] + [[(np.full((n, 3), 0.5), np.zeros((n, 3)))] * 2] * (len(GLOSS_LEVELS) - 1),
        scanned=np.ones(2, bool),
    )
    gloss = fit_gloss(observed, 2, Decisions())
    assert gloss.metallic.tolist() == [1, 0]
    assert gloss.roughness[0] == GLOSS_LEVELS[0]
    np.testing.assert_allclose(gloss.specular[0], 0.85, rtol=0.05)


@pytest.mark.parametrize("reflectance, metal", [(0.06, False), (0.6, True)])
def test_what_reflects_less_than_any_metal_is_none(reflectance: float, metal: bool) -> None:
    """Black lacquer shows no light but what it reflects, as a metal does, and a little more than glass."""
    rng = np.random.default_rng(15)
    patches, views = 60, 5
    n = patches * views
    light = mirrored_light(rng, n)
    observed = GlossObservations(
        region=np.zeros(n, int),
        patch=np.repeat(np.arange(patches), views),
        weight=np.ones(n),
        position=np.zeros((n, 3)),
        radiance=reflectance * light * (1 + 0.02 * rng.normal(size=(n, 1))),
        irradiance=np.ones((n, 3)),
        diffuse=np.ones((len(GLOSS_LEVELS), n)),
        lobes=[[(light, 0.0 * light)] * 2] + [[(np.full((n, 3), 0.5), np.zeros((n, 3)))] * 2] * (len(GLOSS_LEVELS) - 1),
    )
    assert (fit_gloss(observed, 1, Decisions()).metallic[0] == 1) == metal


@pytest.mark.parametrize("highlight", [False, True])
def test_sheen_alone_is_no_gloss(highlight: bool) -> None:
    """A wide lobe that fits is accepted only where a narrow one also fits better than none."""
    rng = np.random.default_rng(0)
    n = 400
    sheen, elsewhere = 0.1 * rng.random((2, n, 1)) * np.ones(3)
    zero = np.zeros((n, 3))
    narrow, close = (zero, elsewhere), (zero, 0.8 * sheen)
    lobes = [narrow, narrow, narrow, close if highlight else narrow, (zero, sheen), (zero, zero)]
    observed = GlossObservations(
        region=np.zeros(n, int),
        patch=np.repeat(np.arange(n // 4), 4),
        weight=np.ones(n),
        position=zero,
        radiance=0.5 + sheen + 0.01 * rng.random((n, 3)),
        irradiance=np.ones((n, 3)),
        diffuse=np.ones((len(GLOSS_LEVELS), n)),
        lobes=[[lobe] * 2 for lobe in lobes],
    )
    assert (fit_gloss(observed, 1, Decisions()).roughness[0] < 1) == highlight


@pytest.mark.parametrize("odd_one_is_polished", [True, False])
def test_a_region_is_not_outvoted_by_neighbours_of_its_colour(odd_one_is_polished: bool) -> None:
    """A frame of the wall's colour on the wall: its own highlight stands, and the wall stays matte; nor is a wall that
    shows no highlight polished because two frames on it are."""
    rng = np.random.default_rng(7)
    patches, views = 60, 5
    n = patches * views
    zero = np.zeros((3 * n, 3))
    region = np.repeat(np.arange(3), n)
    highlight = np.where(region == 0, 0.03, 0.1)[:, None] * (rng.random((3 * n, 1)) < 0.3) * np.ones(3)
    polished = ((region == 0) == odd_one_is_polished)[:, None]
    lobes = [(zero, highlight) for _ in GLOSS_LEVELS[:-2]]
    observed = GlossObservations(
        region=region,
        patch=np.repeat(np.arange(3 * patches), views),
        weight=np.where(region == 0, 1.0, 5.0),
        position=zero,  # all in one place
        radiance=0.5 * (1 + 0.01 * rng.normal(size=(3 * n, 1))) + highlight * polished,
        irradiance=np.ones((3 * n, 3)),
        diffuse=np.ones((len(GLOSS_LEVELS), 3 * n)),
        lobes=[[lobe] * 2 for lobe in (*lobes, (zero, zero), (zero, zero))],
    )
    roughness = fit_gloss(observed, 3, Decisions()).roughness
    glossy = roughness < 0.6
    assert (glossy == [odd_one_is_polished, *[not odd_one_is_polished] * 2]).all()
    assert (roughness[~glossy] == 1).all()


@pytest.mark.parametrize("same_object", [True, False])
def test_regions_of_one_object_of_the_file_share_their_gloss(same_object: bool) -> None:
    """A knob that mirrors nothing bright, ten metres from the drawer whose lacquer it has."""
    rng = np.random.default_rng(11)
    patches, views = np.array([60, 3]), 5
    region = np.repeat([0, 1], patches * views)
    n = len(region)
    zero = np.zeros((n, 3))
    highlight = np.where(region == 0, 0.1, 0.0)[:, None] * (rng.random((n, 1)) < 0.3) * np.ones(3)
    observed = GlossObservations(
        region=region,
        patch=np.repeat(np.arange(patches.sum()), views),
        weight=np.ones(n),
        position=np.where(region == 0, 0.0, 10.0)[:, None] * np.ones(3),
        radiance=0.5 * (1 + 0.01 * rng.normal(size=(n, 1))) + highlight,
        irradiance=np.ones((n, 3)),
        diffuse=np.ones((len(GLOSS_LEVELS), n)),
        lobes=[[lobe] * 2 for lobe in (*((zero, highlight) for _ in GLOSS_LEVELS[:-2]), (zero, zero), (zero, zero))],
        in_file=np.zeros(2, int) if same_object else np.arange(2),
    )
    roughness = fit_gloss(observed, 2, Decisions()).roughness
    assert roughness[0] < 0.6
    assert (roughness[1] < 0.6) == same_object


@pytest.mark.parametrize("scanned", [True, False])
def test_treads_of_a_scan_that_differ_as_their_grain_share_their_gloss(scanned: bool) -> None:
    """A tread that mirrors nothing bright beside a lighter one of the same varnished wood."""
    rng = np.random.default_rng(12)
    patches, views = np.array([60, 12]), 5
    region, patch = np.repeat([0, 1], patches * views), np.repeat(np.arange(patches.sum()), views)
    n = len(region)
    zero = np.zeros((n, 3))
    wood = np.exp(rng.normal(0, 0.3, patches.sum()))[patch] * np.where(region == 0, 0.5, 0.4)
    highlight = np.where(region == 0, 0.1, 0.0)[:, None] * (rng.random((n, 1)) < 0.3) * np.ones(3)
    observed = GlossObservations(
        region=region,
        patch=patch,
        weight=np.ones(n),
        position=zero,
        radiance=wood[:, None] * (1 + 0.01 * rng.normal(size=(n, 1))) + highlight,
        irradiance=np.ones((n, 3)),
        diffuse=np.ones((len(GLOSS_LEVELS), n)),
        lobes=[[lobe] * 2 for lobe in (*((zero, highlight) for _ in GLOSS_LEVELS[:-2]), (zero, zero), (zero, zero))],
        scanned=np.full(2, scanned),
    )
    roughness = fit_gloss(observed, 2, Decisions()).roughness
    assert roughness[0] < 0.6 and (roughness[1] < 0.6) == scanned


@pytest.mark.parametrize("scanned", [True, False])
def test_fragments_of_a_scan_take_the_gloss_of_like_ones_across_the_room(scanned: bool) -> None:
    """Treads of which five mirror a window and the sixth, on the next floor, mirrors nothing bright; a seventh of
    their colour shows that it mirrors nothing."""
    rng = np.random.default_rng(16)
    patches, views = 60, 5
    region = np.repeat(np.arange(7), patches * views)
    n = len(region)
    zero = np.zeros((n, 3))
    windows = [(rng.random((n, 1)) < 0.3) * np.ones(3) for _ in GLOSS_LEVELS[:-2]]  # where each gloss would show them
    bright = np.where(region == 5, 0.0, 0.1)[:, None]
    shown = np.where(region == 6, 0.0, 1.0)[:, None] * bright * windows[2]
    observed = GlossObservations(
        region=region,
        patch=np.repeat(np.arange(7 * patches), views),
        weight=np.ones(n),
        position=10.0 * region[:, None] * np.ones(3),
        radiance=0.4 * (1 + 0.01 * rng.normal(size=(n, 1))) + shown,
        irradiance=np.ones((n, 3)),
        diffuse=np.ones((len(GLOSS_LEVELS), n)),
        lobes=[[(zero, bright * window)] * 2 for window in windows] + [[(zero, zero)] * 2] * 2,
        scanned=np.full(7, scanned),
    )
    roughness = fit_gloss(observed, 7, Decisions()).roughness
    np.testing.assert_allclose(roughness[:5], GLOSS_LEVELS[2], rtol=0.1)
    assert roughness[5] == (pytest.approx(roughness[0], rel=0.1) if scanned else 1) and roughness[6] == 1


def test_highlights_where_normals_are_unknown_tell_nothing() -> None:
    """A bumpy surface of a scan that shows none of its predicted highlights may be glossy all the same."""
    share, variance = np.array([[0.0], [0.0], [1.0], [1.0]]), np.full((4, 1), 0.1)
    known = np.array([1.0, 0.01, 1.0, 0.01])
    matte, bumpy, glossy, bumpy_glossy = ShownHighlights(share, variance, EXPECTED_SHARE * known).evidence[:, 0]
    assert matte < -2 and glossy > 2
    assert -0.01 < bumpy < 0 < bumpy_glossy < 0.1


def test_gloss_by_chance_alone_is_rare() -> None:
    """Lobes that have nothing to do with what was seen, and are fainter than the noise of the photos, are found in
    fewer than one of thirty regions; by 1.5 standard errors of the cost, one in ten was."""
    rng = np.random.default_rng(5)
    regions, patches, views = 300, 40, 4
    n = regions * patches * views
    zero = np.zeros((n, 3))
    light = 0.5 * (1 + 0.03 * rng.normal(size=(n, 1))) * np.ones(3)
    lobes = [(zero, np.abs(0.005 * rng.normal(size=(n, 1))) * np.ones(3)) for _ in GLOSS_LEVELS[:-2]]
    observed = GlossObservations(
        region=np.repeat(np.arange(regions), patches * views),
        patch=np.repeat(np.arange(regions * patches), views),
        weight=np.ones(n),
        position=np.repeat(10.0 * np.arange(regions), patches * views)[:, None] * np.ones(3),  # none near another
        radiance=light,
        irradiance=np.ones((n, 3)),
        diffuse=np.ones((len(GLOSS_LEVELS), n)),
        lobes=[[lobe] * 2 for lobe in (*lobes, (zero, zero), (zero, zero))],
    )
    glossy = fit_gloss(observed, regions, Decisions()).roughness < 1
    assert glossy.mean() < 0.03


@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("noise", [0.0, 0.6])
@pytest.mark.parametrize("blocks", [1, 60])
def test_the_share_of_a_highlight_that_photos_show_is_found(
    share: float, noise: float, blocks: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """However noisy the predicted highlight is; and the standard error is the scatter of like regions, also where
    errors of the light are common to a block."""
    rng = np.random.default_rng(3)
    patches, views, regions = 60, 6, 60
    n = patches * views * regions
    region, patch = np.repeat(np.arange(regions), patches), np.repeat(np.arange(patches * regions), views)
    albedo = rng.uniform(0.2, 0.8, regions)[region][patch] * np.exp(rng.normal(0, 0.05, patches * regions))[patch]
    light = rng.uniform(0.5, 2.0, patches * regions)[patch]
    highlight = 0.1 * rng.random(n) ** 2
    draws = [highlight * (1 + noise * rng.normal(size=n)) for _ in range(2)]
    halves = [(np.zeros((n, 3)), draw[:, None] * np.ones(3)) for draw in draws]
    block = rng.integers(0, blocks, patches * regions)[patch]
    view = np.tile(np.arange(views), patches * regions)
    common = 0.01 * rng.normal(size=(regions, blocks, views))[region[patch], block, view] * (blocks > 1)
    radiance = (albedo * light + share * highlight) * (1 + 0.01 * rng.normal(size=n) + common)
    fits = RegionFits(
        patch=patch,
        region=region,
        weight=np.ones(n),
        radiance=radiance[:, None] * np.ones(3),
        irradiance=light[:, None] * np.ones(3),
    )
    rough = [(np.zeros((n, 3)), np.zeros((n, 3)))]
    position = np.stack([block * 1.0, *np.zeros((2, n))], 1)
    found = find_highlights(fits, position, np.ones((2, n)), [halves, rough], 1, np.ones(1))
    assert found.share.mean() == pytest.approx(share, abs=0.03)
    assert ((found.evidence > 0) == (share > EXPECTED_SHARE / 2)).all()
    monkeypatch.setattr(shown_highlights, "MODEL_ERROR", 0.0)
    monkeypatch.setattr(shown_highlights, "LIGHT_ERROR", 0.0)
    found = find_highlights(fits, position, np.ones((2, n)), [halves, rough], 1, np.ones(1))
    # Robust weights count as known, which makes it too small by a third to a half; errors of the model are larger.
    assert 0.4 < np.sqrt(found.variance.mean()) / found.share.std() < 1.2


def test_where_no_highlight_is_predicted_photos_tell_nothing_of_it() -> None:
    n = 40
    fits = RegionFits(
        patch=np.repeat(np.arange(10), 4),
        region=np.zeros(10, int),
        weight=np.ones(n),
        radiance=np.ones((n, 3)),
        irradiance=np.ones((n, 3)),
    )
    nothing = [(np.zeros((n, 3)), np.zeros((n, 3)))]
    found = find_highlights(fits, np.zeros((n, 3)), np.ones((2, n)), [nothing, nothing], 1, np.ones(1))
    assert found.evidence[0, 0] == 0


def test_the_standard_error_of_a_cost_is_its_spread_over_draws() -> None:
    rng = np.random.default_rng(1)
    draws, patches = 400, 50
    n = draws * patches
    views = rng.integers(1, 5, n)  # observations of each patch
    patch, region = np.repeat(np.arange(n), views), np.repeat(np.arange(draws), patches)
    ones = np.ones((len(patch), 3))
    fits = RegionFits(patch=patch, region=region, weight=ones[:, 0], radiance=ones, irradiance=ones)
    cost = rng.normal(0.3, 0.1, n)
    error = fits.standard_error(cost)
    assert fits.mean(cost).std() == pytest.approx(np.sqrt(np.mean(error**2)), rel=0.1)
    zeros, ones = np.zeros(3, int), np.ones((3, 3))
    alone = RegionFits(patch=zeros, region=zeros[:1], weight=ones[0], radiance=ones, irradiance=ones)
    assert alone.standard_error(np.array([-0.2])) == pytest.approx(0.2)


def test_regions_with_few_observations_keep_the_default(scene: Scene) -> None:
    rows = rows_on(scene, FLOOR)[: GLOSS_MIN_OBSERVATIONS - 1]
    gloss = fit_floor(scene, seen(scene, rows, scene.room.albedo[FLOOR], 0.1, 0.0), rows)
    assert not gloss.decided.any()
    assert (gloss.roughness == rough_everywhere(len(gloss.roughness)).roughness).all()


@pytest.mark.parametrize("aimed", [False, True])
def test_lobes_of_uniform_light_are_the_integrals_of_the_brdf(scene: Scene, aimed: bool) -> None:
    rows = rows_on(scene, WALL)[:300]
    ones, faces = np.ones_like(scene.patch_radiance), np.zeros((len(scene.room.mesh.faces), 3))
    faces[np.concatenate(scene.room.lamps())] = 1.0
    lit = replace(scene.lit(scene.aim() if aimed else None), patch_radiance=ones, face_emission=faces, unknown=ones[0])
    for roughness in (0.15, 0.5, 1.0):
        s = scene.samples
        rays = trace_lobes(lit, s, rows, np.full(len(rows), roughness), 128, np.random.default_rng(1))
        s0, s1 = lit.lobes(rays)
        f0, f1 = specular_integrals(np.full(len(rows), roughness), s.cosine[rows].astype(np.float64))
        assert s0[:, 0].mean() == pytest.approx(f0.mean(), abs=0.01)
        assert s1[:, 0].mean() == pytest.approx(f1.mean(), abs=0.005)


def test_rays_aimed_at_lamps_find_the_same_light_with_less_noise(scene: Scene) -> None:
    """Of a wide lobe a few rays meet the smaller lamp, or none does."""
    rows = rows_on(scene, WALL)[:300]
    lamps_alone = np.zeros_like(scene.patch_radiance)
    truth, spread = [], []
    for aim in (None, scene.aim()):
        lit = replace(scene.lit(aim), patch_radiance=lamps_alone, unknown=np.zeros(3))
        draws = []
        for seed in range(24):
            rays = trace_lobes(lit, scene.samples, rows, np.full(len(rows), 0.5), 15, np.random.default_rng(seed))
            draws.append(lit.lobes(rays)[0].mean(1))
        truth.append(np.mean(draws))
        spread.append(np.std(draws, axis=0).mean())
    assert truth[1] == pytest.approx(truth[0], rel=0.05)
    assert spread[1] < 0.2 * spread[0]


def test_a_dropped_lamp_that_rays_were_aimed_at_reflects(scene: Scene) -> None:
    rows = rows_on(scene, WALL)[:300]
    dark = np.zeros((len(scene.room.mesh.faces), 3))
    lobes = []
    for aim in (None, scene.aim()):
        lit = replace(scene.lit(aim), face_emission=dark, patch_radiance=np.ones_like(scene.patch_radiance))
        lit = replace(lit, unknown=np.ones(3))
        rays = trace_lobes(lit, scene.samples, rows, np.full(len(rows), 0.7), 128, np.random.default_rng(1))
        lobes.append(lit.lobes(rays)[0].mean())
    assert lobes[1] == pytest.approx(lobes[0], rel=0.01)


UP, EYE = (0.0, 0.0, 1.0), (0.6, 0.0, 0.8)


@pytest.mark.parametrize("roughness", [0.2, 0.5, 1.0])
def test_the_density_of_reflected_directions_integrates_to_one(roughness: float) -> None:
    n, rng = 400_000, np.random.default_rng(4)
    incident = rng.normal(size=(n, 3))
    incident /= np.linalg.norm(incident, axis=1, keepdims=True)
    density = np.array([visible_normal_density(UP, EYE, tuple(i), roughness**2) for i in incident])
    assert 4 * np.pi * density.mean() == pytest.approx(1, rel=0.05)


def test_a_layer_lets_out_less_at_grazing_angles_and_the_same_on_average() -> None:
    cosine = np.sqrt((np.arange(2000) + 0.5) / 2000)  # equal steps of the cosine-weighted hemisphere
    for roughness in (0.1, 0.3, 0.7, 1.0):
        factor = layered_factor(np.array(roughness), cosine)
        assert factor.mean() == pytest.approx(1, abs=2e-3)
        assert (np.diff(factor) > -1e-3).all()
    assert layered_factor(np.array(0.3), np.array(0.05)) < 0.75
    assert layered_factor(np.array(1.0), np.array(0.05)) > 0.95


@pytest.mark.parametrize("layered", [False, True])
def test_photos_determine_whether_dielectrics_are_layered(scene: Scene, layered: bool) -> None:
    rows = rows_on(scene, FLOOR)
    factor = layered_factor(np.array(GLOSS_LEVELS)[:, None], scene.samples.cosine[rows])
    irradiance = scene.irradiance[scene.surface.sample_patch[rows]]
    below = scene.room.albedo[WALL] * irradiance
    shown = seen(scene, rows, scene.room.albedo[WALL], 0.2, 0.0)
    shown += (factor[GLOSS_LEVELS.index(0.2)][:, None] - 1) * below * layered
    gloss = fit_floor(scene, shown, rows, factor)
    assert gloss.layered == layered
    assert gloss.roughness[FLOOR] == pytest.approx(0.2, abs=0.08)
    assert Gloss.from_arrays(gloss.arrays()).layered == layered


def test_observations_are_chosen_by_whole_patches() -> None:
    region = np.repeat([0, 1], [3000, 50])
    patch = np.concatenate([np.repeat(np.arange(300), 10), 300 + np.repeat(np.arange(5), 10)])
    weight = np.ones(3050)
    weight[::7] = 0
    rows = choose_observations(region, patch, weight, np.random.default_rng(0))
    assert (weight[rows] > 0).all() and (np.diff(rows) > 0).all()
    assert (region[rows] == 1).sum() == (weight[3000:] > 0).sum()
    chosen, count = np.unique(patch[rows], return_counts=True)
    whole = np.bincount(patch, weight)[chosen]
    assert (count == whole).sum() >= len(chosen) - 1  # the last one may be cut


def test_many_regions_share_the_limit_of_observations(monkeypatch: pytest.MonkeyPatch) -> None:
    """Small regions keep all, large ones are cut to the same size, and as much as allowed is used."""
    monkeypatch.setattr(gloss_module, "GLOSS_ALL_OBSERVATIONS", 1000)
    size = np.array([5, 30, 100, 400, 700, 900])
    region = np.repeat(np.arange(len(size)), size)
    rows = choose_observations(region, np.arange(len(region)), np.ones(len(region)), np.random.default_rng(0))
    assert np.bincount(region[rows]).tolist() == [5, 30, 100, 288, 288, 288]
    none = choose_observations(region, np.arange(len(region)), np.zeros(len(region)), np.random.default_rng(0))
    assert len(none) == 0


# Textures ------------------------------------------------------------------------------------------------------------


def test_a_pixels_albedo_inverts_the_model() -> None:
    rng = np.random.default_rng(0)
    color, irradiance, s0, s1 = (
        rng.random((50, 3)) * 0.9,
        rng.random((50, 3)) + 0.1,
        rng.random((50, 3)),
        rng.random((50, 3)),
    )
    for metallic in (0.0, 1.0):
        m = np.full(50, metallic)
        ks = color * metallic + DIELECTRIC_F0 * (1 - metallic)
        radiance = color * (1 - metallic) * irradiance + ks * s0 + s1
        specular = DIELECTRIC_F0 * (1 - metallic) * s0 + s1
        assert pixel_albedo(radiance, specular, np.maximum(s0, 1e-3), irradiance, m) == pytest.approx(color, abs=0.02)
    assert pixel_albedo(radiance * 100, specular, s0, irradiance, m).max() <= MAX_ALBEDO


def test_near_head_on_well_lit_pixels_weigh_most() -> None:
    """Pixels as one of the first, each worse in one thing: angle, distance, light, a highlight, an edge."""
    cosine, footprint = np.array([1, 1, 1, 0.5, 1, 1, 1, 1]), np.array([1, 1, 1, 1, 2, 1, 1, 1]) * 0.01
    irradiance, specular = np.ones((8, 3)), np.full((8, 3), 1e-6)
    irradiance[5], specular[6] = 0.05, 1.0
    pixels = cast(PixelSamples, SimpleNamespace(cosine=cosine, footprint=footprint))
    on_edge, scanned = np.arange(8) == 7, np.zeros(8, bool)
    weight = pixel_weight(pixels, irradiance, specular, on_edge, scanned, UsualPixel(0.01, 1.0))[:, 0]
    assert weight[1:3] == pytest.approx(weight[0]) and (weight[3:] < 0.5 * weight[0]).all()
    assert weight[0] == pytest.approx(4 * weight[4], rel=1e-3)
    assert weight[6] < 0.01 * weight[0] and weight[7] < 0.01 * weight[0]


def test_unseen_faces_take_their_regions_mean_and_lamps_are_black() -> None:
    """Three regions: a floor half of which nobody saw, a wall nobody saw at all, a lamp."""
    mesh = assemble(
        [
            quad([0, 0, 0], [1, 0, 0], [0, 1, 0]),
            quad([5, 0, 0], [1, 0, 0], [0, 1, 0]),
            quad([0, 5, 0], [1, 0, 0], [0, 0, 1]),
            quad([0, 0, 3], [1, 0, 0], [0, 1, 0]),
        ],
        [0, 0, 1, 2],
    )
    assert mesh.regions is not None
    size, rng = 64, np.random.default_rng(0)
    uv = build_atlas(mesh, np.full(8, 10.0), size)
    n = 8000
    face = rng.choice([0, 1, 6, 7], n).astype(np.int32)
    barycentric = rng.random((n, 2)).astype(np.float32)
    barycentric = np.where(barycentric.sum(1, keepdims=True) > 1, 1 - barycentric, barycentric)
    empty = np.zeros((n, 3), np.float32)
    samples = PixelSamples(
        view=np.zeros(n, np.int16),
        pixel=np.zeros(n, np.int32),
        face=face,
        barycentric=barycentric,
        position=empty,
        normal=empty,
        direction=empty,
        footprint=np.ones(n, np.float32),
    )
    atlas = Atlas.of(uv, size, face, barycentric)
    color = np.where((face < 2)[:, None], [0.5, 0.25, 0.125], 0.9)
    gloss = Gloss(np.array([0.2, 1.0, 0.5]), np.array([0.0, 1.0, 0.0]), np.full((3, 3), 0.04), np.ones(3, bool))
    lamps = np.arange(8) >= 6
    surface = TexelPoints.of(Tracer(mesh), uv, size)
    seen = np.flatnonzero(np.isin(surface.face, [0, 1, 6, 7]))
    value = np.where((surface.face[seen] < 2)[:, None], [0.5, 0.25, 0.125], 0.9).astype(np.float32)
    fused = TexelAlbedo(surface.texel[seen], value, np.full(len(seen), 4, np.float32))
    n_points = len(surface.texel)
    none = np.zeros((n_points, 3), bool)
    texels = PaintedTexels(
        points=surface, fused=fused, light_error=np.full(n_points, 0.02), bounded=none, measured=~none
    )
    pixels = PixelAlbedo(color, np.ones((n, 3)))
    textures, paint = make_textures(atlas, mesh.regions, lamps, gloss, samples, pixels, texels, gloss.metallic < 0.5)
    shown, _ = rasterise_atlas(uv, size)

    def base(*faces: int) -> np.ndarray:
        return textures.base_color[np.isin(shown, faces)]

    assert base(0, 1) == pytest.approx(np.tile([0.5, 0.25, 0.125], (len(base(0, 1)), 1)), abs=1e-3)
    assert base(2, 3) == pytest.approx(np.tile([0.5, 0.25, 0.125], (len(base(2, 3)), 1)), abs=1e-3)
    assert base(6, 7).max() == 0
    assert np.ptp(base(4, 5), axis=0).max() < 1e-6
    assert (textures.confidence[np.isin(shown, [2, 3, 4, 5])] == 0).mean() > 0.9
    assert textures.confidence[np.isin(shown, [0, 1])].mean() > 0.8
    # A filter at the border of a chart reaches beyond it, and finds the same material there.
    points = interpolate_uv(uv, face, barycentric)
    for texture, of_region in ((textures.roughness, gloss.roughness), (textures.metallic, gloss.metallic)):
        found = bilinear(texture[..., None], points)[:, 0]
        assert found == pytest.approx(of_region[mesh.regions[face]], abs=1e-6)
    assert (textures.roughness[np.isin(shown, [0, 1, 2, 3])] == np.float32(0.2)).all()
    assert (textures.metallic[np.isin(shown, [4, 5])] == 1).all()
    assert paint.plain_regions == 2, "the wall that nobody saw says nothing"
    assert bilinear(textures.base_color, interpolate_uv(uv, face, barycentric))[face < 2] == pytest.approx(
        color[face < 2], abs=1e-3
    )
    assert bilinear(textures.base_color, points)[face >= 6].max() == 0, "no colour runs into a lamp"
    assert np.isfinite(textures.base_color).all()
