"""The backdrop: painted where the missing surfaces are, and shown in Blender without adding light."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np
import pytest
from scipy.spatial import ConvexHull

from iris_addon.blender.apply.on_objects import apply_to_objects, restore
from iris_addon.blender.apply.scene_files import apply
from iris_addon.blender.camera import add_camera, look_through
from iris_addon.blender.insert.differential import coverage
from iris_addon.blender.render.cycles import render_views
from iris_addon.blender.render.light_groups import render_light_shares
from iris_addon.blender.scene_in.scene_capture import read_scene_mesh
from iris_addon.blender.scene_out.backdrop import BACKDROP
from iris_addon.blender.scene_out.build import build_scene
from iris_addon.edits.scene_edit import SceneEdit, Sphere
from iris_addon.lighting.backdrop import BACKDROP_MIN_SHARE, fit_backdrop
from iris_addon.model.capture import Mesh, View
from iris_addon.model.recovered import Backdrop, Emitter, OutsideLight
from iris_addon.model.render_settings import RenderSettings
from iris_addon.model.response import gamma, identity
from iris_addon.model.sphere import equirect_directions, equirect_texels, sh_basis
from iris_addon.response.photometry import Photometry
from iris_addon.results.result import Result
from iris_addon.surface.photo_samples import BackdropPixels
from tests.blender_room import box, camera, room
from tests.box_room import look_at

CORNERS = np.array([[x, y, z] for x in (0.0, 5.0) for y in (0.0, 4.0) for z in (0.0, 2.5)])
CAMERAS = np.array([[1.0, 1.0, 1.5], [4.0, 0.8, 1.2], [2.5, 2.0, 0.9]])
ROOM = Mesh(CORNERS, box().faces)


def views_at(positions: np.ndarray) -> list[View]:
    return [View(str(k), camera(position=tuple(position)), None) for k, position in enumerate(positions)]


VIEWS = views_at(CAMERAS)
QUICK = RenderSettings(samples=16, denoise=False)


def paint(points: np.ndarray) -> np.ndarray:
    """(n, 3) radiance of the wall y = 4: stripes half a metre wide, brighter towards the top."""
    stripe = 0.3 + 0.25 * np.sin(2 * np.pi * points[:, 0] / 1.0)
    return (stripe * (0.6 + 0.2 * points[:, 2]))[:, None] * [1.0, 0.8, 0.6]


def seen(rng: np.random.Generator, n: int, hidden: float = 0.0, share: float = 0.1) -> BackdropPixels:
    """Pixels of a gamma camera that show the wall y = 4, of which the mesh has nothing; something dark stands before
    ``hidden`` of them, for the first camera alone."""
    points = rng.uniform([0.2, 4, 0.2], [4.8, 4, 2.3], (n, 3))
    view = rng.integers(len(CAMERAS), size=n)
    direction = points - CAMERAS[view]
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    radiance = paint(points)
    radiance[(view == 0) & (rng.random(n) < hidden)] = 0.01
    z = gamma().apply(radiance).astype(np.float32)
    return BackdropPixels(
        share=share, view=view.astype(np.int16), pixel=np.zeros(n, np.int32), direction=direction, z=z
    )


PHOTOMETRY = Photometry(
    response=gamma(), exposures=np.ones((3, 1)) * np.ones(3), held_out=0.0, per_channel=False, known_exposures=True
)


@pytest.mark.parametrize("hidden", [0.0, 0.5])
def test_a_missing_wall_is_painted_in_its_place(hidden: float) -> None:
    """Stripes seen from three places are one set of stripes: by directions alone they would be blurred to grey."""
    rng = np.random.default_rng(0)
    found = fit_backdrop(seen(rng, 60000, hidden), PHOTOMETRY, ROOM, VIEWS).recovered
    assert found is not None
    points = rng.uniform([0.5, 4, 0.5], [4.5, 4, 2.0], (2000, 3))
    height, width = found.picture.shape[:2]
    shown = found.picture.reshape(-1, 3)[equirect_texels(points - found.centre, width, height)]
    error = np.abs(shown / paint(points) - 1)
    assert np.median(error) < 0.08 and np.quantile(error, 0.9) < 0.25
    assert np.isfinite(found.picture).all() and found.picture.min() >= 0


def test_what_no_photo_shows_is_known_as_such_and_takes_the_radiance_it_is_given() -> None:
    """Photos show the wall y = 4 alone; the rest of the shell falls into parts."""
    rng = np.random.default_rng(0)
    backdrop = fit_backdrop(seen(rng, 60000), PHOTOMETRY, ROOM, VIEWS)
    assert backdrop.recovered is not None
    height, width = backdrop.recovered.picture.shape[:2]

    def part(points: np.ndarray) -> np.ndarray:
        return backdrop.unseen[equirect_texels(points - backdrop.recovered.centre, width, height)]

    wall = rng.uniform([0.5, 4, 0.5], [4.5, 4, 2.0], (2000, 3))
    opposite = rng.uniform([0.5, 0, 0.5], [4.5, 0, 2.0], (2000, 3))
    assert (part(wall) == -1).mean() > 0.98 and (part(opposite) >= 0).all()
    lit = backdrop.with_unseen(np.arange(12.0)[:, None] * np.ones(3))
    dark = backdrop.unseen < 0
    np.testing.assert_array_equal(lit.radiance[dark], backdrop.radiance[dark])
    np.testing.assert_array_equal(lit.radiance[~dark, 0], backdrop.unseen[~dark])
    np.testing.assert_array_equal(lit.unseen, backdrop.unseen)


def assert_within(points: list[np.ndarray], shell: Backdrop) -> None:
    """All points lie before all faces of the shell, which are seen from within."""
    a, b, c = np.moveaxis(shell.vertices[shell.faces], 1, 0)
    normal = np.cross(b - a, c - a)
    for point in points:
        assert (np.einsum("fc,fc->f", normal, point - a) > 0).all()


def test_the_shell_encloses_mesh_and_cameras_and_faces_inwards() -> None:
    rng = np.random.default_rng(1)
    outside = np.vstack([CAMERAS, [[2.0, -1.5, 1.0]]])  # a photographer in the door
    found = fit_backdrop(seen(rng, 500), PHOTOMETRY, ROOM, views_at(outside)).recovered
    assert found is not None
    assert_within([*CORNERS, *outside], found)


def test_the_shell_encloses_a_recessed_pane() -> None:
    """No direction in which the pane's corners lie furthest out need be among those that the shell is drawn from."""
    pane = np.array([[x, 4.15, z] for x in (1.7, 3.3) for z in (0.9, 2.1)])
    recessed = Mesh(np.vstack([CORNERS, pane]), np.vstack([box().faces, [[8, 9, 11], [8, 11, 10]]]))
    found = fit_backdrop(seen(np.random.default_rng(1), 500), PHOTOMETRY, recessed, VIEWS).recovered
    assert found is not None
    assert_within([*CORNERS, *pane], found)


