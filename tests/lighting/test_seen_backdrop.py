"""The backdrop as escaping rays see it: the texel they meet, the light it sends into the room, its albedo."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from iris_addon.base.progress import Progress
from iris_addon.brdf.diffuse import MEAN_SCHLICK
from iris_addon.brdf.ggx import specular_integrals
from iris_addon.lighting.backdrop import SeenBackdrop
from iris_addon.lighting.hidden import OutsideKind, nothing_hidden, through_holes
from iris_addon.lighting.problem import Lights
from iris_addon.lighting.shell_surface import as_surface
from iris_addon.materials.lobes import LampAim, Scene, trace_lobes
from iris_addon.model.capture import Mesh
from iris_addon.model.recovered import Backdrop
from iris_addon.model.sphere import equirect_directions
from iris_addon.surface.primary_rays import PixelSamples
from tests.engine_room import cameras, furnished_room, patched

FLOOR = 4
SIDE = 6.0


def shell(picture: np.ndarray) -> Backdrop:
    """A cube about the origin whose sides are SIDE away."""
    corners = SIDE * np.array([[x, y, z] for x in (-1.0, 1) for y in (-1.0, 1) for z in (-1.0, 1)])
    quads = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
    faces = np.concatenate([quads[:, :3], quads[:, [0, 2, 3]]])
    return Backdrop(corners, faces, picture.astype(np.float32))


def test_a_ray_meets_the_texel_at_its_end_and_not_in_its_direction() -> None:
    picture = equirect_directions(256, 128)
    backdrop = SeenBackdrop(shell(picture))
    rng = np.random.default_rng(0)
    origin = rng.uniform(-1, 1, (200, 3))
    direction = rng.normal(size=(200, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    reach = ((SIDE - np.sign(direction) * origin) / np.abs(direction)).min(1)
    end = origin + reach[:, None] * direction
    met = backdrop.radiance[backdrop.texels(origin, direction)]
    assert np.abs(met - end / np.linalg.norm(end, axis=1, keepdims=True)).max() < 0.04
    assert np.abs(met - direction).max() > 0.1


def test_without_a_backdrop_rays_meet_nothing() -> None:
    backdrop = SeenBackdrop(None)
    assert len(backdrop.radiance) == 0
    assert (backdrop.texels(np.zeros((3, 3)), np.eye(3)) == -1).all()


@pytest.fixture(scope="module")
def floor() -> tuple[Scene, PixelSamples]:
    """The floor of the furnished room alone: every ray that it reflects escapes."""
    room = furnished_room()
    on_floor = room.regions == FLOOR
    mesh = Mesh(room.mesh.vertices, room.mesh.faces[on_floor], None, np.zeros(on_floor.sum(), np.int32))
    seen = patched(replace(room, mesh=mesh), cameras(4), 300, 16)
    n, n_faces = seen.transport.n_patches, len(mesh.faces)
    scene = Scene(
        tracer=seen.tracer,
        transport=seen.transport,
        regions=np.zeros(n_faces, np.int32),
        sample_patch=seen.surface.sample_patch,
        patch_radiance=np.zeros((n, 3)),
        face_emission=np.zeros((n_faces, 3)),
        unknown=np.zeros(3),
        backdrop=SeenBackdrop(None),
        aim=LampAim.nowhere(seen.tracer),
    )
    return scene, seen.samples


@pytest.mark.parametrize("roughness", [0.15, 0.5])
def test_a_uniform_backdrop_is_reflected_with_the_integrals_of_the_brdf(
    floor: tuple[Scene, PixelSamples], roughness: float
) -> None:
    scene, samples = floor
    rows = np.arange(0, len(samples.face), max(1, len(samples.face) // 400))
    lit = replace(scene, backdrop=SeenBackdrop(shell(np.full((8, 16, 3), 0.3))))
    rays = trace_lobes(lit, samples, rows, np.full(len(rows), roughness), 128, np.random.default_rng(1))
    s0, s1 = lit.lobes(rays)
    f0, f1 = specular_integrals(np.full(len(rows), roughness), samples.cosine[rows].astype(np.float64))
    assert s0.mean() == pytest.approx(0.3 * f0.mean(), rel=0.02)
    assert s1.mean() == pytest.approx(0.3 * f1.mean(), abs=0.005)
    dark = trace_lobes(scene, samples, rows, np.full(len(rows), roughness), 16, np.random.default_rng(1))
    assert not scene.lobes(dark)[0].any()


@pytest.mark.parametrize("kappa", [0.0, 0.5])
def test_a_uniform_backdrop_lights_an_open_floor_with_the_integral_of_its_diffuse_lobe(
    floor: tuple[Scene, PixelSamples], kappa: float
) -> None:
    transport = floor[0].transport
    holes = through_holes(transport, SeenBackdrop(shell(np.full((8, 16, 3), 0.3))))
    assert holes is not None
    light = holes.irradiance(np.full(transport.n_patches, kappa))
    np.testing.assert_allclose(light.mean(0), 0.3 * (1 + kappa * MEAN_SCHLICK), rtol=0.002)
    np.testing.assert_allclose(holes.raised(2.0).irradiance(np.zeros(transport.n_patches)), 0.09, rtol=1e-3)
    assert through_holes(transport, SeenBackdrop(None)) is None


def test_one_side_of_a_backdrop_lights_the_floor_with_its_form_factor(floor: tuple[Scene, PixelSamples]) -> None:
    """The floor lies in the middle plane of the cube, whose top fills four rectangles of the sky of every point."""
    transport = floor[0].transport
    directions = equirect_directions(512, 256)
    top = directions[..., 2] >= np.abs(directions[..., :2]).max(-1)
    holes = through_holes(transport, SeenBackdrop(shell(np.where(top[..., None], 1.0, 0.0) * np.ones(3))))
    assert holes is not None
    point = transport.origins.position.mean(1)[:, :2].astype(np.float64)
    expected = sum(
        corner((SIDE + i * point[:, 0]) / SIDE, (SIDE + j * point[:, 1]) / SIDE) for i in (-1, 1) for j in (-1, 1)
    )
    light = holes.irradiance(np.zeros(transport.n_patches))[: transport.n_seen, 0]
    assert light.mean() == pytest.approx(np.mean(expected), rel=0.015)


def test_light_that_photos_show_and_light_that_they_do_not_add_up_to_all_light(
    floor: tuple[Scene, PixelSamples],
) -> None:
    """Of a picture painted on its right half, the left half brings what its twelve parts bring at its radiance."""
    transport = floor[0].transport
    painted = np.arange(16)[None] >= np.full((8, 1), 8)
    backdrop = SeenBackdrop(shell(np.full((8, 16, 3), 0.3)), painted)
    holes, kappa = through_holes(transport, backdrop), np.full(transport.n_patches, 0.5)
    assert holes is not None
    sources = replace(nothing_hidden(transport), holes=holes)
    shown, whole = sources.as_shown(unseen=True), sources.as_shown()
    assert shown.kind == OutsideKind(0, shown=True, unseen=True) and whole.kind == OutsideKind(0, shown=True)
    for kind in (shown.kind, whole.kind, OutsideKind(0)):
        assert sources.of_kind(kind).kind == kind
    parts = shown.start(np.full(3, 0.3))
    np.testing.assert_allclose(shown.irradiance(parts, kappa), whole.irradiance(np.zeros((0, 3)), kappa), rtol=1e-5)
    dark = shown.irradiance(np.zeros_like(parts), kappa)
    assert 0.3 < dark.mean() / whole.irradiance(np.zeros((0, 3)), kappa).mean() < 0.7
    assert shown.completed(backdrop, parts).radiance == pytest.approx(0.3)
    assert whole.completed(backdrop, parts) is backdrop


def corner(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Form factor of a rectangle, x and y times as large as its distance, at a point below its corner that faces it."""
    a, b = np.hypot(1, x), np.hypot(1, y)
    return (x / a * np.arctan(y / a) + y / b * np.arctan(x / b)) / (2 * np.pi)


