"""The artist's own scene onto the photo agrees with an insertion job, and is the photo where nothing was changed."""

from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np
import OpenEXR
import pytest
from mathutils import Matrix

from iris_addon.base.color_spaces import ACESCG, REC709
from iris_addon.base.errors import BadInput
from iris_addon.blender.apply.applied_states import has_light_states
from iris_addon.blender.apply.looks import keep_states, set_own_look
from iris_addon.blender.apply.on_objects import apply_to_objects, restore
from iris_addon.blender.camera import add_camera, look_through
from iris_addon.blender.images import image_from_array, read_image
from iris_addon.blender.insert.differential import insert_onto_photo
from iris_addon.blender.insert.photo_composite import composite, write_copy
from iris_addon.blender.render.cycles import render_views
from iris_addon.blender.scene_in.scene_capture import whole_object
from iris_addon.blender.scene_out.build import add_sphere, plain_mesh
from iris_addon.blender.scene_out.lights import lamp_materials, lamp_setting, set_strength
from iris_addon.edits.scene_edit import SceneEdit, Sphere
from iris_addon.model.recovered import LightState
from iris_addon.model.render_settings import RenderSettings
from iris_addon.model.response import gamma
from iris_addon.results.folder import save_result
from iris_addon.results.result import Result
from tests.blender_room import camera, room

pytestmark = pytest.mark.bpy

EXPOSURE = np.full(3, 0.2)
VIEW = camera(40, 30, fx=24.0, fy=24.0, position=(0, 0, 0.6))
BALL = Sphere(
    center=np.array([0.0, -0.5, -0.4]), radius=0.3, base_color=np.array([0.2, 0.6, 0.2]), roughness=0.3, metallic=0.0
)


@pytest.fixture(autouse=True)
def empty_blender():
    bpy.ops.wm.read_factory_settings(use_empty=True)


def lit_room() -> Result:
    made = room(albedo=(0.5, 0.45, 0.4), emission={3: (12, 11, 10)})
    return replace(made, response=gamma(), up=(0.0, 1.0, 0.0), exposures={"photo": EXPOSURE})


def applied(result: Result) -> bpy.types.Scene:
    """The room in the open scene with ``result`` on it, and the camera of the photo."""
    scene = bpy.context.scene
    thing = bpy.data.objects.new("room", plain_mesh(replace(result.mesh, uv=None), "room"))
    scene.collection.objects.link(thing)
    apply_to_objects(result, whole_object(thing), scene, "key")
    look_through(scene, VIEW, add_camera(VIEW, "photo", scene.collection))
    bpy.context.view_layer.update()
    return scene


def photo_of(result: Result) -> np.ndarray:
    (radiance,) = render_views(result, [VIEW], settings=RenderSettings(samples=128, seed=9, max_bounces=8))
    return np.round(gamma().apply(radiance * EXPOSURE) * 255) / 255


def test_an_added_ball_is_that_of_an_insertion_job():
    result = lit_room()
    photo = photo_of(result)
    expected = insert_onto_photo(result, VIEW, photo, EXPOSURE, SceneEdit(spheres=(BALL,)), RenderSettings(samples=128))
    scene = applied(result)
    ball = add_sphere(BALL, "ball", scene.collection)
    ball.matrix_world = Matrix.Translation(tuple(BALL.center))
    seen = composite(scene, photo, gamma(), EXPOSURE, RenderSettings(samples=128)).display
    changed = np.abs(expected - photo).max(-1) > 0.05
    assert 0.02 < changed.mean() < 0.6
    assert np.abs(seen - expected)[changed].mean() < 0.012
    assert np.abs(seen - expected).mean() < 0.004
    assert not ball.hide_render


def test_without_additions_the_composite_is_the_photo():
    scene = applied(lit_room())
    photo = np.random.default_rng(0).integers(0, 256, (30, 40, 3)) / 255
    np.testing.assert_array_equal(composite(scene, photo, gamma(), EXPOSURE, RenderSettings(samples=4)).display, photo)


def test_dimming_the_lamp_darkens_the_photo_by_the_same_factor():
    result = lit_room()
    photo, scene = photo_of(result), applied(result)
    (lamp,) = lamp_materials(scene.objects)
    set_strength(lamp, 3.0)  # of 12: the only light there is
    seen = composite(scene, photo, gamma(), EXPOSURE, RenderSettings(samples=128)).display
    dark = (photo.max(-1) < 0.9) & (photo.min(-1) > 0.1)
    ratio = gamma().invert(seen[dark]) / gamma().invert(photo[dark])
    np.testing.assert_allclose(np.median(ratio), 0.25, rtol=0.03)