def test_no_backdrop_without_holes_or_without_a_room() -> None:
    rng = np.random.default_rng(2)
    assert fit_backdrop(seen(rng, 500, share=BACKDROP_MIN_SHARE / 2), PHOTOMETRY, ROOM, VIEWS).recovered is None
    flat = replace(ROOM, vertices=CORNERS * [1, 1, 0])
    assert fit_backdrop(seen(rng, 500), PHOTOMETRY, flat, views_at(CAMERAS * [1, 1, 0])).recovered is None


def test_a_stray_vertex_does_not_stretch_the_shell() -> None:
    stray = replace(ROOM, vertices=np.vstack([CORNERS, [[1e3, 0, 0]]]))
    found = fit_backdrop(seen(np.random.default_rng(4), 500), PHOTOMETRY, stray, VIEWS).recovered
    assert found is not None and np.abs(found.vertices).max() < 6


@pytest.mark.parametrize("lit", [0.0, 0.3])
def test_a_backdrop_that_is_mostly_black_is_dark_and_finite(lit: float) -> None:
    """Renders before an empty world: half of the pixels and more are exactly zero."""
    rng = np.random.default_rng(3)
    pixels = seen(rng, 3000)
    radiance = np.where(rng.random((3000, 1)) < lit, 0.5, 0.0) * np.ones(3)
    pixels = replace(pixels, z=radiance.astype(np.float32))
    found = fit_backdrop(
        pixels,
        Photometry(
            response=identity(), exposures=np.ones((3, 3)), held_out=np.nan, per_channel=False, known_exposures=True
        ),
        ROOM,
        VIEWS,
    ).recovered
    assert found is not None and np.isfinite(found.picture).all()
    assert found.picture.min() >= 0 and found.picture.max() <= (0.5 if lit else 0.0)


def test_directions_and_texels_are_inverse() -> None:
    directions = equirect_directions(32, 16).reshape(-1, 3)
    assert (equirect_texels(7 * directions, 32, 16) == np.arange(32 * 16)).all()
    assert (equirect_directions(32, 16)[0, :, 2] > 0.99).all()


# ---- in Blender ----------------------------------------------------------------------------------------------------


