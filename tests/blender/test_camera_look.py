"""The recovered camera outside the engine: look-up tables, and the compositor group in Blender."""

from dataclasses import replace

import numpy as np
import pytest

from iris_addon.model.device import Device
from iris_addon.model.render_settings import RenderSettings
from iris_addon.model.response import Response, gamma
from iris_addon.results.camera_luts import shaper, unshaper, write_luts

BYTE = 1 / 255


def film() -> Response:
    """Three different curves with a toe and a shoulder, tinted."""
    x = np.linspace(0.0, 1.0, 1024)
    return Response(np.stack([x**0.4, 1.1 * x**0.5 / (1 + 0.1 * x), 2.6 * x**0.7 - 1.6 * x]), "file")


def radiance(n=2000) -> np.ndarray:
    """(n, 3) radiance over 18 stops and black."""
    values = np.exp(np.random.default_rng(0).uniform(np.log(1e-4), np.log(40.0), (n, 3)))
    values[:5] = 0.0
    return values


EXPOSURE = np.array([0.1, 0.2, 0.05])


def read_cube(path):
    lines = [line for line in path.read_text().splitlines() if not line.startswith("#")]
    kind, size = lines[0].split()
    return kind, int(size), np.array([line.split() for line in lines[1:]], float)


def test_the_tables_give_what_response_json_says(tmp_path):
    curve, L = film(), radiance()
    files = write_luts(tmp_path, curve, {"a": EXPOSURE})
    assert [path.name for path in files] == ["camera.cube", "camera_log.cube", "camera_3d.cube", "config.ocio"]
    assert "Küche_01" in write_luts(tmp_path, curve, {"Küche_01": EXPOSURE})[-1].read_text(encoding="utf-8")
    expected, x = curve.apply(L * EXPOSURE), L * EXPOSURE

    kind, size, table = read_cube(tmp_path / "camera.cube")
    assert (kind, size, len(table)) == ("LUT_1D_SIZE", 1024, 1024)
    seen = np.stack([np.interp(x[:, c], np.linspace(0, 1, size), table[:, c]) for c in range(3)], -1)
    np.testing.assert_allclose(seen, expected, atol=1e-6)

    kind, size, table = read_cube(tmp_path / "camera_log.cube")
    s = shaper(x)
    seen = np.stack([np.interp(s[:, c], np.linspace(0, 1, size), table[:, c]) for c in range(3)], -1)
    assert np.abs(seen - expected).max() < BYTE

    kind, size, table = read_cube(tmp_path / "camera_3d.cube")
    assert (kind, len(table)) == ("LUT_3D_SIZE", size**3)
    grid = table.reshape(size, size, size, 3)  # blue, green, red
    seen = np.stack(
        [
            np.interp(s[:, 0], np.linspace(0, 1, size), grid[0, 0, :, 0]),
            np.interp(s[:, 1], np.linspace(0, 1, size), grid[3, :, 5, 1]),
            np.interp(s[:, 2], np.linspace(0, 1, size), grid[:, 7, 2, 2]),
        ],
        -1,
    )
    assert np.abs(seen - expected).max() < BYTE


def test_the_shaper_holds_hdr_values():
    x = np.array([2.0**-14, 1e-3, 0.5, 1.0, 3.9])
    np.testing.assert_allclose(unshaper(shaper(x))[1:], x[1:], rtol=1e-12)
    assert shaper(np.array(1.0)) == 0.875
    assert shaper(np.array([0.0, 1e9])).tolist() == [0.0, 1.0]


def test_opencolorio_shows_each_photo(tmp_path):
    ocio = pytest.importorskip("PyOpenColorIO", reason="PyOpenColorIO is not installed")
    curve, L = film(), radiance(50).astype(np.float32)
    write_luts(tmp_path, curve, {"000_0001": EXPOSURE, "dark": EXPOSURE / 4})
    config = ocio.Config.CreateFromFile(str(tmp_path / "config.ocio"))
    config.validate()
    for name, exposure in (("000_0001", EXPOSURE), ("dark", EXPOSURE / 4)):
        transform = ocio.DisplayViewTransform(src="Linear Rec.709", display="Camera", view=name)
        cpu = config.getProcessor(transform).getDefaultCPUProcessor()
        seen = np.array([cpu.applyRGB(pixel.tolist()) for pixel in L])
        assert np.abs(seen - curve.apply(L * exposure)).max() < BYTE