# ---- light states --------------------------------------------------------------------------------------------------


GREEN, RED, BOTH = np.array([2.0, 12.0, 2.0]), np.array([12.0, 3.0, 2.0]), np.array([6.0, 6.0, 6.0])


def room_in_states() -> Result:
    """A green lamp shines in the first state, a red one in the second, a white one in both."""
    made, dark = lit_room(), np.zeros(3)
    states = (
        LightState("green", ("g",), np.array([GREEN, dark, BOTH])),
        LightState("red", ("photo",), np.array([dark, RED, BOTH])),
    )
    lamps = room(emission={3: GREEN, 2: dark, 0: BOTH}).emitters
    return replace(made, emitters=lamps, light_states=states)


def lamp_of(scene: bpy.types.Scene, number: int) -> bpy.types.Material:
    return lamp_materials(scene.objects)[number]


@pytest.mark.parametrize("shown", ["green", "red"])
def test_things_are_put_into_a_photo_under_its_own_lamps_whatever_the_scene_shows(shown: str):
    result = room_in_states()
    lit = result.in_state("red")
    photo, quick = photo_of(lit), RenderSettings(samples=128)
    expected = insert_onto_photo(lit, VIEW, photo, EXPOSURE, SceneEdit(spheres=(BALL,)), quick)
    scene = applied(result)
    keep_states(scene, result)
    set_own_look(scene, shown)
    before = [lamp_setting(lamp) for lamp in lamp_materials(scene.objects)]
    add_sphere(BALL, "ball", scene.collection).matrix_world = Matrix.Translation(tuple(BALL.center))
    seen = composite(scene, photo, gamma(), EXPOSURE, quick, "red").display
    changed = np.abs(expected - photo).max(-1) > 0.05
    assert 0.02 < changed.mean() < 0.6
    assert np.abs(seen - expected)[changed].mean() < 0.012
    assert np.abs(seen - expected).mean() < 0.004
    assert [lamp_setting(lamp) for lamp in lamp_materials(scene.objects)] == before


def test_only_what_the_artist_changed_at_the_lamps_changes_a_photo_of_another_state():
    result = room_in_states()
    photo, scene = photo_of(result.in_state("red")), applied(result)
    quick = RenderSettings(samples=128)
    np.testing.assert_array_equal(composite(scene, photo, gamma(), EXPOSURE, quick, "red").display, photo)
    set_strength(lamp_of(scene, 2), 1.5)  # of 6
    seen = composite(scene, photo, gamma(), EXPOSURE, quick, "red").display
    dimmed = replace(result.in_state("red"), emitters=room(emission={3: 0 * RED, 2: RED, 0: BOTH / 4}).emitters)
    (expected,) = render_views(dimmed, [VIEW], settings=replace(quick, seed=4))
    dark = (photo.max(-1) < 0.9) & (photo.min(-1) > 0.1)
    ratio = gamma().invert(seen[dark]) / (expected[dark] * EXPOSURE)
    np.testing.assert_allclose(np.median(ratio, axis=0), 1.0, rtol=0.05)


def test_a_state_that_the_scene_does_not_keep_is_refused():
    scene = applied(room_in_states())
    with pytest.raises(BadInput, match="keeps no light state 'blue'"):
        composite(scene, np.zeros((3, 4, 3)), gamma(), EXPOSURE, RenderSettings(samples=2), "blue")


def test_a_scene_with_light_states_is_restored_without_a_trace():
    scene = applied(room_in_states())
    assert has_light_states(scene)
    restore(scene)
    assert not has_light_states(scene) and not [key for key in scene.keys() if key.startswith("iris")]  # noqa: SIM118
    assert not bpy.data.worlds