def open_room(albedo: float = 0.8) -> Result:
    """A dark box of 2 m without its +z and -z sides, before a shell of twice its size whose colours are directions."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    mesh = box()
    shell = box(4.0)
    picture = (0.5 + 0.4 * equirect_directions(512, 256)).astype(np.float32)
    # The faces of the box look outwards.
    backdrop = Backdrop(shell.vertices, inward(shell), picture)
    result = room(albedo=albedo, mesh=Mesh(mesh.vertices, mesh.faces[:-4], mesh.uv[:-4]))
    return replace(result, backdrop=backdrop)


def inward(shell: Mesh) -> np.ndarray:
    a, b, c = np.moveaxis(shell.vertices[shell.faces], 1, 0)
    outward = np.einsum("fc,fc->f", np.cross(b - a, c - a), a) > 0
    return np.where(outward[:, None], shell.faces[:, ::-1], shell.faces)


@pytest.mark.bpy
def test_cameras_see_the_backdrop_with_parallax_and_it_lights_nothing_diffuse() -> None:
    result = open_room()
    view = camera(position=(0.5, 0.3, 0.6))
    origin, direction = view.rays()
    at = origin + direction * ((-2.0 - origin[:, 2]) / direction[:, 2])[:, None]
    through = (np.abs(origin + direction * ((-1.0 - 0.6) / direction[:, 2])[:, None])[:, :2] < 0.9).all(1)
    side = (np.abs(at[:, :2]) < 1.95).all(1)
    (image,) = render_views(result, [view], settings=QUICK)
    image = image.reshape(-1, 3)
    expected = 0.5 + 0.4 * at / np.linalg.norm(at, axis=1, keepdims=True)
    assert (through & side).sum() > 20
    np.testing.assert_allclose(image[through & side], expected[through & side], atol=0.01)
    wall = (np.abs(origin + direction * ((-0.9 - 0.6) / direction[:, 2])[:, None])[:, :2] > 1.1).any(1)
    assert wall.sum() > 20 and image[wall].mean() < 0.05  # what a varnish of 4 % reflects
    (half,) = render_views(result, [view], edit=SceneEdit(outside_scale=0.5), settings=QUICK)
    np.testing.assert_allclose(half.reshape(-1, 3)[through & side], 0.5 * expected[through & side], atol=0.01)


@pytest.mark.bpy
@pytest.mark.parametrize("roughness", [0.0, 0.25])
def test_reflections_show_the_backdrop_and_not_the_light_from_outside(roughness: float) -> None:
    """A ball before the camera reflects what is behind it, through the open side the camera looks in by."""
    ball = Sphere(center=np.zeros(3), radius=0.5, base_color=np.ones(3), roughness=roughness, metallic=1.0)
    view = camera(position=(0, 0, 3), fx=60.0, fy=60.0)
    result = replace(open_room(), outside=OutsideLight(np.array([[0.2, 0.2, 0.2]]) / sh_basis(np.eye(3)[2:], 1)))
    (image,) = render_views(result, [view], edit=SceneEdit(spheres=(ball,)), settings=QUICK)
    middle = image[view.height // 2 - 1 : view.height // 2 + 2, view.width // 2 - 1 : view.width // 2 + 2].mean((0, 1))
    np.testing.assert_allclose(middle, [0.5, 0.5, 0.88], atol=0.05)


@pytest.mark.bpy
def test_the_backdrop_is_invisible_from_outside() -> None:
    result = open_room()
    view = camera(position=(0, 0, 6), fx=30.0, fy=30.0)
    lit = replace(result, emitters=room(emission={2: (3, 2, 1)}).emitters)
    (with_shell,) = render_views(lit, [view], settings=QUICK)
    (without,) = render_views(replace(lit, backdrop=None), [view], settings=QUICK)
    lamp = (without[..., 0] > 1).reshape(-1)
    assert lamp.sum() > 3
    means = [image.reshape(-1, 3)[lamp].mean(0) for image in (with_shell, without)]
    np.testing.assert_allclose(*means, rtol=0.05)  # the shell's picture is nowhere above 0.9


def sphere(radius: float, rings: int = 24) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and inward faces of a ball about the origin."""
    polar, azimuth = np.meshgrid(np.linspace(0, np.pi, rings + 1)[1:-1], np.arange(2 * rings) * np.pi / rings)
    ring = np.stack([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)], -1)
    hull = ConvexHull(radius * np.vstack([ring.reshape(-1, 3), [[0, 0, 1], [0, 0, -1]]]))
    return hull.points, inward(Mesh(hull.points, hull.simplices))