# ---- Blender -------------------------------------------------------------------------------------------------------


@pytest.fixture
def scene():
    bpy = pytest.importorskip("bpy")
    bpy.ops.wm.read_factory_settings(use_empty=True)
    return bpy.context.scene


def through_blender(scene, picture, tmp_path):
    """(H, W, 3) what a PNG of the composited scene holds."""
    import bpy

    from iris_addon.blender.images import read_pixels

    settings = scene.render.image_settings
    settings.file_format, settings.color_mode = "PNG", "RGB"
    bpy.ops.render.render(scene=scene.name)
    bpy.data.images["Render Result"].save_render(str(tmp_path / picture), scene=scene)
    return read_pixels(tmp_path / picture)[..., :3]


@pytest.mark.bpy
def test_the_compositor_group_develops_radiance_into_the_photo(scene, tmp_path):
    import bpy

    from iris_addon.blender.apply.camera_look import set_photo, show_through_camera
    from iris_addon.blender.images import LINEAR, image_from_array
    from iris_addon.blender.version import own_compositor_tree

    L = radiance(48 * 40).reshape(40, 48, 3)
    tree = own_compositor_tree(scene)
    tree.nodes.clear()
    picture = tree.nodes.new("CompositorNodeImage")
    picture.image = image_from_array("radiance", L, colorspace=LINEAR, float_buffer=True)
    node = show_through_camera(scene, picture.outputs["Image"], film(), EXPOSURE)
    eye = bpy.data.objects.new("eye", bpy.data.cameras.new("eye"))
    scene.collection.objects.link(eye)
    scene.camera, scene.render.resolution_x, scene.render.resolution_y = eye, 48, 40
    for exposure in (EXPOSURE, EXPOSURE / 8):
        set_photo(node, exposure)
        seen = through_blender(scene, "seen.png", tmp_path)
        assert np.abs(seen - film().apply(L * exposure)).max() < BYTE


@pytest.mark.bpy
def test_a_cycles_render_through_the_camera_is_the_developed_render(scene, tmp_path):
    from iris_addon.blender.apply.camera_look import show_through_camera
    from iris_addon.blender.camera import add_camera, look_through
    from iris_addon.blender.render.cycles import render_views, set_cycles
    from iris_addon.blender.scene_out.build import build_scene
    from iris_addon.blender.version import own_compositor_tree
    from tests.blender_room import camera, room

    result, view = replace(room(emission={4: (9, 6, 3)}), response=gamma()), camera(24, 18)
    settings = RenderSettings(samples=16, denoise=False, seed=2, max_bounces=4)
    (expected,) = render_views(result, [view], settings=settings)
    built = build_scene(result)
    set_cycles(built.scene, settings)
    look_through(built.scene, view, add_camera(view, "view", built.scene.collection))
    layers = own_compositor_tree(built.scene).nodes.new("CompositorNodeRLayers")
    layers.scene = built.scene
    show_through_camera(built.scene, layers.outputs["Image"], result.response, EXPOSURE)
    seen = through_blender(built.scene, "render.png", tmp_path)
    assert np.abs(seen - result.response.apply(expected * EXPOSURE)).max() < BYTE