def test_a_backdrop_brighter_than_a_surface_can_be_is_an_opening(floor: tuple[Scene, PixelSamples]) -> None:
    """A radiance of 50 on the left half of the backdrop, of 0.1 on the right, and an irradiance / pi of 1."""
    scene, _ = floor
    n, n_faces = scene.transport.n_patches, len(scene.face_emission)
    left = (np.arange(256) < 128)[None, :, None] * np.ones((128, 1, 3))
    backdrop = SeenBackdrop(shell(np.where(left, 50.0, 0.1)))
    dark = Lights(
        emitters=[],
        radiance=np.zeros((0, 3)),
        hidden_radiance=np.zeros((0, 3)),
        log_std=np.zeros(0),
        form_factors=np.zeros((n, 0, 2), np.float32),
        mask=np.zeros(n_faces, bool),
        irradiance=np.ones((n, 3)),
        patch_radiance=np.zeros((n, 3)),
    )
    problem = SimpleNamespace(tracer=scene.tracer, transport=scene.transport, regions=scene.regions, seed=0)
    surface = as_surface(backdrop, problem, dark, Progress())  # type: ignore[arg-type]
    assert surface is not None and surface.albedo is not None
    away = np.abs(np.arange(256) - 127.5) % 128 > 8  # from the seams
    sun, wall = left[0, :, 0].astype(bool) & away, ~left[0, :, 0].astype(bool) & away
    assert (surface.picture[:, sun] == 50).all() and not surface.albedo[:, sun].any()
    assert not surface.picture[:, wall].any()
    assert (surface.albedo[:, wall] > 0).all() and surface.albedo[:, wall].max() < 0.1001