def lamp_in_a_shell(picture: np.ndarray, albedo: np.ndarray) -> Result:
    """A ball of 0.1 m that shines with a radiance of 5 in the middle of one of 2 m."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    vertices, faces = sphere(0.1)
    lit = room(albedo=0.0, mesh=Mesh(vertices, faces, np.zeros((len(faces), 3, 2), np.float32)))
    lamp = Emitter(id=0, faces=np.arange(len(faces)), radiance=np.full(3, 5.0), area=1.0, confidence=1.0)
    shell = Backdrop(*sphere(2.0), picture.astype(np.float32), albedo.astype(np.float32))
    return replace(lit, emitters=(lamp,), backdrop=shell)


@pytest.mark.bpy
@pytest.mark.parametrize("albedo", [0.3, 0.7])
def test_a_reflecting_backdrop_is_an_integrating_sphere(albedo: float) -> None:
    """A lamp of radiance L in the middle: the wall has one of a / (1 - a) L times the ratio of their areas."""
    result = lamp_in_a_shell(np.zeros((8, 16, 3)), np.full((8, 16, 3), albedo))
    (image,) = render_views(
        result, [camera(position=(0, 0, -0.5))], settings=RenderSettings(samples=256, denoise=False)
    )
    expected = albedo / (1 - albedo) * 5.0 * (0.1 / 2.0) ** 2
    assert image.mean() == pytest.approx(expected, rel=0.03)


@pytest.mark.bpy
def test_openings_of_the_backdrop_do_not_depend_on_the_lamps() -> None:
    """Its half towards +x has no albedo: one sees its own picture there, and the world behind it."""
    ahead = (equirect_directions(128, 64)[..., :1] > 0) * np.ones(3)
    result = lamp_in_a_shell(0.4 * ahead, 0.5 * (1 - ahead))
    view = replace(camera(fx=20.0, fy=20.0), c2w=look_at(np.array([0.5, 0, 0]), np.array([1.0, 0, 0])))
    for scale, world in ((1.0, 0.0), (0.5, 0.0), (0.5, 0.3)):
        outside = OutsideLight(np.full((1, 3), world) / sh_basis(np.eye(3)[2:], 1))
        lit = replace(result, outside=outside)
        (image,) = render_views(lit, [view], edit=SceneEdit(outside_scale=scale), settings=QUICK)
        np.testing.assert_allclose(image, scale * (0.4 + world), rtol=0.01)


@pytest.mark.bpy
def test_the_backdrop_follows_light_from_outside_in_a_mix() -> None:
    shares = render_light_shares(open_room(), camera(), settings=RenderSettings(samples=4, denoise=False))
    assert set(shares.shares) == {"IRIS Outside"}
    np.testing.assert_allclose(shares.shares["IRIS Outside"], shares.combined, atol=1e-5)
    assert shares.combined.max() > 0.1


@pytest.mark.bpy
def test_the_backdrop_counts_as_the_room_when_an_object_is_inserted() -> None:
    built = build_scene(open_room())
    assert built.backdrop is not None
    look_through(built.scene, camera(), add_camera(camera(), "view", built.scene.collection))
    assert not coverage(built.scene, [built.room, built.backdrop]).any()
    built.free()


@pytest.mark.bpy
def test_the_blend_contains_the_backdrop_and_the_glb_does_not(tmp_path: Path) -> None:
    apply(open_room(), tmp_path / "room.blend", glb=tmp_path / "room.glb")
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "room.blend"))
    assert BACKDROP in bpy.context.scene.objects and bpy.data.images[BACKDROP].packed_file
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.import_scene.gltf(filepath=str(tmp_path / "room.glb"))
    assert BACKDROP not in bpy.data.objects and "IRIS Room Mesh" in bpy.data.objects


@pytest.mark.bpy
def test_the_backdrop_is_no_region_and_is_removed_when_objects_are_restored() -> None:
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.mesh.primitive_cube_add()
    scene = bpy.context.scene
    before = read_scene_mesh(bpy.context.evaluated_depsgraph_get())
    n = len(before.mesh.faces)
    result = replace(open_room_result(before.mesh), backdrop=open_shell())
    assert apply_to_objects(result, before.runs, scene, "key")
    assert BACKDROP in scene.objects
    bpy.context.view_layer.update()
    assert len(read_scene_mesh(bpy.context.evaluated_depsgraph_get()).mesh.faces) == n
    restore(scene)
    assert BACKDROP not in scene.objects and BACKDROP not in bpy.data.materials


def open_shell() -> Backdrop:
    shell = box(4.0)
    return Backdrop(shell.vertices, inward(shell), np.full((4, 8, 3), 0.5, np.float32))


def open_room_result(mesh: Mesh) -> Result:
    return room(mesh=Mesh(mesh.vertices, mesh.faces, np.zeros((len(mesh.faces), 3, 2), np.float32)))