@pytest.mark.bpy
def test_matching_photos_is_undone_exactly(scene, tmp_path):
    from iris_addon.blender.apply.camera_look import follow_photo, match_photo, stop_matching
    from iris_addon.blender.camera import add_camera, look_through
    from iris_addon.blender.render.cycles import render_linear, set_cycles
    from iris_addon.blender.scene_out.build import build_scene
    from tests.blender_room import camera, room
    from tests.scene_snapshot import snapshot

    view = camera(24, 18)
    built = build_scene(room(emission={4: (9, 6, 3)}))
    set_cycles(built.scene, RenderSettings(samples=16, denoise=False, seed=2, max_bounces=4))
    look_through(built.scene, view, add_camera(view, "view", built.scene.collection))
    built.scene.view_settings.exposure = 1.5
    radiance = render_linear(built.scene)
    before = snapshot(built.scene)
    exposures = {"bright": EXPOSURE, "dark": EXPOSURE / 8}

    match_photo(built.scene, film(), exposures, "bright")
    for photo, exposure in (("bright", EXPOSURE), ("dark", EXPOSURE / 8), ("another", 4.5 * EXPOSURE / 8)):
        follow_photo(built.scene, photo)
        seen = through_blender(built.scene, "seen.png", tmp_path)
        assert np.abs(seen - film().apply(radiance * exposure)).max() < BYTE
    stop_matching(built.scene)
    assert snapshot(built.scene) == before
    stop_matching(built.scene)
    follow_photo(built.scene, "dark")
    assert snapshot(built.scene) == before


@pytest.mark.bpy
def test_the_camera_comes_last_in_an_existing_compositing(scene):
    from iris_addon.blender.apply.camera_look import CAMERA_GROUP, match_photo, stop_matching
    from iris_addon.blender.version import own_compositor_tree
    from tests.scene_snapshot import blurred, snapshot

    blur, tree = blurred(scene), own_compositor_tree(scene)
    before = snapshot(scene)
    for _twice in range(2):
        match_photo(scene, film(), {"a": EXPOSURE}, "a")
        assert tree.nodes[CAMERA_GROUP].inputs["Image"].links[0].from_node == blur
        assert sum(node.bl_idname == blur.bl_idname for node in tree.nodes) == 1
    stop_matching(scene)
    assert snapshot(scene) == before


def test_photos_of_another_camera_pass_through_its_tables(tmp_path):
    second = Device("Acme Two", gamma(0.3), photos=("b",))
    files = write_luts(tmp_path, film(), {"a": EXPOSURE, "b": EXPOSURE}, [second])
    assert [path.name for path in files[3:]] == [
        "camera_2.cube",
        "camera_2_log.cube",
        "camera_2_3d.cube",
        "config.ocio",
    ]
    _, _, table = read_cube(tmp_path / "camera_2.cube")
    np.testing.assert_allclose(table, second.response.samples.T, atol=1e-6)
    text = files[-1].read_text(encoding="utf-8")
    for name, cube in (("a", "camera.cube"), ("b", "camera_2.cube")):
        assert cube in text.split(f'name: "photo {name}"')[1].split("ColorSpace")[0]


@pytest.mark.bpy
def test_the_curve_follows_the_camera_of_the_photo(scene, tmp_path):
    from iris_addon.blender.apply.camera_look import follow_photo, keep_look, kept_look, match_photo
    from iris_addon.blender.camera import add_camera, look_through
    from iris_addon.blender.render.cycles import render_linear, set_cycles
    from iris_addon.blender.scene_out.build import build_scene
    from tests.blender_room import camera, room

    view, built = camera(24, 18), build_scene(room(emission={4: (9, 6, 3)}))
    set_cycles(built.scene, RenderSettings(samples=16, denoise=False, seed=2, max_bounces=4))
    look_through(built.scene, view, add_camera(view, "view", built.scene.collection))
    radiance = render_linear(built.scene)
    exposures, second = {"a": EXPOSURE, "b": EXPOSURE / 2}, gamma(0.3)
    keep_look(built.scene, film(), exposures, [Device("Acme Two", second, photos=("b",))])
    match_photo(built.scene, *kept_look(built.scene, "b"), "b")
    for photo, response in (("b", second), ("a", film()), ("b", second)):
        follow_photo(built.scene, photo)
        seen = through_blender(built.scene, "seen.png", tmp_path)
        assert np.abs(seen - response.apply(radiance * exposures[photo])).max() < BYTE
