"""Pictures of looks out of light shares: each is what a render in that look shows; icons and the wipe take them."""

import sys
from dataclasses import replace

import bpy
import numpy as np
import pytest

from iris_addon.blender.apply.look_gains import gains_of_look, gains_of_own, look_radiance
from iris_addon.blender.apply.looks import keep_states, offered_looks, save_look, set_look, set_own_look
from iris_addon.blender.apply.on_objects import apply_to_objects
from iris_addon.blender.camera import add_camera, look_through
from iris_addon.blender.insert.look_shares import look_shares_file, render_look_shares
from iris_addon.blender.insert.photo_composite import write_room_copy
from iris_addon.blender.render.cycles import render_linear, set_cycles
from iris_addon.blender.render.light_mixing import stop_mixing
from iris_addon.blender.scene_out.lights import lamp_materials, set_color, set_strength, switch
from iris_addon.blender.scene_out.world import sky_strength
from iris_addon.model.recovered import LightState, OutsideLight, Sunlight
from iris_addon.model.render_settings import RenderSettings
from tests.blender_home import build_package, in_blender
from tests.blender_room import camera
from tests.solved_scene import cube, solve

pytestmark = pytest.mark.bpy

QUICK = RenderSettings(samples=128, denoise=False, max_bounces=3)
SKY = OutsideLight(np.array([[0.3, 0.8, 1.6], [0, 0, 0], [0.1, 0.0, 0.6], [0, 0, 0]]) / 0.28209479)
SUN = Sunlight(np.array([0.3, 0.2, 0.93]) / np.linalg.norm([0.3, 0.2, 0.93]), np.array([3.0, 2.0, 1.0]))