def test_the_command_works_in_the_light_state_of_the_photo(tmp_path: Path, capsys):
    from headless.cli import main

    result = room_in_states()
    photo, scene = photo_of(result.in_state("red")), applied(result)
    grey = replace(BALL, base_color=np.full(3, 0.8), roughness=1.0)
    add_sphere(grey, "ball", scene.collection).matrix_world = Matrix.Translation(tuple(BALL.center))
    save_result(result, tmp_path / "result")
    image = image_from_array("photo", photo)
    image.filepath_raw, image.file_format = str(tmp_path / "photo.png"), "PNG"
    image.save()
    write_copy(scene, tmp_path / "copy.blend")

    def run(view: str, *more: str) -> int:
        where = ["--result", str(tmp_path / "result"), "--photo", str(tmp_path / "photo.png"), "--view", view]
        command = ["composite", str(tmp_path / "copy.blend"), *where, "--out", str(tmp_path / "out.png")]
        return main([*command, "--samples", "16", *more])

    for view, more, channel in (("photo", (), 0), ("g", (), 1), ("other", ("--light-state", "red"), 0)):
        assert run(view, *more) == 0
        ball = read_image(tmp_path / "out.png")[25:28, 18:23].mean((0, 1))
        assert ball[channel] > 1.1 * ball[1 - channel]
    for view, more, told in (
        ("other", (), "light state is known"),
        ("other", ("--light-state", "blue"), "not solved in the light state 'blue'"),
        ("photo", ("--light-state", "green"), "in the light state 'red', not 'green'"),
    ):
        assert run(view, *more) == 3
        assert told in capsys.readouterr().err


# ---- what is refused -----------------------------------------------------------------------------------------------


def test_a_scene_without_a_result_or_camera_is_refused():
    with pytest.raises(BadInput, match="no result is applied"):
        composite(bpy.context.scene, np.zeros((3, 4, 3)), gamma(), EXPOSURE, RenderSettings())
    scene = applied(lit_room())
    scene.camera = None
    with pytest.raises(BadInput, match="no active camera"):
        composite(scene, np.zeros((3, 4, 3)), gamma(), EXPOSURE, RenderSettings())


def test_the_command_opens_the_copy_and_leaves_a_picture(tmp_path: Path):
    from headless.cli import main

    result = lit_room()
    photo = photo_of(result)
    scene = applied(result)
    add_sphere(BALL, "ball", scene.collection)
    save_result(result, tmp_path / "result")
    image = image_from_array("photo", photo)
    image.filepath_raw, image.file_format = str(tmp_path / "photo.png"), "PNG"
    image.save()
    write_copy(scene, tmp_path / "copy.blend")
    bpy.ops.wm.read_factory_settings(use_empty=True)
    where = ["--result", str(tmp_path / "result"), "--photo", str(tmp_path / "photo.png")]
    out = tmp_path / "out" / "photo.png"
    command = ["composite", str(tmp_path / "copy.blend"), *where, "--view", "photo", "--out", str(out)]
    assert main([*command, "--samples", "16"]) == 0
    seen = read_image(out)
    green = (seen - photo)[..., 1] - (seen - photo)[..., 0]
    assert seen.shape == photo.shape and green.max() > 0.1
    assert main([*command, "--samples", "16", "--acescg"]) == 3
    assert main([*command, "--samples", "16", "--layers", "--acescg"]) == 0
    (part,) = OpenEXR.File(str(tmp_path / "out" / "photo-layers.exr"), separate_channels=True).parts
    channels = {name: channel.pixels for name, channel in part.channels.items()}
    layer = {
        name: np.stack([channels[f"{name}{letter}"] for letter in "RGB"], -1)
        for name in ("", "plate.", "catcher.", "object.")
    }
    alpha = channels["object.A"][..., None]
    assert 0.02 < (alpha > 0.5).mean() < 0.5 and layer["catcher."].min() < -1e-3, "the ball, and its shadow"
    whole = layer["plate."] * (1 - alpha) + layer["catcher."] + layer["object."]
    np.testing.assert_allclose(whole, layer[""], atol=1e-4)
    assert part.header["chromaticities"] == pytest.approx(ACESCG.chromaticities, abs=1e-5)
    shown = gamma().apply(layer[""] @ ACESCG.matrix_to(REC709).T * EXPOSURE)
    np.testing.assert_allclose(shown, read_image(out), atol=0.02)
    unclipped = (photo < 0.9).all(-1)
    plate = gamma().apply(layer["plate."] @ ACESCG.matrix_to(REC709).T * EXPOSURE)
    np.testing.assert_allclose(plate[unclipped], photo[unclipped], atol=5e-3)
    assert main(["composite", str(tmp_path / "photo.png"), *where, "--view", "photo", "--out", str(out)]) == 3