@pytest.fixture
def scene() -> bpy.types.Scene:
    """A box open to a colored sky and the sun, with a wall that is a lamp, seen from within."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    box = cube("box")
    import bmesh

    mesh = bmesh.new()
    mesh.from_mesh(box.data)
    bmesh.ops.delete(mesh, geom=[face for face in mesh.faces if face.calc_center_median().z > 0.9], context="FACES")
    mesh.to_mesh(box.data)
    mesh.free()
    result, runs = solve(lamp_faces=[2, 3])
    apply_to_objects(replace(result, outside=SKY, sun=SUN), runs, scene, "key")
    look_through(scene, camera(), add_camera(camera(16, 12, position=(0, 0, 0.6)), "eye", scene.collection))
    bpy.context.view_layer.update()
    return scene


def seen(scene: bpy.types.Scene) -> np.ndarray:
    set_cycles(scene, QUICK)
    return render_linear(scene)


def test_the_picture_of_every_look_is_a_render_in_that_look(scene):
    shares = render_look_shares(scene, 16, QUICK)
    stop_mixing(scene)
    assert set(shares) == {"lamp 7", "outside", "overcast", "sun"}
    assert len(offered_looks(scene)) == 6
    for key in offered_looks(scene):
        set_look(scene, key)
        mixed, rendered = look_radiance(shares, gains_of_look(scene, key)), seen(scene)
        np.testing.assert_allclose(mixed.mean((0, 1)), rendered.mean((0, 1)), rtol=0.04, atol=1e-4, err_msg=key)
        rough = np.abs(mixed - rendered).mean() / max(rendered.mean(), 1e-4)
        assert rough < 0.25, (key, rough)


def test_own_looks_are_mixed_too_unless_no_share_shows_them(scene):
    shares = render_look_shares(scene, 16, QUICK)
    stop_mixing(scene)
    (lamp,) = lamp_materials(scene.objects)
    set_strength(lamp, 2.0)
    set_color(lamp, (0.2, 0.5, 1.0))
    sky_strength(scene.world).default_value = 0.4
    save_look(scene, "Dusk")
    rendered = seen(scene)
    set_look(scene, "BLACKOUT")
    mixed = look_radiance(shares, gains_of_own(scene, "Dusk"))
    np.testing.assert_allclose(mixed.mean((0, 1)), rendered.mean((0, 1)), rtol=0.04)
    set_own_look(scene, "Dusk")
    switch(lamp, False)
    save_look(scene, "Off")
    off = look_radiance(shares, gains_of_own(scene, "Off"))
    np.testing.assert_allclose(off.mean((0, 1)), seen(scene).mean((0, 1)), rtol=0.04)
    next(thing for thing in scene.objects if thing.type == "LIGHT").rotation_euler.x += 0.5
    save_look(scene, "Turned")
    assert gains_of_own(scene, "Turned") is None and gains_of_own(scene, "none") is None


def test_a_light_state_has_a_picture_where_its_lights_shine_in_the_first(scene):
    result, _ = solve(lamp_faces=[2, 3])
    first = LightState("first", ("a",), np.array([[3.0, 6.0, 1.5]]), outside=SKY, sun=SUN)
    dim = LightState("dim", ("b",), np.array([[1.5, 3.0, 0.75]]), outside=OutsideLight(SKY.sh / 2))
    keep_states(scene, replace(result, outside=SKY, sun=SUN, light_states=(first, dim)))
    gains = gains_of_own(scene, "dim")
    np.testing.assert_allclose(gains["lamp 7"], 0.5)
    np.testing.assert_allclose(gains["outside"], 0.5, rtol=1e-5)
    assert not gains["sun"].any()
    np.testing.assert_allclose(gains_of_own(scene, "first")["sun"], 1.0, rtol=1e-5)


def test_the_job_has_the_recovered_light_whatever_stands_in_the_scene(scene, tmp_path):
    expected = {name: share.mean((0, 1)) for name, share in render_look_shares(scene, 16, QUICK).items()}
    stop_mixing(scene)
    set_look(scene, "BLACKOUT")
    bulb = bpy.data.objects.new("bulb", bpy.data.lights.new("bulb", "POINT"))
    bulb.data.energy = 1e4
    scene.collection.objects.link(bulb)
    write_room_copy(scene, tmp_path / "copy.blend")
    look_shares_file(tmp_path / "copy.blend", tmp_path / "looks" / "eye.npz", width=16, settings=QUICK)
    with np.load(tmp_path / "looks" / "eye.npz") as shares:
        assert set(shares) == set(expected)
        for name in shares:
            np.testing.assert_allclose(shares[name].astype(float).mean((0, 1)), expected[name], rtol=0.02, atol=1e-3)


@pytest.mark.skipif(sys.platform == "win32", reason="as the other tests of the package")
def test_looks_have_icons_and_the_wipe_goes_to_one(tmp_path):
    """In the solved demo, by one small render: the look of the photos resembles the photo, blackout is black."""
    body = """
    import numpy as np
    assert bpy.ops.iris.open_demo() == {"FINISHED"}
    settings = scene.iris
    icons, wipe = (sys.modules[f"{KEY}.operators.ui.look_icons"], sys.modules[f"{KEY}.operators.ui.wipe"])
    settings.view_index = 3
    assert icons.look_icon(scene, "LOOK PHOTOGRAPHED") == 0 and not icons.has_shares(scene)
    settings.wipe_to = "LOOK PHOTOGRAPHED"
    assert wipe.wiped_picture(scene) is None and settings.wipe_before is None
    assert bpy.ops.iris.look_pictures(width=80, samples=16) == {"FINISHED"}
    assert not list(Path(settings.result).glob("looks.blend"))
    drawn = icons.icons._icons  # in background they have pixels, but no number

    def icon(look):
        before = set(drawn)
        icons.look_icon(scene, look)
        (made,) = set(drawn) - before or {None}
        return made and np.array(drawn[made].image_pixels_float).reshape(80, 80, 4)

    photographed, black = icon("LOOK PHOTOGRAPHED"), icon("LOOK BLACKOUT")
    assert (photographed[10:70, :, 3] == 1).all() and not photographed[:10].any()  # 80 by 60 in a square
    assert photographed[10:70, :, :3].mean() > 0.2 and black[..., :3].max() == 0
    assert icon("LOOK PHOTOGRAPHED") is None  # it is there

    def display(image):
        width, height = image.size
        values = np.array(image.pixels[:]).reshape(height, width, -1)[..., :3]
        return values[: height // 60 * 60].reshape(60, height // 60, 80, width // 80, 3).mean((1, 3))

    before = wipe.wiped_picture(scene)  # the render showed what had been chosen
    assert tuple(before.size) == (80, 60) and before.packed_file
    photo = wipe.wiped_photo(scene)
    a, b = display(before), display(photo)
    error = float(np.sqrt(np.mean((a - b) ** 2)))
    assert error < 0.12, error
    settings.wipe_to = "LOOK BLACKOUT"
    assert display(wipe.wiped_picture(scene)).max() == 0
    lamp = settings.lamps[0]
    lamp.on = False
    bpy.ops.iris.save_look(name="Dark")
    settings.wipe_to = "OWN Dark"
    dark = display(wipe.wiped_picture(scene))
    assert 0.02 < dark.mean() < 0.9 * a.mean(), (dark.mean(), a.mean())
    assert abs(icon("OWN Dark")[10:70, :, :3].mean() - dark.mean()) < 0.01
    settings.view_index = 4  # no shares of this view: the icons are those of the other
    assert wipe.wiped_picture(scene) is None and icon("LOOK PHOTOGRAPHED") is None
    settings.wipe_to = "PHOTO"
    assert wipe.wiped_picture(scene) == wipe.wiped_photo(scene) != photo
    report = Path(settings.result) / "report.json"
    os.utime(report)  # solved anew
    drawn.clear()
    assert icon("LOOK PHOTOGRAPHED") is None
    """
    in_blender(build_package(tmp_path / "iris.zip"), tmp_path, body)
